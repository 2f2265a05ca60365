"""What was measured, on one clock and one scene: decay times, ends of windows, joined tables."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from roomfit.bands import bands_between
from roomfit.errors import InputError
from roomfit.inversion.measurements import (
    _joined,
    collect_measurements,
    counted_once,
    fit_ends_s,
    from_emission,
    measured_scene,
    median_decay_s,
    time_scales,
)
from roomfit.measurement import Measurement
from roomfit.scene import PointGroup, scene_of, shoebox_room
from roomfit.signals.iso3382 import MeasuredValues

NAN = np.nan


def response(use: str = "fit", end_s: float = 0.4, **by_name: list[float]) -> Any:
    """Return what is read of a response: its room parameters, and where its windows end."""
    unknown = np.full(2, NAN)
    parameters = SimpleNamespace(of=lambda name: np.array(by_name.get(name, unknown)))
    ends_s = np.array([0.5 * end_s, end_s])
    return SimpleNamespace(
        measurement=SimpleNamespace(use=use), parameters=parameters, fit_end_s=ends_s
    )


def measured(*responses: Any, values: tuple[MeasuredValues, ...] = ()) -> Any:
    return SimpleNamespace(responses=responses, values=values)


def table(receiver: str = "R", hz: tuple[float, ...] = (500.0, 1000.0), use: str = "fit", **row):
    rows = {name: np.array(each, dtype=float) for name, each in row.items()}
    return MeasuredValues("S", receiver, np.array(hz), rows, use=use)


def test_the_longest_decay_is_that_of_t20_or_where_no_pair_has_it_of_edt():
    """Responses and tables alike; what is kept for validation does not count."""
    t20, edt = response(T20_s=[0.3, NAN], EDT_s=[9.0, 9.0]), response(EDT_s=[0.25, 0.2])
    kept = response("validate", 8.0, T20_s=[7.0, 7.0])
    assert time_scales(measured(t20, edt, kept)) == (0.3, 0.3)
    assert time_scales(measured(edt, kept)) == (0.25, 0.25)
    assert time_scales(measured(response(end_s=0.1, T20_s=[0.3, 0.2]))) == (0.3, 0.1)
    for name in ("T30_s", "T20_s", "EDT_s"):
        values = (table(**{name: [0.5, NAN]}),)
        assert time_scales(measured(t20, values=values)) == (0.5, 0.4)
    assert time_scales(measured(t20, values=(table(C50_dB=[3.0, 4.0]),))) == (0.3, 0.3)


def test_where_no_decay_is_known_windows_end_where_the_sound_drowns_or_after_a_second():
    assert time_scales(measured(response())) == (0.0, 0.4)
    assert time_scales(measured(response("validate"))) == (0.0, 1.0)
    assert time_scales(measured(response(end_s=0.0))) == (0.0, 1.0)


def test_the_median_decay_is_of_t20_then_t30_then_edt_band_by_band():
    """A later one takes the place of an earlier one wherever any pair has it."""
    hz = np.array([250.0, 500.0, 1000.0])
    rows = [
        response(T20_s=[NAN, 1.0, NAN], T30_s=[NAN, 5.0, 2.0], EDT_s=[3.0, 6.0, 7.0]),
        response(T20_s=[NAN, 2.0, NAN], T30_s=[NAN] * 3, EDT_s=[4.0, 6.0, 7.0]),
        response(T20_s=[NAN, 6.0, NAN], T30_s=[NAN] * 3, EDT_s=[9.0, 6.0, 7.0]),
        response("validate", T20_s=[8.0] * 3, T30_s=[8.0] * 3, EDT_s=[8.0] * 3),
    ]
    np.testing.assert_array_equal(median_decay_s(measured(*rows), hz), [4.0, 2.0, 2.0])
    tabulated = (table(hz=(500.0, 1000.0), T20_s=[9.0, 4.0]), table(hz=(250.0,), T30_s=[0.5]))
    found = median_decay_s(measured(*rows, values=tabulated), hz)
    np.testing.assert_array_equal(found, [0.5, 4.0, 4.0])
    np.testing.assert_array_equal(median_decay_s(measured(), hz), [NAN] * 3)


def test_windows_end_4_db_above_the_noise_or_where_the_decay_has_fallen_far_enough():
    """The first sample of the curve that lies so far down, itself included; by band."""
    noise = SimpleNamespace(
        usable_end_s=np.array([1.0, 1.0, 0.5]), tail_time_constant_s=np.array([0.1, 0.1, 0.2])
    )
    curve: Any = SimpleNamespace(
        time_s=np.array([0.0, 0.1, 0.2, 0.3]),
        energy_left=np.array([[4.0, 2.0, 0.4, 0.1], [4.0, 2.0, 0.5, 0.5], [8.0, 0.8, 0.1, 0.1]]),
    )
    found = fit_ends_s(noise, curve, 10.0)
    np.testing.assert_allclose(found, [0.2, 1.0 - 0.1 * np.log(2.5), 0.1])


RATE_HZ = 8000


def click(at_s: float, **given: Any) -> Measurement:
    samples = np.zeros(1600)
    samples[round(at_s * RATE_HZ)] = 1.0
    return Measurement("S", "R", samples, RATE_HZ, **given)


def test_files_of_an_unknown_clock_share_the_median_offset_of_their_source_and_state():
    """Those kept for validation say nothing where any other does; others have clocks of theirs."""
    travel_s = [0.01] * 9
    given = [
        *(click(t, time_zero="unknown") for t in (0.03, 0.05, 0.09)),
        click(0.15, time_zero="unknown", use="validate"),
        *(click(t, time_zero="unknown", state="b", use="validate") for t in (0.06, 0.08)),
        click(0.07, time_zero="direct"),
        click(0.07, latency_s=0.02),
    ]
    found = [r.time_zero_s for r in from_emission(given, travel_s[: len(given)])]
    wanted = [0.04] * 4 + [0.06] * 2 + [0.06, 0.02]
    np.testing.assert_allclose(found, wanted, atol=2.0 / RATE_HZ)
    assert found[-1] == 0.02 and len(set(found[:4])) == 1


def test_tables_of_one_pair_are_joined_on_the_bands_of_the_first():
    """Each use by itself; what the second says of other bands is left out."""
    first, other = table(T20_s=[1.0, NAN]), table(hz=(1000.0, 2000.0), T20_s=[1.5, 2.0])
    kept, far = table(T20_s=[7.0, 7.0], use="validate"), table("Q", T20_s=[3.0, 3.0])
    joined, findings = _joined([first, far, kept, other], "fit")
    assert [m.receiver for m in joined] == ["R", "Q"] and not findings
    np.testing.assert_array_equal(joined[0].values["T20_s"], [1.0, 1.5])
    np.testing.assert_array_equal(joined[0].centres_hz, [500.0, 1000.0])
    ((one,), _) = _joined([first, far, kept, other], "validate")
    np.testing.assert_array_equal(one.values["T20_s"], [7.0, 7.0])


ROOM = shoebox_room((4.0, 3.0, 2.5), "wall")
SCENE = scene_of(
    ROOM,
    {"A": (1.0, 1.0, 1.0), "S": (2.0, 1.0, 1.0)},
    {"P": (3.0, 2.0, 1.0), "R": (3.0, 1.0, 1.5), "Q": (1.0, 2.0, 1.0)},
)


def test_a_scene_has_the_pairs_that_were_measured_each_once_and_no_other_point():
    group = PointGroup("all", ("R",), 0.1)
    scene = SCENE.__class__(ROOM, SCENE.sources, SCENE.receivers, SCENE.pairs, SCENE.air,
                            groups=(group,))  # fmt: skip
    found = measured_scene(scene, [click(0.05), table("Q"), click(0.05)])
    assert [p.name for p in found.sources] == ["S"]
    assert [p.name for p in found.receivers] == ["R", "Q"]
    assert found.pairs.tolist() == [[0, 0], [0, 1]]
    assert found.pair_state is None and found.groups == (group,) and found.air is scene.air
    for name, words in (("X", "receiver.*does not have"), ("", "receiver.*does not have")):
        with pytest.raises(InputError, match=words):
            measured_scene(scene, [table(name)])
    with pytest.raises(InputError, match="nothing was measured"):
        collect_measurements(SCENE, [], bands_between("octave", 500, 1000), {})


def test_a_copy_is_left_out_where_it_says_nothing_new_and_the_fitted_one_is_kept():
    """Farther apart than two points can be told from each other, or in another state, it stays."""
    noise = np.random.default_rng(3).normal(size=4000)
    near, far = np.array([2.0, 1.0, 1.0]), np.array([2.0, 1.03, 1.04])

    def copies(use: str, state: str, other_m: np.ndarray) -> tuple[list[str], Any]:
        source = "T" if np.any(other_m != near) else "S"
        scene = scene_of(ROOM, {"S": near, source: other_m}, {"R": (3.0, 1.0, 1.5)})
        one = Measurement("S", "R", noise, RATE_HZ, use=use, name="one")
        two = Measurement(source, "R", noise, RATE_HZ, state=state, name="two")
        left, found = counted_once(scene, [one, two])
        return [m.name for m in left], found

    assert copies("fit", "", near)[0] == ["one"]
    assert copies("validate", "", near)[0] == ["two"]
    assert copies("fit", "b", near)[0] == ["one", "two"]
    names, (copy,) = copies("fit", "", far)
    assert names == ["one", "two"] and copy.apart_m == pytest.approx(0.05)
    assert not copy.is_left_out and (copy.one.name, copy.other.name) == ("one", "two")
