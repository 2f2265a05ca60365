"""Windows of displaced image sources beside paths that stay: the variance of energies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_array

from coherent_cases import small_term
from roomfit.objective.early import DisplacedTerm, fixed_paths


@pytest.mark.parametrize("gain", [1e-3, 1.0, 300.0])
def test_where_no_image_moves_the_variance_is_that_of_the_windows(gain):
    """Noise and errors of the model, of paths that all stay, at the answer; by another class.

    Up to half of what was measured is noise. At the lowest gain what was measured is far above what
    is expected and decides the error of the model; there single reflections, which the two classes
    do not count alike where none moves, are a millionth of the noise.
    """
    energies = small_term().energies
    loud = tuple(
        replace(o, energy=np.linspace(1.0, 3.0, o.energy.size), noise=np.full(o.energy.size, 0.5))
        for o in energies.observations
    )
    term = replace(energies, observations=loud, model_error=0.2, ringing_error=0.1)
    absorption = np.linspace(0.1, 0.3, term.rows[0].hits.shape[1])
    kept = fixed_paths(term, None, absorption, np.zeros((0, 3)))
    no_image, n = np.zeros((0, absorption.size)), term.measured().size
    shares, fine = csr_array((n, 0)), csr_array((kept.fine_energy.size, 0))
    still = DisplacedTerm(
        kept, np.zeros(0, np.int64), no_image, no_image[:, 0], no_image[:, :3],
        spreading=shares, fine_spreading=fine, squared_fine=fine, squared_slopes=shares,
    )  # fmt: skip
    values = {"absorption": absorption, "gain": np.array([gain])}
    np.testing.assert_allclose(still.expected(values), term.expected(values), rtol=1e-12)
    found, wanted = still.variance_parts(values), term.variance_parts(values)
    for name in ("model", "ringing"):
        assert wanted[name].max() > 0.0
        np.testing.assert_allclose(found[name], wanted[name], rtol=1e-10)
    assert np.all(found["reflections"] >= wanted["noise"] * (1.0 - 1e-12))
    if gain < 1.0:
        np.testing.assert_allclose(found["reflections"], wanted["noise"], rtol=1e-6)
