"""The problems of Suh (2001) by name, and those that the paper leaves open."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np

from roomfit.geometry.measures import volume_m3
from roomfit.identification.start import decay_rate_per_s, eyring_absorption
from roomfit.objective.squares import (
    SquaresProblem,
    grouped_rows,
    in_unit,
    squares_problem,
    window_energies,
)
from roomfit.response.rows import EnergyRows, energy_rows
from roomfit.scene.room import material_areas_m2
from roomfit.testproblems.paper_room import (
    DIVISIONS,
    ENERGY_UNIT_PER_M2,
    SPEED_OF_SOUND_M_S,
    WALLS_APART,
    Division,
    Shape,
    arrivals_ms,
    ill_defined_edges_s,
    paper_edges_s,
    paper_scene,
)
from roomfit.tracing.paths import Paths
from roomfit.typing import FloatArray

EXTREME_ABSORPTION = (0.01, 0.99)

# The problem that stands for each number of materials.
MATERIAL_PROBLEMS: Mapping[int, str] = MappingProxyType(
    {
        2: "case1",
        3: "three_materials",
        4: "four_materials",
        5: "five_materials",
        6: "six_materials",
        7: "seven_materials",
    }
)

Windows = Literal["reflections", "direct", "emission"]


@dataclass(frozen=True, slots=True)
class Specification:
    """What makes a problem.

    Attributes
    ----------
    case : int
        Pair of the scene, 0 to 2.
    division : Division
    truth : tuple of float
    shape : {"paper", "disproportionate"}
    windows : {"reflections", "direct", "emission"}
        5 ms from the first reflection on, or 50 ms from the direct sound or from emission on.
    in_paper : bool
        Whether the paper names it.
    """

    case: int
    division: Division
    truth: tuple[float, ...]
    shape: Shape = "paper"
    windows: Windows = "reflections"
    in_paper: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class PaperProblem:
    """A problem ready to be solved.

    Attributes
    ----------
    name : str
    truth : float array, shape (n_materials,)
    squares : SquaresProblem
        Energies in the paper's unit; measured by the same rays that the model has.
    uniform_start : float
        Absorption which on all walls alike explains the decay.
    """

    name: str
    truth: FloatArray
    squares: SquaresProblem
    uniform_start: float


def _specifications() -> dict[str, Specification]:
    two, extreme = DIVISIONS[2], EXTREME_ABSORPTION
    named = {
        "case1": Specification(0, two, two.truth),
        "case2": Specification(1, two, two.truth),
        "case3": Specification(2, two, two.truth),
        "ill_defined": Specification(0, two, two.truth, windows="direct"),
        "ill_defined_from_emission": Specification(
            0, two, two.truth, windows="emission", in_paper=False
        ),
        "extreme": Specification(0, two, extreme),
        "disproportionate": Specification(0, two, two.truth, "disproportionate"),
        "extreme_and_disproportionate": Specification(0, two, extreme, "disproportionate"),
        "three_materials": Specification(0, DIVISIONS[3], DIVISIONS[3].truth),
    }
    # case 3 is the only one off the room's plane of symmetry, where every wall can be told apart
    for number in (4, 5, 6, 7):
        division = DIVISIONS[number]
        named[MATERIAL_PROBLEMS[number]] = Specification(
            2, division, division.truth, in_paper=False
        )
    return named


SPECIFICATIONS: Mapping[str, Specification] = MappingProxyType(_specifications())


def paper_problem(name: str, paths: Paths) -> PaperProblem:
    """Return a problem by its name, from the paths of `paper_scene` in the shape that it asks for.

    Parameters
    ----------
    name : str
        A key of `SPECIFICATIONS`.
    paths : Paths
    """
    wanted = SPECIFICATIONS[name]
    edges_s = problem_edges_s(paths, wanted)
    rows = division_rows(paths, wanted.case, edges_s, wanted.division)
    return _prepared(name, rows, edges_s, wanted)


def walls_apart_problem(paths: Paths, *, mirrored: bool) -> PaperProblem:
    """Return case 1 with its four side walls taken apart.

    Source and receiver stand on the plane y = 5.35 m, half way between the south and the north
    wall: for every path its mirror image exists, with the hits on these two walls exchanged. A
    finite number of rays breaks this a little.

    Parameters
    ----------
    paths : Paths
        Of the room in its own shape.
    mirrored : bool
        Every traced path and its mirror image count half each, so that the two walls are
        exchangeable to the last digit, as they are in the room.
    """
    wanted = Specification(0, WALLS_APART, WALLS_APART.truth, in_paper=False)
    edges_s = problem_edges_s(paths, wanted)
    rows = division_rows(paths, 0, edges_s, WALLS_APART)
    if mirrored:
        rows = in_unit(_with_mirror_images(rows), 0.5)
    return _prepared("walls_apart", rows, edges_s, wanted)


def exchanged_walls(materials: tuple[str, ...]) -> list[int]:
    """Return the order of materials in which south and north have changed places."""
    other = {"south": "north", "north": "south"}
    return [materials.index(other.get(name, name)) for name in materials]


def problem_edges_s(paths: Paths, wanted: Specification) -> FloatArray:
    """Return the windows of a problem, shape (n_windows + 1,)."""
    direct_ms, first_reflection_ms = arrivals_ms(paths, wanted.case)
    if wanted.windows == "reflections":
        return paper_edges_s(first_reflection_ms)
    return ill_defined_edges_s(direct_ms if wanted.windows == "direct" else 0)


def division_rows(paths: Paths, case: int, edges_s: FloatArray, division: Division) -> EnergyRows:
    """Return the rows of one pair in the paper's unit of energy, hits counted by material."""
    rows = energy_rows(paths, case, edges_s, SPEED_OF_SOUND_M_S)
    grouped = grouped_rows(rows, division.materials, np.array(division.group))
    return in_unit(grouped, ENERGY_UNIT_PER_M2)


def uniform_absorption(energy: FloatArray, edges_s: FloatArray, shape: Shape = "paper") -> float:
    """Return the absorption that Eyring's law reads from the decay of one pair's windows."""
    room = paper_scene(shape).room
    return eyring_absorption(
        decay_rate_per_s(energy, edges_s),
        volume_m3(room.mesh),
        float(np.sum(material_areas_m2(room))),
        SPEED_OF_SOUND_M_S,
    )


def _prepared(
    name: str, rows: EnergyRows, edges_s: FloatArray, wanted: Specification
) -> PaperProblem:
    truth = np.array(wanted.truth)
    squares = squares_problem(rows, window_energies(rows, truth))
    start = uniform_absorption(squares.measured, edges_s, wanted.shape)
    return PaperProblem(name, truth, squares, start)


def _with_mirror_images(rows: EnergyRows) -> EnergyRows:
    exchanged = rows.hits[:, exchanged_walls(rows.materials)]
    return EnergyRows(
        rows.materials,
        rows.n_windows,
        2 * rows.offsets,
        np.repeat(rows.weight_per_m2, 2),
        np.stack((rows.hits, exchanged), axis=1).reshape(-1, len(rows.materials)),
        np.repeat(rows.length_m, 2),
        np.repeat(rows.batch, 2),
        rows.n_batches,
    )
