"""What might be true of a campaign: absorption, places, air, levels, as far as it leaves them open.

What a campaign states with a spread is drawn within that spread, what it calls known is kept.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from roomfit.air import speed_of_sound_m_s
from roomfit.app.calibrating.plan import CalibrationPlan
from roomfit.app.coherent.problems import SPEED_SD
from roomfit.app.directing.unknown import UNTOLD_B_SD
from roomfit.app.problems import UNTOLD_POSITION_SD_M
from roomfit.errors import CannotTell
from roomfit.files.campaign.directivity import unknown_directivity
from roomfit.scene.positions import position_findings
from roomfit.scene.scene import Point
from roomfit.typing import FloatArray
from roomfit.uncertainty.posterior import logit

# Correlation of logit absorption from one octave to the next, where the campaign states none.
_ALIKE = 0.95
_LEVEL_SD_DB = 3.0
_UNTOLD_LATENCY_SD_S = {"emission": 2e-5, "direct": 0.0, "unknown": 5e-3}
_SCATTERING = (0.02, 0.4)
_MOST_DRAWS = 200


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """One draw of everything that the campaign leaves open.

    Attributes
    ----------
    absorption : float array, shape (n_materials, n_grid)
    scattering : float array, shape (n_materials, n_bands)
    delays_s : float array, shape (n_materials,)
        What each material adds to the travel time at every reflection.
    sources, receivers : tuple of Point
        Where they stand.
    speed_of_sound_m_s : float
    b : mapping of source to float array, shape (3,)
        First-order directivity of the sources whose directivity is unknown.
    level_db : float array, shape (n_measurements, n_grid)
    latency_s : float array, shape (n_measurements,)
        By how much emission differs from where the campaign has it.
    """

    absorption: FloatArray
    scattering: FloatArray
    delays_s: FloatArray
    sources: tuple[Point, ...]
    receivers: tuple[Point, ...]
    speed_of_sound_m_s: float
    b: dict[str, FloatArray]
    level_db: FloatArray
    latency_s: FloatArray


def draw_truth(plan: CalibrationPlan, rng: np.random.Generator) -> Truth:
    """Draw what might be true of a campaign.

    Raises
    ------
    CannotTell
        Positions are so uncertain that hardly any draw stands within the room.
    """
    absorption = _absorption(plan, rng)
    scattering = _scattering(plan, rng)
    sds = [k.wall_delay_sd_s or 0.0 for k in plan.knowledge]
    delays = np.abs(rng.standard_normal(len(sds))) * np.array(sds)
    sources, receivers = _places(plan, rng)
    told = plan.campaign.temperature_sd_c
    kelvin = 273.15 + plan.campaign.air.temperature_c
    speed_sd = SPEED_SD if told is None else 0.5 * told / kelvin
    c = speed_of_sound_m_s(plan.campaign.air) * float(np.exp(speed_sd * rng.standard_normal()))
    b = {s.name: _b(plan, s.name, rng) for s in plan.campaign.sources}
    known = {name: value for name, value in b.items() if value is not None}
    level_db, latency = _levels(plan, rng), _latency_s(plan, rng)
    return Truth(absorption, scattering, delays, sources, receivers, c, known, level_db, latency)


def _absorption(plan: CalibrationPlan, rng: np.random.Generator) -> FloatArray:
    """Draw absorption with the marginals of priors or posterior, smooth over the bands."""
    n, n_grid = len(plan.knowledge), len(plan.grid)
    lower = np.array([k.lower for k in plan.knowledge])[:, None]
    upper = np.array([k.upper for k in plan.knowledge])[:, None]
    prior_sd = np.array([k.prior_logit_sd for k in plan.knowledge])
    normal = _smooth_normal(plan, float(np.median(prior_sd)), n, rng)
    if plan.answer is None:
        mean = np.array([k.prior_logit_mean for k in plan.knowledge])[:, plan.nearest]
        free = mean + prior_sd[:, plan.nearest] * normal
        drawn = lower + (upper - lower) / (1.0 + np.exp(-free))
    else:
        roots = np.array([_root(c) for c in plan.answer.logit_covariance])[plan.nearest]
        spread = np.einsum("gij,jg->ig", roots, normal)
        free = logit(plan.answer.absorption)[:, plan.nearest] + spread
        drawn = np.clip(1.0 / (1.0 + np.exp(-free)), lower, upper)
    for row, k in enumerate(plan.knowledge):
        if k.known is not None:
            drawn[row] = k.known[plan.nearest]
    names = [k.name for k in plan.knowledge]
    leaders = [names.index(k.tied_to or k.name) for k in plan.knowledge]
    return np.asarray(drawn[leaders].reshape(n, n_grid))


def _smooth_normal(
    plan: CalibrationPlan, sd: float, n: int, rng: np.random.Generator
) -> FloatArray:
    """Return standard normal numbers (n, n_grid) that run smoothly over the bands of the grid."""
    told = plan.campaign.smoothness_per_octave
    alike = _ALIKE if told is None else max(1.0 - 0.5 * (told / sd) ** 2, 0.0)
    step = alike if plan.grid.kind == "octave" else alike ** (1.0 / 3.0)
    drawn = rng.standard_normal((n, len(plan.grid)))
    for band in range(1, len(plan.grid)):
        drawn[:, band] = step * drawn[:, band - 1] + np.sqrt(1.0 - step**2) * drawn[:, band]
    return drawn


def _root(covariance: FloatArray) -> FloatArray:
    """Return the symmetric root, which changes little from one band's covariance to the next's."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)


def _scattering(plan: CalibrationPlan, rng: np.random.Generator) -> FloatArray:
    """Keep what is told; draw one coefficient for all walls of which nothing is."""
    n_bands = len(plan.campaign.bands)
    low, high = np.log(_SCATTERING)
    drawn = float(np.exp(rng.uniform(low, high)))
    found = None if plan.answer is None else plan.answer.scattering
    rows = []
    for row, k in enumerate(plan.knowledge):
        told = None if k.fit_scattering else k.scattering
        if told is None and found is not None:
            told = found[row]
        rows.append(np.full(n_bands, drawn) if told is None else told)
    return np.array(rows)


def _places(
    plan: CalibrationPlan, rng: np.random.Generator
) -> tuple[tuple[Point, ...], tuple[Point, ...]]:
    for _ in range(_MOST_DRAWS):
        sources, receivers = (
            tuple(_moved(point, rng) for point in points)
            for points in (plan.campaign.sources, plan.campaign.receivers)
        )
        if not position_findings(plan.room, sources, receivers):
            return sources, receivers
    raise CannotTell(
        "places so uncertain that hardly any draw stands within the room",
        where=str(plan.campaign.path),
        found=f"{_MOST_DRAWS} draws, each with a point in a wall or outside",
        needed="position_sd well below the distance to the walls",
    )


def _moved(point: Point, rng: np.random.Generator) -> Point:
    sd = UNTOLD_POSITION_SD_M if point.position_sd_m is None else point.position_sd_m
    return replace(point, position_m=point.position_m + sd * rng.standard_normal(3))


def _b(plan: CalibrationPlan, name: str, rng: np.random.Generator) -> FloatArray | None:
    """Draw the unknown directivity of a source, nowhere of negative amplitude."""
    unknown = unknown_directivity(plan.campaign, name)
    if unknown is None:
        return None
    mean = np.zeros(3) if unknown.mean is None else unknown.mean
    sd = UNTOLD_B_SD if unknown.sd is None else unknown.sd
    b = mean + sd * rng.standard_normal(3)
    return np.asarray(b / max(1.0, float(np.linalg.norm(b))))


def _levels(plan: CalibrationPlan, rng: np.random.Generator) -> FloatArray:
    """Draw what is not known of levels: one gain a source or a file, in every band."""
    files, n_grid = plan.campaign.measurements, len(plan.grid)
    of_source = {s.name: rng.normal(0.0, _LEVEL_SD_DB, n_grid) for s in plan.campaign.sources}
    own = rng.normal(0.0, _LEVEL_SD_DB, (len(files), n_grid))
    rows = [
        np.zeros(n_grid) if m.level == "absolute" else
        own[i] if m.level == "per-file" else of_source[m.source]
        for i, m in enumerate(files)
    ]  # fmt: skip
    return np.array(rows).reshape(len(files), n_grid)


def _latency_s(plan: CalibrationPlan, rng: np.random.Generator) -> FloatArray:
    """Draw the error of the moment of emission, which all files of a source share."""
    error = {s.name: rng.standard_normal() for s in plan.campaign.sources}
    rows = []
    for m in plan.campaign.measurements:
        sd = _UNTOLD_LATENCY_SD_S[m.response.time_zero]
        if m.latency_sd_s is not None and m.response.time_zero == "emission":
            sd = m.latency_sd_s
        rows.append(sd * error[m.source])
    return np.array(rows)
