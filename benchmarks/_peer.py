"""The program acoustic-spaces, driven by its command line alone: scenes out, its answers in.

Of the other program nothing is imported and nothing is part of roomfit: its file formats are those
of its documentation. Scenes are JSON, which is YAML as well, with the room as an OBJ file.
"""

from __future__ import annotations

import json
import resource
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from roomfit.base.errors import InputError
from roomfit.base.typing import FloatArray
from roomfit.room.scene import Scene, triangle_material
from roomfit.signals.iso3382 import MeasuredValues, ValueName

OCTAVES_HZ = (63, 125, 250, 500, 1000, 2000, 4000, 8000)  # of every list of eight
START = 0.15  # absorption of every wall before the fit
FITTED: dict[ValueName, str] = {"T30_s": "t30", "EDT_s": "edt", "C80_dB": "c80"}  # by default
SEED = "1"  # of its rays, so that a run can be repeated


@dataclass(frozen=True, eq=False)
class PeerFit:
    """What the other program found, in some of its octaves."""

    absorption: FloatArray  #: (n_materials, n_bands), 0 to 1
    #: (n_materials, n_bands), its standard error, 0 or more; inf where it has none
    sd: FloatArray

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper bound of 1.96 standard errors, within 0 to 1, (n_materials, n_bands)."""
        low, high = self.absorption - 1.96 * self.sd, self.absorption + 1.96 * self.sd
        return np.clip(low, 0.0, 1.0), np.clip(high, 0.0, 1.0)


def write_scene(
    scene: Scene, scattering: FloatArray, folder: Path, *, diffraction: bool = True
) -> Path:
    """Write a scene and its room into an existing folder; return the scene's file.

    Parameters
    ----------
    scene : Scene
        Materials are named m1, m2, ... in their order: names of surfaces must be free of blanks.
    scattering : float array, shape (n_materials,)
        0 to 1, alike in all octaves.
    folder : Path
    diffraction : bool
        As it comes, at edges of first order; or none.
    """
    names = [f"m{i + 1}" for i in range(len(scene.room.materials))]
    (folder / "room.obj").write_text(_obj_text(scene, names))
    materials = {
        name: {"absorption": [START] * len(OCTAVES_HZ), "scattering": float(s)}
        for name, s in zip(names, scattering, strict=True)
    }
    sources = [
        {"name": s.name, "position": s.position_m.tolist(), "directivity": "omni"}
        for s in scene.sources
    ]
    content: dict[str, object] = {
        "name": "roomfit",
        "geometry": {"file": "room.obj", "units": "m"},
        "materials": materials,
        "assignments": {name: name for name in names},
        "sources": sources,
        "listeners": [{"name": r.name, "position": r.position_m.tolist()} for r in scene.receivers],
        "air": {
            "temperature_c": scene.air.temperature_c,
            "humidity_percent": scene.air.humidity_percent,
            "pressure_kpa": scene.air.pressure_kpa,
        },
    }
    if not diffraction:
        content["simulation"] = {"early": {"diffraction": "none"}}
    path = folder / "scene.json"
    path.write_text(json.dumps(content, indent=1))
    return path


def _obj_text(scene: Scene, names: list[str]) -> str:
    """Return the mesh, one group a material, normals into the room as there."""
    mesh, owner = scene.room.mesh, triangle_material(scene.room)
    lines = ["v {!r} {!r} {!r}".format(*row) for row in mesh.vertices_m.tolist()]
    for i, name in enumerate(names):
        lines.append(f"g {name}")
        lines += ["f {2} {1} {0}".format(*row) for row in (mesh.triangles[owner == i] + 1).tolist()]
    return "\n".join(lines) + "\n"


def write_values(values: list[MeasuredValues], path: Path) -> None:
    """Write measured room parameters as the other program reads them, null where missing."""
    pairs = {}
    for v in values:
        rows = {theirs: v.at(ours, np.array(OCTAVES_HZ)) for ours, theirs in FITTED.items()}
        pairs[f"{v.source} {v.receiver}"] = {
            name: [float(x) if np.isfinite(x) else None for x in row] for name, row in rows.items()
        }
    path.write_text(json.dumps({"pairs": pairs}))


def found_program(program: str) -> str:
    """Return where the other program is.

    Raises
    ------
    InputError
        There is no such program.
    """
    found = shutil.which(program)
    if found is None:
        raise InputError(
            "the other program is not there",
            found=program,
            needed="the path of acoustic-spaces 4, which is no part of roomfit",
            hint="pip install acoustic-spaces into an environment of its own, and give the path "
            "of its command",
        )
    return found


def run_peer(program: str, arguments: list[str]) -> float:
    """Run the other program to its end; return its processor seconds.

    Raises
    ------
    InputError
        There is no such program, or it failed.
    """
    found = found_program(program)
    before = _children_s()
    ended = subprocess.run([found, *arguments], capture_output=True, text=True, check=False)
    if ended.returncode:
        raise InputError(
            "the other program failed",
            where=" ".join([program, arguments[0]]),
            found=f"exit code {ended.returncode}: {ended.stderr.strip()}",
            needed="exit code 0",
            hint="these commands are those of its version 4",
        )
    return _children_s() - before


def _children_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def read_fit(path: Path, n_materials: int, centres_hz: FloatArray) -> PeerFit:
    """Read what `calibrate --json` wrote of the materials m1, m2, ... of `write_scene`.

    A standard error that is null is infinite: the other program found that nothing holds the value.

    Raises
    ------
    InputError
        A material or an octave is missing.
    """
    content = json.loads(path.read_text())
    try:
        columns = [content["bands_hz"].index(round(f)) for f in centres_hz]
        tables = [content["materials"][f"m{i + 1}"] for i in range(n_materials)]
        rows = [
            [t[key][i] for i in columns] for key in ("absorption", "uncertainty") for t in tables
        ]
    except (KeyError, IndexError, ValueError) as missing:
        raise InputError(
            "the other program's answer lacks a material or an octave",
            where=str(path),
            found=f"no {missing}",
            needed=f"materials m1 to m{n_materials}, octaves of eight",
        ) from None
    numbers = np.array([[np.inf if x is None else x for x in row] for row in rows])
    return PeerFit(numbers[:n_materials], numbers[n_materials:])


def read_predicted(path: Path, source: str, receiver: str, centres_hz: FloatArray) -> FloatArray:
    """Read a pair's T30, EDT and C80 from what `simulate` wrote, shape (3, n_bands), nan if null.

    Raises
    ------
    InputError
        The pair is missing.
    """
    content = json.loads(path.read_text())
    columns = [content["bands_hz"].index(round(f)) for f in centres_hz]
    for pair in content["responses"]:
        if (pair["source"], pair["listener"]) == (source, receiver):
            rows = [[pair["parameters"][key][i] for i in columns] for key in FITTED.values()]
            return np.array([[np.nan if x is None else x for x in row] for row in rows])
    raise InputError(
        "the other program's answer lacks a pair",
        where=str(path),
        found=f"no {source} to {receiver}",
        needed="every pair of the scene",
    )
