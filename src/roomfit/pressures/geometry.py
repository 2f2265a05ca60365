"""The unknowns of arrival times: positions, speed of sound, latencies and delays of reflections.

Free numbers are multiples of their prior standard deviations, so that the prior of the lowest band
is the unit normal law; a joint prior carries what a band has found to the next.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from roomfit.base.air import Air, relative_speed_sd, speed_of_sound_m_s
from roomfit.base.typing import BoolArray, FloatArray, IntArray
from roomfit.fit.fits import FittedGeometry
from roomfit.materials.priors import MaterialPrior
from roomfit.model.observation import DEFAULT_POSITION_SD_M
from roomfit.model.parameters import GEOMETRY, Block, Marginal, unit_block
from roomfit.pressures.response import Times
from roomfit.room.scene import Point, Scene
from roomfit.settings import Settings
from roomfit.signals.measurement import LATENCY_SD_S, MeasuredPair


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """The unknowns of arrival times and where each observation finds its own."""

    # "source LS1 x", ..., "speed of sound", "latency LS1", "delay wool", ...
    labels: tuple[str, ...]
    # (n,), prior standard deviations: m, 1 (of ln c), s and s; 0: an entry is known
    sd: FloatArray
    # (n,), which entries may move; one that may not still blurs the coherence by its deviation
    fitted: BoolArray
    speed_m_s: float  # prior speed of sound
    # (n_observations, 8 + n_materials), entries of source (3), receiver (3), ln c, latency and
    # delays of each observation
    columns: IntArray
    # (n,), free numbers of the positions for which paths were traced; None: the specified ones
    origin: FloatArray | None = None

    def moves(self) -> BoolArray:
        """Return which entries are free numbers of a fit, shape (n,)."""
        return np.asarray(self.fitted & (self.sd > 0.0))


def geometry_block(geometry: Geometry) -> Block:
    """Return the block of free numbers, zero at the specified geometry, unit normal a priori."""
    return unit_block(GEOMETRY, geometry.labels, geometry.moves())


def times_of(geometry: Geometry, values: FloatArray) -> Times:
    """Return positions, speed, latency and delays of the free numbers, shape (n,)."""
    own = (geometry.sd * values)[geometry.columns]
    traced = 0.0 if geometry.origin is None else geometry.sd * geometry.origin
    shifts_m = (geometry.sd * values - traced)[geometry.columns[:, :6]]
    return Times(
        np.ascontiguousarray(shifts_m),
        float(geometry.speed_m_s * np.exp(own[0, 6])),
        np.ascontiguousarray(own[:, 7]),
        np.ascontiguousarray(own[0, 8:]),
    )


def local_roots(geometry: Geometry, covariance: FloatArray) -> FloatArray:
    """Return a root of each observation's covariance in physical units.

    Shape (n_observations, 8 + n_materials, 8 + n_materials or n). Shapes: `covariance` (n, n).
    """
    values, vectors = np.linalg.eigh(covariance)
    root = geometry.sd[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    # no more columns than rows: a rotation from the right changes no covariance
    own = np.linalg.qr(np.swapaxes(root[geometry.columns], 1, 2), mode="r")
    return np.ascontiguousarray(np.swapaxes(own, 1, 2))


def whole_covariance(geometry: Geometry, fitted: FloatArray | None = None) -> FloatArray:
    """Return the covariance of all free numbers; those that are fixed keep their unit variance.

    Shapes: `fitted` (n_fitted, n_fitted).
    """
    n = geometry.sd.size
    out = np.eye(n)
    if fitted is not None:
        free = np.flatnonzero(geometry.moves())
        out[np.ix_(free, free)] = fitted
    return out


# Prior standard deviation of a reflection delay that is unspecified.
DELAY_SD_S = 2e-4


def campaign_geometry(
    scene: Scene,
    priors: tuple[MaterialPrior, ...],
    fitted: tuple[MeasuredPair, ...],
    *,
    positions: bool,
    delays: bool,
    speed_sd: float,
    origin: FloatArray | None = None,
) -> Geometry:
    """Return the unknowns of arrival times of the fitted measurements."""
    labels: list[str] = []
    sd: list[float] = []
    position_columns = {}
    for kind, points in (("source", scene.sources), ("receiver", scene.receivers)):
        for i, point in enumerate(points):
            position_columns[kind, i] = len(labels)
            position_sd_m = point.position_sd_m
            labels += [f"{kind} {point.name} {axis}" for axis in "xyz"]
            sd += 3 * [DEFAULT_POSITION_SD_M if position_sd_m is None else position_sd_m]
    speed = len(labels)
    labels.append("speed of sound")
    sd.append(speed_sd)
    latency: dict[tuple[str, str], int] = {}
    for m in fitted:
        occasion = m.measurement.source, m.measurement.state
        if occasion not in latency:
            latency[occasion] = len(labels)
            labels.append(f"latency {', '.join(filter(None, occasion))}")
            assumed = LATENCY_SD_S[m.measurement.time_zero]
            sd.append(assumed if m.measurement.latency_sd_s is None else m.measurement.latency_sd_s)
    first_delay = len(labels)
    labels += [f"delay {k.name}" for k in priors]
    spreads = [DELAY_SD_S if k.wall_delay_sd_s is None else k.wall_delay_sd_s for k in priors]
    sds = np.array([*sd, *(spreads if delays else np.zeros(len(spreads)))])
    free = np.array([positions] * len(sd) + [delays] * len(spreads))
    columns = []
    for m in fitted:
        s, r = (int(i) for i in scene.pairs[m.pair])
        source, receiver = position_columns["source", s], position_columns["receiver", r]
        xyz = (*range(source, source + 3), *range(receiver, receiver + 3))
        late = latency[m.measurement.source, m.measurement.state]
        columns.append([*xyz, speed, late, *range(first_delay, len(labels))])
    speed_m_s = speed_of_sound_m_s(scene.air)
    return Geometry(tuple(labels), sds, free, speed_m_s, np.array(columns), origin)


def moved_scene(scene: Scene, geometry: Geometry, fitted: FloatArray) -> tuple[Scene, FloatArray]:
    """Return the scene with fitted positions, and these as free numbers of all entries.

    Shapes: `fitted` (n_fitted,).
    """
    values = np.zeros(geometry.sd.size)
    values[geometry.moves()] = fitted
    n_position_coordinates = 3 * (len(scene.sources) + len(scene.receivers))
    origin = np.where(np.arange(values.size) < n_position_coordinates, values, 0.0)
    steps = (geometry.sd * origin)[:n_position_coordinates].reshape(-1, 3)
    points = (*scene.sources, *scene.receivers)
    at = [replace(p, position_m=p.position_m + x) for p, x in zip(points, steps, strict=True)]
    n = len(scene.sources)
    return replace(scene, sources=tuple(at[:n]), receivers=tuple(at[n:])), origin


def fitted_geometry(geometry: Geometry, final: Marginal) -> FittedGeometry:
    """Return the geometry after the last band, with its standard deviations."""
    free = np.flatnonzero(geometry.moves())
    change, sd = np.zeros(geometry.sd.size), np.array(geometry.sd)
    change[free] = geometry.sd[free] * final.mean
    sd[free] = geometry.sd[free] * np.sqrt(np.diag(np.linalg.inv(final.information)))
    speed = geometry.labels.index("speed of sound")
    c = geometry.speed_m_s * float(np.exp(change[speed]))
    return FittedGeometry(geometry.labels, change, sd, geometry.sd, c)


# Positions whose standard deviations are right move farther once in a thousand campaigns.
LEVEL = 0.999


def inflate_position_sds(
    scene: Scene, origin: FloatArray | None, position_sd_scale: float
) -> tuple[Scene, FloatArray | None]:
    """Return a scene with larger standard deviations of positions, and the origin in their units.

    Points without a specified standard deviation keep the one that is then assumed.
    """

    def inflated(points: tuple[Point, ...]) -> tuple[Point, ...]:
        return tuple(
            p
            if p.position_sd_m is None
            else replace(p, position_sd_m=position_sd_scale * p.position_sd_m)
            for p in points
        )

    changed = replace(scene, sources=inflated(scene.sources), receivers=inflated(scene.receivers))
    if origin is None:
        return changed, None
    specified = [p.position_sd_m is not None for p in (*scene.sources, *scene.receivers)]
    factor = np.ones(origin.size)
    factor[: n_position_coordinates(scene)] = np.where(
        np.repeat(specified, 3), position_sd_scale, 1.0
    )
    return changed, origin / factor


def n_position_coordinates(scene: Scene) -> int:
    return 3 * (len(scene.sources) + len(scene.receivers))


def prior_speed_sd(air: Air, settings: Settings) -> float:
    """Return the prior relative standard deviation of the speed of sound, 1e-6 at least."""
    if settings.temperature_sd_c is None:
        return settings.speed_of_sound_sd
    return max(relative_speed_sd(air, settings.temperature_sd_c), 1e-6)
