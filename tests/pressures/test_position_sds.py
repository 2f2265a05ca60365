"""Standard deviations of positions that arrival times contradict."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from roomfit.base.air import Air
from roomfit.pressures.geometry import inflate_position_sds
from roomfit.room.mesh import shoebox_mesh
from roomfit.room.scene import Point, Scene, room_from_mesh

N_COORDINATES, N_OTHERS = 18, 3


def scene(sd: float | None = 0.01) -> Scene:
    room = room_from_mesh(shoebox_mesh((5.0, 4.0, 3.0)), {}, (5.0, 4.0, 3.0))
    points = [Point(f"P{i}", np.array([1.0 + 0.4 * i, 1.0, 1.0]), sd) for i in range(6)]
    return Scene(room, tuple(points[:2]), tuple(points[2:]), np.array([[0, 0]]), Air())


def test_inflated_positions_are_the_same_positions_with_larger_standard_deviations():
    """Free numbers are in standard deviations: those of positions shrink as these grow."""
    specified = scene()
    specified = replace(
        specified,
        receivers=(replace(specified.receivers[0], position_sd_m=None), *specified.receivers[1:]),
    )
    origin = np.arange(1.0, N_COORDINATES + N_OTHERS + 1.0)
    changed, moved = inflate_position_sds(specified, origin, 2.5)
    assert [p.position_sd_m for p in changed.sources] == [0.025, 0.025]
    assert [p.position_sd_m for p in changed.receivers] == [None, 0.025, 0.025, 0.025]
    assert moved is not None
    factor = np.full(N_COORDINATES, 2.5)
    factor[6:9] = 1.0  # the first receiver, whose standard deviation is unspecified
    np.testing.assert_allclose(moved[:N_COORDINATES] * factor, origin[:N_COORDINATES])
    np.testing.assert_array_equal(moved[N_COORDINATES:], origin[N_COORDINATES:])
    assert inflate_position_sds(specified, None, 2.0)[1] is None
