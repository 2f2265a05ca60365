"""The variances that decide how much each window counts, against filtered signals drawn at random.

And what stands in an observation besides its energy: the noise, the timing, and whose gain it has.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_array

from coherent_cases import END_S, small_term
from rays_reference import tracing_variance
from roomfit.base.bands import Bands
from roomfit.base.typing import FloatArray
from roomfit.model.energy import (
    EnergyTerm,
    Observation,
    late_shares,
    model_variance,
    noise_and_model_variance,
    observation_variance,
    weighed,
)
from roomfit.model.problem import total
from roomfit.model.weighing import EnergyRows, weigh
from roomfit.signals.filters import (
    frequency_response,
    spreading_kernel,
    spreading_matrix,
    spreading_slopes_per_s,
    statistical_bandwidth_hz,
    window_energies,
)
from roomfit.signals.response import ImpulseResponse

BANK = Bands("octave", np.array([500.0]))
BANDWIDTH_HZ = float(statistical_bandwidth_hz(BANK)[0])
RATE_HZ = 4000.0
EDGES_S = np.array([0.2, 0.25, 0.35])


def observation(energy: FloatArray, noise: FloatArray, edges_s: FloatArray = EDGES_S):
    """Return windows of which only edges, energy and noise matter."""
    n = energy.size
    nothing = csr_array((n, 1))
    return Observation(0, edges_s, energy, noise, nothing, edges_s, nothing, nothing, 0.0, -1)


def term(model_error: float = 0.0, ringing_error: float = 0.0) -> EnergyTerm:
    return EnergyTerm(500.0, BANDWIDTH_HZ, 0.0, (), (), model_error, ringing_error)


def drawn_energies(signal: FloatArray, sd: float, n: int = 800) -> FloatArray:
    """Return energies of the windows of one signal with white noise, drawn anew each time."""
    rng = np.random.default_rng(1)
    return np.array(
        [
            window_energies(
                BANK, ImpulseResponse(signal + sd * rng.standard_normal(signal.size), RATE_HZ),
                EDGES_S,
            )[0]
            for _ in range(n)
        ]
    )  # fmt: skip


def test_noise_scatters_as_filtered_white_noise_and_beats_with_the_signal():
    """A variance of 800 draws is known to 5 %: 20 % is four of them.

    The signal is noise itself, held fixed: flat over the band as an impulse response is.
    """
    for loudness in (0.0, 3.0):
        signal = loudness * np.random.default_rng(2).standard_normal(2400)
        found = drawn_energies(signal, 1.0)
        noise = RATE_HZ * np.diff(EDGES_S)
        of_signal = window_energies(BANK, ImpulseResponse(signal, RATE_HZ), EDGES_S)[0]
        np.testing.assert_allclose(found.mean(axis=0), noise + of_signal, rtol=0.03)
        own = observation(noise + of_signal, noise)
        law = total(noise_and_model_variance(term(), own, of_signal))
        # a fixed stretch of noise is not quite flat: a tenth more
        tolerance = 0.2 if loudness == 0.0 else 0.3
        np.testing.assert_allclose(law, found.var(axis=0, ddof=1), rtol=tolerance)


def test_the_error_of_the_model_is_a_share_of_what_is_expected_or_half_of_what_is_measured():
    """A fifth of the larger; and a tenth of what may ring on from earlier windows."""
    measured, signal = np.array([1.0, 1.0, 9.0]), np.array([2.0, 1.0, 2.0])
    ringing = np.array([0.0, 1.0, 2.0])
    found = total(model_variance(term(0.2, 0.1), measured, signal, ringing))
    np.testing.assert_allclose(found, [0.16, 0.04 + 0.01, 0.81 + 0.04])
    # and with noise: it is no part of what was measured
    edges = 1e4 * np.array([0.0, 1.0, 2.0, 3.0])
    noise = np.full(3, 5.0)
    parts = noise_and_model_variance(term(0.2), observation(measured + noise, noise, edges), signal)
    own = total(parts)
    scattered = noise * (noise + 2.0 * signal) / (BANDWIDTH_HZ * 1e4)
    np.testing.assert_allclose(own - scattered, [0.16, 0.04, 0.81], rtol=1e-9)
    assert np.all(scattered < 1e-4)


def test_energy_may_ring_on_into_later_windows_by_two_milliseconds():
    """From the middle of a window on: integrals of exp(-t / 2 ms) / 2 ms, counted by a grid."""
    edges = np.array([0.0, 0.001, 0.003, 0.004, 0.009])
    t = np.linspace(0.0, 0.02, 400_001)
    found = late_shares(edges)
    for source in range(4):
        middle = 0.5 * (edges[source] + edges[source + 1])
        density = np.exp(-t / 0.002) / 0.002 * (t[1] - t[0])
        for window in range(4):
            inside = (middle + t >= edges[window]) & (middle + t < edges[window + 1])
            expected = density[inside].sum() if window > source else 0.0
            assert found[window, source] == pytest.approx(expected, abs=1e-5)


def one_window_term() -> tuple[EnergyTerm, FloatArray, FloatArray]:
    """Return a room's image sources in a single window, with times and energies of its paths."""
    made = small_term(2000.0)
    whole, own = made.energies, slice(*made.images.offsets[:2])
    bank = Bands("octave", np.array([2000.0]))
    kernel = spreading_kernel(bank)
    rows, old = whole.rows[0], whole.observations[0]
    n_bins = old.spreading.shape[1]
    centres = 1e-4 * np.arange(n_bins) + 0.5e-4
    edges = np.array([0.0, 0.02, 0.04, END_S + 0.03])
    fine = np.linspace(0.0, END_S + 0.03, 4 * 90 + 1)
    fine = np.unique(np.concatenate((fine, edges)))
    observed = replace(
        old,
        edges_s=edges,
        energy=np.ones(3),
        noise=np.zeros(3),
        spreading=spreading_matrix(kernel, 0, centres, edges),
        fine_edges_s=fine,
        fine_spreading=spreading_matrix(kernel, 0, centres, fine),
        slopes=spreading_slopes_per_s(kernel, 0, centres, edges),
    )
    energies = replace(
        whole, rows=(rows,), observations=(observed,), model_error=0.0, ringing_error=0.0
    )  # fmt: skip
    length_m = made.images.lengths_m()[own]
    return energies, length_m / 340.0, made.images.weight[own]


@pytest.mark.slow
def test_arrivals_of_random_phase_interfere_as_their_filtered_pulses_do():
    """Two arrivals add 2 sqrt(e1 e2) r(t2 - t1) of random sign: four e1 e2 r^2 to the variance.

    r is the filter's autocorrelation. The law takes energies as spread over time and interference
    as local: for a room's several hundred reflections within a fifth, all windows together.
    """
    energies, time_s, weight = one_window_term()
    nothing_absorbed = np.full(3, 0.0)
    f = np.linspace(700.0, 4400.0, 4001)
    squared = frequency_response(Bands("octave", np.array([2000.0])), f)[0] ** 2
    inside = time_s < END_S - 0.004
    lags = np.abs(time_s[inside][:, None] - time_s[inside])
    grid = np.linspace(0.0, 0.02, 4001)
    r = np.trapezoid(squared * np.cos(2 * np.pi * np.outer(grid, f)), f) / np.trapezoid(squared, f)
    alike = np.interp(lags, grid, r, right=0.0)
    np.fill_diagonal(alike, 0.0)
    e = weight[inside]
    expected = 2.0 * e @ alike**2 @ e
    paths = weighed(energies, nothing_absorbed)[0]
    one = total(observation_variance(replace(energies), 0, paths, 1.0))
    found = one.sum()
    assert found == pytest.approx(expected, rel=0.2)
    # the gain is one of energies
    np.testing.assert_allclose(total(observation_variance(energies, 0, paths, 3.0)), 9.0 * one)


def test_the_variance_by_rays_is_the_scatter_of_other_rays():
    """Sixteen batches drawn anew 400 times: window energies scatter as their batches say.

    A variance of 400 draws is known to 7 %; 25 % are four of them and that of the estimates.
    """
    energies, *_ = one_window_term()
    observed, rng, n_batches = energies.observations[0], np.random.default_rng(7), 16
    n_bins = observed.spreading.shape[1]
    found, stated = [], []
    for _ in range(400):
        drawn = rng.random((n_batches, n_bins)) < 0.2
        batch, bins = np.nonzero(drawn)
        order = np.argsort(bins, kind="stable")
        offsets = np.concatenate(([0], np.cumsum(np.bincount(bins, minlength=n_bins))))
        hits, length_m = np.zeros((bins.size, 1), dtype=np.uint16), np.zeros(bins.size)
        each = (np.ones(bins.size), hits, length_m, batch[order].astype(np.int32))
        rows = EnergyRows(("walls",), n_bins, offsets, *each, n_batches)
        total = weigh(rows, np.zeros((1, 1)), np.zeros(1))[0]
        found.append(observed.spreading @ total)
        if len(stated) < 60:
            stated.append(tracing_variance(rows, observed, np.zeros((1, 1))))
    np.testing.assert_allclose(np.mean(stated, axis=0), np.var(found, axis=0, ddof=1), rtol=0.3)


def test_a_single_arrival_interferes_with_nothing():
    """All other paths taken away: no variance but that of its timing."""
    energies, *_ = one_window_term()
    first = np.arange(energies.rows[0].weight_per_m2.size) == 0
    rows = energies.rows[0]
    alone = replace(rows, weight_per_m2=np.where(first, rows.weight_per_m2, 0.0))
    energies = replace(energies, rows=(alone,))
    paths = weighed(energies, np.full(3, 0.0))[0]
    assert paths.squares.sum() == pytest.approx(float(alone.weight_per_m2[0]) ** 2)
    found = total(observation_variance(energies, 0, paths, 1.0))
    np.testing.assert_allclose(found, 0.0, atol=1e-12 * paths.squares.sum())


def test_an_arrival_near_an_edge_falls_on_either_side_of_it():
    """By drawing its time: slopes of the shares are those at the specified time, to 5 %."""
    energies, *_ = one_window_term()
    observed = energies.observations[0]
    n_bins = observed.spreading.shape[1]
    sd, at = 2e-5, int(np.argmin(np.abs(1e-4 * np.arange(n_bins) + 0.5e-4 - 0.02)))
    squares = np.where(np.arange(n_bins) == at, 4.0, 0.0)
    energy = np.sqrt(squares)
    paths = replace(
        weighed(energies, np.full(3, 0.0))[0], energy=energy, squares=squares, tracing=np.zeros(3)
    )
    late = replace(energies, observations=(replace(observed, timing_sd_s=sd),))
    late_law, on_time = (total(observation_variance(e, 0, paths, 1.0)) for e in (late, energies))
    law = late_law - on_time
    times = 1e-4 * at + 0.5e-4 + sd * np.random.default_rng(4).standard_normal(4000)
    kernel = spreading_kernel(Bands("octave", np.array([2000.0])))
    drawn = 2.0 * spreading_matrix(kernel, 0, times, observed.edges_s).toarray()
    np.testing.assert_allclose(law[:2], drawn.var(axis=1)[:2], rtol=0.1)
    assert law[0] > 0.0
