"""``roomfit check``: whether a room, or a campaign's room and positions, can be computed."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from roomfit.cli.arguments import Commands, add_command
from roomfit.cli.terminal import say


def add(commands: Commands) -> None:
    about = (
        "Show a room's volume, surface, materials and mean free path, and name each fault.\n\n"
        "For a campaign, the positions of its sources and receivers are examined, too."
    )
    parser = add_command(commands, "check", about, run)
    parser.add_argument(
        "room", type=Path, help="Room (.obj, .ac, .ply, .stl, .glb), or a campaign file (.toml)."
    )
    parser.add_option("--unit", "m, mm, cm, ft or in; needed where the format does not state it.")
    parser.add_option("--up", "Axis that points up: z or y.")


def run(options: argparse.Namespace) -> None:
    """Carry out the command; leave with 2 where the room cannot be traced."""
    from roomfit.errors import InputError
    from roomfit.io.campaign import read_campaign
    from roomfit.io.inputs import check_campaign, check_room
    from roomfit.io.rooms.model import RoomSpec
    from roomfit.report.text import room_text

    room: Path = options.room
    if room.suffix.lower() == ".toml":
        if options.unit is not None or options.up is not None:
            raise InputError(
                "a campaign itself specifies the unit and the axes of its room",
                where=str(room),
                found="--unit or --up",
                hint="write them under [room]",
            )
        result = check_campaign(read_campaign(room))
    else:
        result = check_room(RoomSpec(file=room, unit=options.unit, up=options.up))
    say(room_text(str(room), result))
    if not result.traceable:
        sys.exit(2)
