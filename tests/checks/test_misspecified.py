"""Rooms that are described wrongly: what is detected, and what the findings say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roomfit.base.air import Air
from roomfit.base.findings import Code
from roomfit.checks import misfit, positions
from roomfit.materials.priors import unknown_material
from roomfit.pressures.geometry import inflate_position_sds
from roomfit.room.mesh import shoebox_mesh
from roomfit.room.scene import Point, Scene, room_from_mesh
from roomfit.uncertainty.gaussian import prior_only_band
from seen import of_answers, of_tests

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


def test_a_scale_is_in_the_finding():
    assert not list(positions.check_inflated(of_tests(position_sd_scale=1.0)))
    (finding,) = positions.check_inflated(of_tests(position_sd_scale=3.2))
    assert finding.code == Code.POSITION_UNCERTAINTY_INFLATED
    assert "3.2 times" in finding.sentence


def answers(phi: list[float], model: str = "coherent"):
    priors = (unknown_material("a", len(phi)),)
    return [
        replace(prior_only_band(priors, band), chi2_reduced=p, model=model)
        for band, p in enumerate(phi)
    ]


@pytest.mark.parametrize(
    ("phi", "doubtful"),
    [
        ([3.9, 4.2, 2.0, 1.7, 2.0, 1.4], True),
        ([3.9, 1.7, 0.8, 0.9, 1.1, 0.5], False),  # one low band with reasons of its own
        ([2.5, 1.6], True),  # both, as of three bands two at least
        ([4.0, 1.4], False),  # one of two, whose mean is high
        ([4.0], False),
        ([2.5, 1.6, 0.5], True),
    ],
)
def test_many_bands_that_fit_badly_cast_doubt_on_the_description(phi, doubtful):
    found_codes = [f.code for f in misfit.check(of_answers(answers(phi)))]
    assert found_codes == ([Code.MODEL_MISFIT_ALL_BANDS] if doubtful else [])


def test_bands_of_tables_and_bands_without_data_do_not_contribute():
    for model in ("values", "prior"):
        assert not list(misfit.check(of_answers(answers([3.0] * 6, model))))
