"""Chains that are not linear, windows left in, fixed absorption that is wrong, copies of files."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.signal import butter, sosfilt
from scipy.special import stdtrit

import roomfit
from roomfit.base.findings import Code, Finding
from roomfit.checks.noise_tail import band_passed
from roomfit.demo.boxes import (
    SAMPLING_RATE_HZ,
    WALLS,
    BoxPlan,
    add_noise,
    pressure_response,
    true_box,
)
from roomfit.fit.measurements import collect_measurements
from roomfit.fit.paths import traced_paths
from roomfit.fit.solve import coherent_task
from roomfit.materials.priors import unknown_material
from roomfit.model.parameters import Block, Parameters
from roomfit.model.problem import Objective
from roomfit.pressures.fit import fit_coherent, initialise
from roomfit.pressures.score_tests import (
    FittedWindows,
    Score,
    common,
    scored,
)
from roomfit.solver.least_squares import score_band
from seen import doubts_of_fit
from simulated_rooms.random_boxes import random_plan

BANDS = roomfit.bands_between("octave", 1000, 2000)


class _Line:
    """Data on a line over absorption and one further unknown."""

    is_gamma = False

    def __init__(self, rng: np.random.Generator, further: float) -> None:
        self.rows = rng.standard_normal((40, 2))
        self.further = rng.standard_normal(40)
        self.data = self.rows @ np.array([0.2, 0.3]) + further * self.further
        self.data += 0.01 * rng.standard_normal(40)

    def measured(self):
        return self.data

    def predict(self, values):
        mean = self.rows @ values["absorption"]
        return mean, mean, {"absorption": self.rows}

    def expected(self, values):
        return self.predict(values)[0]

    def variance_parts(self, _values):
        return {"noise": np.full(40, 1e-4)}

    def correlation_length(self, _start):
        return np.ones(40)


def line_score(seed: int, further: float) -> tuple[float, float]:
    term = _Line(np.random.default_rng(seed), further)
    block = Block(
        "absorption",
        ("a", "b"),
        "identity",
        start=np.full(2, 0.25),
        fitted=np.ones(2, dtype=np.bool_),
        prior_mean=np.zeros(2),
        prior_sd=np.full(2, 1e3),
        lower=np.zeros(2),
        upper=np.ones(2),
    )
    objective = Objective(Parameters((block,)), (term,))  # type: ignore[arg-type]
    # the unknown that is missing is a misfit, which would widen the standard deviation
    fit = replace(score_band(objective, np.full(2, 0.25)), chi2_reduced=1.0)
    there, one = objective.predict(fit.vector), objective.correlation_length()
    by_wall, none = np.zeros((0, 2)), {"none": np.zeros((40, 0))}
    windows = FittedWindows(
        *(0, objective.parameters, there, by_wall, one, fit, None, (), none, 1.0)  # type: ignore[arg-type]
    )
    score, information = scored(windows, term.further[:, None])
    return float(score[0] / information[0, 0]), float(information[0, 0] ** -0.5)


def test_the_score_of_a_linear_unknown_is_its_least_squares_estimate():
    """40 data of a line, errors 0.01: the closed form of three unknowns, fitted at once.

    To rounding and to the prior of standard deviation 1000.
    """
    value, sd = line_score(1, 0.3)
    term = _Line(np.random.default_rng(1), 0.3)
    whole = np.column_stack((term.rows, term.further))
    covariance = 1e-4 * np.linalg.inv(whole.T @ whole)
    closed = covariance @ whole.T @ term.data / 1e-4
    assert value == pytest.approx(closed[2], rel=1e-6)
    assert sd == pytest.approx(np.sqrt(covariance[2, 2]), rel=1e-6)


def test_scores_of_what_is_not_there_are_standard_normal():
    """400 lines: the mean square of 400 standard normals is 1 +- .07, three sigmas .21."""
    z = np.array([line_score(seed, 0.0) for seed in range(400)])
    assert np.mean((z[:, 0] / z[:, 1]) ** 2) == pytest.approx(1.0, abs=0.21)


def test_bands_that_disagree_make_their_common_value_less_certain():
    """Two of 1 and 3, each +- 1: 2 +- .71 by themselves, twice the variance as they scatter.

    Satterthwaite: 2**2 / (1/50 + 1/1) = 3.92 degrees of freedom.
    """
    agreeing = common(np.array([1.0, 1.2]), np.ones(2))
    assert agreeing == pytest.approx((1.1, np.sqrt(0.5), 50.0))
    assert common(np.array([1.0, 3.0]), np.ones(2)) == pytest.approx((2.0, 1.0, 4.0 / 1.02))


def test_a_common_value_whose_law_is_right_is_clear_once_in_as_many_rooms_as_stated():
    """20,000 rooms of two bands whose errors of the model are common to both: 1e-3 of three.

    Errors common to bands have 2.6 times the variance of their own: 3.6 in all. One of the three
    alternatives exceeds its limit in one room of 3,000: 6.7 +- 2.6 expected, at most 15.
    """
    rng = np.random.default_rng(6)
    n, limits = 20_000, 0
    shared = rng.standard_normal((n, 1)) * np.sqrt(1.3)
    own = rng.standard_normal((n, 2))
    for scores in shared + own:
        found = common(scores, np.ones(2), 3.6)
        limits += abs(found.value) / found.sd > stdtrit(found.n_free, 1.0 - 1e-3 / 6.0)
    assert limits <= 15


@cache
def room(seed: int) -> tuple[BoxPlan, dict[tuple[str, str], np.ndarray]]:
    """Return a random box and its responses of an even loudspeaker, positions 1 cm off."""
    rng = np.random.default_rng(seed)
    plan = random_plan(rng)
    truth, at = true_box(plan, 0.01, rng)
    even = np.zeros(truth.centres_hz.size)
    pairs = [(s, r) for s in plan.sources_m for r in plan.receivers_m]
    return plan, {
        (s, r): add_noise(
            pressure_response(truth, at[s], at[r], 0.4, SAMPLING_RATE_HZ, even), -60.0, rng
        )
        for s, r in pairs
    }


def found_in(seed: int, change=lambda x, _: x, known: float | None = None) -> list[Finding]:
    """Return what is found of a simulated room whose files went through a chain."""
    plan, responses = room(seed)
    scene = roomfit.scene_of(
        roomfit.shoebox_room(plan.lengths_m, dict(zip(WALLS, plan.materials, strict=True))),
        plan.sources_m,
        plan.receivers_m,
    )
    peak = max(float(np.abs(x).max()) for x in responses.values())
    files = [
        roomfit.Measurement(s, r, change(x, peak), SAMPLING_RATE_HZ)
        for (s, r), x in responses.items()
    ]
    priors = [
        replace(unknown_material(m, len(BANDS)), scattering=np.zeros(len(BANDS)))
        for m in plan.materials
    ]
    if known is not None:
        priors[-1] = replace(priors[-1], known=np.full(len(BANDS), known))
    measured = collect_measurements(scene, files, BANDS, {})
    settings, start = roomfit.Settings(), np.full(len(BANDS), 0.3)
    traced = traced_paths(measured, tuple(priors), settings, start, None)
    task = coherent_task(measured, tuple(priors), traced, start, settings)
    asked = {Code.LEVELS_NOT_LINEAR, Code.DECAY_BENT, Code.FIXED_ABSORPTION_CONTRADICTED}
    return [
        f for f in doubts_of_fit(fit_coherent(initialise(task, traced), traced)) if f.code in asked
    ]


@pytest.mark.slow
def test_a_clean_chain_is_not_doubted_and_a_compressor_is():
    """No false alarm here; over more rooms: docs/how-far-to-trust.md."""
    assert found_in(41) == []
    (finding,) = found_in(41, lambda x, peak: np.sign(x) * peak * np.abs(x / peak) ** 0.8)
    assert finding.code is Code.LEVELS_NOT_LINEAR
    assert finding.evidence["exponent"] == pytest.approx(0.8, abs=0.08)  # 4 sds


@pytest.mark.slow
def test_an_overdriven_input_is_found():
    """A hyperbolic tangent that levels off at a third of the peak, by 7 standard deviations.

    The power, which bends what is faint as well, says nothing of it.
    """
    (finding,) = found_in(41, lambda x, peak: 0.3 * peak * np.tanh(x / (0.3 * peak)))
    assert finding.code is Code.LEVELS_NOT_LINEAR
    assert "overdriven" in finding.sentence
    loss, sd = (finding.evidence[k] for k in ("loss_at_peak", "loss_at_peak_sd"))
    assert loss > 4.0 * sd
    assert 0.3 < loss < 0.7
    assert finding.evidence["exponent"] == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow
def test_a_fixed_absorption_that_is_wrong_is_contradicted_and_a_right_one_is_not():
    plan, _ = room(41)
    true = float(plan.absorption[-1, 4:6].mean())  # 1 and 2 kHz of 63 Hz to 8 kHz
    assert found_in(41, known=true) == []
    (finding,) = found_in(41, known=true + 0.2 if true < 0.6 else true - 0.2)
    assert finding.code is Code.FIXED_ABSORPTION_CONTRADICTED
    assert finding.evidence["material"] == plan.materials[-1]


# A power, a loss and a window, by value, standard deviation and degrees of freedom: here the power
# is clear (5 sd, 12.5 units of log-likelihood) and alone so.
NONE, POWER = Score(0.0, 0.02, 500.0), Score(0.1, 0.02, 500.0)


@pytest.mark.parametrize("rate_hz", [8000.0, 44_100.0])
def test_noise_is_sought_through_causal_filters_of_scipy(rate_hz):
    """To rounding, and nothing comes before the sound."""
    x = np.zeros(3001)
    x[1000:] = np.random.default_rng(2).standard_normal(2001)
    peer = sosfilt(butter(4, 500.0, btype="high", fs=rate_hz, output="sos"), x)
    peer = sosfilt(butter(8, 0.25 * rate_hz, fs=rate_hz, output="sos"), peer)
    found = band_passed(x, 500.0, 0.25 * rate_hz, rate_hz)
    np.testing.assert_allclose(found, peer, atol=1e-11)
    assert np.abs(found[:1000]).max() < 1e-11
