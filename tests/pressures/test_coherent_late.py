"""Windows too late for pressures to add: there the partly coherent model is that of energies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_array

from coherent_cases import (
    CENTRE_HZ,
    END_S,
    MATERIALS,
    objective_of,
    small_geometry,
    small_scene,
    small_term,
)
from roomfit.base.bands import Bands
from roomfit.materials.priors import uniform_scattering
from roomfit.model.binned import bin_paths, in_band
from roomfit.model.energy import fine_edges_s, first_windows
from roomfit.model.parameters import start_vector
from roomfit.model.weighing import weigh
from roomfit.model.windows import in_windows, window_edges_s
from roomfit.pressures.data_term import CoherentTerm, with_coherence
from roomfit.signals.filters import spreading_kernel, spreading_matrix
from roomfit.tracing.paths import TraceSettings
from roomfit.tracing.trace import trace

CUT_S = 0.03


@pytest.fixture(scope="module")
def whole() -> CoherentTerm:
    """Return the small room, pressures in every window."""
    return with_coherence(small_term(CENTRE_HZ), 1e-4 * np.eye(small_geometry().sd.size))


@pytest.fixture(scope="module")
def cut(whole: CoherentTerm) -> CoherentTerm:
    """Return the same with pressures only in windows that end by CUT_S."""
    observed = tuple(first_windows(o, CUT_S) for o in whole.energies.observations)
    return replace(whole, early=observed)


def _late(term: CoherentTerm) -> np.ndarray:
    each = zip(term.energies.observations, term.early, strict=True)
    return np.concatenate([np.arange(o.energy.size) >= e.energy.size for o, e in each])


def test_first_windows_end_by_the_time_asked_for(whole: CoherentTerm) -> None:
    """All that end by then, with their pieces, and one at least."""
    observed = whole.energies.observations[0]
    early = first_windows(observed, CUT_S)
    assert early.edges_s[-1] <= CUT_S < observed.edges_s[early.edges_s.size]
    assert early.fine_edges_s[-1] == early.edges_s[-1]
    assert early.fine_spreading.shape[0] == early.fine_edges_s.size - 1
    assert first_windows(observed, -1.0).energy.size == 1
    assert first_windows(observed, END_S).energy.size == observed.energy.size


def test_early_windows_do_not_see_where_pressures_end(
    whole: CoherentTerm, cut: CoherentTerm
) -> None:
    """Expectation, derivative and variance of the early windows are those of the whole problem."""
    some, every, early = objective_of(cut), objective_of(whole), ~_late(cut)
    vector = start_vector(every.parameters)
    ours, all_of_it = some.predict(vector), every.predict(vector)
    assert 0 < early.sum() < early.size
    np.testing.assert_allclose(ours.expected[early], all_of_it.expected[early], rtol=1e-12)
    scale = np.abs(all_of_it.jacobian).max()
    np.testing.assert_allclose(
        ours.jacobian[early], all_of_it.jacobian[early], rtol=0, atol=1e-12 * scale
    )
    np.testing.assert_allclose(
        some.variance(vector)[early], every.variance(vector)[early], rtol=1e-12
    )


def test_late_windows_are_those_of_energies(whole: CoherentTerm, cut: CoherentTerm) -> None:
    """Beyond the cut all that depends on phase is gone, and without the cut it is not."""
    some, energies, late = objective_of(cut), objective_of(cut.energies), _late(cut)
    vector = start_vector(some.parameters)
    n = start_vector(energies.parameters).size
    expected = energies.predict(vector[:n])
    ours = some.predict(vector)
    np.testing.assert_array_equal(ours.expected[late], expected.expected[late])
    np.testing.assert_array_equal(ours.jacobian[late, :n], expected.jacobian[late])
    assert not ours.jacobian[late, n:].any()
    np.testing.assert_array_equal(some.variance(vector)[late], energies.variance(vector[:n])[late])
    with_phase = objective_of(whole).predict(vector).expected[late]
    assert np.abs(with_phase / expected.expected[late] - 1.0).max() > 0.05


def test_bins_that_grow_late_hold_the_same_rows_and_expect_the_same_energies() -> None:
    """A trace of rays in a box: windows from growing bins against windows from the finest ones."""
    scene = small_scene()
    paths = trace(scene, TraceSettings(0.9, 4000, 1), uniform_scattering(MATERIALS, 0.3)).paths
    bands = Bands("octave", np.array([4000.0]))
    fine = bin_paths(scene, bands, paths, 0.9)
    grown = in_band(fine, 4000.0)
    assert grown.edges_s.size < 0.25 * fine.edges_s.size
    assert len(grown.rows[0]) == len(fine.rows[0])
    edges = window_edges_s(0.01, 0.85, 2800.0)
    a, still = np.full((3, 1), 0.2), np.zeros(1)
    kernel = spreading_kernel(bands)
    found = []
    for binned in (fine, grown):
        middles = 0.5 * (binned.edges_s[1:] + binned.edges_s[:-1])
        energy = weigh(binned.rows[0], a, still, derivative=False).energy[0]
        found.append(spreading_matrix(kernel, 0, middles, edges) @ energy)
    # a bin is a fortieth of a window at most: an edge moves less than half of that, 1.25 % of what
    # stands there, and the Poisson noise of some hundred rays a bin is no more
    np.testing.assert_allclose(found[1], found[0], rtol=0.02)


def test_rows_of_bins_are_carried_into_windows_as_a_matrix_product_would() -> None:
    """Against scipy's own product, some windows empty."""
    rng = np.random.default_rng(4)
    dense = rng.random((7, 50)) * (rng.random((7, 50)) < 0.2)
    dense[3] = 0.0
    rows = rng.random((5, 50))
    np.testing.assert_allclose(in_windows(csr_array(dense), rows.T), dense @ rows.T, rtol=1e-13)


def test_pressures_that_are_known_early_need_no_later_grid() -> None:
    """Where late times are uncertain the grid ends early, and nothing else changes."""
    term = small_term(CENTRE_HZ)
    covariance = np.diag(np.where(np.arange(14) == 9, 1e4, 1e-9))  # of ln c: late is uncertain
    short = with_coherence(term, covariance)
    assert 0 < short.coherent.row.size < short.images.weight.size
    assert short.grid.n < term.grid.n
    long, at = replace(short, grid=term.grid), objective_of(short)
    vector = start_vector(at.parameters)
    found, expected = at.predict(vector), objective_of(long).predict(vector)
    # of the largest: the filter has 1e-7 of its energy beyond the padding
    for a, b in ((found.expected, expected.expected), (found.jacobian, expected.jacobian)):
        np.testing.assert_allclose(a, b, rtol=1e-4, atol=2e-6 * np.abs(b).max())
    np.testing.assert_allclose(at.variance(vector), objective_of(long).variance(vector), rtol=1e-3)


def test_fine_windows_are_of_half_the_inverse_bandwidth_or_as_they_are():
    """Eight pieces at most, and one of a window that is too short to be cut."""
    edges_s = np.array([0.0, 0.001, 0.006, 0.016, 0.116])
    found = fine_edges_s(edges_s, 100.0)  # pieces of 5 ms
    expected = [0.0, 0.001, 0.006, 0.011, *np.linspace(0.016, 0.116, 9)]
    np.testing.assert_allclose(found, expected, rtol=1e-9)
