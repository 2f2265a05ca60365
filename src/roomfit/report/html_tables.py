"""The tables of the report, as text in cells.

Absorption with intervals, shares and absorption areas; the fit and its certificate; errors of
predictions beside those of the baseline, and pair by pair in just noticeable differences; the
room's materials and positions; fitted directivities. `wording.Table` is what the template draws.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from roomfit.air import attenuation_per_m
from roomfit.geometry.mesh import volume_m3
from roomfit.objective.directivity import FittedDirectivity
from roomfit.report.room_figure import material_colour
from roomfit.report.text import pair_sti
from roomfit.report.wording import (
    DASH,
    PARAMETERS,
    Cell,
    Row,
    Table,
    area,
    band_tables,
    coefficient,
    count,
    hertz,
    number,
    parameter,
    shortened,
)
from roomfit.response.directivity import axial_index_db
from roomfit.results import Compared, ComparedPair, Result, Use, certificate_distance
from roomfit.scene import Room, Scene, material_areas_m2
from roomfit.signals.decay import in_jnd
from roomfit.typing import BoolArray, FloatArray, IntArray
from roomfit.uncertainty.gaussian import LARGEST_CHI2_REDUCED

NOT_IDENTIFIABLE = "not identif."


def fixed_coefficients(answer: Result) -> BoolArray:
    """Return which coefficients were fixed, shape (n_materials, n_bands)."""
    return np.asarray(answer.lower95 == answer.upper95)


def absorption_tables(answer: Result, say: Callable[[str], str] = str) -> tuple[Table, ...]:
    """Return absorption with its 95 % interval, materials in rows, with the mean of the room."""

    def translated(row: Row) -> Row:
        cells = tuple(replace(c, small=tuple(say(line) for line in c.small)) for c in row.cells)
        head = say(row.head) if row.style == "total" else row.head
        return replace(row, head=head, cells=cells)

    return band_tables(
        f"{say('Absorption coefficient, 95 % interval')} ({answer.interval_kind})",
        say("material"),
        answer.bands.centres_hz,
        lambda block: (
            *(translated(r) for r in material_rows(answer, block)),
            translated(mean_row(answer, block)),
        ),
    )


def material_rows(answer: Result, block: IntArray) -> list[Row]:
    """Return absorption with its interval in the bands of a block, one row a material."""
    fixed = fixed_coefficients(answer)
    return [
        Row(
            name,
            tuple(
                coefficient_cell(
                    answer.absorption[i, j],
                    answer.lower95[i, j],
                    answer.upper95[i, j],
                    sure=bool(answer.identifiable[i, j]),
                    fixed=bool(fixed[i, j]),
                )
                for j in block
            ),
            small=f"{area(float(answer.areas_m2[i]))} m²",
            colour=material_colour(i),
        )
        for i, name in enumerate(answer.materials)
    ]


def mean_row(answer: Result, block: IntArray) -> Row:
    """Return the mean absorption of the room, weighted by area, in the bands of a block."""
    total = float(np.sum(answer.areas_m2))
    cells = tuple(
        coefficient_cell(*answer.mean_absorption[:, j], sure=True, fixed=False) for j in block
    )
    return Row("mean of the room", cells, small=f"by area, {area(total)} m²", style="total")


def coefficient_cell(value: float, lower: float, upper: float, *, sure: bool, fixed: bool) -> Cell:
    """Return an absorption with its interval; doubts and given values are marked in words."""
    if not np.isfinite(value):
        return Cell(DASH, ("not determined",), "unsure")
    if fixed:
        return Cell(coefficient(value, upper), ("given",), "given")
    text = coefficient(value, upper)
    interval = f"{coefficient(lower, upper)}{DASH}{coefficient(upper, upper)}"
    if sure:
        return Cell(text, (interval,))
    return Cell(f"({text})", (interval, NOT_IDENTIFIABLE), "unsure")


def fit_tables(answer: Result) -> tuple[Table, ...]:
    """Return how well the model fits each band, and whether the fit converged."""

    def rows(block: IntArray) -> tuple[Row, ...]:
        chi2 = tuple(_chi2_cell(float(value)) for value in answer.chi2_reduced[block])
        converged = tuple(
            Cell("yes") if answer.converged[j] else Cell("no", style="far") for j in block
        )
        return Row("φ", chi2, "1: as expected"), Row("the fit converged", converged)

    caption = "How well the model explains the data"
    return band_tables(caption, "", answer.bands.centres_hz, rows)


def _chi2_cell(chi2_reduced: float) -> Cell:
    if not np.isfinite(chi2_reduced):
        return Cell(DASH, ("too few data",), "unsure")
    if chi2_reduced > LARGEST_CHI2_REDUCED:
        return Cell(number(chi2_reduced, 1), ("does not fit",), "far")
    return Cell(number(chi2_reduced, 1), ("fits",), "near")


def area_tables(answer: Result, scene: Scene) -> tuple[Table, ...]:
    """Return equivalent absorption areas ``A = alpha S`` in m2, their sum, and the air's ``4 m V``.

    The interval of the sum is that of the mean absorption times the whole area. The air's part is
    the last term of the reverberation formula of ISO 354:2003, equation 6.
    """
    areas = answer.absorption * answer.areas_m2[:, None]
    walls = areas.sum(axis=0)
    air = 4.0 * attenuation_per_m(scene.air, answer.bands) * volume_m3(scene.room.mesh)
    bounds = answer.mean_absorption[1:] * float(np.sum(answer.areas_m2))
    return band_tables(
        "Equivalent absorption area A = \N{GREEK SMALL LETTER ALPHA}S in m²",
        "material",
        answer.bands.centres_hz,
        lambda block: (
            *_area_rows(answer, areas, block),
            _wall_row(answer, walls, bounds, block),
            _sum_row("air, 4mV", air, block, f"V = {area(volume_m3(scene.room.mesh))} m³"),
            _sum_row("total", walls + air, block, "surfaces and air", "total"),
        ),
        before=("S in m²",),
    )


def _area_rows(answer: Result, areas: FloatArray, block: IntArray) -> list[Row]:
    rows = []
    for i, name in enumerate(answer.materials):
        cells = [Cell(area(float(answer.areas_m2[i])), style="first")]
        for j in block:
            cell = _area_cell(float(areas[i, j]))
            if np.isfinite(areas[i, j]) and not answer.identifiable[i, j]:
                cell = Cell(f"({cell.text})", style="unsure")
            cells.append(cell)
        rows.append(Row(name, tuple(cells)))
    return rows


def _wall_row(answer: Result, walls: FloatArray, bounds: FloatArray, block: IntArray) -> Row:
    cells = []
    for j in block:
        known = bool(np.isfinite(bounds[:, j]).all())
        interval = f"{area(bounds[0, j])}{DASH}{area(bounds[1, j])}" if known else ""
        cells.append(_area_cell(float(walls[j]), interval))
    whole = Cell(area(float(np.sum(answer.areas_m2))), style="first")
    return Row("all surfaces", (whole, *cells), "95 % interval below", style="total")


def _sum_row(head: str, values: FloatArray, block: IntArray, small: str, style: str = "") -> Row:
    cells = tuple(_area_cell(float(values[j])) for j in block)
    return Row(head, (Cell("", style="first"), *cells), small, style=style)


def share_tables(answer: Result) -> tuple[Table, ...]:
    """Return what share of the room's absorption each material contributes, with its interval."""
    if answer.shares is None:
        return ()
    shares = answer.shares
    return band_tables(
        "Share of the surfaces' absorption in %, 95 % interval below",
        "material",
        answer.bands.centres_hz,
        lambda block: (
            Row(name, tuple(_share_cell(*shares[:, i, j]) for j in block))
            for i, name in enumerate(answer.materials)
        ),
    )


def prior_tables(answer: Result) -> tuple[Table, ...]:
    """Return the prior, in the order of `absorption_tables`."""
    if answer.prior is None:
        return ()
    prior, fixed = answer.prior, fixed_coefficients(answer)

    def cell(i: int, j: int) -> Cell:
        return coefficient_cell(*prior[:, i, j], sure=True, fixed=bool(fixed[i, j]))

    return band_tables(
        "Prior, specified or assumed, 95 % interval",
        "material",
        answer.bands.centres_hz,
        lambda block: (
            Row(name, tuple(cell(i, int(j)) for j in block))
            for i, name in enumerate(answer.materials)
        ),
    )


def _share_cell(value: float, lower: float, upper: float) -> Cell:
    texts = [number(100.0 * x, 0) for x in (value, lower, upper)]
    return Cell(texts[0], (f"{texts[1]}{DASH}{texts[2]}",))


def _area_cell(value_m2: float, interval: str = "") -> Cell:
    if not np.isfinite(value_m2):
        return Cell(DASH, ("not determined",), "unsure")
    return Cell(area(value_m2), (interval,) if interval else ())


_STATUS = {"certified": "proven", "stopped": "stopped early", "unresolved": "not resolved"}


def certificate_tables(answer: Result) -> tuple[Table, ...]:
    """Return one table with a row a band, or none where nothing was to be proven."""
    rows = []
    for band, proof in enumerate(answer.certificates):
        if proof is None:
            continue
        minimisers = [
            ", ".join(
                f"{name} {number(float(value), 2)}"
                for name, value in zip(proof.coordinates, cluster.minimiser, strict=True)
            )
            for cluster in proof.clusters
        ]
        rows.append(
            Row(
                hertz(float(answer.bands.centres_hz[band])),
                (
                    Cell(_STATUS[proof.status]),
                    Cell(number(proof.value, 3)),
                    Cell(number(proof.lower_bound, 3)),
                    Cell(str(len(minimisers)), tuple(minimisers)),
                    Cell(number(certificate_distance(answer, band), 3)),
                ),
            )
        )
    if not rows:
        return ()
    columns = ("status", "lowest cost found", "proven bound", "minima", "answer differs by")
    caption = (
        "How low the cost of the energies can be, their weights fixed, and in how many regions "
        "it comes within what other rays would change"
    )
    return (Table(caption, "band", columns, tuple(rows)),)


NEAR_JND, FAR_JND = 1.0, 2.0
"""Up to the first no difference is audible; above the second it is plain."""


def pair_title(pair: ComparedPair) -> str:
    """Return "LS1 to MP2", and whether the pair was kept out of the fit."""
    state = f", {pair.state}" if pair.state else ""
    use = "" if pair.use == "fit" else " (not fitted)"
    return f"{pair.source} to {pair.receiver}{state}{use}"


def parameter_keys(pairs: Iterable[ComparedPair]) -> tuple[str, ...]:
    """Return the parameters that any pair has a number for, in the order of ISO 3382-1."""
    found = {
        key
        for pair in pairs
        for key, c in pair.parameters.items()
        if np.isfinite(c.measured).any() or np.isfinite(c.predicted).any()
    }
    known = tuple(key for key in PARAMETERS if key in found)
    return (*known, *sorted(found - set(known)))


def baseline_jnd(key: str, compared: Compared) -> FloatArray:
    """Return the baseline's error in just noticeable differences, shape (n_bands,)."""
    if key not in PARAMETERS:
        return np.full(compared.measured.shape, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        return in_jnd(key, compared.measured, compared.null)


def mean_abs_jnd(pair: ComparedPair) -> float:
    """Return the mean |JND| over all parameters and bands that can be compared; NaN where none."""
    return known_mean(
        np.concatenate([np.zeros(0), *(abs(c.jnd) for c in pair.parameters.values())])
    )


def known_mean(values: FloatArray) -> float:
    """Return the mean of the finite values, NaN where there are none."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else float("nan")


def pair_sections(answer: Result) -> tuple[tuple[str, tuple[Table, ...]], ...]:
    """Return the title and the tables of every pair."""
    keys = parameter_keys(answer.pairs)
    return tuple((pair_title(pair), _pair_tables(answer, pair, keys)) for pair in answer.pairs)


def _pair_tables(answer: Result, pair: ComparedPair, keys: Sequence[str]) -> tuple[Table, ...]:
    return band_tables(
        f"{pair_title(pair)}: predicted minus measured in JND",
        "parameter",
        answer.bands.centres_hz,
        lambda block: (_parameter_row(pair, key, block) for key in keys),
    )


def _parameter_row(pair: ComparedPair, key: str, block: IntArray) -> Row:
    how = parameter(key)
    compared = pair.parameters.get(key)
    if compared is None:
        return Row(how.symbol, tuple(Cell(DASH, ("not given",), "missing") for _ in block))
    baseline = baseline_jnd(key, compared)
    cells = tuple(_jnd_cell(compared, float(baseline[j]), j, how.decimals) for j in block)
    return Row(how.symbol, cells, small=f"in {how.unit}" if how.unit else "")


def _jnd_cell(compared: Compared, baseline: float, band: int, decimals: int) -> Cell:
    measured, predicted = float(compared.measured[band]), float(compared.predicted[band])
    if not np.isfinite(measured):
        guess = [f"predicted {number(predicted, decimals)}"] if np.isfinite(predicted) else []
        return Cell(DASH, ("not measured", *guess), "missing")
    if not np.isfinite(predicted):
        text = number(measured, decimals)
        return Cell(DASH, ("not predicted", f"measured {text}"), "missing")
    values = f"{number(measured, decimals)} → {number(predicted, decimals)}"
    beside = f"others {number(baseline, 1, signed=True)}" if np.isfinite(baseline) else "no others"
    jnd = float(compared.jnd[band])
    return Cell(number(jnd, 1, signed=True), (values, beside), jnd_style(jnd))


def jnd_style(jnd: float) -> str:
    """Return the style sheet's name for how audible an error is."""
    if not np.isfinite(jnd):
        return "missing"
    size = abs(round(jnd, 1))
    return "near" if size <= NEAR_JND else "middle" if size <= FAR_JND else "far"


def overview_table(answer: Result) -> Table | None:
    """Return the mean |JND| over bands of every pair and parameter beside the baseline's."""
    keys = parameter_keys(answer.pairs)
    if not keys:
        return None
    return Table(
        "Mean size of the error over all bands in JND, beside that of the mean of the others",
        "pair",
        tuple(parameter(key).symbol for key in keys),
        tuple(
            Row(pair_title(pair), tuple(_overview_cell(pair, key) for key in keys))
            for pair in answer.pairs
        ),
    )


def _overview_cell(pair: ComparedPair, key: str) -> Cell:
    compared = pair.parameters.get(key)
    if compared is None:
        return Cell(DASH, ("not given",), "missing")
    ours, baseline = known_mean(abs(compared.jnd)), known_mean(abs(baseline_jnd(key, compared)))
    if not np.isfinite(ours):
        why = "not predicted" if np.isfinite(compared.measured).any() else "not measured"
        return Cell(DASH, (why,), "missing")
    beside = f"others {number(baseline, 1)}" if np.isfinite(baseline) else "no others"
    return Cell(number(ours, 1), (beside,), jnd_style(ours))


WORSE = "▲"


def errors_of(pairs: Sequence[ComparedPair], key: str) -> tuple[FloatArray, FloatArray]:
    """Return absolute errors of a parameter by the model and by the baseline.

    Percent or in its unit, each of shape (n_pairs, n_bands); NaN where one of the two cannot be
    compared. Where any baseline exists, the model has only what the baseline has as well, so that
    both are means over the same pairs.
    """
    compared = [pair.parameters[key] for pair in pairs if key in pair.parameters]
    measured = np.array([c.measured for c in compared])
    scale = np.where(measured == 0.0, np.nan, measured) / 100.0
    if parameter(key).error_unit != "%":
        scale = np.ones_like(measured)
    model = np.abs(np.array([c.predicted for c in compared]) - measured) / scale
    baseline = np.abs(np.array([c.null for c in compared]) - measured) / scale
    both = np.isfinite(model) & np.isfinite(baseline)
    if not both.any():
        return model, np.full_like(model, np.nan)
    return np.where(both, model, np.nan), np.where(both, baseline, np.nan)


def error_tables(answer: Result) -> tuple[Table, ...]:
    """Return mean |error| per parameter and band, model beside baseline, by use of the pairs."""
    uses: tuple[tuple[Use, str], ...] = (("validate", "not fitted"), ("fit", "fitted"))
    tables: list[Table] = []
    for use, words in uses:
        pairs = [pair for pair in answer.pairs if pair.use == use]
        if parameter_keys(pairs):
            tables += _tables(answer, pairs, f"Mean error over {count(len(pairs), 'pair')} {words}")
    return tuple(tables)


def sti_tables(answer: Result) -> tuple[Table, ...]:
    """Return the speech transmission index of every pair, where the bands give it."""
    measured, predicted, others = pair_sti(answer)
    known = np.isfinite(measured) & np.isfinite(predicted)
    if not known.any():
        return ()
    jnd, beside = in_jnd("STI", measured, predicted), in_jnd("STI", measured, others)
    rows = [
        Row(
            pair_title(pair),
            (
                Cell(number(measured[i], 2)),
                Cell(number(predicted[i], 2)),
                Cell(
                    number(jnd[i], 1, signed=True),
                    (f"others {number(beside[i], 1, signed=True)}",),
                    jnd_style(float(jnd[i])),
                ),
            ),
        )
        for i, pair in enumerate(answer.pairs)
        if known[i]
    ]
    caption = "Speech transmission index of the room alone: without noise, masking and threshold"
    return (Table(caption, "pair", ("measured", "predicted", "error in JND"), tuple(rows)),)


def _tables(answer: Result, pairs: Sequence[ComparedPair], caption: str) -> tuple[Table, ...]:
    keys = parameter_keys(pairs)
    found = {key: errors_of(pairs, key) for key in keys}
    every = list(range(len(answer.bands)))

    def rows(block: IntArray) -> Iterator[Row]:
        groups = [[int(j)] for j in block] + ([every] if block[-1] == every[-1] else [])
        for key in keys:
            cells = tuple(
                _cell(key, *(known_mean(errors[:, bands]) for errors in found[key]))
                for bands in groups
            )
            yield Row(parameter(key).symbol, cells, small=f"in {parameter(key).error_unit}")

    centres = answer.bands.centres_hz
    return band_tables(caption, "parameter", centres, rows, after=("all bands",))


def _cell(key: str, model: float, baseline: float) -> Cell:
    if not np.isfinite(model):
        return Cell(DASH, ("not comparable",), "missing")
    decimals = parameter(key).error_decimals
    text = number(model, decimals)
    if not np.isfinite(baseline):
        return Cell(text, ("no others",))
    if round(model, decimals) > round(baseline, decimals):
        return Cell(f"{WORSE} {text}", (f"others {number(baseline, decimals)}",), "worse")
    return Cell(text, (f"others {number(baseline, decimals)}",))


_SURFACES_SHOWN = 6


def material_table(room: Room) -> Table:
    """Return colour, area, share and surfaces of each material: the legend of the picture."""
    areas = material_areas_m2(room)
    whole = float(areas.sum())
    rows = [
        Row(
            name,
            (
                Cell(area(float(areas[i]))),
                Cell(f"{number(100.0 * areas[i] / whole, 1) if whole > 0.0 else DASH} %"),
                Cell(_surfaces(room, i), style="words"),
            ),
            colour=material_colour(i),
        )
        for i, name in enumerate(room.materials)
    ]
    total = Row("all", (Cell(area(whole)), Cell("100 %"), Cell("")), style="total")
    return Table("Materials", "material", ("area in m²", "share", "surfaces"), (*rows, total))


def _surfaces(room: Room, material: int) -> str:
    owners = [
        ("", room.surface_material),
        *((f"{s.name}: ", s.surface_material) for s in room.states),
    ]
    names = [
        state + room.mesh.surfaces[k].name
        for state, owner in owners
        for k in np.flatnonzero(owner == material)
        if not state or room.surface_material[k] != material
    ]
    shown = ", ".join(shortened(name) for name in names[:_SURFACES_SHOWN])
    more = len(names) - _SURFACES_SHOWN
    return f"{shown} and {more} more" if more > 0 else shown


def position_table(scene: Scene) -> Table:
    """Return the positions of sources and receivers, in metres."""
    points = [("source", p) for p in scene.sources] + [("receiver", p) for p in scene.receivers]
    return Table(
        "Positions in metres",
        "name",
        ("", "x", "y", "z"),
        tuple(
            Row(p.name, (Cell(kind, style="words"), *(Cell(number(v, 2)) for v in p.position_m)))
            for kind, p in points
        ),
    )


def source_tables(answer: Result) -> tuple[Table, ...]:
    """Return a table of every source whose directivity was fitted, none where none was."""
    return tuple(
        table
        for found in answer.directivities
        for table in band_tables(
            f"Directivity of {found.source}: amplitude "
            + (
                "by Legendre polynomials of the cosine of the angle to the aim"
                if _is_axial(found)
                else "1 + b cos of the angle to its axis"
            ),
            "b",
            answer.bands.centres_hz,
            partial(_rows, found),
        )
    )


def _is_axial(found: FittedDirectivity) -> bool:
    return any(aim is not None for aim in found.aims.values())


def _rows(found: FittedDirectivity, block: IntArray) -> tuple[Row, ...]:
    if _is_axial(found):
        index = tuple(Cell(number(axial_index_db(found.b[j]), 1)) for j in block)
        rows = [Row("directivity index, dB", index, f"{len(found.aims)} sources")]
        names: tuple[str, ...] = ("order 1", "order 2", "order 3")
    else:
        length = np.linalg.norm(found.b, axis=1)
        whole = tuple(Cell(number(float(length[j]), 2)) for j in block)
        rows = [Row("strength |b|", whole, "0 omnidirectional, 1 cardioid")]
        names = ("along x", "along y", "along z")
    for axis, name in enumerate(names):
        cells = tuple(
            Cell(
                number(float(found.b[j, axis]), 2, signed=True),
                (f"± {number(float(found.sd[j, axis]), 2)}",),
            )
            for j in block
        )
        rows.append(Row(name, cells, "± standard deviation"))
    return tuple(rows)
