"""``roomfit check``: whether a room can be computed, and a campaign fitted."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from roomfit.base.errors import InputError, located
from roomfit.base.whole_files import (
    check_output_folder,
    whole_output_folder,
    write_text_atomically,
)
from roomfit.cli.terminal import say
from roomfit.files import edits
from roomfit.files.campaign import Campaign, read_campaign
from roomfit.files.encoding import finding_of
from roomfit.files.inputs import check_campaign, check_room
from roomfit.files.remedies import advice, advised, changed_since, chosen, unchosen
from roomfit.files.responses.recordings import UnchosenChannelError
from roomfit.files.schema import RoomSpec
from roomfit.report.blocks import Drawing, Part
from roomfit.report.check import describe, parameters_csv, room_blocks
from roomfit.report.progress import shown_progress
from roomfit.report.text import text

if TYPE_CHECKING:
    from roomfit.checks.usable import CheckedRecordings

_EXAMINING = "examining recordings (longer the first time, which compiles)"


def check(
    *,
    room: Path,
    unit: str | None,
    up: Literal["z", "y"] | None,
    between_hz: tuple[float, float] | None,
    out: Path | None,
    remedy: str | None,
    result: Path | None,
    undo: bool,
    **how: bool,
) -> tuple[None, int]:
    """Say what a room or a campaign is; or write what a finding advises, or take that back."""
    if remedy is not None or result is not None or undo:
        _remedy(room, remedy, result, undo, between_hz)
        return None, 0
    if room.suffix.lower() == ".toml" or room.is_dir():
        what = "a campaign itself specifies the unit and the axes of its room"
        _refuse(room, {"unit": unit, "up": up}, what, "write them under [room]")
        return None, _check(read_campaign(room), room, out, between_hz, **how)
    what = "a room by itself has no positions to draw, and no bands"
    _refuse(room, {"out": out, "bands": between_hz}, what, "roomfit init --room ROOM makes one")
    found = check_room(RoomSpec(file=room, unit=unit, up=up))
    say(text(room_blocks(str(room), found)))
    return None, 0 if found.traceable else 2


def _refuse(room: Path, options: dict[str, object], what: str, hint: str) -> None:
    """Refuse options that have no meaning for this kind of file."""
    for name, value in options.items():
        if value is not None:
            kind = "room file" if room.suffix.lower() == ".toml" else "campaign.toml"
            found, needed = f"--{name}", f"a {kind}, or no such option"
            raise InputError(what, where=str(room), found=found, needed=needed, hint=hint)


def _check(
    campaign: Campaign,
    file: Path,
    out: Path | None,
    between_hz: tuple[float, float] | None,
    **how: bool,
) -> int:
    """Check the room of a campaign, then its recordings; return the exit code."""
    result = check_campaign(campaign)
    of_room = advice(result.findings, campaign)
    say(text(room_blocks(str(file), result, of_room)))
    if not result.traceable:
        return 2
    if campaign.spectra:
        return 0  # of impedances: there are no recordings to examine
    with shown_progress(_EXAMINING):
        checked = check_campaign_recordings(campaign, out, between_hz=between_hz, **how)
    of_recordings = advice(checked.findings, campaign)
    say(f"\n{text(describe(checked, of_recordings))}")
    if of_room or of_recordings:
        say(how_to_write(file))
    if out is not None:
        say(f"\nrecordings.html, room_parameters.csv and pictures are in {out}")
    if checked.in_doubt:
        return 1
    say(f"\nthen: roomfit identify {shlex.quote(str(file))} --out result")
    return 0


def check_campaign_recordings(
    campaign: Campaign,
    out: Path | None = None,
    *,
    between_hz: tuple[float, float] | None = None,
    overwrite: bool = False,
    png: bool = False,
) -> CheckedRecordings:
    """Read everything that a campaign names and examine it, see `check_recordings`.

    `out` is a folder for a page, pictures of room and recordings, and ``room_parameters.csv``;
    `between_hz` are bands to examine in place of the campaign's.
    """
    # all of roomfit: a room by itself does not wait for it
    from roomfit.checks.usable import check_recordings
    from roomfit.design.positions import plane_findings
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
    checked = replace(checked, findings=(*checked.findings, *alike))
    if out is not None:
        from roomfit.report.figures import write_pictures
        from roomfit.report.html import page

        of = measured_scene(scene, measurements)
        picture = Drawing("room", "The room", "", "room_figure.room_figure", (of,))
        shown = describe(checked)
        shown = replace(shown, blocks=(*shown.blocks, Part("The room", (picture,), "room")))
        with whole_output_folder(out, overwrite=overwrite) as folder:
            write_pictures(folder, shown, png_too=png)
            write_text_atomically(folder / "recordings.html", page(shown))
            write_text_atomically(folder / "room_parameters.csv", parameters_csv(checked))
    return checked


def how_to_write(campaign: Path, result: Path | None = None) -> str:
    """Return what writes the lines below findings, for the terminal."""
    of_result = "" if result is None else f" --result {shlex.quote(str(result))}"
    return (
        f"\nLines below a finding go into {campaign.name}. To write them, with its code:\n"
        f"  roomfit check {shlex.quote(str(campaign))}{of_result} --remedy CODE\n"
        "and --undo in place of --remedy takes the last ones back."
    )


def _remedy(
    file: Path,
    wanted: str | None,
    result: Path | None,
    undo: bool,
    between_hz: tuple[float, float] | None,
) -> None:
    """Write what findings advise into the campaign, or take that back."""
    from roomfit.files.results import read_result_content

    if undo and wanted is None and result is None:
        edits.undo(file)
        say(f"{file} is as it was before the last remedy")
        return
    if undo or wanted is None:
        what = "a remedy is written, or taken back"
        found = "--undo beside other options" if undo else "--result without --remedy"
        needed = "--remedy CODE, with or without --result FOLDER; or --undo"
        hint = "roomfit check CAMPAIGN shows the codes"
        raise InputError(what, where=str(file), found=found, needed=needed, hint=hint)
    campaign = read_campaign(file, to_fit=result is None)
    if result is not None:
        path = result / "result.json" if result.is_dir() else result
        content, _ = read_result_content(path)
        findings = [finding_of(one, str(path)) for one in content["findings"]]
        advised_ = advised(findings, campaign, changed=changed_since(content, file))
    else:
        try:
            with shown_progress(_EXAMINING):
                own = check_campaign_recordings(campaign, between_hz=between_hz).findings
        except UnchosenChannelError as error:
            own = (unchosen(error),)
        advised_ = advised((*check_campaign(campaign).findings, *own), campaign)
    remedy = chosen(advised_, wanted)
    change = edits.preview(file, remedy.edits)
    edits.apply(file, change)
    say(f"{remedy.words}, in {file}")
    for table, now, then in change.lines:
        say(f"  {table}\n    was  {now}\n    is   {then}")
    say(f"\nto take it back: roomfit check {shlex.quote(str(file))} --undo")
