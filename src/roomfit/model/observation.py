"""A campaign's data and paths as one problem a band: the same reduction on both sides."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from roomfit.base.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.base.bands import Bands
from roomfit.base.errors import InsufficientDataError
from roomfit.base.logit import expit
from roomfit.base.typing import FloatArray
from roomfit.materials.priors import MaterialPrior, prior_logit_law
from roomfit.model.binned import BIN_S, BinnedPaths, in_band
from roomfit.model.energy import EnergyTerm, Observation, fine_edges_s, in_air
from roomfit.model.parameters import Block, Parameters
from roomfit.model.weighing import first_rows, weigh
from roomfit.model.windows import band_spreading, spread_energy, window_edges_s
from roomfit.room.scene import Scene
from roomfit.signals import filters
from roomfit.signals.measurement import MeasuredPair

# Positions are taken with a tape, unless the campaign says how well they are known.
DEFAULT_POSITION_SD_M = 0.02
# Energy of a unit source is 1/(4 pi r^2), the square of its stated pressure 1/(4 pi r)^2.
_ENERGY_PER_PRESSURE_SQUARED = 4.0 * np.pi
# Of an impulse: what only the variance is made of needs no smaller shares, and half the memory.
_LEAST_OF_VARIANCE = 1e-5


def energy_terms(
    scene: Scene,
    bands: Bands,
    priors: tuple[MaterialPrior, ...],
    measured: tuple[MeasuredPair, ...],
    binned: BinnedPaths,
    start: FloatArray,
    *,
    periods: float = 1.5,
    fine_s: float = 0.0,
) -> Iterator[tuple[EnergyTerm, Parameters] | None]:
    """Make the windows of one band after the other, see `energy_term`: take them one by one."""
    for band in range(len(bands)):
        yield energy_term(scene, bands, priors, measured, binned, start, band, (periods, fine_s))


def energy_term(
    scene: Scene,
    bands: Bands,
    priors: tuple[MaterialPrior, ...],
    measured: tuple[MeasuredPair, ...],
    binned: BinnedPaths,
    start: FloatArray,
    band: int,
    shortest: tuple[float, float] = (1.5, 0.0),
) -> tuple[EnergyTerm, Parameters] | None:
    """Return the windows of a band, with their unknowns, of the measurements to be fitted.

    None where fewer windows rise above the noise than there are unknowns. A measurement is left out
    of the bands in which no decay rises above its noise.
    """
    attenuation = attenuation_per_m(scene.air, bands)
    fitted = fitted_in_band(measured, band)
    coarse = in_band(binned, float(bands.centres_hz[band]))
    labels = [_gain_label(m) for m in fitted]  # "" where the level is absolute
    gain_labels = tuple(dict.fromkeys(label for label in labels if label))
    one = Bands(bands.kind, bands.centres_hz[band : band + 1])
    reduction = one, filters.spreading_kernel(bands)
    observations = tuple(
        _observation(
            reduction,
            band,
            m,
            coarse.edges_s,
            timing_sd_s(scene, m),
            gain_labels.index(label) if label else -1,
            shortest,
        )
        for m, label in zip(fitted, labels, strict=True)
    )
    if sum(o.energy.size for o in observations) <= len(priors) + len(gain_labels):
        return None
    absorption = absorption_block(priors, band, float(start[band]))
    centre_hz = float(bands.centres_hz[band])
    bandwidth_hz = filters.statistical_bandwidth_hz(one)[0]
    term = EnergyTerm(centre_hz, float(bandwidth_hz), 0.0, (), observations)
    term = with_paths(term, binned, float(attenuation[band]))
    return term, Parameters((absorption, _gain_block(gain_labels, term, absorption)))


def with_paths(term: EnergyTerm, binned: BinnedPaths, attenuation_per_m: float) -> EnergyTerm:
    """Return the windows of a band with other paths, in the same bins, the air's loss in them."""
    rows = in_band(binned, term.centre_hz).rows
    # what reaches no window would be weighed for nothing
    own = tuple(first_rows(rows[o.pair], o.spreading.shape[1]) for o in term.observations)
    return in_air(replace(term, rows=own, attenuation_per_m=attenuation_per_m))


def has_data_in_band(m: MeasuredPair, band: int) -> bool:
    """Whether a measurement is to be fitted and a decay rises above its noise in a band."""
    return m.measurement.use == "fit" and bool(m.noise.tail_time_constant_s[band] > 0.0)


def fitted_in_band(measured: Sequence[MeasuredPair], band: int) -> tuple[MeasuredPair, ...]:
    """Return the measurements of a band's observations, in their order."""
    return tuple(m for m in measured if has_data_in_band(m, band))


def spread_over_time(bands: Bands, energies: FloatArray) -> FloatArray:
    """Return bin energies as the band filters would show them, shape (n_bands, n_bins)."""
    spread = []
    for band, row in enumerate(energies):
        one = Bands(bands.kind, bands.centres_hz[band : band + 1])
        spread.append(spread_energy(band_spreading(one, row.size, BIN_S), row))
    return np.stack(spread)


def _observation(
    reduction: tuple[Bands, filters.SpreadingKernel],
    band: int,
    m: MeasuredPair,
    bin_edges_s: FloatArray,
    timing_sd_s: float,
    gain: int,
    shortest: tuple[float, float],
) -> Observation:
    one, kernel = reduction
    bandwidth_hz = float(filters.statistical_bandwidth_hz(one)[0])
    end_s = min(float(m.fit_end_s[band]), float(bin_edges_s[-1]))
    periods, fine_s = shortest
    rough = kernel if fine_s else replace(kernel, least_share=_LEAST_OF_VARIANCE)
    edges = window_edges_s(m.direct_s, end_s, bandwidth_hz, periods=periods, fine_s=fine_s)
    fine = fine_edges_s(edges, bandwidth_hz)
    unit = _ENERGY_PER_PRESSURE_SQUARED if m.measurement.level == "absolute" else 1.0
    # noise power in the unit of `window_energies`: a single sample of height 1 has the energy 1
    rate_hz = m.response.sampling_rate_hz
    per_second = (
        m.noise.floor[band] * rate_hz**2 / (2.0 * float(filters.energy_bandwidth_hz(one)[0]))
    )
    centres = 0.5 * (bin_edges_s[1:] + bin_edges_s[:-1])
    bin_centres_s = centres[
        : int(np.searchsorted(centres, edges[-1] + filters.spreading_reach_s(kernel, band)))
    ]
    return Observation(
        m.pair,
        edges,
        unit * filters.window_energies(one, m.response, edges)[0],
        unit * per_second * np.diff(edges),
        filters.spreading_matrix(kernel, band, bin_centres_s, edges),
        fine,
        filters.spreading_matrix(rough, band, bin_centres_s, fine),
        filters.spreading_slopes_per_s(rough, band, bin_centres_s, edges),
        timing_sd_s,
        gain,
    )


def timing_sd_s(scene: Scene, m: MeasuredPair) -> float:
    """Return how uncertain arrival times are, from both ends' positions along the path."""
    source, receiver = scene.pairs[m.pair]
    position_sds_m = (scene.sources[source].position_sd_m, scene.receivers[receiver].position_sd_m)
    sd_m = [DEFAULT_POSITION_SD_M if sd is None else sd for sd in position_sds_m]
    return float(np.linalg.norm(sd_m) / speed_of_sound_m_s(scene.air))


def _gain_label(m: MeasuredPair) -> str:
    if m.measurement.level == "per-source":
        # between two states of a room, gains are set anew
        return ", ".join(filter(None, (m.measurement.source, m.measurement.state)))
    if m.measurement.level == "per-file":
        return f"{m.measurement.source} to {m.measurement.receiver}, {m.measurement.where}"
    return ""


def absorption_block(priors: tuple[MaterialPrior, ...], band: int, start: float) -> Block:
    """Return the unknown absorptions of one band, those that are not known starting alike."""
    known = np.array([np.nan if k.known is None else k.known[band] for k in priors])
    names = [k.name for k in priors]
    leader = np.array([names.index(k.tied_to or k.name) for k in priors])
    follows = leader != np.arange(len(names))
    known = known[leader]
    fitted = np.isnan(known) & ~follows
    lower = np.array([k.lower for k in priors])[leader]
    upper = np.array([k.upper for k in priors])[leader]
    mean, covariance = prior_logit_law(priors)
    sd = np.sqrt(np.diag(covariance[band]))
    correlated = np.count_nonzero(covariance[band][np.ix_(fitted, fitted)]) > fitted.sum()
    inside = np.clip(start, lower + 0.02 * (upper - lower), upper - 0.02 * (upper - lower))
    # of what is in the volume, no wall can say where to start
    in_volume = np.array([k.object_volume_m3 is not None for k in priors])
    inside = np.where(in_volume, lower + (upper - lower) * expit(mean[:, band]), inside)
    return Block(
        "absorption",
        tuple(k.name for k in priors),
        "logit",
        np.where(np.isnan(known), inside, known),
        fitted,
        mean[:, band],
        sd,
        lower,
        upper,
        leader if follows.any() else None,
        covariance[band] / np.outer(sd, sd) if correlated else None,
    )


def _gain_block(labels: tuple[str, ...], term: EnergyTerm, absorption: Block) -> Block:
    """Unknown levels, starting where measured and predicted energy agree as a whole."""
    sums, air = np.zeros((2, len(labels))), np.array([term.attenuation_per_m])
    for own, observed in zip(term.rows, term.observations, strict=True):
        if observed.gain < 0:
            continue
        energy = weigh(own, absorption.start[:, None], air)[0]
        sums[0, observed.gain] += float(np.maximum(observed.energy - observed.noise, 0.0).sum())
        sums[1, observed.gain] += float((observed.spreading @ energy).sum())
    for label, (found, expected) in zip(labels, sums.T, strict=True):
        if not (found > 0.0 and expected > 0.0):
            raise InsufficientDataError(
                "a measurement and its prediction cannot be brought to one level",
                where=label,
                found="no energy above the noise" if expected > 0.0 else "no path in any window",
                hint="look at the response; leave the band out with from_hz and to_hz",
            )
    n = len(labels)
    return Block(
        "gain",
        labels,
        "log",
        sums[0] / sums[1],
        np.ones(n, dtype=np.bool_),
        np.zeros(n),
        np.full(n, np.inf),
        np.full(n, 0.0),
        np.full(n, 1.0),
    )
