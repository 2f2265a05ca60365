"""A campaign's energy problems made partly coherent, with places and times as unknowns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from roomfit.air import speed_of_sound_m_s
from roomfit.app.binning import BinnedPaths, in_band, regrouped
from roomfit.app.measuring import LATENCY_SD_S, MeasuredPair
from roomfit.app.problems import UNTOLD_POSITION_SD_M
from roomfit.bands import Bands
from roomfit.identification.scoring import Marginal
from roomfit.materials.knowledge import MaterialKnowledge
from roomfit.objective.coherent_geometry import Geometry, geometry_block
from roomfit.objective.coherent_problem import CoherentProblem
from roomfit.objective.energy_problem import EnergyProblem, first_windows
from roomfit.objective.parameters import JointPrior, Parameters
from roomfit.response.coherent import band_grid, chosen_paths, image_paths
from roomfit.response.rows import first_rows
from roomfit.scene.scene import Scene
from roomfit.signals.filters import FilterBank
from roomfit.tracing.paths import Paths
from roomfit.typing import FloatArray
from roomfit.uncertainty.answer import FittedGeometry

# What is assumed of an unknown of which nothing is told.
SPEED_SD = 2e-3
DELAY_SD_S = 2e-4


def cut_at(binned: BinnedPaths, end_s: float) -> BinnedPaths:
    """Return the bins that end by a time, with their rows."""
    n = max(int(np.searchsorted(binned.edges_s, end_s + 1e-9, side="right")) - 1, 1)
    if n >= binned.edges_s.size - 1:
        return binned
    return regrouped(binned, binned.edges_s[: n + 1], lambda rows: first_rows(rows, n))


def campaign_geometry(
    scene: Scene,
    knowledge: tuple[MaterialKnowledge, ...],
    fitted: tuple[MeasuredPair, ...],
    *,
    positions: bool,
    delays: bool,
    speed_sd: float = SPEED_SD,
) -> Geometry:
    """Return the unknowns of arrival times of the fitted measurements.

    Parameters
    ----------
    fitted : tuple of MeasuredPair
        One an observation, in the order of the observations.
    positions : bool
        Whether places, speed of sound and latencies may move.
    delays : bool
        Whether walls may delay.
    speed_sd : float
        Standard deviation of ln c.
    """
    labels: list[str] = []
    sd: list[float] = []
    places = {}
    for kind, points in (("source", scene.sources), ("receiver", scene.receivers)):
        for i, point in enumerate(points):
            places[kind, i] = len(labels)
            told = point.position_sd_m
            labels += [f"{kind} {point.name} {axis}" for axis in "xyz"]
            sd += 3 * [UNTOLD_POSITION_SD_M if told is None else told]
    speed = len(labels)
    labels.append("speed of sound")
    sd.append(speed_sd)
    latency = {}
    for m in fitted:
        source = int(scene.pairs[m.pair][0])
        if source not in latency:
            latency[source] = len(labels)
            labels.append(f"latency {scene.sources[source].name}")
            assumed = LATENCY_SD_S[m.file.response.time_zero]
            sd.append(assumed if m.file.latency_sd_s is None else m.file.latency_sd_s)
    first_delay = len(labels)
    labels += [f"delay {k.name}" for k in knowledge]
    spreads = [DELAY_SD_S if k.wall_delay_sd_s is None else k.wall_delay_sd_s for k in knowledge]
    sds = np.array([*sd, *(spreads if delays else np.zeros(len(spreads)))])
    free = np.array([positions] * len(sd) + [delays] * len(spreads))
    columns = []
    for m in fitted:
        s, r = (int(i) for i in scene.pairs[m.pair])
        places_s, places_r = places["source", s], places["receiver", r]
        columns.append(
            [
                *range(places_s, places_s + 3),
                *range(places_r, places_r + 3),
                speed,
                latency[s],
                *range(first_delay, first_delay + len(knowledge)),
            ]
        )
    return Geometry(tuple(labels), sds, free, speed_of_sound_m_s(scene.air), np.array(columns))


def coherent_problem(
    bands: Bands,
    band: int,
    energies: EnergyProblem,
    attenuation_per_m: float,
    paths: Paths,
    binned: BinnedPaths,
    geometry: Geometry,
    joint: JointPrior | None,
    end_s: float = np.inf,
) -> CoherentProblem:
    """Return the partly coherent problem of a band from its energy problem, not coherent yet.

    Parameters
    ----------
    energies : EnergyProblem
        Of the same paths and observations; its attenuation may be in its rows already.
    attenuation_per_m : float
        Energy attenuation of the air in the band.
    geometry : Geometry
        With one row of columns for each observation.
    joint : JointPrior or None
        What lower bands say of the geometry.
    end_s : float
        Pressures add in the windows that end by then.
    """
    seen = tuple(first_windows(o, end_s) for o in energies.observations)
    c = geometry.speed_m_s
    bank = FilterBank(Bands(bands.kind, bands.centres_hz[band : band + 1]))
    first = min(float(o.edges_s[0]) for o in seen)
    last = max(float(o.edges_s[-1]) for o in seen)
    grid = band_grid(bank, first, last)
    pairs = np.array([o.pair for o in seen])
    images = image_paths(paths, pairs, attenuation_per_m, c * (last + 4.0 / energies.centre_hz))
    travel = np.linalg.norm(images.away_m, axis=1) / c
    bin_edges_s = in_band(BinnedPaths(binned.edges_s, ()), energies.centre_hz).edges_s
    bins = np.searchsorted(bin_edges_s, travel, side="right") - 1
    heard = [o.shares.shape[1] for o in seen]
    bins[bins >= np.repeat(heard, np.diff(images.offsets))] = -1
    parameters = Parameters((*energies.parameters.blocks, geometry_block(geometry)), joint)
    nothing = chosen_paths(images, np.zeros(travel.size, dtype=np.bool_))
    return CoherentProblem(
        energies,
        seen,
        parameters,
        geometry,
        replace(images, coherence=np.zeros(travel.size)),
        nothing,
        bins,
        np.zeros(0, dtype=np.int64),
        grid,
        energies.centre_hz,
    )


def moved_scene(scene: Scene, geometry: Geometry, fitted: FloatArray) -> tuple[Scene, FloatArray]:
    """Return the scene with fitted positions, and these as free numbers of all entries.

    Parameters
    ----------
    fitted : float array, shape (n_fitted,)
        Free numbers of the fitted entries of the geometry.
    """
    values = np.zeros(geometry.sd.size)
    values[geometry.fitted & (geometry.sd > 0.0)] = fitted
    n_places = 3 * (len(scene.sources) + len(scene.receivers))
    origin = np.where(np.arange(values.size) < n_places, values, 0.0)
    steps = (geometry.sd * origin)[:n_places].reshape(-1, 3)
    points = (*scene.sources, *scene.receivers)
    at = [replace(p, position_m=p.position_m + x) for p, x in zip(points, steps, strict=True)]
    n = len(scene.sources)
    return replace(scene, sources=tuple(at[:n]), receivers=tuple(at[n:])), origin


def fitted_geometry(geometry: Geometry, final: Marginal) -> FittedGeometry:
    """Return where everything stands after the last band, and how sure that is."""
    free = np.flatnonzero(geometry.fitted & (geometry.sd > 0.0))
    change, sd = np.zeros(geometry.sd.size), np.array(geometry.sd)
    change[free] = geometry.sd[free] * final.mean
    sd[free] = geometry.sd[free] * np.sqrt(np.diag(np.linalg.inv(final.information)))
    speed = geometry.labels.index("speed of sound")
    c = geometry.speed_m_s * float(np.exp(change[speed]))
    return FittedGeometry(geometry.labels, change, sd, geometry.sd, c)
