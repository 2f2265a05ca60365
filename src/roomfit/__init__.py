"""roomfit: the absorption of a real room's walls from impulse responses measured in it.

The front door: what stands in `__all__` is public, everything else may move. Names are loaded when
they are first used, so that ``import roomfit`` costs nothing.

>>> import roomfit
>>> roomfit.bands_between("octave", 125, 500).centres_hz.tolist()
[125.0, 250.0, 500.0]
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from roomfit.base.air import Air
    from roomfit.base.bands import Bands, bands_between
    from roomfit.base.errors import InputError, InsufficientDataError, RoomfitError, StoreError
    from roomfit.base.findings import About, Code, Finding
    from roomfit.checks.usable import check_recordings
    from roomfit.cli.export import export_result
    from roomfit.design.campaign import design_arguments
    from roomfit.design.candidates import DesignOptions
    from roomfit.design.positions import Design, design
    from roomfit.files.campaign import read_campaign
    from roomfit.files.inputs import load_campaign
    from roomfit.files.questions import question_of
    from roomfit.files.responses import read_response
    from roomfit.files.results import read_result, write_result
    from roomfit.files.rooms import read_room
    from roomfit.files.schema import ResponseSpec, RoomSpec
    from roomfit.files.values import read_parameters
    from roomfit.fit.traced_room import TracedRoom
    from roomfit.identify import identify
    from roomfit.impedance.data import Observed
    from roomfit.impedance.identify import ImpedanceSettings, identify_impedance
    from roomfit.materials.catalogue import material_prior
    from roomfit.materials.priors import MaterialPrior
    from roomfit.model.parameters import Parameters
    from roomfit.model.problem import DataTerm, Objective
    from roomfit.predict.changes import Change, read_change
    from roomfit.predict.diffuse_field import DiffuseField
    from roomfit.predict.predict import predict, predict_change, prepare
    from roomfit.predict.prediction import Predicted
    from roomfit.predict.question import Question
    from roomfit.report.answer import report_html
    from roomfit.result import Result, absorption_posterior
    from roomfit.room.scene import (
        Point,
        Room,
        RoomObject,
        Scene,
        State,
        scene_of,
        shoebox_room,
        with_states,
    )
    from roomfit.settings import Settings
    from roomfit.signals.iso3382 import MeasuredValues
    from roomfit.signals.measurement import Measurement
    from roomfit.treat.arrangements import Treatment, treat
    from roomfit.treat.question import Product, Surface, Target
    from roomfit.uncertainty.posterior import AbsorptionPosterior

__version__ = "0.1.0"

__all__ = [
    "About",
    "AbsorptionPosterior",
    "Air",
    "Bands",
    "Change",
    "Code",
    "DataTerm",
    "Design",
    "DesignOptions",
    "DiffuseField",
    "Finding",
    "ImpedanceSettings",
    "InputError",
    "InsufficientDataError",
    "MaterialPrior",
    "MeasuredValues",
    "Measurement",
    "Objective",
    "Observed",
    "Parameters",
    "Point",
    "Predicted",
    "Product",
    "Question",
    "ResponseSpec",
    "Result",
    "Room",
    "RoomObject",
    "RoomSpec",
    "RoomfitError",
    "Scene",
    "Settings",
    "State",
    "StoreError",
    "Surface",
    "Target",
    "TracedRoom",
    "Treatment",
    "__version__",
    "absorption_posterior",
    "bands_between",
    "check_recordings",
    "design",
    "design_arguments",
    "export_result",
    "identify",
    "identify_impedance",
    "load_campaign",
    "material_prior",
    "predict",
    "predict_change",
    "prepare",
    "question_of",
    "read_campaign",
    "read_change",
    "read_parameters",
    "read_response",
    "read_result",
    "read_room",
    "report_html",
    "scene_of",
    "shoebox_room",
    "treat",
    "with_states",
    "write_result",
]

# Where each name stands: what type checkers read above, for use.
_HOME = {
    "About": "base.findings",
    "absorption_posterior": "result",
    "AbsorptionPosterior": "uncertainty.posterior",
    "Air": "base.air",
    "Bands": "base.bands",
    "bands_between": "base.bands",
    "Change": "predict.changes",
    "check_recordings": "checks.usable",
    "Code": "base.findings",
    "DataTerm": "model.problem",
    "design": "design.positions",
    "Design": "design.positions",
    "design_arguments": "design.campaign",
    "DesignOptions": "design.candidates",
    "DiffuseField": "predict.diffuse_field",
    "export_result": "cli.export",
    "Finding": "base.findings",
    "identify": "identify",
    "identify_impedance": "impedance.identify",
    "ImpedanceSettings": "impedance.identify",
    "InputError": "base.errors",
    "InsufficientDataError": "base.errors",
    "load_campaign": "files.inputs",
    "material_prior": "materials.catalogue",
    "MaterialPrior": "materials.priors",
    "MeasuredValues": "signals.iso3382",
    "Measurement": "signals.measurement",
    "Objective": "model.problem",
    "Observed": "impedance.data",
    "Parameters": "model.parameters",
    "Point": "room.scene",
    "predict": "predict.predict",
    "predict_change": "predict.predict",
    "Predicted": "predict.prediction",
    "prepare": "predict.predict",
    "Product": "treat.question",
    "Question": "predict.question",
    "question_of": "files.questions",
    "read_campaign": "files.campaign",
    "read_change": "predict.changes",
    "read_parameters": "files.values",
    "read_response": "files.responses",
    "read_result": "files.results",
    "read_room": "files.rooms",
    "report_html": "report.answer",
    "ResponseSpec": "files.schema",
    "Result": "result",
    "Room": "room.scene",
    "RoomfitError": "base.errors",
    "RoomObject": "room.scene",
    "RoomSpec": "files.schema",
    "Scene": "room.scene",
    "scene_of": "room.scene",
    "Settings": "settings",
    "shoebox_room": "room.scene",
    "State": "room.scene",
    "StoreError": "base.errors",
    "Surface": "treat.question",
    "Target": "treat.question",
    "TracedRoom": "fit.traced_room",
    "treat": "treat.arrangements",
    "Treatment": "treat.arrangements",
    "with_states": "room.scene",
    "write_result": "files.results",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'roomfit' has no attribute {name!r}")
    return getattr(import_module(f"roomfit.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)


class _FrontDoor(ModuleType):
    """Importing a module of the name of a public function, as `identify`, does not hide it."""

    def __setattr__(self, name: str, value: object) -> None:
        if not (name in _HOME and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _FrontDoor
