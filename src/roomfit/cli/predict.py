"""``roomfit predict``: what would be measured."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from roomfit.base.door import files_read, reading_noted
from roomfit.base.errors import InputError, InsufficientDataError, located
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
from roomfit.files.campaign import Campaign, read_campaign
from roomfit.files.encoding import ResultFile
from roomfit.files.results import check_disk_room, read_result
from roomfit.files.reverberation import diffuse_field
from roomfit.predict.campaign import WantedPairs, pair_choice, predict_arguments, undoubted
from roomfit.predict.changes import Change, read_change
from roomfit.predict.diffuse import PreparedField, predict_field, prepare_field
from roomfit.predict.grid import grid_records, grid_scene
from roomfit.predict.other_walls import Predicted, predict
from roomfit.predict.output import write_predicted
from roomfit.report.blocks import Blocks, Drawing
from roomfit.report.html import page
from roomfit.report.predicted import describe, grid_drawings, pair_drawings
from roomfit.report.progress import shown_progress
from roomfit.report.text import text
from roomfit.room.scene import Room, Scene, shoebox_room
from roomfit.uncertainty.other_room import room_posterior


def run(options: argparse.Namespace) -> None:
    changes = [read_change(text) for text in options.changes or []]
    wanted = WantedPairs(
        pair_choice(options.pairs), options.state or "", options.grid, options.doubted
    )
    with shown_progress("predicting") as progress:
        _, shown = predict_to_folder(
            options.campaign,
            options.absorption and result_file(options, options.absorption),
            options.out,
            changes,
            wanted=wanted,
            overwrite=options.overwrite,
            png=options.png,
            progress=progress,
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
    wanted: WantedPairs | None = None,
    overwrite: bool = False,
    png: bool = False,
    progress: Progress | None = None,
) -> tuple[Predicted, Blocks]:
    """Predict a campaign; write predicted.json, .csv, .html and pictures into a folder.

    Pictures of the first 24 pairs; the files contain all. Of a grid maps in place of them, a
    picture a source, and grid.csv. Without an absorption, or without positions, the room is taken
    for a diffuse field: by its decay times, or by its priors where the campaign has none.

    Raises
    ------
    InputError
        The campaign, the room, the absorption or the output folder is invalid.
    StoreError
        The disk refuses.
    """
    check_output_folder(out, overwrite=overwrite)
    campaign = read_campaign(campaign_file, to_fit=False, decay_times=True)
    field = prepared_field(campaign, absorption_file, wanted, changes)
    pairs, state, grid_m, doubted = wanted or WantedPairs()
    scene = None
    if field is not None:
        check_disk_room(out, 0)
        with located(str(campaign_file)):
            predicted = predict_field(field, changes)
    elif absorption_file is not None:
        found = read_result(absorption_file)
        arguments = predict_arguments(campaign, found, changes, pairs, state, doubted)
        scene = arguments["scene"]
        if grid_m is not None:
            scene = grid_scene(scene, *grid_m)
            arguments |= {"scene": scene, "measurements": ()}
        check_disk_room(out, len(scene.pairs) // 3)
        with located(str(campaign_file)):
            predicted = predict(**arguments, progress=part(progress, 0.0, 0.95))
    shown = describe(predicted)
    drawings: list[Drawing] = []
    if grid_m is not None and scene is not None:
        drawings += grid_drawings(predicted, scene)
    else:
        drawings += pair_drawings(predicted)
    with whole_output_folder(out, overwrite=overwrite) as folder:
        from roomfit.report.figures import write_pictures

        write_predicted(folder, predicted, files_read())
        write_text_atomically(folder / "predicted.html", page(shown))
        if grid_m is not None and scene is not None:
            write_text_atomically(folder / "grid.csv", csv_of(grid_records(predicted, scene)))
        beside = Blocks("", (*shown.drawings(), *drawings), ())
        write_pictures(folder, beside, png_too=png)
    if progress is not None:
        progress(1.0)
    return predicted, shown


def prepared_field(
    campaign: Campaign,
    absorption_file: ResultFile | None = None,
    wanted: WantedPairs | None = None,
    changes: Sequence[Change] = (),
) -> PreparedField | None:
    """Return a campaign as a diffuse field; None where positions and an absorption are given.

    Raises
    ------
    InputError
        Responses were measured and no absorption is given; a state or a choice of pairs is asked
        for; the campaign has no positions, and nothing that is known without; or a doubted result
        is to be taken where none is given.
    InsufficientDataError
        Walls are to be changed and the result is seriously doubted in a band, and may not be.
    """
    if absorption_file is not None and campaign.sources and campaign.receivers:
        return None
    is_measured = bool(campaign.measurements or campaign.tables)
    where = str(campaign.path)
    if absorption_file is None and campaign.reverberation is None and is_measured:
        raise InputError(
            "the absorption of the room is not given",
            where=where,
            found="recordings or tables, and no result",
            needed="a result of what the campaign has measured",
            hint="roomfit identify first, then --absorption result.json",
        )
    if wanted is not None and wanted[:3] != WantedPairs()[:3]:
        raise InputError(
            "without positions there are neither pairs nor states",
            where=where,
            found="--pairs, --state or --grid",
            needed="sources and receivers with positions, and --absorption",
            hint="leave --pairs, --state and --grid out",
        )
    may_be_doubted = wanted is not None and wanted.doubted
    if may_be_doubted and absorption_file is None:
        raise InputError(
            "decay times and priors alone have no result that could be doubted",
            where=where,
            found="--doubted",
            needed="--absorption, a result, beside it",
            hint="leave --doubted out: nothing is left out here",
        )
    field, room = diffuse_field(campaign)
    with located(where):
        known = None
        if absorption_file is not None:
            found = read_result(absorption_file)
            refused = () if may_be_doubted else undoubted(found, field.bands, changes, "")[2]
            if refused:
                raise InsufficientDataError(
                    "the result is seriously doubted in some of the bands",
                    found=refused[0].sentence,
                    needed="a result that is not, or bands in which it is not",
                    hint="put right what the findings name; or add --doubted",
                )
            known = room_posterior(found, field.priors, field.bands)
        # of volume and surface alone no wall is known: one material, and no picture
        walls: Room = room or shoebox_room((1.0, 1.0, 1.0), "room")
        scene = Scene(walls, (), (), np.zeros((0, 2), np.int64), campaign.air)
        return prepare_field(field, scene, known, campaign.settings)
