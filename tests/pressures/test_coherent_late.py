"""Windows too late for pressures to add: there the partly coherent model is that of energies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from coherent_cases import (
    CENTRE_HZ,
    objective_of,
    small_geometry,
    small_term,
)
from roomfit.model.energy import first_windows
from roomfit.model.parameters import start_vector
from roomfit.pressures.data_term import CoherentTerm, with_coherence

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
