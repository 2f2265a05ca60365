"""From which number on a check says something, and what: on both sides of each limit."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.special import chdtri

import roomfit
from roomfit.bands import bands_between
from roomfit.diagnostics import (
    convergence,
    decay,
    fixed_absorption,
    levels,
    linearity,
    minima,
    mirrors,
    misfit,
    missing_data,
    polarity,
    prior,
    repeats,
    schroeder,
    unreached,
    wall_positions,
)
from roomfit.diagnostics.wall_positions import _Echoes, _Wall
from roomfit.findings import Code
from roomfit.inversion.score_tests import FreedAbsorption, Score
from roomfit.materials.priors import object_area_m2, unknown_material
from roomfit.signals.response import ImpulseResponse
from seen import evidence, of_answers, of_files, of_tests

BANDS = bands_between("octave", 500, 2000)
SCENE = roomfit.scene_of(
    roomfit.shoebox_room((6.0, 5.0, 3.0), "plaster"),
    {"S": (1.0, 1.5, 1.2)}, {"A": (4.0, 3.0, 1.2), "B": (2.0, 4.0, 1.6)},
)  # fmt: skip


def recording(name: str, *, level: str = "per-source", use: str = "fit") -> Any:
    return SimpleNamespace(
        source="S", receiver="A", name=name, where=name, level=level, use=use, state=""
    )


def measured(name: str, pair: int = 0, level: str = "per-source", **times: Any) -> Any:
    """Return a recording with the parameters that are given, and levels in dB."""
    level_db = np.array(times.pop("level_db", (0.0, 0.0, 0.0)))
    known = {n: np.array(times.get(n, (1.0, 1.0, 1.0))) for n in ("T20_s", "EDT_s", "C80_dB")}
    curve = SimpleNamespace(bands=BANDS, energy_left=10.0 ** (level_db[:, None] / 10.0))
    return SimpleNamespace(
        pair=pair, measurement=recording(name, level=level), curve=curve,
        parameters=SimpleNamespace(of=known.__getitem__),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("other", "words"),
    [
        # 5 % of the mean of both is one step: two of them are 10 %
        ({"T20_s": (1.0, 1.106, 1.0)}, "T20 1.00 and 1.11 s at 1000 Hz"),
        ({"T20_s": (1.0, 1.104, 1.0)}, ""),
        ({"EDT_s": (1.0, 1.0, 0.903)}, "EDT 1.00 and 0.90 s at 2000 Hz"),
        ({"EDT_s": (1.0, 1.0, 0.906)}, ""),
        ({"C80_dB": (3.01, 1.0, 1.0)}, "C80 1.00 and 3.01 dB at 500 Hz"),
        ({"C80_dB": (2.99, 1.0, 1.0)}, ""),
        ({"T20_s": (np.nan, 1.0, 1.0)}, ""),
        ({"level_db": (0.0, 0.0, -1.51)}, "levels that differ by 1.5 dB at 2000 Hz"),
        ({"level_db": (0.0, 0.0, 1.49)}, ""),
        ({"level_db": (9.0, 0.0, 0.0), "level": "per-file"}, ""),
        ({"T20_s": (9.0, 1.0, 1.0), "pair": 1}, ""),
    ],
)
def test_repetitions_differ_by_more_than_two_steps_or_a_decibel_and_a_half(other, words):
    """Whichever comes first; files of two pairs, or with gains of their own, say nothing."""
    level = other.get("level", "per-source")
    both = (measured("a", level=level), measured("b", **other))
    for files in (both, both[::-1]):
        found = list(repeats.check(of_files(files)))
        assert bool(found) is bool(words)
        if found:
            assert found[0].evidence["files"] == [f.measurement.where for f in files]
    if words:
        assert next(repeats.check(of_files(both))).evidence["differences"] == [words]
    twice = (measured("a", level="per-file"), measured("b", level="per-file", level_db=(9, 0, 0)))
    assert not list(repeats.check(of_files(twice)))


def test_recordings_and_bands_without_data_are_named(monkeypatch):
    """Only those that are to be fitted, and only the bands without a decay above the noise."""
    has = {("a", 0): False, ("a", 1): True, ("a", 2): False}
    monkeypatch.setattr(
        missing_data, "has_data_in_band", lambda m, b: has.get((m.measurement.name, b), True)
    )
    files = [SimpleNamespace(measurement=recording(n)) for n in "ab"]
    seen = evidence(measured=SimpleNamespace(bands=BANDS, responses=files))
    (finding,) = missing_data.check_recordings(seen)
    assert finding.evidence["bands_hz"] == [500.0, 2000.0] == list(finding.about.bands_hz)
    assert "S to A (a): no decay rises above the noise at 500, 2000 Hz" in finding.sentence
    kept = [SimpleNamespace(measurement=recording("a", use="validate"))]
    seen = evidence(measured=SimpleNamespace(bands=BANDS, responses=kept))
    assert not list(missing_data.check_recordings(seen))
    answers = [SimpleNamespace(model=m) for m in ("energy", "prior", "coherent")]
    (finding,) = missing_data.check_bands(of_answers(answers, BANDS))
    assert finding.evidence["bands_hz"] == [1000.0]
    assert not list(missing_data.check_bands(of_answers(answers[:1] * 3, BANDS)))


def test_samples_that_did_not_converge_are_told_with_their_worst_numbers():
    """Those that did, and bands that were not sampled, are left out."""

    def sampling(converged):
        return SimpleNamespace(
            sampling=SimpleNamespace(
                converged=converged, evaluations=1200, r_hat=np.array([1.01, 1.23456]),
                autocorrelation=np.array([80.0, 123.4]),
            )
        )  # fmt: skip

    seen = of_answers([sampling(True), sampling(False), SimpleNamespace(sampling=None)], BANDS)
    (finding,) = convergence.check_samples(seen)
    assert finding.code is Code.SAMPLING_NOT_CONVERGED
    assert finding.evidence == {
        "bands_hz": [1000.0], "evaluations": [1200], "largest_r_hat": [1.2346],
    }  # fmt: skip
    assert "1200 evaluations, autocorrelation 123 steps, R-hat 1.23" in finding.sentence
    assert not list(convergence.check_samples(of_answers([sampling(True)] * 3, BANDS)))


def test_bands_that_begin_below_the_schroeder_frequency_are_told(monkeypatch):
    """2000 sqrt(T / V) at the lower edge: 90 m3, edges of 355, 710 and 1420 Hz."""
    edges_hz = BANDS.lower_hz
    for share, n in ((0.999, 0), (1.001, 3)):
        decay_s = 90.0 * (share * edges_hz / 2000.0) ** 2
        monkeypatch.setattr(schroeder, "median_decay_s", lambda *_, d=decay_s: d)
        own = SimpleNamespace(bands=BANDS, scene=SCENE)
        found = list(schroeder.check(evidence(measured=own)))
        assert len(found) == bool(n)
    assert found[0].evidence["bands_hz"] == BANDS.centres_hz.tolist()
    assert "500 Hz" in found[0].sentence and "355 Hz" in found[0].sentence


def test_a_material_that_no_path_strikes_is_named_where_it_is_to_be_fitted():
    """Specular or diffuse hits count; a known one, and an object, may be unreached."""
    paths = SimpleNamespace(
        materials=("a", "b", "c", "d"),
        hits_specular=np.array([[1, 0, 0, 0], [0, 0, 0, 0]]),
        hits_diffuse=np.array([[0, 0, 0, 0], [0, 2, 0, 0]]),
    )
    open_ = {n: unknown_material(n, 3) for n in "abcd"}
    seen = evidence(traced=SimpleNamespace(paths=paths), priors=tuple(open_.values()))
    (finding,) = unreached.check(seen)
    assert finding.evidence["materials"] == ["c", "d"] == list(finding.about.materials)
    fixed = {k: SimpleNamespace(name=k, object_volume_m3=None, known=None) for k in "ab"}
    fixed["c"] = SimpleNamespace(name="c", object_volume_m3=None, known=np.zeros(3))
    fixed["d"] = SimpleNamespace(name="d", object_volume_m3=90.0, known=None)
    seen = evidence(traced=SimpleNamespace(paths=paths), priors=tuple(fixed.values()))
    assert not list(unreached.check(seen))


def test_a_mean_miss_has_the_larger_of_the_scatter_by_theory_and_of_three_pairs_the_observed():
    jnd = np.array([1.0, 2.0, 6.0])
    mean, sd = decay.mean_miss(jnd, np.full(3, 0.05))
    assert (mean, sd) == pytest.approx((3.0, np.std(jnd, ddof=1) / np.sqrt(3.0)))
    assert decay.mean_miss(jnd, np.array([0.1, 0.4, 9.0]))[1] == pytest.approx(8.0 / np.sqrt(3.0))
    assert decay.mean_miss(jnd[:2], np.full(2, 0.05))[1] == pytest.approx(1.0 / np.sqrt(2.0))
    assert decay.mean_miss(np.zeros(0), np.zeros(0)) == (0.0, np.inf)


@pytest.mark.parametrize(
    ("chi2", "models", "words"),
    [
        ((1.0, 1.51, 9.0), "eee", "In most bands"),
        ((1.0, 1.49, 9.0), "eee", ""),
        ((1.51, 9.0, 9.0), "eep", "In both bands"),
        ((1.49, 9.0, 9.0), "eep", ""),
        ((9.0, 9.0, 9.0), "ecp", "In both bands"),
        ((9.0, 9.0, 9.0), "epp", ""),
    ],
)
def test_most_bands_misfit_by_their_median_and_two_by_the_smaller(chi2, models, words):
    names = {"e": "energy", "c": "coherent", "p": "values"}
    answers = [SimpleNamespace(chi2_reduced=x, model=names[m])
               for x, m in zip(chi2, models, strict=True)]  # fmt: skip
    found = list(misfit.check(of_answers(answers, BANDS)))
    assert bool(found) is bool(words)
    assert not found or found[0].sentence.startswith(words)
    for value, n in ((2.01, 1), (2.0, 0)):
        answers = [SimpleNamespace(chi2_reduced=x) for x in (0.5, value, 1.0)]
        found = list(misfit.check_bands(of_answers(answers, BANDS)))
        assert len(found) == n
    assert found == []


def test_another_minimum_is_reported_with_its_absorptions_and_what_it_loses():
    starts = SimpleNamespace(other=(0.1234567, 0.7), loss=1.2345)
    answers = [SimpleNamespace(starts=s) for s in
               (None, starts, SimpleNamespace(other=None, loss=0.0))]  # fmt: skip
    (finding,) = minima.check_starts(of_answers(answers, BANDS, materials=("a", "b")))
    assert finding.evidence == {
        "bands_hz": [1000.0],
        "other_answer": [{"a": 0.123457, "b": 0.7}],
        "log_likelihood_lower_by": [1.234],
    }
    assert "1000 Hz (log-likelihood lower by 1.2)" in finding.sentence


def test_an_answer_is_that_of_its_prior_where_nine_tenths_of_the_spread_are_left():
    """Of a stated prior of a material of its own that was fitted."""
    stated = [roomfit.material_prior(n, BANDS, prior=(0.3, 0.05)) for n in "ab"]
    known = roomfit.material_prior("c", BANDS, absorption=[0.1, 0.1, 0.1])
    tied = roomfit.material_prior("d", BANDS, same_absorption_as="a")
    priors = (*stated, known, tied, unknown_material("e", 3))
    sds = stated[0].prior_logit_sd

    def answer(share, band, model="energy"):
        spread = np.full(5, share * sds[band])
        spread[1] = 0.5 * sds[band]
        return SimpleNamespace(logit_covariance=np.diag(spread**2), model=model)

    answers = [answer(0.899, 0), answer(0.901, 1), answer(1.5, 2)]
    (finding,) = prior.check(of_answers(answers, BANDS, priors=priors))
    assert finding.evidence["material"] == "a"
    assert finding.evidence["bands_hz"] == [1000.0, 2000.0]
    assert finding.evidence["spread_left"] == [0.901, 1.5]
    assert "90 %" in finding.sentence and "100 %" in finding.sentence
    without = [answer(1.5, b, "prior") for b in range(3)]
    assert not list(prior.check(of_answers(without, BANDS, priors=priors)))


def loud(name: str, late_db: float, direct_db: float, distance: float = 1.0, **more: Any) -> Any:
    """Return a file with a reverberant level and a direct sound that was measured so loud."""
    time_s = np.array([0.0, 0.01, 0.06, 1.0])
    left = np.tile([9.0, 9.0, 10.0 ** (late_db / 10.0), 1e-9], (3, 1))
    own = recording(name, level=more.pop("level", "per-source"))
    own.response = SimpleNamespace(pressure=np.array([0.1, 1.0, 0.2]) * 10 ** (direct_db / 20.0))
    curve = SimpleNamespace(bands=BANDS, time_s=time_s, energy_left=left, onset_s=0.01,
                            usable_end_s=np.full(3, 0.9))  # fmt: skip
    return SimpleNamespace(measurement=own, curve=curve, direct_s=distance, direct_db=direct_db)


@pytest.mark.parametrize(
    ("late_db", "direct_db", "odd", "words"),
    [
        ((0, 0, 0, 4.01), (0, 0, 0, 4.01), {"3"}, "4.0 dB louder than the other 3"),
        ((0, 0, 0, 3.99), (0, 0, 0, 3.99), set(), ""),
        ((0, 0, 0, -6.0), (0, 0, 0, -6.0), {"3"}, "6.0 dB softer than the other 3"),
        ((0, 0, 6, 6), (0, 0, 6, 6), {"2", "3"}, "6.0 dB louder than the other 2"),
        # what direct sounds do not do as well, to 2 dB, is no gain
        ((0, 0, 0, 6.0), (0, 0, 0, 4.01), {"3"}, "6.0 dB louder"),
        ((0, 0, 0, 6.0), (0, 0, 0, 3.99), set(), ""),
        ((0, 0, 0, 6.0), (0, 0, 0, 8.01), set(), ""),
        # files of one level scatter by 1.2 dB at most
        ((0, 2.39, 9.0, 9.0), (0, 2.39, 9.0, 9.0), {"2", "3"}, "7.8 dB louder"),
        ((0, 2.41, 9.0, 9.0), (0, 2.41, 9.0, 9.0), set(), ""),
        # of two files 5 dB
        ((0, 5.01), (0, 5.01), {"1"}, "5.0 dB louder than the other 1"),
        ((0, 4.99), (0, 4.99), set(), ""),
    ],
)
def test_levels_are_apart_where_late_and_direct_sound_make_one_step(
    monkeypatch, late_db, direct_db, odd, words
):
    """Distances are allowed for: twice as far is 6 dB less of direct sound."""
    monkeypatch.setattr(levels, "direct_sound", lambda m: np.array([10.0 ** (m.at_db / 20.0)]))
    files = []
    for i, (late, direct) in enumerate(zip(late_db, direct_db, strict=True)):
        m = loud(str(i), late, direct, 1.0 + i)
        m.at_db = direct - 20.0 * np.log10(1.0 + i)
        # no two files have one peak
        m.measurement.response.pressure *= 1.0 + 0.01 * i
        files.append(m)
    found = list(levels.check(of_files(files)))
    assert bool(found) is bool(words)
    if found:
        assert words in found[0].sentence
        assert set(found[0].evidence["files"]) == odd
    for m in files:
        m.measurement.level = "per-file"
    assert not list(levels.check(of_files(files)))


def test_reverberant_levels_are_means_by_bandwidth_50_ms_after_the_direct_sound():
    """Of bands that all have there; none have one where a file has none."""
    files = [loud("a", 0.0, 0.0), loud("b", 0.0, 0.0)]
    files[1].curve.energy_left = files[1].curve.energy_left * np.array([[1.0], [10.0], [100.0]])
    found = levels._late_levels_db(files)
    weights = BANDS.centres_hz / BANDS.centres_hz.sum()
    np.testing.assert_allclose(found, [0.0, weights @ [0.0, 10.0, 20.0]], atol=1e-12)
    files[0].curve.usable_end_s = np.array([0.9, 0.9, 0.0600])
    found = levels._late_levels_db(files)
    np.testing.assert_allclose(found[1], 10.0 * 1000.0 / 1500.0, rtol=1e-6)
    files[1].curve.usable_end_s = np.full(3, 0.05)
    assert np.isnan(levels._late_levels_db(files)).all()


def test_polarity_is_the_sign_of_the_largest_correlation_above_0_6():
    """Of a shifted copy, of one that is turned, of another sound, and of silence none."""
    x = np.array([0.0, 1.0, 0.5, -0.2, 0.0, 0.0])
    assert polarity._sign(np.roll(x, 1), x) == 1 and polarity._sign(-0.3 * x, x) == -1
    assert polarity._sign(np.zeros(6), x) == 0 == polarity._sign(x, np.zeros(6))
    one, other = np.array([1.0, 0.0]), np.array([0.0, 1.0])
    long = np.array([1.0, 0.0, 0.0, 0.0])
    for share, sign in ((0.601, 1), (0.599, 0)):
        rest = np.sqrt(1.0 - share**2)
        mixed = np.array([0.0, 0.0, 0.0, 0.0])
        # sounds that overlap by so much at one delay, and less at all others
        mixed[0] = share
        mixed[1:] = rest / np.sqrt(3.0)
        assert polarity._sign(mixed, long) == sign
        assert polarity._sign(-mixed, long) == -sign
    assert polarity._sign(one, other) == 1


@pytest.mark.parametrize(
    ("gains", "spoken"),
    [((1.0, 1.04), "by +1.0: the"), ((1.0, 1.06), "by +1.0 to +1.1: the"), ((), "")],
)
def test_a_mirrored_answer_is_said_with_what_a_second_fit_changes(gains, spoken):
    """Of bands in which it differs; a range where it is not one number."""
    symmetry: Any = SimpleNamespace(exchange=np.array([1, 0]))
    scene: Any = SimpleNamespace(room=SimpleNamespace(materials=("a", "b")))
    absorption = np.array([[0.1, 0.2, 0.3], [0.5, 0.6, 0.7]])
    differs = np.array([[True, True, False], [True, True, False]])
    trials: Any = [SimpleNamespace(gain=g) for g in (*gains, 99.0)]
    trials = trials if gains else [None] * 3
    finding = mirrors._finding(symmetry, scene, BANDS, 0.034, absorption, differs, trials)
    assert (spoken in finding.sentence) and ("second fit" in finding.sentence) is bool(gains)
    assert "within 3 cm" in finding.sentence and finding.evidence["apart_m"] == 0.034
    assert "a 0.50, 0.60 instead of 0.10, 0.20; b 0.10, 0.20 instead" in finding.sentence
    assert finding.evidence["other_answer"] == {"a": [0.5, 0.6, 0.7], "b": [0.1, 0.2, 0.3]}
    assert finding.evidence["log_likelihood_change"] == list(gains)
    assert finding.evidence["bands_hz"] == [500.0, 1000.0]


def test_a_contradicted_area_of_an_object_is_said_in_m2():
    """Not as the share of energy by which a fit knows it."""
    own = SimpleNamespace(known=np.array([0.02, 0.02, 0.02]), name="seats", object_volume_m3=90.0)
    freed = FreedAbsorption(0, {0: 18.0, 1: 9.0}, {0: 0.05, 1: 0.06})
    tests = of_tests(freed_absorptions=(freed,), chain=None)
    tests.fits.directivities = ()
    tests.priors, tests.measured = (own,), SimpleNamespace(bands=BANDS)
    (finding,) = fixed_absorption.check(tests)
    areas = [float(object_area_m2(np.array(x), 90.0)) for x in (0.02, 0.05, 0.06)]
    assert f"{areas[0]:.2f} fixed, about {areas[1]:.2f} m2 likelier" in finding.sentence
    assert finding.evidence["about"] == [round(x, 3) for x in areas[1:]]
    assert "contradict the absorption area" in finding.sentence
    # a chance of 1e-5 for the sum of both bands
    limit = 0.5 * chdtri(2, 1e-5)
    for share, n in ((0.999, 0), (1.001, 1)):
        freed = FreedAbsorption(0, {0: share * limit - 2.0, 1: 2.0}, {0: 0.05, 1: 0.06})
        again = of_tests(freed_absorptions=(freed,), chain=None)
        again.fits.directivities, again.priors, again.measured = (), (own,), tests.measured
        assert len(list(fixed_absorption.check(again))) == n


def test_without_a_clear_fault_of_the_chain_it_explains_nothing():
    quiet = Score(0.0, 1.0, 500.0)
    scores: Any = SimpleNamespace(alone=(quiet,) * 3, beside_freed=(quiet,) * 3,
                                  decay_rate_per_s=10.0)  # fmt: skip
    freed = FreedAbsorption(0, {0: 1.0}, {0: 0.3})
    assert linearity.explained_by_the_chain(scores, freed, is_directed=False) is False
    assert linearity.explained_by_the_chain(None, freed, is_directed=False) is False


def echo(n: int = 4000, source: Any = (1.0, 1.0, 1.0), receiver: Any = (2.0, 3.0, 1.0)) -> _Echoes:
    ends = np.array(source), np.array(receiver)
    time_s = np.arange(n) / 16_000.0
    direct_s = float(np.linalg.norm(ends[0] - ends[1])) / 343.0
    return _Echoes(*ends, direct_s, np.zeros(0), time_s, np.arange(n, dtype=float),
                   np.zeros(n, dtype=bool))  # fmt: skip


def test_prominence_of_a_wall_is_read_where_its_mirror_image_arrives():
    """By Pythagoras; not within 1 ms of the direct sound, nor where a position is within 0.4 m."""
    wall = _Wall("east", (5.0, 2.0, 1.0), np.array([1.0, 0.0, 0.0]), 5.0)
    own, moved_m = echo(), np.array([-2.59, -2.61, -0.5, 0.0, 0.13, 1.0])
    found = wall_positions._prominences(wall, moved_m, [own], 343.0)[:, 0]
    assert np.isfinite(found).tolist() == [True, False, True, True, True, True]
    for moved, value in zip(moved_m[[0, 2, 3, 4, 5]], found[[0, 2, 3, 4, 5]], strict=True):
        way_m = np.hypot(2.0 * (5.0 + moved) - 1.0 - 2.0, 2.0)
        assert value == np.ceil(way_m / 343.0 * 16_000.0)
    # what the outline explains counts only for the wall where it is specified
    own.explained[:] = True
    found = wall_positions._prominences(wall, np.array([0.0, 0.12, 0.121]), [own], 343.0)[:, 0]
    assert np.isfinite(found).tolist() == [True, True, False]
    near = echo(source=(4.0, 1.0, 1.0), receiver=(4.0, 3.0, 1.0))
    early = [wall_positions._prominences(_Wall("e", (0, 0, 0), np.array([1.0, 0, 0]), at),
                                         np.zeros(1), [near], 343.0)[0, 0]
             for at in (4.6, 4.69)]  # fmt: skip
    # ways of 2.33 and 2.43 m against 2 m: 0.97 and 1.25 ms later
    assert np.isnan(early[0]) and np.isfinite(early[1])
    short = echo(200)
    assert np.isnan(wall_positions._prominences(wall, np.array([0.0]), [short], 343.0)).all()


@pytest.mark.parametrize(
    ("change", "is_raised"),
    [
        ({}, True),
        ({"best": 1.49}, False),
        ({"best": 1.51}, True),
        # a lead of 0.7 with eight responses, of 1 beyond half of the reach
        ({"rest": 1.29}, True),
        ({"rest": 1.31}, False),
        ({"here": 1.31}, False),
        ({"moved_m": 1.6, "rest": 0.99}, True),
        ({"moved_m": 1.6, "rest": 1.01}, False),
        ({"n": 4, "rest": 1.02}, False),
        ({"n": 4, "rest": 1.0}, True),
        # seven of ten responses
        ({"n": 10, "low": 3}, True),
        ({"n": 10, "low": 4}, False),
        ({"moved_m": 0.12}, False),
        ({"moved_m": -0.5}, True),
    ],
)
def test_a_wall_is_elsewhere_where_its_echoes_are_prominent_lead_and_most_responses_have_them(
    monkeypatch, change, is_raised
):
    given = {"moved_m": 0.5, "best": 2.0, "rest": 0.5, "here": 0.5, "n": 8, "low": 0, **change}
    moved_m = given["moved_m"]
    scores = np.full(wall_positions._DISTANCES_M.size, 0.3)
    scores[5] = given["rest"]
    scores[np.argmin(np.abs(wall_positions._DISTANCES_M))] = given["here"]
    scores[np.argmin(np.abs(wall_positions._DISTANCES_M - moved_m))] = given["best"]
    peak = np.where(np.arange(given["n"]) < given["low"], 1.0, 1.001)
    monkeypatch.setattr(wall_positions, "_prominences", lambda *_: peak[None])
    wall = _Wall("east", (5.0, 2.0, 1.0), np.array([1.0, 0.0, 0.0]), 5.0)
    found = wall_positions._mismatch(wall, moved_m, scores, [], 343.0)
    assert bool(found) is is_raised
    if found:
        way = "farther out than" if moved_m > 0.0 else "inside of where"
        assert f"a wall {abs(moved_m):.2f} m {way}" in found[0].sentence
        share = round(100.0 * (1.0 - given["low"] / given["n"]))
        assert f"in {share} % of {given['n']} responses" in found[0].sentence
        assert found[0].evidence["metres_outward"] == moved_m


def test_a_displacement_is_scored_by_the_mean_of_five_responses_or_half_of_all(monkeypatch):
    """NaN where fewer resolve it."""
    rows = np.full((3, 12), np.nan)
    rows[0, :5], rows[1, :6], rows[2] = 1.0, np.arange(6.0), np.arange(12.0)
    monkeypatch.setattr(wall_positions, "_prominences", lambda *_: rows)
    wall = _Wall("east", (5.0, 2.0, 1.0), np.array([1.0, 0.0, 0.0]), 5.0)
    found = wall_positions._scan(wall, [echo(8)] * 12, 343.0)
    np.testing.assert_array_equal(found, [np.nan, 2.5, 5.5])
    found = wall_positions._scan(wall, [echo(8)] * 4, 343.0)
    np.testing.assert_array_equal(found, [1.0, 2.5, 5.5])


def test_walls_of_three_hundredths_of_the_room_are_large_and_stand_at_their_middle():
    """Triangles of one plane are one wall; its offset is along the normal out of the room."""
    room = roomfit.shoebox_room((6.0, 5.0, 3.0), "plaster")
    walls = {w.name: w for w in wall_positions._large_walls(room)}
    assert set(walls) == {"west", "east", "south", "north", "floor", "ceiling"}
    np.testing.assert_allclose(walls["east"].normal, [1.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(walls["east"].centre_m, (6.0, 2.5, 1.5))
    assert walls["east"].offset_m == pytest.approx(6.0)
    assert walls["west"].offset_m == pytest.approx(0.0, abs=1e-12)
    assert walls["ceiling"].offset_m == pytest.approx(3.0)
    # ends of 0.35 m square are 0.35 / (0.7 + 4 L) of a duct: three hundredths at 2.74 m
    for length_m, n in ((2.7, 6), (2.8, 4)):
        duct = roomfit.shoebox_room((length_m, 0.35, 0.35), "plaster")
        assert len(wall_positions._large_walls(duct)) == n


def test_a_direct_sound_is_what_lies_about_the_onset():
    """A pulse and its onset: samples from 0.3 ms before it to 1.5 ms after."""
    x = np.zeros(480)
    x[100:110] = 1.0
    m: Any = SimpleNamespace(
        response=ImpulseResponse(x, 16_000.0), measurement=SimpleNamespace(where="a file")
    )
    found = polarity.direct_sound(m)
    assert found.size in (28, 29, 30) and found[0] == 0.0 and np.sum(found) == 10.0
