"""``roomfit init``: a first campaign file from a room, recordings and positions."""

from __future__ import annotations

import argparse
import contextlib
import shlex
import sys
import tomllib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from roomfit.base.arguments import in_short
from roomfit.base.errors import InputError
from roomfit.base.whole_files import check_place, make_folder, write_text_atomically
from roomfit.cli.terminal import say
from roomfit.files.campaign import blanks
from roomfit.files.draft import draft_campaign, likely_units, read_positions
from roomfit.files.edits import sole_editor
from roomfit.files.file_names import matching_files, recordings_in
from roomfit.files.reverberation import read_decay_times
from roomfit.files.rooms import READERS
from roomfit.files.rooms.model import RoomSpec
from roomfit.report.wording import count


def run(options: argparse.Namespace) -> None:
    if options.room is not None and options.shoebox is not None:
        what = "two rooms for one campaign"
        hint = "leave --shoebox out where a file has the room"
        raise InputError(what, found="--room and --shoebox", needed="one of the two", hint=hint)
    unit, because = options.unit, ""
    if options.room is not None and unit is None and sys.stdin.isatty():
        unit, because = _asked(options.room, options.space)
    room = None
    if options.room is not None or options.shoebox is not None:
        lengths = None if options.shoebox is None else tuple(options.shoebox)
        room = RoomSpec(options.room, lengths, unit=unit, up=options.up, space=options.space)
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
    if left := blanks(written):
        say("to be filled in: " + ", ".join(left))
    for line in (*_left_out(options, written), *_missing(options)):
        say(line)
    verb = "check" if options.decay_times is None else "reverberation"
    say(f"then: roomfit {verb} {shlex.quote(str(file))}")


def _left_out(options: argparse.Namespace, written: dict[str, Any]) -> Iterator[str]:
    """Say which recordings and positions were passed over."""
    if options.decay_times is None and options.recordings is None:
        recordings = recordings_in(options.folder)
        used = {m["file"] for m in written["measurements"]}
        if not recordings:
            yield f"no recordings lie in {options.folder}"
        elif others := [name for name in recordings if name not in used]:
            yield f"left out, names that do not fit: {in_short(others)}"
    if options.positions is not None:
        points = {*written["sources"], *written["receivers"]}
        idle = [name for name in read_positions(options.positions) if name not in points]
        if idle:
            yield f"positions that no recording names: {in_short(idle)}"


def _missing(options: argparse.Namespace) -> Iterator[str]:
    """Say with which files of the folder the campaign may be more complete."""
    lacking: dict[str, list[Path]] = {}
    if options.room is None and options.shoebox is None:
        lacking["--room"] = _readable(options.folder, READERS)
    if options.positions is None and options.decay_times is None:
        times = _readable(options.folder, dict.fromkeys((".csv", ".xlsx"), read_decay_times))
        points = _readable(options.folder, dict.fromkeys((".csv", ".xlsx"), read_positions))
        points = [path for path in points if path not in times]
        lacking |= {"--positions": points, "--decay-times": [] if points else times}
    words = [f"{k} {shlex.quote(str(v[0]))}" for k, v in lacking.items() if len(v) == 1]
    if words:
        parts = [str(options.folder)]
        for key in ("room", "space", "shoebox", "recordings", "unit", "up"):
            value = getattr(options, key)
            if value is not None:
                values = [f"{x:g}" for x in value] if key == "shoebox" else [str(value)]
                parts += [f"--{key}", *values]
        yield f"perhaps: roomfit init {shlex.join(parts)} {' '.join(words)} --overwrite"


def _readable(folder: Path, readers: Mapping[str, Callable[[Path], object]]) -> list[Path]:
    """Return the files in the folder that can be read as what they may be."""
    found = []
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() in readers and not path.name.startswith("."):
            with contextlib.suppress(InputError):
                readers[path.suffix.lower()](path)
                found.append(path)
    return found


def _asked(room: Path, space: str | None) -> tuple[str | None, str]:
    """Ask for the unit where it is in doubt."""
    units = likely_units(room, space)
    if len(units) < 2:
        return None, ""
    for unit, why in units.items():
        say(f"  {unit}: {why}")
    answer = input(f"Unit of {room} ({', '.join(units)})? ").strip()
    return (answer, units.get(answer, "")) if answer else (None, "")


def draft_to_folder(
    folder: Path,
    room: RoomSpec | None,
    recordings: str | None = None,
    positions: Path | None = None,
    *,
    decay_times: Path | None = None,
    because: str = "",
    overwrite: bool = False,
) -> str:
    """Write a first campaign.toml into a folder, see `draft_campaign`, and return its text.

    A folder for decay times alone is made if needed. `InputError` where there is no folder of
    recordings, or a campaign already and `overwrite` is false; a file cannot be read, the unit is
    in doubt, or no recording has the shape of the template.
    """
    file = folder / "campaign.toml"
    if not folder.is_dir() and decay_times is None:
        raise InputError(
            "there is no such folder of recordings",
            where=str(folder),
            found="no folder of this name",
            needed="a folder with recordings, or --decay-times",
            hint="make the folder, and put the recordings into it",
        )
    if folder.exists():
        check_place(file, overwrite=overwrite)
    if decay_times is not None:
        if recordings is not None or positions is not None:
            raise InputError(
                "--decay-times cannot be combined with --recordings or --positions",
                found="both",
                needed="one or the other",
                hint="tables of pairs whose positions are known: parameters in [[measurements]]",
            )
        read_decay_times(decay_times)
    known = {} if positions is None else read_positions(positions)
    text = draft_campaign(
        room,
        {} if decay_times is not None else matching_files(folder, recordings, known),
        known,
        folder=folder,
        template=recordings,
        because=because,
        decay_times=decay_times,
    )
    make_folder(folder)
    with sole_editor(file):
        check_place(file, overwrite=overwrite)
        write_text_atomically(file, text)
    return text
