"""What to hang where: small cases are solved by counting, and odds by what is measured."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import product as combinations

import numpy as np
import pytest

import treat as benchmark
from roomfit.base.bands import bands_between
from roomfit.base.findings import Code
from roomfit.files.campaign import read_campaign
from roomfit.files.questions import question_of
from roomfit.predict.changes import read_change
from roomfit.predict.predict import predict_change, prepare
from roomfit.predict.question import Question
from roomfit.report.treated import treatment_sentence
from roomfit.settings import Settings
from roomfit.signals.decay import jnd_of
from roomfit.signals.iso3382 import VALUE_NAMES
from roomfit.treat.arrangements import treat
from roomfit.treat.question import Product, Surface, Target, problem_of, treated, treated_draws
from roomfit.treat.search import best_arrangement, excess, mean_values, numbers_of
from roomfit.uncertainty.posterior import AbsorptionPosterior
from small_campaign import ABSORPTION, write_campaign

BANDS = bands_between("octave", 500, 1000)


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    campaign = read_campaign(write_campaign(tmp_path_factory.mktemp("treat") / "campaign"))
    a = np.array([[x] * 2 for x in ABSORPTION.values()])
    low, high = (1.0 / (1.0 + (1.0 / a - 1.0) * np.exp(s * 0.392)) for s in (1.0, -1.0))
    covariance = np.stack([0.04 * np.eye(len(a))] * 2)
    known = AbsorptionPosterior(tuple(ABSORPTION), BANDS, a, low, high, covariance)
    given = question_of(campaign, known)
    return prepare(replace(given, settings=replace(given.settings, n_draws=64)))


def products() -> tuple[Product, ...]:
    return (
        Product("foam", np.array([0.5, 0.8]), np.array([0.05, 0.05]), 30.0, 2.0, 0.05),
        Product("panel", np.array([0.8, 0.6]), np.array([0.05, 0.05]), 55.0, 3.0, 0.1),
    )


SURFACES = (Surface("walls", 9.0), Surface("tiles", 8.0, forbidden_m2=1.0))
LIMITS = (0.85, 0.75, 0.68)


def at_most(room, share: float) -> tuple[Target, ...]:
    """Return a target at a share of the reverberation time of the bare room, by band."""
    before = mean_values(room, room.absorption.absorption[None])[0, 2]
    return tuple(
        Target("T30_s", high=float(share * t), bands_hz=(f,))
        for t, f in zip(before, BANDS.centres_hz.tolist(), strict=True)
    )


@pytest.mark.parametrize("share", LIMITS)
def test_the_search_finds_the_cheapest_arrangement_of_all(room, share):
    """Every arrangement of two products on two surfaces, counted: none is cheaper."""
    question = problem_of(room, SURFACES, products(), at_most(room, share))
    assert question.most.tolist() == [4, 3, 3, 2]
    every = np.array(list(combinations(*(range(int(n) + 1) for n in question.most))), dtype=float)
    area = every * question.piece_m2
    every = every[(area[:, :2].sum(axis=1) <= 9.0) & (area[:, 2:].sum(axis=1) <= 7.0)]
    margin = np.zeros(len(question.target))
    fits = ~excess(question, numbers_of(question, every), margin).any(axis=1)
    assert 0 < fits.sum() < len(every)
    cheapest = (every[fits] @ question.cost).min()
    pieces, numbers = best_arrangement(question, margin)
    assert not excess(question, numbers, margin).any()
    assert pieces @ question.cost == pytest.approx(cheapest)


def test_what_cannot_be_met_is_said_and_what_misses_least_is_shown(room):
    found = treat(room, SURFACES, products(), at_most(room, 0.3))
    assert not found.is_met
    (one,) = found.arrangements
    assert one.missed and one.joint < 0.05
    assert any(
        f.code == Code.TARGET_NOT_MET and "misses least" in f.sentence for f in found.findings
    )
    question = problem_of(room, SURFACES, products(), at_most(room, 0.3))
    every = np.array(list(combinations(*(range(int(n) + 1) for n in question.most))), dtype=float)
    area = every * question.piece_m2
    every = every[(area[:, :2].sum(axis=1) <= 9.0) & (area[:, 2:].sum(axis=1) <= 7.0)]
    margin = np.zeros(len(question.target))
    least = excess(question, numbers_of(question, every), margin).sum(axis=1).min()
    hung = {(h.surface, h.product): h.area_m2 for h in one.hung}
    pieces = np.array(
        [
            hung.get((room.absorption.materials[m], products()[p].name), 0.0)
            for m, p in zip(question.surface, question.product, strict=True)
        ]
    )
    own = excess(question, numbers_of(question, (pieces / question.piece_m2)[None]), margin).sum()
    assert own <= least * 1.01


def test_where_none_is_as_likely_as_asked_the_likeliest_is_shown_not_the_cheapest(room):
    """Even odds can be had for less: that arrangement was tried first, and is not the answer."""
    targets = at_most(room, 0.6)
    even, sure = (treat(room, SURFACES, products(), targets, number=1, probability=p)
                  for p in (0.5, 0.99))  # fmt: skip
    assert even.is_met and not sure.is_met
    (first,), (shown,) = even.arrangements, sure.arrangements
    assert shown.cost > first.cost and shown.joint > first.joint


def test_the_odds_are_those_of_draws_and_a_larger_probability_costs_more(room):
    """At a probability of 0.5 a target that is just met has about even odds."""
    target = at_most(room, 0.8)
    even, sure = (treat(room, SURFACES, products(), target, number=1, probability=p)
                  for p in (0.5, 0.9))  # fmt: skip
    first, second = even.arrangements[0], sure.arrangements[0]
    assert np.all(second.probability >= first.probability - 0.02)
    assert np.all(second.probability > 0.85)
    assert second.cost > first.cost
    assert np.all(first.before < first.probability)
    assert 0.0 < first.joint <= first.probability.min() + 1e-9
    assert first.decisive[0][1] > 0.1


@pytest.mark.parametrize("probability", [0.5, 0.6, 0.8, 0.9, 0.95])
@pytest.mark.parametrize("share", [0.8, 0.6, 0.5])
def test_the_verdict_is_that_of_the_odds_that_are_printed(room, share, probability):
    """Each target has one band here, so that its odds are those that the verdict is about."""
    targets = at_most(room, share)
    found = treat(room, SURFACES, products(), targets, number=2, probability=probability)
    for one in found.arrangements if probability > 0.5 else ():
        assert found.is_met == bool(np.all(one.probability >= probability)) == (not one.missed)
    said = treatment_sentence(found)
    if probability > 0.5 and not found.is_met:
        (one,) = found.arrangements
        short = [100.0 * p for p in one.probability if p < probability]
        assert len(one.missed) == len(short)
        for p, line in zip(short, one.missed, strict=True):
            likely, needed = re.findall(r"probability of ([\d.]+) %, ([\d.]+) % was", line)[0]
            assert float(likely) == pytest.approx(p, abs=0.51) and float(likely) < float(needed)
        assert "are met with a probability of" in said and f"{100 * probability:g} % that" in said
    assert found.is_met == ("nothing that was allowed" not in said)


def test_a_part_covered_surface_has_the_mean_by_area(room):
    """Linear in area, the product's own where all is covered, and draws follow."""
    whole = Surface("walls")
    question = problem_of(room, (whole,), products()[:1], at_most(room, 0.8))
    area = question.areas_m2[question.surface[0]]
    m, pieces = question.surface[0], np.array([area / 2.0])
    np.testing.assert_allclose(treated(question, pieces)[m], products()[0].absorption)
    half = treated(question, pieces / 2.0)[m]
    own = room.absorption.absorption[m]
    np.testing.assert_allclose(half, 0.5 * (own + products()[0].absorption))
    draws = treated_draws(question, pieces / 2.0)
    np.testing.assert_allclose(draws[:, m], 0.5 * (room.draws[:, m] + question.drawn[:, 0]))


def test_an_arrangement_does_what_the_change_is_predicted_to_do(room):
    """Two products share a wall: means, intervals and draws of both commands are the same."""
    targets = (*at_most(room, 0.72), Target("C50_dB", low=-10.0, bands_hz=(500.0,)))
    found = treat(room, SURFACES, products(), targets, number=3)
    assert len(found.arrangements) > 1
    assert any(len({h.surface for h in a.hung}) < len(a.hung) for a in found.arrangements)
    for arrangement in found.arrangements:
        changes = [read_change(hung.change) for hung in arrangement.hung]
        mean = predict_change(room, changes).mean
        for name, value in arrangement.mean.items():
            for row in ("predicted", "lower95", "upper95", "measured", "sd_rest"):
                own, other = getattr(value, row), getattr(mean[name], row)
                np.testing.assert_allclose(own, other, rtol=1e-6, err_msg=f"{name} {row}")
            np.testing.assert_allclose(
                value.change.change_lower95, mean[name].change.change_lower95, rtol=1e-6
            )


@pytest.mark.slow
@pytest.mark.parametrize(("cuts", "covered"), [((0.0, 0.5, 1.0), 0), ((0.0, 0.25, 0.75, 1.0), 1)])
def test_the_mean_by_area_is_within_a_third_of_a_jnd_of_the_divided_ceiling(cuts, covered):
    """Means over six pairs, as a treatment is judged; the two cases of the largest differences.

    A fifth is measured (`benchmarks/treat.py --parts`), and two traces of 8000 rays differ, too. A
    ceiling that is left as it was is off by several.
    """
    lengths_m = (7.0, 5.0, 3.0)
    scene = benchmark.box(lengths_m, 6)
    scene = replace(scene, room=benchmark.strip_room(lengths_m, np.array(cuts)))
    materials, part = scene.room.materials, float(np.diff(cuts)[covered])
    ceiling = [i for i, m in enumerate(materials) if m.startswith("strip")]
    found = {}
    for name in ("mean", "divided", "none"):
        a = np.full((len(materials), 6), benchmark.OWN)
        if name == "mean":
            a[ceiling] += part * (benchmark.COVER - benchmark.OWN)
        elif name == "divided":
            a[materials.index(f"strip{covered + 1}")] = benchmark.COVER
        known = benchmark.posterior(materials, a)
        assert len(known.bands) == len(bands_between("octave", 125, 4000))
        room = prepare(Question(scene, known, settings=Settings(n_rays=8000, n_draws=2)))
        found[name] = np.mean([n.values for n in room.before], axis=0)[:, 2:5].mean(axis=1)
    rows = [VALUE_NAMES.index(n) for n in ("T30_s", "EDT_s", "C50_dB")]
    unit = np.array([float(jnd_of(VALUE_NAMES[r], found["divided"][r])) for r in rows])
    assert np.all(np.abs(found["mean"] - found["divided"])[rows] < 0.34 * unit)
    assert np.all(np.abs(found["none"] - found["divided"])[rows] > 2.0 * unit)
