"""The laws of the diffuse field: free paths, Eyring's decay and Kuttruff's correction to it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from _ac3d import as_obj
from followed_rays import FollowedRays, follow_rays
from images_reference import SPEED_M_S, box_room, box_with_sheet, l_shaped_room
from rays_reference import box_with_panel
from roomfit.files.rooms import read_room
from roomfit.files.schema import PolygonSpec, RoomSpec
from roomfit.materials.priors import uniform_scattering
from roomfit.room.mesh import mean_free_path_m, surface_area_m2, volume_m3
from roomfit.room.scene import Room
from simulated_rooms.hall import hall_room

START = [1.5, 1.2, 1.3]


def _followed(room: Room, s: float, duration_s: float, n_rays: int = 2**14) -> FollowedRays:
    times = np.linspace(0.0, duration_s, 61)
    still = uniform_scattering(room.materials, s)
    return follow_rays(room, START, SPEED_M_S, times, n_rays, still, seed=3)


@pytest.fixture(scope="module")
def diffuse_box() -> tuple[Room, FollowedRays]:
    """A box of ordinary shape whose walls scatter everything, for 1.2 s."""
    room = box_room()
    return room, _followed(room, 1.0, 1.2)


def _reverberation_time_s(rays: FollowedRays, alpha: float, duration_s: float) -> float:
    """Fit a line to the logarithm of the energy left, from a tenth of a second on."""
    times = np.linspace(0.0, duration_s, 61)
    left = np.mean((1.0 - alpha) ** rays.hits.sum(axis=2, dtype=np.float64), axis=1)
    fitted = (times > 0.1) & (left > 1e-6)
    return float(-6.0 * np.log(10.0) / np.polyfit(times[fitted], np.log(left[fitted]), 1)[0])


def _eyring_s(room: Room, alpha: float) -> float:
    area, volume = surface_area_m2(room.mesh), volume_m3(room.mesh)
    return float(-24.0 * np.log(10.0) * volume / (SPEED_M_S * area * np.log(1.0 - alpha)))


@pytest.mark.parametrize("alpha", [0.01, 0.02, 0.05])
def test_a_diffuse_room_decays_by_eyring_while_absorption_is_small(diffuse_box, alpha):
    """Within 2 % up to 0.05."""
    room, rays = diffuse_box
    assert _reverberation_time_s(rays, alpha, 1.2) == pytest.approx(
        _eyring_s(room, alpha), rel=0.02
    )


@pytest.mark.parametrize("alpha", [0.05, 0.1, 0.2, 0.3, 0.4, 0.5])
def test_kuttruffs_correction_with_the_traces_own_variance_holds_far_beyond(diffuse_box, alpha):
    """T = T_Eyring / (1 + gamma^2 / 2 ln(1 - a)) within 3 % up to 0.5."""
    room, rays = diffuse_box
    variance = np.var(rays.free_paths_m) / np.mean(rays.free_paths_m) ** 2
    correction = 1.0 + 0.5 * variance * np.log(1.0 - alpha)
    expected = _eyring_s(room, alpha) / correction
    assert _reverberation_time_s(rays, alpha, 1.2) == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize("room", [box_room(), l_shaped_room(), box_with_sheet(), hall_room(1012)])
def test_the_mean_free_path_of_a_diffuse_room_is_four_times_volume_over_surface(room: Room):
    """Concave rooms and both sides of a sheet included.

    A million free paths with a relative spread of about 0.7 leave 0.07 %; the first of the more
    than 30 flights of each ray still depend on where it started. 0.5 % covers both.
    """
    mean = mean_free_path_m(room.mesh)
    rays = _followed(room, 1.0, 70.0 * mean / SPEED_M_S)
    assert rays.free_paths_m.size > 10**6
    assert rays.free_paths_m.mean() == pytest.approx(mean, rel=5e-3)


@pytest.mark.parametrize("s", [0.0, 0.2, 1.0])
@pytest.mark.parametrize("room", [box_room(), box_with_sheet(), hall_room(212)])
def test_no_ray_is_lost_in_a_closed_room(room: Room, s: float):
    """At no absorption the energy is therefore constant, exactly, for every scattering."""
    rays = _followed(room, s, 1.0, n_rays=4096)
    assert rays.present.all()
    assert np.all(np.diff(rays.hits.sum(axis=2, dtype=np.int64), axis=0) >= 0)


@pytest.mark.slow
def test_no_ray_is_lost_in_a_real_room_and_few_in_one_with_leaks(real_data: Path):
    """Half a million hits in a mesh of 504 triangles; the studio leaks at less than one in 1000."""
    closed, _ = read_room(
        RoomSpec(file=as_obj(real_data / "bras_cr2" / "scene9.ac"), unit="m", up="y")
    )
    folder = real_data / "ptb_studio"
    tables = PolygonSpec(
        corners=(folder / "corners.csv",),
        planes=(folder / "planes.csv",),
        drop=tuple(range(351, 357)),
    )
    leaking, _ = read_room(RoomSpec(polygons=tables))
    fractions = []
    for room in (closed, leaking):
        corners = room.mesh.vertices_m
        start = 0.5 * (corners.min(axis=0) + corners.max(axis=0)) + [0.31, 0.27, -0.3]
        still = uniform_scattering(room.materials, 0.1)
        rays = follow_rays(room, start, SPEED_M_S, [1.5], 4096, still)
        assert rays.free_paths_m.size > 400_000
        fractions.append((~rays.present[-1]).sum() / rays.free_paths_m.size)
    assert fractions[0] == 0.0
    assert 0.0 < fractions[1] < 1e-3


@pytest.mark.parametrize("s", [0.0, 0.6])
def test_a_panel_reflects_once_however_it_is_modelled(s: float):
    """A sheet, one face that is struck from behind as well, and two faces back to back.

    The same rays strike the panel and the walls the same number of times; nothing is caught
    between the two faces.
    """
    sheet, wall, pair = (
        _followed(box_with_panel(kind), s, 0.4, n_rays=1024) for kind in ("sheet", "wall", "pair")
    )
    assert sheet.hits[-1, :, 1].sum() > 1000
    np.testing.assert_array_equal(wall.hits, sheet.hits)
    np.testing.assert_array_equal(pair.hits, sheet.hits)
