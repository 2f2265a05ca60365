"""Rays in plain numpy and closed forms to check the tracer with: slow, short, independent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from roomfit.base.polygon import Surface
from roomfit.base.typing import FloatArray
from roomfit.materials.priors import Scattering
from roomfit.model.energy import Observation, variance_of_batches
from roomfit.model.scattering import scattering_weights
from roomfit.model.weighing import EnergyRows
from roomfit.room.mesh import Mesh, corners_m, shoebox_mesh
from roomfit.room.scene import Room, Scene, triangle_material
from roomfit.tracing.paths import Paths


def flights_m(corners: FloatArray, start: FloatArray, direction: FloatArray) -> FloatArray:
    """Return the distance to every triangle by Cramer's rule; infinity for a miss or behind."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    columns = np.stack((np.broadcast_to(-direction, a.shape), b - a, c - a), axis=2)
    with np.errstate(divide="ignore", invalid="ignore"):
        determinant = np.linalg.det(columns)
        solution = []
        for k in range(3):
            replaced = columns.copy()
            replaced[:, :, k] = start - a
            solution.append(np.linalg.det(replaced) / determinant)
        t, u, v = solution
        inside = (u >= -1e-12) & (v >= -1e-12) & (u + v <= 1.0 + 1e-12) & (t > 1e-9)
    return np.where(inside, t, np.inf)


def crossings(
    scene: Scene, start: FloatArray, direction: FloatArray, radius_m: float, max_length_m: float
) -> list[tuple[float, float, tuple[int, ...]]]:
    """Return (length, chord, hits of each material) of one specular ray for the first receiver."""
    mesh = scene.room.mesh
    corners = corners_m(mesh)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    owner = triangle_material(scene.room)
    centre = scene.receivers[0].position_m
    hits = np.zeros(len(scene.room.materials), dtype=int)
    found, travelled = [], 0.0
    while travelled <= max_length_m:
        flights = flights_m(corners, start, direction)
        wall = int(np.argmin(flights))
        ends = np.clip(_sphere_ends(start - centre, direction, radius_m), 0.0, flights[wall])
        nearest = np.clip((centre - start) @ direction, 0.0, flights[wall])
        if ends[1] > ends[0] and travelled + nearest <= max_length_m:
            found.append((travelled + nearest, ends[1] - ends[0], tuple(hits.tolist())))
        start = start + flights[wall] * direction
        direction = direction - 2.0 * (direction @ normals[wall]) * normals[wall]
        travelled += flights[wall]
        hits[owner[wall]] += 1
    return found


def _sphere_ends(start: FloatArray, direction: FloatArray, radius_m: float) -> FloatArray:
    """Solve |start + t direction| = radius; zeros where there is no solution."""
    roots = np.roots([1.0, 2.0 * start @ direction, start @ start - radius_m**2])
    return np.sort(roots.real) if np.isreal(roots).all() else np.zeros(2)


def direct_energy_per_m2(distance_m: float, radius_m: float) -> float:
    """Return 1 / (4 pi r^2) averaged over a ball whose centre is at `distance_m`.

    Shells about the source: a shell of radius r has the area 2 pi r^2 (1 - cos) inside the ball,
    with cos = (r^2 + R^2 - a^2) / (2 r R); integrating 1 / r^2 over them gives this for R > a and,
    with full shells up to a - R added, for R < a.
    """
    far, a = distance_m, radius_m
    logarithm = np.log((far + a) / abs(far - a))
    integral = 2.0 * np.pi * (a - (far**2 - a**2) / (2.0 * far) * logarithm)
    return float(integral / (4.0 * np.pi) / (4.0 / 3.0 * np.pi * a**3))


def rotated(room: Room, seed: int) -> Room:
    """Return the room turned and moved at random, so that nothing lies along an axis."""
    rng = np.random.default_rng(seed)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.linalg.det(turn)
    old = room.mesh
    mesh = Mesh(
        old.vertices_m @ turn.T + [3.0, -7.0, 11.0],
        old.triangles,
        old.triangle_surface,
        old.surfaces,
    )
    return Room(mesh, room.materials, room.surface_material)


def box_without(triangle: int) -> Room:
    """Return a box of 5 m by 4 m by 3 m that lacks one of its 12 triangles."""
    whole = shoebox_mesh((5.0, 4.0, 3.0))
    kept = np.arange(12) != triangle
    mesh = Mesh(
        whole.vertices_m, whole.triangles[kept], whole.triangle_surface[kept], whole.surfaces
    )
    return Room(mesh, ("wall",), np.zeros(6, dtype=int))


def box_with_panel(kind: str) -> Room:
    """Return a box with a tilted panel in the air, made in one of three ways.

    "sheet": a double-sided face; "wall": one single-sided face; "pair": two single-sided faces in
    one place, back to back, so that either side has a face of its own.
    """
    box = shoebox_mesh((5.0, 4.0, 3.0))
    panel = [[2.1, 0.4, 0.3], [2.3, 3.1, 0.4], [2.9, 3.2, 2.3], [2.7, 0.5, 2.2]]
    faces = [(8, 9, 10), (8, 10, 11)]
    if kind == "pair":
        faces += [(10, 9, 8), (11, 10, 8)]
    mesh = Mesh(
        np.concatenate((box.vertices_m, panel)),
        np.concatenate((box.triangles, faces)),
        np.concatenate((box.triangle_surface, np.full(len(faces), 6))),
        (*box.surfaces, Surface("panel", double_sided=kind == "sheet")),
    )
    return Room(mesh, ("wall", "panel"), np.array([0, 0, 0, 0, 0, 0, 1]))


def box_with_two_floors() -> Room:
    """Return a box of 4 m by 3 m by 2 m whose floor is wood for x < 1 and stone beyond."""
    corners = [
        [x, y, z] for z in (0, 2) for x, y in ((0, 0), (1, 0), (4, 0), (4, 3), (1, 3), (0, 3))
    ]
    sides = [(k, (k + 1) % 6, (k + 1) % 6 + 6, k + 6) for k in range(6)]
    quads = {
        "wood": [(0, 5, 4, 1)],
        "stone": [(1, 4, 3, 2)],
        "rest": [(6, 7, 10, 11), (7, 8, 9, 10), *sides],
    }
    triangles, owner = [], []
    for i, part in enumerate(quads.values()):
        for a, b, c, d in part:
            triangles += [(a, b, c), (a, c, d)]
            owner += [i, i]
    surfaces = tuple(Surface(name) for name in quads)
    mesh = Mesh(np.array(corners, dtype=float), np.array(triangles), np.array(owner), surfaces)
    return Room(mesh, tuple(quads), np.arange(3))


def with_scattering(paths: Paths, scattering: Scattering) -> Paths:
    """Return the same paths with the weights, and the coefficients, of another scattering."""
    return replace(
        paths,
        weight_per_m2=paths.weight_per_m2 * scattering_weights(paths, scattering),
        sampling_scattering=scattering.coefficients[None].copy(),
    )


def batch_energies(rows: EnergyRows, coefficients: FloatArray, air_per_m: FloatArray) -> FloatArray:
    """Return the energies of each batch of rays, (n_batches, n_bands, n_windows), row by row."""
    window = np.repeat(np.arange(rows.n_windows), np.diff(rows.offsets))
    rays = rows.batch >= 0
    out = np.zeros((max(rows.n_batches, rows.largest_batch + 1), air_per_m.size, rows.n_windows))
    for band, m in enumerate(air_per_m):
        left = np.prod((1.0 - coefficients[:, band]) ** rows.hits, axis=1)
        energy = rows.weight_per_m2 * np.exp(-m * rows.length_m) * left
        np.add.at(out[:, band], (rows.batch[rays], window[rays]), energy[rays])
    return out


def monte_carlo_sd(rows: EnergyRows, coefficients: FloatArray, air_per_m: FloatArray) -> FloatArray:
    """Return the standard error of window energies from independent batches of rays."""
    batches = batch_energies(rows, coefficients, air_per_m)
    return np.asarray(np.sqrt(len(batches) * np.var(batches, axis=0, ddof=1)))


def tracing_variance(rows: EnergyRows, observed: Observation, absorption: FloatArray) -> FloatArray:
    """Return the Monte-Carlo variance of each window's energy, batches weighed for it alone."""
    batches = batch_energies(rows, absorption.reshape(-1, 1), np.zeros(1))[:, 0]
    return variance_of_batches(observed.spreading @ batches.T)
