"""Use case: examine a room, or a campaign's room and positions, before anything is computed."""

from __future__ import annotations

from dataclasses import replace

from roomfit.files.campaign.campaign import Campaign
from roomfit.files.campaign.materials import material_knowledge
from roomfit.files.rooms.read import read_mesh
from roomfit.files.rooms.spec import RoomSpec
from roomfit.scene.positions import position_findings
from roomfit.scene.room_check import RoomCheck, check_mesh
from roomfit.scene.rooms import room_from_mesh


def check_room(spec: RoomSpec) -> RoomCheck:
    """Read a room and tell all that is wrong with it.

    Raises
    ------
    InputError
        The room cannot be read at all, or a key of `spec.materials` matches nothing.
    """
    mesh, findings = read_mesh(spec)
    return check_mesh(mesh, spec.materials, findings)


def check_campaign(campaign: Campaign) -> RoomCheck:
    """Tell all that is wrong with a campaign's room and with where sources and receivers stand.

    Measured files are not opened. Positions are looked at once the room itself has no fault.

    Raises
    ------
    InputError
        The room cannot be read at all; or materials of the campaign and of the room disagree.
    """
    spec = campaign.room
    mesh, findings = read_mesh(spec)
    check = check_mesh(mesh, spec.materials, findings)
    if not check.traceable:
        return check
    room = room_from_mesh(mesh, spec.materials)
    material_knowledge(campaign, room.materials)
    places = position_findings(room, campaign.sources, campaign.receivers)
    return replace(check, findings=(*check.findings, *places))
