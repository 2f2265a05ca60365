"""What every replicate of a campaign is made from."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from roomfit.app.calibrating.settings import CalibrationSettings
from roomfit.app.gathering import gather
from roomfit.bands import Bands
from roomfit.checks import read_only
from roomfit.errors import InputError
from roomfit.files.campaign.campaign import Campaign, input_files
from roomfit.files.campaign.materials import material_knowledge
from roomfit.files.digests import code_digest, digest
from roomfit.files.result_reader import read_result
from roomfit.files.rooms.read import read_room
from roomfit.materials.knowledge import MaterialKnowledge
from roomfit.scene.room import Room
from roomfit.signals.measured_values import MeasuredValues
from roomfit.signals.parameter_gradients import ValueName
from roomfit.typing import FloatArray, IntArray
from roomfit.uncertainty.posterior import AbsorptionPosterior

# Peak over noise of made responses where neither files nor the user tell.
USUAL_SNR_DB = 60.0
_LEAST_SNR_DB, _MOST_SNR_DB = 15.0, 90.0


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """An answer that absorption is drawn about, bands as they are fitted.

    Attributes
    ----------
    absorption : float array, shape (n_materials, n_bands)
    logit_covariance : float array, shape (n_bands, n_materials, n_materials)
    scattering : float array, shape (n_materials, n_bands), or None
    """

    absorption: FloatArray
    logit_covariance: FloatArray
    scattering: FloatArray | None


@dataclass(frozen=True, slots=True, eq=False)
class TabulatedPair:
    """Which room parameters of a pair are fitted.

    Attributes
    ----------
    source, receiver : str
    spread : dict of value name to float array, shape (n_bands,)
        Stated standard deviation in the fitted bands, NaN where none is stated.
    """

    source: str
    receiver: str
    spread: dict[ValueName, FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationPlan:
    """A campaign, what is known of it beforehand, and how its files sound.

    Attributes
    ----------
    campaign : Campaign
        Without what is kept for validation.
    room : Room
    knowledge : tuple of MaterialKnowledge, in the order of the room's materials
    answer : Known or None
        What absorption is drawn from; None for the priors.
    grid : Bands
        Adjacent bands of the truth, one beyond the fitted ones at either end.
    columns : int array, shape (n_bands,)
        Places of the fitted bands among the grid's.
    nearest : int array, shape (n_grid,)
        The fitted band nearest to each of the grid's.
    snr_db : float array, shape (n_measurements, n_grid)
        Loudest block over noise of every file that is made.
    length_s : float
        No file that is made is longer.
    tabulated : tuple of TabulatedPair
        Pairs of which room parameters are fitted.
    digest : str
        Of all that decides a replicate besides its number.
    """

    campaign: Campaign
    room: Room
    knowledge: tuple[MaterialKnowledge, ...]
    answer: Known | None
    grid: Bands
    columns: IntArray
    nearest: IntArray
    snr_db: FloatArray
    length_s: float
    tabulated: tuple[TabulatedPair, ...]
    digest: str


def calibration_plan(campaign: Campaign, settings: CalibrationSettings) -> CalibrationPlan:
    """Return what every replicate of a campaign is made from.

    Raises
    ------
    InputError
        The campaign, its room or a measured file is not as needed; damped spectra; or a result
        that is of other materials or bands.
    """
    if campaign.spectra:
        raise InputError(
            "a campaign of damped spectra cannot be calibrated",
            where=str(campaign.path),
            needed="impulse responses (file) or room parameters",
        )
    fitted = replace(
        campaign,
        measurements=tuple(m for m in campaign.measurements if m.use == "fit"),
        tables=tuple(t for t in campaign.tables if t.use == "fit"),
    )
    room, _ = read_room(campaign.room)
    knowledge = material_knowledge(campaign, room.materials)
    answer = None
    if settings.result is not None:
        answer = _checked(read_result(settings.result), settings.result, campaign, room)
    grid = truth_bands(campaign.bands)
    steps = np.abs(np.log(grid.centres_hz[:, None] / campaign.bands.exact_centres_hz[None, :]))
    nearest = np.argmin(steps, axis=1)
    heard, tabulated, length_s = _as_measured(fitted, room, settings.snr_db)
    return CalibrationPlan(
        fitted,
        room,
        knowledge,
        answer,
        grid,
        read_only(np.argmin(steps, axis=0)),
        read_only(nearest),
        read_only(heard[:, nearest]),
        length_s,
        tabulated,
        _digest(campaign, settings),
    )


def truth_bands(bands: Bands) -> Bands:
    """Return adjacent bands from one below the lowest to one above the highest of the given ones.

    Exact centres; filters have skirts, and a room does not end where a fit does.
    """
    steps = 1 if bands.kind == "octave" else 3
    exact = bands.exact_centres_hz
    ratio = 10.0 ** (0.3 / steps)
    count = round(np.log(exact[-1] / exact[0]) / np.log(ratio))
    return Bands(bands.kind, exact[0] * ratio ** np.arange(-1, count + 2))


def _checked(posterior: AbsorptionPosterior, where: Path, campaign: Campaign, room: Room) -> Known:
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
    return Known(posterior.absorption, posterior.logit_covariance, posterior.scattering)


def _as_measured(
    campaign: Campaign, room: Room, snr_db: float | None
) -> tuple[FloatArray, tuple[TabulatedPair, ...], float]:
    """Return what is kept of the measured files: peak over noise, tables, and the longest length.

    With a stated ratio no response is read: the campaign may be one that is still to be measured.
    """
    n, n_bands = len(campaign.measurements), len(campaign.bands)
    read = campaign if snr_db is None else replace(campaign, measurements=())
    if not read.measurements and not read.tables:
        return np.full((n, n_bands), snr_db), (), np.inf
    gathered = gather(read, room)
    tabulated = tuple(_tabulated(v, campaign.bands) for v in gathered.values)
    if not read.measurements:
        return np.full((n, n_bands), snr_db or USUAL_SNR_DB), tabulated, np.inf
    ratios = np.array([m.noise.peak_to_noise_db for m in gathered.responses])
    lengths = [
        len(m.response.pressure) / m.response.sampling_rate_hz - m.response.time_zero_s
        for m in gathered.responses
    ]
    return np.clip(ratios, _LEAST_SNR_DB, _MOST_SNR_DB), tabulated, max(lengths)


def _tabulated(values: MeasuredValues, bands: Bands) -> TabulatedPair:
    def at_bands(name: ValueName) -> FloatArray:
        if name not in values.spread:
            return np.full(len(bands), np.nan)
        rows = zip(values.centres_hz.tolist(), values.spread[name].tolist(), strict=True)
        told = dict(rows)
        return np.array([told.get(f, np.nan) for f in bands.centres_hz.tolist()])

    return TabulatedPair(
        values.source, values.receiver, {name: at_bands(name) for name in values.values}
    )


def _digest(campaign: Campaign, settings: CalibrationSettings) -> str:
    """Files by content; responses that nobody reads are left out, for they may not exist yet."""
    unread = set()
    if settings.snr_db is not None:
        unread = {m.response.path for m in campaign.measurements}
        unread |= {m.response.excitation for m in campaign.measurements if m.response.excitation}
    files = [p for p in input_files(campaign) if p not in unread]
    if settings.result is not None:
        files.append(settings.result)
    contents = [p.read_bytes() for p in files]
    return digest(code_digest(), "calibration", contents, settings.snr_db, settings.seed)
