"""What may be hung where, and what is to be reached by it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from roomfit.base.arguments import check_known
from roomfit.base.bands import Bands
from roomfit.base.errors import InputError
from roomfit.base.typing import BoolArray, FloatArray, IntArray
from roomfit.materials.catalogue import band_correlation
from roomfit.predict.changes import product_draws
from roomfit.predict.diffuse import NAME, PreparedField
from roomfit.predict.predict import ChangingRoom
from roomfit.room.scene import Scene, material_areas_m2, pair_states
from roomfit.signals.decay import FIT_RANGES_DB
from roomfit.signals.iso3382 import VALUE_NAMES, ValueName
from roomfit.signals.speech import speech_bands, sti_missing

# The speech transmission index is one number of all octaves from 125 Hz to 8 kHz.
TargetName = Literal[ValueName, "STI"]
TARGET_NAMES: tuple[TargetName, ...] = (*VALUE_NAMES, "STI")


def target_name(name: str) -> TargetName:
    """Return the name of a parameter that may be a target."""
    check_known("a target names an unknown parameter", name, TARGET_NAMES)
    return next(known for known in TARGET_NAMES if known == name)


@dataclass(frozen=True, slots=True)
class Surface:
    """A material of the room that may be covered."""

    material: str
    free_m2: float | None = None  # left out: its whole area
    forbidden_m2: float = 0.0  # of the free area: doors, lamps, what must stay as it is
    depth_m: float = np.inf  # room for a product
    products: tuple[str, ...] = ()  # which may hang there; none: all that are not too deep


@dataclass(frozen=True, slots=True, eq=False)
class Product:
    """What may be hung: its absorption covers that of the surface."""

    name: str
    absorption: FloatArray  # (n_bands,), 0 to 1
    sd: FloatArray  # (n_bands,)
    cost_per_m2: float = 1.0
    piece_m2: float = 1.0
    depth_m: float = 0.0
    # a material of the room, whose absorption it is with all that is known of it, or its entry of
    # the catalogue; "": neither
    entry: str = ""


@dataclass(frozen=True, slots=True)
class Target:
    """Limits of one room parameter, mean over all pairs, in some bands.

    `parameter` is any that `roomfit.predict` names, or STI, which has no bands of its own; infinite
    limits are none.
    """

    parameter: TargetName
    low: float = -np.inf
    high: float = np.inf
    bands_hz: tuple[float, ...] = ()  # none: 500, 1000 and 2000 Hz
    mean_of_bands: bool = False
    source: str = ""  # standard, edition and clause

    def __post_init__(self) -> None:
        target_name(self.parameter)
        if self.parameter == "STI" and self.bands_hz:
            raise InputError(
                "a target of the speech transmission index is in bands",
                found=f"{', '.join(f'{f:g}' for f in self.bands_hz)} Hz",
                needed="no bands: it is of all octaves from 125 Hz to 8 kHz together",
                hint="leave bands_hz out",
            )
        if not self.low <= self.high or not np.isfinite([self.low, self.high]).any():
            raise InputError(
                "a target has no limits that can be met",
                where=self.parameter,
                found=f"from {self.low:g} to {self.high:g}",
                needed="at_most, at_least, or a value with a tolerance",
                hint="write at_most = 0.6, say, or value and tolerance",
            )

    def __str__(self) -> str:
        """Return the target in a line."""
        limits = f"{self.low:.3g} to {self.high:.3g}"
        if not np.isfinite(self.low):
            limits = f"at most {self.high:.3g}"
        elif not np.isfinite(self.high):
            limits = f"at least {self.low:.3g}"
        source = f", {self.source}" if self.source else ""
        if self.parameter == "STI":
            return f"STI {limits}{source}"
        symbol, _, unit = self.parameter.partition("_")
        bands = ", ".join(f"{f:g}" for f in self.bands_hz or USUAL_HZ)
        way = "mean of " if self.mean_of_bands else ""
        unit = {"percent": "%"}.get(unit, unit)
        return f"{symbol} {limits} {unit} ({way}{bands} Hz){source}"


USUAL_HZ = (500.0, 1000.0, 2000.0)


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """A prepared room, and the columns and rows of what is asked of it."""

    room: ChangingRoom
    products: tuple[Product, ...]
    targets: tuple[Target, ...]
    # of each column, a product on a surface; (n_columns,) each
    surface: IntArray  # material of the room
    product: IntArray
    piece_m2: FloatArray
    most: FloatArray  # pieces that fit the surface alone
    cost: FloatArray  # of a piece
    areas_m2: FloatArray  # (n_materials,)
    free_m2: Mapping[int, float]  # by material
    # of each row, a target in a band or in the mean of its bands; (n_rows,) each
    target: IntArray
    low: FloatArray  # limits
    high: FloatArray
    is_time: BoolArray  # whether it is a decay time, whose inverse is linear in absorption
    scale: FloatArray  # what misses are measured by: of a time its limit, else 20 JND
    weights: FloatArray  # (n_rows, n_bands)
    drawn: FloatArray  # (n_draws, n_products, n_bands)


_SCALES = {"D50_percent": 100.0, "TS_ms": 200.0, "STI": 0.6}


def problem_of(
    room: ChangingRoom,
    surfaces: Sequence[Surface],
    products: Sequence[Product],
    targets: Sequence[Target],
) -> Problem:
    """Return what is asked of a room, checked."""
    others = [t for t in targets if t.parameter != NAME]
    if isinstance(room, PreparedField) and others:
        raise InputError(
            "a target is of a parameter that decay times alone do not determine",
            where=str(others[0]),
            found="decay times alone",
            needed="T30_s, or sources and receivers with their positions and a result of identify",
            hint="set T30_s as the target, or identify the room first",
        )
    if not targets:
        hint = "add [[targets]] to treatment.toml"
        raise InputError("no target is given", found="none", needed="one target or more", hint=hint)
    columns, free = columns_of(room.scene, surfaces, products)
    surface, product, most = (np.array(x) for x in zip(*columns, strict=True))
    piece = np.array([p.piece_m2 for p in products])[product]
    rows = [row_weights(target, room.absorption.bands) for target in targets]
    of_row = np.repeat(np.arange(len(targets)), [len(weights) for weights in rows])
    own = [targets[t] for t in of_row.tolist()]
    low, high = np.array([(t.low, t.high) for t in own]).T
    names = [t.parameter for t in own]
    is_time = np.array([name in FIT_RANGES_DB for name in names])
    limit = np.abs(np.where(np.isfinite(high), high, low))
    return Problem(
        room,
        tuple(products),
        tuple(targets),
        surface,
        product,
        piece,
        most,
        piece * np.array([p.cost_per_m2 for p in products])[product],
        _areas_m2(room.scene),
        free,
        of_row,
        low,
        high,
        is_time,
        np.where(is_time, limit, [_SCALES.get(name, 20.0) for name in names]),
        np.concatenate(rows),
        _product_draws(room, products),
    )


def columns_of(
    scene: Scene, surfaces: Sequence[Surface], products: Sequence[Product]
) -> tuple[list[tuple[int, int, float]], dict[int, float]]:
    """Return material, product and most pieces of what may hang where, and the free areas in m2."""
    materials, areas = scene.room.materials, _areas_m2(scene)
    names = [p.name for p in products]
    columns: list[tuple[int, int, float]] = []
    free: dict[int, float] = {}
    for s in surfaces:
        check_known("a surface of the treatment is not known", s.material, materials)
        m = materials.index(s.material)
        whole = float(areas[m])
        wanted = whole if s.free_m2 is None else s.free_m2
        if wanted > 1.001 * whole:
            raise InputError(
                "more area is free than the surface has",
                where=f"surfaces.{s.material}",
                found=f"{wanted:g} m2",
                needed=f"{whole:.2f} m2 at most: of this material in this state of the room",
                hint="a sheet that sound strikes from both sides counts twice",
            )
        free[m] = min(wanted, whole) - s.forbidden_m2
        for name in s.products:
            check_known("a product of the treatment is not known", name, names)
        for p in [names.index(name) for name in s.products] or range(len(products)):
            pieces = float(np.floor(free[m] / products[p].piece_m2 + 1e-6))
            if products[p].depth_m <= s.depth_m and pieces >= 1.0:
                columns.append((m, p, pieces))
    if not columns:
        raise InputError(
            "no product fits on any surface",
            found=f"{len(surfaces)} surfaces, {len(products)} products",
            needed="a product no deeper than the surface allows, and a piece that fits in",
            hint="raise depth_m of a surface, or lower piece_m2 of a product",
        )
    return columns, free


def _areas_m2(scene: Scene) -> FloatArray:
    """Return the area of each material in the state of the pairs; as described without pairs."""
    return material_areas_m2(scene.room, int(np.max(pair_states(scene), initial=0)))


def row_weights(target: Target, bands: Bands) -> FloatArray:
    """Return the weights of bands of each row of a target, shape (n_rows, n_bands).

    Of the speech transmission index, which is alike in every band, a seventh of each octave's.
    """
    if target.parameter == "STI":
        missing_text = sti_missing(bands)
        if missing_text:
            what = "a target is of the speech transmission index, which is not predicted here"
            needed = "octaves from 125 Hz to 8 kHz"
            hint = "fit to 8 kHz (to_hz = 8000), or set C50_dB or D50_percent as a target"
            raise InputError(what, where=str(target), found=missing_text, needed=needed, hint=hint)
        weights = np.zeros((1, len(bands)))
        weights[0, speech_bands(bands)] = 1.0 / 7.0
        return weights
    missing = [f for f in target.bands_hz if f not in bands.centres_hz]
    wanted = [f for f in target.bands_hz or USUAL_HZ if f in bands.centres_hz]
    if missing or not wanted:
        raise InputError(
            "a target is in bands that are not predicted",
            where=str(target),
            found=f"{', '.join(f'{f:g}' for f in missing or USUAL_HZ)} Hz",
            needed=f"of {', '.join(f'{f:g}' for f in bands.centres_hz)} Hz",
            hint="others were not fitted, or a serious finding of the result says that its walls "
            "are wrong there: roomfit treat --doubted then predicts them nevertheless",
        )
    rows = np.array([bands.centres_hz == f for f in wanted], dtype=np.float64)
    return rows.mean(axis=0)[None] if target.mean_of_bands else rows


def _product_draws(room: ChangingRoom, products: Sequence[Product]) -> FloatArray:
    """Return draws of what products absorb, (n_draws, n_products, n_bands): equal in every call."""
    drawn, known = [], room.absorption
    for p in products:
        is_own = p.entry in known.materials
        correlation = band_correlation(p.entry, known.bands) if p.entry and not is_own else None
        own = product_draws(p.absorption, p.sd, len(room.draws), room.seed, correlation)
        drawn.append(room.draws[:, known.materials.index(p.entry)] if is_own else own)
    return np.stack(drawn, axis=1)


def treated(problem: Problem, pieces: FloatArray) -> FloatArray:
    """Return the absorption of the treated room, shape (..., n_materials, n_bands).

    Of a surface that is covered in part the mean by area: in the diffuse limit its energy.

    Shapes: `pieces` (..., n_columns).
    """
    products = np.array([p.absorption for p in problem.products])
    return _covered(problem, pieces, problem.room.absorption.absorption, products)


def treated_draws(problem: Problem, pieces: FloatArray) -> FloatArray:
    """Return draws of the same, with pieces of shape (n_columns,)."""
    return _covered(problem, pieces, problem.room.draws, problem.drawn)


def _covered(
    problem: Problem, pieces: FloatArray, own: FloatArray, products: FloatArray
) -> FloatArray:
    share = pieces * problem.piece_m2 / problem.areas_m2[problem.surface]
    shape = np.broadcast_shapes(own.shape, (*pieces.shape[:-1], 1, 1))
    absorption = np.array(np.broadcast_to(own, shape))
    for c, (m, p) in enumerate(zip(problem.surface, problem.product, strict=True)):
        gain = products[..., p, :] - own[..., m, :]
        absorption[..., m, :] += share[..., c, None] * gain
    return np.clip(absorption, 0.0, 1.0)


def rows_of(problem: Problem, values: FloatArray) -> FloatArray:
    """Return the number of every row, (..., n_rows), of values (..., n_names + 1, n_bands)."""
    names = [TARGET_NAMES.index(problem.targets[t].parameter) for t in problem.target]
    picked = values[..., names, :]
    return np.asarray(np.where(problem.weights > 0.0, picked * problem.weights, 0.0).sum(axis=-1))
