"""The tables of an identification: absorption, areas, the fit, errors of predictions, the room."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from roomfit.base.air import attenuation_per_m
from roomfit.base.bands import OCTAVES_HZ
from roomfit.base.table import Cell, Table, Value
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.checks.verdict import what_remains
from roomfit.materials.ratings import (
    noise_reduction_coefficient,
    rated_bands,
    weighted_absorption,
)
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
from roomfit.result import Compared, ComparedPair, Result
from roomfit.room.mesh import volume_m3
from roomfit.room.scene import Room, Scene, material_areas_m2, wall_materials
from roomfit.signals.decay import in_jnd
from roomfit.signals.speech import sti_of_decay
from roomfit.uncertainty.gaussian import LARGEST_CHI2_REDUCED

_MOST_GROUPS = 2


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


def known_means(answer: Result) -> BoolArray:
    """Return in which bands the mean of the room is determined, and no finding takes it away."""
    found, known = what_remains(answer), [c[0].determined for c in answer.combinations]
    return np.asarray(found.mean_usable & known if found.voids else known, dtype=np.bool_)


def answer_table(answer: Result) -> Table:
    """Return the absorption that is known, in a line each: of the room, of groups, of materials.

    Of many bands the octaves. The last column is what was known before, in the middle band.
    """
    centres, fixed = answer.bands.centres_hz, fixed_coefficients(answer)
    shown = np.arange(len(centres))
    if len(centres) > BANDS_AT_MOST and np.isin(centres, OCTAVES_HZ).any():
        shown = np.flatnonzero(np.isin(centres, OCTAVES_HZ))
    mean = _brief(answer.mean_absorption, known_means(answer))
    rows: list[list[Value]] = [[Cell("mean of the room", style="total"), *mean, ""]]
    groups: dict[tuple[int, ...], FloatArray] = {}
    for band, combinations in enumerate(answer.combinations):
        for c in (c for c in combinations[1:] if c.determined):
            members = tuple(np.flatnonzero(c.weights).tolist())
            own = groups.setdefault(members, np.full((3, len(centres)), np.nan))
            own[:, band] = c.value, c.lower95, c.upper95
    for members in sorted(groups, key=lambda m: -np.isfinite(groups[m][0]).sum())[:_MOST_GROUPS]:
        names = " + ".join(answer.materials[i] for i in members)
        rows.append([names, *_brief(groups[members], missing=""), ""])
    values = np.stack([answer.absorption, answer.lower95, answer.upper95])
    middle = int(np.argmin(np.abs(np.log2(centres / 1000.0))))
    for i, name in enumerate(answer.materials):
        _, low, high = (coefficient(x, 1.0) for x in answer.prior[:, i, middle].tolist())
        before = Cell("given", style="given") if fixed[i, middle] else Cell(f"{low}{DASH}{high}")
        head = Cell(shortened(name), colour=material_colour(i))
        rows.append([head, *_brief(values[:, i], answer.identifiable[i], fixed[i]), before])
    heads = ("", *(hertz(float(centres[k])) for k in shown), f"before, {hertz(centres[middle])}")
    chosen = [[row[0], *(row[1 + k] for k in shown), row[-1]] for row in rows]
    notes = ("?: not determined by the data. Last: known before, 95 %. All bands: the report.",)
    return Table("What is known of the absorption, with its 95 % interval", heads, chosen, notes)


def _brief(
    values: FloatArray, sure: ArrayLike = True, fixed: ArrayLike = False, missing: str = "?"
) -> list[Cell]:
    """Return cells of values (3, n_bands) with the longer side of their intervals."""
    cells = []
    rest = np.broadcast_arrays(values[0], sure, fixed)[1:]
    for value, low, high, is_sure, given in zip(*values.tolist(), *rest, strict=True):
        text, side = coefficient(value, high), coefficient(max(value - low, high - value), high)
        if text == DASH:
            cells.append(Cell(missing, style="unsure"))
        elif given:
            cells.append(Cell(text, style="given"))
        else:
            cells.append(Cell(f"{text}±{side}") if is_sure else Cell(f"{text}?", style="unsure"))
    return cells


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


def _two(value: float, _: float) -> str:
    return number(value, 2)


def rating_tables(answer: Result) -> tuple[Table, ...]:
    """Return single-number ratings of each material, where all octaves that they need are known."""
    at = rated_bands(answer.bands)
    if not at:
        return ()

    def weighted(octaves: FloatArray) -> float:
        return weighted_absorption(octaves)[0]

    rows: list[Sequence[Value]] = []
    for i, name in enumerate(answer.materials):
        three = np.stack([answer.absorption, answer.lower95, answer.upper95])[:, i, at]
        rated = [[[f(x)] for x in three] for f in (weighted, noise_reduction_coefficient)]
        sure = bool(answer.identifiable[i, at].all())
        (first,), (second,) = (bounded_cells(np.array(x), sure, write=_two) for x in rated)
        rows.append((name, first, weighted_absorption(three[0])[1], second))
    caption = "Ratings of what was found in the room, which are no laboratory's"
    heads = ("material", "\N{GREEK SMALL LETTER ALPHA}w (ISO 11654)", "shape", "NRC (ASTM C423)")
    return (Table(caption, heads, rows),)


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


def pair_table(answer: Result) -> Table:
    """Return how far every parameter of every pair is off: the mean over bands, and the worst.

    In just noticeable differences; below, the band that is worst, with its values, and the mean
    error of the mean of the others.
    """
    keys = parameter_keys(answer.pairs)
    rows = [
        (pair_title(p), *(_jnd_cell(answer, key, p.parameters.get(key)) for key in keys))
        for p in answer.pairs
    ]
    heads = ("pair", *(parameter(key).symbol for key in keys))
    return Table("Predicted against measured, in JND: mean size over the bands", heads, rows)


def _jnd_cell(answer: Result, key: str, c: Compared | None) -> Cell:
    if c is None or not np.isfinite(c.jnd).any():
        given = c is not None and np.isfinite(c.measured).any()
        return Cell(DASH, ("not predicted" if given else "not measured",), "missing")
    how, worst = parameter(key), int(np.nanargmax(np.abs(c.jnd)))
    before, after = (number(float(x[worst]), how.decimals) for x in (c.measured, c.predicted))
    at = hertz(float(answer.bands.centres_hz[worst]))
    small = [f"{number(float(c.jnd[worst]), 1, signed=True)} at {at}", f"{before} → {after}"]
    if key in PARAMETERS:
        with np.errstate(divide="ignore", invalid="ignore"):
            others = known_mean(np.abs(in_jnd(key, c.measured, c.null)))
        small += [f"others {number(others, 1)}"] if np.isfinite(others) else []
    size = known_mean(np.abs(c.jnd))
    return Cell(number(size, 1), tuple(small), _audible(size))


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


def compared_pairs(pairs: Sequence[ComparedPair]) -> list[ComparedPair]:
    """Return the pairs kept for validation, all where none was."""
    return [pair for pair in pairs if pair.use == "validate"] or list(pairs)


def compared_words(answer: Result) -> str:
    """Return what `compared_pairs` are, in words."""
    kept = any(pair.use == "validate" for pair in answer.pairs)
    return "measurements that were not fitted" if kept else "the fitted measurements"


def mean_decay_times(
    pairs: Sequence[ComparedPair],
) -> tuple[str, FloatArray, FloatArray] | None:
    """Return symbol, measured and predicted mean decay time by band; None where none is known."""
    pairs = compared_pairs(pairs)
    known = parameter_keys(pairs)
    key = decay_time_key(known)
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
