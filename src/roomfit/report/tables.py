"""The tables of an identification: absorption, areas, the fit, errors of predictions, the room."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import groupby

import numpy as np
from numpy.typing import ArrayLike

from roomfit.base.air import attenuation_per_m
from roomfit.base.logit import Z95
from roomfit.base.table import Cell, Table, Value
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.checks.decay import DECAY_SCATTER
from roomfit.files.budget import SOURCES, Budget, contribution, share, uncertainty_budget
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
from roomfit.result import ComparedPair, Result
from roomfit.room.mesh import volume_m3
from roomfit.room.scene import Room, Scene, material_areas_m2, wall_materials
from roomfit.signals.decay import in_jnd
from roomfit.signals.speech import sti_of_decay
from roomfit.uncertainty.gaussian import LARGEST_CHI2_REDUCED


def fixed_coefficients(answer: Result) -> BoolArray:
    """Return which coefficients were fixed, shape (n_materials, n_bands)."""
    return np.asarray(answer.lower95 == answer.upper95)


def bounded_cells(
    values: FloatArray,
    sure: ArrayLike = True,
    fixed: ArrayLike = False,
    write: Callable[[float, float], str] = coefficient,
) -> list[Cell]:
    """Return cells of values and their 95 % bounds, shape (3, n_bands); doubts are in words.

    `write` gives the text of a value, by the upper bound. "?" and brackets mark what is not
    identifiable, "given" what was fixed.
    """
    rest = np.broadcast_arrays(values[0], sure, fixed)[1:]
    cells = []
    for value, lower, upper, is_sure, given in zip(*values.tolist(), *rest, strict=True):
        text, known = write(value, upper), bool(np.isfinite([lower, upper]).all())
        small = (f"{write(lower, upper)}{DASH}{write(upper, upper)}",) if known else ()
        if text == DASH:
            cells.append(Cell(DASH, ("not determined",), "unsure"))
        elif given:
            cells.append(Cell(text, ("given",), "given"))
        else:
            sure_cell = Cell(text, small)
            doubted = Cell(f"({text})", (*small, "not identif."), "unsure")
            cells.append(sure_cell if is_sure else doubted)
    return cells


def known_or(cell: Cell, reason: str, style: str = "missing") -> Cell:
    """Return a cell, with the reason below it where nothing is known."""
    return Cell(DASH, (reason,), style) if cell.text == DASH else cell


def absorption_tables(answer: Result) -> tuple[Table, ...]:
    """Return absorption with its 95 % interval, and that of the prior below; last the mean."""
    rows, fixed = [], fixed_coefficients(answer)
    values = np.stack([answer.absorption, answer.lower95, answer.upper95])
    for i, name in enumerate(answer.materials):
        head = Cell(name, (f"{area(float(answer.areas_m2[i]))} m²",), colour=material_colour(i))
        cells = bounded_cells(values[:, i], answer.identifiable[i], fixed[i])
        for j in np.flatnonzero(~fixed[i]):
            low, high = answer.prior[1:, i, j].tolist()
            before = f"before {coefficient(low, high)}{DASH}{coefficient(high, high)}"
            cells[j] = replace(cells[j], small=(*cells[j].small, before))
        rows.append((head, *cells))
    whole = f"by area, {area(float(np.sum(answer.areas_m2)))} m²"
    total = Cell("mean of the room", (whole,), "total")
    rows.append((total, *bounded_cells(answer.mean_absorption)))
    caption = f"Absorption coefficient, 95 % interval ({answer.interval_kind})"
    return band_tables(caption, "material", answer.bands.centres_hz, rows)


def _area_cells(values_m2: ArrayLike, sure: ArrayLike = True) -> list[Cell]:
    """Return cells of areas, or of areas and their bounds."""
    values = np.full((3, np.shape(values_m2)[-1]), np.nan)
    values[: np.atleast_2d(values_m2).shape[0]] = values_m2
    return bounded_cells(values, sure, values[1] == values[2], lambda value_m2, _: area(value_m2))


def object_tables(answer: Result) -> tuple[Table, ...]:
    """Return the equivalent absorption area of every object with its interval."""
    rows = _object_rows(answer)
    caption = "Equivalent absorption area of objects in m², 95 % interval"
    return band_tables(caption, "object", answer.bands.centres_hz, rows) if rows else ()


def _object_rows(answer: Result) -> list[list[Value]]:
    if (found := answer.objects) is None:
        return []
    values = np.stack([found.area_m2, found.lower95_m2, found.upper95_m2], axis=1)
    each = zip(found.names, values, found.identifiable, strict=True)
    return [[name, *_area_cells(own, sure)] for name, own, sure in each]


def area_tables(answer: Result, scene: Scene) -> tuple[Table, ...]:
    """Return equivalent absorption areas ``A = alpha S`` in m2, their sum, and the air's ``4 m V``.

    Below the area of a material its share of the surfaces' absorption, with the 95 % interval. The
    interval of the sum is that of the mean absorption times the whole area; the air's part is the
    last term of equation 6 of ISO 354:2003.
    """
    areas, whole = answer.absorption * answer.areas_m2[:, None], float(np.sum(answer.areas_m2))
    solid, volume = areas.sum(axis=0), volume_m3(scene.room.mesh)
    air = 4.0 * attenuation_per_m(scene.air, answer.bands) * volume
    nothing = Cell("", style="first")
    rows: list[Sequence[Value]] = []
    for i, name in enumerate(answer.materials):
        texts = [[number(100.0 * x, 0) for x in column] for column in answer.shares[:, i].T]
        cells = [
            replace(cell, small=(*cell.small, f"{value} % ({low}{DASH}{high})"))
            for cell, (value, low, high) in zip(
                _area_cells(areas[i], answer.identifiable[i]), texts, strict=True
            )
        ]
        rows.append((name, Cell(area(float(answer.areas_m2[i])), style="first"), *cells))
    sums = np.stack([solid, *(answer.mean_absorption[1:] * whole)])
    head = Cell("all surfaces", ("95 % interval below",), "total")
    rows.append((head, Cell(area(whole), style="first"), *_area_cells(sums)))
    words, found = "surfaces and air", answer.objects
    for object_name, *object_cells in _object_rows(answer):
        rows.append((Cell(str(object_name), ("object",)), nothing, *object_cells))
    if found is not None:
        words, solid = "with objects and air", solid + found.area_m2.sum(axis=0)
    rows.append((Cell("air, 4mV", (f"V = {area(volume)} m³",)), nothing, *_area_cells(air)))
    rows.append((Cell("total", (words,), "total"), nothing, *_area_cells(solid + air)))
    caption = (
        "Equivalent absorption area A = \N{GREEK SMALL LETTER ALPHA}S in m², and its share of the "
        "surfaces' absorption"
    )
    centres = answer.bands.centres_hz
    return band_tables(caption, "material", centres, rows, before=("S in m²",))


def fit_tables(answer: Result) -> tuple[Table, ...]:
    """Return how well the model fits each band, and whether the fit converged."""
    phi = []
    for chi2 in answer.chi2_reduced:
        words, style = ("does not fit", "far") if chi2 > LARGEST_CHI2_REDUCED else ("fits", "near")
        phi.append(known_or(Cell(number(chi2, 1), (words,), style), "too few data", "unsure"))
    converged = (Cell("yes") if c else Cell("no", style="far") for c in answer.converged)
    rows = [(Cell("φ", ("1: as expected",)), *phi), ("the fit converged", *converged)]
    caption = "How well the model explains the data"
    return band_tables(caption, "", answer.bands.centres_hz, rows)


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
    names = {name for one in block for name in one.variances}
    rows: dict[str | Cell, list[Value]] = {
        "absorption coefficient": [number(one.value, 3) for one in block]
    }
    for name in sorted(names, key=lambda n: ([*SOURCES, n].index(n), n)):
        variances = [one.variances.get(name, 0.0) for one in block]
        rows[Cell(name, (SOURCES[name],) if name in SOURCES else ())] = [
            Cell(number(contribution(v), 4), (f"{number(share(v, one), 0)} %",))
            for v, one in zip(variances, block, strict=True)
        ]
    rows[Cell("combined standard uncertainty", style="total")] = [
        number(one.standard, 4) for one in block
    ]
    rows[Cell("coverage factor", style="total")] = [f"{Z95:.2f}"] * len(block)
    rows[Cell("expanded uncertainty", style="total")] = [
        Cell(number(Z95 * one.standard, 3), (f"{one.lower95:.3f}{DASH}{one.upper95:.3f}",))
        for one in block
    ]
    rows[Cell("without the prior", style="total")] = [
        known_or(Cell(number(one.without_prior, 4)), "nothing would be known") for one in block
    ]
    return [(head, *cells) for head, cells in rows.items()]


def condition_tables(answer: Result) -> tuple[Table, ...]:
    """Return how well the fitted pairs of one state know the mean decay time.

    ISO 3382-2:2008, clause 7 and annex A, equations A.1 and A.2 with n = 10.
    """
    fitted = [p for p in answer.pairs if p.use == "fit"]
    fitted = [p for p in fitted if p.state == fitted[0].state]
    key = decay_time_key(name for p in fitted for name in p.parameters)
    if key is None:
        return ()
    symbol = parameter(key).symbol
    rows: list[list[Value]] = [
        [f"mean {symbol} in s"],
        [Cell("its standard deviation in %", ("ISO 3382-2, clause 7, n = 10",))],
        [Cell("the same in %", ("from the scatter of the pairs",))],
    ]
    measured_s = np.array([p.parameters[key].measured for p in fitted if key in p.parameters])
    widths_hz = answer.bands.upper_hz - answer.bands.lower_hz
    for width_hz, column_s in zip(widths_hz, measured_s.T, strict=True):
        times_s = column_s[np.isfinite(column_s)]
        n, mean_s = times_s.size, float(times_s.mean()) if times_s.size else np.nan
        theory = DECAY_SCATTER[key] / np.sqrt(n * width_hz * mean_s) if n else np.nan
        observed = times_s.std(ddof=1) / mean_s / np.sqrt(n) if n > 1 else np.nan
        cells = (
            (Cell(number(mean_s, 2), (count(n, "pair"),)), "not measured"),
            (Cell(number(100.0 * theory, 1)), "not measured"),
            (Cell(number(100.0 * observed, 1)), "one pair" if n else "not measured"),
        )
        for row, (cell, reason) in zip(rows, cells, strict=True):
            row.append(known_or(cell, reason))
    caption = f"Conditions of the measurement: how well the mean {symbol} is known"
    return band_tables(caption, "", answer.bands.centres_hz, rows)


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
    keys, found, centres = parameter_keys(answer.pairs), [], answer.bands.centres_hz
    for pair in answer.pairs:
        rows = []
        for key in keys:
            how, compared = parameter(key), pair.parameters.get(key)
            if compared is None:
                missing = [Cell(DASH, ("not given",), "missing")] * len(centres)
                rows.append((Cell(how.symbol), *missing))
                continue
            beside = np.full(len(centres), np.nan)
            if key in PARAMETERS:
                with np.errstate(divide="ignore", invalid="ignore"):
                    beside = in_jnd(key, compared.measured, compared.null)
            columns = (compared.measured, compared.predicted, compared.jnd, beside)
            cells = [_jnd_cell(how.decimals, *map(float, x)) for x in zip(*columns, strict=True)]
            rows.append((Cell(how.symbol, (f"in {how.unit}",) if how.unit else ()), *cells))
        title = pair_title(pair)
        caption = f"{title}: predicted minus measured in JND"
        found.append((title, band_tables(caption, "parameter", centres, rows)))
    return tuple(found)


def _jnd_cell(
    decimals: int, measured: float, predicted: float, jnd: float, baseline: float
) -> Cell:
    before, after = (number(x, decimals) for x in (measured, predicted))
    if before == DASH:
        guess = [] if after == DASH else [f"predicted {after}"]
        return Cell(DASH, ("not measured", *guess), "missing")
    if after == DASH:
        return Cell(DASH, ("not predicted", f"measured {before}"), "missing")
    beside = f"others {number(baseline, 1, signed=True)}" if np.isfinite(baseline) else "no others"
    return Cell(number(jnd, 1, signed=True), (f"{before} → {after}", beside), _audible(jnd))


def _audible(jnd: float) -> str:
    """Return the style sheet's name for how audible an error is."""
    if not np.isfinite(jnd):
        return "missing"
    size = abs(round(jnd, 1))
    return "near" if size <= 1.0 else "middle" if size <= 2.0 else "far"


def errors_of(pairs: Sequence[ComparedPair], key: str) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return absolute errors of a parameter by the model, the mean of others and a diffuse field.

    Percent or in its unit, each of shape (n_pairs, n_bands); NaN where one of the first two cannot
    be compared. Where any mean exists, the model has only what this has as well, so that both are
    means over the same pairs.
    """
    compared = [pair.parameters[key] for pair in pairs if key in pair.parameters]
    measured = np.array([c.measured for c in compared])
    scale = np.where(measured == 0.0, np.nan, measured) / 100.0
    if parameter(key).error_unit != "%":
        scale = np.ones_like(measured)
    unknown = np.full(measured.shape[1:], np.nan)
    model, baseline, diffuse = (
        np.abs(np.array(values) - measured) / scale
        for values in (
            [c.predicted for c in compared],
            [c.null for c in compared],
            [unknown if c.diffuse is None else c.diffuse for c in compared],
        )
    )
    both = np.isfinite(model) & np.isfinite(baseline)
    if not both.any():
        return model, np.full_like(model, np.nan), np.full_like(model, np.nan)
    first, second, third = (np.where(both, x, np.nan) for x in (model, baseline, diffuse))
    return first, second, third


def error_tables(answer: Result) -> tuple[Table, ...]:
    """Return mean |error| per parameter and band, model beside baseline, by use of the pairs."""
    tables: list[Table] = []
    for use, words in (("validate", "not fitted"), ("fit", "fitted")):
        pairs = [pair for pair in answer.pairs if pair.use == use]
        rows = []
        for key in parameter_keys(pairs):
            errors = errors_of(pairs, key)
            columns = [*zip(*(e.T for e in errors), strict=True), errors]
            head = Cell(parameter(key).symbol, (f"in {parameter(key).error_unit}",))
            cells = (_error_cell(key, *map(known_mean, own)) for own in columns)
            rows.append((head, *cells))
        if rows:
            caption = f"Mean error over {count(len(pairs), 'pair')} {words}"
            centres = answer.bands.centres_hz
            tables += band_tables(caption, "parameter", centres, rows, after=("all bands",))
    return tuple(tables)


def _error_cell(key: str, model: float, baseline: float, diffuse: float) -> Cell:
    decimals = parameter(key).error_decimals
    text = number(model, decimals)
    if not np.isfinite(baseline):
        return known_or(Cell(text, ("no others",)), "not comparable")
    beside = [f"others {number(baseline, decimals)}"]
    # of a decay time the theory takes the mean of others
    if np.isfinite(diffuse) and key not in ("T20_s", "T30_s"):
        beside.append(f"Barron {number(diffuse, decimals)}")
        baseline = min(baseline, diffuse)
    if round(model, decimals) > round(baseline, decimals):
        return Cell(f"▲ {text}", tuple(beside), "worse")
    return known_or(Cell(text, tuple(beside)), "not comparable")


def decay_time_tables(answer: Result) -> tuple[Table, ...]:
    """Return the mean decay time, measured and predicted, over the same pairs."""
    found = mean_decay_times(answer)
    if found is None:
        return ()
    symbol, *both = found
    rows = [
        (name, *(known_or(Cell(number(t, 2)), "not determined") for t in times_s))
        for name, times_s in zip(("measured", "predicted"), both, strict=True)
    ]
    caption = f"{symbol} in s, mean of {compared_words(answer)}"
    return band_tables(caption, "", answer.bands.centres_hz, rows)


def compared_pairs(answer: Result) -> list[ComparedPair]:
    """Return the pairs kept for validation, all where none was."""
    return [pair for pair in answer.pairs if pair.use == "validate"] or list(answer.pairs)


def compared_words(answer: Result) -> str:
    """Return what `compared_pairs` are, in words."""
    kept = any(pair.use == "validate" for pair in answer.pairs)
    return "measurements that were not fitted" if kept else "the fitted measurements"


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
    """Return the speech transmission index of every pair, where the bands give it.

    Of the room alone, from the decay curves, beside the mean of the others that were fitted in the
    same state.
    """
    found = []
    for pair in answer.pairs:
        if (decay := pair.decay) is not None:
            curves = (decay.measured_db, decay.predicted_db)
            both = [sti_of_decay(answer.bands, decay.time_s, levels) for levels in curves]
            if np.isfinite(both).all():
                found.append((pair, both))
    rows = []
    for pair, (measured, predicted) in found:
        fitted = [
            value
            for other, (value, _) in found
            if other is not pair and other.use == "fit" and other.state == pair.state
        ]
        others = np.mean(fitted) if fitted else np.nan
        own, steps = (in_jnd("STI", np.array(measured), np.array(x)) for x in (predicted, others))
        small = (f"others {number(float(steps), 1, signed=True)}",)
        error = Cell(number(float(own), 1, signed=True), small, _audible(float(own)))
        rows.append((pair_title(pair), measured, predicted, error))
    caption = "Speech transmission index of the room alone: without noise, masking and threshold"
    columns = ("pair", "measured", "predicted", "error in JND")
    return (Table(caption, columns, rows, form=".2f"),) if rows else ()


_SURFACES_SHOWN = 6


def material_table(room: Room) -> Table:
    """Return colour, area, share and surfaces of each material: the legend of the picture."""
    areas = material_areas_m2(room)
    whole = float(areas.sum())
    owners = [("", room.surface_material)]
    owners += [(f"{s.name}: ", s.surface_material) for s in room.states]
    rows: list[Sequence[Value]] = []
    for i, name in enumerate(wall_materials(room)):
        names = [
            state + room.mesh.surfaces[k].name
            for state, owner in owners
            for k in np.flatnonzero(owner == i)
            if not state or room.surface_material[k] != i
        ]
        shown = ", ".join(shortened(name) for name in names[:_SURFACES_SHOWN])
        more = len(names) - _SURFACES_SHOWN
        words = Cell(f"{shown} and {more} more" if more > 0 else shown, style="words")
        share = f"{number(100.0 * areas[i] / whole, 1) if whole > 0.0 else DASH} %"
        rows.append((Cell(name, colour=material_colour(i)), area(float(areas[i])), share, words))
    rows.append((Cell("all", style="total"), area(whole), "100 %", ""))
    heads = ("material", "area in m²", "share", "surfaces")
    return Table("Materials", heads, rows, kind="last-words")


def position_table(scene: Scene) -> Table:
    """Return the positions of sources and receivers, in metres."""
    points = [("source", p) for p in scene.sources] + [("receiver", p) for p in scene.receivers]
    rows = [(p.name, Cell(kind, style="words"), *p.position_m) for kind, p in points]
    return Table("Positions in metres", ("name", "", "x", "y", "z"), rows, form=".2f")


def source_tables(answer: Result) -> tuple[Table, ...]:
    """Return a table of every source whose directivity was fitted, none where none was."""
    tables: list[Table] = []
    for found in answer.directivities:
        words, names = "1 + b cos of the angle to its axis", ("along x", "along y", "along z")
        head = Cell("strength |b|", ("0 omnidirectional, 1 cardioid",))
        first = [number(float(length), 2) for length in np.linalg.norm(found.b, axis=1)]
        if any(aim is not None for aim in found.aims.values()):
            words = "by Legendre polynomials of the cosine of the angle to the aim"
            names = ("order 1", "order 2", "order 3")
            head = Cell("directivity index, dB", (f"{len(found.aims)} sources",))
            first = [number(axial_index_db(b), 1) for b in found.b]
        rows = [(head, *map(Cell, first))]
        for name, values, sds in zip(names, found.b.T, found.sd.T, strict=True):
            cells = (
                Cell(number(float(b), 2, signed=True), (f"± {number(float(sd), 2)}",))
                for b, sd in zip(values, sds, strict=True)
            )
            rows.append((Cell(name, ("± standard deviation",)), *cells))
        caption = f"Directivity of {found.source}: amplitude {words}"
        tables += band_tables(caption, "b", answer.bands.centres_hz, rows)
    return tuple(tables)
