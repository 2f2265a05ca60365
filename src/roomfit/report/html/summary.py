"""The answer in a few sentences, and the findings with the most serious first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roomfit.findings import Finding, Severity
from roomfit.report.html.absorption_tables import given
from roomfit.report.html.error_tables import errors_of
from roomfit.report.html.pair_tables import known_mean
from roomfit.report.html.wording import band_ranges, count, hertz, listing, number, parameter
from roomfit.typing import BoolArray
from roomfit.uncertainty.answer import Answer
from roomfit.uncertainty.gaussian import LARGEST_PHI

_SEVERITIES: tuple[Severity, ...] = ("serious", "warning", "info")
_MOST_ENDS, _MOST_NAMES = 3, 8
_TOLD = ("T20_s", "T30_s", "EDT_s", "C80_dB")


@dataclass(frozen=True, slots=True)
class FindingGroup:
    """Findings of one code: what many files share is told once, the rest can be unfolded."""

    code: str
    severity: Severity
    sentence: str
    others: tuple[str, ...]


def summary_sentences(answer: Answer) -> tuple[str, ...]:
    """Return what was done, what can be told apart, what cannot, and how well it predicts."""
    return tuple(
        sentence
        for sentence in (
            _what_was_done(answer),
            *_what_is_told(answer),
            _where_it_does_not_fit(answer),
            _how_well_it_predicts(answer),
            _how_many_findings(answer),
        )
        if sentence
    )


def told_in_words(answer: Answer) -> tuple[tuple[str, str], ...]:
    """Return band and sentence where the data know groups of materials, or leave some open."""
    told = zip(answer.bands.centres_hz, answer.sentences, strict=False)
    return tuple(
        (hertz(float(centre)), sentence.replace("+-", "\N{PLUS-MINUS SIGN}"))
        for centre, sentence in told
        if sentence
    )


def finding_groups(findings: tuple[Finding, ...]) -> tuple[FindingGroup, ...]:
    """Return the findings by severity, those of one code together."""
    alike: dict[tuple[Severity, str], list[Finding]] = {}
    for finding in sorted(findings, key=lambda f: _SEVERITIES.index(f.severity)):
        alike.setdefault((finding.severity, finding.code), []).append(finding)
    return tuple(
        FindingGroup(code, severity, same[0].sentence, tuple(f.sentence for f in same[1:]))
        for (severity, code), same in alike.items()
    )


def _what_was_done(answer: Answer) -> str:
    fitted = sum(pair.use == "fit" for pair in answer.pairs)
    kept = len(answer.pairs) - fitted
    data = count(fitted, "fitted measurement")
    if kept:
        data += f" and {count(kept, 'measurement')} kept for validation"
    everywhere = np.ones(len(answer.bands), dtype=np.bool_)
    return (
        f"Absorption of {count(len(answer.materials), 'material')} in "
        f"{count(len(answer.bands), f'{answer.bands.kind} band')} "
        f"({band_ranges(answer.bands.centres_hz, everywhere)}), from {data}; "
        f"method {answer.method}, model {answer.model}."
    )


def _what_is_told(answer: Answer) -> list[str]:
    held = given(answer)
    sure = answer.identifiable & ~held
    wanted = int(np.sum(~held))
    if not wanted:
        return ["Every coefficient was given; nothing was looked for."]
    told = [f"The data determine {int(sure.sum())} of {wanted} coefficients."]
    names, whole, never = answer.materials, [], []
    some = []
    for name, found, fixed in zip(names, sure, held, strict=True):
        if fixed.all():
            continue
        if (found | fixed).all():
            whole.append(name)
        elif not found.any():
            never.append(name)
        else:
            some.append(f"{name} ({_where(answer, found)})")
    if whole:
        told.append(f"Identified in every band: {_first(whole)}.")
    if some:
        told.append(f"Identified in some bands: {_first(some)}.")
    if never:
        told.append(f"Not identifiable in any band: {_first(never)}.")
    fixed_names = [name for name, fixed in zip(names, held, strict=True) if fixed.all()]
    if fixed_names:
        told.append(f"Given beforehand and held fixed: {_first(fixed_names)}.")
    return told


def _where(answer: Answer, found: BoolArray) -> str:
    """Return the bands; their number where they are too scattered to be read."""
    if int(np.sum(np.diff(found.astype(int)) != 0)) > _MOST_ENDS:
        return f"{int(found.sum())} of {len(answer.bands)} bands"
    return band_ranges(answer.bands.centres_hz, found)


def _first(names: list[str]) -> str:
    """Return a list that stays short enough to be read; the tables hold all."""
    more = len(names) - _MOST_NAMES
    return listing(names) if more <= 0 else listing([*names[:_MOST_NAMES], f"{more} more"])


def _where_it_does_not_fit(answer: Answer) -> str:
    misfit = answer.phi > LARGEST_PHI
    if not misfit.any():
        return ""
    return (
        f"The model does not explain the data at {band_ranges(answer.bands.centres_hz, misfit)} "
        f"(φ above {LARGEST_PHI:g}); no coefficient counts as identifiable there."
    )


def _how_well_it_predicts(answer: Answer) -> str:
    kept = [pair for pair in answer.pairs if pair.use == "validate"]
    pairs = kept or list(answer.pairs)
    told = []
    for key in _TOLD:
        if not any(key in pair.parameters for pair in pairs):
            continue
        errors = errors_of(pairs, key)
        model, null = known_mean(errors.model), known_mean(errors.null)
        if not np.isfinite(model):
            continue
        how = parameter(key)
        words = f"{how.symbol} {number(model, how.error_decimals)} {how.error_unit}"
        if np.isfinite(null):
            words += f" ({number(null, how.error_decimals)})"
        told.append(words)
    if not told:
        return ""
    which = "measurements kept for validation" if kept else "fitted measurements"
    return (
        f"Mean error of the {which}, in brackets that of guessing the mean of the others: "
        f"{listing(told)}."
    )


def _how_many_findings(answer: Answer) -> str:
    counts = [
        (sum(f.severity == severity for f in answer.findings), severity) for severity in _SEVERITIES
    ]
    words = {"serious": "serious finding", "warning": "warning", "info": "note"}
    told = [count(n, words[severity]) for n, severity in counts if n]
    return f"Read first: {listing(told)} below." if told else ""
