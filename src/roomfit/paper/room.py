"""The gabled room of Suh (2001) and its problems: minimise the error of equation (1).

The paper's drawing of the room is lost; floor plan, heights and ridge were inferred from the
numbers in its text (arrival times and Table 2), and whatever shows this room must say so:
`RECONSTRUCTED`. Seven planes, each a material of its own; coarser divisions come from `DIVISIONS`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Literal, NamedTuple

import numpy as np

from roomfit.base.air import Air
from roomfit.base.arguments import read_only
from roomfit.base.polygon import Face, Surface
from roomfit.base.typing import FloatArray, IntArray
from roomfit.materials.priors import uniform_scattering
from roomfit.model.weighing import EnergyRows, energy_rows, merge_equal_rows, weigh, weigh_parts
from roomfit.room.build import build_mesh
from roomfit.room.scene import Point, Room, Scene
from roomfit.tracing.paths import Directions, Paths, TraceSettings, hits
from roomfit.tracing.rays import trace_rays


@dataclass(frozen=True, slots=True, eq=False)
class SquaresProblem:
    """One band, no air, no noise: find the absorption whose window energies are the measured ones.

    Without air equal rows can be merged, which changes no energy.
    """

    rows: EnergyRows  # the windows of all pairs end to end
    measured: FloatArray  # (n_windows,), M of equation (1), in the unit of the rows' weights

    def __post_init__(self) -> None:
        object.__setattr__(self, "rows", merge_equal_rows(self.rows))


def window_energies(rows: EnergyRows, absorption: FloatArray) -> FloatArray:
    """Return R of equation (1) for absorption of shape (n_materials,), shape (n_windows,)."""
    return np.asarray(weigh(rows, absorption[:, None], np.zeros(1))[0])


def error(problem: SquaresProblem, absorption: FloatArray) -> float:
    """Return equation (1): the sum of ``(M - R)**2`` over windows.

    `absorption`, shape (n_materials,): 0 to 1.
    """
    difference = window_energies(problem.rows, absorption) - problem.measured
    return float(difference @ difference)


def residuals(problem: SquaresProblem, absorption: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return ``R - M``, shape (n_windows,), and its derivative, shape (n_windows, n_materials)."""
    parts = weigh_parts(problem.rows, None, absorption, 0.0, derivative=True)
    return parts.energy - problem.measured, parts.by_absorption


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


class Division(NamedTuple):
    """How the seven planes are divided into materials."""

    materials: tuple[str, ...]
    group: tuple[int, ...]  # material of each of `PLANES`
    true_absorption: tuple[float, ...]  # of each material in the test problems


DIVISIONS = {
    2: Division(("floor and ceilings", "walls"), (0, 0, 0, 1, 1, 1, 1), TRUE_ABSORPTION),
    3: Division(("floor", "ceilings", "walls"), (0, 1, 1, 2, 2, 2, 2), (0.20, 0.65, 0.35)),
    7: Division(PLANES, (0, 1, 2, 3, 4, 5, 6), (0.20, 0.65, 0.45, 0.35, 0.55, 0.10, 0.25)),
}


def paper_scene(shape: Shape = "paper") -> Scene:
    """Return the room with its three pairs, "S1" to "R1" first; every plane a material of its own.

    The shape "disproportionate" is three times as long and a quarter as wide, positions included.
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
    sources, receivers = (
        tuple(Point(f"{letter}{i}", np.array(p) * stretch) for i, p in enumerate(positions_m, 1))
        for letter, positions_m in (("S", _SOURCES_M), ("R", _RECEIVERS_M))
    )
    pairs = np.array([(i, i) for i in range(len(CASES))])
    air = Air(speed_of_sound_m_s=SPEED_OF_SOUND_M_S, attenuation="none")
    return Scene(room, sources, receivers, pairs, air)


def trace_paper_room(
    scene: Scene, n_rays: int = N_RAYS, directions: Directions = "fibonacci", seed: int = 1
) -> Paths:
    """Return the rays of all three pairs, as the paper traces: specular, 0.2 s, no image sources.

    `scene`: from `paper_scene`. `n_rays`: for each source. `directions`: fibonacci is the
    reconstruction's own; Sobol differs from seed to seed.
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
    """Return the 1 ms bins in which the direct sound and the first reflection arrive."""
    own = paths.pair == pair
    bins = np.floor(1e3 * paths.length_m[own] / SPEED_OF_SOUND_M_S).astype(int)
    reflected = hits(paths)[own].any(axis=1)
    return int(bins[~reflected].min()), int(bins[reflected].min())


def whole_windows_s(first_ms: int, step_ms: int) -> FloatArray:
    """Return the edges of whole windows of some length from a 1 ms bin on, shape (n_windows + 1,).

    Figure 2 has windows of 1 ms from emission on, equation (1) of 5 ms from the first reflection.
    Figure 5 has 50 ms from the direct sound on, as the 5 ms windows start with the first
    reflection; the paper does not say so.
    """
    count: IntArray = np.arange(first_ms, round(1e3 * DURATION_S) + 1, step_ms)
    return count / 1e3


class Specification(NamedTuple):
    """What makes a problem."""

    case: int  # pair of the scene, 0 to 2
    division: Division
    shape: Shape = "paper"
    # 50 ms from the direct sound on, else 5 ms from the first reflection on
    ill_defined: bool = False


_EXTREME = DIVISIONS[2]._replace(true_absorption=(0.01, 0.99))
SPECIFICATIONS: Mapping[str, Specification] = MappingProxyType(
    {
        "case1": Specification(0, DIVISIONS[2]),
        "case2": Specification(1, DIVISIONS[2]),
        "case3": Specification(2, DIVISIONS[2]),
        "ill_defined": Specification(0, DIVISIONS[2], ill_defined=True),
        "extreme": Specification(0, _EXTREME),
        "disproportionate": Specification(0, DIVISIONS[2], "disproportionate"),
        "extreme_and_disproportionate": Specification(0, _EXTREME, "disproportionate"),
        "three_materials": Specification(0, DIVISIONS[3]),
    }
)


def true_absorption(name: str) -> FloatArray:
    """Return the absorption with which a problem of `SPECIFICATIONS` is made, (n_materials,)."""
    return np.array(SPECIFICATIONS[name].division.true_absorption)


def paper_problem(name: str, paths: Paths) -> SquaresProblem:
    """Return a problem of `SPECIFICATIONS`, measured by the rays of the model.

    `paths`: of `paper_scene` in the shape that is specified.
    """
    wanted = SPECIFICATIONS[name]
    direct_ms, first_reflection_ms = arrivals_ms(paths, wanted.case)
    begin_ms, step_ms = (direct_ms, 50) if wanted.ill_defined else (first_reflection_ms, 5)
    windows_s = whole_windows_s(begin_ms, step_ms)
    rows = division_rows(paths, wanted.case, windows_s, wanted.division)
    return SquaresProblem(rows, window_energies(rows, true_absorption(name)))


def division_rows(paths: Paths, case: int, windows_s: FloatArray, division: Division) -> EnergyRows:
    """Return the rows of one pair in the paper's unit of energy, hits counted by material.

    Absorption does not bend rays, so that one trace serves every division into materials.

    `windows_s`, shape (n_windows + 1,): edges of the windows, from emission.
    """
    rows = energy_rows(paths, case, windows_s, SPEED_OF_SOUND_M_S)
    membership = np.array(division.group)[:, None] == np.arange(len(division.materials))
    return replace(
        rows,
        materials=division.materials,
        hits=rows.hits.astype(np.int64) @ membership,
        weight_per_m2=rows.weight_per_m2 * ENERGY_UNIT_PER_M2,
    )


# alpha of floor and ceilings, alpha of walls, error in the paper's unknown unit
TABLE2 = read_only(
    np.array(
        """
        0.010 0.900 448.681; 0.025 0.880 423.263; 0.020 0.900 430.133
        0.010 0.900 448.681; 0.020 0.900 430.133; 0.018 0.930 432.507
        0.003 0.950 458.833; 0.031 0.925 409.098; 0.049 0.867 382.489
        0.111 0.849 293.459; 0.384 0.688 63.880; 0.977 0.221 69.751
        0.402 0.630 53.198; 0.977 0.221 69.751; 0.241 0.790 157.592
        0.653 0.340 0.022; 0.662 0.352 0.129; 0.653 0.340 0.022
        0.653 0.363 0.053; 0.650 0.350 0.000
        """.replace(";", " ").split(),
        dtype=np.float64,
    ).reshape(-1, 3)
)
# Smaller errors are printed with too few digits, and depend on digits of alpha that are not.
COMPARED_ABOVE = 10.0
