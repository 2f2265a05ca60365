"""roomfit: the absorption of a real room's walls from impulse responses measured in it.

The front door: what stands in `__all__` is public, everything else may move. Names are loaded when
they are first used, so that ``import roomfit`` costs nothing.

>>> import roomfit
>>> roomfit.bands_between("octave", 125, 500).centres_hz.tolist()
[125.0, 250.0, 500.0]
"""

# ruff: noqa: F401 -- imports for type checkers; `_HOME` loads the same names when they are used
from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from roomfit.air import Air, attenuation_per_m, speed_of_sound_m_s
    from roomfit.app.calibrating.calibrate import CalibrationResult, calibrate
    from roomfit.app.calibrating.settings import CalibrationSettings
    from roomfit.app.changes import Change, read_change
    from roomfit.app.check import check_room
    from roomfit.app.designing.design import design
    from roomfit.app.exporting import export_result
    from roomfit.app.gathering import campaign_scene
    from roomfit.app.identify import identify
    from roomfit.app.impedance.campaign import identify_campaign_impedance
    from roomfit.app.predicting.predict import predict_campaign
    from roomfit.bands import Bands, bands_between
    from roomfit.errors import CannotTell, InputError, NotConverged, RoomfitError, StoreError
    from roomfit.files.cache import Cache, cache_of
    from roomfit.files.campaign.campaign import Campaign, read_campaign
    from roomfit.files.parameters import read_parameters
    from roomfit.files.responses.read import read_response
    from roomfit.files.responses.spec import ResponseSpec
    from roomfit.files.result_reader import read_result
    from roomfit.files.results import write_result
    from roomfit.files.rooms.read import read_room
    from roomfit.files.rooms.spec import PolygonSpec, RoomSpec
    from roomfit.findings import Finding
    from roomfit.impedance.answer import ImpedanceAnswer
    from roomfit.impedance.choose import WallModel
    from roomfit.impedance.identify import identify_impedance
    from roomfit.impedance.model import Nuisances
    from roomfit.impedance.observed import Observed
    from roomfit.materials.absorption import Absorption
    from roomfit.materials.catalogue import catalogue, find_material
    from roomfit.materials.scattering import Scattering, uniform_scattering
    from roomfit.placement.answer import Design
    from roomfit.report.answer_text import answer_text
    from roomfit.report.html.page import report_html
    from roomfit.response.energy import weigh
    from roomfit.response.rows import energy_rows
    from roomfit.scene.room import Room
    from roomfit.scene.scene import Point, Scene
    from roomfit.signals.measured_values import MeasuredValues
    from roomfit.signals.room_parameters import room_parameters
    from roomfit.tracing.join import trace
    from roomfit.tracing.paths import Paths
    from roomfit.tracing.settings import TraceSettings
    from roomfit.uncertainty.answer import Answer
    from roomfit.uncertainty.posterior import AbsorptionPosterior
    from roomfit.uncertainty.prediction import Predicted
    from roomfit.uncertainty.smoothing import smooth_over_bands

__version__ = "0.1.0"

_HOME = {
    "Air": "air",
    "attenuation_per_m": "air",
    "speed_of_sound_m_s": "air",
    "calibrate": "app.calibrating.calibrate",
    "CalibrationResult": "app.calibrating.calibrate",
    "CalibrationSettings": "app.calibrating.settings",
    "read_change": "app.changes",
    "Change": "app.changes",
    "check_room": "app.check",
    "design": "app.designing.design",
    "export_result": "app.exporting",
    "campaign_scene": "app.gathering",
    "identify": "app.identify",
    "identify_campaign_impedance": "app.impedance.campaign",
    "predict_campaign": "app.predicting.predict",
    "Bands": "bands",
    "bands_between": "bands",
    "CannotTell": "errors",
    "InputError": "errors",
    "NotConverged": "errors",
    "RoomfitError": "errors",
    "StoreError": "errors",
    "Cache": "files.cache",
    "cache_of": "files.cache",
    "Campaign": "files.campaign.campaign",
    "read_campaign": "files.campaign.campaign",
    "read_parameters": "files.parameters",
    "read_response": "files.responses.read",
    "ResponseSpec": "files.responses.spec",
    "read_result": "files.result_reader",
    "write_result": "files.results",
    "read_room": "files.rooms.read",
    "PolygonSpec": "files.rooms.spec",
    "RoomSpec": "files.rooms.spec",
    "Finding": "findings",
    "ImpedanceAnswer": "impedance.answer",
    "WallModel": "impedance.choose",
    "identify_impedance": "impedance.identify",
    "Nuisances": "impedance.model",
    "Observed": "impedance.observed",
    "Absorption": "materials.absorption",
    "catalogue": "materials.catalogue",
    "find_material": "materials.catalogue",
    "Scattering": "materials.scattering",
    "uniform_scattering": "materials.scattering",
    "Design": "placement.answer",
    "answer_text": "report.answer_text",
    "report_html": "report.html.page",
    "weigh": "response.energy",
    "energy_rows": "response.rows",
    "Room": "scene.room",
    "Point": "scene.scene",
    "Scene": "scene.scene",
    "MeasuredValues": "signals.measured_values",
    "room_parameters": "signals.room_parameters",
    "trace": "tracing.join",
    "Paths": "tracing.paths",
    "TraceSettings": "tracing.settings",
    "Answer": "uncertainty.answer",
    "AbsorptionPosterior": "uncertainty.posterior",
    "Predicted": "uncertainty.prediction",
    "smooth_over_bands": "uncertainty.smoothing",
}

__all__ = [
    "__version__",
    *_HOME,
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'roomfit' has no attribute {name!r}")
    return getattr(import_module(f"roomfit.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
