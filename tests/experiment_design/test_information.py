"""Information of pairs: parts that are eliminated, against the whole of all unknowns."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from roomfit.experiment_design import design
from roomfit.experiment_design.information import (
    PairInformation,
    about_geometry,
    by_all_pairs,
    information_of,
    interval_widths,
    material_widths,
    without_gain,
    without_geometry,
)
from roomfit.logit import expit


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


def test_pairs_of_one_gain_inform_together_and_each_gain_is_found_along():
    """The Schur complement of their sum; known levels add what they have; none is the prior's."""
    rng = np.random.default_rng(3)
    matrices = np.array([[[positive(rng, 3)]] for _ in range(4)])
    unknowns: Any = SimpleNamespace(information=np.eye(2)[None, None])
    pairs = PairInformation(matrices, np.array([0, 0, 1, -1]))
    found = information_of(unknowns, pairs, [0, 1, 2, 3])[0, 0]
    m = matrices[:, 0, 0]
    expected = np.eye(2) + left_of(m[0] + m[1], [0, 1]) + left_of(m[2], [0, 1]) + m[3][:2, :2]
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    np.testing.assert_allclose(without_gain(m[2]), left_of(m[2], [0, 1]), rtol=1e-6)
    np.testing.assert_array_equal(information_of(unknowns, pairs, [])[0, 0], np.eye(2))
    apart = information_of(unknowns, PairInformation(matrices, np.arange(4)), [0, 1])[0, 0]
    together = information_of(unknowns, pairs, [0, 1])[0, 0]
    least, most = np.linalg.eigvalsh(together - apart)
    assert least > -1e-8 and most > 0.1


def test_widths_are_those_of_intervals_in_the_logit_between_bounds():
    """The mean over draws; known materials have none, tied ones that of their leader."""
    rng = np.random.default_rng(4)
    logit = rng.normal(size=(5, 2, 2))
    information = np.array([[positive(rng, 2) for _ in range(2)] for _ in range(5)])
    lower, upper = np.array([0.0, 0.1]), np.array([1.0, 0.7])
    unknowns: Any = SimpleNamespace(
        logit=logit, lower=lower, upper=upper, number=np.array([1, 2, 0, 1])
    )
    found = interval_widths(unknowns, information)
    for band in range(2):
        each = []
        for draw in range(5):
            sd = np.sqrt(np.diag(np.linalg.inv(information[draw, band])))
            ends = [expit(logit[draw, band] + z * sd) for z in (1.959964, -1.959964)]
            each.append((upper - lower) * (ends[0] - ends[1]))
        np.testing.assert_allclose(found[band], np.mean(each, axis=0), rtol=1e-6)
    wide = material_widths(unknowns, found)
    np.testing.assert_array_equal(wide, [found[:, 1], [0.0, 0.0], found[:, 0], found[:, 1]])


@pytest.mark.parametrize(
    ("level", "expected"),
    [("per-source", [1, 0, 1]), ("per-file", [0, 1, 2]), ("absolute", [-1, -1, -1])],
)
def test_pairs_share_the_gain_of_their_source_or_have_one_each_or_none(level, expected):
    scene: Any = SimpleNamespace(pairs=np.array([[1, 0], [0, 2], [1, 1]]))
    assert design._gains(level, scene).tolist() == expected
