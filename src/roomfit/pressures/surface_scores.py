"""Score tests of surfaces that do not absorb alike over their area, by the places of reflections.

Where a surface is of two materials, is covered or open in part, or has a material in common with
one that it is unlike, reflections return more at some of its places and less at others than one
absorption says. Each surface is cut into twelve cells with one more unknown each, whose scores
follow from the fit as it is (`roomfit.pressures.score_tests`). Under a Gaussian process over places
and octaves they give the Bayes factor against a surface that is alike everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from roomfit.base.forks import in_forks
from roomfit.base.typing import FloatArray, IntArray
from roomfit.fit.fits import SurfaceScore
from roomfit.model.directivity import DirectedTerm
from roomfit.model.parameters import GEOMETRY, physical_values, times_of
from roomfit.model.problem import Values
from roomfit.model.windows import in_windows
from roomfit.pressures.data_term import CoherentTerm
from roomfit.pressures.fit import CoherentFit
from roomfit.pressures.response import (
    ImagePaths,
    binned_energies,
    coherent_response,
    image_energies,
)
from roomfit.pressures.score_tests import scored
from roomfit.room.mesh import (
    Box,
    area_vectors_m2,
    box_of,
    corners_m,
    is_double_sided,
    plane_axes,
)
from roomfit.room.scene import Room, Scene

# Prior standard deviation of what a place returns more than its material, in ln(1 - a); how far
# places, and octaves, are alike.
RETURN_SD, ALIKE_M, PER_OCTAVE = 0.3, 2.0, 0.8
_SAME_PLANE_M, _LEAST_SHARE = 1e-3, 0.03
_ORDER = 3  # of the images of a box that tell places
_SAME_DIRECTION, _NEAR_M = 0.99, 0.2
_CELLS = 4, 3  # of a surface along its axes
N_CELLS = _CELLS[0] * _CELLS[1]


@dataclass(frozen=True, slots=True, eq=False)
class PlaneSurface:
    """One plane part of the room's outline, of one material."""

    name: str
    material: int
    normal: FloatArray  # (3,), out of the room
    offset_m: float  # of its plane from the origin, along the normal
    axes: FloatArray  # (2, 3), unit vectors in the plane
    lower_m: FloatArray  # (2,), where it begins along them
    upper_m: FloatArray  # (2,)

    def cells_m(self) -> FloatArray:
        """Return the middle of every cell, (N_CELLS, 3), the second axis fastest."""
        shares = np.indices(_CELLS).reshape(2, -1).T + 0.5
        along_m = self.lower_m + shares / _CELLS * (self.upper_m - self.lower_m)
        return np.asarray(along_m @ self.axes + self.offset_m * self.normal)


def plane_surfaces(room: Room) -> tuple[PlaneSurface, ...]:
    """Return the large plane parts of a room's surfaces, in order of their first triangle.

    Sheets in the air are left out, and parts of less than 3 % of the area.
    """
    vectors, corners = area_vectors_m2(room.mesh), corners_m(room.mesh)
    areas_m2 = np.linalg.norm(vectors, axis=1)
    owner, unassigned = room.mesh.triangle_surface, (areas_m2 > 0.0) & ~is_double_sided(room.mesh)
    found: list[PlaneSurface] = []
    for seed in range(len(areas_m2)):
        if not unassigned[seed]:
            continue
        normal = vectors[seed] / areas_m2[seed]
        offset_m = float(corners[seed, 0] @ normal)
        own = unassigned & (owner == owner[seed]) & (vectors @ normal > 0.99 * areas_m2)
        own &= np.abs(corners @ normal - offset_m).max(axis=1) < _SAME_PLANE_M
        own[seed] = True
        unassigned &= ~own
        if areas_m2[own].sum() < _LEAST_SHARE * areas_m2.sum():
            continue
        name, axes = room.mesh.surfaces[owner[seed]].name, plane_axes(normal)
        material, along_m = int(room.surface_material[owner[seed]]), corners[own] @ axes.T
        ends_m = along_m.min(axis=(0, 1)), along_m.max(axis=(0, 1))
        found.append(PlaneSurface(name, material, normal, offset_m, axes, *ends_m))
    return tuple(found)


def surface_scores(fit: CoherentFit) -> tuple[SurfaceScore, ...]:
    """Return the score of every surface, of the bands that pressures explain better than energies.

    None of rooms of so many surfaces that no single one matters.
    """
    task = fit.state.task
    surfaces = plane_surfaces(task.scene.room)
    n = len(surfaces)

    def cells_of(b: int) -> list[tuple[int, FloatArray, FloatArray]]:
        """Return band, score and information of the cells of every surface, if a band has any."""
        own, band_fit, windows = fit.state.bands[b], fit.fits[b], fit.windows[b]
        if own is None or band_fit is None or windows is None or not surfaces:
            return []
        term = band_fit.objective(own).terms[0]
        values, _ = physical_values(windows.parameters, windows.fit.vector)
        if isinstance(term, DirectedTerm):
            term = term.radiated(values)
        energies, pressures = fit.log_evidences[b]
        if not isinstance(term, CoherentTerm) or pressures < energies:
            return []
        strikes = _strikes(term.images, task.scene, [m.pair for m in windows.files], surfaces)
        slopes = _slopes(term, values, strikes.reshape(len(strikes), -1))
        score, information = scored(windows, slopes)
        blocks = information.reshape(n, N_CELLS, n, N_CELLS)
        return [(b, own, blocks[k, :, k]) for k, own in enumerate(score.reshape(n, N_CELLS))]

    octaves = np.log2(task.bands.centres_hz)
    found = [cells for cells in in_forks(cells_of, range(len(fit.fits))) if cells]
    each = zip(surfaces, zip(*found, strict=True), strict=True) if found else ()
    return tuple(_score(surface, own, octaves) for surface, own in each)


def _score(
    surface: PlaneSurface, own: Sequence[tuple[int, FloatArray, FloatArray]], octaves: FloatArray
) -> SurfaceScore:
    """Return the evidence of cells that return more or less, alike where near, over that of none.

    A Gaussian process over places and octaves in ln(1 - a), its likelihood that of the scores.
    """
    bands = tuple(band for band, _, _ in own)
    apart_octaves = np.abs(np.subtract.outer(octaves[list(bands)], octaves[list(bands)]))
    positions_m = surface.cells_m()
    apart_m = np.linalg.norm(positions_m[:, None] - positions_m, axis=-1)
    alike = np.kron(PER_OCTAVE**apart_octaves, np.exp(-apart_m / ALIKE_M))
    root = RETURN_SD * np.linalg.cholesky(alike + 1e-9 * np.eye(len(alike)))
    information = block_diag(*(i for _, _, i in own))
    score = root.T @ np.concatenate([s for _, s, _ in own])
    precision = np.eye(score.size) + root.T @ information @ root
    step = np.linalg.solve(precision, score)
    evidence = 0.5 * float(score @ step) - 0.5 * float(np.linalg.slogdet(precision)[1])
    returned = np.asarray((root @ step).reshape(len(bands), -1), dtype=np.float64)
    return SurfaceScore(surface.name, surface.material, bands, positions_m, returned, evidence)


def _strikes(
    images: ImagePaths, scene: Scene, pairs: Sequence[int], surfaces: Sequence[PlaneSurface]
) -> IntArray:
    """Return how often each row strikes each cell of each surface, (n_rows, n_surfaces, N_CELLS).

    In a box all images of low order, elsewhere the first reflections. Images stand at the positions
    of the trace, ends at the specified ones: centimetres apart.
    """
    out = np.zeros((len(images.hits), len(surfaces), N_CELLS), dtype=images.hits.dtype)
    box = box_of(scene.room.mesh)
    order = 1 if box is None else _ORDER
    for o, pair in enumerate(pairs):
        source, receiver = scene.pairs[pair]
        source_m, from_m = scene.sources[source].position_m, scene.receivers[receiver].position_m
        rows = np.unique(images.row[images.offsets[o] : images.offsets[o + 1]])
        n_hits = images.hits[rows].sum(axis=1)
        rows = rows[(n_hits > 0) & (n_hits <= order)]
        to_m = from_m - images.image_to_receiver_m[rows]
        if box is None:
            _strike_once(out, rows, (source_m, from_m), to_m, surfaces)
        else:
            _strike_box(out, rows, from_m, to_m, surfaces, box)
    return out


def _strike_box(
    out: IntArray,
    rows: IntArray,
    from_m: FloatArray,
    to_m: FloatArray,
    surfaces: Sequence[PlaneSurface],
    box: Box,
) -> None:
    """Count where straight lines to the images cross the planes of the lattice of a box."""
    origin_m, axes, lengths_m, _ = box
    from_m, to_m = axes @ (from_m - origin_m), (to_m - origin_m) @ axes.T
    for k, surface in enumerate(surfaces):
        towards = axes @ surface.normal
        axis = int(np.argmax(np.abs(towards)))
        is_upper = towards[axis] > 0.0
        for plane in range(-_ORDER, _ORDER + 1):
            if (plane % 2 == 1) != is_upper:
                continue
            before_m, step_m = plane * lengths_m[axis] - from_m[axis], to_m[:, axis] - from_m[axis]
            met = (before_m * step_m > 0.0) & (np.abs(before_m) < np.abs(step_m))
            share = before_m / step_m[met]
            at_m = from_m + share[:, None] * (to_m[met] - from_m)
            cell = np.floor(at_m / lengths_m)
            folded_m = np.where(
                cell % 2 == 0, at_m - cell * lengths_m, (cell + 1) * lengths_m - at_m
            )
            _count(out, rows[met], surface, k, folded_m @ axes + origin_m)


def _strike_once(
    out: IntArray,
    rows: IntArray,
    ends_m: tuple[FloatArray, FloatArray],
    to_m: FloatArray,
    surfaces: Sequence[PlaneSurface],
) -> None:
    """Count which surface first reflections meet, by the plane between source and image."""
    source_m, from_m = ends_m
    step_m = to_m - source_m
    step_m = step_m / np.linalg.norm(step_m, axis=1)[:, None]
    middle_m = 0.5 * (to_m + source_m)
    for k, surface in enumerate(surfaces):
        met = step_m @ surface.normal > _SAME_DIRECTION
        met &= np.abs(middle_m @ surface.normal - surface.offset_m) < _NEAR_M
        before_m = surface.offset_m - float(from_m @ surface.normal)
        share = before_m / (to_m[met] @ surface.normal - float(from_m @ surface.normal))
        at_m = from_m + share[:, None] * (to_m[met] - from_m)
        _count(out, rows[met], surface, k, at_m)


def _count(out: IntArray, rows: IntArray, surface: PlaneSurface, k: int, at_m: FloatArray) -> None:
    """Add one strike of each row at its place, if that is on the surface."""
    share = (at_m @ surface.axes.T - surface.lower_m) / (surface.upper_m - surface.lower_m)
    on = np.all((share >= 0.0) & (share <= 1.0), axis=1)
    cell = np.minimum(np.floor(share[on] * _CELLS), np.array(_CELLS) - 1).astype(np.int64)
    np.add.at(out[:, k], (rows[on], cell[:, 0] * _CELLS[1] + cell[:, 1]), 1)


def _slopes(term: CoherentTerm, values: Values, hits: IntArray) -> FloatArray:
    """Return the derivative of every window by ln(1 - a) of what paths hit so often.

    Parameters
    ----------
    hits : int array, shape (n_rows, n)
        Beside those of the materials, whose absorption they have.

    Returns
    -------
    float array, shape (n_windows, n)
    """
    n = hits.shape[1]
    times = times_of(term.geometry, values[GEOMETRY])
    times = replace(times, delays_s=np.append(times.delays_s, np.zeros(n)))
    absorption = np.append(values["absorption"], np.zeros(n))
    names = tuple(f"further {k}" for k in range(n))
    every, coherent = term.images, term.coherent
    both = np.concatenate((coherent.hits, hits), axis=1)
    coherent = replace(coherent, materials=(*coherent.materials, *names), hits=both)
    edges_s = tuple(o.fine_edges_s for o in term.early)
    response = coherent_response(coherent, absorption, times, term.grid, edges_s)
    ends = np.cumsum([0, *(o.fine_edges_s.size - 1 for o in term.early)])
    firsts = [
        end + np.searchsorted(o.fine_edges_s, o.edges_s[:-1])
        for end, o in zip(ends, term.early, strict=False)
    ]
    pressures = np.add.reduceat(response.by_log_reflected, np.concatenate(firsts))[:, -n:]
    # what is hit beside the materials absorbs nothing
    energy = image_energies(every, values["absorption"]) * (1.0 - every.coherence)
    rest = []
    for o, observed in enumerate(term.early):
        own = np.arange(every.offsets[o], every.offsets[o + 1])
        own = own[term.bins[own] >= 0]
        n_bins = observed.spreading.shape[1]
        total, by_hits = np.zeros(n_bins), np.zeros((n, n_bins))
        binned_energies(term.bins[own], every.row[own], hits, energy[own], total, by_hits)
        rest.append(in_windows(observed.spreading, by_hits.T))
    gains = np.append(values["gain"], 1.0)
    gain = np.repeat([gains[o.gain] for o in term.early], [o.energy.size for o in term.early])
    slopes = np.zeros((term.measured().size, n))
    slopes[term.early_windows()] = gain[:, None] * (pressures + np.concatenate(rest))
    return slopes
