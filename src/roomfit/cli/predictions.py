"""The commands that ask what would be: predict, choose a treatment, listen; and decay times alone.

Each reads files, does one thing, and writes files whole or not at all. A campaign without positions
is taken for a diffuse field, with its decay times (``[reverberation]``) or its priors alone.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from roomfit.base.errors import InputError, InsufficientDataError, located
from roomfit.base.findings import Code, Finding
from roomfit.base.forks import in_forks
from roomfit.base.table import csv_of
from roomfit.base.typing import FloatArray, Progress, part
from roomfit.base.whole_files import (
    check_output_folder,
    sole_writer,
    whole_output_folder,
    write_bytes_atomically,
    write_json_atomically,
    write_text_atomically,
)
from roomfit.files.campaign import Campaign, read_campaign
from roomfit.files.door import files_read, reading_noted

if TYPE_CHECKING:
    from roomfit.files.encoding import ResultFile
    from roomfit.files.schema import TreatmentTable
    from roomfit.predict.campaign import WantedPairs
    from roomfit.predict.changes import Change
    from roomfit.predict.diffuse import PreparedField
    from roomfit.predict.diffuse_field import DiffuseAbsorption
    from roomfit.predict.other_walls import Predicted
    from roomfit.room.scene import Scene
    from roomfit.signals.measurement import Measurement
    from roomfit.treat.arrangements import Treatment

_LOG = logging.getLogger("roomfit")


@reading_noted()
def reverberation_to_folder(
    campaign_file: Path, out: Path | None = None, *, overwrite: bool = False
) -> DiffuseAbsorption:
    """Find mean absorption from decay times; write result.json, a table and a page into a folder.

    Raises
    ------
    InputError
        As of `diffuse_field` and `diffuse_absorption`; or the folder is not empty.
    """
    from roomfit.files.reverberation import diffuse_field, diffuse_result_content
    from roomfit.predict.diffuse_field import diffuse_absorption
    from roomfit.report.html import diffuse_page
    from roomfit.report.text import diffuse_records

    if out is not None:
        check_output_folder(out, overwrite=overwrite)
    campaign = read_campaign(campaign_file, to_fit=False, decay_times=True)
    field, _ = diffuse_field(campaign)
    if field.decay_s is None:
        raise InputError(
            "a campaign without decay times",
            where=str(campaign_file),
            found="no such table",
            needed="a table [reverberation]",
            hint="add it, or predict from a result: --absorption result.json",
        )
    found = diffuse_absorption(
        field.decay_s, field.bands, field.priors, field.areas_m2, field.volume_m3,
        speed_of_sound_m_s=field.speed_of_sound_m_s, attenuation_per_m=field.attenuation_per_m,
    )  # fmt: skip
    if out is not None:
        with whole_output_folder(out, overwrite=overwrite) as folder:
            content = diffuse_result_content(field, found, campaign.settings.seed, files_read())
            write_json_atomically(folder / "result.json", content)
            write_text_atomically(folder / "reverberation.csv", csv_of(diffuse_records(found)))
            write_text_atomically(folder / "reverberation.html", diffuse_page(found))
    return found


_MOST_PICTURES = 24


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
    progress: Progress | None = None,
) -> Predicted:
    """Predict a campaign; write predicted.json, .csv, .html and pictures into a folder.

    Pictures of the first 24 pairs; the files contain all. Of a grid maps in place of them, a
    picture a source, and grid.csv.

    Parameters
    ----------
    absorption_file : Path, EditedFile, or None
        Of a fit. Without positions, and without such a file, the room is taken for a diffuse field:
        by its decay times, or by its priors where the campaign has none.

    Raises
    ------
    InputError
        The campaign, the room, the absorption or the output folder is invalid.
    StoreError
        The disk refuses.
    """
    from roomfit.files.results import check_disk_room, read_result
    from roomfit.predict.campaign import WantedPairs, predict_arguments
    from roomfit.predict.diffuse import predict_field
    from roomfit.predict.grid import grid_scene
    from roomfit.predict.other_walls import predict
    from roomfit.predict.output import change_figure, predicted_decay_figure, write_predicted
    from roomfit.report.figures import in_file_name, png

    check_output_folder(out, overwrite=overwrite)
    campaign = read_campaign(campaign_file, to_fit=False, decay_times=True)
    field = prepared_field(campaign, absorption_file, wanted, changes)
    pairs, state, grid_m, doubted = wanted or WantedPairs()
    most_drawn = _MOST_PICTURES if grid_m is None else 0
    if field is not None:
        check_disk_room(out, 0)
        with located(str(campaign_file)):
            predicted = predict_field(field, changes)
    elif absorption_file is not None:
        found = read_result(absorption_file)
        arguments = predict_arguments(campaign, found, changes, pairs, state, doubted)
        if grid_m is not None:
            own = grid_scene(arguments["scene"], *grid_m)
            arguments = {**arguments, "scene": own, "measurements": ()}
        n_pairs = len(arguments["scene"].pairs)
        # without its picture a pair takes a tenth: 20 kB with seven bands
        check_disk_room(out, min(n_pairs, most_drawn) + n_pairs // 10)
        with located(str(campaign_file)):
            predicted = predict(**arguments, progress=part(progress, 0.0, 0.95))
    with whole_output_folder(out, overwrite=overwrite) as folder:
        write_predicted(folder, predicted, files_read())
        if predicted.compares_states:
            write_bytes_atomically(folder / "change.png", png(change_figure(predicted)))
        if grid_m is not None:
            write_grid(folder, predicted, arguments["scene"])
        shown = predicted.pairs[:most_drawn]
        drawn = in_forks(lambda pair: png(predicted_decay_figure(predicted, pair)), shown)
        for number, (pair, picture) in enumerate(zip(shown, drawn, strict=True), start=1):
            name = f"predicted_{number:02d}_{in_file_name(pair.source, pair.receiver)}.png"
            write_bytes_atomically(folder / name, picture)
    if progress is not None:
        progress(1.0)
    return predicted


def write_grid(folder: Path, predicted: Predicted, scene: Scene) -> None:
    """Write grid.csv, and grid_NUMBER_SOURCE.png of each source, into a folder.

    Raises
    ------
    StoreError
        The disk refuses.
    """
    from roomfit.predict.grid import grid_figure, grid_records
    from roomfit.report.figures import in_file_name, png

    write_text_atomically(folder / "grid.csv", csv_of(grid_records(predicted, scene)))
    sources = dict.fromkeys(pair.source for pair in predicted.pairs)
    for number, source in enumerate(sources, start=1):
        picture = png(grid_figure(predicted, scene, source))
        write_bytes_atomically(folder / f"grid_{number:02d}_{in_file_name(source)}.png", picture)


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
    from roomfit.files.results import read_result
    from roomfit.files.reverberation import diffuse_field
    from roomfit.predict.campaign import WantedPairs, undoubted
    from roomfit.predict.diffuse import prepare_field
    from roomfit.room.scene import Room, Scene, shoebox_room
    from roomfit.uncertainty.other_room import room_posterior

    has_points = bool(campaign.sources and campaign.receivers)
    if absorption_file is not None and has_points:
        return None
    is_measured = bool(campaign.measurements or campaign.tables)
    if absorption_file is None and campaign.reverberation is None and is_measured:
        raise InputError(
            "the absorption of the room is not given",
            where=str(campaign.path),
            found="recordings or tables, and no result",
            needed="a result of what the campaign has measured",
            hint="roomfit identify first, then --absorption result.json",
        )
    if wanted is not None and wanted[:3] != WantedPairs()[:3]:
        raise InputError(
            "without positions there are neither pairs nor states",
            where=str(campaign.path),
            found="--pairs, --state or --grid",
            needed="sources and receivers with positions, and --absorption",
            hint="leave --pairs, --state and --grid out",
        )
    may_be_doubted = wanted is not None and wanted.doubted
    if may_be_doubted and absorption_file is None:
        raise InputError(
            "decay times and priors alone have no result that could be doubted",
            where=str(campaign.path),
            found="--doubted",
            needed="--absorption, a result, beside it",
            hint="leave --doubted out: nothing is left out here",
        )
    field, room = diffuse_field(campaign)
    with located(str(campaign.path)):
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


@sole_writer
@reading_noted()
def treat_to_folder(
    campaign_file: Path,
    absorption_file: ResultFile | None,
    treatment_file: Path,
    out: Path,
    *,
    wanted: WantedPairs | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Treatment:
    """Choose what to hang where; write treatment.json, .csv, .html and a picture into a folder.

    Raises
    ------
    InputError
        The campaign, the room, the absorption, the treatment or the output folder is invalid.
    StoreError
        The disk refuses.
    """
    from roomfit.predict.changes import Change
    from roomfit.report.figures import png
    from roomfit.treat.arrangements import treat
    from roomfit.treat.campaign import read_treatment, treat_arguments
    from roomfit.treat.output import treatment_figure, write_treatment

    check_output_folder(out, overwrite=overwrite)
    campaign = read_campaign(campaign_file, to_fit=False, decay_times=True)
    table = read_treatment(treatment_file)
    covered = [Change(name, "factor", (1.0,)) for name in table.surfaces]
    field = prepared_field(campaign, absorption_file, wanted, covered)
    to_measure: tuple[str, ...] = ()
    if field is not None:
        if not campaign.has_room:
            raise InputError(
                "a treatment of a room without walls",
                where=str(campaign_file),
                found="volume and surface alone",
                needed="a table [room], so that there are surfaces to hang something on",
                hint="add [room] with shoebox or file",
            )
        asked, doubts = treat_arguments(treatment_file, table, field.absorption, field.scene)
        with located(str(treatment_file)):
            answer = treat(field, **asked, progress=progress)
    elif absorption_file is not None:
        answer, doubts = _treat_traced(
            campaign,
            absorption_file,
            treatment_file,
            table,
            covered,
            wanted,
            part(progress, 0, 0.9),
        )
        to_measure = _what_to_measure(campaign, absorption_file, answer, part(progress, 0.9, 1.0))
    answer = replace(answer, findings=(*doubts, *answer.findings), to_measure=to_measure)
    with whole_output_folder(out, overwrite=overwrite) as folder:
        write_treatment(folder, answer, files_read())
        write_bytes_atomically(folder / "treatment.png", png(treatment_figure(answer)))
    return answer


def _treat_traced(
    campaign: Campaign,
    absorption_file: ResultFile,
    treatment_file: Path,
    table: TreatmentTable,
    covered: Sequence[Change],
    wanted: WantedPairs | None,
    progress: Progress | None,
) -> tuple[Treatment, tuple[Finding, ...]]:
    """Return a treatment by the paths of the room, and what is in doubt about its standards."""
    from roomfit.files.results import read_result
    from roomfit.predict.campaign import WantedPairs, predict_arguments
    from roomfit.predict.other_walls import prepare_prediction
    from roomfit.treat.arrangements import treat
    from roomfit.treat.campaign import hardest_changes, treat_arguments

    pairs, state, _, doubted = wanted or WantedPairs()
    found = read_result(absorption_file)
    given = predict_arguments(campaign, found, covered, pairs, state, doubted)
    scene, known = given["scene"], given["absorption"]
    asked, doubts = treat_arguments(treatment_file, table, known, scene)
    with located(str(treatment_file)):
        room = prepare_prediction(
            scene,
            known,
            hardest_changes(asked, known.bands),
            given["measurements"],
            speech_db=given["speech_db"],
            settings=given["settings"],
            progress=part(progress, 0.0, 0.9),
        )
        return treat(room, **asked, progress=part(progress, 0.9, 1.0)), doubts


# Of two pairs among few: the best of 200 leave intervals a tenth narrower at most, in 36 s not 6.
_TO_MEASURE: dict[str, Any] = {"number": 2, "n_candidates": 30, "n_random": 1, "n_draws": 1}


def _what_to_measure(
    campaign: Campaign, absorption_file: ResultFile, answer: Treatment, progress: Progress | None
) -> tuple[str, ...]:
    """Return pairs that tell most of the absorption, where a target hangs on that of a wall.

    By the experiment design after a fit; none where its rules leave no place for a receiver.
    """
    from roomfit.design.campaign import design_arguments
    from roomfit.design.output import chosen_positions
    from roomfit.design.positions import design
    from roomfit.files.results import read_result
    from roomfit.room.scene import wall_materials

    first = answer.arrangements[0]
    names = answer.room.scene.room.materials
    if first.is_sure or not first.decisive or first.decisive[0][0] not in names:
        return ()
    try:
        given = design_arguments(campaign, read_result(absorption_file), _TO_MEASURE)
        found = design(**given, progress=progress)
    except InputError as error:
        _LOG.info("no measurement is proposed: %s", error.what)
        return ()
    lines = []
    for source, source_m, receiver, receiver_m in chosen_positions(found):
        here, there = (", ".join(f"{x:.2f}" for x in at_m) for at_m in (source_m, receiver_m))
        lines.append(f"{source} at ({here}) m to {receiver} at ({there}) m")
    index = found.materials.index(first.decisive[0][0])
    before, after = found.widths[[0, -1], index].mean(axis=1)
    unit = " m2" * (index >= len(wall_materials(found.scene.room)))
    lines.append(
        f"with these the 95 % interval of the absorption of {first.decisive[0][0]}, {before:.2f}"
        f"{unit} wide in the mean over the bands, is expected to be {after:.2f}{unit} wide"
    )
    return tuple(lines)


def listen_to_folder(
    campaign_file: Path,
    absorption_file: ResultFile,
    out: Path,
    changes: Sequence[Change] = (),
    *,
    wanted: WantedPairs | None = None,
    dry: Path | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Write measured responses before and after a change, as WAV files of floats, and listen.json.

    Nothing is normalised. With `dry`, a recording of one channel, its convolutions stand beside
    them, all scaled by one factor so that the loudest has a peak of half. Of what is wanted the
    state counts, and whether the result may be doubted.

    Returns
    -------
    dict
        What listen.json contains.

    Raises
    ------
    InputError
        See `roomfit.predict.listen.listen`; or the recording has another sampling rate.
    InsufficientDataError
        The result is seriously doubted in a band, which a sound cannot leave out, and this is not
        wanted.
    StoreError
        The disk refuses.
    """
    from roomfit.files.results import read_result
    from roomfit.predict.campaign import WantedPairs, predict_arguments
    from roomfit.predict.listen import listen, with_dry_recording
    from roomfit.predict.output import listen_content
    from roomfit.signals.measurement import Measurement

    check_output_folder(out, overwrite=overwrite)
    campaign = read_campaign(campaign_file, to_fit=False)
    found = read_result(absorption_file)
    _, state, _, doubted = wanted or WantedPairs()
    arguments = predict_arguments(campaign, found, changes, "campaign", state, doubted)
    for doubt in arguments["absorption"].findings:
        if doubt.code is Code.RESULT_DOUBTED:
            raise InsufficientDataError(
                "a sound has every band, and other walls are not predicted in some",
                found=doubt.sentence,
                needed="in every band, absorptions that no serious finding calls wrong",
                hint="put right what the findings name, and identify again; or add --doubted",
            )
    measured = [m for m in arguments["measurements"] if isinstance(m, Measurement)]
    known, settings = arguments["absorption"], arguments["settings"]
    recorded = None if dry is None else _dry_pressure(dry, measured)
    with located(str(campaign_file)):
        made, findings = listen(
            arguments["scene"], known, changes, measured, settings=settings, progress=progress
        )
    sounds = [{"before": c.measurement.response.pressure, "after": c.samples} for c in made]
    content = listen_content(known.bands, changes, made, findings, files_read())
    content["dry_factor"] = None
    if recorded is not None:
        sounds, content["dry_factor"] = with_dry_recording(sounds, recorded)
    with whole_output_folder(out, overwrite=overwrite) as folder:
        for i, (c, sound) in enumerate(zip(made, sounds, strict=True), start=1):
            files = _write_sounds(folder, i, c.measurement, sound)
            content["responses"][i - 1]["files"] = files
        write_json_atomically(folder / "listen.json", content)
    return content


def _write_sounds(
    folder: Path, number: int, measurement: Measurement, sounds: Mapping[str, FloatArray]
) -> dict[str, str]:
    """Write the sounds of a pair as WAV files; return their names by kind."""
    import soundfile

    from roomfit.report.figures import in_file_name

    stem = f"{number:02d}_{in_file_name(measurement.source, measurement.receiver)}"
    names = {kind: f"{stem}_{kind}.wav" for kind in sounds}
    rate_hz = round(measurement.response.sampling_rate_hz)
    for kind, x in sounds.items():
        soundfile.write(folder / names[kind], x, rate_hz, subtype="FLOAT")
    return names


def _dry_pressure(file: Path, measured: Sequence[Measurement]) -> FloatArray:
    """Return the samples of a dry recording, which has the sampling rate of the responses."""
    from roomfit.files.responses import read_response
    from roomfit.files.responses.recordings import ResponseSpec

    dry = read_response(ResponseSpec(file))[0]
    if measured and dry.sampling_rate_hz != measured[0].response.sampling_rate_hz:
        raise InputError(
            "the dry recording has another sampling rate than the responses",
            where=str(file),
            found=f"{dry.sampling_rate_hz:g} Hz",
            needed=f"{measured[0].response.sampling_rate_hz:g} Hz",
            hint="resample the dry recording",
        )
    return dry.pressure
