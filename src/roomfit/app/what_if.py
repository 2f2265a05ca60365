"""A room that is ready for changes, kept by the worker from one move of a slider to the next.

Of a room that was identified its paths; of one of which decay times alone are known, its formula.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from roomfit.app import project
from roomfit.app.treatment import treatment_view
from roomfit.base.errors import InputError, InsufficientDataError
from roomfit.base.findings import Code
from roomfit.base.typing import Progress
from roomfit.files.campaign import read_campaign
from roomfit.files.encoding import finding_content, numbers_or_null
from roomfit.files.questions import Wanted, question_of, question_of_pairs
from roomfit.files.results import read_result
from roomfit.predict.changes import Change, read_change
from roomfit.predict.diffuse import NAME, PreparedField
from roomfit.predict.predict import ChangingRoom, predict_change, prepare
from roomfit.predict.prediction import PredictedValue, change_directions, named_values
from roomfit.signals.iso3382 import ValueName
from roomfit.treat.campaign import read_treatment, treat_arguments
from roomfit.treat.question import USUAL_HZ

SHOWN = ("T20_s", "EDT_s", "C80_dB", "D50_percent", "STI")
"""Parameters that are shown, as far as they are predicted; from decay times alone T30."""
_SHOWN_WITH = {"T30_s": "T20_s"}  # limits of the one stand in the picture of the other
_LEAST_FACTOR = 0.5  # decays are followed as long as with so much of each material's absorption
_ready: dict[str, tuple[tuple[float, ...], ChangingRoom]] = {}


def what_if_prepare(progress: Progress, folder: str, doubted: bool = False) -> dict[str, Any]:
    """Make a room ready for changes; return materials, their absorption and the room as it is.

    Without a result it is taken for a diffuse field, by its decay times. Bands in which a result
    is seriously doubted are left out, unless `doubted`; where these are all of them, the answer
    is why, alone.
    """
    root = Path(folder)
    file, result = project.campaign_file(root), project.best_result(root)
    known_by = project.answer_file(root, or_decay_times=True)
    stamp = (known_by.stat().st_mtime, file.stat().st_mtime, float(doubted))
    if folder not in _ready or _ready[folder][0] != stamp:
        _ready.clear()
        try:
            room = _prepared(progress, file, result and known_by, doubted)
        except InsufficientDataError as error:
            return {"refused": f"{error.what[0].upper()}{error.what[1:]}: {error.found}."}
        _ready[folder] = (stamp, room)
    room = prepared(folder)
    known = room.absorption
    left_out = [f.sentence for f in known.findings if f.code is Code.RESULT_DOUBTED]
    limits, fault, bands_hz = [], "", known.bands.centres_hz.tolist()
    try:
        limits = _limits(root / project.TREATMENT_QUESTION, room)
    except InputError as error:  # which the form says, where it can be put right
        fault = str(error)
    return {
        "bands_hz": bands_hz,
        "treatment": (
            treatment_view(progress, folder, bands_hz if result else (), fault)
            if "room" in project.campaign_content(root)
            else None  # of volume and surface alone nothing can be covered
        ),
        "absorption": dict(zip(known.materials, known.absorption.tolist(), strict=True)),
        "left_out": " ".join(left_out),
        "limits": limits,
        **what_if(progress, folder, []),
    }


def _prepared(
    progress: Progress, campaign_file: Path, result: Path | None, doubted: bool
) -> ChangingRoom:
    """Return a campaign's room ready for changes, by its result or its decay times."""
    campaign = read_campaign(campaign_file, to_fit=False, decay_times=result is None)
    if result is None:
        return prepare(question_of(campaign))
    found = read_result(result)
    question = question_of_pairs(campaign, found, _harder(found.materials), Wanted(doubted=doubted))
    known = question.known
    room = prepare(question, (_harder(known.materials),), progress=progress)
    # what a slider leaves as it was found is then known at its first move
    predict_change(room, [Change(known.materials[0], "factor", (1.0,))])
    return room


def _harder(materials: Sequence[str]) -> list[Change]:
    return [Change(name, "factor", (_LEAST_FACTOR,)) for name in materials]


def prepared(folder: str) -> ChangingRoom:
    """Return the room that `what_if_prepare` has made ready last."""
    if folder not in _ready:
        what = "the room is not prepared yet"
        needed, hint = "what_if_prepare of this project", "open What if again"
        raise InputError(what, found="a room of another project, or none", needed=needed, hint=hint)
    return _ready[folder][1]


def what_if(
    progress: Progress, folder: str, changes: list[str], doubted: bool = False
) -> dict[str, Any]:
    """Return what changes do, written as those of ``roomfit predict --set``."""
    if folder not in _ready:  # the process was ended meanwhile and started again
        what_if_prepare(progress, folder, doubted)
    room, own = prepared(folder), [read_change(text) for text in changes]
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
            {
                "source": pair.source,
                "receiver": pair.receiver,
                **_values(pair.parameters, pair.sti),
            }
            for pair in predicted.pairs
        ],
        "seconds": predicted.seconds,
    }


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


def _values(
    table: Mapping[ValueName, PredictedValue], sti: PredictedValue | None
) -> dict[str, dict[str, list[float | None]]]:
    named = named_values(table, sti)
    shown = SHOWN if SHOWN[0] in named else (NAME,)
    return {name: _value(named[name]) for name in shown if name in named}


def _value(value: PredictedValue) -> dict[str, list[float | None]]:
    own = {
        "predicted": numbers_or_null(value.predicted),
        "lower95": numbers_or_null(value.lower95),
        "upper95": numbers_or_null(value.upper95),
    }
    if value.change is not None:
        own["before"] = numbers_or_null(value.change.before)
        own["before_lower95"] = numbers_or_null(value.change.before_lower95)
        own["before_upper95"] = numbers_or_null(value.change.before_upper95)
    return own
