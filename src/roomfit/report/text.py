"""Answers, checked rooms and the catalogue of materials as text for a terminal."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Sequence
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from roomfit.base.findings import Code, Finding
from roomfit.base.logit import Z95, expit
from roomfit.base.table import Column, Table, Value, text_of
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.materials.catalogue import OCTAVES_HZ, CatalogueEntry
from roomfit.model.patterns import axial_index_db
from roomfit.report.wording import PARAMETERS, decay_time_key, parameter, short_hertz
from roomfit.room.scene import RoomCheck
from roomfit.signals.speech import sti_of_decay

if TYPE_CHECKING:  # heavy, and no text of a room needs them
    from roomfit.checks.usable import CheckedRecordings
    from roomfit.files.remedies import Advice
    from roomfit.predict.diffuse_field import DiffuseAbsorption
    from roomfit.result import ComparedPair, Result

# A recording has all parameters, and these represent them; a table of room parameters has the
# measured ones only, and all of it is shown.
_OF_RECORDINGS = ("T20_s", "EDT_s", "C80_dB")
_BELOW_BAND = " " * 11
_LEAST_COST = 0.03  # of a standard deviation: terms that cost less are not named
_MOST_SENTENCES = 12


def answer_text(answer: Result, advice: Advice | None = None) -> str:
    """Return everything a user must know: what is void, absorption, pairs, findings."""
    parts = [
        usable_text(answer),
        absorption_table(answer),
        objects_table(answer),
        separable_text(answer),
        shares_table(answer),
        directivity_text(answer),
        offsets_text(answer),
        costs_text(answer),
        pairs_table(answer),
        plan_text(answer),
        findings_text(answer.findings, advice),
    ]
    return "\n\n".join(p for p in parts if p)


def usable_text(answer: Result) -> str:
    """Return which walls findings take away, and what may be used all the same."""
    from roomfit.report.usable import remaining_usable

    return "\n".join(
        textwrap.fill(text, 100, break_on_hyphens=False) for text in remaining_usable(answer)
    )


def plan_text(answer: Result) -> str:
    """Return where sources and receivers were taken to stand: the reader is to compare."""
    lines = (
        ["The plan in words; no recording tells it from its mirror image"] if answer.plan else []
    )
    more = len(answer.plan) - _MOST_SENTENCES
    rest = [f"(and {more} more in result.json)"] if more > 0 else []
    return "\n".join([*lines, *answer.plan[:_MOST_SENTENCES], *rest])


def absorption_table(answer: Result) -> str:
    """Return absorption with its interval per material and band; ``?`` marks what is not sure."""
    values = np.stack([answer.absorption, answer.lower95, answer.upper95])
    rows = [
        (name, *map(_interval_cell, *values[:, i], answer.identifiable[i]))
        for i, name in enumerate(answer.materials)
    ]
    rows.append(("room mean", *map(_interval_cell, *answer.mean_absorption)))
    caption = f"Absorption, 95 % interval ({answer.interval_kind}); ? = not identifiable"
    return text_of(Table(caption, _heads(answer.bands.centres_hz), rows))


def separable_text(answer: Result) -> str:
    """Return in words which materials the data determine, band by band."""
    has_sentences = any(answer.sentences)
    lines = [
        "What the data determine" + (" (+-: half of the 95 % interval)" if has_sentences else "")
    ]
    for j, centre in enumerate(answer.bands.centres_hz):
        fixed = answer.lower95[:, j] == answer.upper95[:, j]
        sure = _names(answer.materials, answer.identifiable[:, j] & ~fixed)
        mean, lower, upper = answer.mean_absorption[:, j]
        known = sure if sure else "no single material"
        if fixed.any():
            known += f"; given: {_names(answer.materials, fixed)}"
        fit = (
            ""
            if answer.chi2_reduced[j] <= 2.0
            else f"; the model does not fit (phi {answer.chi2_reduced[j]:.1f})"
        )
        lines.append(
            f"{centre:>6g} Hz  identified: {known}; mean of the room {mean:.2f} "
            f"({lower:.2f} to {upper:.2f}){fit}"
        )
        if answer.sentences and answer.sentences[j]:
            sentence = textwrap.fill(answer.sentences[j], 100 - len(_BELOW_BAND))
            lines.append(textwrap.indent(sentence, _BELOW_BAND))
    return "\n".join(lines)


def shares_table(answer: Result) -> str:
    """Return what each material contributes to the room's absorption, in percent."""
    if answer.shares is None:
        return ""
    rows = []
    for i, name in enumerate(answer.materials):
        columns = 100.0 * answer.shares[:, i].T
        rows.append(
            (name, *(f"{value:.0f} ({low:.0f}-{high:.0f})" for value, low, high in columns))
        )
    caption = "Share of the room's absorption in %, 95 % interval (air left out)"
    return text_of(Table(caption, _heads(answer.bands.centres_hz), rows))


def _heads(centres_hz: FloatArray) -> tuple[str, ...]:
    return ("Hz", *(f"{f:g}" for f in centres_hz))


def objects_table(answer: Result) -> str:
    """Return the equivalent absorption area of every object with its interval, or nothing."""
    if answer.objects is None:
        return ""
    found, rows = answer.objects, []
    for i, name in enumerate(found.names):
        columns = zip(
            found.area_m2[i], found.lower95_m2[i], found.upper95_m2[i], found.identifiable[i],
            strict=True,
        )  # fmt: skip
        cells = (
            f"{a:.3g} given"
            if high <= low
            else f"{a:.3g}{'' if sure else '?'} ({low:.2g}-{high:.2g})"
            for a, low, high, sure in columns
        )
        rows.append((name, *cells))
    caption = "Equivalent absorption area of objects in m2, 95 % interval, ? not identifiable"
    return text_of(Table(caption, _heads(answer.bands.centres_hz), rows))


def directivity_text(answer: Result) -> str:
    """Return strength and axis of every source whose directivity was fitted, band by band."""
    lines = []
    for found in answer.directivities:
        aimed = any(aim is not None for aim in found.aims.values())
        if aimed:
            lines.append(
                f"{found.source}, {len(found.aims)} sources: amplitude by Legendre polynomials of "
                "the cosine of the angle to the aim"
            )
            for centre, b, sd in zip(answer.bands.centres_hz, found.b, found.sd, strict=True):
                numbers = ", ".join(f"{x:.2f} +- {s:.2f}" for x, s in zip(b, sd, strict=True))
                index_db = axial_index_db(b)
                lines.append(f"{centre:>6g} Hz  b {numbers}; directivity index {index_db:.1f} dB")
            continue
        lines.append(f"{found.source} sends with the amplitude 1 + b cos of the angle to its axis")
        for centre, b, sd in zip(answer.bands.centres_hz, found.b, found.sd, strict=True):
            length = float(np.linalg.norm(b))
            axis = b / length if length > 0.0 else b
            along = float(np.sqrt(axis**2 @ sd**2)) if length > 0.0 else float(sd.max())
            towards = ", ".join(f"{x:.2f}" for x in axis)
            lines.append(f"{centre:>6g} Hz  b {length:.2f} +- {along:.2f} towards ({towards})")
    return "\n".join(lines)


def offsets_text(answer: Result) -> str:
    """Return where groups of positions and lengths were found, with standard deviations."""
    found = answer.geometry
    if found is None or not found.n_offsets:
        return ""
    lines = ["Fitted along by early reflections, from the specified value; intervals hold there"]
    for i in range(len(found.labels) - found.n_offsets, len(found.labels)):
        lines.append(
            f"{found.labels[i]}: {found.change[i]:+.3f} +- {found.sd[i]:.3f} m "
            f"(specified within {found.prior_sd[i]:.3f} m)"
        )
    return "\n".join(lines)


def _names(materials: tuple[str, ...], chosen: BoolArray) -> str:
    return ", ".join(n for n, c in zip(materials, chosen, strict=True) if c)


def costs_text(answer: Result) -> str:
    """Return by how much standard deviations would be smaller without each term, band by band."""
    lines = []
    for centre, band in zip(answer.bands.centres_hz, answer.costs, strict=False):
        fitted = band[""] > 0.0 if band else np.zeros(0, dtype=np.bool_)
        if not fitted.any():
            continue
        less = {n: 1.0 - float(np.median(sd[fitted] / band[""][fitted])) for n, sd in band.items()}
        named = sorted((n for n in less if less[n] >= _LEAST_COST), key=lambda n: -less[n])
        prior = float(np.median(np.minimum(band["prior"][fitted] / band[""][fitted], 100.0)))
        each = ", ".join(f"{n} {100 * less[n]:.0f} %" for n in named) or "none"
        lines.append(f"{centre:>6g} Hz  {each}; without the prior {prior:.1f} times as large")
    if not lines:
        return ""
    head = "What uncertainty is made of: by how much the standard deviation of a material (median)"
    return "\n".join([head, "would be smaller without a term", *lines])


def pairs_table(answer: Result) -> str:
    """Return mean absolute errors of predicted parameters beside those of the baseline.

    Of pairs with a recording T20, EDT and C80; of tables of room parameters all that they have.
    The baseline is the mean of the same parameter over the other fitted measurements.
    """
    rows: list[tuple[str, list[str]]] = []
    times: list[str] = []
    for use in ("fit", "validate"):
        pairs = [p for p in answer.pairs if p.use == use]
        time = decay_time_key(key for p in pairs for key in p.parameters)
        if time is not None:
            rows.append((f"{parameter(time).symbol} s {_said(use)}", _decay_cells(pairs, time)))
            times.append(parameter(time).symbol)
        rows += [_error_row(pairs, name, use) for name in _shown(pairs)]
    if not rows:
        return ""
    means = f"mean {' or '.join(dict.fromkeys(times))} (measured > predicted), then " * bool(times)
    width = max(16, *(len(label) for label, _ in rows))
    head = "  ".join(f"{f:>13g}" for f in answer.bands.centres_hz)
    return "\n".join(
        [
            f"Predicted against measured: {means}mean absolute errors (model | mean of the others)",
            f"{'Hz':<{width}}  {head}",
            *(f"{label:<{width}}  " + "  ".join(cells) for label, cells in rows),
            *_sti_lines(answer),
        ]
    )


def pair_sti(answer: Result) -> FloatArray:
    """Return the speech transmission index of every pair: measured, predicted, mean of the others.

    Of the room alone, from the decay curves, shape (3, n_pairs); NaN where it is not known. The
    others are those that were fitted in the same state.
    """
    found = np.full((3, len(answer.pairs)), np.nan)
    for i, pair in enumerate(answer.pairs):
        if pair.decay is not None:
            for k, levels_db in enumerate((pair.decay.measured_db, pair.decay.predicted_db)):
                found[k, i] = sti_of_decay(answer.bands, pair.decay.time_s, levels_db)
    for i, pair in enumerate(answer.pairs):
        others = [
            found[0, j]
            for j, other in enumerate(answer.pairs)
            if j != i and other.use == "fit" and other.state == pair.state
            if np.isfinite(found[0, j])
        ]
        found[2, i] = np.mean(others) if others else np.nan
    return found


def _sti_lines(answer: Result) -> list[str]:
    """Return the mean index and its errors, of fitted pairs and of others."""
    measured, predicted, others = pair_sti(answer)
    lines = []
    for use in ("fit", "validate"):
        own = np.array([p.use == use for p in answer.pairs])
        own &= np.isfinite(measured) & np.isfinite(predicted)
        if own.any():
            means = f"{measured[own].mean():.2f} > {predicted[own].mean():.2f}"
            ours, baseline = (
                f"{np.mean(np.abs(x - measured)[own]):.2f}" for x in (predicted, others)
            )
            errors = f"{ours} | {baseline.replace('nan', '-')}"
            lines.append(f"STI of the room alone, {_said(use)}: {means}; error {errors}")
    return lines


def _shown(pairs: list[ComparedPair]) -> list[str]:
    """Return the parameters to show, in the order of `PARAMETERS`."""
    return [
        name
        for name in PARAMETERS
        if any(name in p.parameters and (name in _OF_RECORDINGS or p.decay is None) for p in pairs)
    ]


def _error_row(pairs: list[ComparedPair], name: str, use: str) -> tuple[str, list[str]]:
    """Return the label and the cells of the errors of a parameter, of pairs that have it."""
    compared = [p.parameters[name] for p in pairs if name in p.parameters]
    measured = [c.measured for c in compared]
    ours = _mean_error(name, [c.predicted for c in compared], measured)
    baseline = _mean_error(name, [c.null for c in compared], measured)
    label = f"{parameter(name).symbol} {parameter(name).error_unit} {_said(use)}"
    texts = [[f"{x:.1f}" if np.isfinite(x) else "-" for x in row] for row in (ours, baseline)]
    return label, [f"{a:>5} | {b:>5}" for a, b in zip(*texts, strict=True)]


def _decay_cells(pairs: list[ComparedPair], name: str) -> list[str]:
    """Return the mean decay time, measured > predicted in s, over pairs that have both."""
    compared = [p.parameters[name] for p in pairs if name in p.parameters]
    measured = np.array([c.measured for c in compared])
    predicted = np.array([c.predicted for c in compared])
    both = np.isfinite(measured) & np.isfinite(predicted)
    counts = np.maximum(both.sum(axis=0), 1)
    means = [np.where(both, t, 0.0).sum(axis=0) / counts for t in (measured, predicted)]
    return [
        f"{m:5.2f} > {p:5.2f}" if known else f"{'-':>5} > {'-':>5}"
        for m, p, known in zip(*means, both.any(axis=0), strict=True)
    ]


def _said(use: str) -> str:
    return "fitted" if use == "fit" else "not fitted"


def findings_text(findings: tuple[Finding, ...], advice: Advice | None = None) -> str:
    """Return the findings, most serious first; one line for each code, and what it advises."""
    order = {"serious": 0, "warning": 1, "info": 2}
    alike: dict[Code, list[Finding]] = {}
    for finding in sorted(findings, key=lambda f: order[f.severity]):
        alike.setdefault(finding.code, []).append(finding)
    lines = ["Findings"] if findings else []
    for code, same in alike.items():
        more = f" (and {len(same) - 1} more of this kind in result.json)" if same[1:] else ""
        text = f"{same[0].severity}: {same[0].sentence}{more} [{code}]"
        # codes are looked up, so they stay whole
        wrapped = textwrap.wrap(
            text, 100, initial_indent="- ", subsequent_indent="  ", break_on_hyphens=False
        )
        lines += [*wrapped, *(f"    {line}" for line in (advice or {}).get(code, ()))]
    return "\n".join(lines)


def _interval_cell(value: float, lower: float, upper: float, sure: object = True) -> str:
    mark = " " if sure else "?"
    return f"{_short(value)}{mark}{_short(lower)}-{_short(upper)}"


def _short(value: float) -> str:
    """Three characters and a point less: .07, 1.0."""
    return "1.00"[:3] if value >= 0.995 else f"{value:.2f}"[1:]


def _mean_error(name: str, guesses: list[FloatArray], measured: list[FloatArray]) -> FloatArray:
    """Mean absolute error over pairs, in `error_unit`; NaN where nothing can be compared."""
    errors = np.abs(np.array(guesses) - np.array(measured))
    if parameter(name).error_unit == "%":
        errors = 100.0 * errors / np.array(measured)
    known = np.isfinite(errors)
    counts = known.sum(axis=0)
    sums = np.where(known, errors, 0.0).sum(axis=0)
    return np.asarray(np.where(counts > 0, sums / np.maximum(counts, 1), np.nan))


_OCTAVES = tuple(Column(short_hertz(f), ".2f") for f in OCTAVES_HZ)


def catalogue_text(entries: Sequence[CatalogueEntry]) -> str:
    """Return one line for each entry, under its group: name and absorption in octaves."""
    rows: list[Sequence[Value]] = []
    for group, own in groupby(entries, key=lambda entry: entry.group):
        rows += [[""], [group], *([f"  {e.name}", *e.absorption] for e in own)]
    number = f"{len(entries)} materials" if len(entries) != 1 else "1 material"
    notes = ("", f"{number}. roomfit catalogue NAME shows one with its spread and sources.")
    return text_of(Table("", ("absorption at", *_OCTAVES), rows, notes))


def entry_text(entry: CatalogueEntry) -> str:
    """Return one entry in full: middle, spread, and every reading with its source."""
    low, high = (expit(entry.logit_mean + z * entry.logit_sd) for z in (-Z95, Z95))
    rows: list[Sequence[Value]] = [
        ("absorption", *entry.absorption),
        ("standard deviation", *entry.sd),
        ("95 % from", *low),
        ("95 % to", *high),
        ("",),
        ("readings",),
    ]
    for reading in entry.readings:
        rows += [("", *reading.absorption), (f"  {reading.row}",), (f"    {reading.source}",)]
    caption = f"{entry.name}\n{entry.description} ({entry.group})\n"
    notes = (
        "",
        "63 Hz and 8 kHz are extrapolated from their neighbours, with a wider spread, where no",
        f'reading has them. As a prior in a campaign: prior = "{entry.name}"',
    )
    return text_of(Table(caption, ("octave, Hz", *_OCTAVES), rows, notes))


def room_text(title: str, check: RoomCheck, advice: Advice | None = None) -> str:
    """Return the room's size, its materials, and what is wrong with it, ready to print."""
    about = "" if check.closed else "  (approximate: the mesh is not closed)"
    x, y, z = check.size_m
    rows = [
        title,
        f"  size            {x:.2f} x {y:.2f} x {z:.2f} m",
        f"  volume V        {check.volume_m3:.2f} m3{about}",
        f"  surface S       {check.surface_m2:.2f} m2",
        f"  mean free path  {check.mean_free_path_m:.3f} m  (4 V / S)",
        f"  mesh            {check.n_triangles} triangles, {check.n_surfaces} surfaces, "
        f"{'closed' if check.closed else 'not closed'}, {_leak(check.leak)}",
        "",
        *_materials(check),
    ]
    faults = [f for f in check.findings if f.severity == "serious"]
    doubts = [f for f in check.findings if f.severity != "serious"]
    if doubts:
        rows += ["", "findings"]
        for f in doubts:
            text = f"  {f.severity:<8} {f.sentence}"
            rows += textwrap.wrap(text, 100, subsequent_indent=" " * 11, break_on_hyphens=False)
            rows += [f"{' ' * 13}{line}" for line in (advice or {}).get(f.code, ())]
    if faults:
        rows += ["", "faults that forbid tracing", *(line for f in faults for line in _fault(f))]
    else:
        rows += ["", "The room can be traced."]
    return "\n".join(rows)


DIFFUSE_WORDS = (
    "Decay times determine the mean alone, as far as the field is diffuse; the formulas "
    "differ by what that means, and intervals allow for it where priors tell walls apart; "
    "elsewhere walls are taken to be alike. What stands for single materials is their priors, "
    "moved together until they give this mean: nothing more is known of any of them. Where "
    "walls are much alike Eyring was nearest in trials, in flat rooms with one soft surface "
    "Fitzroy. Impulse "
    "responses and positions would separate them (roomfit identify)."
)


def diffuse_text(found: DiffuseAbsorption) -> str:
    """Return mean absorption and materials by each formula, and what may be concluded from them."""
    from roomfit.predict.diffuse_field import FORMULAS

    times = [f"{t:.2f} +- {sd:.2f}" for t, sd in zip(found.decay_s, found.decay_sd_s, strict=True)]
    rows: list[Sequence[Value]] = [("decay time, s", *times)]
    for formula, mean, absorption in zip(FORMULAS, found.mean, found.absorption, strict=True):
        rows += [("",), (f"Absorption by {formula}, 95 % interval",)]
        named = (("room mean", mean), *zip(found.materials, absorption, strict=True))
        rows += [(name, *map(_interval_cell, *values)) for name, values in named]
    notes = ("", textwrap.fill(DIFFUSE_WORDS, 100))
    return text_of(Table("", _heads(found.bands.centres_hz), rows, notes))


def diffuse_records(found: DiffuseAbsorption) -> Table:
    """Return the content of reverberation.csv; material "" is the mean of the room."""
    from roomfit.predict.diffuse_field import FORMULAS

    rows = []
    for i, formula in enumerate(FORMULAS):
        named = (("", found.mean[i]), *zip(found.materials, found.absorption[i], strict=True))
        for name, values in named:
            for centre, column in zip(found.bands.centres_hz, values.T, strict=True):
                rows.append((formula, name, centre, *column))
    names = ("absorption", "lower95", "upper95")
    return Table("", ("formula", "material", Column("band_hz"), *names), rows, form=".5f")


def recordings_text(checked: CheckedRecordings, advice: Advice | None = None) -> str:
    """Return a table of recordings by band before a fit, and what is wrong with them."""
    names = [f"{m.source} to {m.receiver} ({m.name})" for m in checked.measurements]
    width = max(map(len, (*names, "Schroeder frequency, Hz")), default=0)
    bands = " ".join(f"{f:>6g}" for f in checked.bands.centres_hz)
    rows = []
    if names:
        rows = [
            "Recordings: direct sound in ms after emission, and by the geometry; peak over noise,",
            "and decay range by band, in dB; < = too little for T20, - = not to be used",
            f"{'':<{width}}  {'direct':>8} {'geometry':>8} {'S/N':>4}  {bands}",
        ]
    for i, name in enumerate(names):
        cells = [
            f"{range_db:5.0f}{' ' if has_t20 else '<'}" if usable else f"{'-':>5} "
            for range_db, usable, has_t20 in zip(
                checked.decay_range_db[i], checked.usable[i], checked.has_t20[i], strict=True
            )
        ]
        times = (1e3 * float(x[i]) for x in (checked.onset_s, checked.travel_s))
        noise_db = float(np.max(checked.peak_to_noise_db[i], initial=-np.inf))
        numbers = [f"{x:8.2f}" if np.isfinite(x) else f"{'-':>8}" for x in times]
        numbers += [f"{noise_db:4.0f}" if np.isfinite(noise_db) else f"{'-':>4}"]
        rows.append(f"{name:<{width}}  {' '.join(numbers)}  {' '.join(cells)}".rstrip())
    if np.any(np.isfinite(checked.decay_s)):
        known = np.isfinite(checked.decay_s)
        for title, values, digits in (
            ("reverberation time, s", checked.decay_s, 2),
            ("Schroeder frequency, Hz", checked.schroeder_hz, 0),
        ):
            cells = [
                f"{v:6.{digits}f}" if k else f"{'-':>6}" for v, k in zip(values, known, strict=True)
            ]
            rows.append(f"{title:<{width}}  {'':>22}  {' '.join(cells)}")
    findings = re.sub(r"\s+in\s+result\.json\)", ")", findings_text(checked.findings, advice))
    return "\n".join([*rows, "", findings]).strip("\n")


def _leak(leak: float | None) -> str:
    if leak is None:
        return "no point inside found"
    return f"{1e2 * leak:.3g} % of hits lost" if leak else "no ray lost"


def _materials(check: RoomCheck) -> list[str]:
    rows = [
        (name or "(no material)", area, f"{1e2 * area / (check.surface_m2 or np.inf):.1f} %")
        for name, area in check.material_areas_m2
    ]
    shown = Table("", ("material", "area in m2", "share"), rows, form=".2f")
    return text_of(shown, indent="  ").splitlines()


def _fault(finding: Finding) -> list[str]:
    error = finding.error
    if error is None:
        return [f"  {finding.sentence}"]
    parts = {
        "where": error.where,
        "found": error.found,
        "needed": error.needed,
        "try": error.hint,
    }
    rows = [f"    {key:<7} {text}" for key, text in parts.items() if text]
    return [f"  {error.what}", *rows]
