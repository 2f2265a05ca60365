"""The gabled room of Suh (2001), reconstructed from the arrival times and Table 2 of the paper.

The paper's drawing of the room is lost; floor plan, heights and ridge were inferred from the
numbers that its text carries, and whatever shows this room must say so: `RECONSTRUCTED`.
Seven planes, each a material of its own; coarser divisions come from `DIVISIONS`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from roomfit.air import Air
from roomfit.geometry.build import Face, build_mesh
from roomfit.geometry.mesh import Surface
from roomfit.materials.scattering import uniform_scattering
from roomfit.scene.room import Room
from roomfit.scene.scene import Point, Scene
from roomfit.tracing.paths import Paths, hits
from roomfit.tracing.rays import trace_rays
from roomfit.tracing.settings import Directions, TraceSettings
from roomfit.typing import FloatArray, IntArray

RECONSTRUCTED = "Room reconstructed from the arrival times and Table 2 of the paper."

SPEED_OF_SOUND_M_S = 341.0
DURATION_S = 0.2
N_RAYS = 18_000
RECEIVER_RADIUS_M = 0.5
CASES = ("case1", "case2", "case3")
TRUE_ABSORPTION = (0.65, 0.35)
# What the paper says: 1 ms bins of the direct sound and of the first reflection.
PRINTED_ARRIVALS_MS = {"case1": (11, 15), "case2": (13, 17), "case3": (19, 22)}

# How many of the paper's unknown units of energy make 1/m2: the one common factor that brings the
# errors of this room nearest to Table 2, as `roomfit paper` works out again and reports.
ENERGY_UNIT_PER_M2 = 4796.0

PLANES = ("floor", "ceiling-west", "ceiling-east", "west", "east", "south", "north")
_LENGTH_M, _WIDTH_M = 15.64, 10.70
_RIDGE_M = 8.70
_HEIGHTS_M = (2.88, 4.20, 3.69)  # at x = 0, at the ridge, at x = length
_SOURCES_M = ((9.82, 5.35, 1.70), (9.82, 6.35, 2.70), (10.82, 3.35, 1.50))
_RECEIVERS_M = ((5.82, 5.35, 1.70), (5.82, 4.35, 1.70), (4.82, 6.35, 2.00))

# "Very disproportionate", without numbers in the paper: a corridor 17 times as long as wide.
_STRETCH = {"paper": (1.0, 1.0, 1.0), "disproportionate": (3.0, 0.25, 1.0)}
Shape = Literal["paper", "disproportionate"]


@dataclass(frozen=True, slots=True)
class Division:
    """How the seven planes are divided into materials.

    Attributes
    ----------
    materials : tuple of str
    group : tuple of int
        Material of each of `PLANES`.
    truth : tuple of float
        Absorption of each material in the test problems.
    """

    materials: tuple[str, ...]
    group: tuple[int, ...]
    truth: tuple[float, ...]


DIVISIONS = {
    2: Division(("floor and ceilings", "walls"), (0, 0, 0, 1, 1, 1, 1), TRUE_ABSORPTION),
    3: Division(("floor", "ceilings", "walls"), (0, 1, 1, 2, 2, 2, 2), (0.20, 0.65, 0.35)),
    4: Division(
        ("floor", "ceilings", "end walls", "side walls"),
        (0, 1, 1, 2, 2, 3, 3),
        (0.20, 0.65, 0.35, 0.10),
    ),
    5: Division(
        ("floor", "ceiling-west", "ceiling-east", "end walls", "side walls"),
        (0, 1, 2, 3, 3, 4, 4),
        (0.20, 0.65, 0.45, 0.35, 0.10),
    ),
    6: Division(
        ("floor", "ceiling-west", "ceiling-east", "west", "east", "side walls"),
        (0, 1, 2, 3, 4, 5, 5),
        (0.20, 0.65, 0.45, 0.35, 0.55, 0.10),
    ),
    7: Division(PLANES, (0, 1, 2, 3, 4, 5, 6), (0.20, 0.65, 0.45, 0.35, 0.55, 0.10, 0.25)),
}
WALLS_APART = Division(
    ("floor and ceilings", "west", "east", "south", "north"),
    (0, 0, 0, 1, 2, 3, 4),
    (0.65, 0.35, 0.55, 0.10, 0.25),
)


def paper_scene(shape: Shape = "paper") -> Scene:
    """Return the room with its three pairs, "S1" to "R1" first; every plane a material of its own.

    Parameters
    ----------
    shape : {"paper", "disproportionate"}
        The second is three times as long and a quarter as wide, positions included.
    """
    stretch = np.array(_STRETCH[shape])
    profile = [(0.0, 0.0), (_LENGTH_M, 0.0), (_LENGTH_M, _HEIGHTS_M[2])]
    profile += [(_RIDGE_M, _HEIGHTS_M[1]), (0.0, _HEIGHTS_M[0])]
    corners = np.array([(x, y, z) for y in (0.0, _WIDTH_M) for x, z in profile])
    # corners 0 to 4 run round the south wall from the floor's west end, 5 to 9 the north wall
    outlines = {
        "floor": (0, 5, 6, 1),
        "ceiling-west": (3, 8, 9, 4),
        "ceiling-east": (2, 7, 8, 3),
        "west": (4, 9, 5, 0),
        "east": (1, 6, 7, 2),
        "south": (0, 1, 2, 3, 4),
        "north": (9, 8, 7, 6, 5),
    }
    faces = [Face(outlines[name], Surface(name)) for name in PLANES]
    mesh, _ = build_mesh(corners * stretch, faces)
    room = Room(mesh, PLANES, np.arange(len(PLANES)))
    return Scene(
        room,
        _points("S", _SOURCES_M, stretch),
        _points("R", _RECEIVERS_M, stretch),
        np.array([(i, i) for i in range(len(CASES))]),
        Air(speed_of_sound_m_s=SPEED_OF_SOUND_M_S, attenuation="none"),
    )


def trace_paper_room(
    scene: Scene, n_rays: int = N_RAYS, directions: Directions = "fibonacci", seed: int = 1
) -> Paths:
    """Return the rays of all three pairs, as the paper traces: specular, 0.2 s, no image sources.

    Parameters
    ----------
    scene : Scene
        From `paper_scene`.
    n_rays : int
        For each source.
    directions : {"fibonacci", "sobol"}
        Fibonacci is the reconstruction's own; Sobol differs from seed to seed.
    seed : int
    """
    settings = TraceSettings(
        DURATION_S,
        n_rays=n_rays,
        image_order=-1,
        receiver_radius_m=RECEIVER_RADIUS_M,
        directions=directions,
        n_batches=1,
        seed=seed,
    )
    return trace_rays(scene, settings, uniform_scattering(scene.room.materials, 0.0)).paths


def arrivals_ms(paths: Paths, pair: int) -> tuple[int, int]:
    """Return the 1 ms bins in which the direct sound and the first reflection are first heard."""
    own = paths.pair == pair
    bins = np.floor(1e3 * paths.length_m[own] / SPEED_OF_SOUND_M_S).astype(int)
    reflected = hits(paths)[own].any(axis=1)
    return int(bins[~reflected].min()), int(bins[reflected].min())


def response_edges_s() -> FloatArray:
    """Return the edges of 1 ms bins from emission on (Figure 2), shape (201,)."""
    return _milliseconds(0, 1)


def paper_edges_s(first_reflection_ms: int) -> FloatArray:
    """Return the windows of equation (1): 5 ms from the first reflection, whole ones only."""
    return _milliseconds(first_reflection_ms, 5)


def ill_defined_edges_s(first_ms: int) -> FloatArray:
    """Return windows of 50 ms from a 1 ms bin on, whole ones only.

    For Figure 5 that bin is the one of the direct sound, as the 5 ms windows begin with the first
    reflection. The paper does not say so; from emission on (0 ms) is the other way to read it.
    """
    return _milliseconds(first_ms, 50)


def _milliseconds(first: int, step: int) -> FloatArray:
    count: IntArray = np.arange(first, round(1e3 * DURATION_S) + 1, step)
    return count / 1e3


def _points(
    letter: str, positions_m: tuple[tuple[float, float, float], ...], stretch: FloatArray
) -> tuple[Point, ...]:
    return tuple(
        Point(f"{letter}{i}", np.array(position) * stretch)
        for i, position in enumerate(positions_m, start=1)
    )
