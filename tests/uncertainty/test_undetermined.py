"""What the data leave open, in words; and what each material contributes to the absorption."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roomfit.uncertainty.combinations import (
    Undetermined,
    absorption_shares,
    determined,
    information_directions,
    undetermined_groups,
)

NAMES = ("floor", "ceiling", "walls")


def posterior(rows, n: int, sd: float = 1.5):
    """Return the covariance of n logits that some linear data see, exactly nearly."""
    J = np.asarray(rows, dtype=np.float64)
    return np.linalg.inv(1e6 * J.T @ J + np.eye(n) / sd**2)


def floor_and_ceiling():
    """A decay knows 0.5 floor + 0.5 ceiling within 0.004 in logits, and the walls alone."""
    a, prior = np.array([0.1, 0.12, 0.2]), 1.5**2 * np.eye(3)
    slope = a * (1.0 - a)
    rows = np.array([[0.5 * slope[0] / 0.002, 0.5 * slope[1] / 0.002, 0.0], [0.0, 0.0, 100.0]])
    return a, np.linalg.inv(rows.T @ rows + np.linalg.inv(prior)), prior


def test_floor_and_ceiling_are_reported_together_and_their_difference_as_open():
    a, covariance, before = floor_and_ceiling()
    prior = np.full((3, 1), -1.7), before[None]
    areas_m2 = np.array([20.0, 20.0, 60.0])
    (found,) = determined(NAMES, a[:, None], covariance[None], prior, areas_m2, 1)

    assert found.sentence == (
        "floor and ceiling together 0.110 ± 0.005; their difference is not in the data"
    )
    (difference,) = found.combinations[1].differences
    assert difference.weights.tolist() == [-1.0, 1.0, 0.0]
    assert difference.value == pytest.approx(0.02)
    assert not difference.determined
    # a sum of 0.22 leaves room for a difference of 0.2 either way
    assert difference.upper95 - difference.lower95 > 0.2
    assert found.combinations[0].differences == ()


@settings(max_examples=60, deadline=None)
@given(st.integers(2, 7), st.data())
def test_what_is_open_has_as_many_directions_as_the_data_lack(n, data):
    """Dense data of k < n kinds see k directions of the n; the projector's trace is the rest."""
    k = data.draw(st.integers(0, n - 1))
    rng = np.random.default_rng(data.draw(st.integers(0, 1000)))
    rows = rng.uniform(0.5, 1.0, (k, n)) + 3.0 * np.eye(k, n)
    covariance = posterior(rows, n)
    left, directions, own = information_directions(covariance, 1.5**2 * np.eye(n))

    np.testing.assert_allclose(left[k:], 1.0, rtol=1e-6)
    assert np.all(left[:k] < 1e-2)
    assert np.abs(rows @ directions[:, k:]).max(initial=0.0) < 1e-4
    assert own.tolist() == list(range(n))
    found = undetermined_groups(covariance, 1.5**2 * np.eye(n))
    # a material's small part in a direction is not named, so whole ones may be missing at the edge
    assert abs(sum(u.directions for u in found) - (n - k)) <= (0 if k == 0 else 1)


def test_held_and_tied_materials_open_nothing_by_themselves():
    """A tie is no exchange: two rows of one unknown are one direction of one material."""
    covariance = np.zeros((3, 3))
    covariance[:2, :2] = 1.5**2
    assert undetermined_groups(covariance, 1.5**2 * np.eye(3)) == (Undetermined((0,), 1, False),)
    assert undetermined_groups(np.zeros((3, 3)), np.eye(3)) == ()


def test_shares_agree_with_the_tangent_where_errors_are_small():
    """Gaussian errors of 1 %: the interval of A1 / (A1 + A2) by its derivative.

    Half the distance of the two outer quantiles of 4000 draws has a standard error of 2.4 %
    (sqrt(p (1 - p) / n) over the density, two ends): four of them, wrong once in 16,000 seeds.
    """
    rng = np.random.default_rng(2)
    areas, a = np.array([10.0, 40.0]), np.array([0.4, 0.2])
    draws = a * (1.0 + 0.01 * rng.standard_normal((4000, 2)))
    value, low, high = absorption_shares(areas, a, draws)
    np.testing.assert_allclose(value, [1.0 / 3.0, 2.0 / 3.0])
    half = 1.96 * 0.01 * np.sqrt(2.0) * (1.0 / 3.0) * (2.0 / 3.0)
    np.testing.assert_allclose(0.5 * (high - low), half, rtol=0.1)
    # what one gains the other loses
    np.testing.assert_allclose(low[0], 1.0 - high[1])


def test_a_share_is_known_where_only_the_ratio_is():
    """A common factor on all absorptions, as an unknown gain leaves it, changes no share."""
    a = np.array([0.1, 0.2, 0.05])
    factor = np.linspace(0.5, 2.0, 50)[:, None]
    value, low, high = absorption_shares(np.ones(3), a, a * factor)
    np.testing.assert_allclose(low, value)
    np.testing.assert_allclose(high, value)
    assert absorption_shares(np.ones(1), np.zeros(1), np.zeros((5, 1)))[0] == 0.0
