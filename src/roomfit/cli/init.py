"""``roomfit init``: a first campaign file from a room, recordings and positions."""

from __future__ import annotations

import contextlib
import shlex
import sys
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, cast

from roomfit.base.arguments import in_short
from roomfit.base.errors import InputError
from roomfit.base.findings import Finding
from roomfit.base.whole_files import check_place, make_folder, write_text_atomically
from roomfit.cli.terminal import say
from roomfit.files.campaign import blanks
from roomfit.files.draft import carried_in, draft_campaign, likely_units
from roomfit.files.edits import sole_editor
from roomfit.files.file_names import matching_files, recordings_in
from roomfit.files.responses import RESPONSE_SUFFIXES, read_response
from roomfit.files.rooms import READERS
from roomfit.files.schema import ResponseSpec, RoomSpec
from roomfit.files.values import read_decay_times, read_positions
from roomfit.report.wording import count


def init(
    *,
    folder: Path,
    room: Path | None,
    shoebox: list[float] | None,
    recordings: str | None,
    positions: Path | None,
    decay_times: Path | None,
    overwrite: bool,
    **of_room: Any,
) -> str:
    """Write a first campaign, and return what it holds and lacks; `of_room` are unit, up, space."""
    if room is not None and shoebox is not None:
        what = "two rooms for one campaign"
        hint = "leave --shoebox out where a file has the room"
        raise InputError(what, found="--room and --shoebox", needed="one of the two", hint=hint)
    because, spec, given = "", None, dict(of_room)
    if room is not None and given["unit"] is None and sys.stdin.isatty():
        given["unit"], because = _asked(room, given["space"])
    if room is not None or shoebox is not None:
        lengths = shoebox and cast("tuple[float, float, float]", tuple(shoebox))
        spec = RoomSpec(file=room, shoebox=lengths or None, **given)
    text = draft_to_folder(
        folder, spec, recordings, positions,
        decay_times=decay_times, because=because, overwrite=overwrite,
    )  # fmt: skip
    doubts: tuple[Finding, ...] = ()
    written, file = tomllib.loads(text), folder / "campaign.toml"
    kinds = ("source", "receiver", "measurement")
    found = [count(len(written[f"{k}s"]), k) for k in kinds if f"{k}s" in written]
    found += [written["recordings"]] if "recordings" in written else []
    lines = [f"{file}: {', '.join(found) or f'decay times of {decay_times}'}"]
    lines += [line[2:] for line in text.splitlines() if line.startswith("# In doubt: ")]
    if left := blanks(written):
        lines.append("to be filled in: " + ", ".join(left))
    if decay_times is None and recordings is None:
        names = recordings_in(folder)
        used = {m["file"] for m in written["measurements"]}
        if not names:
            lines.append(f"no recordings lie in {folder}: no {', '.join(RESPONSE_SUFFIXES)}")
        for name in [n for n in names if n.endswith((".npy", ".mat"))][:1]:  # others are alike
            try:
                read_response(ResponseSpec(folder / name, sampling_rate_hz=48_000.0))
            except InputError as error:
                lines.append(f"{name}: {error.what}: {error.found}; needed: {error.needed}")
        if others := [name for name in names if name not in used]:
            lines.append(f"left out, names that do not fit: {in_short(others)}")
    if positions is not None:
        points = {*written["sources"], *written["receivers"]}
        known, doubts = read_positions(positions)
        idle = [name for name in known if name not in points]
        lines += [f"positions that no recording names: {in_short(idle)}"] if idle else []
    if decay_times is not None:
        doubts = read_decay_times(decay_times)[2]
    lines += [finding.sentence for finding in doubts]
    box = None if shoebox is None else [f"{x:g}" for x in shoebox]
    stated = {"room": room, "shoebox": box, "recordings": recordings, **of_room}
    may_lack = positions is None and decay_times is None
    lines += [x for x in [_missing(folder, may_lack, stated)] if x]
    verb = "check" if decay_times is None else "reverberation"
    return "\n".join([*lines, f"then: roomfit {verb} {shlex.quote(str(file))}"])


def _missing(folder: Path, without_points: bool, stated: Mapping[str, Any]) -> str:
    """Return a call with files of the folder by which the campaign may be more complete."""
    lacking: dict[str, list[Path]] = {}
    if stated["room"] is None and stated["shoebox"] is None:
        lacking["--room"] = _readable(folder, READERS)
    if without_points:
        times = _readable(folder, dict.fromkeys((".csv", ".xlsx"), read_decay_times))
        points = _readable(folder, dict.fromkeys((".csv", ".xlsx"), read_positions))
        points = [path for path in points if path not in times]
        lacking |= {"--positions": points, "--decay-times": [] if points else times}
    words = [f"{k} {shlex.quote(str(v[0]))}" for k, v in lacking.items() if len(v) == 1]
    parts = [str(folder)]
    for key, value in stated.items():
        if value is not None:
            parts += [f"--{key}", *(value if isinstance(value, list) else [str(value)])]
    call = f"perhaps: roomfit init {shlex.join(parts)} {' '.join(words)} --overwrite"
    return call if words else ""


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
        what, found = "there is no such folder of recordings", "no folder of this name"
        needed = "a folder with recordings, or --decay-times"
        hint = "make the folder, and put the recordings into it"
        raise InputError(what, where=str(folder), found=found, needed=needed, hint=hint)
    if folder.exists():
        check_place(file, overwrite=overwrite)
    if decay_times is not None:
        if recordings is not None or positions is not None:
            what = "--decay-times cannot be combined with --recordings or --positions"
            hint = "tables of pairs whose positions are known: parameters in [[measurements]]"
            raise InputError(what, found="both", needed="one or the other", hint=hint)
        read_decay_times(decay_times)
    known = {} if positions is None else read_positions(positions)[0]
    files = {} if decay_times is not None else matching_files(folder, recordings, known)
    carried = carried_in(folder, files, known, room) if recordings is None else None
    text = draft_campaign(
        room,
        files,
        known,
        folder=folder,
        template=recordings,
        because=because,
        decay_times=decay_times,
        carried=carried,
    )
    make_folder(folder)
    with sole_editor(file):
        check_place(file, overwrite=overwrite)
        write_text_atomically(file, text)
    return text
