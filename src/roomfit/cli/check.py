"""``roomfit check``: whether a room can be computed, and a campaign fitted."""

from __future__ import annotations

import argparse
import shlex
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from roomfit.base.errors import InputError, located
from roomfit.base.whole_files import check_output_folder, whole_output_folder
from roomfit.cli.terminal import say
from roomfit.files import edits
from roomfit.files.campaign import Campaign, read_campaign
from roomfit.files.encoding import finding_of
from roomfit.files.inputs import check_campaign, check_room
from roomfit.files.remedies import advice, advised, changed_since, chosen
from roomfit.files.rooms.model import RoomSpec
from roomfit.report.blocks import Blocks, Drawing
from roomfit.report.check import recordings_blocks, room_blocks
from roomfit.report.progress import shown_progress
from roomfit.report.text import text

if TYPE_CHECKING:
    from roomfit.checks.usable import CheckedRecordings

_IN_DOUBT = 1
_EXAMINING = "examining recordings (longer the first time, which compiles)"


def run(options: argparse.Namespace) -> None:
    """Carry out the command; leave with 2 where the room cannot be traced."""
    file: Path = options.room
    if options.remedy is not None or options.result is not None or options.undo:
        _remedy(options)
    elif file.suffix.lower() != ".toml" and not file.is_dir():
        what = "a room by itself has no positions to draw, and no bands"
        hint = "roomfit init --room ROOM makes one"
        _refuse(options, ("out", "bands"), what, "a campaign.toml", hint)
        result = check_room(RoomSpec(file=file, unit=options.unit, up=options.up))
        say(text(room_blocks(str(file), result)))
        sys.exit(0 if result.traceable else 2)
    else:
        what = "a campaign itself specifies the unit and the axes of its room"
        needed = "neither of them beside a campaign"
        _refuse(options, ("unit", "up"), what, needed, "write them under [room]")
        _check(options, read_campaign(file))


def _refuse(
    options: argparse.Namespace, names: tuple[str, ...], what: str, needed: str, hint: str
) -> None:
    """Refuse options that have no meaning for this kind of file."""
    for name in names:
        if getattr(options, name) is not None:
            where, found = str(options.room), f"--{name}"
            hint = f"{hint}; or leave the option out"
            raise InputError(what, where=where, found=found, needed=needed, hint=hint)


def _check(options: argparse.Namespace, campaign: Campaign) -> None:
    """Check the room of a campaign, then its recordings; leave with 1 where these are in doubt."""
    result = check_campaign(campaign)
    of_room = advice(result.findings, campaign)
    say(text(room_blocks(str(options.room), result, of_room)))
    if not result.traceable:
        sys.exit(2)
    if campaign.spectra:
        return  # of impedances: there are no recordings to examine
    with shown_progress(_EXAMINING):
        checked = check_campaign_recordings(
            campaign, options.out, between_hz=options.bands, overwrite=options.overwrite,
            png=options.png,
        )  # fmt: skip
    of_recordings = advice(checked.findings, campaign)
    say(f"\n{text(recordings_blocks(checked, of_recordings))}")
    if of_room or of_recordings:
        say(how_to_write(options.room))
    if options.out is not None:
        say(f"\nroom.svg is in {options.out}")
    if checked.in_doubt:
        sys.exit(_IN_DOUBT)
    say(f"\nthen: roomfit identify {shlex.quote(str(options.room))} --out result")


def check_campaign_recordings(
    campaign: Campaign,
    out: Path | None = None,
    *,
    between_hz: tuple[float, float] | None = None,
    overwrite: bool = False,
    png: bool = False,
) -> CheckedRecordings:
    """Read everything that a campaign names and examine it, see `check_recordings`.

    `out` is a folder for a picture of room and positions, `between_hz` are bands to examine in
    place of the campaign's.
    """
    # all of roomfit: a room by itself does not wait for it
    from roomfit.checks.usable import check_recordings
    from roomfit.design.symmetry import plane_findings
    from roomfit.files.inputs import identify_arguments
    from roomfit.fit.measurements import measured_scene
    from roomfit.room.scene import named_pairs

    if out is not None:
        check_output_folder(out, overwrite=overwrite)
    own = identify_arguments(campaign, between_hz)
    scene, measurements = own["scene"], own["measurements"]
    with located(str(campaign.path)):
        range_db = own["settings"].decay_range_db
        checked = check_recordings(
            scene, measurements, own["bands"], own["directivities"], range_db
        )
    fitted = {m.pair_name[:2] for m in measurements if m.use == "fit"}
    alike = plane_findings(named_pairs(scene, fitted))
    if out is not None:
        from roomfit.report.figures import write_pictures

        of = measured_scene(scene, measurements)
        picture = Drawing("room", "The room", "", "room_figure.room_figure", (of,))
        with whole_output_folder(out, overwrite=overwrite) as folder:
            write_pictures(folder, Blocks("", (picture,), ()), png_too=png)
    return replace(checked, findings=(*checked.findings, *alike))


def how_to_write(campaign: Path, result: Path | None = None) -> str:
    """Return what writes the lines below findings, for the terminal."""
    of_result = "" if result is None else f" --result {shlex.quote(str(result))}"
    return (
        f"\nLines below a finding go into {campaign.name}. To write them, with its code:\n"
        f"  roomfit check {shlex.quote(str(campaign))}{of_result} --remedy CODE\n"
        "and --undo in place of --remedy takes the last ones back."
    )


def _remedy(options: argparse.Namespace) -> None:
    """Write what findings advise into the campaign, or take that back."""
    from roomfit.files.results import read_result_content

    file, result = options.room, options.result
    if options.undo and options.remedy is None and result is None:
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
    campaign = read_campaign(file, to_fit=result is None)
    if result is not None:
        path = result / "result.json" if result.is_dir() else result
        content, _ = read_result_content(path)
        findings = [finding_of(one, str(path)) for one in content["findings"]]
        found = advised(findings, campaign, changed=changed_since(content, file))
    else:
        with shown_progress(_EXAMINING):
            checked = check_campaign_recordings(campaign, between_hz=options.bands)
        found = advised((*check_campaign(campaign).findings, *checked.findings), campaign)
    remedy = chosen(found, options.remedy)
    wanted = edits.preview(file, remedy.edits)
    edits.apply(file, wanted)
    say(f"{remedy.words}, in {file}")
    for table, now, then in wanted.lines:
        say(f"  {table}\n    was  {now}\n    is   {then}")
    say(f"\nto take it back: roomfit check {shlex.quote(str(file))} --undo")
