"""What was measured, on one clock and one scene: decay times, ends of windows, joined tables."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from roomfit.base.bands import bands_between
from roomfit.base.errors import InputError
from roomfit.fit.measurements import (
    collect_measurements,
    counted_once,
    from_emission,
    measured_scene,
)
from roomfit.room.scene import PointGroup, scene_of, shoebox_room
from roomfit.signals.iso3382 import MeasuredValues
from roomfit.signals.measurement import Measurement


def table(receiver: str = "R", hz: tuple[float, ...] = (500.0, 1000.0), use: str = "fit", **row):
    rows = {name: np.array(each, dtype=float) for name, each in row.items()}
    return MeasuredValues("S", receiver, np.array(hz), rows, use=use)


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
