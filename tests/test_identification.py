"""In which order a room is traced, fitted and examined, and what each step is handed."""

from __future__ import annotations

from dataclasses import replace

import pytest

from roomfit.base.errors import InputError
from roomfit.identify import identify
from roomfit.room.scene import PointGroup, scene_of, shoebox_room


def test_a_group_of_positions_that_are_nobodys_is_refused_before_anything_is_done():
    here, there = {"S": (1.0, 1.0, 1.0)}, {"R1": (2.0, 1.5, 1.0)}
    group = PointGroup("array", ("R1", "P*"), 0.05)
    scene = replace(scene_of(shoebox_room((4.0, 3.0, 2.5), "a"), here, there), groups=(group,))
    with pytest.raises(InputError, match="names neither a source nor a receiver") as refused:
        identify(scene, [])
    assert "'P*'" in str(refused.value) and "S, R1" in str(refused.value)
