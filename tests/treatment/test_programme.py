"""The search for arrangements where numbers are formulas: all arrangements can be counted."""

from __future__ import annotations

from itertools import product
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr

from roomfit.bands import bands_between
from roomfit.logit import logit
from roomfit.treatment import question as questions
from roomfit.treatment import search, treat
from roomfit.treatment.question import Product, Target, limits_of, treated, treated_draws

TARGETS = (
    Target("T30_s", high=0.8),
    Target("T30_s", low=0.5, high=0.9),
    Target("C80_dB", low=2.0),
)


def asked(seed: int, targets: tuple[Target, ...] = TARGETS) -> Any:
    """Return a question of two surfaces and four columns, with what each piece does to a row."""
    rng = np.random.default_rng(seed)
    return SimpleNamespace(
        cost=rng.integers(1, 9, 4).astype(float),
        most=np.array([4.0, 3.0, 3.0, 2.0]),
        surface=(0, 0, 1, 1),
        product=(0, 1, 0, 1),
        piece_m2=np.array([1.0, 2.0, 1.0, 2.0]),
        free_m2={0: 5.0, 1: 4.0},
        target=tuple(range(len(targets))),
        targets=targets,
        inverse=1.0 / 1.2,
        gains=rng.uniform(0.03, 0.2, (len(targets), 4)),
        levels=rng.uniform(0.1, 1.0, (len(targets), 4)),
    )


def by_formula(question: Any, pieces: Any) -> Any:
    """Return times whose inverse, and levels which themselves, are linear in the pieces."""
    rows = [
        1.0 / (question.inverse + pieces @ question.gains[r])
        if question.targets[t].parameter == "T30_s"
        else pieces @ question.levels[r] - 1.0
        for r, t in enumerate(question.target)
    ]
    return np.stack(rows, axis=-1)


def counted(question: Any) -> Any:
    """Return all arrangements that fit on both surfaces."""
    every = np.array(list(product(*(range(int(n) + 1) for n in question.most))), dtype=float)
    area = every * question.piece_m2
    return every[(area[:, :2].sum(axis=1) <= 5.0) & (area[:, 2:].sum(axis=1) <= 4.0)]


@pytest.mark.parametrize("seed", range(3))
def test_no_arrangement_that_keeps_all_limits_is_cheaper_than_the_one_found(monkeypatch, seed):
    """With a margin, under a highest price, and beside a set of columns that is excluded.

    A tenth of a step less than a limit is let pass, but not sought.
    """
    monkeypatch.setattr(search, "numbers_of", by_formula)
    question, every = asked(seed), counted(asked(seed))
    none, some = np.zeros(3), np.array([0.05, 0.03, 0.5])
    first, _ = search.best_arrangement(question, none)
    price = question.cost @ first
    for margin, most_cost, excluded in (
        (none, np.inf, []),
        (some, np.inf, []),
        (none, np.inf, [first > 0]),
        (none, price, []),
        (none, price - 0.5, []),
    ):
        allowed = every[every @ question.cost <= most_cost]
        for used in excluded:
            allowed = allowed[~np.all((allowed > 0) == used, axis=1)]
        pieces, numbers = search.best_arrangement(question, margin, excluded, most_cost)
        np.testing.assert_allclose(numbers, by_formula(question, pieces))
        assert np.any(np.all(allowed == pieces, axis=1))
        rows = by_formula(question, allowed)
        missed = search.excess(question, rows, margin).sum(axis=1)
        with monkeypatch.context() as patch:
            patch.setattr(search, "MET", 0.0)
            is_strict = ~search.excess(question, rows, margin).any(axis=1)
        own = search.excess(question, numbers, margin).sum()
        if is_strict.any():
            assert own == 0.0
            costs = allowed @ question.cost
            assert costs[missed == 0.0].min() <= question.cost @ pieces <= costs[is_strict].min()
        elif (missed > 0.0).all():
            assert own <= 1.3 * missed.min()


def test_misses_are_counted_in_units_of_the_limit_or_of_twenty_steps():
    """Of a time its limit, of a share 100 %, of a centre time 200 ms; a tenth of a step is met."""
    targets = (
        Target("T30_s", high=0.8),
        Target("T30_s", low=0.5),
        Target("C80_dB", low=2.0, high=6.0),
        Target("D50_percent", low=50.0),
        Target("TS_ms", high=80.0),
        Target("STI", low=0.6),
    )
    question = asked(1, targets)
    np.testing.assert_allclose(search.scale_of(question), [0.8, 0.5, 20.0, 100.0, 200.0, 0.6])
    numbers = np.array([1.0, 0.4, 1.0, 40.0, 100.0, 0.3])
    none = np.zeros(6)
    expected = [0.2 / 0.8, 0.1 / 0.5, 1.0 / 20.0, 0.1, 0.1, 0.5]
    np.testing.assert_allclose(search.excess(question, numbers, none), expected)
    above = np.array([0.8, 0.5, 8.0, 60.0, 80.0, 0.6])
    np.testing.assert_allclose(search.excess(question, above, none), [0, 0, 0.1, 0, 0, 0])
    kept = search.excess(question, above, np.array([0.08, 0.05, 1.0, 20.0, 20.0, 0.06]))
    np.testing.assert_allclose(kept, [0.1, 0.1, 3.0 / 20.0, 0.1, 0.1, 0.1])
    assert search.excess(question, np.full(6, np.nan), none).tolist() == [1.0] * 6
    for share, is_met in ((0.0049, True), (0.0051, False)):
        near = above[:1] * (1.0 + share)
        found = search.excess(asked(1, targets[:1]), near, none[:1])
        assert bool(found[0] == 0.0) is is_met
    low, high = limits_of(question)
    np.testing.assert_array_equal(low, [-np.inf, 0.5, 2.0, 50.0, -np.inf, 0.6])
    np.testing.assert_array_equal(high, [0.8, np.inf, 6.0, np.inf, 80.0, np.inf])


def test_slopes_are_those_of_one_step_up_or_down_where_nothing_more_fits(monkeypatch):
    """Of inverse times and plain levels, which are linear here: the formulas' own."""
    monkeypatch.setattr(search, "numbers_of", by_formula)
    question = asked(2)
    for here in (np.zeros(4), np.array([4.0, 1.0, 3.0, 0.0]), question.most):
        numbers = by_formula(question, here)
        for step in (np.ones(4), question.most):
            found = search._slopes(question, here, numbers, step)
            expected = np.array([question.gains[0], question.gains[1], question.levels[2]])
            np.testing.assert_allclose(found, expected, rtol=1e-9)
    worth = search._worth(question, np.array([1.0, 0, 2.0, 0]), np.array([0.88, 0.7, 1.0]), 0.0)
    cost = question.cost[0] + 2.0 * question.cost[2]
    assert worth == pytest.approx((0.1 + 0.05, cost + 3e-9), abs=1e-12)


def test_moves_add_take_and_exchange_pieces_by_their_area():
    """One more of each; one, a quarter or all less; and as much of another, or one piece."""
    question: Any = SimpleNamespace(piece_m2=np.array([1.0, 3.0]))
    found = {tuple(m) for m in search._moves(question, np.array([7.0, 0.0])).tolist()}
    assert found == {
        *((1.0, 0.0), (0.0, 1.0)),
        *((-1.0, 0.0), (-2.0, 0.0), (-7.0, 0.0)),
        *((-1.0, 1.0), (-2.0, 1.0), (-7.0, 2.0), (-7.0, 1.0)),
    }
    found = {tuple(m) for m in search._moves(question, np.array([0.0, 2.0])).tolist()}
    assert found == {
        *((1.0, 0.0), (0.0, 1.0)),
        *((0.0, -1.0), (0.0, -2.0)),
        *((3.0, -1.0), (1.0, -1.0), (6.0, -2.0), (1.0, -2.0)),
    }


def test_a_surface_that_is_covered_in_part_has_the_mean_by_area_and_so_have_its_draws():
    """Two products on one wall, and one that is of the room: it varies with what is known of it."""
    rng = np.random.default_rng(3)
    own, drawn = rng.uniform(0.1, 0.3, (2, 2)), rng.uniform(0.1, 0.3, (5, 2, 2))
    known = SimpleNamespace(materials=("wall", "felt"), absorption=own)
    room: Any = SimpleNamespace(seed=4, draws=drawn, absorption=known)
    foam = Product("foam", np.array([0.5, 0.8]), np.array([0.05, 0.02]))
    felt = Product("felt", own[1], np.zeros(2), material="felt")
    every = questions._product_draws(room, (foam, felt))
    np.testing.assert_array_equal(every[:, 1], drawn[:, 1])
    np.testing.assert_array_equal(every, questions._product_draws(room, (foam, felt)))
    # the same error in the logit of every band, to first order 0.05 and 0.02
    z = (logit(every[:, 0]) - logit(foam.absorption)) * foam.absorption * (1 - foam.absorption)
    np.testing.assert_allclose(z[:, 0] / 0.05, z[:, 1] / 0.02, rtol=0.35)
    question: Any = SimpleNamespace(
        room=room, products=(foam, felt), surface=(0, 0), product=(0, 1),
        piece_m2=np.array([2.0, 1.0]), areas_m2=np.array([20.0, 9.0]), drawn=every,
    )  # fmt: skip
    pieces = np.array([[3.0, 4.0], [0.0, 0.0]])
    found = treated(question, pieces)
    expected = 0.3 * foam.absorption + 0.2 * own[1] + 0.5 * own[0]
    np.testing.assert_allclose(found[0], [expected, own[1]], rtol=1e-12)
    np.testing.assert_array_equal(found[1], own)
    draws = treated_draws(question, pieces[0])
    mixed = 0.3 * every[:, 0] + 0.2 * drawn[:, 1] + 0.5 * drawn[:, 0]
    np.testing.assert_allclose(draws[:, 0], mixed, rtol=1e-12)
    np.testing.assert_array_equal(draws[:, 1], drawn[:, 1])


def test_odds_are_those_of_the_normal_law_between_the_limits_in_logarithms_of_times(monkeypatch):
    """Of one target in all its bands, and of all targets, draw by draw."""
    question = asked(5)
    question.target = (0, 1, 1)
    question.targets = (Target("C80_dB", low=2.0), Target("T30_s", low=0.5, high=0.9))
    sd = np.array([0.5, 0.1, 0.2])
    monkeypatch.setattr(treat, "_rest_sd", lambda *_: sd)
    rows = np.array([[2.5, 0.6, 0.8], [1.0, 0.9, 1.1]])
    found = treat._odds(question, (None, None), rows[0], rows)
    expected = np.stack(
        [
            ndtr((rows[:, 0] - 2.0) / 0.5),
            ndtr(np.log(0.9 / rows[:, 1]) / 0.1) - ndtr(np.log(0.5 / rows[:, 1]) / 0.1),
            ndtr(np.log(0.9 / rows[:, 2]) / 0.2) - ndtr(np.log(0.5 / rows[:, 2]) / 0.2),
        ],
        axis=1,
    )
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    each, all_of_them = treat._of_targets(question, found)
    np.testing.assert_allclose(each[0], found[:, 0].mean())
    np.testing.assert_allclose(each[1], (found[:, 1] * found[:, 2]).mean())
    assert all_of_them == pytest.approx(found.prod(axis=1).mean())


def test_a_margin_is_the_quantile_of_what_may_be_measured_beside_the_likeliest(monkeypatch):
    """Many equal draws and a spread of the rest: its normal quantile, in logarithms of times.

    Of sixteen equally likely steps the largest stands for the last sixteenth: a tenth is off by
    little; the tenth of a step that the search lets pass is added.
    """
    question = asked(6, (Target("T30_s", high=0.8), Target("C80_dB", low=2.0, high=9.0)))
    sd = np.array([0.1, 0.5])
    monkeypatch.setattr(treat, "_rest_sd", lambda *_: sd)
    rows = np.tile([0.7, 4.0], (10, 1))
    one: Any = SimpleNamespace(rows=rows, numbers=np.array([0.69, 4.2]), means=None)
    found = treat._margin(question, one, 0.9)
    tenth = 1.2816
    expected = [
        0.7 * np.exp(tenth * 0.1) - 0.69 + 0.005 * 0.8,
        max(4.2 - (4.0 - tenth * 0.5), 4.0 + tenth * 0.5 - 4.2) + 0.005 * 20.0,
    ]
    np.testing.assert_allclose(found, expected, rtol=0.08)
    upper = treat._margin(question, one, 0.8)
    assert np.all(upper < found)


def test_what_was_measured_before_is_said_to_be_known_everywhere_somewhere_or_nowhere():
    """Of a prepared room's pairs in all bands."""
    nan = np.nan
    names = (("S", "A"), ("S", "B"))
    scene = SimpleNamespace(pairs=np.array([[0, 0], [0, 1]]))
    at = questions.VALUE_NAMES.index("T30_s")

    def said(*times: tuple[float, float]) -> str:
        observed = []
        for (source, receiver), own in zip(names, times, strict=False):
            values = np.full((len(questions.VALUE_NAMES), 2), nan)
            values[at] = own
            observed.append(SimpleNamespace(source=source, receiver=receiver, values=values))
        bands = bands_between("octave", 500, 1000)
        room: Any = SimpleNamespace(
            observed=observed, scene=scene, absorption=SimpleNamespace(bands=bands)
        )
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(treat, "pair_names", lambda _: [(*n, "") for n in names])
            return treat._before_in_words(room)

    assert said((1.0, 1.0), (1.0, 1.0)) == "measured before"
    assert said((1.0, nan), (1.0, 1.0)) == "before, measured where it was"
    assert said((1.0, 1.0)) == "before, measured where it was"
    assert said((nan, nan), (nan, nan)) == "predicted before" == said()


def test_arrangements_come_cheapest_first_whatever_the_order_in_which_they_were_found(monkeypatch):
    """The first that meets all, then others of other sets, until one misses or is known."""
    found = iter([[2.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    question = SimpleNamespace(cost=np.array([3.0, 0.0]), target=(0,), targets=TARGETS[:1])
    told: list[float] = []

    def outcome(_question, pieces, *_):
        cost = float(question.cost @ pieces)
        missed = ("T30",) if pieces.tolist() == [1.0, 1.0] else ()
        return SimpleNamespace(pieces=np.array(pieces), cost=cost, missed=missed, odds=pieces)

    room: Any = SimpleNamespace(
        absorption=SimpleNamespace(bands="bands"),
        scene=SimpleNamespace(room=SimpleNamespace(findings=())),
    )
    given = {
        "as_measured": lambda room: room,
        "_before_in_words": lambda _: "measured before",
        "question_of": lambda *_: question,
        "best_arrangement": lambda *_: (np.array(next(found)), np.zeros(1)),
        "_outcome": outcome,
        "_of_targets": lambda _q, odds: (odds, 1.0),
        "_arrangement": lambda _q, one, before: (one.cost, before.tolist()),
        "result_doubts": lambda *_: (),
        "_of_the_room": lambda *_: (),
        "_findings": lambda *_: (),
    }
    for name, function in given.items():
        monkeypatch.setattr(treat, name, function)
    answer = treat.treat(room, (), (), (), number=5, progress=told.append)
    # a product that costs nothing leaves the room without any a room without any
    assert answer.arrangements == ((0.0, [0.0, 0.0]), (6.0, [0.0, 0.0]))
    assert told == [0.4] and answer.is_met and answer.asked == 0.5
