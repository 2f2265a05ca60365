"""The tables of an identification: absorption, areas, the fit, errors of predictions, the room."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby

import numpy as np
from numpy.typing import ArrayLike

from roomfit.base.air import attenuation_per_m
from roomfit.base.logit import Z95
from roomfit.base.table import Cell, Table, Value
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.checks.decay import DECAY_SCATTER
from roomfit.files.budget import SOURCES, Budget, contribution, share, uncertainty_budget
from roomfit.model.directivity import FittedDirectivity
from roomfit.model.patterns import axial_index_db
from roomfit.report.wording import (
    BANDS_AT_MOST,
    DASH,
    PARAMETERS,
    area,
    band_tables,
    coefficient,
    count,
    decay_time_key,
    hertz,
    material_colour,
    number,
    parameter,
    shortened,
)
from roomfit.result import Compared, ComparedPair, Result, Use
from roomfit.room.mesh import volume_m3
from roomfit.room.scene import Room, Scene, material_areas_m2, wall_materials
from roomfit.signals.decay import in_jnd
from roomfit.signals.speech import sti_of_decay
from roomfit.uncertainty.gaussian import LARGEST_CHI2_REDUCED

NOT_IDENTIFIABLE = "not identif."


def fixed_coefficients(answer: Result) -> BoolArray:
    """Return which coefficients were fixed, shape (n_materials, n_bands)."""
    return np.asarray(answer.lower95 == answer.upper95)


def absorption_tables(answer: Result) -> tuple[Table, ...]:
    """Return absorption with its 95 % interval, materials in rows, with the mean of the room.

    "?" and brackets mark what is not identifiable, "given" what was fixed.
    """
    rows, fixed = [], fixed_coefficients(answer)
    values = np.stack([answer.absorption, answer.lower95, answer.upper95])
    for i, name in enumerate(answer.materials):
        head = Cell(name, (f"{area(float(answer.areas_m2[i]))} m²",), colour=material_colour(i))
        rows.append((head, *coefficient_cells(values[:, i], answer.identifiable[i], fixed[i])))
    whole = f"by area, {area(float(np.sum(answer.areas_m2)))} m²"
    total = Cell("mean of the room", (whole,), "total")
    rows.append((total, *coefficient_cells(answer.mean_absorption)))
    caption = f"Absorption coefficient, 95 % interval ({answer.interval_kind})"
    return band_tables(caption, "material", answer.bands.centres_hz, rows)


def object_tables(answer: Result) -> tuple[Table, ...]:
    """Return the equivalent absorption area of every object with its interval."""
    if (found := answer.objects) is None:
        return ()
    rows = []
    for i, name in enumerate(found.names):
        columns = zip(
            found.area_m2[i], found.lower95_m2[i], found.upper95_m2[i], found.identifiable[i],
            strict=True,
        )  # fmt: skip
        cells = []
        for value, low, high, sure in columns:
            cell = _area_cell(value, low, high)
            if high <= low:
                cell = Cell(cell.text, ("given",), "given")
            elif not sure:
                cell = Cell(f"({cell.text})", (*cell.small, NOT_IDENTIFIABLE), "unsure")
            cells.append(cell)
        rows.append((Cell(name), *cells))
    caption = "Equivalent absorption area of objects in m², 95 % interval"
    return band_tables(caption, "object", answer.bands.centres_hz, rows)


def coefficient_cells(
    values: FloatArray, sure: ArrayLike = True, fixed: ArrayLike = False
) -> list[Cell]:
    """Return cells of coefficients and their bounds, shape (3, n_bands)."""
    rest = np.broadcast_arrays(values[0], sure, fixed)[1:]
    columns = zip(*values.tolist(), *(x.tolist() for x in rest), strict=True)
    return [coefficient_cell(*x, sure=is_sure, fixed=given) for *x, is_sure, given in columns]


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
    converged = (Cell("yes") if c else Cell("no", style="far") for c in answer.converged)
    rows = [
        (Cell("φ", ("1: as expected",)), *map(_chi2_cell, answer.chi2_reduced)),
        ("the fit converged", *converged),
    ]
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

    The interval of the sum is that of the mean absorption times the whole area; the air's part is
    the last term of equation 6 of ISO 354:2003.
    """
    areas = answer.absorption * answer.areas_m2[:, None]
    solid, volume_ = areas.sum(axis=0), volume_m3(scene.room.mesh)
    air = 4.0 * attenuation_per_m(scene.air, answer.bands) * volume_
    whole = float(np.sum(answer.areas_m2))
    rows: list[Sequence[Value]] = []
    for i, name in enumerate(answer.materials):
        cells = map(_doubted_area, areas[i], answer.identifiable[i])
        rows.append((name, Cell(area(float(answer.areas_m2[i])), style="first"), *cells))
    all_walls = map(_area_cell, solid, *(answer.mean_absorption[1:] * whole))
    head = Cell("all surfaces", ("95 % interval below",), "total")
    rows.append((head, Cell(area(whole), style="first"), *all_walls))
    nothing = Cell("", style="first")
    if (found := answer.objects) is not None:
        for i, name in enumerate(found.names):
            bounds = found.area_m2[i], found.lower95_m2[i], found.upper95_m2[i]
            rows.append((Cell(name, ("object",)), nothing, *map(_area_cell, *bounds)))
        solid = solid + found.area_m2.sum(axis=0)
    volume = f"V = {area(volume_)} m³"
    rows.append((Cell("air, 4mV", (volume,)), nothing, *map(_area_cell, air)))
    total = Cell(
        "total", ("surfaces and air" if found is None else "with objects and air",), "total"
    )
    rows.append((total, nothing, *map(_area_cell, solid + air)))
    caption = "Equivalent absorption area A = \N{GREEK SMALL LETTER ALPHA}S in m²"
    centres = answer.bands.centres_hz
    return band_tables(caption, "material", centres, rows, before=("S in m²",))


def _area_cell(value_m2: float, low_m2: float = np.nan, high_m2: float = np.nan) -> Cell:
    if not np.isfinite(value_m2):
        return Cell(DASH, ("not determined",), "unsure")
    known = np.isfinite(low_m2) and np.isfinite(high_m2)
    return Cell(area(value_m2), (f"{area(low_m2)}{DASH}{area(high_m2)}",) if known else ())


def _doubted_area(value_m2: float, identifiable: bool) -> Cell:
    cell = _area_cell(value_m2)
    if identifiable or not np.isfinite(value_m2):
        return cell
    return Cell(f"({cell.text})", style="unsure")


def share_tables(answer: Result) -> tuple[Table, ...]:
    """Return what share of the room's absorption each material contributes, with its interval."""
    if answer.shares is None:
        return ()
    rows = []
    for i, name in enumerate(answer.materials):
        texts = ([number(100.0 * x, 0) for x in column] for column in answer.shares[:, i].T)
        rows.append((name, *(Cell(value, (f"{low}{DASH}{high}",)) for value, low, high in texts)))
    caption = "Share of the surfaces' absorption in %, 95 % interval below"
    return band_tables(caption, "material", answer.bands.centres_hz, rows)


def prior_tables(answer: Result) -> tuple[Table, ...]:
    """Return the prior, in the order of `absorption_tables`."""
    if answer.prior is None:
        return ()
    fixed = fixed_coefficients(answer)
    rows = [
        (name, *coefficient_cells(answer.prior[:, i], fixed=fixed[i]))
        for i, name in enumerate(answer.materials)
    ]
    caption = "Prior, specified or assumed, 95 % interval"
    return band_tables(caption, "material", answer.bands.centres_hz, rows)


def budget_tables(answer: Result) -> tuple[Table, ...]:
    """Return the uncertainty budget at 500 and 1000 Hz, a row a source, none without its terms.

    In each cell a standard uncertainty in absorption, and its share of the combined variance.
    """
    tables: list[Table] = []
    found = uncertainty_budget(answer) if any(answer.costs) else ()
    for centre_hz, of_band in groupby(found, key=lambda one: one.band_hz):
        own = list(of_band)
        for first in range(0, len(own), BANDS_AT_MOST):
            block = own[first : first + BANDS_AT_MOST]
            more = f", {block[0].quantity} to {block[-1].quantity}" if len(block) < len(own) else ""
            caption = f"Uncertainty budget of the absorption at {hertz(centre_hz)}{more}"
            heads = ("source", *(one.quantity for one in block))
            tables.append(Table(caption, heads, _budget_rows(block)))
    return tuple(tables)


def _budget_rows(block: Sequence[Budget]) -> list[Sequence[Value]]:
    def cell(one: Budget, name: str) -> Cell:
        variance = one.variances.get(name, 0.0)
        small = f"{number(share(variance, one), 0)} %"
        return Cell(number(contribution(variance), 4), (small,))

    names = list(dict.fromkeys(name for one in block for name in one.variances))
    rows: list[Sequence[Value]] = [
        ("absorption coefficient", *(number(one.value, 3) for one in block))
    ]
    for name in sorted(names, key=lambda n: [*SOURCES, n].index(n)):
        words = (SOURCES[name],) if name in SOURCES else ()
        rows.append((Cell(name, words), *(cell(one, name) for one in block)))
    sums: dict[str, list[Value]] = {
        "combined standard uncertainty": [number(one.standard, 4) for one in block],
        "coverage factor": [f"{Z95:.2f}"] * len(block),
        "expanded uncertainty": [
            Cell(number(Z95 * one.standard, 3), (f"{one.lower95:.3f}{DASH}{one.upper95:.3f}",))
            for one in block
        ],
        "without the prior": [
            _known_or(Cell(number(one.without_prior, 4)), "nothing would be known") for one in block
        ],
    }
    rows += [(Cell(name, style="total"), *cells) for name, cells in sums.items()]
    return rows


def condition_tables(answer: Result) -> tuple[Table, ...]:
    """Return how well the fitted pairs of one state know the mean decay time.

    ISO 3382-2:2008, clause 7 and annex A, equations A.1 and A.2 with n = 10.
    """
    fitted = [p for p in answer.pairs if p.use == "fit"]
    fitted = [p for p in fitted if p.state == fitted[0].state]
    key = decay_time_key(name for p in fitted for name in p.parameters)
    if key is None:
        return ()
    rows_s = np.array([p.parameters[key].measured for p in fitted if key in p.parameters])
    cells: list[list[Value]] = [[], [], []]
    for width_hz, measured_s in zip(
        answer.bands.upper_hz - answer.bands.lower_hz, rows_s.T, strict=True
    ):
        times_s = measured_s[np.isfinite(measured_s)]
        n, mean_s = times_s.size, float(times_s.mean()) if times_s.size else np.nan
        theory = DECAY_SCATTER[key] / np.sqrt(n * width_hz * mean_s) if n else np.nan
        observed = times_s.std(ddof=1) / mean_s / np.sqrt(n) if n > 1 else np.nan
        cells[0].append(_known_or(Cell(number(mean_s, 2), (count(n, "pair"),)), "not measured"))
        cells[1].append(_known_or(Cell(number(100.0 * theory, 1)), "not measured"))
        cells[2].append(
            _known_or(Cell(number(100.0 * observed, 1)), "one pair" if n else "not measured")
        )
    symbol = parameter(key).symbol
    rows = [
        (f"mean {symbol} in s", *cells[0]),
        (Cell("its standard deviation in %", ("ISO 3382-2, clause 7, n = 10",)), *cells[1]),
        (Cell("the same in %", ("from the scatter of the pairs",)), *cells[2]),
    ]
    caption = f"Conditions of the measurement: how well the mean {symbol} is known"
    return band_tables(caption, "", answer.bands.centres_hz, rows)


def _known_or(cell: Cell, reason: str) -> Cell:
    """Return a cell, with the reason below it where nothing is known."""
    return Cell(DASH, (reason,), "missing") if cell.text == DASH else cell


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
    keys, found = parameter_keys(answer.pairs), []
    for pair in answer.pairs:
        title = pair_title(pair)
        caption, rows = f"{title}: predicted minus measured in JND", []
        for key in keys:
            rows.append(_parameter_row(pair, key, len(answer.bands)))
        found.append((title, band_tables(caption, "parameter", answer.bands.centres_hz, rows)))
    return tuple(found)


def _parameter_row(pair: ComparedPair, key: str, n_bands: int) -> tuple[Cell, ...]:
    how, compared = parameter(key), pair.parameters.get(key)
    if compared is None:
        return (Cell(how.symbol), *[Cell(DASH, ("not given",), "missing")] * n_bands)
    baseline = baseline_jnd(key, compared)
    cells = (_jnd_cell(compared, float(baseline[j]), j, how.decimals) for j in range(n_bands))
    return (Cell(how.symbol, (f"in {how.unit}",) if how.unit else ()), *cells)


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
        ("pair", *(parameter(key).symbol for key in keys)),
        [(pair_title(pair), *(_overview_cell(pair, key) for key in keys)) for pair in answer.pairs],
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
        if keys := parameter_keys(pairs):
            caption = f"Mean error over {count(len(pairs), 'pair')} {words}"
            centres, rows = answer.bands.centres_hz, [_error_row(pairs, k) for k in keys]
            tables += band_tables(caption, "parameter", centres, rows, after=("all bands",))
    return tuple(tables)


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


def _seconds(time_s: float) -> Cell:
    text = number(time_s, 2)
    return Cell(text, ("not determined",), "missing") if text == DASH else Cell(text)


def decay_time_tables(answer: Result) -> tuple[Table, ...]:
    """Return the mean decay time of `shown_decay`, measured and predicted, over the same pairs."""
    found = mean_decay_times(answer)
    if found is None:
        return ()
    symbol, measured, predicted = found
    rows = [
        (name, *(_seconds(float(t)) for t in times_s))
        for name, times_s in (("measured", measured), ("predicted", predicted))
    ]
    caption = f"{symbol} in s, mean of the {compared_words(answer)}"
    return band_tables(caption, "", answer.bands.centres_hz, rows)


def compared_pairs(answer: Result) -> list[ComparedPair]:
    """Return the pairs kept for validation, all where none was."""
    return [pair for pair in answer.pairs if pair.use == "validate"] or list(answer.pairs)


def compared_words(answer: Result) -> str:
    """Return what `compared_pairs` are, in words."""
    kept = any(pair.use == "validate" for pair in answer.pairs)
    return "measurements that were not fitted" if kept else "fitted measurements"


def mean_decay_times(answer: Result) -> tuple[str, FloatArray, FloatArray] | None:
    """Return symbol, measured and predicted mean decay time by band; None where none is known."""
    pairs = compared_pairs(answer)
    known = parameter_keys(pairs)
    key = "T30_s" if "T30_s" in known else decay_time_key(known)
    if key is None:
        return None
    own = [p.parameters[key] for p in pairs if key in p.parameters]
    both = np.array([(c.measured, c.predicted) for c in own])
    # only where both are known, so that means are over the same pairs
    both = np.where(np.isfinite(both).all(axis=1, keepdims=True), both, np.nan)
    n_known = np.isfinite(both).sum(axis=0)
    if not n_known.any():
        return None
    with np.errstate(invalid="ignore", divide="ignore"):
        measured, predicted = np.where(n_known > 0, np.nansum(both, axis=0) / n_known, np.nan)
    return parameter(key).symbol, measured, predicted


def sti_tables(answer: Result) -> tuple[Table, ...]:
    """Return the speech transmission index of every pair, where the bands give it."""
    measured, predicted, others = pair_sti(answer)
    known = np.isfinite(measured) & np.isfinite(predicted)
    if not known.any():
        return ()
    jnd, beside = in_jnd("STI", measured, predicted), in_jnd("STI", measured, others)
    rows = []
    for i in np.flatnonzero(known):
        small = (f"others {number(beside[i], 1, signed=True)}",)
        error = Cell(number(jnd[i], 1, signed=True), small, jnd_style(float(jnd[i])))
        rows.append((pair_title(answer.pairs[i]), measured[i], predicted[i], error))
    caption = "Speech transmission index of the room alone: without noise, masking and threshold"
    columns = ("pair", "measured", "predicted", "error in JND")
    return (Table(caption, columns, rows, form=".2f"),)


def _error_row(pairs: Sequence[ComparedPair], key: str) -> tuple[Cell, ...]:
    """Return the mean errors of a parameter in each band, and over all of them."""
    model, baseline = errors_of(pairs, key)
    every = np.arange(model.shape[1])
    bands = (*every[:, None], every)
    cells = (_cell(key, known_mean(model[:, j]), known_mean(baseline[:, j])) for j in bands)
    return (Cell(parameter(key).symbol, (f"in {parameter(key).error_unit}",)), *cells)


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
    rows: list[Sequence[Value]] = []
    for i, name in enumerate(wall_materials(room)):
        share = f"{number(100.0 * areas[i] / whole, 1) if whole > 0.0 else DASH} %"
        surfaces = Cell(_surfaces(room, i), style="words")
        rows.append((Cell(name, colour=material_colour(i)), area(float(areas[i])), share, surfaces))
    rows.append((Cell("all", style="total"), area(whole), "100 %", ""))
    heads = ("material", "area in m²", "share", "surfaces")
    return Table("Materials", heads, rows, kind="last-words")


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


def digest_table(digests: Mapping[str, str]) -> Table:
    """Return the SHA-256 of every input."""
    rows = [(name, Cell(digest, style="words")) for name, digest in digests.items()]
    return Table("SHA-256 of the inputs", ("file", "digest"), rows)


def position_table(scene: Scene) -> Table:
    """Return the positions of sources and receivers, in metres."""
    points = [("source", p) for p in scene.sources] + [("receiver", p) for p in scene.receivers]
    rows = [(p.name, Cell(kind, style="words"), *p.position_m) for kind, p in points]
    return Table("Positions in metres", ("name", "", "x", "y", "z"), rows, form=".2f")


def offset_terms(answer: Result) -> tuple[tuple[str, str], ...]:
    """Return where groups of positions and lengths were found by early reflections, in words."""
    found = answer.geometry
    if found is None:
        return ()
    return tuple(
        (
            found.labels[i],
            f"{found.change[i]:+.3f} ± {found.sd[i]:.3f} m "
            f"(specified within {found.prior_sd[i]:.3f} m)",
        )
        for i in range(len(found.labels) - found.n_offsets, len(found.labels))
    )


def source_tables(answer: Result) -> tuple[Table, ...]:
    """Return a table of every source whose directivity was fitted, none where none was."""
    tables: list[Table] = []
    for found in answer.directivities:
        axial = any(aim is not None for aim in found.aims.values())
        words = (
            "by Legendre polynomials of the cosine of the angle to the aim"
            if axial
            else "1 + b cos of the angle to its axis"
        )
        caption = f"Directivity of {found.source}: amplitude {words}"
        rows = _directivity_rows(found, axial=axial)
        tables += band_tables(caption, "b", answer.bands.centres_hz, rows)
    return tuple(tables)


def _directivity_rows(found: FittedDirectivity, *, axial: bool) -> list[tuple[Cell, ...]]:
    if axial:
        first = [number(axial_index_db(b), 1) for b in found.b]
        head = Cell("directivity index, dB", (f"{len(found.aims)} sources",))
        names = ("order 1", "order 2", "order 3")
    else:
        first = [number(float(length), 2) for length in np.linalg.norm(found.b, axis=1)]
        head = Cell("strength |b|", ("0 omnidirectional, 1 cardioid",))
        names = ("along x", "along y", "along z")
    rows = [(head, *map(Cell, first))]
    for name, values, sds in zip(names, found.b.T, found.sd.T, strict=True):
        cells = (
            Cell(number(float(b), 2, signed=True), (f"± {number(float(sd), 2)}",))
            for b, sd in zip(values, sds, strict=True)
        )
        rows.append((Cell(name, ("± standard deviation",)), *cells))
    return rows
