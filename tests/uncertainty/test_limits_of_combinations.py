"""From where on a mean, a difference or a direction counts as known: both sides of each limit."""

from __future__ import annotations

import numpy as np

from roomfit.uncertainty.combinations import (
    Combination,
    Undetermined,
    inseparable_findings,
    undetermined_groups,
)


def test_a_direction_is_open_where_four_fifths_of_the_prior_are_left():
    """Of two materials that compensate each other, and of one by itself."""
    prior = 2.25 * np.eye(3)
    for left, is_open in ((0.801, True), (0.799, False)):
        against = np.array([1.0, -1.0, 0.0]) / np.sqrt(2.0)
        covariance = 2.25 * (0.01 * np.eye(3) + (left**2 - 0.01) * np.outer(against, against))
        found = undetermined_groups(covariance, prior)
        assert found == ((Undetermined((0, 1), 1, True),) if is_open else ())
        along = np.abs(against)
        covariance = 2.25 * (0.01 * np.eye(3) + (left**2 - 0.01) * np.outer(along, along))
        found = undetermined_groups(covariance, prior)
        assert found == ((Undetermined((0, 1), 1, False),) if is_open else ())
    alone = 2.25 * np.diag([0.01, 0.99, 0.99])
    assert undetermined_groups(alone, prior) == (
        Undetermined((1,), 1, False), Undetermined((2,), 1, False),
    )  # fmt: skip
    # what takes part by less than a tenth of the projector is not named
    for part, names in ((0.11, (0, 1)), (0.09, (1,))):
        direction = np.array([np.sqrt(part), np.sqrt(1.0 - part), 0.0])
        covariance = 2.25 * (0.01 * np.eye(3) + 0.97 * np.outer(direction, direction))
        (found_one,) = undetermined_groups(covariance, prior)
        assert found_one.materials == names and found_one.directions == 1


def test_materials_are_not_separable_where_none_is_identifiable_and_their_mean_is_known():
    """To a tenth; of two materials or more."""
    rooms = [(Combination(np.ones(2), 0.3, 0.3 - h, 0.3 + h, 0.1),) for h in (0.0299, 0.0301, 0.02)]
    identifiable = np.array([[False, False, True], [False, False, False]])
    centres_hz = np.array([500.0, 1000.0, 2000.0])
    (found,) = inseparable_findings(("a", "b"), centres_hz, identifiable, rooms)
    assert found.evidence == {"bands_hz": [500.0], "materials": ["a", "b"]}
    assert "at 500 Hz (10 %)" in found.sentence
    assert inseparable_findings(("a",), centres_hz, identifiable[:1], rooms) == ()
    assert inseparable_findings(("a", "b"), centres_hz, identifiable | True, rooms) == ()
