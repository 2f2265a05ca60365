"""roomfit: the absorption of a real room's walls from impulse responses measured in it.

The front door: what stands in `__all__` is public, everything else may move. Names are loaded when
they are first used, so that ``import roomfit`` costs nothing.

>>> import roomfit
>>> roomfit.bands_between("octave", 125, 500).centres_hz.tolist()
[125.0, 250.0, 500.0]
"""

from __future__ import annotations

import ast
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from roomfit.base.air import Air as Air
    from roomfit.base.bands import Bands as Bands, bands_between as bands_between
    from roomfit.base.errors import (
        InputError as InputError,
        InsufficientDataError as InsufficientDataError,
        RoomfitError as RoomfitError,
        StoreError as StoreError,
    )
    from roomfit.base.findings import About as About, Code as Code, Finding as Finding
    from roomfit.checks.usable import check_recordings as check_recordings
    from roomfit.cli.export import export_result as export_result
    from roomfit.design.campaign import design_arguments as design_arguments
    from roomfit.design.candidates import DesignOptions as DesignOptions
    from roomfit.design.positions import Design as Design, design as design
    from roomfit.files.campaign import read_campaign as read_campaign
    from roomfit.files.inputs import load_campaign as load_campaign
    from roomfit.files.questions import question_of as question_of
    from roomfit.files.responses import read_response as read_response
    from roomfit.files.results import read_result as read_result, write_result as write_result
    from roomfit.files.rooms import read_room as read_room
    from roomfit.files.schema import ResponseSpec as ResponseSpec, RoomSpec as RoomSpec
    from roomfit.files.values import read_parameters as read_parameters
    from roomfit.fit.traced_room import TracedRoom as TracedRoom
    from roomfit.identify import identify as identify
    from roomfit.impedance.data import Observed as Observed
    from roomfit.impedance.identify import (
        ImpedanceSettings as ImpedanceSettings,
        identify_impedance as identify_impedance,
    )
    from roomfit.materials.catalogue import material_prior as material_prior
    from roomfit.materials.priors import MaterialPrior as MaterialPrior
    from roomfit.model.parameters import Parameters as Parameters
    from roomfit.model.problem import DataTerm as DataTerm, Objective as Objective
    from roomfit.predict.changes import Change as Change, read_change as read_change
    from roomfit.predict.diffuse_field import DiffuseField as DiffuseField
    from roomfit.predict.predict import (
        predict as predict,
        predict_change as predict_change,
        prepare as prepare,
    )
    from roomfit.predict.prediction import Predicted as Predicted
    from roomfit.predict.question import Question as Question
    from roomfit.report.answer import report_html as report_html
    from roomfit.result import Result as Result, absorption_posterior as absorption_posterior
    from roomfit.room.scene import (
        Point as Point,
        Room as Room,
        RoomObject as RoomObject,
        Scene as Scene,
        State as State,
        scene_of as scene_of,
        shoebox_room as shoebox_room,
        with_states as with_states,
    )
    from roomfit.settings import Settings as Settings
    from roomfit.signals.iso3382 import MeasuredValues as MeasuredValues
    from roomfit.signals.measurement import Measurement as Measurement
    from roomfit.treat.arrangements import Treatment as Treatment, treat as treat
    from roomfit.treat.question import Product as Product, Surface as Surface, Target as Target
    from roomfit.uncertainty.posterior import AbsorptionPosterior as AbsorptionPosterior

__version__ = "0.1.0"

# What type checkers read above, for use: where each name stands.
_PUBLIC = next(
    node for node in ast.parse(Path(__file__).read_text("utf-8")).body if isinstance(node, ast.If)
)
_HOME = {
    alias.name: str(statement.module)
    for statement in _PUBLIC.body
    if isinstance(statement, ast.ImportFrom)
    for alias in statement.names
}

__all__ = sorted(["__version__", *_HOME])


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'roomfit' has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return list(__all__)


class _FrontDoor(ModuleType):
    """Importing a module of the name of a public function, as `identify`, does not hide it."""

    def __setattr__(self, name: str, value: object) -> None:
        if not (name in _HOME and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _FrontDoor
