"""A simulated campaign in a room of known flat walls.

Sources stand a centimetre or so off their specified positions, the drawing may be a centimetre
wrong, the loudspeaker's level changes from octave to octave, and every file contains noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from roomfit.base.air import Air, attenuation_per_m, speed_of_sound_m_s
from roomfit.base.bands import bands_between
from roomfit.base.errors import InputError
from roomfit.base.typing import FloatArray, Progress
from roomfit.base.whole_files import write_text_atomically
from roomfit.demo.boxes import add_noise
from simulated_rooms.other_turned_box import other_responses
from simulated_rooms.polyhedra import Cells, SyntheticPolyhedron, pressure_responses
from simulated_rooms.polyhedral_rooms import (
    l_shaped_cells,
    obj_text,
    paper_cells,
    slanted_cells,
    turned_cells,
    with_moved_planes,
)

SAMPLING_RATE_HZ = 32_000.0
Shape = Literal["paper", "slanted", "l-shaped", "turned"]
_Place = tuple[float, float, float]

# Sources and receivers at least 0.6 m from all walls, and the length of their responses: 1.3 times
# that of which a fit makes use.
_PLACES: dict[Shape, tuple[tuple[_Place, ...], tuple[_Place, ...], float]] = {
    "paper": (
        ((9.82, 6.05, 1.70), (12.90, 2.70, 1.35)),
        ((4.30, 3.10, 1.20), (5.82, 5.35, 1.70), (2.10, 8.20, 1.45), (8.10, 1.90, 1.05)),
        0.325,
    ),
    "slanted": (
        ((1.25, 1.40, 1.10), (4.70, 3.25, 1.62)),
        ((4.05, 1.35, 1.20), (2.30, 3.40, 1.45), (3.20, 2.25, 1.83), (5.00, 2.20, 0.92)),
        0.26,
    ),
    "l-shaped": (
        ((1.30, 4.90, 1.15), (6.10, 1.25, 1.50)),
        ((2.70, 1.10, 1.20), (1.10, 1.70, 1.45), (4.60, 2.10, 1.05), (2.90, 3.90, 1.75)),
        0.26,
    ),
    "turned": (
        ((2.589, 0.199, 1.50), (4.850, 3.583, 2.02)),
        ((4.401, 2.861, 1.60), (2.417, 2.698, 1.85), (6.228, 1.896, 2.23), (4.560, 0.586, 1.32)),
        0.45,
    ),
}


@dataclass(frozen=True, slots=True, eq=False)
class PolyhedronPlan:
    """A room to be measured: its true walls, and the specified positions."""

    cells: Cells
    absorption: FloatArray  # (n_materials, 8), in octaves from 63 to 8000 Hz
    sources_m: dict[str, _Place]  # by name
    receivers_m: dict[str, _Place]  # by name
    duration_s: float  # of the files, which are cut before the decay ends in noise
    pairs: tuple[tuple[str, str], ...] = ()  # (source, receiver); empty for all


def measured_pairs(plan: PolyhedronPlan) -> tuple[tuple[str, str], ...]:
    """Return source and receiver of every measurement, source by source."""
    every = tuple((s, r) for s in plan.sources_m for r in plan.receivers_m)
    return tuple(pair for pair in every if not plan.pairs or pair in plan.pairs)


def polyhedron_plan(shape: Shape, rng: np.random.Generator) -> PolyhedronPlan:
    """Return a room with absorption drawn anew: even in logit between 0.02 and 0.9.

    It changes from octave to octave by some 0.4 in logit.

    Parameters
    ----------
    shape : {"paper", "slanted", "l-shaped", "turned"}
        The paper's room (622 m3, seven materials), a room of 74 m3 without right angles, an L
        of 97 m3 (six materials each), or a box of 80 m3 with a door and a window (eight).
    """
    if shape not in _PLACES:
        raise InputError("no such room", found=repr(shape), needed=", ".join(_PLACES))
    makers = {"paper": paper_cells, "slanted": slanted_cells, "l-shaped": l_shaped_cells}
    cells = {**makers, "turned": turned_cells}[shape]()
    n = len(cells.materials)
    low, high = np.log(0.02 / 0.98), np.log(0.9 / 0.1)
    logit = rng.uniform(low, high, (n, 1)) + np.cumsum(rng.normal(0.0, 0.4, (n, 8)), axis=1)
    sources, receivers, duration_s = _PLACES[shape]
    return PolyhedronPlan(
        cells,
        1.0 / (1.0 + np.exp(-np.clip(logit, low, high))),
        {f"LS{i}": place for i, place in enumerate(sources, start=1)},
        {f"MP{i}": place for i, place in enumerate(receivers, start=1)},
        duration_s,
    )


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPolyhedron:
    """A simulated campaign and the true absorption."""

    campaign: Path  # The campaign file; room.obj and its WAV files lie beside it
    materials: tuple[str, ...]
    centres_hz: FloatArray  # (n_bands,), octaves, 63 to 8000 Hz
    absorption: FloatArray  # (n_materials, n_bands)


def write_measured_polyhedron(
    plan: PolyhedronPlan,
    folder: Path,
    rng: np.random.Generator,
    *,
    position_error_m: float = 0.01,
    plane_error_m: float = 0.0,
    delays_s: tuple[float, ...] | None = None,
    noise_db: float = -60.0,
    loudspeaker_db: float = 3.0,
    other_program: bool = False,
    progress: Progress | None = None,
) -> MeasuredPolyhedron:
    """Simulate measured responses of every pair in a room and write them as a campaign.

    Parameters
    ----------
    folder : Path
        An existing folder.
    rng : numpy.random.Generator
        Draws the errors of positions and planes, loudspeaker levels and noise.
    position_error_m : float
        Standard deviation of each true coordinate about the specified one.
    plane_error_m : float
        Standard deviation of each specified plane along its normal about the true one; rooms of
        one cell only.
    delays_s : tuple of float, optional
        What each material adds to the travel time at every reflection.
    noise_db : float
        Level of the noise relative to the peak of each response.
    loudspeaker_db : float
        Standard deviation of each source's level from octave to octave.
    other_program : bool
        Pyroomacoustics simulates the turned box, with an even loudspeaker.

    Raises
    ------
    InputError
        Errors of planes in a room that is not convex.
    """
    import soundfile

    bands = bands_between("octave", 63, 8000)
    air = Air()
    specified = _specified(plan.cells, plane_error_m, rng)
    synthetic = SyntheticPolyhedron(
        plan.cells,
        bands.centres_hz,
        plan.absorption,
        attenuation_per_m(air, bands),
        speed_of_sound_m_s(air),
        (0.0,) * len(plan.cells.materials) if delays_s is None else delays_s,
    )
    true_at = {
        name: np.array(place) + position_error_m * rng.standard_normal(3)
        for name, place in (*plan.sources_m.items(), *plan.receivers_m.items())
    }
    for number, s in enumerate(plan.sources_m):
        own = [r for source, r in measured_pairs(plan) if source == s]
        receivers = np.array([true_at[r] for r in own]).reshape(-1, 3)
        level_db = rng.normal(0.0, loudspeaker_db, len(bands))
        where = synthetic, true_at[s], receivers, plan.duration_s, SAMPLING_RATE_HZ
        if other_program:
            pressures = other_responses(*where)
        else:
            pressures = pressure_responses(*where, level_db)
        for r, pressure in zip(own, pressures, strict=True):
            soundfile.write(
                folder / f"{s}_{r}.wav",
                add_noise(pressure, noise_db, rng).astype(np.float32),
                int(SAMPLING_RATE_HZ),
                subtype="FLOAT",
            )
        if progress is not None:
            progress((number + 1) / len(plan.sources_m))
    write_text_atomically(folder / "room.obj", obj_text(specified))
    text = _campaign_text(plan, position_error_m)
    campaign = write_text_atomically(folder / "campaign.toml", text)
    return MeasuredPolyhedron(campaign, plan.cells.materials, bands.centres_hz, plan.absorption)


def _specified(cells: Cells, plane_error_m: float, rng: np.random.Generator) -> Cells:
    if plane_error_m == 0.0:
        return cells
    if any(face.material < 0 for face in cells.faces):
        raise InputError(
            "planes can be misplaced in a convex room only",
            found=f"{1 + max(face.cell for face in cells.faces)} cells",
            needed="one",
        )
    return with_moved_planes(cells, plane_error_m * rng.standard_normal(len(cells.faces)))


def _campaign_text(plan: PolyhedronPlan, position_error_m: float) -> str:
    lines = ["[room]", 'file = "room.obj"', 'unit = "m"', 'up = "z"']
    lines += ["[air]", "temperature_c = 20.0", "humidity_percent = 50.0"]
    for name in plan.cells.materials:
        lines += [f'[materials."{name}"]', "scattering = 0.0  # smooth, bare walls"]
    for kind, points in (("sources", plan.sources_m), ("receivers", plan.receivers_m)):
        for name, position in points.items():
            lines += [f"[{kind}.{name}]", f"position = {list(position)}"]
            lines += [f"position_sd = {position_error_m}"]
    for s, r in measured_pairs(plan):
        lines += ["[[measurements]]", f'source = "{s}"', f'receiver = "{r}"']
        lines += [f'file = "{s}_{r}.wav"']
    lines += ["[identify]", 'bands = "octave"', "from_hz = 125", "to_hz = 4000", "seed = 1"]
    return "\n".join(lines) + "\n"
