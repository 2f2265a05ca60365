"""The windows that a measurement would be compared in, and its noise, before it is made."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roomfit.app.binning import BinnedPaths
from roomfit.bands import Bands
from roomfit.objective.energy_problem import (
    EnergyProblem,
    Observation,
    fine_edges_s,
    in_air,
    lone_rows,
)
from roomfit.objective.parameters import Block, Parameters
from roomfit.objective.windows import window_edges_s
from roomfit.response.energy import weigh
from roomfit.response.rows import EnergyRows, first_rows
from roomfit.signals.filters import (
    FilterBank,
    SmearingKernel,
    share_matrix,
    share_reach_s,
    share_slopes_per_s,
    smearing_kernel,
    statistical_bandwidth_hz,
)
from roomfit.typing import FloatArray

# As in a fit: a window is used down to where the decay stands 4 dB above the noise.
_CLEAR_OF_NOISE = 2.5
# The time constant of the late decay is read from 5 dB below the whole energy on.
_FROM_DB = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class BandFilter:
    """One band's filter with all that is made of it once.

    Attributes
    ----------
    band : int
    centre_hz, bandwidth_hz : float
    bank : FilterBank
        Of this band alone.
    kernel : SmearingKernel
        Of all bands.
    attenuation_per_m : float
    """

    band: int
    centre_hz: float
    bandwidth_hz: float
    bank: FilterBank
    kernel: SmearingKernel
    attenuation_per_m: float


def band_filters(bands: Bands, attenuation_per_m: FloatArray) -> tuple[BandFilter, ...]:
    """Return the filter of every band."""
    kernel = smearing_kernel(FilterBank(bands))
    found = []
    for band, centre_hz in enumerate(bands.centres_hz):
        bank = FilterBank(Bands(bands.kind, bands.centres_hz[band : band + 1]))
        width = float(statistical_bandwidth_hz(bank)[0])
        attenuation = float(attenuation_per_m[band])
        found.append(BandFilter(band, float(centre_hz), width, bank, kernel, attenuation))
    return tuple(found)


def expected_problem(
    own: BandFilter,
    coarse: BinnedPaths,
    direct_s: float,
    absorption: Block,
    decay_range_db: float,
    timing_sd_s: float,
    *,
    periods: float,
) -> EnergyProblem:
    """Return the energy problem of one pair that has not been measured yet.

    Its noise stands where the expected decay, at the absorption the block starts with, has fallen
    by `decay_range_db`. The "measured" energy is that noise: only how far predictions may scatter
    is asked of the problem, not how well they fit.

    Parameters
    ----------
    coarse : BinnedPaths
        Of this pair alone, in the bins of this band.
    direct_s : float
        Travel time of the direct sound.
    absorption : Block
    decay_range_db : float
    timing_sd_s : float
        Of arrival times, from the positions.
    periods : float
        How short the windows may be, see `window_edges_s`.
    """
    rows = coarse.rows[0]
    usable_s, noise_per_s = expected_noise(own, coarse.edges_s, rows, absorption, decay_range_db)
    edges = window_edges_s(direct_s, usable_s, own.bandwidth_hz, periods=periods)
    fine = fine_edges_s(edges, own.bandwidth_hz)
    centres = 0.5 * (coarse.edges_s[1:] + coarse.edges_s[:-1])
    reach_s = share_reach_s(own.kernel, own.band)
    heard = centres[: int(np.searchsorted(centres, edges[-1] + reach_s))]
    noise = noise_per_s * np.diff(edges)
    seen = Observation(
        0,
        edges,
        noise,
        noise,
        share_matrix(own.kernel, own.band, heard, edges),
        fine,
        share_matrix(own.kernel, own.band, heard, fine),
        share_slopes_per_s(own.kernel, own.band, heard, edges),
        timing_sd_s,
        0,
    )
    rows = first_rows(rows, heard.size)
    return in_air(
        EnergyProblem(
            own.centre_hz,
            own.bandwidth_hz,
            own.attenuation_per_m,
            (rows,),
            (lone_rows(rows),),
            (seen,),
            Parameters((absorption, _unit_gain())),
        )
    )


def expected_noise(
    own: BandFilter,
    edges_s: FloatArray,
    rows: EnergyRows,
    absorption: Block,
    decay_range_db: float,
) -> tuple[float, float]:
    """Return where the usable decay would end in s, and the energy of the noise per second.

    The decay is that of Schroeder's backward integral; the noise has the power that the decay has
    left after `decay_range_db`.
    """
    attenuation = np.array([own.attenuation_per_m])
    energy = weigh(rows, absorption.start[:, None], attenuation, derivative=False).energy[0]
    left = np.cumsum(energy[::-1])[::-1]
    levels_db = -10.0 * np.log10(np.maximum(left / left[0], 1e-30))
    late = int(np.searchsorted(levels_db, decay_range_db))
    late = min(late, edges_s.size - 2)
    early = min(int(np.searchsorted(levels_db, _FROM_DB)), late - 1)
    fallen = (levels_db[late] - levels_db[early]) * np.log(10.0) / 10.0
    constant_s = float(edges_s[late] - edges_s[early]) / max(float(fallen), 1e-6)
    end_s = float(edges_s[late]) - np.log(_CLEAR_OF_NOISE) * constant_s
    return end_s, float(left[0] * 10.0 ** (-0.1 * decay_range_db) / constant_s)


def _unit_gain() -> Block:
    """Return an unknown level of which nothing is known."""
    one = np.ones(1)
    return Block(
        "gain",
        ("level",),
        "log",
        one,
        np.ones(1, dtype=np.bool_),
        0.0 * one,
        np.full(1, np.inf),
        0.0 * one,
        one,
    )
