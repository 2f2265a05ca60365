"""The simulator of rooms that are no boxes, against that of boxes, other programs, closed forms."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from images_reference import their_images
from roomfit.demo.boxes import SyntheticBox, box_images, pressure_response
from roomfit.files.campaign import read_campaign
from roomfit.files.rooms import read_room
from roomfit.files.schema import RoomSpec
from simulated_rooms.measured_polyhedron import Shape, polyhedron_plan, write_measured_polyhedron
from simulated_rooms.polyhedra import (
    SyntheticPolyhedron,
    cell_arrays,
    cell_images,
    pressure_responses,
)
from simulated_rooms.polyhedral_rooms import (
    box_room_cells,
    l_shaped_cells,
    paper_cells,
    room_of,
    slanted_cells,
    turned_cells,
    with_moved_planes,
)

CENTRES = np.array([125.0, 250.0, 500.0, 1000.0, 2000.0])
LENGTHS = (5.0, 4.0, 3.0)
ROOMS = {
    "paper": paper_cells(),
    "slanted": slanted_cells(),
    "l-shaped": l_shaped_cells(),
    "turned": turned_cells(),
}
SHAPES: tuple[Shape, ...] = ("paper", "slanted", "l-shaped", "turned")


def truths() -> tuple[SyntheticBox, SyntheticPolyhedron]:
    """Return one box specified in both ways."""
    absorption = np.linspace(0.05, 0.8, 30).reshape(6, 5)
    delays = (0.0, 1e-4, 0.0, 2e-4, 3e-4, 0.0)
    air = np.full(5, 1e-3)
    box = SyntheticBox(LENGTHS, CENTRES, absorption, air, 343.0, delays)
    return box, SyntheticPolyhedron(
        box_room_cells(LENGTHS), CENTRES, absorption, air, 343.0, delays
    )


def test_a_box_has_the_images_of_the_formula() -> None:
    """Every length and every wall's hits within 40 m."""
    source, receiver = np.array([1.03, 1.51, 1.22]), np.array([4.07, 2.53, 1.71])
    box, cells = truths()
    lengths, hits = box_images(box, source, receiver, 40.0 / 343.0)
    own, own_hits = cell_images(cells.cells, source, receiver[None], 40.0)[0]
    assert len(own) == len(lengths) > 4000
    rows, expected = (
        np.column_stack([np.round(a, 9), h]) for a, h in ((own, own_hits), (lengths, hits))
    )
    np.testing.assert_array_equal(
        rows[np.lexsort(rows.T[::-1])], expected[np.lexsort(expected.T[::-1])]
    )


def test_a_box_sounds_as_the_simulator_of_boxes_has_it() -> None:
    """Delays, levels and air included. A rounded time may fall to the next of the fine steps."""
    source, receiver = np.array([1.03, 1.51, 1.22]), np.array([4.07, 2.53, 1.71])
    level = np.array([1.0, -2.0, 0.0, 3.0, -1.0])
    box, cells = truths()
    expected = pressure_response(box, source, receiver, 0.1, 8000.0, level)
    found = pressure_responses(cells, source, receiver[None], 0.1, 8000.0, level)[0]
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("name", SHAPES)
def test_another_program_has_the_same_images(name: Shape) -> None:
    """Of order 5 and below, in single precision there."""
    plan = polyhedron_plan(name, np.random.default_rng(1))
    source = np.array(plan.sources_m["LS1"])
    receiver = np.array(plan.receivers_m["MP1"]) + 0.0123
    room = room_of(plan.cells)
    distance, _ = their_images(room, source, receiver, 5)
    lengths, hits = cell_images(plan.cells, source, receiver[None], distance.max() + 0.1)[0]
    low = np.sort(lengths[hits.sum(axis=1) <= 5])
    assert len(low) == len(distance)
    np.testing.assert_allclose(low, distance, atol=5e-4)


@pytest.mark.parametrize("name", ["paper", "slanted"])
def test_moved_planes_are_where_they_were_sent(name: str) -> None:
    """Each face's plane is shifted by what was asked, turned not at all, and still flat."""
    cells = ROOMS[name]
    shift = np.random.default_rng(2).normal(0.0, 0.02, len(cells.faces))
    moved = with_moved_planes(cells, shift)
    before, after = cell_arrays(cells), cell_arrays(moved)
    np.testing.assert_allclose(after.normal, before.normal, atol=1e-12)
    np.testing.assert_allclose(after.offset_m - before.offset_m, shift, atol=1e-12)
    for f, face in enumerate(moved.faces):
        heights = moved.vertices_m[list(face.corners)] @ before.normal[f]
        np.testing.assert_allclose(heights, before.offset_m[f] + shift[f], atol=1e-12)


def test_the_files_hold_what_was_measured(tmp_path: Path) -> None:
    """The direct sound comes at the specified distance, up to the errors of the positions."""
    import soundfile

    rng = np.random.default_rng(4)
    plan = replace(polyhedron_plan("slanted", rng), duration_s=0.04)
    measured = write_measured_polyhedron(plan, tmp_path, rng, plane_error_m=0.01)
    campaign = read_campaign(measured.campaign)
    assert len(campaign.measurements) == 8
    reported, _ = read_room(RoomSpec(file=tmp_path / "room.obj", unit="m", up="z"))
    vertices = np.array(sorted(map(tuple, np.round(plan.cells.vertices_m, 1))))
    read = np.array(sorted(map(tuple, np.round(reported.mesh.vertices_m, 1))))
    # six planes, 1 cm each: corners move by one to some centimetres, and do move
    assert not np.allclose(
        sorted(reported.mesh.vertices_m[:, 0]), sorted(plan.cells.vertices_m[:, 0])
    )
    assert np.abs(vertices - read).max() < 0.2
    for s, source in plan.sources_m.items():
        for r, receiver in plan.receivers_m.items():
            pressure, rate = soundfile.read(tmp_path / f"{s}_{r}.wav")
            assert pressure.size == round(0.04 * rate)
            arrival = np.linalg.norm(np.subtract(source, receiver)) / 343.99
            # six coordinates of 1 cm: 2.4 cm in all, 0.07 ms, and the pulse's own width
            first = np.flatnonzero(np.abs(pressure) > 0.2 * np.abs(pressure).max())[0] / rate
            assert abs(first - arrival) < 5e-4
