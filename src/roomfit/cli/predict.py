"""``roomfit predict``: what would be measured."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from roomfit.base.door import files_read, reading_noted
from roomfit.base.errors import located
from roomfit.base.table import csv_of
from roomfit.base.typing import Progress, part
from roomfit.base.whole_files import (
    check_output_folder,
    sole_writer,
    whole_output_folder,
    write_text_atomically,
)
from roomfit.cli.arguments import result_file
from roomfit.cli.terminal import say
from roomfit.files.campaign import read_campaign
from roomfit.files.encoding import ResultFile
from roomfit.files.questions import Wanted, question_of
from roomfit.files.results import check_disk_room, read_result
from roomfit.predict.changes import Change, read_change
from roomfit.predict.grid import grid_records
from roomfit.predict.output import write_predicted
from roomfit.predict.predict import predict
from roomfit.predict.prediction import Predicted
from roomfit.report.blocks import Blocks
from roomfit.report.html import page
from roomfit.report.predicted import describe, grid_drawings, pair_drawings
from roomfit.report.progress import shown_progress
from roomfit.report.text import text


def run(options: argparse.Namespace) -> None:
    changes = [read_change(text) for text in options.changes or []]
    found = options.absorption and result_file(options, options.absorption)
    wanted = Wanted(options.pairs, options.state or "", options.grid, options.doubted)
    how = {"overwrite": options.overwrite, "png": options.png}
    with shown_progress("predicting") as progress:
        _, shown = predict_to_folder(
            options.campaign, found, options.out, changes, wanted=wanted, progress=progress, **how
        )
    say(text(shown))
    files = "predicted.json, predicted.csv, predicted.html" + ", grid.csv" * bool(options.grid)
    say(f"\n{files} and pictures are in {options.out}")


@sole_writer
@reading_noted()
def predict_to_folder(
    campaign_file: Path,
    absorption_file: ResultFile | None,
    out: Path,
    changes: Sequence[Change] = (),
    *,
    wanted: Wanted | None = None,
    overwrite: bool = False,
    png: bool = False,
    progress: Progress | None = None,
) -> tuple[Predicted, Blocks]:
    """Predict a campaign; write predicted.json, .csv, .html and pictures into a folder.

    Pictures of the first 24 pairs; the files contain all. Of a grid maps in place of them, a
    picture a source, and grid.csv. Without an absorption, or without positions, the room is taken
    for a diffuse field: by its decay times, or by its priors where the campaign has none.
    """
    check_output_folder(out, overwrite=overwrite)
    campaign = read_campaign(campaign_file, to_fit=False, decay_times=True)
    found = None if absorption_file is None else read_result(absorption_file)
    question = question_of(campaign, found, changes, wanted)
    check_disk_room(out, len(question.scene.pairs) // 3)
    with located(str(campaign_file)):
        predicted = predict(question, progress=part(progress, 0.0, 0.95))
    shown, drawings = describe(predicted), pair_drawings(predicted)
    with whole_output_folder(out, overwrite=overwrite) as folder:
        from roomfit.report.figures import write_pictures

        write_predicted(folder, predicted, files_read())
        write_text_atomically(folder / "predicted.html", page(shown))
        if wanted is not None and wanted.grid_m is not None:
            drawings = grid_drawings(predicted, question.scene)
            records = grid_records(predicted, question.scene)
            write_text_atomically(folder / "grid.csv", csv_of(records))
        write_pictures(folder, Blocks("", (*shown.drawings(), *drawings), ()), png_too=png)
    if progress is not None:
        progress(1.0)
    return predicted, shown
