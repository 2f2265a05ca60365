"""``roomfit listen``: measured responses as they would be after a change."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import soundfile

from roomfit.base.door import files_read, reading_noted
from roomfit.base.errors import InputError, InsufficientDataError, located
from roomfit.base.findings import Code
from roomfit.base.typing import FloatArray, Progress
from roomfit.base.whole_files import check_output_folder, whole_output_folder, write_json_atomically
from roomfit.files.campaign import read_campaign
from roomfit.files.encoding import ResultFile
from roomfit.files.questions import Wanted, question_of_pairs
from roomfit.files.responses import read_response
from roomfit.files.results import read_result
from roomfit.files.schema import ResponseSpec
from roomfit.predict.changes import read_change
from roomfit.predict.listen import listen, with_dry_recording
from roomfit.predict.output import listen_content
from roomfit.report.blocks import Blocks
from roomfit.report.predicted import listen_blocks
from roomfit.report.wording import in_file_name
from roomfit.signals.measurement import Measurement


@reading_noted()
def listen_to_folder(
    campaign_file: Path,
    absorption_file: ResultFile,
    out: Path,
    changes: Sequence[str] = (),
    *,
    wanted: Wanted | None = None,
    dry: Path | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Blocks:
    """Write measured responses before and after a change, as WAV files of floats, and listen.json.

    Nothing is normalised. With `dry`, a recording of one channel, its convolutions stand beside
    them, all scaled by one factor so that the loudest has a peak of half. `InsufficientDataError`
    where the result is seriously doubted in a band, which a sound cannot leave out, unless
    this is wanted.
    """
    own = [read_change(text) for text in changes]
    if named := [c.variant for c in own if c.variant]:
        what, found_here = "sounds are of one change of the room", f"the variant {named[0]!r}"
        needed, hint = "changes without a name", "leave NAME | out, and make each by itself"
        raise InputError(what, found=found_here, needed=needed, hint=hint)
    check_output_folder(out, overwrite=overwrite)
    campaign = read_campaign(campaign_file, to_fit=False)
    found = read_result(absorption_file)
    wanted = (wanted or Wanted())._replace(pairs="campaign")
    question = question_of_pairs(campaign, found, own, wanted)
    known = question.known
    for doubt in known.findings:
        if doubt.code is Code.RESULT_DOUBTED:
            raise InsufficientDataError(
                "a sound has every band, and other walls are not predicted in some",
                found=doubt.sentence,
                needed="in every band, absorptions that no serious finding calls wrong",
                hint="put right what the findings name, and identify again; or add --doubted",
            )
    measured = [m for m in question.measurements if isinstance(m, Measurement)]
    recorded = None if dry is None else _dry_pressure(dry, measured)
    with located(str(campaign_file)):
        made, findings = listen(question, progress=progress)
    sounds = [{"before": c.measurement.response.pressure, "after": c.samples} for c in made]
    content = listen_content(known.bands, own, made, findings, files_read())
    content["dry_factor"] = None
    if recorded is not None:
        sounds, content["dry_factor"] = with_dry_recording(sounds, recorded)
    with whole_output_folder(out, overwrite=overwrite) as folder:
        for i, (c, sound) in enumerate(zip(made, sounds, strict=True), start=1):
            m = c.measurement
            stem = f"{i:02d}_{in_file_name(m.source, m.receiver)}"
            names = {kind: f"{stem}_{kind}.wav" for kind in sound}
            rate_hz = round(m.response.sampling_rate_hz)
            for kind, x in sound.items():
                soundfile.write(folder / names[kind], x, rate_hz, subtype="FLOAT")
            content["responses"][i - 1]["files"] = names
        write_json_atomically(folder / "listen.json", content)
    return listen_blocks(content)


def _dry_pressure(file: Path, measured: Sequence[Measurement]) -> FloatArray:
    """Return the samples of a dry recording, which has the sampling rate of the responses."""
    dry = read_response(ResponseSpec(file))[0]
    rates_hz = {m.response.sampling_rate_hz for m in measured[:1]}
    if rates_hz and dry.sampling_rate_hz not in rates_hz:
        raise InputError(
            "the dry recording has another sampling rate than the responses",
            where=str(file),
            found=f"{dry.sampling_rate_hz:g} Hz",
            needed=f"{rates_hz.pop():g} Hz",
            hint="resample the dry recording",
        )
    return dry.pressure
