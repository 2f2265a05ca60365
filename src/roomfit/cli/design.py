"""``roomfit design``: where to measure."""

from __future__ import annotations

from pathlib import Path

from roomfit.base.door import files_read, reading_noted
from roomfit.base.errors import located
from roomfit.base.typing import Progress, part
from roomfit.base.whole_files import check_output_folder, sole_writer, whole_output_folder
from roomfit.design.campaign import design_arguments
from roomfit.design.output import write_design
from roomfit.design.positions import Design, design
from roomfit.files.campaign import read_campaign
from roomfit.files.encoding import ResultFile
from roomfit.files.results import read_result
from roomfit.report.designed import describe
from roomfit.report.figures import write_pictures


@sole_writer
@reading_noted()
def design_to_folder(
    campaign_file: Path,
    out: Path,
    result: ResultFile | None = None,
    *,
    overwrite: bool = False,
    png: bool = False,
    progress: Progress | None = None,
    **wanted: int | str | None,
) -> Design:
    """Choose where to measure; write design.json, .csv and pictures into a folder.

    `wanted` are those of `roomfit.DesignOptions`, None where its default holds.
    """
    check_output_folder(out, overwrite=overwrite)
    campaign = read_campaign(campaign_file, to_fit=False)
    found = None if result is None else read_result(result)
    given = {name: value for name, value in wanted.items() if value is not None}
    arguments = design_arguments(campaign, found, given)
    with located(str(campaign_file)):
        answer = design(**arguments, progress=part(progress, 0.0, 0.98))
    with whole_output_folder(out, overwrite=overwrite) as folder:
        write_design(folder, answer, files_read())
        write_pictures(folder, describe(answer), png_too=png)
    return answer
