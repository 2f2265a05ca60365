"""Another program beside roomfit: scenes are written, answers read, the program stays outside."""

from __future__ import annotations

import json
import math
import sys

import numpy as np
import pytest

pytest.importorskip("resource", reason="processor seconds of a child, as POSIX counts them")

import _peer
from roomfit.base.air import Air
from roomfit.base.errors import InputError
from roomfit.room.scene import Point, Scene, shoebox_room

LENGTHS_M = (5.0, 4.0, 3.0)
WALLS = ("west", "east", "south", "north", "floor", "ceiling")


def scene() -> Scene:
    """Return a box of six materials, two sources and one receiver."""
    room = shoebox_room(LENGTHS_M, dict(zip(WALLS, ("a", "b", "c", "d", "e", "f"), strict=True)))
    sources = tuple(Point(f"S{i}", np.array([1.0 * i, 1.0, 1.5])) for i in (1, 2))
    receivers = (Point("R1", np.array([4.0, 3.0, 1.25])),)
    return Scene(room, sources, receivers, np.array([(0, 0), (1, 0)]), Air(18.0, 40.0, 99.0))


def answer() -> dict[str, object]:
    """Return an answer in the documented form: absorption i/10 of material i, plus octave/100."""
    tables = {
        f"m{i}": {
            "absorption": [i / 10 + octave / 100 for octave in range(8)],
            "uncertainty": [0.05 * i if octave != 3 else None for octave in range(8)],
        }
        for i in (2, 1)
    }
    return {"bands_hz": [63, 125, 250, 500, 1000, 2000, 4000, 8000], "materials": tables}


def test_each_wall_of_a_box_is_its_own_group_with_normals_into_the_room(tmp_path):
    """Read by hand: material i lies in the i-th plane, and every face looks at the middle."""
    _peer.write_scene(scene(), np.zeros(6), tmp_path)
    corners, faces, group = [], {}, ""
    for line in (tmp_path / "room.obj").read_text().splitlines():
        key, *rest = line.split()
        if key == "v":
            corners.append([float(x) for x in rest])
        elif key == "g":
            group = rest[0]
        else:
            faces.setdefault(group, []).append([int(x) - 1 for x in rest])
    assert list(faces) == ["m1", "m2", "m3", "m4", "m5", "m6"]
    for number, triangles in enumerate(faces.values()):
        axis, far = divmod(number, 2)
        area = 0.0
        for a, b, c in (np.array([corners[i] for i in triangle]) for triangle in triangles):
            assert {a[axis], b[axis], c[axis]} == {LENGTHS_M[axis] if far else 0.0}
            normal = np.cross(b - a, c - a)
            assert normal @ (np.array(LENGTHS_M) / 2 - a) > 0.0
            area += 0.5 * float(np.linalg.norm(normal))
        assert area == pytest.approx(math.prod(LENGTHS_M) / LENGTHS_M[axis], rel=1e-12)


def test_an_answer_is_read_by_material_and_octave_and_no_error_holds_nothing(tmp_path):
    """1.96 standard errors, cut at 0 and 1; a standard error of null leaves 0 to 1."""
    (tmp_path / "fit.json").write_text(json.dumps(answer()))
    fit = _peer.read_fit(tmp_path / "fit.json", 2, np.array([125.0, 500.0, 4000.0]))
    np.testing.assert_allclose(fit.absorption, [[0.11, 0.13, 0.16], [0.21, 0.23, 0.26]])
    low, high = fit.bounds
    np.testing.assert_allclose(low, [[0.012, 0.0, 0.062], [0.014, 0.0, 0.064]], atol=1e-12)
    np.testing.assert_allclose(high, [[0.208, 1.0, 0.258], [0.406, 1.0, 0.456]], atol=1e-12)


def test_a_program_that_fails_says_so_and_one_that_computes_is_charged_for_it(tmp_path):
    """Half a second of processor time spent by the child, whatever its clock says."""
    program = tmp_path / "program"
    program.write_text(
        f"#!{sys.executable}\nimport sys, time\n"
        "while time.process_time() < 0.5: pass\n"
        "sys.exit('no ' + sys.argv[2] if sys.argv[1] == 'simulate' else 0)\n"
    )
    program.chmod(0o755)
    assert 0.5 <= _peer.run_peer(str(program), ["calibrate"]) < 5.0
    with pytest.raises(InputError, match="exit code 1: no room"):
        _peer.run_peer(str(program), ["simulate", "room"])
