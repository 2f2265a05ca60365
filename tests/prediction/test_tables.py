"""What was measured beside what is predicted: speech at the levels of the pair itself."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import roomfit
from roomfit.bands import bands_between
from roomfit.prediction import decay as decays
from roomfit.prediction import tables
from roomfit.prediction.decay import PredictedDecay
from roomfit.prediction.tables import ObservedPair, _interval, with_sti
from roomfit.signals.decay import echogram_decay_curve
from roomfit.signals.iso3382 import VALUE_NAMES
from roomfit.signals.speech import speech_transmission

OCTAVES = bands_between("octave", 125, 8000)
NOTHING = np.full((len(VALUE_NAMES), 7), np.nan)


def observed(receiver: str, decay_s: float | None) -> ObservedPair:
    curve = None
    if decay_s is not None:
        edges_s = 1e-3 * np.arange(2001)
        energy = -np.diff(10.0 ** (-6.0 * edges_s / decay_s))
        curve = echogram_decay_curve(OCTAVES, np.tile(energy, (7, 1)), edges_s, 0.0)
    return ObservedPair("S", receiver, "fit", NOTHING, 0.0 * NOTHING, curve)


def test_speech_is_heard_at_the_level_that_is_predicted_of_its_own_pair():
    """Of two receivers the one where G is 30 dB lower hears noise; a table has no response.

    Without levels a decay of 0.5 s gives the index of its closed form.
    """
    scene = roomfit.scene_of(
        roomfit.shoebox_room((6.0, 5.0, 3.0), {}),
        {"S": (1.5, 1.2, 1.5)},
        {"near": (2.0, 3.5, 1.2), "far": (5.0, 4.0, 1.2)},
    )
    numbers = [
        SimpleNamespace(values=np.vstack([NOTHING[:-1], np.full(7, strength_db)]))
        for strength_db in (10.0, -20.0)
    ]
    pairs = [observed("far", 0.5), observed("near", 0.5), observed("near", None)]
    speech_db = np.stack([np.full(7, 60.0), np.full(7, 35.0)])
    far, near, table = with_sti(scene, OCTAVES, pairs, numbers, speech_db)
    modulations_hz = 10.0 ** (np.arange(-2, 12) / 10.0)
    exact = 1.0 / np.sqrt(1.0 + (2.0 * np.pi * modulations_hz * 0.5 / np.log(1e6)) ** 2)
    quiet = float(speech_transmission(np.tile(exact, (7, 1))))
    # speech of 70 dB masks itself a little
    assert quiet - 0.06 < near.sti < quiet
    assert far.sti < near.sti - 0.2
    assert np.isnan(table.sti) and (far.receiver, near.receiver) == ("far", "near")
    # without levels both places are alike
    levels = [o.sti for o in with_sti(scene, OCTAVES, pairs[:2], numbers, None)]
    assert levels[0] == pytest.approx(levels[1]) and levels[0] == pytest.approx(quiet, abs=0.01)
    few = bands_between("octave", 250, 4000)
    assert with_sti(scene, few, pairs, numbers, None) == tuple(pairs)


@pytest.mark.parametrize(
    ("name", "least", "most"),
    [
        ("STI", 0.0, 1.0),
        ("D50_percent", 0.0, 100.0),
        ("C80_dB", -np.inf, np.inf),
    ],
)
def test_an_interval_holds_its_estimate_and_ends_where_a_parameter_must(name, least, most):
    """Of draws about both ends: noise of a standard deviation 3 widens a normal law of 4 to 5."""
    rng = np.random.default_rng(4)
    for middle in (0.0, 1.0, 100.0):
        draws = middle + 4.0 * rng.standard_normal((40_000, 1))
        low, high = _interval(name, np.array([middle]), draws, np.array([3.0]))
        ends = middle - 1.96 * 5.0, middle + 1.96 * 5.0
        # the quantile of 40,000 normal draws has a standard deviation of 0.013 of theirs
        assert low == pytest.approx(np.clip(ends[0], least, most), abs=0.3)
        assert high == pytest.approx(np.clip(ends[1], least, most), abs=0.3)
    low, high = _interval(name, np.array([0.9]), np.full((9, 1), 0.5), np.zeros(1))
    assert (low[0], high[0]) == (0.5, 0.9)


def test_decay_times_are_widened_by_factors_and_never_end_at_zero():
    """A law of .3 in logarithms and a relative rest of .4, whose logarithm has sqrt(ln 1.16)."""
    draws = np.exp(0.3 * np.random.default_rng(4).standard_normal((40_000, 1)))
    low, high = _interval("T20_s", np.array([1.0]), draws, np.array([0.4]))
    sd = np.hypot(0.3, np.sqrt(np.log(1.16)))
    np.testing.assert_allclose(np.log([low[0], high[0]]), [-1.96 * sd, 1.96 * sd], atol=0.02)
    low, high = _interval("EDT_s", np.array([0.9]), np.full((9, 1), 0.5), np.zeros(1))
    assert (low[0], high[0]) == (0.5, 0.9)


@pytest.mark.parametrize(
    ("name", "low", "high", "is_open"),
    [
        ("T30_s", 0.7, 1.41, True),
        ("T30_s", 0.7, 1.39, False),
        ("EDT_s", 1.0, 2.5, False),
        ("EDT_s", 0.4, 1.0, False),
        ("C80_dB", -1.0, 2.02, True),
        ("C80_dB", -1.0, 2.0, False),
        ("G_dB", 0.0, 9.0, False),
        ("G_dB", -9.0, 0.0, False),
        ("D50_percent", -50.0, 50.0, False),
    ],
)
def test_a_change_is_undetermined_where_neither_its_sign_nor_a_factor_of_two_is_known(
    name, low, high, is_open
):
    change = SimpleNamespace(change_lower95=np.array([low]), change_upper95=np.array([high]))
    assert bool(tables.is_undetermined(name, change)[0]) is is_open


def numbers(values, draws, noise_sd, common, scale=0.0):
    """Return predictions of one pair: one name in two bands."""
    return SimpleNamespace(
        values=np.array([values]), draws=np.array(draws)[:, None], noise_sd=np.array([noise_sd]),
        common_noise=np.array([common]), model_scale=np.full((1, 2), scale), decay="decay",
    )  # fmt: skip


def test_means_are_over_pairs_that_were_measured_and_of_a_band_of_none_over_all():
    """Values by their mean, independent errors by the root of their squares over the number."""
    rng = np.random.default_rng(1)
    pairs = [numbers(rng.random(2), rng.random((3, 2)), rng.random(2), rng.random(2))
             for _ in range(3)]  # fmt: skip
    measured = np.array([[[1.0, np.nan]], [[2.0, np.nan]], [[np.nan, np.nan]]])
    sd = np.array([[[0.3, 0.0]], [[0.4, 0.0]], [[0.0, 0.0]]])
    given = []

    def told(names, states, observed, sds, others):
        given.append((names, states, observed, sds, others))
        return "table"

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tables, "_table", told)
        assert tables._mean_table(("C80_dB",), [pairs], measured, sd) == "table"
    ((names, (state,), observed, sds, others),) = given
    assert names == ("C80_dB",) and np.isnan(others).all()
    np.testing.assert_array_equal(observed, [[1.5, np.nan]])
    np.testing.assert_allclose(sds, [[0.25, 0.0]])
    for band, own in ((0, pairs[:2]), (1, pairs)):
        n = len(own)
        np.testing.assert_allclose(state.values[0, band], np.mean([p.values[0, band] for p in own]))
        np.testing.assert_allclose(
            state.draws[:, 0, band], np.mean([p.draws[:, 0, band] for p in own], axis=0)
        )
        noise = np.sqrt(np.sum([p.noise_sd[0, band] ** 2 for p in own])) / n
        assert state.noise_sd[0, band] == pytest.approx(noise)
        shared = np.sum([p.common_noise[0, band] for p in own]) / n**2
        assert state.common_noise[0, band] == pytest.approx(shared)
    nothing = tables._mean([np.array([1.0, np.nan]), np.array([3.0, np.nan])], (2,))
    np.testing.assert_array_equal(nothing, [2.0, np.nan])
    assert np.isnan(tables._mean([], (2,))).all()


@pytest.mark.parametrize("name", ["C80_dB", "T30_s"])
def test_what_was_measured_is_carried_over_by_the_regression_of_errors(name):
    """Its share, rest and ends written out; of times in logarithms; the model errs alike."""
    rng = np.random.default_rng(2)
    in_ratios = name == "T30_s"
    size = 0.1 if in_ratios else 1.0
    z = rng.standard_normal((2, 400, 2))
    x, y = 0.5 * size * z[0], 0.5 * size * (0.8 * z[0] + 0.6 * z[1])
    old, new = np.array([1.0, 2.0]), np.array([0.8, 1.5])
    drawn = (old * np.exp(x), new * np.exp(y)) if in_ratios else (old + x, new + y)
    s, t, both = 0.3 * size, 0.2 * size, 0.04 * size**2
    scales = (old, new) if in_ratios else (1.0, 1.0)
    before = numbers(old, drawn[0], s * scales[0] * np.ones(2), np.zeros(2), 1.0)
    after = numbers(new, drawn[1], t * scales[1] * np.ones(2), both * scales[0] * scales[1]
                    * np.ones(2), 1.0)  # fmt: skip
    measured, stated = np.array([1.3, 1.9]), 0.1 * size
    found = tables._change(name, 0, (after, before), measured,
                           stated * (measured if in_ratios else np.ones(2)))  # fmt: skip
    model = tables.model_sd(name, old) / (old if in_ratios else 1.0)
    v, c = x.var(axis=0), np.mean((x - x.mean(axis=0)) * (y - y.mean(axis=0)), axis=0)
    share = (c + model**2 + both) / (v + model**2 + s**2 + stated**2)
    assert np.all((share > 0.3) & (share < 1.0))
    carried = new * (measured / old) ** share if in_ratios else new + share * (measured - old)
    np.testing.assert_allclose(found.carried, carried, rtol=1e-9)
    np.testing.assert_allclose(found.before, old)
    np.testing.assert_allclose(found.change, new / old if in_ratios else new - old)
    rest = (1.0 - share) ** 2 * model**2 + t**2 + share**2 * (s**2 + stated**2) - 2 * share * both
    away = (np.log(drawn[1] / new) - share * np.log(drawn[0] / old) if in_ratios else
            drawn[1] - new - share * (drawn[0] - old))  # fmt: skip
    sd = np.sqrt(rest + away.var(axis=0))
    reach = (np.log(found.carried_upper95 / found.carried_lower95) if in_ratios else
             found.carried_upper95 - found.carried_lower95)  # fmt: skip
    # 400 draws know a quantile to 5 % of a standard deviation
    np.testing.assert_allclose(reach, 2 * 1.96 * sd, rtol=0.1)
    apart = np.sqrt(s**2 + t**2 - 2.0 * both + (y - x).var(axis=0))
    reach = (np.log(found.change_upper95 / found.change_lower95) if in_ratios else
             found.change_upper95 - found.change_lower95)  # fmt: skip
    np.testing.assert_allclose(reach, 2 * 1.96 * apart, rtol=0.1)
    first = np.sqrt(s**2 + model**2 + v)
    reach = (np.log(found.before_upper95 / found.before_lower95) if in_ratios else
             found.before_upper95 - found.before_lower95)  # fmt: skip
    np.testing.assert_allclose(reach, 2 * 1.96 * first, rtol=0.1)
    nothing = tables._change(name, 0, (after, before), np.full(2, np.nan), np.zeros(2))
    assert np.isnan(nothing.carried).all() and np.isnan(nothing.carried_lower95).all()
    np.testing.assert_allclose(nothing.change, found.change)


def test_a_table_adds_the_error_of_the_model_to_that_of_interference():
    """Deviations are those of the draws; jnd is of what was predicted before a change."""
    after = numbers([1.0, 2.0], np.arange(6.0).reshape(3, 2), [0.3, 0.4], [0.0, 0.0], 2.0)
    before = numbers([1.1, 2.2], np.arange(6.0).reshape(3, 2), [0.3, 0.4], [0.0, 0.0], 2.0)
    measured = np.array([[1.0, np.nan]])
    args = (measured, 0.0 * measured, np.full((1, 2), 7.0))
    own = tables._table(("T30_s",), [after], *args)["T30_s"]
    error = 2.0 * tables.model_sd("T30_s", np.array([1.0, 2.0]))
    np.testing.assert_allclose(own.sd_rest, np.hypot([0.3, 0.4], error))
    np.testing.assert_allclose(own.sd_absorption, np.std([0.0, 2.0, 4.0]))
    np.testing.assert_allclose(own.jnd, [0.0, np.nan], atol=1e-12)
    assert own.change is None and own.mean_of_others.tolist() == [7.0, 7.0]
    changed = tables._table(("T30_s",), [after, before], *args)["T30_s"]
    np.testing.assert_allclose(changed.jnd, [2.0, np.nan])
    assert changed.change is not None
    blank = tables.without_jnd({"T30_s": own, "none": None})
    assert np.isnan(blank["T30_s"].jnd).all() and blank["none"] is None


def test_a_measured_decay_stands_beside_the_predicted_one_as_far_as_it_is_usable():
    """At the same times; in each band to its own end."""
    time_s = np.array([0.0, 0.5, 1.0])
    own = SimpleNamespace(decay=PredictedDecay(time_s, *[np.zeros((2, 3))] * 3))
    curve = SimpleNamespace(usable_end_s=np.array([0.5, 0.49]),
                            levels_db=lambda t: np.tile(-10.0 * t, (2, 1)))  # fmt: skip
    found = tables._decay(own, SimpleNamespace(curve=curve)).measured_db
    np.testing.assert_array_equal(found, [[-0.0, -5.0, np.nan], [-0.0, np.nan, np.nan]])
    for nothing in (None, SimpleNamespace(curve=None)):
        assert tables._decay(own, nothing) is own.decay


def test_other_absorptions_move_times_by_ratios_and_levels_by_differences():
    """Interference of a time goes as its root; of D50 as that of the ratio of early and late."""
    n = len(VALUE_NAMES)
    before = np.arange(1.0, 1.0 + n)[:, None]
    there, base = 2.0 * before, 1.5 * before
    found = decays.moved(before, there, base)
    for i, name in enumerate(VALUE_NAMES):
        expected = before[i] * (2.0 / 1.5 if name.endswith("_s") else 1.5)
        assert found[i] == pytest.approx(expected), name
    assert decays.moved(before, there, 0.0 * base)[0] == before[0]
    index = SimpleNamespace(sti=SimpleNamespace(values=np.array([[0.6]])))
    moved = decays.extrapolated_sti(index, np.array([0.5, 0.9, 0.0]), np.array(0.4))
    np.testing.assert_allclose(moved, [0.7, 1.0, 0.2])
    without = SimpleNamespace(sti=None)
    assert np.isnan(decays.extrapolated_sti(without, np.array([0.5]), np.array(0.4))).all()
