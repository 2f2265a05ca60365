"""Values of many echograms at once, speech transmission behind a direct sound, products."""

from __future__ import annotations

import numpy as np
import pytest

from roomfit.base.bands import Bands, bands_between
from roomfit.base.errors import InputError
from roomfit.signals import iso3382
from roomfit.signals.decay import echogram_decay_curve, jnd_of
from roomfit.signals.iso3382 import VALUE_NAMES, MeasuredValues, value_gradients, values_of_bins
from roomfit.signals.speech import (
    MODULATIONS_HZ,
    SPEECH_BANDS_HZ,
    speech_transmission,
    sti_of_decay,
)

ONE_BAND = bands_between("octave", 1000, 1000)


@pytest.mark.parametrize("direct", [0.0, 60.0])
@pytest.mark.parametrize("decay_s", [0.3, 0.8, 1.6])
def test_values_of_many_echograms_are_those_of_each(decay_s, direct):
    """A line through 64 levels in place of all: half a just noticeable difference.

    Random decays of one second, by another function. EDT is left out behind a direct sound, where
    the level falls by a step within its range.
    """
    edges_s = 4e-4 * np.arange(-40, 2501)
    middle = 0.5 * (edges_s[1:] + edges_s[:-1])
    rng = np.random.default_rng(17)
    rough = rng.gamma(1.0, size=(6, middle.size))
    energies = np.where(middle > 0.01, np.exp(-13.8 * middle / decay_s) * rough, 0.0)
    loud = direct * rng.uniform(0.2, 1.5, (6, 1))
    energies += np.where(np.abs(middle - 0.01) < 3e-4, loud, 0.0)
    found = values_of_bins(energies, np.ones(1), edges_s, 0.01)
    worst = np.array([0.5 if "T" in n[:2] and n.endswith("_s") else 1e-3 for n in VALUE_NAMES])
    worst[VALUE_NAMES.index("EDT_s")] = np.inf if direct else 0.25
    for own, energy in zip(found, energies, strict=True):
        curve = echogram_decay_curve(ONE_BAND, energy[None], edges_s, 0.01)
        exact, _ = value_gradients(curve, 0, VALUE_NAMES, derivative=False)
        unit = [float(jnd_of(n, np.array(abs(v)))) for n, v in zip(VALUE_NAMES, exact, strict=True)]
        assert np.all(np.abs(own - exact) < worst * np.array(unit)), (own, exact)


@pytest.mark.parametrize("n_bins", [3, 5, 60, 601])
@pytest.mark.parametrize("begins_s", [0.0, 0.25])
def test_the_values_of_an_exponential_decay_are_those_of_its_closed_form(n_bins, begins_s):
    """However early the record ends: what is left goes on as over its last third.

    The energy left is exp(-t / 0.1 s), and its level a straight line, in every bin. The centre of
    gravity is that of trapezoids, whose error is (step / 0.1 s)^2 / 12.
    """
    constant_s, step_s = 0.1, 0.004
    edges_s = begins_s + step_s * np.arange(n_bins + 1)
    left = 3.0 * np.exp(-(edges_s - begins_s) / constant_s)
    energies = np.stack([-np.diff(left), -2.0 * np.diff(left)])
    found = values_of_bins(energies, np.ones(1), edges_s, begins_s)
    of = {name: found[:, row] for row, name in enumerate(VALUE_NAMES)}
    decay_s = constant_s * np.log(1e6)
    for name in ("EDT_s", "T20_s", "T30_s"):
        np.testing.assert_allclose(of[name], decay_s, rtol=1e-6)
    if edges_s[-1] - begins_s > 0.08:
        for name, early_s in (("C50_dB", 0.05), ("C80_dB", 0.08)):
            clarity_db = 10.0 * np.log10(np.expm1(early_s / constant_s))
            # the level within a bin is taken for a line in energy
            np.testing.assert_allclose(of[name], clarity_db, atol=0.01)
        share = 100.0 * -np.expm1(-0.05 / constant_s)
        np.testing.assert_allclose(of["D50_percent"], share, atol=0.1)
    np.testing.assert_allclose(of["TS_ms"], 100.0, rtol=2.0 * (step_s / constant_s) ** 2 / 12.0)
    # of a source that gives 1 W: 1 / (4 pi 100) at 10 m
    wanted_db = 10.0 * np.log10(np.array([3.0, 6.0]) * 400.0 * np.pi)
    np.testing.assert_allclose(of["G_dB"], wanted_db, atol=1e-9)


def test_the_speech_transmission_behind_a_direct_sound_is_that_of_the_closed_form():
    """Half of the energy at once, half in a decay of 1 s: both parts of the modulation add up.

    The direct sound lies in the middle of the first 2 ms, which turns it by 0.1 at 12.5 Hz.
    """
    octaves = Bands("octave", np.array(SPEECH_BANDS_HZ))
    time_s = np.concatenate(([0.0], np.arange(1, 401) * 0.002))
    left = np.where(time_s > 0.0, 0.5 * np.exp(-np.log(1e6) * (time_s - 0.002)), 1.0)
    levels_db = np.tile(10.0 * np.log10(left), (7, 1))
    omega = 2.0 * np.pi * MODULATIONS_HZ
    late = 0.5 * np.exp(-1j * omega * 0.002) / (1.0 + 1j * omega / np.log(1e6))
    exact = np.tile(np.abs(0.5 * np.exp(-1j * omega * 0.001) + late), (7, 1))
    wanted = float(speech_transmission(exact))
    assert sti_of_decay(octaves, time_s, levels_db) == pytest.approx(wanted, abs=0.003)


def values_of(**given: float) -> MeasuredValues:
    return MeasuredValues("S", "R", [500.0], {name: [value] for name, value in given.items()})


def test_values_that_do_not_go_together_are_doubted_and_then_refused():
    """T30 over T20, EDT over either, D50 by its definition from C50: both sides of each limit."""

    def doubts(**given: float) -> int:
        found = iso3382.contradiction_findings(values_of(**given), "a table")
        return 0 if not found else len(found[0].evidence["doubts"])

    for name, doubt, error in (("T30_s", 1.35, 2.5), ("EDT_s", 2.0, 8.0)):
        for ratio in (lambda r: r, lambda r: 1.0 / r):
            given = {"T20_s": 1.0, name: ratio(0.99 * doubt)}
            assert doubts(**given) == 0
            assert doubts(**{**given, name: ratio(1.01 * doubt)}) == 1
            assert doubts(**{**given, name: ratio(0.99 * error)}) == 1
            with pytest.raises(InputError, match="contradict each other"):
                doubts(**{**given, name: ratio(1.01 * error)})
    # where T20 is unknown, EDT is compared with T30, which by itself contradicts nothing
    assert doubts(T30_s=1.0) == doubts(EDT_s=1.0) == doubts(T30_s=1.0, EDT_s=1.9) == 0
    assert doubts(T30_s=1.0, EDT_s=2.1) == 1
    # C50 of 0 dB is D50 of 50 %, one of 10 dB is 1000 / 11 %
    for c50_db, percent in ((0.0, 50.0), (10.0, 1000.0 / 11.0), (-10.0, 100.0 / 11.0)):
        off = -1.0 if percent > 60.0 else 1.0
        assert doubts(C50_dB=c50_db, D50_percent=percent + 4.9 * off) == 0
        assert doubts(C50_dB=c50_db, D50_percent=percent + 5.1 * off) == 1
        assert doubts(C50_dB=c50_db, D50_percent=percent + 19.9 * off) == 1
        with pytest.raises(InputError, match="contradict each other"):
            doubts(C50_dB=c50_db, D50_percent=percent + 20.1 * off)
    assert doubts(C50_dB=1.0, C80_dB=1.0) == 0
    with pytest.raises(InputError, match="C80 at least as large"):
        doubts(C50_dB=1.0, C80_dB=0.99)
