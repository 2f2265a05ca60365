"""A room that is ready for changes, kept by its process from one move of a slider to the next.

Of a room that was identified its paths; of one of which decay times alone are known, its formula.
And what to hang where: the form is treatment.toml, of which what it does not show stays as it is
written.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from roomfit.app import project
from roomfit.base.door import read_text
from roomfit.base.errors import InputError, InsufficientDataError
from roomfit.base.findings import Code
from roomfit.base.whole_files import write_text_atomically
from roomfit.files.campaign import read_campaign, read_toml
from roomfit.files.edits import edited_text, without_tables
from roomfit.files.encoding import finding_content, numbers_or_null, written_content
from roomfit.files.inputs import campaign_room
from roomfit.files.questions import Wanted, question_of, question_of_pairs
from roomfit.files.results import read_result
from roomfit.files.values import read_decay_times
from roomfit.predict.changes import Change, read_change
from roomfit.predict.diffuse import NAME, PreparedField
from roomfit.predict.predict import ChangingRoom, predict_change, prepare
from roomfit.predict.prediction import PredictedValue, change_directions, named_values
from roomfit.room.scene import material_areas_m2
from roomfit.signals.iso3382 import ValueName
from roomfit.treat.campaign import checked_treatment, read_treatment, treat_arguments
from roomfit.treat.question import USUAL_HZ

SHOWN = ("T20_s", "EDT_s", "C80_dB", "D50_percent", "STI")
"""Parameters that are shown, as far as they are predicted; from decay times alone T30."""
_SHOWN_WITH = {"T30_s": "T20_s"}  # limits of the one stand in the picture of the other
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
    limits, fault, bands_hz = [], "", known.bands.centres_hz.tolist()
    try:
        limits = _limits(folder / project.TREATMENT_QUESTION, room)
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
        "limits": limits,
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
    if isinstance(room, PreparedField):
        predicted = predict_change(room, own)
        said = predicted.findings
    else:
        # nothing measured stands beside: means are over all pairs in every band
        predicted = predict_change(replace(room, observed=()), own, compare_pairs=False)
        said = tuple(f for f in predicted.findings if f.code is Code.CHANGE_PRIOR_DOMINATED)
    return {
        "findings": [finding_content(f) for f in said if f.code is not Code.MATERIALS_CHANGED],
        # what was changed is what the sliders say
        "directions": change_directions(predicted.bands, predicted.mean)[1],
        "mean": _values(predicted.mean, predicted.sti),
        "pairs": [
            {"source": p.source, "receiver": p.receiver, **_values(p.parameters, p.sti)}
            for p in predicted.pairs
        ],
    }


def _values(
    table: Mapping[ValueName, PredictedValue], sti: PredictedValue | None
) -> dict[str, dict[str, list[float | None]]]:
    """Return numbers by parameter: predicted, with their interval, and the same before."""
    named, shown = named_values(table, sti), {}
    for name in SHOWN if SHOWN[0] in named else (NAME,):
        if name in named:
            value, kinds = named[name], ["predicted", "lower95", "upper95"]
            shown[name] = {kind: numbers_or_null(getattr(value, kind)) for kind in kinds}
            for kind in ("before", "before_lower95", "before_upper95") if value.change else ():
                shown[name][kind] = numbers_or_null(getattr(value.change, kind))
    return shown


def _limits(file: Path, room: ChangingRoom) -> list[dict[str, Any]]:
    """Return the limits of a treatment file, each with the bands in which it holds."""
    if not file.is_file():
        return []
    asked = treat_arguments(file, read_treatment(file), room.absorption, room.scene)[0]
    shown_with = {} if isinstance(room, PreparedField) else _SHOWN_WITH
    return [
        {
            "parameter": shown_with.get(t.parameter, t.parameter),
            "value": float(value),
            "bands_hz": list(t.bands_hz or USUAL_HZ),
        }
        for t in asked["targets"]
        for value in (t.low, t.high)
        if np.isfinite(value)
    ]


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
            checked_treatment(file, question)
    except InputError as error:
        fault = str(error)
    with suppress(InputError, LookupError, TypeError):  # none yet, or of an earlier version
        answer = folder / project.TREATMENT / "treatment.json"
        sentence = written_content(answer, "treatment")[0]["sentence"]
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
    checked_treatment(file, tomllib.loads(after))
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
