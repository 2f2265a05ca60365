"""``roomfit treat`` and ``roomfit design``: what to hang where, and where to measure."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

from roomfit.base import whole_files
from roomfit.base.door import files_read, reading_noted
from roomfit.base.errors import InputError, located
from roomfit.base.typing import Progress, part
from roomfit.design.campaign import design_arguments
from roomfit.design.output import chosen_positions, write_design
from roomfit.design.positions import Design, design
from roomfit.files.campaign import Campaign, read_campaign
from roomfit.files.encoding import ResultFile
from roomfit.files.inputs import project_details
from roomfit.files.questions import Wanted, question_of
from roomfit.files.results import read_result
from roomfit.predict.changes import Change, by_variant, change_text, read_change
from roomfit.predict.predict import ChangingRoom, predict_change, prepare
from roomfit.report import designed
from roomfit.report.blocks import in_its_language
from roomfit.report.html import page
from roomfit.report.treated import client_blocks, describe, treatment_sentence
from roomfit.report.wording import count
from roomfit.room.scene import wall_materials
from roomfit.treat.arrangements import Treatment, treat
from roomfit.treat.campaign import hardest_changes, read_treatment, treat_arguments
from roomfit.treat.output import write_treatment
from roomfit.uncertainty.posterior import AbsorptionPosterior

_LOG = logging.getLogger("roomfit")


@whole_files.sole_writer
@reading_noted()
def treat_to_folder(
    campaign_file: Path,
    absorption_file: ResultFile | None,
    treatment_file: Path,
    out: Path,
    *,
    wanted: Wanted | None = None,
    overwrite: bool = False,
    png: bool = False,
    progress: Progress | None = None,
) -> Treatment:
    """Choose what to hang where; write treatment.json, .csv, .html and pictures into a folder.

    And client.html, two pages that `roomfit export` makes PDF of, and Word with pictures as `png`;
    it has the variants that are wanted beside what hangs then.
    """
    named = [read_change(text) for text in (wanted or Wanted()).variants]
    if unnamed := [c for c in named if not c.variant]:
        what, found_here = "a change that belongs to no variant", change_text(unnamed[0])
        needed = "NAME | CHANGE: variants stand beside what is chosen to be hung"
        hint = f"--set 'variant | {found_here}'"
        raise InputError(what, found=found_here, needed=needed, hint=hint)
    whole_files.check_output_folder(out, overwrite=overwrite)
    campaign = read_campaign(campaign_file, to_fit=False, decay_times=True)
    table = read_treatment(treatment_file)
    covered = [Change(name, "factor", (1.0,)) for name in table.surfaces]
    found = None if absorption_file is None else read_result(absorption_file)
    question = question_of(campaign, found, [*covered, *named], wanted)
    variants = by_variant(question.changes)
    del variants[""]  # what may be covered
    if question.field is not None and not campaign.has_room:
        what, found_here = "a treatment of a room without walls", "volume and surface alone"
        needed = "a table [room], so that there are surfaces to hang something on"
        where, hint = str(campaign_file), "add [room] with shoebox or file"
        raise InputError(what, where=where, found=found_here, needed=needed, hint=hint)
    room: ChangingRoom | None = None
    if question.field is not None:
        with located(str(campaign_file)):
            room = prepare(question)
    known = question.known if room is None else room.absorption
    asked, doubts = treat_arguments(treatment_file, table, known, question.scene)
    with located(str(treatment_file)):
        if room is None:
            hardest = (*hardest_changes(asked, known.bands), *variants.values())
            room = prepare(question, hardest, progress=part(progress, 0.0, 0.8))
        answer = treat(room, **asked, progress=part(progress, 0.8, 0.9))
        beside = {name: predict_change(room, own) for name, own in variants.items()}
    to_measure: tuple[str, ...] = ()
    if found is not None and question.field is None:
        to_measure = _what_to_measure(campaign, found, answer, part(progress, 0.9, 1.0))
    answer = replace(answer, findings=(*doubts, *answer.findings), to_measure=to_measure)
    project = project_details(campaign.project, campaign.path.parent)
    shown = in_its_language(replace(describe(answer), language=project.get("language", "en")))
    with whole_files.whole_output_folder(out, overwrite=overwrite) as folder:
        from roomfit.report.figures import write_pictures  # matplotlib: not before it draws

        write_treatment(folder, answer, treatment_sentence(answer), files_read())
        whole_files.write_text_atomically(folder / "treatment.html", page(shown))
        write_pictures(folder, shown, png_too=png)
        client = client_blocks(answer, project, _measured(campaign), beside)
        whole_files.write_text_atomically(folder / "client.html", page(client))
    return answer


def _measured(campaign: Campaign) -> str:
    """Return what was measured, in words."""
    pairs = [(m.source, m.receiver) for m in campaign.measurements]
    if not pairs:
        return "nothing" if campaign.reverberation is None else "decay times"
    sources, receivers = (len(set(own)) for own in zip(*pairs, strict=True))
    all_ = ((len(pairs), "measurement"), (sources, "source"), (receivers, "receiver"))
    return ", ".join(count(*one) for one in all_)


# Of two pairs among few: the best of 200 leave intervals a tenth narrower at most, in 36 s not 6.
_TO_MEASURE: dict[str, Any] = {"number": 2, "n_candidates": 30, "n_random": 1, "n_draws": 1}


def _what_to_measure(
    campaign: Campaign, found: AbsorptionPosterior, answer: Treatment, progress: Progress | None
) -> tuple[str, ...]:
    """Return pairs that tell most of the absorption, where a target hangs on that of a wall.

    By the experiment design after a fit; none where its rules leave no place for a receiver.
    """
    first = answer.arrangements[0]
    name = first.decisive[0][0] if first.decisive else ""
    if first.is_sure or name not in answer.room.scene.room.materials:
        return ()
    try:
        plan = design(**design_arguments(campaign, found, _TO_MEASURE), progress=progress)
    except InputError as error:
        _LOG.info("no measurement is proposed: %s", error.what)
        return ()
    lines = []
    for source, source_m, receiver, receiver_m in chosen_positions(plan):
        here, there = (", ".join(f"{x:.2f}" for x in at_m) for at_m in (source_m, receiver_m))
        lines.append(f"{source} at ({here}) m to {receiver} at ({there}) m")
    index = plan.materials.index(name)
    before, after = plan.widths[[0, -1], index].mean(axis=1)
    unit = " m2" * (index >= len(wall_materials(plan.scene.room)))
    lines.append(
        f"with these the 95 % interval of the absorption of {name}, {before:.2f}{unit} wide in the "
        f"mean over the bands, is expected to be {after:.2f}{unit} wide"
    )
    return tuple(lines)


@whole_files.sole_writer
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
    whole_files.check_output_folder(out, overwrite=overwrite)
    campaign = read_campaign(campaign_file, to_fit=False)
    found = None if result is None else read_result(result)
    given = {name: value for name, value in wanted.items() if value is not None}
    arguments = design_arguments(campaign, found, given)
    with located(str(campaign_file)):
        answer = design(**arguments, progress=part(progress, 0.0, 0.98))
    with whole_files.whole_output_folder(out, overwrite=overwrite) as folder:
        from roomfit.report.figures import write_pictures

        write_design(folder, answer, files_read())
        write_pictures(folder, designed.describe(answer), png_too=png)
    return answer
