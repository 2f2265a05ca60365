"""``roomfit predict`` and ``roomfit reverberation``: what would be measured, and by decay times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from roomfit.base import whole_files
from roomfit.base.door import files_read, reading_noted
from roomfit.base.errors import InputError, located
from roomfit.base.table import csv_of
from roomfit.base.typing import Progress, part
from roomfit.files.campaign import read_campaign
from roomfit.files.encoding import ResultFile
from roomfit.files.questions import Wanted, diffuse_field, diffuse_result_content, question_of
from roomfit.files.results import check_disk_room, read_result
from roomfit.predict.changes import read_change
from roomfit.predict.diffuse_field import DiffuseAbsorption, diffuse_absorption
from roomfit.predict.grid import grid_records
from roomfit.predict.output import write_predicted
from roomfit.predict.predict import predict
from roomfit.predict.prediction import Predicted
from roomfit.report.blocks import Blocks, in_its_language, names_of
from roomfit.report.html import page
from roomfit.report.predicted import (
    describe,
    diffuse_blocks,
    diffuse_records,
    grid_drawings,
    pair_drawings,
)


@whole_files.sole_writer
@reading_noted()
def predict_to_folder(
    campaign_file: Path,
    absorption_file: ResultFile | None,
    out: Path,
    changes: Sequence[str] = (),
    *,
    wanted: Wanted | None = None,
    overwrite: bool = False,
    png: bool = False,
    progress: Progress | None = None,
) -> Predicted:
    """Predict a campaign; write predicted.json, .csv, .html and pictures into a folder.

    Pictures of the first 24 pairs; the files contain all. Of a grid maps in place of them, a
    picture a source, and grid.csv. Without an absorption, or without positions, the room is taken
    for a diffuse field: by its decay times, or by its priors where the campaign has none.
    """
    own = [read_change(text) for text in changes]
    whole_files.check_output_folder(out, overwrite=overwrite)
    campaign = read_campaign(campaign_file, to_fit=False, decay_times=True)
    found = None if absorption_file is None else read_result(absorption_file)
    question = question_of(campaign, found, own, wanted)
    check_disk_room(out, len(question.scene.pairs) // 3)
    with located(str(campaign_file)):
        predicted = predict(question, progress=part(progress, 0.0, 0.95))
    own_names, language = (
        names_of(question.scene, *changes, *predicted.variants),
        campaign.project.language,
    )
    answer = replace(describe(predicted), language=language, names=own_names)
    shown = in_its_language(answer)
    beside = pair_drawings(predicted)
    with whole_files.whole_output_folder(out, overwrite=overwrite) as folder:
        from roomfit.report.figures import write_pictures

        write_predicted(folder, predicted, files_read())
        whole_files.write_text_atomically(folder / "predicted.html", page(shown))
        if wanted is not None and wanted.grid_m is not None:
            beside = grid_drawings(predicted, question.scene)
            records = grid_records(predicted, question.scene)
            whole_files.write_text_atomically(folder / "grid.csv", csv_of(records))
        of_page = replace(answer, head=shown.drawings(), blocks=beside)
        write_pictures(folder, in_its_language(of_page), png_too=png)
    return predicted


def reverberation(campaign_file: Path, out: Path | None, *, overwrite: bool) -> Blocks:
    """Return the mean absorption in words."""
    return diffuse_blocks(reverberation_to_folder(campaign_file, out, overwrite=overwrite))


@reading_noted()
def reverberation_to_folder(
    campaign_file: Path, out: Path | None = None, *, overwrite: bool = False
) -> DiffuseAbsorption:
    """Find mean absorption from decay times; write result.json, a table and a page into a folder.

    `InputError` as of `diffuse_field` and `diffuse_absorption`; or the folder is not empty.
    """
    if out is not None:
        whole_files.check_output_folder(out, overwrite=overwrite)
    campaign = read_campaign(campaign_file, to_fit=False, decay_times=True)
    field, _ = diffuse_field(campaign)
    if field.decay_s is None:
        what, where = "a campaign without decay times", str(campaign_file)
        needed = "a table [reverberation]"
        hint = "add it, or predict from a result: --absorption result.json"
        raise InputError(what, where=where, found="no such table", needed=needed, hint=hint)
    found = diffuse_absorption(
        field.decay_s, field.bands, field.priors, field.areas_m2, field.volume_m3,
        speed_of_sound_m_s=field.speed_of_sound_m_s, attenuation_per_m=field.attenuation_per_m,
    )  # fmt: skip
    found = replace(found, findings=field.findings)
    if out is not None:
        with whole_files.whole_output_folder(out, overwrite=overwrite) as folder:
            content = diffuse_result_content(field, found, campaign.settings.seed, files_read())
            whole_files.write_json_atomically(folder / "result.json", content)
            whole_files.write_text_atomically(
                folder / "reverberation.csv", csv_of(diffuse_records(found))
            )
            own_names, language = frozenset(found.materials), campaign.project.language
            shown = replace(diffuse_blocks(found), language=language, names=own_names)
            whole_files.write_text_atomically(folder / "reverberation.html", page(shown))
    return found
