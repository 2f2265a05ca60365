"""A design from files to files."""

from __future__ import annotations

from pathlib import Path

from roomfit.app.designing.design import CANDIDATES, design
from roomfit.app.progress import part
from roomfit.errors import InputError
from roomfit.files.campaign.campaign import input_files, read_campaign
from roomfit.files.designs import write_design
from roomfit.files.result_reader import read_misfit, read_result
from roomfit.files.store import check_output_folder, whole_output_folder, write_bytes_atomically
from roomfit.placement.answer import Design
from roomfit.placement.choose import CRITERIA, Criterion
from roomfit.typing import Progress

# What the command writes, and so may remove when it writes over an earlier design.
OWN_FILES = ("design.json", "design.csv", "design_map.png", "design_gain.png")


def design_to_folder(
    campaign_file: Path,
    out: Path,
    *,
    candidates: int = CANDIDATES,
    choose_n: int | None = None,
    most_sources: int | None = None,
    criterion: Criterion | None = None,
    result_file: Path | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Design:
    """Choose where to measure and write design.json, design.csv and two pictures into a folder.

    Raises
    ------
    InputError
        Something in the campaign, the room, the result or the output folder is not as needed.
    StoreError
        The disk refuses.
    """
    from roomfit.report.design_pictures import design_gain, design_map
    from roomfit.report.pictures import png

    check_output_folder(out, overwrite=overwrite)
    campaign = read_campaign(campaign_file, to_fit=False)
    found = None if result_file is None else read_result(result_file)
    answer = design(
        campaign,
        candidates=candidates,
        choose_n=choose_n,
        most_sources=most_sources,
        criterion=criterion,
        result=found,
        misfit=None if result_file is None else read_misfit(result_file),
        progress=part(progress, 0.0, 0.98),
    )
    inputs = input_files(campaign)
    if result_file is not None:
        inputs = (*inputs, Path(result_file))
    with whole_output_folder(out, overwrite=overwrite, own=OWN_FILES) as folder:
        write_design(folder, answer, inputs)
        write_bytes_atomically(folder / "design_map.png", png(design_map(answer)))
        write_bytes_atomically(folder / "design_gain.png", png(design_gain(answer)))
    return answer


def criterion_of(text: str | None) -> Criterion | None:
    """Return a criterion by its name.

    Raises
    ------
    InputError
        There is none of that name.
    """
    if text is None:
        return None
    for known in CRITERIA:
        if text == known:
            return known
    raise InputError("unknown criterion", found=repr(text), needed=", ".join(CRITERIA))
