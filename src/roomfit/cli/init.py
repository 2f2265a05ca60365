"""``roomfit init``: a first campaign file from a room, recordings and positions."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from roomfit.cli.arguments import Commands, add_command, number
from roomfit.cli.terminal import say


def add(commands: Commands) -> None:
    about = (
        "Write a first campaign.toml for a folder of recordings.\n\n"
        "Sources, receivers and measurements come from the names of the files; what is not known "
        "is marked FILL IN."
    )
    parser = add_command(commands, "init", about, run)
    parser.add_argument("folder", type=Path, help="Folder of the campaign to be.")
    parser.add_option(
        "--room",
        "Room (.obj, .ac, .ply, .3ds, .stl, .glb, .geo, .dxf, .dae, .ifc) of the campaign.",
        type=Path,
    )
    parser.add_option(
        "--shoebox", "In place of a room file: lengths along x, y, z.", nargs=3, type=number
    )
    parser.add_option(
        "--recordings", "Names of recordings in FOLDER, as in 'DIR/{source}_{receiver}.wav'."
    )
    parser.add_option("--positions", "Table (CSV) of name, x, y, z in m.", type=Path)
    parser.add_option("--unit", "Of the room: m, cm, mm, in or ft. Left out: guessed, or asked.")
    parser.add_option("--up", "Axis that points up in the room file: z or y. Left out: guessed.")
    parser.add_overwrite("Replace a campaign.toml that is there.")


def run(options: argparse.Namespace) -> None:
    import tomllib

    from roomfit.commands import draft_to_folder
    from roomfit.errors import InputError
    from roomfit.io.campaign import blanks
    from roomfit.io.rooms.model import RoomSpec

    if options.room is not None and options.shoebox is not None:
        raise InputError("two rooms for one campaign", needed="either --room or --shoebox")
    because = ""
    unit: str | None = options.unit
    if options.room is not None and unit is None and sys.stdin.isatty():
        unit, because = _asked(options.room)
    room = None
    if options.room is not None or options.shoebox is not None:
        lengths = None if options.shoebox is None else tuple(options.shoebox)
        room = RoomSpec(file=options.room, shoebox=lengths, unit=unit, up=options.up)
    text = draft_to_folder(
        options.folder,
        room,
        options.recordings,
        options.positions,
        because=because,
        overwrite=options.overwrite,
    )
    written = tomllib.loads(text)
    file = options.folder / "campaign.toml"
    kinds = ("sources", "receivers", "measurements")
    found = [f"{len(written[k])} {k}" for k in kinds if k in written]
    say(f"{file}: {', '.join(found)}, {written.get('recordings', 'recordings one by one')}")
    left = blanks(written)
    if left:
        say("to be filled in: " + ", ".join(left))
    say(f"then: roomfit check {file}")


def _asked(room: Path) -> tuple[str | None, str]:
    """Ask for the unit where it is in doubt."""
    from roomfit.io.draft import likely_units

    units = likely_units(room)
    if len(units) < 2:
        return None, ""
    for unit, why in units.items():
        say(f"  {unit}: {why}")
    answer = input(f"Unit of {room} ({', '.join(units)})? ").strip()
    return (answer, units.get(answer, "")) if answer else (None, "")
