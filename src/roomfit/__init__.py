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
    from roomfit.base.findings import Finding
    from roomfit.checks.usable import check_recordings
    from roomfit.cli.export import export_result
    from roomfit.design.campaign import design_arguments
    from roomfit.design.candidates import DesignOptions
    from roomfit.design.positions import design
    from roomfit.files.campaign import read_campaign
    from roomfit.files.inputs import load_campaign
    from roomfit.files.iso3382 import read_parameters
    from roomfit.files.responses import read_response
    from roomfit.files.responses.recordings import ResponseSpec
    from roomfit.files.results import read_result, write_result
    from roomfit.files.rooms import read_room
    from roomfit.files.rooms.model import RoomSpec
    from roomfit.identify import identify
    from roomfit.impedance.data import Observed
    from roomfit.impedance.identify import ImpedanceSettings, identify_impedance
    from roomfit.materials.catalogue import material_prior
    from roomfit.predict.campaign import predict_arguments
    from roomfit.predict.other_walls import predict
    from roomfit.report.answer import report_html
    from roomfit.result import Result, absorption_posterior
    from roomfit.room.scene import Point, scene_of, shoebox_room, with_states
    from roomfit.settings import Settings
    from roomfit.signals.iso3382 import MeasuredValues
    from roomfit.signals.measurement import Measurement

__version__ = "0.1.0"

__all__ = [
    "Air",
    "Bands",
    "DesignOptions",
    "Finding",
    "ImpedanceSettings",
    "InputError",
    "InsufficientDataError",
    "MeasuredValues",
    "Measurement",
    "Observed",
    "Point",
    "ResponseSpec",
    "Result",
    "RoomSpec",
    "RoomfitError",
    "Settings",
    "StoreError",
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
    "predict_arguments",
    "read_campaign",
    "read_parameters",
    "read_response",
    "read_result",
    "read_room",
    "report_html",
    "scene_of",
    "shoebox_room",
    "with_states",
    "write_result",
]

# Where each name stands: what type checkers read above, for use.
_HOME = {
    "absorption_posterior": "result",
    "Air": "base.air",
    "Bands": "base.bands",
    "bands_between": "base.bands",
    "InsufficientDataError": "base.errors",
    "design": "design.positions",
    "design_arguments": "design.campaign",
    "DesignOptions": "design.candidates",
    "export_result": "cli.export",
    "Finding": "base.findings",
    "identify": "identify",
    "check_recordings": "checks.usable",
    "identify_impedance": "impedance.identify",
    "ImpedanceSettings": "impedance.identify",
    "InputError": "base.errors",
    "load_campaign": "files.inputs",
    "material_prior": "materials.catalogue",
    "MeasuredValues": "signals.iso3382",
    "Measurement": "signals.measurement",
    "Observed": "impedance.data",
    "Point": "room.scene",
    "predict": "predict.other_walls",
    "predict_arguments": "predict.campaign",
    "read_campaign": "files.campaign",
    "read_parameters": "files.iso3382",
    "read_response": "files.responses",
    "read_result": "files.results",
    "read_room": "files.rooms",
    "report_html": "report.answer",
    "ResponseSpec": "files.responses.recordings",
    "Result": "result",
    "RoomfitError": "base.errors",
    "RoomSpec": "files.rooms.model",
    "scene_of": "room.scene",
    "Settings": "settings",
    "shoebox_room": "room.scene",
    "with_states": "room.scene",
    "StoreError": "base.errors",
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
