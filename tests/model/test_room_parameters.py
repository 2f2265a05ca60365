"""ISO 3382 values as data: tables, contradictions, derivatives, scatter, and a room found again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roomfit.base.air import Air, attenuation_per_m, speed_of_sound_m_s
from roomfit.base.bands import Bands, bands_between
from roomfit.base.errors import InputError
from roomfit.base.logit import expit, logit
from roomfit.demo.boxes import WALLS, SyntheticBox, pressure_response
from roomfit.files.rooms import read_room
from roomfit.files.schema import RoomSpec
from roomfit.files.values import read_parameters
from roomfit.fit.bands import fitted_band
from roomfit.fit.compare import compared_values
from roomfit.materials.priors import Scattering, uniform_scattering, unknown_material
from roomfit.model.binned import bin_paths
from roomfit.model.parameters import start_vector
from roomfit.model.room_parameters import (
    ValuesTerm,
    approximated,
    curve_by_pressures,
    predicted_values,
    value_covariances,
    value_terms,
    without_responses,
)
from roomfit.model.weighing import EnergyRows, weigh
from roomfit.model.windows import band_spreading, despread, spread_energy
from roomfit.room.scene import Point, Scene, scene_of, shoebox_room
from roomfit.settings import Settings
from roomfit.signals.decay import (
    PARAMETER_NAMES,
    decay_curve,
    echogram_decay_curve,
    jnd_of,
    room_parameters,
)
from roomfit.signals.filters import statistical_bandwidth_hz
from roomfit.signals.iso3382 import VALUE_NAMES, MeasuredValues, value_gradients
from roomfit.signals.response import ImpulseResponse
from roomfit.tracing.paths import TraceSettings
from roomfit.tracing.trace import trace

ONE_BAND = Bands("octave", np.array([1000.0]))
HEAD = "source,receiver,parameter,125,250\n"


def echogram(seed: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Return rough energies of a decay of 0.8 s after a direct sound at 10 ms, and the edges."""
    edges = 4e-4 * np.arange(-40, 3001)
    middle = 0.5 * (edges[1:] + edges[:-1])
    rough = np.random.default_rng(seed).gamma(1.0, size=middle.size)
    late = np.where(middle > 0.01, np.exp(-13.8 * middle / 0.8) * rough, 0.0)
    return late + np.where(np.abs(middle - 0.01) < 3e-4, 60.0, 0.0), edges, 0.01


@given(st.integers(0, 10**6))
def test_values_are_those_of_the_analysis_of_measurements(seed):
    """One function reads measured curves, the other predicted ones: the same numbers."""
    energy, edges, onset_s = echogram(seed)
    curve = echogram_decay_curve(ONE_BAND, energy[None], edges, onset_s)
    values, _ = value_gradients(curve, 0, PARAMETER_NAMES)
    # both add up some thousand numbers: 1e-13, and the line takes differences of their logarithms
    np.testing.assert_allclose(values, room_parameters(curve).values[:, 0], rtol=1e-10)


@given(st.integers(0, 10**6))
def test_derivatives_by_the_energies_are_those_of_finite_differences(seed):
    """All bins moved at once in a random direction, the evaluated range moving along."""
    energy, edges, onset_s = echogram(seed)
    direction = energy * np.random.default_rng(seed + 1).standard_normal(energy.size)

    def values(step):
        curve = echogram_decay_curve(ONE_BAND, (energy + step * direction)[None], edges, onset_s)
        return value_gradients(curve, 0, VALUE_NAMES)

    here, gradients = values(0.0)
    check_slopes(gradients @ direction, values(-1e-7)[0], here, values(1e-7)[0], 1e-7)


def check_slopes(claimed, before, here, after, step):
    """Check a slope against those on both sides, which differ where the curve has a corner.

    Every boundary between bins is one, and the evaluated range passes over them. Values of 14
    digits leave a slope seven digits at a step of 1e-7; some values are a hundred times it.
    """
    sides = np.array([(here - before) / step, (after - here) / step])
    slack = 1e-4 * np.abs(sides).max(axis=0) + 1e-5 * np.abs(here)
    assert np.all(claimed >= sides.min(axis=0) - slack)
    assert np.all(claimed <= sides.max(axis=0) + slack)


def test_a_pure_exponential_has_the_textbook_values():
    """From its onset on: T of all kinds, C80 = 10 lg(exp(13.8 0.08/T) - 1), TS = T / 13.8."""
    T, edges = 1.0, 1e-4 * np.arange(0, 20001)
    left = np.exp(-6.0 * np.log(10.0) * edges / T)
    energy = left[:-1] - left[1:]
    curve = echogram_decay_curve(ONE_BAND, energy[None], edges, 0.0)
    values = dict(zip(VALUE_NAMES, value_gradients(curve, 0, VALUE_NAMES)[0], strict=True))
    k = 6.0 * np.log(10.0) / T

    for name in ("EDT_s", "T20_s", "T30_s"):
        assert values[name] == pytest.approx(T, rel=1e-5)
    assert values["C80_dB"] == pytest.approx(10.0 * np.log10(np.exp(0.08 * k) - 1.0), abs=1e-6)
    assert values["C50_dB"] == pytest.approx(10.0 * np.log10(np.exp(0.05 * k) - 1.0), abs=1e-6)
    assert values["D50_percent"] == pytest.approx(100.0 * (1.0 - np.exp(-0.05 * k)), abs=1e-6)
    # the integral of the curve by trapezia of 0.1 ms
    assert values["TS_ms"] == pytest.approx(1000.0 / k, rel=1e-6)
    # total energy 1 over that of the direct sound at 10 m
    assert values["G_dB"] == pytest.approx(10.0 * np.log10(4.0 * np.pi * 100.0), abs=1e-9)


def test_smearing_and_its_transpose_agree():
    """<S x, y> = <x, S' y>, and nothing is lost of what lies inside."""
    rng = np.random.default_rng(1)
    spreading = band_spreading(ONE_BAND, 800, 5e-4)
    x, y = rng.random(800), rng.random(800)
    assert spread_energy(spreading, x) @ y == pytest.approx(x @ despread(spreading, y), rel=1e-12)
    lone = np.zeros(800)
    lone[400] = 1.0
    # 1e-11 of an impulse lies farther than 64 periods away
    assert spread_energy(spreading, lone).sum() == pytest.approx(1.0, abs=1e-9)


START = {"absorption": np.full(3, 0.3)}


def exponential_problem(T: float, centre_hz: float) -> ValuesTerm:
    """Return a problem whose rays alone make an exponential decay from the onset on."""
    scene, bands, binned = small_room(np.array([centre_hz]))
    n = 5000
    edges = 5e-4 * np.arange(-100, n - 99)
    middle = 0.5 * (edges[1:] + edges[:-1])
    weight = np.where(middle > 0.0, np.exp(-6.0 * np.log(10.0) * middle / T), 0.0)
    rows = EnergyRows(
        scene.room.materials,
        n,
        np.arange(n + 1),
        weight,
        np.zeros((n, len(scene.room.materials)), dtype=np.uint16),
        np.zeros(n),
        np.zeros(n, dtype=np.int32),
        1,
    )
    measured = MeasuredValues(
        "S", "R1", bands.centres_hz, {"T20_s": np.array([T]), "T30_s": np.array([T])}, {}
    )
    (problem,) = value_terms(scene, bands, [measured], binned)
    assert problem is not None
    problem = replace(problem, model_error_jnd=0.0)
    return replace(
        problem,
        edges_s=edges,
        rows=(rows,),
        spreading=band_spreading(bands, n, 5e-4),
        observations=(replace(problem.observations[0], direct_s=0.0),),
    )


@pytest.mark.parametrize("T", [0.6, 2.0])
def test_interference_scatters_decay_times_as_the_standard_says(T):
    """ISO 3382-2 (from Davy): s(T30) = .55 T (B T)^-1/2, s(T20) = .88 T (B T)^-1/2."""
    problem = exponential_problem(T, 1000.0)
    (covariance,) = value_covariances(problem, START["absorption"])
    b = float(statistical_bandwidth_hz(ONE_BAND)[0])
    t20, t30 = np.sqrt(np.diag(covariance)) / (T / np.sqrt(b * T))
    # the standard's factors are themselves rounded, and hold for a line through the level
    assert t20 == pytest.approx(0.88, rel=0.06)
    assert t30 == pytest.approx(0.55, rel=0.06)
    # T20 is read from a part of what T30 is read from
    assert 0.3 < covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1]) < 0.95
    assert np.all(problem.correlation_length(START) > 1.1)


def exponential_values(names, spread: float = 0.0, jnd: float = 0.0) -> ValuesTerm:
    """Return an exponential decay of 1 s with these values, interference all but taken away."""
    problem = exponential_problem(1.0, 1000.0)
    observed = replace(
        problem.observations[0], names=names, measured=np.ones(len(names)),
        spread=np.full(len(names), spread),
    )  # fmt: skip
    return replace(problem, observations=(observed,), bandwidth_hz=1e12, model_error_jnd=jnd)


def test_the_scatter_by_rays_is_that_of_other_rays():
    """Sixteen batches of independent rays drawn anew 400 times: T20 and C80 of their sums.

    A standard deviation of 400 is known to 3.5 %, and the mean of estimates from 16 batches is
    better known: 15 %.
    """
    names, rng, n_batches = ("T20_s", "C80_dB"), np.random.default_rng(6), 16
    problem = exponential_values(names)
    mean = problem.rows[0].weight_per_m2
    n = mean.size
    found, stated = [], []
    for _ in range(400):
        # of each batch, a bin in ten has a ray
        parts = mean * (rng.random((n_batches, n)) < 0.1) * 10.0 / n_batches
        batch, own = np.nonzero(parts)
        order = np.argsort(own, kind="stable")
        rows = EnergyRows(
            problem.rows[0].materials,
            n,
            np.concatenate(([0], np.cumsum(np.bincount(own, minlength=n)))),
            parts[batch, own][order],
            np.zeros((own.size, len(problem.rows[0].materials)), dtype=np.uint16),
            np.zeros(own.size),
            batch[order].astype(np.int32),
            n_batches,
        )
        drawn = replace(problem, rows=(rows,))
        found.append(drawn.expected(START))
        if len(stated) < 60:
            stated.append(np.diag(value_covariances(drawn, START["absorption"])[0]))
    np.testing.assert_allclose(
        np.sqrt(np.mean(stated, axis=0)), np.std(found, axis=0, ddof=1), rtol=0.15
    )


def test_the_scatter_of_values_is_that_of_random_echoes():
    """Independent of the derivation: exponential energies with the chi-square of each bin."""
    T, edges, b = 1.0, 5e-4 * np.arange(0, 4001), 708.0
    problem = exponential_problem(T, 1000.0)
    rng = np.random.default_rng(5)
    mean = np.diff(-np.exp(-6.0 * np.log(10.0) * edges / T))
    found = []
    for _ in range(600):
        # a window of B dt degrees of freedom scatters by (B dt) ** -1/2: gamma of that shape
        shape = b * 5e-4
        energy = mean * rng.gamma(shape, 1.0 / shape, mean.size)
        curve = echogram_decay_curve(ONE_BAND, energy[None], edges, 0.0)
        found.append(value_gradients(curve, 0, ("T20_s", "T30_s"))[0])
    (covariance,) = value_covariances(problem, START["absorption"])
    # 600 trials know a standard deviation within 2.9 %: four of them, and the bandwidth's rounding
    np.testing.assert_allclose(np.std(found, axis=0), np.sqrt(np.diag(covariance)), rtol=0.13)


def small_room(centres_hz: np.ndarray):
    """Return a scene of a box with three materials and four pairs, traced."""
    walls = dict.fromkeys(("west", "east", "south", "north"), "walls")
    room, _ = read_room(RoomSpec(shoebox=(5.1, 3.7, 2.6), materials=walls))
    source = (Point("S", np.array([1.1, 1.3, 1.2])),)
    places = [(3.9, 2.5, 1.4), (3.1, 0.9, 1.0), (1.7, 2.8, 1.7), (4.2, 1.0, 2.0)]
    receivers = tuple(Point(f"R{i}", np.array(p)) for i, p in enumerate(places, start=1))
    scene = Scene(room, source, receivers, np.array([(0, i) for i in range(4)]), Air(20.0, 50.0))
    bands = Bands("octave", centres_hz)
    settings = TraceSettings(duration_s=0.6, n_rays=4096, image_order=2, seed=3)
    scattering = Scattering(room.materials, np.full(len(room.materials), 0.3))
    return scene, bands, bin_paths(scene, bands, trace(scene, settings, scattering).paths, 0.6)


def measured_from(scene, bands, values, names) -> list[MeasuredValues]:
    """Return predicted values as if they had been measured."""
    return [
        MeasuredValues("S", f"R{i + 1}", bands.centres_hz, dict(zip(names, row, strict=True)), {})
        for i, row in enumerate(values)
    ]


def test_derivatives_by_absorption_are_those_of_finite_differences():
    """Through weights, smearing, curve and evaluation, all eight values of all pairs."""
    scene, bands, binned = small_room(np.array([1000.0]))
    truth = np.array([[0.2], [0.3], [0.4]])
    values = predicted_values(scene, bands, binned, truth)
    priors = tuple(unknown_material(m, 1) for m in scene.room.materials)
    (term,) = value_terms(scene, bands, measured_from(scene, bands, values, VALUE_NAMES), binned)
    problem = without_responses((term,), priors, 0, np.full(1, 0.25))
    assert problem is not None
    vector = start_vector(problem.parameters)
    here = problem.predict(vector)
    for j in range(vector.size):
        step = np.zeros(vector.size)
        step[j] = 1e-7
        after, before = (problem.predict(vector + s * step).expected for s in (1, -1))
        check_slopes(here.jacobian[:, j], before, here.expected, after, 1e-7)


def test_absorption_is_found_again_from_values_alone():
    """With other rays' noise in nothing: the truth is where all values agree."""
    scene, bands, binned = small_room(np.array([1000.0]))
    truth = np.array([[0.15], [0.5], [0.3]])
    names = ("EDT_s", "T20_s", "C80_dB", "D50_percent", "TS_ms", "G_dB")
    values = predicted_values(scene, bands, binned, truth, names)
    priors = tuple(unknown_material(m, 1) for m in scene.room.materials)
    measured = measured_from(scene, bands, values, names)
    # a model held for right, so that the prior has no say
    (term,) = value_terms(scene, bands, measured, binned)
    assert term is not None
    term = replace(term, model_error_jnd=0.0)
    problem = without_responses((term,), priors, 0, np.full(1, 0.25))
    answer = fitted_band(0, problem, priors, Settings()).estimate

    assert answer.chi2_reduced < 0.1
    sd = np.sqrt(np.diag(answer.logit_covariance))
    off = np.log(answer.absorption / (1 - answer.absorption)) - np.log(truth / (1 - truth))[:, 0]
    # without noise in the data only the prior pulls: by less than the stated spread
    assert np.all(np.abs(off) < sd)
    compared = compared_values(measured, values, measured, bands, names)
    assert compared[0]["T20_s"].jnd == pytest.approx(0.0)
    others = np.mean([v.values["C80_dB"][0] for v in measured[1:]])
    assert compared[0]["C80_dB"].null == pytest.approx(others)


def table(tmp_path, text: str, head: str = HEAD):
    path = tmp_path / "measured.csv"
    path.write_text(head + text)
    return path


def test_a_table_is_read_with_its_spread_and_its_gaps(tmp_path):
    """Order of pairs as in the file; empty cells and rows that are not there are unknown."""
    path = table(
        tmp_path,
        "A,1,T20,1.5,\nA,1,T20_sd,0.1,0.2\n# a remark\nB,2,c80,-1.5,2\nA,1,D50,40,50\n",
    )
    (first, second), findings = read_parameters(path)

    assert not findings
    assert (first.source, first.receiver, second.source) == ("A", "1", "B")
    np.testing.assert_array_equal(first.centres_hz, [125.0, 250.0])
    np.testing.assert_array_equal(first.values["T20_s"], [1.5, np.nan])
    np.testing.assert_array_equal(first.spread["T20_s"], [0.1, 0.2])
    np.testing.assert_array_equal(second.values["C80_dB"], [-1.5, 2.0])
    (only,), _ = read_parameters(path, source="B")
    assert only.receiver == "2"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("A,1,T20,20,1\n", r"implausible(.|\n)*line 2, column 4(.|\n)*T20 of 20 s"),
        ("A,1,C80,1,90\n", r"implausible(.|\n)*column 5 \(C80 A 1 at 250 Hz\)"),
        ("A,1,C50,3,3\nA,1,C80,2,4\n", "contradict(.|\n)*C80 of 2 dB and C50 of 3 dB"),
        ("A,1,C50,0,0\nA,1,D50,50,80\n", "contradict(.|\n)*D50 near 50 %"),
        ("A,1,T20,1,1\nA,1,EDT,1,10\n", "contradict(.|\n)*EDT of 10 s"),
        ("A,1,T25,1,1\n", "unknown room parameter"),
        ("A,1,T20,one,1\n", "not a number(.|\n)*line 2, column 4"),
        ("A,1,T20,1,5,1,7\n", "more values than bands(.|\n)*point"),
        ("A,,T20,1,1\n", "without source or receiver"),
        ("A,1,T20,1,1\nA,1,T20_sd,-1,0\n", "below zero"),
    ],
)
def test_bad_tables_are_refused_with_the_place(tmp_path, text, words):
    """What, where, found, needed."""
    with pytest.raises(InputError, match=words):
        read_parameters(table(tmp_path, text))


def test_values_at_many_absorptions_follow_those_that_are_exact():
    """With fewer paths: within a third of a just noticeable difference where changes are two."""
    scene, bands, binned, truth = smooth_box()
    (term,) = box_terms(scene, bands, binned, truth)
    rng = np.random.default_rng(3)
    points = expit(logit(truth) + 0.5 * rng.standard_normal((8, 6)))
    exact = np.array([term.expected({"absorption": p}) for p in points])
    found = approximated(term, truth)(points)
    names = [n for o in term.observations for n in o.names]
    before = term.expected({"absorption": truth})
    unit = np.array([jnd_of(n, np.array(v)) for n, v in zip(names, before, strict=True)])
    np.testing.assert_allclose(approximated(term, truth)(truth[None])[0], before, rtol=1e-12)
    change, error = (
        np.sqrt(np.mean(((x - y) / unit) ** 2, axis=0))
        for x, y in ((exact, before), (found, exact))
    )
    assert error.max() < 0.35
    assert change.max() > 2.0


def test_pressures_in_a_smooth_box_give_what_is_measured_there():
    """By pressures the values of a smooth box are those of a simulator of its own.

    Between uneven walls energies miss T20 by more than four times as much.
    """
    scene, bands, binned, truth = smooth_box()
    (term,) = box_terms(scene, bands, binned, truth)
    wide = bands_between("octave", 500, 2000)
    box = SyntheticBox(
        scene.room.shoebox_m,
        wide.centres_hz,
        np.tile(truth[:, None], len(wide)),
        attenuation_per_m(scene.air, wide),
        speed_of_sound_m_s(scene.air),
    )
    errors = []
    model, at = term.expected({"absorption": truth}), 0
    for i, o in enumerate(term.observations):
        source, receiver = scene.pairs[o.pair]
        ends = scene.sources[source].position_m, scene.receivers[receiver].position_m
        pressure = pressure_response(box, *ends, 0.5, 8000, np.zeros(len(wide)))
        curve = decay_curve(bands, ImpulseResponse(pressure, 8000), o.direct_s)
        true = room_parameters(curve).of("T20_s")[0]
        k = at + o.names.index("T20_s")
        energy = weigh(term.rows[i], truth[:, None], np.zeros(1))
        curve = curve_by_pressures(term, i, truth, energy)
        by_pressures = value_gradients(curve, 0, o.names)[0][k - at]
        errors.append((model[k] / true - 1.0, by_pressures / true - 1.0))
        # the difference stands in the variance, a standard deviation as large as itself
        assert value_covariances(term, truth)[i][k - at, k - at] > (by_pressures - model[k]) ** 2
        at += len(o.names)
    by_energies, by_pressures = np.sqrt(np.mean(np.square(errors), axis=0))
    assert by_pressures < 0.25 * by_energies
    assert by_pressures < 0.05


def smooth_box():
    """Return a small, dead box of six walls that differ much, its paths and their absorption."""
    room = shoebox_room((5.0, 4.2, 2.7), dict(zip(WALLS, WALLS, strict=True)))
    places = {"R1": (3.9, 2.9, 1.3), "R2": (2.2, 3.3, 1.6), "R3": (3.1, 0.9, 1.1)}
    scene = scene_of(room, {"S": (1.1, 1.2, 1.2)}, places)
    truth = np.array([0.05, 0.5, 0.09, 0.9, 0.05, 0.8])
    settings = TraceSettings(duration_s=0.3, n_rays=0, image_order=200, image_until_s=0.3)
    paths = trace(scene, settings, uniform_scattering(room.materials, 0.0)).paths
    return scene, ONE_BAND, bin_paths(scene, ONE_BAND, paths, 0.3), truth


def box_terms(scene, bands, binned, truth):
    expected = predicted_values(scene, bands, binned, truth[:, None])
    measured = [
        MeasuredValues(
            "S", r.name, bands.centres_hz, dict(zip(VALUE_NAMES, expected[i], strict=True))
        )
        for i, r in enumerate(scene.receivers)
    ]
    names = ("T20_s", "EDT_s", "C80_dB", "D50_percent", "TS_ms")
    return value_terms(scene, bands, measured, binned, names=names)
