"""Surfaces that do not absorb alike over their area."""

from __future__ import annotations

import numpy as np
import pytest

from roomfit.checks import uniformity
from roomfit.pressures.surface_scores import (
    plane_surfaces,
)
from roomfit.room.mesh import surface_area_m2
from roomfit.room.scene import shoebox_room

SURFACES = plane_surfaces(shoebox_room((6.0, 4.5, 3.0), "plaster"))


def test_a_box_has_six_plane_surfaces_whose_cells_lie_in_them():
    assert [s.name for s in SURFACES] == ["west", "east", "south", "north", "floor", "ceiling"]
    for s in SURFACES:
        np.testing.assert_allclose(s.cells_m() @ s.normal, s.offset_m, atol=1e-12)
        size = np.prod(s.upper_m - s.lower_m)
        assert size in (pytest.approx(13.5), pytest.approx(18.0), pytest.approx(27.0))
    mesh = shoebox_room((6.0, 4.5, 3.0), "plaster").mesh
    assert sum(np.prod(s.upper_m - s.lower_m) for s in SURFACES) == pytest.approx(
        surface_area_m2(mesh)
    )


def test_rooms_without_pressures_are_not_examined():
    assert uniformity.most_uneven([]) is None
