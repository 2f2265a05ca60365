"""From where on a mean, a difference or a direction counts as known: both sides of each limit."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from roomfit.uncertainty import combinations
from roomfit.uncertainty.combinations import (
    Combination,
    Difference,
    Undetermined,
    inseparable_findings,
    undetermined_groups,
)
from roomfit.uncertainty.profile import RISE95, _Line

Z95 = 1.959964


def spread(middle: float, half: float, n: int = 2001) -> Any:
    """Return values whose 95 % interval reaches so far to either side of the middle."""
    return middle + half * np.linspace(-1.0, 1.0, n) / 0.95


def test_a_mean_is_determined_to_a_tenth_where_the_data_halve_the_spread_of_its_prior():
    """By area; the interval reaches to the answer where that lies aside."""
    areas, a = np.array([10.0, 30.0, 5.0]), np.array([0.3, 0.3, 0.9])
    for half, before, is_known in (
        (0.0299, 0.5, True),
        (0.0301, 0.5, False),
        (0.0299, 0.0599, True),
        (0.0299, 0.0597, False),
    ):
        drawn = np.stack([spread(0.3, half)] * 2 + [spread(0.9, 0.1)], axis=1)
        prior = np.stack([spread(0.3, before)] * 3, axis=1)
        found = combinations._combination((0, 1), areas, a, (drawn, prior), 0.1)
        np.testing.assert_allclose(found.weights, [0.25, 0.75, 0.0])
        np.testing.assert_allclose([found.value, found.lower95, found.upper95],
                                   [0.3, 0.3 - half, 0.3 + half], rtol=1e-9)  # fmt: skip
        assert found.sd == pytest.approx(np.std(drawn[:, 0]))
        assert found.determined is is_known
    aside = combinations._combination((0, 1), areas, a + 0.5, (drawn, prior), 0.1)
    assert aside.upper95 == aside.value == pytest.approx(0.8)


def test_a_difference_is_known_to_a_tenth_of_the_larger_where_its_spread_is_halved():
    """Of those that compensate each other; the larger less the other."""
    a, n = np.array([0.2, 0.5, 0.4]), 2001
    group = Undetermined((0, 1), 1, True)
    for half, before, is_known in (
        (0.0499, 1.0, True),
        (0.0501, 1.0, False),
        (0.0499, 0.0999, True),
        (0.0499, 0.0997, False),
    ):
        drawn = np.stack([np.full(n, 0.2), spread(0.5, half, n), np.full(n, 0.4)], axis=1)
        apart = spread(0.5, before, n)  # materials that are expected to rise together
        prior = np.stack([0.5 * apart, 1.5 * apart, np.zeros(n)], axis=1)
        (found,) = combinations._differences([group], a, drawn, prior, 0.1)
        np.testing.assert_array_equal(found.weights, [-1.0, 1.0, 0.0])
        assert found.value == pytest.approx(0.3)
        np.testing.assert_allclose([found.lower95, found.upper95], [0.3 - half, 0.3 + half])
        assert found.determined is is_known
    alike = Undetermined((0, 1), 1, False)
    assert combinations._differences([alike], a, drawn, prior, 0.1) == []


def test_a_difference_stands_with_the_smallest_group_that_has_both():
    def group(*weights: float) -> Combination:
        return Combination(np.array(weights), 0.3, 0.2, 0.4, 0.05)

    kept = (group(0.2, 0.3, 0.5), group(0.4, 0.6, 0.0), group(0.0, 0.4, 0.6))
    own = [Difference(np.array(w), 0.1, 0.0, 0.2, True)
           for w in ([1.0, -1.0, 0.0], [-1.0, 0.0, 1.0], [0.0, 1.0, -1.0])]  # fmt: skip
    found = combinations._with_differences(kept, own)
    assert [len(c.differences) for c in found] == [1, 1, 1]
    assert found[1].differences == (own[0],) and found[0].differences == (own[1],)
    assert combinations._with_differences((kept[1],), own[2:]) == (kept[1],)


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


def test_relations_are_taken_apart_into_what_hangs_together():
    """Over chains of any length; what is not even its own is left out."""
    linked = np.eye(6, dtype=bool)
    for i, j in ((0, 2), (2, 5), (3, 4)):
        linked[i, j] = linked[j, i] = True
    assert combinations._connected(linked) == [[0, 2, 5], [1], [3, 4]]
    linked[1, 1] = False
    assert combinations._connected(linked) == [[0, 2, 5], [3, 4]]


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


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_end_of_a_straight_profile_is_found_in_one_step_from_anywhere_near(sign):
    """Its root rises by 1 / (sd sqrt 2): one step of Newton; no farther than 1.96 deviations.

    An absorption is sought no farther than 14 in the logit.
    """
    sd = 0.5
    line: Any = SimpleNamespace(
        fit=SimpleNamespace(vector=np.array([0.2])), entry=0, sd=sd, _apart=lambda *_: 1.0
    )

    def step(here: float, at: Any = line) -> tuple[float, bool, Any]:
        bracket: Any = [(0.0, 0.0, np.sqrt(0.5) / sd), (np.inf, np.inf, 0.0)]
        rise, slope = 0.5 * (here / sd) ** 2, sign * here / sd**2
        return (*_Line.towards_end(at, sign, here, rise, slope, bracket), bracket)

    end = Z95 * sd
    for here in (0.6 * end, 0.99 * end, 1.01 * end):
        found, _, bracket = step(here)
        assert found == pytest.approx(end, rel=1e-3 if here > end else 1e-6)
        assert bracket[0][0] in (0.0, here) and bracket[1][0] in (np.inf, here)
    near, is_end, _ = step(end * np.sqrt(1.01))
    assert is_end and near == pytest.approx(end, rel=1e-6)
    # a root that hardly rises says little: not beyond one interval more
    far, is_end, _ = step(1e-9)
    assert far == pytest.approx(1e-9 + Z95 * sd, rel=1e-2) and not is_end
    bracket: Any = [(0.0, 0.0, 1.0), (np.inf, np.inf, 0.0)]
    flat, _ = _Line.towards_end(line, sign, 0.1, 1e-9, 0.0, bracket)
    assert flat == pytest.approx(0.1 + Z95 * sd, rel=1e-6)
    edge: Any = SimpleNamespace(
        fit=SimpleNamespace(vector=np.array([sign * 13.9])), entry=0, sd=sd, _apart=lambda *_: 1.0
    )
    last, is_end, _ = step(0.05, edge)
    assert last == pytest.approx(0.1, abs=1e-9) and is_end
    assert pytest.approx(0.5 * Z95**2, rel=1e-6) == RISE95
