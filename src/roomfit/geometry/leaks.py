"""How much sound a mesh loses through its gaps, measured with rays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roomfit.compiled import kernel
from roomfit.geometry.kernels import along, corner, cross, dot, flight_m, minus, row
from roomfit.geometry.mesh import Mesh, corners_m
from roomfit.typing import FloatArray, IntArray

# A start nearer to a wall than this counts as on it: faces may lie upon each other.
_ON_WALL_M = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Leak:
    """What became of test rays that were followed inside a room.

    Attributes
    ----------
    n_hits, n_escapes : int
        How often a wall was hit, and how many rays met none.
    last_m : float array, shape (n_escapes, 3)
        Where each lost ray started its last flight.
    directions : float array, shape (n_escapes, 3)
        In which direction.
    """

    n_hits: int
    n_escapes: int
    last_m: FloatArray
    directions: FloatArray

    @property
    def fraction(self) -> float:
        """Escapes per hit; 1 where nothing was hit."""
        return min(1.0, self.n_escapes / self.n_hits) if self.n_hits else 1.0


def find_leaks(
    mesh: Mesh, points_m: FloatArray, n_rays: int, seed: int, n_bounces: int = 50
) -> Leak:
    """Follow specular rays from points inside and record those that leave the room.

    Parameters
    ----------
    points_m : float array, shape (n_points, 3)
        Inside the room; the rays are dealt out to them in turn.
    """
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(n_rays, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    starts = np.resize(np.asarray(points_m, dtype=np.float64), (n_rays, 3))
    hits, escaped = _bounce(corners_m(mesh), starts, directions, n_bounces)
    lost = escaped.astype(np.bool_)
    return Leak(int(hits.sum()), int(lost.sum()), starts[lost], directions[lost])


def leak_fraction(mesh: Mesh, points_m: FloatArray, n_rays: int, seed: int) -> float:
    """Return how many rays leave the room for each time one hits a wall; see `find_leaks`."""
    return find_leaks(mesh, points_m, n_rays, seed).fraction


@kernel()
def _bounce(
    corners_m: FloatArray, starts_m: FloatArray, directions: FloatArray, n_bounces: int
) -> tuple[IntArray, IntArray]:
    """Move every ray on, in place, until it has bounced enough or met no wall."""
    hits = np.zeros(len(starts_m), dtype=np.int64)
    escaped = np.zeros(len(starts_m), dtype=np.int64)
    for r in range(len(starts_m)):
        last = -1
        for _ in range(n_bounces):
            nearest, hit = np.inf, -1
            for i in range(len(corners_m)):
                distance = flight_m(corners_m, i, row(starts_m, r), row(directions, r))
                if _ON_WALL_M < distance < nearest and i != last:
                    nearest, hit = distance, i
            if hit < 0:
                escaped[r] = 1
                break
            hits[r] += 1
            last = hit
            starts_m[r, :] = along(row(starts_m, r), row(directions, r), nearest)
            _reflect(corners_m, hit, directions, r)
    return hits, escaped


@kernel()
def _reflect(corners_m: FloatArray, i: int, directions: FloatArray, r: int) -> None:
    """Mirror direction r at triangle i, in place."""
    a = corner(corners_m, i, 0)
    n = cross(minus(corner(corners_m, i, 1), a), minus(corner(corners_m, i, 2), a))
    d = row(directions, r)
    d = along(d, n, -2.0 * dot(d, n) / dot(n, n))
    directions[r, :] = along((0.0, 0.0, 0.0), d, 1.0 / np.sqrt(dot(d, d)))
