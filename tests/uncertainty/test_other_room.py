"""What of an answer is taken along into another room."""

from __future__ import annotations

import numpy as np

from roomfit.materials.priors import MaterialPrior
from roomfit.uncertainty.other_room import _scattering


def test_scattering_is_that_which_was_found_where_it_was_fitted_else_as_specified():
    """One row a material: unspecified, specified, fitted, fitted without an answer in one band."""
    said = np.array([0.1, 0.2])
    priors = [
        MaterialPrior("a", np.zeros(2), np.ones(2)),
        MaterialPrior("b", np.zeros(2), np.ones(2), scattering=said),
        MaterialPrior("c", np.zeros(2), np.ones(2), scattering=said, fit_scattering=True),
        MaterialPrior("d", np.zeros(2), np.ones(2), scattering=said, fit_scattering=True),
    ]
    found = np.array([[0.5, 0.6], [0.5, 0.6], [0.5, 0.6], [0.5, np.nan]])
    taken = _scattering(priors, found)
    np.testing.assert_array_equal(taken, [[0.5, 0.6], said, [0.5, 0.6], said])
    assert np.isnan(found[3, 1]), "what was found stays as it was"
