"""Windows of several beams: their covariance against simulated pressures, and their rows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import approx_fprime

from _beams import (
    Beams,
    BeamTerm,
    beam_levels,
    beam_term,
    beam_windows,
    spread_covariance,
    with_levels,
)
from _microphone_arrays import beam_patterns, cross_patterns
from coherent_cases import MATERIALS, small_scene
from roomfit.base.bands import Bands
from roomfit.materials.priors import uniform_scattering
from roomfit.model.binned import bin_paths, in_band
from roomfit.model.energy import EnergyTerm, Observation, fine_edges_s
from roomfit.model.parameters import Block, Parameters, start_vector
from roomfit.model.problem import Objective, total
from roomfit.model.weighing import window_of_rows
from roomfit.signals.filters import (
    frequency_response,
    spreading_kernel,
    spreading_matrix,
    spreading_slopes_per_s,
    statistical_bandwidth_hz,
)
from roomfit.tracing.image_sources import trace_images
from roomfit.tracing.paths import Paths

BANK = Bands("octave", np.array([1000.0]))
BANDWIDTH_HZ = float(statistical_bandwidth_hz(BANK)[0])
END_S = 0.06
WALLS = np.array([0.3, 0.6, 0.1])


def image_case() -> tuple[Paths, EnergyTerm, Beams]:
    """Return a small box's image sources at two receivers, their windows, and ideal beams."""
    scene = small_scene()
    paths = trace_images(scene, 100, END_S, uniform_scattering(MATERIALS, 0.0))
    binned = in_band(bin_paths(scene, BANK, paths, END_S), 1000.0)
    centres = 0.5 * (binned.edges_s[1:] + binned.edges_s[:-1])
    edges = np.array([0.004, 0.008, 0.014, 0.022, 0.036])
    fine, kernel = fine_edges_s(edges, BANDWIDTH_HZ), spreading_kernel(BANK)
    n = edges.size - 1
    observations = tuple(
        Observation(
            pair,
            edges,
            np.ones(n),
            np.full(n, 1e-3),
            spreading_matrix(kernel, 0, centres, edges),
            fine,
            spreading_matrix(kernel, 0, centres, fine),
            spreading_slopes_per_s(kernel, 0, centres, edges),
            2e-5,
            0,
        )
        for pair in range(2)
    )
    term = EnergyTerm(1000.0, BANDWIDTH_HZ, 0.0, binned.rows, observations)
    (cross,) = cross_patterns(BANK, -paths.arrival.astype(float))
    return paths, term, Beams(cross, tuple(rows.path for rows in binned.rows))


def parameters(term: EnergyTerm) -> Parameters:
    """Return three absorptions, one gain and the levels of the beams."""
    three, one = np.ones(3), np.ones(1)
    absorption = Block(
        "absorption", MATERIALS, "logit", WALLS, three > 0, -three, 1.5 * three, 0 * three, three
    )
    gain = Block("gain", ("level",), "log", 2.0 * one, one > 0, 0 * one, np.inf * one, 0 * one, one)
    levels = beam_levels(np.full(7, 0.05), 0.1, 0.2)
    return with_levels(Parameters((absorption, gain)), levels)


def case(seed: int = 1) -> tuple[EnergyTerm, Beams, BeamTerm, Parameters]:
    """Return beams with energies drawn about nothing in particular, and their term."""
    _, omni, beams = image_case()
    rng, n = np.random.default_rng(seed), omni.observations[0].energy.size
    measured = [(rng.uniform(0.1, 1.0, (7, n)), np.full((7, n), 1e-3)) for _ in range(2)]
    windows = beam_windows(omni, beams, measured)
    values = {"absorption": WALLS, "gain": np.array([2.0])}
    return omni, beams, beam_term(omni, beams, windows, values), parameters(omni)


@pytest.mark.slow
def test_energies_of_beams_scatter_together_as_the_law_states():
    """1,500 rooms of the same reflections with random phases, as pressures, filtered and squared.

    A variance is known to 4 %, a covariance to as much of the standard deviations' product; the law
    takes interference as local in time and energies as spread: .12 rms over all pairs of beams.
    """
    paths, omni, beams = image_case()
    rows, observed, rng = omni.rows[0], omni.observations[0], np.random.default_rng(3)
    energy = rows.weight_per_m2 * np.prod((1.0 - WALLS) ** rows.hits, axis=1)
    own = spread_covariance(
        rows, replace(observed, timing_sd_s=0.0), energy, beams.direction[0], beams.cross,
        BANDWIDTH_HZ,
    )["interference"]  # fmt: skip
    amplitude = np.sqrt(energy)[:, None] * beam_patterns(-paths.arrival[rows.path].astype(float))
    rate_hz, n = 8000.0, 1024
    f = np.fft.rfftfreq(n, 1.0 / rate_hz)
    shape = frequency_response(BANK, f)[0]
    inside = shape > 0.0
    late = np.exp(-2j * np.pi * np.outer(rows.length_m / 340.0 + 0.01, f[inside])) * shape[inside]
    scale = 0.5 * n / np.sum(shape**2)  # a lone path has its own energy, by Parseval
    edges = np.rint((observed.edges_s + 0.01) * rate_hz).astype(int)
    drawn = []
    for _ in range(1500):
        phase = np.exp(2j * np.pi * rng.random(len(energy)))
        spectrum = np.zeros((7, f.size), dtype=complex)
        spectrum[:, inside] = (amplitude * phase[:, None]).T @ late
        pressure = np.fft.irfft(spectrum, n)
        drawn.append(np.add.reduceat(pressure**2, edges, axis=1)[:, :-1] * scale)
    scattered = np.array(drawn)
    power = np.einsum("dkk->dk", beams.cross[beams.direction[0]]).real
    bins = np.array(
        [np.bincount(window_of_rows(rows), energy * p, rows.n_windows) for p in power.T]
    )
    mean = (observed.spreading @ bins[:, : observed.spreading.shape[1]].T).T
    # a mean of 1,500 is known to 2 % of itself where a window's energy scatters by as much as it is
    np.testing.assert_allclose(scattered.mean(axis=0), mean, rtol=0.06)
    for w in range(observed.energy.size):
        empirical = np.cov(scattered[:, :, w].T)
        sd = np.sqrt(np.diag(empirical))
        off = (own[w] - empirical) / np.outer(sd, sd)
        if w:
            assert np.sqrt(np.mean(off**2)) < 0.12, (w, off.round(2))
        else:  # the direct sound and few others, farther apart than the filter rings: less
            assert np.all(np.diag(off) > 0.0)


def test_one_beam_is_the_window_of_the_omnidirectional_microphone():
    """The omnidirectional beam's interference and positions are those that `EnergyTerm` states."""
    _, omni, beams = image_case()
    values = {"absorption": WALLS, "gain": np.array([2.0])}
    expected = omni.variance_parts(values)
    first = 0
    for o, (rows, observed) in enumerate(zip(omni.rows, omni.observations, strict=True)):
        energy = 2.0 * rows.weight_per_m2 * np.prod((1.0 - WALLS) ** rows.hits, axis=1)
        found = spread_covariance(
            rows, observed, energy, beams.direction[o], beams.cross, BANDWIDTH_HZ
        )
        last = first + observed.energy.size
        for name in ("interference", "positions"):
            np.testing.assert_allclose(
                found[name][:, 0, 0], expected[name][first:last], rtol=1e-9, atol=1e-18
            )
        first = last


def test_a_lone_path_interferes_in_no_beam_and_all_of_them_hear_it_alike():
    """No covariance by phases, and a coherence of 1 between all beams that hear it."""
    _, omni, beams = image_case()
    rows, observed = omni.rows[0], omni.observations[0]
    energy = np.where(np.arange(len(rows)) == 0, rows.weight_per_m2, 0.0)
    found = spread_covariance(rows, observed, energy, beams.direction[0], beams.cross, BANDWIDTH_HZ)
    np.testing.assert_allclose(found["interference"], 0.0, atol=1e-12 * energy.sum() ** 2)
    np.testing.assert_allclose(found["coherence"][0], 1.0, rtol=1e-9)


def test_decorrelated_data_have_a_variance_of_one_and_its_parts_add_to_it():
    """Whatever the windows: that is what the roots are for."""
    _, _, term, unknown = case()
    objective = Objective(unknown, (term,))
    parts = objective.variance_parts(start_vector(unknown))
    np.testing.assert_allclose(total(parts), 1.0, rtol=1e-9)
    assert set(parts) == {"interference", "positions", "noise", "model", "ringing"}


def test_the_derivative_of_beams_is_that_of_their_differences():
    """Absorption, gain and levels, by forward differences."""
    _, _, term, unknown = case()
    objective = Objective(unknown, (term,))
    vector = start_vector(unknown) + 0.03 * np.arange(19)
    numeric = approx_fprime(vector, objective.expected, 1e-7)
    np.testing.assert_allclose(
        objective.jacobian(vector), numeric, atol=2e-6 * np.abs(numeric).max()
    )


def test_a_beam_that_is_louder_by_a_tenth_is_predicted_so_and_late_sound_by_its_own_level():
    """Undone by the inverse root: single windows of one beam change, those of others do not."""
    _, _, term, _ = case()
    level = np.zeros(15)
    values = {"absorption": WALLS, "gain": np.array([2.0]), "beam level": level}
    plain = term.windows.predict(values)[1]
    roots = [np.linalg.inv(r) for r in term.roots]
    level = level.copy()
    level[3], level[7 + 5] = np.log(1.1), np.log(1.2)
    expected = term.expected({**values, "beam level": level})
    undone = replace(term, roots=tuple(roots)).decorrelated(expected) - 1e-3
    n = term.windows.observations[0].energy.size
    ratio = (undone / plain).reshape(2, 7, n)
    late = term.late.reshape(2, 7, n)
    np.testing.assert_allclose(ratio[:, 3], 1.1, rtol=1e-9)
    np.testing.assert_allclose(ratio[:, 5], 1.2 ** late[:, 5], rtol=1e-9)
    np.testing.assert_allclose(ratio[:, [0, 1, 2, 4, 6]], 1.0, rtol=1e-9)
