"""Use case: examine a room before anything is computed in it."""

from __future__ import annotations

from roomfit.files.rooms.read import read_mesh
from roomfit.files.rooms.spec import RoomSpec
from roomfit.scene.room_check import RoomCheck, check_mesh


def check_room(spec: RoomSpec) -> RoomCheck:
    """Read a room and tell all that is wrong with it.

    Raises
    ------
    InputError
        The room cannot be read at all, or a key of `spec.materials` matches nothing.
    """
    mesh, findings = read_mesh(spec)
    return check_mesh(mesh, spec.materials, findings)
