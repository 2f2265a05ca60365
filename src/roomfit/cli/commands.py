"""The commands: each reads files, does one thing, and writes files whole or not at all.

`identify_to_folder` is the main one. Others examine a room or a campaign, design a measurement,
export materials, or run a demonstration on a room whose absorption is known; those that predict are
in `roomfit.cli.predictions`.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from roomfit.base.errors import InputError, located
from roomfit.base.table import csv_of
from roomfit.base.typing import FloatArray, Progress, part
from roomfit.base.whole_files import (
    check_output_folder,
    make_folder,
    sole_writer,
    whole_output_folder,
    write_bytes_atomically,
    write_text_atomically,
)
from roomfit.files.door import files_read, read_bytes, read_text, reading_noted
from roomfit.files.encoding import ResultFile, input_digests, path_of
from roomfit.settings import Settings

if TYPE_CHECKING:
    from roomfit.base.findings import Finding
    from roomfit.checks.usable import CheckedRecordings
    from roomfit.design.positions import Design
    from roomfit.files.campaign import Campaign
    from roomfit.files.remedies import Advice
    from roomfit.files.responses.sweep import SweepPlan, SweepResponse
    from roomfit.files.rooms.model import RoomSpec
    from roomfit.report.comparison import Comparison
    from roomfit.result import Result
    from roomfit.room.scene import Scene

_LOG = logging.getLogger("roomfit")


def check_campaign_recordings(
    campaign: Campaign,
    out: Path | None = None,
    *,
    between_hz: tuple[float, float] | None = None,
    overwrite: bool = False,
) -> CheckedRecordings:
    """Read everything that a campaign names and examine it, see `check_recordings`.

    Parameters
    ----------
    out : Path, optional
        Folder for a picture of room and positions, ``room.png``.
    between_hz : (lowest, highest), optional
        Bands to examine in place of the campaign's, see `identify_arguments`.

    Raises
    ------
    InputError
        A file cannot be read, or the room has faults.
    StoreError
        The disk refuses.
    """
    from roomfit.checks.usable import check_recordings
    from roomfit.design.symmetry import plane_findings
    from roomfit.files.inputs import identify_arguments
    from roomfit.room.scene import named_pairs

    if out is not None:
        check_output_folder(out, overwrite=overwrite)
    own = identify_arguments(campaign, between_hz)
    with located(str(campaign.path)):
        checked = check_recordings(
            own["scene"],
            own["measurements"],
            own["bands"],
            own["directivities"],
            own["settings"].decay_range_db,
        )
    fitted = {m.pair_name[:2] for m in own["measurements"] if m.use == "fit"}
    alike = plane_findings(named_pairs(own["scene"], fitted))
    checked = replace(checked, findings=(*checked.findings, *alike))
    if out is not None:
        from roomfit.fit.measurements import measured_scene
        from roomfit.report.figures import png
        from roomfit.report.room_figure import room_figure

        picture = png(room_figure(measured_scene(own["scene"], own["measurements"])))
        with whole_output_folder(out, overwrite=overwrite) as folder:
            write_bytes_atomically(folder / "room.png", picture)
    return checked


def draft_to_folder(
    folder: Path,
    room: RoomSpec | None,
    recordings: str | None = None,
    positions: Path | None = None,
    *,
    decay_times: Path | None = None,
    because: str = "",
    overwrite: bool = False,
) -> str:
    """Write a first campaign.toml into a folder, see `draft_campaign`, and return its text.

    A folder for decay times alone is made if needed.

    Raises
    ------
    InputError
        There is no such folder of recordings, or a campaign already and `overwrite` is false; a
        room or a table cannot be read; decay times stand beside positions or recordings, which they
        replace; the unit is in doubt, or no recording has the shape of the template.
    StoreError
        The disk refuses.
    """
    from roomfit.files.draft import draft_campaign, matching_files, read_positions
    from roomfit.files.edits import sole_editor
    from roomfit.files.reverberation import read_decay_times

    file = folder / "campaign.toml"
    if not folder.is_dir() and decay_times is None:
        raise InputError(
            "there is no such folder of recordings",
            where=str(folder),
            found="no folder of this name",
            needed="a folder with recordings, or --decay-times",
            hint="make the folder, and put the recordings into it",
        )
    if folder.exists():
        _check_place(file, overwrite)
    if decay_times is not None:
        if recordings is not None or positions is not None:
            raise InputError(
                "decay times without positions stand alone",
                found="--decay-times beside --recordings or --positions",
                needed="one or the other",
                hint="tables of pairs whose positions are known: parameters in [[measurements]]",
            )
        read_decay_times(decay_times)
    known = {} if positions is None else read_positions(positions)
    text = draft_campaign(
        room,
        {} if decay_times is not None else matching_files(folder, recordings, known),
        known,
        folder=folder,
        template=recordings,
        because=because,
        decay_times=decay_times,
    )
    make_folder(folder)
    with sole_editor(file):
        _check_place(file, overwrite)
        write_text_atomically(file, text)
    return text


def measure_to_folder(
    folder: Path,
    source: str,
    receiver: str,
    plan: SweepPlan,
    play_and_record: Callable[[FloatArray, float], tuple[FloatArray, tuple[str, ...]]],
    *,
    again: bool = False,
) -> SweepResponse:
    """Measure a pair and write its impulse response as ``SOURCE_RECEIVER.wav``, 32-bit float.

    Parameters
    ----------
    folder : Path
        Of the recordings; made where it is missing.
    plan : SweepPlan
    play_and_record : callable
        Takes what is played, shape (n_samples,), and its sampling rate in Hz; returns what was
        recorded meanwhile, and what the devices report of faults. `SoundCard` is one.
    again : bool
        Whether to replace the response of this pair.

    Raises
    ------
    InputError
        A name of no use, a pair that was measured already, or a recording of no use; then nothing
        is written.
    StoreError
        The disk refuses.
    """
    from roomfit.files.responses.sweep import (
        check_not_measured,
        excitation,
        response_from_recording,
        response_name,
        wav_bytes,
    )

    path = folder / response_name(source, receiver)
    check_not_measured(path, again=again)
    recorded, reported = play_and_record(excitation(plan), plan.sampling_rate_hz)
    measured = response_from_recording(plan, recorded, reported)
    make_folder(folder)
    write_bytes_atomically(path, wav_bytes(measured.response))
    return measured


@reading_noted()
def compare_to_folder(
    first: ResultFile, second: ResultFile, out: Path | None = None, *, overwrite: bool = False
) -> Comparison:
    """Compare two results; write compared.csv, compared.html and compared.png into a folder.

    Parameters
    ----------
    first, second : Path
        ``result.json`` or ``absorption.csv``.
    out : Path, optional
        Left out, nothing is written.

    Raises
    ------
    InputError
        A result cannot be read, the two have nothing in common, or the folder is not empty.
    StoreError
        The disk refuses.
    """
    from roomfit.files.results import read_result
    from roomfit.report import comparison
    from roomfit.report.figures import png

    if out is not None:
        check_output_folder(out, overwrite=overwrite)
    compared = comparison.compare_results(read_result(first), read_result(second))
    if out is not None:
        labels = tuple("/".join(path_of(file).parts[-2:]) for file in (first, second))
        records = comparison.comparison_records(compared)
        with whole_output_folder(out, overwrite=overwrite) as folder:
            write_text_atomically(folder / "compared.csv", csv_of(records))
            page = comparison.comparison_page(compared, labels)
            write_text_atomically(folder / "compared.html", page)
            picture = png(comparison.comparison_figure(compared, labels))
            write_bytes_atomically(folder / "compared.png", picture)
    return compared


@dataclass(frozen=True, slots=True, eq=False)
class ExportedFiles:
    """Files that were written, and what their reader must know."""

    files: tuple[Path, ...]
    findings: tuple[Finding, ...]


def export_result(
    result_file: ResultFile | Result,
    wanted: str,
    out: Path,
    *,
    scattering: float | None = None,
    overwrite: bool = False,
) -> ExportedFiles:
    """Write the materials of a result in the format of another program.

    Parameters
    ----------
    result_file : Path or Result
        A ``result.json`` or an ``absorption.csv``; for "pdf" and "word" with its ``report.html``
        beside it, for "word" the pictures as well. Or a result in memory, but for "excel", "pdf"
        and "word".
    wanted : {"catt", "odeon", "isimpa", "pyroomacoustics", "csv", "budget", "excel", "pdf", "word"}
    out : Path
        The file to write.
    scattering : float, optional
        Coefficient of every material where the result contains none, 0 to 1; by default that of
        `Settings`.
    overwrite : bool
        Replace an existing file.

    Raises
    ------
    InputError
        The result cannot be read, the format is unknown, or the file exists already.
    StoreError
        The disk refuses.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as name:
    ...     result, out = Path(name) / "absorption.csv", Path(name) / "materials.txt"
    ...     _ = result.write_text(
    ...         "material,band_hz,absorption,lower95,upper95,identifiable\\n"
    ...         "carpet,500,0.3,0.25,0.36,true\\n"
    ...     )
    ...     written = export_result(result, "isimpa", out)
    ...     print(out.read_text().strip())
    carpet = < 30 30 30 30 30 30 > L < 10 10 10 10 10 10 >
    >>> print(written.findings[0].sentence)
    The result has no scattering; 0.1 was written for every material.
    """
    from roomfit.files.exports import export_materials, material_table_of, read_material_table
    from roomfit.result import Result

    out = Path(out)
    # as the programs write themselves: CATT-Acoustic, I-Simpa
    wanted = wanted.lower().replace("-", "").removesuffix("acoustic")
    if wanted == "budget":
        from roomfit.files.budget import budget_records, uncertainty_budget

        _check_place(out, overwrite)
        write_text_atomically(out, csv_of(budget_records(uncertainty_budget(result_file))))
        return ExportedFiles((out,), ())
    if wanted in ("excel", "pdf", "word"):
        if isinstance(result_file, Result):
            raise InputError(
                "this format is made from the files of a result",
                found=f"a result in memory, for {wanted!r}",
                needed="result.json, and for PDF or Word report.html beside it",
                hint="roomfit.write_result(folder, result, []) first",
            )
        _check_place(out, overwrite)
        content, findings = _whole_export(result_file, wanted)
        write_bytes_atomically(out, content)
        return ExportedFiles((out,), findings)
    usual = Settings().default_scattering if scattering is None else scattering
    table = (
        material_table_of(result_file)
        if isinstance(result_file, Result)
        else read_material_table(result_file)
    )
    text, findings = export_materials(table, wanted, usual)
    _check_place(out, overwrite)
    write_text_atomically(out, text)
    return ExportedFiles((out,), (*findings, *table.findings))


def _whole_export(result_file: ResultFile, wanted: str) -> tuple[bytes, tuple[Finding, ...]]:
    from roomfit.files.exports import read_material_table, workbook_bytes

    if wanted == "excel":
        return workbook_bytes(result_file), read_material_table(result_file).findings
    # the page that was written beside the result
    path = path_of(result_file)
    own = path.suffix.lower() in (".html", ".htm")
    page = read_text(path if own else path.with_name("report.html"), "report")
    if wanted == "pdf":
        from roomfit.report.pdf import report_pdf

        return report_pdf(page), ()
    from roomfit.report.word import report_word

    findings = () if own else read_material_table(result_file).findings
    beside = sorted(path.parent.glob("*.png"))
    return report_word(page, {f.stem: read_bytes(f, "picture") for f in beside}), findings


def _check_place(out: Path, overwrite: bool) -> None:
    if out.exists() and not out.is_file():
        inner = out.is_dir()
        raise InputError(
            "one file is written, and something else is in its place",
            where=str(out),
            found="a folder" if inner else "a device, a pipe or a socket, which would be replaced",
            needed="a new name",
            hint=f"write --out {out / 'materials.txt'}"
            if inner and not out.suffix  # a folder was meant, not a name that a folder has
            else "rename what is there, or choose another name",
        )
    if out.exists() and not overwrite:
        raise InputError(
            "the file to write exists",
            where=str(out),
            found="a file of this name",
            needed="a new name, so that nothing is lost",
            hint="choose another name, or add --overwrite",
        )
    if not out.parent.is_dir():
        raise InputError(
            "the folder of the file to write does not exist",
            where=str(out.parent),
            found="no such folder",
            needed="a folder that is there",
            hint="make it first, or name another one",
        )


@sole_writer
@reading_noted()
def design_to_folder(
    campaign_file: Path,
    out: Path,
    changed: Mapping[str, Any] | None = None,
    *,
    result_file: ResultFile | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Design:
    """Choose where to measure and write design.json, design.csv and two pictures into a folder.

    Parameters
    ----------
    changed : mapping of option to value, optional
        Fields of `roomfit.DesignOptions` that stand instead of the campaign's.
    result_file : Path, optional
        ``result.json`` or ``absorption.csv`` of a finished fit.

    Raises
    ------
    InputError
        The campaign, the room, the result or the output folder is invalid.
    StoreError
        The disk refuses.
    """
    from roomfit.design.campaign import design_arguments
    from roomfit.design.output import design_gain, design_map, write_design
    from roomfit.design.positions import design
    from roomfit.files.campaign import read_campaign
    from roomfit.files.results import read_result
    from roomfit.report.figures import png

    check_output_folder(out, overwrite=overwrite)
    campaign = read_campaign(campaign_file, to_fit=False)
    found = None if result_file is None else read_result(result_file)
    arguments = design_arguments(campaign, found, changed)
    with located(str(campaign_file)):
        answer = design(**arguments, progress=part(progress, 0.0, 0.98))
    with whole_output_folder(out, overwrite=overwrite) as folder:
        write_design(folder, answer, files_read())
        write_bytes_atomically(folder / "design_map.png", png(design_map(answer)))
        write_bytes_atomically(folder / "design_gain.png", png(design_gain(answer)))
    return answer


@sole_writer
@reading_noted()
def identify_to_folder(
    campaign_file: Path,
    out: Path,
    *,
    between_hz: tuple[float, float] | None = None,
    quick: bool = False,
    overwrite: bool = False,
    progress: Progress | None = None,
    answered: Callable[[Result, Advice], None] | None = None,
) -> Result:
    """Identify a campaign and write result.json, tables, pictures and report into a folder.

    Files are written after the whole computation, all of them or none.

    Parameters
    ----------
    campaign_file, out : Path
    between_hz : (lowest, highest), optional
        Bands to fit in place of the campaign's, see `identify_arguments`.
    quick : bool
        A first answer, see `Settings.quick`, without pictures beside the report.
    overwrite : bool
        Write into a folder that is not empty.
    progress, answered : callable, optional
        `answered` is called with the answer, and with what its findings advise to write into the
        campaign, before report and pictures are drawn.

    Raises
    ------
    InputError
        The campaign, the room, a response or the output folder is invalid.
    InsufficientDataError
        The data cannot be fitted at all.
    StoreError
        The disk refuses.
    """
    from roomfit.files.campaign import read_campaign
    from roomfit.files.inputs import identify_arguments
    from roomfit.files.project import project_details
    from roomfit.files.remedies import advice
    from roomfit.files.results import check_disk_room
    from roomfit.fit.measurements import measured_scene
    from roomfit.identify import identify

    check_output_folder(out, overwrite=overwrite)  # now rather than after minutes of work
    campaign = read_campaign(campaign_file)
    project = project_details(campaign.project, campaign.path.parent)
    arguments = identify_arguments(campaign, between_hz)
    arguments["settings"] = replace(arguments["settings"], quick=quick)
    check_disk_room(out, len(arguments["measurements"]))
    with located(str(campaign_file)):
        answer = identify(**arguments, progress=part(progress, 0.0, 0.95))
    advised = advice(answer.findings, campaign)
    if answered is not None:
        answered(answer, advised)
    scene = measured_scene(arguments["scene"], arguments["measurements"])
    with whole_output_folder(out, overwrite=overwrite) as folder:
        rest = part(progress, 0.95, 1.0)
        _write_answer(folder, answer, scene, campaign_file, project, advised, rest)
    return answer


def _write_answer(
    folder: Path,
    answer: Result,
    scene: Scene,
    campaign_file: Path,
    project: dict[str, str],
    advised: Advice,
    progress: Progress | None,
) -> None:
    """Write result and report, and pictures beside it unless the answer is a quick one."""
    from roomfit.base.forks import beside, in_this_process
    from roomfit.files.results import write_result
    from roomfit.report.figures import answer_figures, write_pictures
    from roomfit.report.html import mean_decay_figure, report_html
    from roomfit.report.room_figure import room_figure
    from roomfit.report.usable import remaining_usable

    inputs = tuple(files_read())
    shown = {"room": room_figure(scene), "decay_times": mean_decay_figure(answer)}
    figures = answer_figures(answer, **shown)
    drawing = partial(write_pictures, folder, answer, in_this_process(progress), figures)
    _LOG.info("drawing")
    with beside(drawing) if not answer.settings.quick else nullcontext() as drawn:
        page = report_html(
            answer,
            scene,
            title=project.pop("title", f"Absorption: {campaign_file.stem}"),
            campaign=campaign_file.name,
            inputs_sha256=input_digests(inputs),
            project=project,
            figures=figures,
            advice=advised,
        )
        write_result(folder, answer, inputs, remaining_usable(answer))
        write_text_atomically(folder / "report.html", page)
        if drawn is not None:
            drawn.result()


@sole_writer
def run_demo(
    out: Path, seed: int, *, overwrite: bool = False, progress: Progress | None = None
) -> tuple[Result, FloatArray]:
    """Write a simulated campaign into ``out/campaign`` and its identification into ``out/result``.

    Returned are the answer and the absorption with which its data were simulated, shape
    (n_materials, n_bands), in the answer's order.

    Raises
    ------
    InputError
        The folder is not empty and `overwrite` is false.
    StoreError
        The disk refuses.
    """
    from roomfit.demo.boxes import PLAN_BANDS, demo_plan, write_measured_box
    from roomfit.report.figures import absorption_figure, png

    with whole_output_folder(out, overwrite=overwrite) as folder:
        (folder / "campaign").mkdir()
        plan, rng = demo_plan(), np.random.default_rng(seed)
        _LOG.info("simulating measurements")
        campaign = write_measured_box(plan, folder / "campaign", rng, part(progress, 0.0, 0.4))
        answer = identify_to_folder(campaign, folder / "result", progress=part(progress, 0.4, 1.0))
        rows = [plan.materials.index(name) for name in answer.materials]
        at = [int(np.argmin(np.abs(PLAN_BANDS.centres_hz - f))) for f in answer.bands.centres_hz]
        true_absorption: FloatArray = plan.absorption[np.ix_(rows, at)]
        picture = png(absorption_figure(answer, true_absorption))
        write_bytes_atomically(folder / "result" / "absorption_and_truth.png", picture)
    return answer, true_absorption
