"""A room that is ready for changes, kept by the worker from one move of a slider to the next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from roomfit.app import project
from roomfit.app.treatment import treatment_view
from roomfit.errors import InputError, InsufficientDataError
from roomfit.findings import Code
from roomfit.io.campaign import read_campaign
from roomfit.io.encoding import numbers_or_null
from roomfit.io.results import read_result
from roomfit.prediction.campaign import predict_arguments
from roomfit.prediction.changes import Change, read_change
from roomfit.prediction.predict import (
    PreparedRoom,
    predict_change,
    prepare_prediction,
)
from roomfit.prediction.tables import PredictedValue, named_values
from roomfit.signals.iso3382 import ValueName
from roomfit.treatment.campaign import read_treatment, treat_arguments
from roomfit.treatment.question import USUAL_HZ
from roomfit.typing import Progress

SHOWN = ("T20_s", "EDT_s", "C80_dB", "D50_percent", "STI")
"""Parameters that are shown, as far as they are predicted."""
_SHOWN_WITH = {"T30_s": "T20_s"}  # limits of the one stand in the picture of the other
_LEAST_FACTOR = 0.5  # decays are followed as long as with so much of each material's absorption
_ready: dict[str, tuple[tuple[float, ...], PreparedRoom]] = {}


def what_if_prepare(progress: Progress, folder: str, doubted: bool = False) -> dict[str, Any]:
    """Trace the room for changes; return materials, their absorption and the room as it is.

    Bands in which the result is seriously doubted are left out, unless `doubted`; where these are
    all of them, the answer is why, alone.

    Raises
    ------
    InputError
        There is no result yet.
    """
    root = Path(folder)
    result = project.best_result(root)
    if result is None:
        raise InputError("there is no answer yet", hint="identify first")
    file = project.campaign_file(root)
    stamp = (result.stat().st_mtime, file.stat().st_mtime, float(doubted))
    if folder not in _ready or _ready[folder][0] != stamp:
        _ready.clear()
        campaign = read_campaign(file, to_fit=False)
        found = read_result(result)
        harder = _harder(found.materials)
        try:
            arguments = predict_arguments(campaign, found, harder, doubted=doubted)
        except InsufficientDataError as error:
            return {"refused": f"{error.what[0].upper()}{error.what[1:]}: {error.found}."}
        known = arguments["absorption"]
        room = prepare_prediction(
            arguments["scene"],
            known,
            (_harder(known.materials),),
            arguments["measurements"],
            speech_db=arguments["speech_db"],
            settings=arguments["settings"],
            progress=progress,
        )
        # what a slider leaves as it was found is then known at its first move
        predict_change(room, [Change(known.materials[0], "factor", (1.0,))])
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
        "treatment": treatment_view(progress, folder, bands_hz, fault),
        "absorption": dict(zip(known.materials, known.absorption.tolist(), strict=True)),
        "left_out": " ".join(left_out),
        "limits": limits,
        **what_if(progress, folder, []),
    }


def _harder(materials: Sequence[str]) -> list[Change]:
    return [Change(name, "factor", (_LEAST_FACTOR,)) for name in materials]


def prepared(folder: str) -> PreparedRoom:
    """Return the room that `what_if_prepare` has traced last.

    Raises
    ------
    InputError
        It is another one.
    """
    if folder not in _ready:
        raise InputError("the room is not prepared yet")
    return _ready[folder][1]


def what_if(
    progress: Progress, folder: str, changes: list[str], doubted: bool = False
) -> dict[str, Any]:
    """Return what changes do, written as those of ``roomfit predict --set``.

    Raises
    ------
    InputError
        There is no result, or a change cannot be made.
    """
    if folder not in _ready:  # the process was ended meanwhile and started again
        what_if_prepare(progress, folder, doubted)
    # nothing measured stands beside: means are over all pairs in every band
    room = replace(prepared(folder), observed=())
    own = [read_change(text) for text in changes]
    predicted = predict_change(room, own, compare_pairs=False)
    return {
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


def _limits(file: Path, room: PreparedRoom) -> list[dict[str, Any]]:
    """Return the limits of a treatment file, each with the bands in which it holds."""
    if not file.is_file():
        return []
    asked = treat_arguments(file, read_treatment(file), room.absorption, room.scene)[0]
    return [
        {
            "parameter": _SHOWN_WITH.get(t.parameter, t.parameter),
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
    return {name: _value(named[name]) for name in SHOWN if name in named}


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
