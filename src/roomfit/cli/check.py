"""``roomfit check``: whether a room can be computed, and a campaign fitted."""

from __future__ import annotations

import argparse
import shlex
import sys
from pathlib import Path

from roomfit.cli.arguments import Commands, add_command, number_range
from roomfit.cli.terminal import say
from roomfit.report.progress import shown_progress

_IN_DOUBT = 1


def add(commands: Commands) -> None:
    about = (
        "Show a room's volume, surface, materials and mean free path, and name each fault.\n\n"
        "For a campaign, positions and recordings are examined, too: what could be wrong is said "
        "before anything is fitted. Exit codes: 0 fine; 1 a finding that voids the answer, or a "
        "recording or a band of no use; 2 bad input."
    )
    parser = add_command(commands, "check", about, run)
    parser.add_argument(
        "room", type=Path, help="Room file, such as room.obj, or a campaign file (.toml)."
    )
    parser.add_option("--unit", "m, mm, cm, ft or in; needed where the format does not state it.")
    parser.add_option("--up", "Axis that points up: z or y.")
    parser.add_option(
        "--bands",
        "Of a campaign: bands to examine, as 500-2000, in place of from_hz and to_hz.",
        type=number_range,
    )
    parser.add_option(
        "--out", "Of a campaign: folder for a picture of room and positions.", type=Path
    )
    parser.add_overwrite()


def run(options: argparse.Namespace) -> None:
    """Carry out the command; leave with 2 where the room cannot be traced."""
    from roomfit.errors import InputError
    from roomfit.io.campaign import read_campaign
    from roomfit.io.inputs import check_campaign, check_room
    from roomfit.io.rooms.model import RoomSpec
    from roomfit.report.text import room_text

    room: Path = options.room
    if room.suffix.lower() != ".toml" and not room.is_dir():
        if options.out is not None:
            raise InputError("a room by itself has no positions to draw", found="--out")
        if options.bands is not None:
            raise InputError("a room by itself has no bands", found="--bands")
        result = check_room(RoomSpec(file=room, unit=options.unit, up=options.up))
        say(room_text(str(room), result))
        sys.exit(0 if result.traceable else 2)
    if options.unit is not None or options.up is not None:
        raise InputError(
            "a campaign itself specifies the unit and the axes of its room",
            where=str(room),
            found="--unit or --up",
            hint="write them under [room]",
        )
    campaign = read_campaign(room)
    result = check_campaign(campaign)
    say(room_text(str(room), result))
    if not result.traceable:
        sys.exit(2)
    if campaign.spectra:
        return  # of impedances: there are no recordings to examine
    from roomfit.commands import check_campaign_recordings  # all of roomfit: not for a room

    with shown_progress("examining recordings (longer the first time, which compiles)"):
        checked = check_campaign_recordings(
            campaign, options.out, between_hz=options.bands, overwrite=options.overwrite
        )
    say(f"\n{checked}")
    if options.out is not None:
        say(f"\nroom.png is in {options.out}")
    if checked.in_doubt:
        sys.exit(_IN_DOUBT)
    say(f"\nthen: roomfit identify {shlex.quote(str(room))} --out result")
