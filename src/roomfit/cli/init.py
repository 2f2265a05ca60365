"""``roomfit init``: a first campaign file from a room, recordings and positions."""

from __future__ import annotations

import argparse
import contextlib
import shlex
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from roomfit.cli.arguments import Commands, add_command, number
from roomfit.cli.terminal import say


def add(commands: Commands) -> None:
    about = (
        "Write a first campaign.toml for a folder of recordings.\n\n"
        "Sources, receivers and measurements come from the names of the files, best where the "
        "table of positions has the same names; what is not known is marked FILL IN."
    )
    parser = add_command(commands, "init", about, run)
    parser.add_argument("folder", type=Path, help="Folder of the campaign to be.")
    parser.add_option(
        "--room",
        "Room (.obj, .ac, .ply, .3ds, .stl, .glb, .geo, .dxf, .dae, .ifc, .skp, .usdz, .json).",
        type=Path,
    )
    parser.add_option(
        "--shoebox",
        "In place of a room file: lengths along x, y, z in m, or in --unit.",
        nargs=3,
        type=number,
        metavar=("X", "Y", "Z"),
    )
    parser.add_option(
        "--space", "Which room of a building model (.ifc) or a scan (.json) of several."
    )
    parser.add_option(
        "--recordings",
        "Names of recordings in FOLDER, as in 'DIR/{source}_{receiver}.wav'. Left out: all.",
    )
    parser.add_option(
        "--positions", "Table (CSV, XLSX) of name, x, y, z in m, or as its heading says.", type=Path
    )
    parser.add_option(
        "--decay-times",
        "In place of recordings: table (CSV, XLSX) of T30 in s, as from an older report.",
        type=Path,
    )
    parser.add_option("--unit", "Of the room: m, cm, mm, in or ft. Left out: guessed, or asked.")
    parser.add_option("--up", "Axis that points up in the room file: z or y. Left out: guessed.")
    parser.add_overwrite("Replace a campaign.toml that is there.")


def run(options: argparse.Namespace) -> None:
    import tomllib

    from roomfit.base.errors import InputError
    from roomfit.cli.commands import draft_to_folder
    from roomfit.files.campaign import blanks
    from roomfit.files.rooms.model import RoomSpec
    from roomfit.report.wording import count

    if options.room is not None and options.shoebox is not None:
        what = "two rooms for one campaign"
        hint = "leave --shoebox out where a file has the room"
        raise InputError(what, found="--room and --shoebox", needed="one of the two", hint=hint)
    because = ""
    unit: str | None = options.unit
    if options.room is not None and unit is None and sys.stdin.isatty():
        unit, because = _asked(options.room, options.space)
    room = None
    if options.room is not None or options.shoebox is not None:
        lengths = None if options.shoebox is None else tuple(options.shoebox)
        room = RoomSpec(
            file=options.room, shoebox=lengths, unit=unit, up=options.up, space=options.space
        )
    text = draft_to_folder(
        options.folder,
        room,
        options.recordings,
        options.positions,
        decay_times=options.decay_times,
        because=because,
        overwrite=options.overwrite,
    )
    written = tomllib.loads(text)
    file = options.folder / "campaign.toml"
    kinds = ("source", "receiver", "measurement")
    found = [count(len(written[f"{k}s"]), k) for k in kinds if f"{k}s" in written]
    found += [written["recordings"]] if "recordings" in written else []
    say(f"{file}: {', '.join(found) or f'decay times of {options.decay_times}'}")
    left = blanks(written)
    if left:
        say("to be filled in: " + ", ".join(left))
    for line in _hints(options, written):
        say(line)
    verb = "check" if options.decay_times is None else "reverberation"
    say(f"then: roomfit {verb} {shlex.quote(str(file))}")


def _hints(options: argparse.Namespace, written: dict[str, Any]) -> Iterator[str]:
    """Say what was passed over, and which files may be what is missing."""
    from roomfit.base.errors import InputError
    from roomfit.files.draft import read_positions, recordings_in
    from roomfit.files.file_names import in_short
    from roomfit.files.reverberation import read_decay_times
    from roomfit.files.rooms import READERS

    folder: Path = options.folder
    if options.decay_times is None and options.recordings is None:
        recordings = recordings_in(folder)
        used = {m["file"] for m in written["measurements"]}
        if not recordings:
            yield f"no recordings lie in {folder}"
        elif others := [name for name in recordings if name not in used]:
            yield f"left out, names that do not fit: {in_short(others)}"
    if options.positions is not None:
        points = {*written["sources"], *written["receivers"]}
        idle = [name for name in read_positions(options.positions) if name not in points]
        if idle:
            yield f"positions that no recording names: {in_short(idle)}"

    def beside(endings: tuple[str, ...], read: Callable[[Path], object]) -> list[Path]:
        """Return the files in the folder that can be read as what they may be."""
        found = []
        for path in sorted(folder.iterdir()):
            if path.suffix.lower() in endings and not path.name.startswith("."):
                with contextlib.suppress(InputError):
                    read(path)
                    found.append(path)
        return found

    lacking: dict[str, list[Path]] = {}
    if options.room is None and options.shoebox is None:
        lacking["--room"] = beside(tuple(READERS), lambda path: READERS[path.suffix.lower()](path))
    if options.positions is None and options.decay_times is None:
        times = beside((".csv", ".xlsx"), read_decay_times)
        points_of = [p for p in beside((".csv", ".xlsx"), read_positions) if p not in times]
        lacking |= {"--positions": points_of, "--decay-times": [] if points_of else times}
    words = [f"{k} {shlex.quote(str(v[0]))}" for k, v in lacking.items() if len(v) == 1]
    if words:
        keys = ("room", "space", "shoebox", "recordings", "unit", "up")
        given = {k: getattr(options, k) for k in keys}
        parts = [str(folder)]
        for key, value in given.items():
            if value is not None:
                values = [f"{x:g}" for x in value] if key == "shoebox" else [str(value)]
                parts += [f"--{key}", *values]
        yield f"perhaps: roomfit init {shlex.join(parts)} {' '.join(words)} --overwrite"


def _asked(room: Path, space: str | None) -> tuple[str | None, str]:
    """Ask for the unit where it is in doubt."""
    from roomfit.files.draft import likely_units

    units = likely_units(room, space)
    if len(units) < 2:
        return None, ""
    for unit, why in units.items():
        say(f"  {unit}: {why}")
    answer = input(f"Unit of {room} ({', '.join(units)})? ").strip()
    return (answer, units.get(answer, "")) if answer else (None, "")
