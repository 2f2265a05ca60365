"""Information of pairs: parts that are eliminated, against the whole of all unknowns."""

from __future__ import annotations

from typing import Any

import numpy as np

from roomfit.design.information import (
    about_geometry,
    by_all_pairs,
    without_geometry,
)


def positive(rng: Any, n: int) -> Any:
    root = rng.normal(size=(n, n + 2))
    return root @ root.T


def left_of(whole: Any, kept: Any) -> Any:
    """Return the information on some unknowns when all others are found along with them."""
    return np.linalg.inv(np.linalg.inv(whole)[np.ix_(kept, kept)])


def test_a_geometry_is_integrated_out_under_what_all_bands_say_of_it():
    """Three bands of two unknowns each and one geometry of three, a unit prior on the latter."""
    rng = np.random.default_rng(1)
    first, n = 2, 3
    bands = [positive(rng, first + n) for _ in range(3)]
    whole = np.zeros((3 * first + n, 3 * first + n))
    for b, own in enumerate(bands):
        at = [*range(first * b, first * b + first), *range(3 * first, 3 * first + n)]
        whole[np.ix_(at, at)] += own
    whole[3 * first :, 3 * first :] += np.eye(n)
    found = without_geometry(bands, first, np.zeros(n, dtype=bool), 0)
    for b in range(3):
        expected = left_of(whole, [first * b, first * b + 1])
        np.testing.assert_allclose(found[b], expected, rtol=1e-4)
        alone = left_of(bands[b], [2, 3, 4])
        np.testing.assert_allclose(about_geometry(bands[b], first), alone, rtol=1e-4)


def test_other_pairs_inform_on_what_is_shared_with_positions_of_their_own():
    """Two more pairs: the whole of three sets of positions, each with a unit prior."""
    rng = np.random.default_rng(2)
    own = positive(rng, 4)
    shared = np.array([True, False, True, False])
    found = by_all_pairs(own, shared, 2)
    kept = np.flatnonzero(shared)
    with_prior = own + np.diag(np.where(shared, 0.0, 1.0))
    once = left_of(with_prior, kept)
    np.testing.assert_allclose(found - own, np.where(np.outer(shared, shared), 1.0, 0.0) * (
        np.zeros((4, 4)) + np.pad(2.0 * once, ((0, 2), (0, 2)))[np.ix_([0, 2, 1, 3], [0, 2, 1, 3])]
    ), rtol=1e-9, atol=1e-12)  # fmt: skip
    np.testing.assert_array_equal(by_all_pairs(own, shared, 0), own)
