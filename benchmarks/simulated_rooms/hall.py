"""A closed hall with as many seats as a wanted number of triangles needs."""

from __future__ import annotations

import numpy as np

from roomfit.base.errors import InputError
from roomfit.base.polygon import Surface
from roomfit.base.typing import FloatArray, IntArray
from roomfit.room.mesh import Mesh
from roomfit.room.scene import Room

MATERIALS = ("floor", "walls", "ceiling", "seats")
DEPTH_M, HEIGHT_M = 32.0, 12.0
FRONT_M, BACK_M = 16.0, 26.0  # widths of the stage wall and of the back wall
SHELL_TRIANGLES, SEAT_TRIANGLES = 12, 20

# the block of seats: clear of all walls, rising from front to back
_BLOCK_LOW, _BLOCK_HIGH = np.array([6.0, -7.0]), np.array([30.0, 7.0])
_FIRST_ROW_M, _RISE_PER_M = 0.10, 0.12
# side view of a seat in a cell of 1 by 1: seat to the front, leaning back behind
_PROFILE = np.array(
    [[0.05, 0.0], [0.75, 0.0], [0.95, 0.9], [0.80, 0.9], [0.65, 0.35], [0.05, 0.35]]
)
_PROFILE_TRIANGLES = np.array([[0, 1, 4], [0, 4, 5], [1, 2, 3], [1, 3, 4]])
_SEAT_WIDTH = 0.8  # share of its cell


def hall_room(n_triangles: int = 12_012) -> Room:
    """Return a fan-shaped hall whose seats float a little above a flat floor.

    Closed, with all normals out of the air, and the same on every machine. The hall always has
    the same size; more seats are smaller ones.

    Parameters
    ----------
    n_triangles : int
        At least 12, the empty hall; every seat adds 20. The next number of whole seats below is
        taken.
    """
    if n_triangles < SHELL_TRIANGLES:
        raise InputError(
            "too few triangles for a hall",
            found=str(n_triangles),
            needed=f"at least {SHELL_TRIANGLES}",
        )
    n_seats = (n_triangles - SHELL_TRIANGLES) // SEAT_TRIANGLES
    shell, shell_triangles, owner = _shell()
    seats, seat_triangles = _seats(n_seats)
    mesh = Mesh(
        np.concatenate((shell, seats)),
        np.concatenate((shell_triangles, seat_triangles + len(shell))),
        np.concatenate((owner, np.full(len(seat_triangles), 3))),
        tuple(Surface(name, None, name) for name in MATERIALS),
    )
    return Room(mesh, MATERIALS, np.arange(4))


def hall_volume_m3(n_triangles: int) -> float:
    """Return the volume of the air in `hall_room`, from its measures and not from its mesh."""
    n_seats = (n_triangles - SHELL_TRIANGLES) // SEAT_TRIANGLES
    x, z = _PROFILE.T
    profile = 0.5 * abs(float(x @ np.roll(z, -1) - z @ np.roll(x, -1)))
    length, width = _cell_m(n_seats) if n_seats else np.zeros(2)
    seat = profile * length * length * _SEAT_WIDTH * width
    return float(0.5 * (FRONT_M + BACK_M) * DEPTH_M * HEIGHT_M - n_seats * seat)


def _shell() -> tuple[FloatArray, IntArray, IntArray]:
    plan = [(0.0, -FRONT_M / 2), (DEPTH_M, -BACK_M / 2), (DEPTH_M, BACK_M / 2), (0.0, FRONT_M / 2)]
    corners = np.array([(x, y, z) for z in (0.0, HEIGHT_M) for x, y in plan])
    quads = [(0, 3, 2, 1), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7), (4, 5, 6, 7)]
    triangles = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    return corners, triangles, np.repeat([0, 1, 1, 1, 1, 2], 2)


def _grid(n_seats: int) -> tuple[int, int]:
    """Return rows and seats in a row, the cells about square."""
    depth, width = _BLOCK_HIGH - _BLOCK_LOW
    in_row = max(1, round(np.sqrt(n_seats * width / depth)))
    return -(-n_seats // in_row), in_row


def _cell_m(n_seats: int) -> FloatArray:
    """Return length and width of the place of one seat, at most a metre each."""
    cells: FloatArray = (_BLOCK_HIGH - _BLOCK_LOW) / np.array(_grid(n_seats))
    return np.minimum(cells, 1.0)


def _seats(n_seats: int) -> tuple[FloatArray, IntArray]:
    if n_seats == 0:
        return np.empty((0, 3)), np.empty((0, 3), dtype=np.int64)
    length, width = _cell_m(n_seats)
    _, in_row = _grid(n_seats)
    row, column = np.divmod(np.arange(n_seats), in_row)
    start = np.stack(
        (
            _BLOCK_LOW[0] + row * length,
            _BLOCK_LOW[1] + column * width,
            _FIRST_ROW_M + _RISE_PER_M * row * length,
        ),
        axis=1,
    )
    n = len(_PROFILE)
    side = np.zeros((2 * n, 3))
    side[:, 0] = length * np.tile(_PROFILE[:, 0], 2)
    side[:, 1] = width * np.repeat([0.0, _SEAT_WIDTH], n)
    side[:, 2] = length * np.tile(_PROFILE[:, 1], 2)
    # From the front of the y axis the profile runs counter-clockwise; the air is outside, so
    # the normals point into the seat.
    k = np.arange(n)
    after = (k + 1) % n
    near, far = _PROFILE_TRIANGLES[:, ::-1], _PROFILE_TRIANGLES + n
    mantle = np.concatenate(
        (np.stack((k, after, after + n), axis=1), np.stack((k, after + n, k + n), axis=1))
    )
    one = np.concatenate((near, far, mantle))
    triangles = one[None] + (2 * n * np.arange(n_seats))[:, None, None]
    return (start[:, None] + side[None]).reshape(-1, 3), triangles.reshape(-1, 3)
