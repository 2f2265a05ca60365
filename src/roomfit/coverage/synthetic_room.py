"""Synthetic rooms that a campaign may describe: draws of all that it leaves open.

Absorption, positions, air and levels that a campaign states with a standard deviation are drawn
with it, those it calls known are kept.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from roomfit.base.air import relative_speed_sd, speed_of_sound_m_s
from roomfit.base.arguments import check_range, read_only
from roomfit.base.bands import Bands
from roomfit.base.cache import code_digest, digest
from roomfit.base.errors import InputError, InsufficientDataError
from roomfit.base.logit import expit, logit
from roomfit.base.typing import FloatArray, IntArray
from roomfit.files.campaign import Campaign, input_files, refuse_objects
from roomfit.files.door import read_bytes
from roomfit.files.encoding import ResultFile, path_of
from roomfit.files.inputs import CampaignInputs
from roomfit.files.results import read_result
from roomfit.fit.measurements import collect_measurements
from roomfit.materials.priors import MaterialPrior, prior_logit_law
from roomfit.model.directivity import DEFAULT_B_SD
from roomfit.model.observation import DEFAULT_POSITION_SD_M
from roomfit.model.patterns import Directivity, UnknownDirectivity
from roomfit.room.scene import Point, Room, position_findings
from roomfit.signals.iso3382 import ValueName
from roomfit.uncertainty.posterior import AbsorptionPosterior


@dataclass(frozen=True, slots=True)
class CoverageSettings:
    """How many replicates, drawn from what, and which of them now."""

    replicates: int = 200  # of the whole estimate, 1 to 100,000
    first: int = 0  # the first replicate of this run
    only: int | None = None  # how many this run simulates at most; None: all that follow
    result: ResultFile | None = None  # result.json whose posterior is drawn from; None: the priors
    # loudest 10 ms over noise in every band, 20 to 90 dB; None: that of the recordings
    snr_db: float | None = None
    seed: int = 1  # of the draws; replicate n of one seed is the same in any slice
    workers: int = 1  # processes
    scheduler: str | None = None  # address of a dask scheduler, in place of processes

    def __post_init__(self) -> None:
        only = self.replicates if self.only is None else self.only
        limits: tuple[tuple[str, float, float, float], ...] = (
            ("replicates", self.replicates, 1, 100_000),
            ("first", self.first, 0, self.replicates - 1),
            ("only", only, 1, self.replicates),
            ("seed", self.seed, 0, 2**63 - 1),
            ("workers", self.workers, 1, 1024),
        )
        if self.snr_db is not None:
            limits = (*limits, ("snr-db", self.snr_db, 20.0, 90.0))
        for name, value, low, high in limits:
            check_range(name, value, low, high, where="the estimate of coverage")

    @property
    def numbers(self) -> range:
        """Replicates of this run."""
        stop = self.replicates if self.only is None else self.first + self.only
        return range(self.first, min(stop, self.replicates))


# Peak over noise of synthetic responses where neither recordings nor settings specify it.
USUAL_SNR_DB = 60.0
_LEAST_SNR_DB, _MOST_SNR_DB = 15.0, 90.0


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceResult:
    """An answer that absorption is drawn about, in the fitted bands; worker processes get it."""

    absorption: FloatArray  # (n_materials, n_bands)
    logit_covariance: FloatArray  # (n_bands, n_materials, n_materials)
    scattering: FloatArray | None  # (n_materials, n_bands)


Tabulated = tuple[str, str, dict[ValueName, FloatArray]]
"""Source, receiver, and by fitted parameter its stated standard deviation, (n_bands,), or NaN."""


@dataclass(frozen=True, slots=True, eq=False)
class CoveragePlan:
    """What every replicate of a campaign is drawn and simulated from."""

    campaign: Campaign  # without what is kept for validation
    room: Room
    priors: tuple[MaterialPrior, ...]  # in the order of the room's materials
    answer: ReferenceResult | None  # what absorption is drawn from; None: the priors
    grid: Bands  # adjacent bands of the simulation, one beyond the fitted ones at either end
    columns: IntArray  # (n_bands,), indices of the fitted bands among the grid's
    nearest: IntArray  # (n_grid,), the fitted band nearest to each of the grid's
    snr_db: FloatArray  # (n_measurements, n_grid), loudest block over noise of every recording
    length_s: float  # no synthetic recording is longer
    tabulated: tuple[Tabulated, ...]
    directivities: dict[str, Directivity | UnknownDirectivity]  # by source
    digest: str  # of all that decides a replicate besides its number


def coverage_plan(campaign: Campaign, settings: CoverageSettings) -> CoveragePlan:
    """Return what every replicate of a campaign is drawn and simulated from.

    Raises
    ------
    InputError
        The campaign, its room or a measured file is not as needed; damped spectra; or a result
        that is of other materials or bands.
    """
    if campaign.spectra:
        raise InputError(
            "the coverage of damped spectra cannot be estimated",
            where=str(campaign.path),
            found=f"{len(campaign.spectra)} damped spectra",
            needed="impulse responses (file) or room parameters",
            hint="leave out the [[measurements]] with spectrum",
        )
    fitted = replace(
        campaign,
        measurements=tuple(m for m in campaign.measurements if m.use == "fit"),
        tables=tuple(t for t in campaign.tables if t.use == "fit"),
    )
    refuse_objects(campaign, "roomfit coverage")
    inputs = CampaignInputs(campaign)
    room = inputs.room()
    priors = inputs.priors(room)
    answer = None
    if settings.result is not None:
        answer = _reference(read_result(settings.result), path_of(settings.result), campaign, room)
    grid = synthetic_bands(campaign.bands)
    steps = np.abs(np.log(grid.centres_hz[:, None] / campaign.bands.exact_centres_hz[None, :]))
    nearest = np.argmin(steps, axis=1)
    observed, tabulated, length_s = _as_measured(fitted, room, settings.snr_db)
    return CoveragePlan(
        fitted,
        room,
        priors,
        answer,
        grid,
        read_only(np.argmin(steps, axis=0)),
        read_only(nearest),
        read_only(observed[:, nearest]),
        length_s,
        tabulated,
        inputs.directivities(campaign.bands),
        _digest(campaign, settings),
    )


def synthetic_bands(bands: Bands) -> Bands:
    """Return adjacent bands from one below the lowest to one above the highest of the given ones.

    Exact centres; filters have skirts, and a room does not end where a fit does.
    """
    steps = 1 if bands.kind == "octave" else 3
    exact = bands.exact_centres_hz
    ratio = 10.0 ** (0.3 / steps)
    count = round(np.log(exact[-1] / exact[0]) / np.log(ratio))
    return Bands(bands.kind, exact[0] * ratio ** np.arange(-1, count + 2))


def _reference(
    posterior: AbsorptionPosterior, where: Path, campaign: Campaign, room: Room
) -> ReferenceResult:
    same_bands = np.array_equal(posterior.bands.centres_hz, campaign.bands.centres_hz)
    if posterior.materials != room.materials or not same_bands:
        raise InputError(
            "the result is of other materials or bands than the campaign",
            where=str(where),
            found=f"{', '.join(posterior.materials)}; "
            f"{', '.join(f'{f:g}' for f in posterior.bands.centres_hz)} Hz",
            needed=f"{', '.join(room.materials)}; "
            f"{', '.join(f'{f:g}' for f in campaign.bands.centres_hz)} Hz",
            hint="identify the campaign again, or draw from the priors",
        )
    return ReferenceResult(posterior.absorption, posterior.logit_covariance, posterior.scattering)


def _as_measured(
    campaign: Campaign, room: Room, snr_db: float | None
) -> tuple[FloatArray, tuple[Tabulated, ...], float]:
    """Return what counts of the recordings: peak over noise, tables, and the longest length.

    With a stated ratio no response is read: the campaign may be one that is still to be measured.
    """
    n, n_bands = len(campaign.measurements), len(campaign.bands)
    read = campaign if snr_db is None else replace(campaign, measurements=())
    if not read.measurements and not read.tables:
        return np.full((n, n_bands), snr_db), (), np.inf
    inputs = CampaignInputs(read)
    measurements = collect_measurements(inputs.scene(room), inputs.measurements(), read.bands, {})
    centres_hz = campaign.bands.centres_hz
    tabulated: tuple[Tabulated, ...] = tuple(
        (v.source, v.receiver, {name: v.spread_at(name, centres_hz) for name in v.values})
        for v in measurements.values
    )
    if not read.measurements:
        return np.full((n, n_bands), snr_db or USUAL_SNR_DB), tabulated, np.inf
    ratios = np.array([m.noise.peak_to_noise_db for m in measurements.responses])
    lengths = [
        len(m.response.pressure) / m.response.sampling_rate_hz - m.response.time_zero_s
        for m in measurements.responses
    ]
    return np.clip(ratios, _LEAST_SNR_DB, _MOST_SNR_DB), tabulated, max(lengths)


def _digest(campaign: Campaign, settings: CoverageSettings) -> str:
    """Files by content; responses that nobody reads are left out, for they may not exist yet."""
    unread = set()
    if settings.snr_db is not None:
        unread = {m.response.path for m in campaign.measurements}
        unread |= {m.response.excitation for m in campaign.measurements if m.response.excitation}
    files = [p for p in input_files(campaign) if p not in unread]
    if settings.result is not None:
        files.append(path_of(settings.result))
    contents = [read_bytes(p, "input file") for p in files]
    return digest(code_digest(), "calibration", contents, settings.snr_db, settings.seed)


# Correlation of logit absorption from one octave to the next, where the campaign states none.
_CORRELATION = 0.95
_LEVEL_SD_DB = 3.0
_DEFAULT_LATENCY_SD_S = {"emission": 2e-5, "direct": 0.0, "unknown": 5e-3}
_SCATTERING = (0.02, 0.4)
_MOST_DRAWS = 200


@dataclass(frozen=True, slots=True, eq=False)
class SyntheticRoom:
    """One draw of everything that the campaign leaves open."""

    absorption: FloatArray  # (n_materials, n_grid)
    scattering: FloatArray  # (n_materials, n_bands)
    delays_s: FloatArray  # (n_materials,), added to the travel time at every reflection
    sources: tuple[Point, ...]
    receivers: tuple[Point, ...]
    speed_of_sound_m_s: float
    b: dict[str, FloatArray]  # (3,), first order, of the sources whose directivity is unknown
    level_db: FloatArray  # (n_measurements, n_grid)
    latency_s: FloatArray  # (n_measurements,), error of the moment of emission


def draw_synthetic_room(plan: CoveragePlan, rng: np.random.Generator) -> SyntheticRoom:
    """Draw a room that the campaign may describe.

    Raises
    ------
    InsufficientDataError
        Positions are so uncertain that hardly any draw stands within the room.
    """
    absorption = _absorption(plan, rng)
    scattering = _scattering(plan, rng)
    sds = [k.wall_delay_sd_s or 0.0 for k in plan.priors]
    delays = np.abs(rng.standard_normal(len(sds))) * np.array(sds)
    sources, receivers = _positions(plan, rng)
    temperature_sd_c = plan.campaign.settings.temperature_sd_c
    speed_sd = (
        plan.campaign.settings.speed_of_sound_sd
        if temperature_sd_c is None
        else relative_speed_sd(plan.campaign.air, temperature_sd_c)
    )
    c = speed_of_sound_m_s(plan.campaign.air) * float(np.exp(speed_sd * rng.standard_normal()))
    b = {s.name: _b(plan, s.name, rng) for s in plan.campaign.sources}
    known = {name: value for name, value in b.items() if value is not None}
    level_db, latency = _levels(plan, rng), _latency_s(plan, rng)
    return SyntheticRoom(
        absorption, scattering, delays, sources, receivers, c, known, level_db, latency
    )


def _absorption(plan: CoveragePlan, rng: np.random.Generator) -> FloatArray:
    """Draw absorption with the law of priors or posterior, smooth over the bands."""
    n, n_grid = len(plan.priors), len(plan.grid)
    lower = np.array([k.lower for k in plan.priors])[:, None]
    upper = np.array([k.upper for k in plan.priors])[:, None]
    mean, covariance = prior_logit_law(plan.priors)
    prior_sd = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    normal = _smooth_normal(plan, float(np.median(prior_sd)), n, rng)
    if plan.answer is None:
        roots = np.array([_root(c) for c in covariance])[plan.nearest]
        free = mean[:, plan.nearest] + np.einsum("gij,jg->ig", roots, normal)
        drawn = lower + (upper - lower) * expit(free)
    else:
        roots = np.array([_root(c) for c in plan.answer.logit_covariance])[plan.nearest]
        spread = np.einsum("gij,jg->ig", roots, normal)
        free = logit(plan.answer.absorption)[:, plan.nearest] + spread
        drawn = np.clip(expit(free), lower, upper)
    for row, k in enumerate(plan.priors):
        if k.known is not None:
            drawn[row] = k.known[plan.nearest]
    names = [k.name for k in plan.priors]
    leaders = [names.index(k.tied_to or k.name) for k in plan.priors]
    return np.asarray(drawn[leaders].reshape(n, n_grid))


def _smooth_normal(plan: CoveragePlan, sd: float, n: int, rng: np.random.Generator) -> FloatArray:
    """Return standard normal numbers (n, n_grid) that run smoothly over the bands of the grid."""
    sd_per_octave = plan.campaign.settings.smoothness_per_octave
    correlation = (
        _CORRELATION if sd_per_octave is None else max(1.0 - 0.5 * (sd_per_octave / sd) ** 2, 0.0)
    )
    step = correlation if plan.grid.kind == "octave" else correlation ** (1.0 / 3.0)
    drawn = rng.standard_normal((n, len(plan.grid)))
    for band in range(1, len(plan.grid)):
        drawn[:, band] = step * drawn[:, band - 1] + np.sqrt(1.0 - step**2) * drawn[:, band]
    return drawn


def _root(covariance: FloatArray) -> FloatArray:
    """Return the symmetric root, which changes little from one band's covariance to the next's."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)


def _scattering(plan: CoveragePlan, rng: np.random.Generator) -> FloatArray:
    """Keep what is specified; draw one coefficient for all walls where it is not."""
    n_bands = len(plan.campaign.bands)
    low, high = np.log(_SCATTERING)
    drawn = float(np.exp(rng.uniform(low, high)))
    found = None if plan.answer is None else plan.answer.scattering
    rows = []
    for row, k in enumerate(plan.priors):
        specified = None if k.fit_scattering else k.scattering
        if specified is None and found is not None:
            specified = found[row]
        rows.append(np.full(n_bands, drawn) if specified is None else specified)
    return np.array(rows)


def _positions(
    plan: CoveragePlan, rng: np.random.Generator
) -> tuple[tuple[Point, ...], tuple[Point, ...]]:
    for _ in range(_MOST_DRAWS):
        sources, receivers = (
            tuple(_moved(point, rng) for point in points)
            for points in (plan.campaign.sources, plan.campaign.receivers)
        )
        if not position_findings(plan.room, sources, receivers):
            return sources, receivers
    raise InsufficientDataError(
        "positions so uncertain that hardly any draw stands within the room",
        where=str(plan.campaign.path),
        found=f"{_MOST_DRAWS} draws, each with a point in a wall or outside",
        needed="position_sd well below the distance to the walls",
    )


def _moved(point: Point, rng: np.random.Generator) -> Point:
    sd = DEFAULT_POSITION_SD_M if point.position_sd_m is None else point.position_sd_m
    return replace(point, position_m=point.position_m + sd * rng.standard_normal(3))


def _b(plan: CoveragePlan, name: str, rng: np.random.Generator) -> FloatArray | None:
    """Draw the unknown directivity of a source, nowhere of negative amplitude."""
    unknown = plan.directivities.get(name)
    if not isinstance(unknown, UnknownDirectivity):
        return None
    if unknown.loudspeaker is not None:
        raise InputError(
            "coverage cannot be estimated with a loudspeaker that several sources share",
            where=f"{plan.campaign.path}, sources.{name}.directivity",
            found=f"loudspeaker {unknown.loudspeaker}",
            needed='directivity = "fit", a file, or {aim, b}',
            hint="give each source a directivity of its own",
        )
    mean = np.zeros(3) if unknown.mean is None else unknown.mean
    sd = DEFAULT_B_SD if unknown.sd is None else unknown.sd
    b = mean + sd * rng.standard_normal(3)
    return np.asarray(b / max(1.0, float(np.linalg.norm(b))))


def _levels(plan: CoveragePlan, rng: np.random.Generator) -> FloatArray:
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


def _latency_s(plan: CoveragePlan, rng: np.random.Generator) -> FloatArray:
    """Draw the error of the moment of emission, which all recordings of a source share."""
    error = {s.name: rng.standard_normal() for s in plan.campaign.sources}
    rows = []
    for m in plan.campaign.measurements:
        sd = _DEFAULT_LATENCY_SD_S[m.response.time_zero]
        if m.latency_sd_s is not None and m.response.time_zero == "emission":
            sd = m.latency_sd_s
        rows.append(sd * error[m.source])
    return np.array(rows)
