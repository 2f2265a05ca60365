"""What the data leave open, in words; and what each material contributes to the absorption."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from report_cases import answer_of, scene_of
from roomfit.base.whole_files import json_text
from roomfit.files.results import result_content
from roomfit.report.tables import share_tables
from roomfit.report.wording import DASH
from roomfit.uncertainty.combinations import (
    Combination,
    Determined,
    Difference,
    Undetermined,
    absorption_shares,
    band_sentence,
    determined,
    find_combinations,
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
        "floor and ceiling together 0.110 +- 0.005; their difference is not in the data"
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


def test_materials_of_which_nothing_is_known_are_named_in_one_sentence():
    found = undetermined_groups(posterior([[0.0, 0.0, 1.0]], 3), 1.5**2 * np.eye(3))
    assert found == (Undetermined((0,), 1, False), Undetermined((1,), 1, False))
    assert band_sentence(NAMES, (), found) == "floor and ceiling are not in the data"


def test_within_a_group_they_are_named_in_one_sentence_too():
    whole = Combination(np.full(3, 1.0 / 3.0), 0.2, 0.18, 0.22, 0.01)
    alone = [Undetermined((0,), 1, False), Undetermined((1,), 1, False)]
    assert band_sentence(NAMES, (whole, whole), alone) == (
        "floor, ceiling and walls together 0.20 +- 0.02; floor and ceiling are not in the data"
    )


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ([1.0, 1.0, 0.0], "the difference of floor and ceiling is not in the data"),
        ([1.0, -1.0, 0.0], "the sum of floor and ceiling is not in the data"),
        ([1.0, 1.0, 1.0], "of floor, ceiling and walls only one mean is in the data"),
    ],
)
def test_what_is_open_is_said_as_what_it_is(row, words):
    rows = [row] if row[2] else [row, [0.0, 0.0, 1.0]]
    found = undetermined_groups(posterior(rows, 3), 1.5**2 * np.eye(3))
    assert band_sentence(NAMES, (), found) == words


@pytest.mark.parametrize(
    ("directions", "against", "words"),
    [
        (2, True, "how it is shared among them is not in the data"),
        (1, True, "of floor, ceiling and walls only 2 means are in the data"),
        (2, False, "of floor, ceiling and walls only one mean is in the data"),
    ],
)
def test_a_mean_of_three_with_two_directions_open_leaves_how_it_is_shared(
    directions, against, words
):
    """Three shares of one sum are two numbers; with one of them open two means are known."""
    whole = Combination(np.full(3, 1.0 / 3.0), 0.2, 0.18, 0.22, 0.01)
    left_open = [Undetermined((0, 1, 2), directions, against)]
    assert band_sentence(NAMES, (whole, whole), left_open) == (
        f"floor, ceiling and walls together 0.20 +- 0.02; {words}"
    )


def test_held_and_tied_materials_open_nothing_by_themselves():
    """A tie is no exchange: two rows of one unknown are one direction of one material."""
    covariance = np.zeros((3, 3))
    covariance[:2, :2] = 1.5**2
    assert undetermined_groups(covariance, 1.5**2 * np.eye(3)) == (Undetermined((0,), 1, False),)
    assert undetermined_groups(np.zeros((3, 3)), np.eye(3)) == ()


def test_where_all_is_known_nothing_is_said():
    a, prior = np.full((3, 1), 0.3), (np.zeros((3, 1)), np.eye(3)[None])
    (found,) = determined(NAMES, a, 1e-6 * np.eye(3)[None], prior, np.ones(3), 1)
    assert found.sentence == ""


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


def test_text_report_and_result_tell_shares_and_what_is_open():
    scene = scene_of(NAMES)
    answer = answer_of(scene, low=500, high=1000)
    a, covariance, before = floor_and_ceiling()
    group = find_combinations(
        np.array([20.0, 20.0, 60.0]),
        a,
        covariance,
        np.full(3, -1.7),
        before,
        np.random.default_rng(1),
    )
    sentence = "floor and ceiling together 0.31 +- 0.02; their difference is not in the data"
    shares = np.array([np.full(3, x) for x in (0.3, 0.2, 0.4)])
    known = Determined(group, "", shares), Determined(group, sentence, shares)
    answer = replace(answer, determined=known)

    assert sentence.replace("+-", "±") in " ".join(str(answer).split())
    (table,) = share_tables(answer)
    assert [(c.text, c.small) for c in table.rows[0][1:]] == [("30", (f"20{DASH}40",))] * 2
    content = json.loads(json_text(result_content(answer, ())))
    assert content["materials"]["floor"]["share_upper95"] == [0.4, 0.4]
    reported = [c for c in content["combinations"] if c["band_hz"] == 1000.0]
    assert reported[0]["sentence"] == sentence
    assert reported[0]["kind"] == "mean"
    assert reported[1]["determined"]
    assert reported[1]["differences"][0]["weights"] == {"floor": -1.0, "ceiling": 1.0}
    assert all(sum(c["weights"].values()) == pytest.approx(1.0, abs=1e-5) for c in reported)


def test_a_difference_is_reported_the_larger_less_the_smaller():
    a, covariance, before = floor_and_ceiling()
    found = find_combinations(
        np.ones(3), a, covariance, np.full(3, -1.7), before, np.random.default_rng(1)
    )
    differences = [d for c in found for d in c.differences]
    assert all(isinstance(d, Difference) and d.value >= 0.0 for d in differences)
    assert len(differences) == 1
