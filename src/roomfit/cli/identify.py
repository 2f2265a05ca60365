"""``roomfit identify``: the absorption of a measured room."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from roomfit.base import whole_files
from roomfit.base.door import files_read, reading_noted
from roomfit.base.errors import located
from roomfit.base.typing import Progress, part
from roomfit.cli.check import how_to_write
from roomfit.cli.terminal import say
from roomfit.files.campaign import read_campaign
from roomfit.files.encoding import input_digests
from roomfit.files.inputs import identify_arguments, project_details
from roomfit.files.remedies import advice
from roomfit.files.results import check_disk_room, write_result
from roomfit.fit.measurements import measured_scene
from roomfit.identify import identify
from roomfit.report.answer import result_blocks
from roomfit.report.blocks import Blocks, in_its_language
from roomfit.report.doubts import remaining_usable
from roomfit.report.html import page
from roomfit.report.progress import shown_progress
from roomfit.report.text import text
from roomfit.result import Result

_LOG = logging.getLogger("roomfit")


def run(*, campaign_file: Path, out: Path, details: bool = False, **how: Any) -> None:
    """Identify, and say the answer, or all of its details, before anything is drawn."""
    with ExitStack() as line:

        def show(answer: Blocks, *, advised: bool) -> None:
            line.close()  # that of the progress
            # a reader who has gone, or a full disk, is met again at the end, with all files written
            with suppress(OSError):
                say(text(answer, details=details))
                if advised and details:
                    say(how_to_write(campaign_file, out))
                sys.stdout.flush()

        progress = line.enter_context(shown_progress("identifying"))
        identify_to_folder(campaign_file, out, progress=progress, answered=show, **how)


@whole_files.sole_writer
@reading_noted()
def identify_to_folder(
    campaign_file: Path,
    out: Path,
    *,
    between_hz: tuple[float, float] | None = None,
    quick: bool = False,
    overwrite: bool = False,
    png: bool = False,
    progress: Progress | None = None,
    answered: Callable[..., None] | None = None,
) -> Result:
    """Identify a campaign and write result.json, tables, pictures and report into a folder.

    Files are written after the whole computation, all of them or none. `between_hz` are bands to
    fit in place of the campaign's; a `quick` answer, see `Settings.quick`, has no pictures beside
    the report. `answered` is called with the answer's blocks before anything is drawn. `InputError`
    where the campaign, the room, a response or the output folder is invalid,
    `InsufficientDataError` where the data cannot be fitted at all.
    """
    whole_files.check_output_folder(
        out, overwrite=overwrite
    )  # now rather than after minutes of work
    campaign = read_campaign(campaign_file)
    project = project_details(campaign.project, campaign.path.parent)
    arguments = identify_arguments(campaign, between_hz)
    arguments["settings"] = replace(arguments["settings"], quick=quick)
    check_disk_room(out, len(arguments["measurements"]))
    with located(str(campaign_file)):
        answer = identify(**arguments, progress=part(progress, 0.0, 0.95))
    advised, inputs = advice(answer.findings, campaign), tuple(files_read())
    shown = result_blocks(
        answer,
        measured_scene(arguments["scene"], arguments["measurements"]),
        title=project.pop("title", f"Absorption: {campaign_file.stem}"),
        campaign=campaign_file.name,
        inputs_sha256=input_digests(inputs),
        project=project,
        advice=advised,
    )
    if answered is not None:
        answered(shown, advised=bool(advised))
    _LOG.info("drawing")
    shown = in_its_language(shown)
    with whole_files.whole_output_folder(out, overwrite=overwrite) as folder:
        write_result(folder, answer, inputs, remaining_usable(answer))
        whole_files.write_text_atomically(folder / "report.html", page(shown))
        if not quick:
            from roomfit.report.figures import write_pictures  # matplotlib, which this first needs

            write_pictures(folder, shown, png_too=png)
    return answer
