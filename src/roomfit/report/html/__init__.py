"""The answer in a few sentences, and the findings with the most serious first.

The report: a whole answer as one HTML file that needs nothing beside it.
"""

from __future__ import annotations

import base64
import gzip
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from roomfit.findings import Code, Finding, Severity
from roomfit.geometry.mesh import surface_area_m2, volume_m3
from roomfit.report.html.figures import (
    absorption_plot,
    corner_plot,
    decay_plot,
    identifiability_plot,
    material_table,
    position_table,
    profile_plot,
    room_plan,
    room_plot,
)
from roomfit.report.html.parts import (
    area,
    band_ranges,
    count,
    hertz,
    listing,
    number,
    page_json,
    parameter,
)
from roomfit.report.html.tables import (
    absorption_tables,
    area_tables,
    certificate_tables,
    error_tables,
    errors_of,
    fit_tables,
    given,
    known_mean,
    overview_table,
    pair_sections,
    prior_tables,
    share_tables,
    source_tables,
)
from roomfit.results import Answer
from roomfit.scene import Scene
from roomfit.typing import BoolArray
from roomfit.uncertainty.gaussian import LARGEST_PHI

_SEVERITIES: tuple[Severity, ...] = ("serious", "warning", "info")
_MOST_ENDS, _MOST_NAMES = 3, 8
_TOLD = ("T20_s", "T30_s", "EDT_s", "C80_dB")


@dataclass(frozen=True, slots=True)
class FindingGroup:
    """Findings of one code: what many files share is told once, the rest can be unfolded."""

    code: Code
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
    alike: dict[tuple[Severity, Code], list[Finding]] = {}
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


def report_html(
    answer: Answer,
    scene: Scene,
    *,
    title: str,
    campaign: str | None = None,
    inputs_sha256: Mapping[str, str] | None = None,
) -> str:
    """Return the report of an identification as the text of one HTML file, 2 to 5 MB.

    It holds, in this order: the answer in words, findings, the room, absorption with its
    intervals, absorption areas, predictions beside measurements and beside the null model, and
    where everything comes from. The file asks nothing of any network: the script that draws
    (plotly.js) is inside, and the page's own content security policy forbids requests. Tables,
    findings and the plan can be read without a script. Equal arguments give equal text.

    Parameters
    ----------
    answer : Answer
    scene : Scene
        That the answer was found in: room, positions and air.
    title : str
    campaign : str, optional
        Name of the campaign file, for provenance.
    inputs_sha256 : mapping of str to str, optional
        SHA-256 of every input file by its name.

    Returns
    -------
    str
        Write it as UTF-8.
    """
    drawn = decay_plot(answer)
    decay, curves = drawn if drawn else (None, [])
    room, absorption = room_plot(scene), absorption_plot(answer)
    sure, bent, corner = identifiability_plot(answer), profile_plot(answer), corner_plot(answer)
    drawn_here = (room, absorption, sure, bent, corner, decay)
    plots = [plot for plot in drawn_here if plot is not None]
    text: str = _template().render(
        title=title,
        summary=summary_sentences(answer),
        findings=finding_groups(answer.findings),
        room=room,
        plan=room_plan(scene),
        materials=material_table(scene.room),
        positions=position_table(scene),
        absorption=absorption,
        certainty=[plot for plot in (sure, bent, corner) if plot is not None],
        prior_tables=prior_tables(answer),
        reasons=answer.reasons,
        absorption_tables=absorption_tables(answer),
        fit_tables=(*fit_tables(answer), *source_tables(answer), *certificate_tables(answer)),
        area_tables=(*area_tables(answer, scene), *share_tables(answer)),
        told=told_in_words(answer),
        error_tables=error_tables(answer),
        overview=overview_table(answer),
        decay=decay,
        curves=curves,
        without_curve=len(answer.pairs) - len(curves),
        pairs=pair_sections(answer),
        provenance=_provenance(answer, scene, campaign),
        inputs=tuple((inputs_sha256 or {}).items()),
        page_data=page_json(_page_data(plots, curves)),
        plotly_js=_packed_plotly_js(),
    )
    return text


def _page_data(plots: list[Any], curves: list[dict[str, Any]]) -> dict[str, Any]:
    return {
        "plots": [{"name": p.name, "height": p.height_px, "alt": p.alt, **p.figure} for p in plots],
        "curves": curves,
    }


def _provenance(answer: Answer, scene: Scene, campaign: str | None) -> tuple[tuple[str, str], ...]:
    mesh, air = scene.room.mesh, scene.air
    return (
        ("roomfit", version("roomfit")),
        ("campaign", campaign or "not told"),
        ("method, model", f"{answer.method}, {answer.model}"),
        ("intervals", answer.interval_kind),
        ("seed", str(answer.seed)),
        ("time", f"{number(answer.seconds, 1)} s"),
        ("evaluations", str(answer.evaluations)),
        ("cost", f"{number(answer.cost, 2)} (half the sum of squared weighted residuals)"),
        ("room", f"V = {area(volume_m3(mesh))} m³, S = {area(surface_area_m2(mesh))} m²"),
        (
            "air",
            f"{number(air.temperature_c, 1)} °C, {number(air.humidity_percent, 0)} % relative "
            f"humidity, {number(air.pressure_kpa, 1)} kPa; attenuation "
            f"{'by ISO 9613-1' if air.attenuation == 'iso9613' else 'none'}",
        ),
        ("speed of sound", f"{number(answer.speed_of_sound_m_s, 2)} m/s"),
    )


def _template() -> Any:
    environment = Environment(
        loader=PackageLoader("roomfit.report.html"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("report.html.j2")


def _packed_plotly_js() -> str:
    """Return plotly.js, compressed to 2 of its 5 MB, in base64; a browser unpacks it."""
    from plotly.offline import get_plotlyjs

    packed = gzip.compress(get_plotlyjs().encode("utf-8"), mtime=0)
    return base64.b64encode(packed).decode("ascii")
