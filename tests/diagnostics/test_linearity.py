"""Chains that are not linear, windows left in, fixed absorption that is wrong, copies of files."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import butter, sosfilt
from scipy.special import stdtrit

import roomfit
from roomfit.diagnostics import copies, fixed_absorption, linearity, noise_gate, noise_tail
from roomfit.diagnostics.noise_tail import band_passed
from roomfit.findings import Code, Finding
from roomfit.inversion.coherent import fit_coherent, initialise
from roomfit.inversion.fits import CoherentTests
from roomfit.inversion.measurements import collect_measurements, counted_once
from roomfit.inversion.paths import traced_paths
from roomfit.inversion.score_tests import (
    ChainScores,
    FittedWindows,
    FreedAbsorption,
    Score,
    chain_slopes,
    common,
    scored,
)
from roomfit.inversion.solve import coherent_task
from roomfit.materials.priors import MaterialPrior, unknown_material
from roomfit.objective.parameters import Block, Parameters
from roomfit.objective.problem import Objective
from roomfit.signals.filters import window_energies
from roomfit.signals.response import ImpulseResponse
from roomfit.solvers.least_squares import score_band
from roomfit.synthetic.boxes import (
    SAMPLING_RATE_HZ,
    WALLS,
    BoxPlan,
    add_noise,
    pressure_response,
    true_box,
)
from seen import doubts_of_fit, evidence, of_files
from simulated_rooms.random_boxes import random_plan

BANDS = roomfit.bands_between("octave", 1000, 2000)
RATE_HZ = 16_000.0


def decaying(seed: int) -> ImpulseResponse:
    """Return a click and a decay of half a second."""
    rng = np.random.default_rng(seed)
    t = np.arange(8000) / RATE_HZ
    pressure = 0.1 * rng.standard_normal(t.size) * np.exp(-6.91 * t / 0.5) * (t > 0.006)
    pressure[80] = 1.0
    return ImpulseResponse(pressure, RATE_HZ)


def test_slopes_are_those_of_finite_differences():
    """Energies of files that went through the chain, a thousandth either side of none."""
    response, peak, step = decaying(3), 2.0, 1e-3
    edges_s = [np.array([0.0, 0.01, 0.03, 0.08, 0.2]), np.array([0.004, 0.05, 0.15])]
    measured = SimpleNamespace(response=response)
    slopes = chain_slopes(BANDS, measured, edges_s, peak)  # type: ignore[arg-type]
    x, t = response.pressure, np.arange(8000) / RATE_HZ

    def compressed(by: float) -> np.ndarray:
        return np.sign(x) * peak * np.abs(x / peak) ** (1.0 + by)

    def saturated(by: float) -> np.ndarray:
        return x * (1.0 - by * (x / peak) ** 2)

    def windowed(by: float) -> np.ndarray:
        return x * np.exp(-0.5 * by * t)

    for band in range(2):
        bank = roomfit.Bands(BANDS.kind, BANDS.centres_hz[band : band + 1])
        for column, change in enumerate((compressed, saturated, windowed)):
            up, down = (
                np.log(window_energies(bank, ImpulseResponse(change(s), RATE_HZ), edges_s[band])[0])
                for s in (step, -step)
            )
            expected = (up - down) / (2.0 * step)
            # the mean time of a window stands for that of its energy: within a third of its length
            slack = 1e-4 if column < 2 else np.diff(edges_s[band]) / 2.0
            assert np.all(np.abs(slopes[band][:, column] - expected) <= slack)


def gated(x: np.ndarray) -> np.ndarray:
    """Return samples behind a gate that opens and closes within 5 ms."""
    n = round(5e-3 * RATE_HZ)
    envelope = np.sqrt(np.convolve(x**2, np.ones(n) / n, mode="same"))
    return np.where(envelope > 0.35 * envelope[1000], x, 0.0)


def padded(x: np.ndarray) -> np.ndarray:
    return np.where(np.arange(x.size) < 6000, x, 0.0)


def in_16_bits(x: np.ndarray) -> np.ndarray:
    """Return samples whose decay falls below the steps of the converter."""
    return np.round(x / 2.0**-9) * 2.0**-9


@pytest.mark.parametrize(
    ("change", "found"),
    [(gated, True), (lambda x: gated(x) + 0.01, True), (padded, False), (in_16_bits, False)],
)
def test_a_gate_is_found_and_silence_or_coarse_steps_are_none(change, found):
    measured = []
    for seed in range(6):
        # reflections between two walls come in bursts
        bursts = 1.0 + 0.9 * np.sin(2.0 * np.pi * 40.0 * np.arange(8000) / RATE_HZ)
        pressure = change(decaying(seed).pressure * bursts)
        response = ImpulseResponse(pressure, RATE_HZ)
        own = roomfit.Measurement("S", f"R{seed}", pressure, RATE_HZ)
        measured.append(SimpleNamespace(response=response, measurement=own))
    codes = [f.code for f in noise_gate.check(of_files(measured))]
    assert codes == ([Code.NOISE_GATED] if found else [])


@pytest.mark.parametrize(
    ("n_silent", "rises", "n_runs", "expected"),
    # of 1 kHz: 3 equal samples begin and end 2 steps apart, which is 2 ms
    [(3, 8.1, 4, 3), (2, 8.1, 4, 0), (3, 7.9, 4, 0), (3, 8.1, 3, 2), (5, 20.0, 6, 5)],
)
def test_silence_counts_from_two_milliseconds_on_and_sound_from_eight_steps(
    n_silent, rises, n_runs, expected
):
    """After the peak; the last silence is followed by nothing. Steps of sound are of 1 at least."""
    burst = [1.0, 0.0 + rises, 1.0, 2.0]
    x = np.concatenate([[100.0, 3.0, 2.0], *n_runs * [[*n_silent * [0.0], *burst]]])
    x = x[: -len(burst)]
    m = SimpleNamespace(response=ImpulseResponse(x, 1000.0))
    assert noise_gate._gaps(m) == expected
    before = np.concatenate([x[3:], x[:3], [0.0, 1.0]])  # the peak after all of them
    assert noise_gate._gaps(SimpleNamespace(response=ImpulseResponse(before, 1000.0))) == 0


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
    traced = traced_paths(measured, tuple(priors), settings, start, None, None)
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
ALONE = (POWER, NONE, NONE)


def codes_of(alone=ALONE, beside=(), freed=(), directed=()):
    """Return what is said of a chain beside absorptions that are fixed, here at 0.5."""
    known = MaterialPrior("felt", np.zeros(2), np.ones(2), known=np.full(2, 0.5))
    tests = CoherentTests(
        chain=ChainScores(alone, 20.0, (0, 1), beside), freed_absorptions=tuple(freed)
    )
    seen = evidence(
        fits=SimpleNamespace(tests=tests, directivities=directed),
        measured=SimpleNamespace(bands=BANDS),
        priors=(known,),
    )
    return [f for check in (linearity.check, fixed_absorption.check) for f in check(seen)]


def gained(total: float) -> FreedAbsorption:
    return FreedAbsorption(0, {0: 0.7 * total, 1: 0.3 * total}, {0: 0.31, 1: 0.32})


@pytest.mark.parametrize(
    ("size", "entry", "is_found"),
    [
        (0.041, 0, True),  # an exponent nearer to 1 than 0.04 does no harm
        (-0.041, 0, True),
        (0.039, 0, False),
        (0.051, 1, True),
        (0.049, 1, False),
        (-0.2, 1, False),  # nothing saturates by a gain
        (1.1, 2, True),  # of a decay of 20 per second
        (0.9, 2, False),
    ],
)
def test_what_is_bent_by_less_than_intervals_allow_for_is_not_told(size, entry, is_found):
    alone = [NONE, NONE, NONE]
    alone[entry] = Score(size, 0.05 * abs(size), 500.0)  # 20 sd
    found = [f.code for f in codes_of(tuple(alone))]
    assert found == [Code.LEVELS_NOT_LINEAR if entry < 2 else Code.DECAY_BENT] * is_found


def test_a_chain_is_clear_at_a_chance_of_a_thousandth_for_all_three():
    """Either side of the two-sided quantile of Student's t at 1e-3 / 3, with 9 of freedom."""
    limit = float(stdtrit(9.0, 1.0 - 1e-3 / 6.0))
    for factor, n in ((1.01, 1), (0.99, 0)):
        assert len(codes_of((Score(factor * limit, 1.0, 9.0), NONE, NONE))) == n


def test_which_way_a_chain_bends_is_said():
    for alone, words in (
        ((POWER, NONE, NONE), "power 1.10 +- 0.02 of the pressure, in all bands and over all "
         "distances alike: an expander or gate"),
        ((Score(-0.1, 0.02, 500.0), NONE, NONE), "power 0.90 +- 0.02"),
        ((NONE, POWER, NONE), "by 0.10 +- 0.02 at the peak, in all bands and over all distances "
         "alike: a limiter or an overdriven input"),
        ((NONE, NONE, Score(5.0, 0.5, 500.0)), "decays too fast for its early reflections, by "
         "5.0 +- 0.5 of energy per second"),
        ((NONE, NONE, Score(-5.0, 0.5, 500.0)), "decays too slowly"),
    ):  # fmt: skip
        (finding,) = codes_of(alone)
        assert words in finding.sentence
    # of several the clearest, here by 20 standard deviations beside 5
    (finding,) = codes_of((POWER, Score(0.4, 0.02, 500.0), Score(5.0, 0.5, 500.0)))
    assert "overdriven" in finding.sentence
    (finding,) = codes_of()
    assert finding.evidence["exponent"] == 1.1 and finding.evidence["exponent_sd"] == 0.02
    # directivities that were fitted leave powers and losses, and no window, unsaid
    assert codes_of(directed=("fitted",)) == []
    assert len(codes_of((NONE, NONE, Score(5.0, 0.5, 500.0)), directed=("fitted",))) == 1


@pytest.mark.parametrize(
    ("by_walls", "beside", "said"),
    [
        # freed, the wall gains 20 for two unknowns; the chain 12.5 for one, and nothing beside it
        (20.0, NONE, {Code.FIXED_ABSORPTION_CONTRADICTED}),
        # 12.5 - 1 + 2 = 13.5 = 15.5 - 2: undecided, and both are named
        (15.4, NONE, {Code.LEVELS_NOT_LINEAR, Code.FIXED_ABSORPTION_CONTRADICTED}),
        (15.6, NONE, {Code.FIXED_ABSORPTION_CONTRADICTED}),
        # beside the freed wall the chain is as clear as before: both are wrong
        (20.0, POWER, {Code.LEVELS_NOT_LINEAR, Code.FIXED_ABSORPTION_CONTRADICTED}),
    ],
)
def test_a_chain_is_not_named_where_a_wrong_fixed_absorption_explains_it(by_walls, beside, said):
    found = codes_of(beside=(beside, NONE, NONE), freed=(gained(by_walls),))
    assert {f.code for f in found} == said


@pytest.mark.parametrize(
    ("chain", "by_walls", "beside_gain", "is_contradicted"),
    [
        # the chain gains 50, the wall 20, and after the chain nothing is left for the wall
        (50.0, 20.0, 30.0, False),
        # 2 * 6.8 and 2 * 7.0 are either side of chi-square's 13.8 (2 of freedom, 1e-3)
        (50.0, 20.0, 36.8, False),
        (50.0, 20.0, 37.0, True),
        # the chain must be likelier by 2 units, less one an unknown: 20 - 2 + 2 + 1 = 21
        (21.1, 20.0, 1.2, False),
        (20.9, 20.0, 1.0, True),
    ],
)
def test_a_fixed_absorption_is_not_contradicted_where_a_bent_chain_explains_it(
    chain, by_walls, beside_gain, is_contradicted
):
    alone = Score(1.0, (2.0 * chain) ** -0.5, 500.0)
    beside = Score(1.0, (2.0 * beside_gain) ** -0.5, 500.0)
    found = codes_of((alone, NONE, NONE), (beside, NONE, NONE), (gained(by_walls),))
    codes = [f.code for f in found]
    assert (Code.FIXED_ABSORPTION_CONTRADICTED in codes) is is_contradicted
    # with nothing known of the chain beside the wall, the wall is contradicted
    alone_known = [f.code for f in codes_of((alone, NONE, NONE), (), (gained(by_walls),))]
    assert Code.FIXED_ABSORPTION_CONTRADICTED in alone_known


def test_a_fixed_absorption_is_contradicted_by_what_it_gains_in_all_bands():
    """Chi-square at 1e-5 with two of freedom is 2 ln 1e5 = 23.03; bands of less than 2 are left."""
    quiet = (NONE, NONE, NONE)
    assert codes_of(quiet, freed=(gained(11.5),)) == []
    (finding,) = codes_of(quiet, freed=(gained(11.6),))
    assert finding.evidence["bands_hz"] == [1000.0, 2000.0]
    assert "0.50 fixed, about 0.31 likelier" in finding.sentence
    freed = FreedAbsorption(0, {0: 18.0, 1: 1.9}, {0: 0.31, 1: 0.32})
    (finding,) = codes_of(quiet, freed=(freed,))
    assert finding.evidence["bands_hz"] == [1000.0]
    assert finding.evidence["log_likelihood_gain"] == [18.0]


def test_copies_are_counted_once_in_one_place_and_void_the_answer_in_two():
    at = {"A": (1.0, 1.0, 1.0), "B": (3.0, 2.0, 1.5), "C": (3.0, 2.0, 1.5), "D": (2.0, 3.0, 1.2)}
    scene = roomfit.scene_of(
        roomfit.shoebox_room((5.0, 4.0, 3.0), "plaster"),
        {"A": at["A"]},
        {k: at[k] for k in "BCD"},
    )
    samples = decaying(1).pressure

    def counted(*names: str):
        files = [
            roomfit.Measurement("A", r, s, RATE_HZ)
            for r, s in zip(names, (samples, 2 * samples), strict=True)
        ]
        kept, found = counted_once(scene, files)
        return kept, copies.check(evidence(measured=SimpleNamespace(copies=found)))

    kept, (finding,) = counted("B", "C")
    assert [m.receiver for m in kept] == ["B"]
    assert finding.code is Code.RECORDING_COUNTED_ONCE
    kept, (finding,) = counted("B", "D")
    assert len(kept) == 2
    assert finding.code is Code.RECORDING_OF_TWO_PAIRS
    fresh = decaying(2).pressure
    repeated = [roomfit.Measurement("A", "B", s, RATE_HZ) for s in (samples, fresh)]
    assert counted_once(scene, repeated) == (repeated, ())


def files_of(seed: int, *, windowed: bool, rings: bool = False) -> list[SimpleNamespace]:
    """Return eight files of white noise with a click and a decay of 0.3 s, or of 4 s."""
    rng = np.random.default_rng(seed)
    t = np.arange(16_000) / RATE_HZ
    found = []
    for _ in range(8):
        decay = rng.standard_normal(t.size) * np.exp(-6.91 * t / (4.0 if rings else 0.3))
        pressure = 1e-3 * rng.standard_normal(t.size) + 0.1 * decay * (t > 0.01)
        pressure[160] = 1.0
        pressure *= np.exp(-t / 0.3) if windowed else 1.0
        noise = SimpleNamespace(tail_time_constant_s=np.full(2, 0.3 / 13.8))
        response = ImpulseResponse(pressure, RATE_HZ)
        own = SimpleNamespace(use="fit", where="a file")
        found.append(
            SimpleNamespace(response=response, direct_s=0.01, noise=noise, measurement=own)
        )
    return found


def test_noise_that_falls_tells_of_an_exponential_window():
    """exp(-t / 0.3 s) of the pressure: the energy falls by 6.7 in a second."""
    (finding,) = noise_tail.check(of_files(files_of(1, windowed=True)))
    assert finding.code is Code.DECAY_BENT
    assert finding.evidence["rate_per_s"] == pytest.approx(2.0 / 0.3, rel=0.1)


def test_stationary_noise_and_rooms_that_still_ring_are_no_windows():
    """Forty campaigns at a level of 1 in 10,000."""
    for seed in range(20):
        for rings in (False, True):
            files = files_of(seed, windowed=False, rings=rings)
            assert not list(noise_tail.check(of_files(files)))


def test_a_decay_without_noise_is_no_noise_that_falls():
    """Files as other simulators make them: a decay of .4 s, and filters that ring before it.

    What rings before is as loud as falls on the line of the decay: levels alone say of it what they
    say of noise that falls by 150 dB in a second.
    """
    rng = np.random.default_rng(5)
    t = np.arange(8000) / RATE_HZ
    files = []
    for own in files_of(1, windowed=False):
        ringing = 1e-2 * np.exp(-(((t - 0.01) / 2e-3) ** 2)) * np.cos(2e4 * t) * (t < 0.01)
        decay = rng.standard_normal(t.size) * np.exp(-6.91 * t / 0.4) * (t > 0.01)
        pressure = ringing + 0.1 * decay
        pressure[160] = 1.0
        noise = SimpleNamespace(tail_time_constant_s=np.full(2, 0.4 / 13.8))
        own.response, own.noise = ImpulseResponse(pressure, RATE_HZ), noise
        files.append(own)
    assert not list(noise_tail.check(of_files(files)))


def test_a_pulse_between_two_samples_that_rings_before_itself_is_no_noise_that_falls():
    """One file 2.6 m from its source: its sinc stands 20 dB above the noise before it."""
    for seed in range(20):
        rng = np.random.default_rng([seed, 6])
        t = np.arange(16_000) / RATE_HZ
        decay = rng.standard_normal(t.size) * np.exp(-6.91 * t / 0.3) * (t > 0.0075)
        pressure = np.sinc(t * RATE_HZ - 120.5) + 0.1 * decay
        pressure += 10 ** (-70 / 20) * rng.standard_normal(t.size)
        own = files_of(seed, windowed=False)[0]
        own.response, own.direct_s = ImpulseResponse(pressure, RATE_HZ), 0.0075
        assert not list(noise_tail.check(of_files([own])))


def reverberant_files(
    reverberation_s: float, duration_s: float, *, window_s: float = np.inf, before: float = 1.0
) -> list[SimpleNamespace]:
    """Return four files with noise 50 dB below the click; what precedes it may be louder."""
    files = []
    for seed in range(4):
        rng = np.random.default_rng([seed, 4])
        t = np.arange(round(duration_s * RATE_HZ)) / RATE_HZ
        decay = rng.standard_normal(t.size) * np.exp(-6.91 * t / reverberation_s) * (t > 0.01)
        pressure = 3e-3 * rng.standard_normal(t.size) + 0.1 * decay
        pressure[:160] *= before
        pressure[160] = 1.0
        files.append(
            SimpleNamespace(
                response=ImpulseResponse(pressure * np.exp(-t / window_s), RATE_HZ),
                direct_s=0.01,
                noise=SimpleNamespace(
                    tail_time_constant_s=np.full(2, 1.0 / (13.8 / reverberation_s + 2.0 / window_s))
                ),
                measurement=SimpleNamespace(use="fit", where="a file"),
            )
        )
    return files


@pytest.mark.parametrize(("reverberation_s", "duration_s"), [(0.8, 1.0), (1.2, 1.5)])
def test_a_window_is_found_where_the_end_of_the_file_still_holds_reverberation(
    reverberation_s, duration_s
):
    """Under exp(-t / .5 s): a rate of 4 in a second, within 4 standard deviations."""
    (finding,) = noise_tail.check(
        of_files(reverberant_files(reverberation_s, duration_s, window_s=0.5))
    )
    rate, sd = (finding.evidence[k] for k in ("rate_per_s", "rate_sd_per_s"))
    assert rate == pytest.approx(4.0, abs=4.0 * sd)
    assert sd < 0.5


@pytest.mark.parametrize("before", [2.0, 6.0])
@pytest.mark.parametrize("reverberation_s", [0.5, 0.8, 1.2])
def test_sound_before_the_direct_one_that_is_louder_than_the_noise_is_no_window(
    reverberation_s, before
):
    """As deconvolution leaves it there: the noise at the end of the files is steady by itself."""
    assert not list(
        noise_tail.check(of_files(reverberant_files(reverberation_s, 1.0, before=before)))
    )


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


@pytest.mark.parametrize(("n_after", "is_long_enough"), [(160, True), (157, False)])
def test_a_tail_is_of_eight_blocks_of_a_millisecond_at_least(n_after, is_long_enough):
    """Two fifths of what follows the direct sound: 64 samples are 8 ms at 8 kHz, 62 are not."""
    pressure = np.random.default_rng(3).normal(size=400 + n_after)
    response = ImpulseResponse(pressure, 8000.0)
    m = SimpleNamespace(response=response, direct_s=400 / 8000.0)
    assert (noise_tail._levels(m, 0.4) is not None) == is_long_enough


def test_silence_that_jumps_to_another_silence_is_followed_by_sound_where_the_jump_is_loud():
    """Equal samples of 0 and of 20 in turn: each jump is of more than eight of the least steps."""
    runs = np.repeat([0.0, 20.0, 0.0, 20.0, 0.0], 5)
    for least, expected in ((1.0, 4), (2.6, 0)):
        x = np.concatenate(([100.0, 30.0, 30.0 - least, 10.0], runs, [3.0]))
        m = SimpleNamespace(response=ImpulseResponse(x, 1000.0))
        assert noise_gate._gaps(m) == expected
