"""What a treatment costs, what a standard asks, and how likely a target is: by hand."""

from __future__ import annotations

import numpy as np
import pytest

from roomfit.room.mesh import shoebox_mesh
from roomfit.room.scene import room_from_mesh
from roomfit.treat.standards import standard_target


@pytest.mark.parametrize(("name", "per_m"), [("b3", 0.20), ("b4", 0.25), ("b5", 0.30)])
def test_rooms_below_two_and_a_half_metres_have_the_limits_of_one_that_high(name, per_m):
    """DIN 18041:2016, table 4: A/V of 0.20, 0.25 and 0.30 per metre up to 2.5 m, less above."""

    def limit_s(height_m: float) -> float:
        room = room_from_mesh(shoebox_mesh((6.0, 5.0, height_m)), {})
        return standard_target(f"din-18041-{name}", room)[0].high

    for height_m in (2.0, 2.3, 2.5):
        assert limit_s(height_m) == pytest.approx(0.16 / per_m, rel=0.002)
    # each doubling of the height adds 4.69 log10(2) to the reciprocal of A/V
    assert limit_s(5.0) - limit_s(2.5) == pytest.approx(0.16 * 4.69 * np.log10(2.0), rel=1e-6)
