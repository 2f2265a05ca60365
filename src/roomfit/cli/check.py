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
    parser.add_option(
        "--remedy",
        "Of a campaign: write into it what the findings of CODE advise; CODE:2 the second choice.",
        metavar="CODE",
    )
    parser.add_option(
        "--result", "With --remedy: of the findings of this answer, a folder.", type=Path
    )
    parser.add_argument(
        "--undo", action="store_true", help="Of a campaign: take the last remedy back."
    )


def run(options: argparse.Namespace) -> None:
    """Carry out the command; leave with 2 where the room cannot be traced."""
    from roomfit.base.errors import InputError
    from roomfit.files.campaign import read_campaign
    from roomfit.files.inputs import check_campaign, check_room
    from roomfit.files.rooms.model import RoomSpec
    from roomfit.report.text import room_text

    room: Path = options.room
    if options.remedy is not None or options.result is not None or options.undo:
        _remedy(options)
        return
    if room.suffix.lower() != ".toml" and not room.is_dir():
        if options.out is not None or options.bands is not None:
            raise InputError(
                "a room by itself has no positions to draw, and no bands",
                where=str(room),
                found="--out" if options.out is not None else "--bands",
                needed="a campaign.toml",
                hint="roomfit init --room ROOM makes one; or leave the option out",
            )
        result = check_room(RoomSpec(file=room, unit=options.unit, up=options.up))
        say(room_text(str(room), result))
        sys.exit(0 if result.traceable else 2)
    if options.unit is not None or options.up is not None:
        what = "a campaign itself specifies the unit and the axes of its room"
        needed, hint = "neither of them beside a campaign", "write them under [room]"
        raise InputError(what, where=str(room), found="--unit or --up", needed=needed, hint=hint)
    from roomfit.files.remedies import advice

    campaign = read_campaign(room)
    result = check_campaign(campaign)
    advised = advice(result.findings, campaign)
    say(room_text(str(room), result, advised))
    if not result.traceable:
        sys.exit(2)
    if campaign.spectra:
        return  # of impedances: there are no recordings to examine
    from roomfit.cli.commands import check_campaign_recordings  # all of roomfit: not for a room
    from roomfit.report.text import recordings_text

    with shown_progress("examining recordings (longer the first time, which compiles)"):
        checked = check_campaign_recordings(
            campaign, options.out, between_hz=options.bands, overwrite=options.overwrite
        )
    of_recordings = advice(checked.findings, campaign)
    say(f"\n{recordings_text(checked, of_recordings)}")
    if advised or of_recordings:
        say(how_to_write(room))
    if options.out is not None:
        say(f"\nroom.png is in {options.out}")
    if checked.in_doubt:
        sys.exit(_IN_DOUBT)
    say(f"\nthen: roomfit identify {shlex.quote(str(room))} --out result")


def how_to_write(campaign: Path, result: Path | None = None) -> str:
    """Return what writes the lines below findings, for the terminal."""
    of_result = "" if result is None else f" --result {shlex.quote(str(result))}"
    return (
        f"\nLines below a finding go into {campaign.name}. To write them, with its code:\n"
        f"  roomfit check {shlex.quote(str(campaign))}{of_result} --remedy CODE\n"
        "and --undo in place of --remedy takes the last ones back."
    )


def _remedy(options: argparse.Namespace) -> None:
    """Write what findings advise into the campaign, or take that back.

    Raises
    ------
    InputError
        No finding advises it, or the campaign cannot be edited.
    """
    from roomfit.base.errors import InputError
    from roomfit.files import edits
    from roomfit.files.campaign import read_campaign
    from roomfit.files.encoding import finding_of
    from roomfit.files.exports import read_result_content
    from roomfit.files.inputs import check_campaign
    from roomfit.files.remedies import advised, changed_since, chosen

    file: Path = options.room
    if options.undo and options.remedy is None and options.result is None:
        edits.undo(file)
        say(f"{file} is as it was before the last remedy")
        return
    if options.undo or options.remedy is None:
        raise InputError(
            "a remedy is written, or taken back",
            where=str(file),
            found="--undo beside other options" if options.undo else "--result without --remedy",
            needed="--remedy CODE, with or without --result FOLDER; or --undo",
            hint="roomfit check CAMPAIGN shows the codes",
        )
    campaign = read_campaign(file, to_fit=options.result is None)
    if options.result is not None:
        path = options.result / "result.json" if options.result.is_dir() else options.result
        content, _ = read_result_content(path)
        findings = [finding_of(one, str(path)) for one in content["findings"]]
        found = advised(findings, campaign, changed=changed_since(content, file))
    else:
        from roomfit.cli.commands import check_campaign_recordings

        with shown_progress("examining recordings (longer the first time, which compiles)"):
            checked = check_campaign_recordings(campaign, between_hz=options.bands)
        found = advised((*check_campaign(campaign).findings, *checked.findings), campaign)
    remedy = chosen(found, options.remedy)
    wanted = edits.preview(file, remedy.edits)
    edits.apply(file, wanted)
    say(f"{remedy.words}, in {file}")
    for table, now, then in wanted.lines:
        say(f"  {table}\n    was  {now}\n    is   {then}")
    say(f"\nto take it back: roomfit check {shlex.quote(str(file))} --undo")
