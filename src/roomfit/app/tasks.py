"""What the page asks a process to do, by name, of a project's folder: answers, and long work.

A room that is ready for changes is kept from one move of a slider to the next: of one that was
identified its paths, of one of which decay times alone are known its formula. What to hang where is
asked by treatment.toml; what the form does not show stays there as it is written.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from roomfit.app import project, views
from roomfit.base.door import read_text
from roomfit.base.errors import InputError, InsufficientDataError
from roomfit.base.findings import Code
from roomfit.base.typing import Progress
from roomfit.base.whole_files import write_text_atomically
from roomfit.cli.identify import identify_to_folder
from roomfit.cli.listen import listen_to_folder
from roomfit.cli.predict import reverberation_to_folder
from roomfit.cli.treat import treat_to_folder
from roomfit.demo.boxes import demo_plan, write_measured_box
from roomfit.files import encoding
from roomfit.files.campaign import read_campaign, read_toml
from roomfit.files.edits import edited_text, without_tables
from roomfit.files.inputs import campaign_room
from roomfit.files.questions import Wanted, question_of, question_of_pairs
from roomfit.files.remedies import changed_since
from roomfit.files.results import read_result, read_result_content
from roomfit.files.values import read_decay_times
from roomfit.predict.changes import Change, by_variant, read_change
from roomfit.predict.diffuse import PreparedField
from roomfit.predict.predict import ChangingRoom, predict_change, prepare
from roomfit.predict.prediction import change_directions
from roomfit.report.blocks import Block, Blocks, Sentence
from roomfit.report.html import fragment
from roomfit.report.predicted import describe, variant_tables
from roomfit.report.treated import limits_of
from roomfit.room.scene import material_areas_m2
from roomfit.treat import campaign as treatments
from roomfit.treat.question import Target

_LEAST_FACTOR = 0.5  # decays are followed as long as with so much of each material's absorption
_FIRST = "# What may be hung where, and what is to be reached: roomfit treat, docs/treat.md\n"
_ready: dict[Path, tuple[tuple[float, ...], ChangingRoom]] = {}


def what_if_prepare(folder: Path, doubted: bool = False) -> dict[str, Any]:
    """Make a room ready for changes; return materials, their absorption and the room as it is.

    Without a result it is taken for a diffuse field, by its decay times. Bands in which a result
    is seriously doubted are left out, unless `doubted`; where these are all of them, the answer
    is why, alone.
    """
    try:
        room = _ready_room(folder, doubted)
    except InsufficientDataError as error:
        return {"refused": f"{error.what[0].upper()}{error.what[1:]}: {error.found}."}
    known = room.absorption
    fault, bands_hz = "", known.bands.centres_hz.tolist()
    try:
        _targets(folder / project.TREATMENT_QUESTION, room)
    except InputError as error:  # which the form says, where it can be put right
        fault = str(error)
    has_result = project.best_result(folder) is not None
    # of volume and surface alone nothing can be covered
    has_walls = "room" in project.campaign_content(folder)
    left_out = [f.sentence for f in known.findings if f.code is Code.RESULT_DOUBTED]
    return {
        "bands_hz": bands_hz,
        "treatment": (
            treatment_view(folder, bands_hz if has_result else (), fault) if has_walls else None
        ),
        "absorption": dict(zip(known.materials, known.absorption.tolist(), strict=True)),
        "left_out": " ".join(left_out),
        "from_times": not has_result,
        "variants": _variants(folder, room),
        **what_if(folder, [], doubted),
    }


def _ready_room(folder: Path, doubted: bool) -> ChangingRoom:
    """Return a project's room ready for changes, as it was kept where nothing has changed."""
    file, result = project.campaign_file(folder), project.best_result(folder)
    known_by = project.answer_file(folder, or_decay_times=True)
    stamp = (known_by.stat().st_mtime, file.stat().st_mtime, float(doubted))
    if folder in _ready and _ready[folder][0] == stamp:
        return _ready[folder][1]
    _ready.clear()
    campaign = read_campaign(file, to_fit=False, decay_times=result is None)
    if result is None:
        room = prepare(question_of(campaign))
    else:
        found, wanted = read_result(result), Wanted(doubted=doubted)
        question = question_of_pairs(campaign, found, _harder(found.materials), wanted)
        room = prepare(question, (_harder(question.known.materials),))
        # what a slider leaves as it was found is then known at its first move
        predict_change(room, [Change(question.known.materials[0], "factor", (1.0,))])
    _ready[folder] = stamp, room
    return room


def _harder(materials: Sequence[str]) -> list[Change]:
    return [Change(name, "factor", (_LEAST_FACTOR,)) for name in materials]


def what_if(folder: Path, changes: list[str], doubted: bool = False) -> dict[str, Any]:
    """Return what changes do, written as those of ``roomfit predict --set``."""
    own = [read_change(text) for text in changes]
    # the process may have been ended meanwhile and started again
    room = _ready[folder][1] if folder in _ready else _ready_room(folder, doubted)
    predicted = predict_change(room, own)
    said = predicted.findings
    if not isinstance(room, PreparedField):
        said = tuple(f for f in said if f.code is Code.CHANGE_PRIOR_DOMINATED)
    targets: Sequence[Target] = ()
    with suppress(InputError):  # the form says it
        targets = _targets(folder / project.TREATMENT_QUESTION, room)
    return {
        "findings": [
            encoding.finding_content(f) for f in said if f.code is not Code.MATERIALS_CHANGED
        ],
        # what was changed is what the sliders say
        "directions": change_directions(predicted.bands, predicted.mean)[1],
        "shown": fragment(describe(predicted, limits_of(targets)), first=True),
    }


def _variants(folder: Path, room: ChangingRoom) -> dict[str, Any]:
    """Return the names of the variants that are kept, and the variants side by side."""
    own = by_variant([read_change(text) for text in project.variants(folder)])
    del own[""]
    blocks: tuple[Block, ...]
    try:
        blocks = variant_tables({name: predict_change(room, one) for name, one in own.items()})
    except InputError as error:  # of a room that is another now
        blocks = (Sentence(str(error)),)
    return {"names": [*own], "shown": fragment(Blocks("", blocks, ()))}


def _targets(file: Path, room: ChangingRoom) -> Sequence[Target]:
    """Return the targets of a treatment file; none where there is no file."""
    if not file.is_file():
        return ()
    known, scene = room.absorption, room.scene
    asked = treatments.treat_arguments(file, treatments.read_treatment(file), known, scene)[0]
    return tuple(asked["targets"])


# What to hang where.


def treatment_view(folder: Path, bands_hz: Sequence[float] = (), fault: str = "") -> dict[str, Any]:
    """Return surfaces with their areas, what is asked, and the sentence of the last answer."""
    with project.filled_campaign(folder) as campaign:
        room, times = campaign_room(campaign), campaign.reverberation
    from_times = times is not None and not bands_hz
    if times is not None and from_times:
        bands_hz = read_decay_times(folder / times.file)[1].centres_hz.tolist()
    question: dict[str, Any] = {}
    file, sentence = folder / project.TREATMENT_QUESTION, ""
    try:
        if file.is_file():
            question = read_toml(file, "treatment file")
            treatments.checked_treatment(file, question)
    except InputError as error:
        fault = str(error)
    with suppress(InputError, LookupError, TypeError):  # none yet, or of an earlier version
        answer = folder / project.TREATMENT / "treatment.json"
        sentence = encoding.written_content(answer, "treatment")[0]["sentence"]
    areas_m2 = material_areas_m2(room).round(2).tolist()
    return {
        "areas_m2": dict(zip(room.materials, areas_m2, strict=True)),
        "bands_hz": list(bands_hz),
        "from_times": from_times,
        "question": question,
        "fault": fault,
        "sentence": sentence,
    }


def ask_treatment(folder: Path, question: dict[str, Any]) -> None:
    """Write what is asked into treatment.toml, whole or not at all."""
    for key, what, hint in (
        ("surfaces", "no surface may be covered", "tick a surface"),
        ("products", "there is nothing to hang", "choose a product from the catalogue"),
        ("targets", "there is no target", "add a target"),
    ):
        if not question.get(key):
            raise InputError(what, found="none", needed="at least one", hint=hint)
    for number, target in enumerate(question["targets"], start=1):
        if not {"at_most", "at_least", "value", "standard"} & set(target):
            what, where, found = "a target has no limit", f"target {number}", "two empty fields"
            needed, hint = "a number below At most, At least, or both", "type one, or remove it"
            raise InputError(what, where=where, found=found, needed=needed, hint=hint)
    file = folder / project.TREATMENT_QUESTION
    before = read_text(file, "treatment file", most="campaign_bytes") if file.is_file() else _FIRST
    after = written_question(before, question)
    treatments.checked_treatment(file, tomllib.loads(after))
    if after != before:
        write_text_atomically(file, after)


def written_question(text: str, question: Mapping[str, Any]) -> str:
    """Return the text of a treatment file with another content; what is equal stays as written."""
    try:
        now = tomllib.loads(text)
        n_left, targets = len(question["targets"]), now.get("targets", [])
        gone = [("targets", n) for n in range(n_left + 1, len(targets) + 1)]
        edits = list(project.differences(now | {"targets": targets[:n_left]}, question))
        after = edited_text(without_tables(text, gone), edits)
        if tomllib.loads(after) == question:
            return after
    except (ValueError, TypeError, AttributeError, RecursionError, InputError):
        pass
    raise InputError(
        "the treatment file is written in a way that this cannot edit",
        where=project.TREATMENT_QUESTION,
        found="tables of another form than [surfaces.NAME], [products.NAME], [[targets]]",
        needed="one table for each, one key a line",
        hint="rename the file, and fill the form anew",
    )


# What the page has done.


def answer_view(folder: Path, name: str) -> dict[str, Any]:
    """Return when an answer was made, and what it advises; nothing where there is none.

    ``stale``: whether the campaign has changed since; ``advised``: see `views.advice_view`.
    """
    file = folder / name / "result.json"
    if not file.is_file():
        return {}
    content, doubts = read_result_content(encoding.EditedFile(file))
    campaign_file = project.campaign_file(folder)
    stale = changed_since(content, campaign_file)
    advice: list[dict[str, Any]] = []
    if not doubts:
        with suppress(InputError):  # the campaign cannot be read any more
            campaign = read_campaign(campaign_file, to_fit=False)
            raised = [encoding.finding_of(f, "result.json") for f in content["findings"]]
            advice = views.advice_view(raised, campaign, changed=stale)
    return {"made": file.stat().st_mtime, "stale": stale, "advised": advice}


def identify(progress: Progress, folder: Path, quick: bool) -> None:
    """Identify, as ``roomfit identify [--quick]`` does, into the folder of this kind of answer."""
    out = project.inside(folder, folder / (project.QUICK if quick else project.FULL))
    file = project.campaign_file(folder)
    identify_to_folder(file, out, quick=quick, overwrite=True, png=True, progress=progress)


def reverberation(folder: Path) -> None:
    """Find the mean absorption from decay times alone, as ``roomfit reverberation`` does."""
    out = project.inside(folder, folder / project.MEAN)
    reverberation_to_folder(project.campaign_file(folder), out, overwrite=True)


def demo(progress: Progress, folder: Path) -> None:
    """Write the campaign of ``roomfit demo``: a simulated room of known absorption."""
    if project.has_campaign(folder):
        what, found = "the folder has a campaign already", "campaign.toml"
        needed, hint = "a folder without a campaign", "start roomfit app in a new folder"
        raise InputError(what, where=str(folder), found=found, needed=needed, hint=hint)
    write_measured_box(demo_plan(), folder, np.random.default_rng(1), progress)


def treat(progress: Progress, folder: Path, doubted: bool = False) -> None:
    """Choose what to hang where, as ``roomfit treat`` does."""
    project.answer_file(folder, or_decay_times=True)
    treat_to_folder(
        project.campaign_file(folder),
        project.best_result(folder),
        folder / project.TREATMENT_QUESTION,
        project.inside(folder, folder / project.TREATMENT),
        wanted=Wanted(doubted=doubted, variants=project.variants(folder)),
        overwrite=True,
        png=True,  # for Word
        progress=progress,
    )


def listen(
    progress: Progress, folder: Path, changes: list[str], dry: str = "", doubted: bool = False
) -> None:
    """Make what a change sounds like, as ``roomfit listen`` does."""
    result = project.answer_file(folder)
    if not changes:
        what, needed = "there is nothing to compare yet", "one change or more"
        raise InputError(what, found="no change", needed=needed, hint="change a wall under What if")
    listen_to_folder(
        project.campaign_file(folder),
        result,
        project.inside(folder, folder / project.LISTENED),
        changes,
        wanted=Wanted(doubted=doubted),
        dry=project.upload_place(folder, project.DRY, dry) if dry else None,
        overwrite=True,
        progress=progress,
    )


def ready(_: Path) -> str:
    """Return a word: all that tasks need is imported."""
    return "ready"


WORKS: dict[str, Callable[..., Any]] = {f.__name__: f for f in (identify, demo, treat, listen)}
"""What takes long, by name: of a function for progress, and the folder."""
TASKS: dict[str, Callable[..., Any]] = {
    f.__name__: f
    for f in (
        views.room_view,
        views.set_room,
        views.recordings_view,
        views.table_positions,
        answer_view,
        reverberation,
        treatment_view,
        ask_treatment,
        views.measure,
        views.look_at_upload,
        project.export,
        what_if_prepare,
        what_if,
        ready,
    )
}
"""What is answered at once, by name."""


def carry_out(progress: Progress, task: str, folder: str, arguments: Mapping[str, Any]) -> Any:
    """Return the answer of a task, by its name, about a project."""
    if task in WORKS:
        return WORKS[task](progress, Path(folder), **arguments)
    return TASKS[task](Path(folder), **arguments)
