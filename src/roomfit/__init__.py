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
    from roomfit.bands import Bands, bands_between
    from roomfit.cache import Cache, cache_of
    from roomfit.commands import check_room, export_result
    from roomfit.coverage.calibrate import CoverageResult, estimate_coverage
    from roomfit.coverage.truth import CoverageSettings
    from roomfit.errors import CannotTell, InputError, NotConverged, RoomfitError, StoreError
    from roomfit.experiment_design.choose import Design
    from roomfit.experiment_design.design import design
    from roomfit.findings import Finding
    from roomfit.impedance.campaign import identify_campaign_impedance
    from roomfit.impedance.data import Observed
    from roomfit.impedance.fit import WallModel
    from roomfit.impedance.identify import ImpedanceSettings, identify_impedance
    from roomfit.impedance.result import ImpedanceResult
    from roomfit.impedance.wave_model import Nuisances
    from roomfit.inversion.identify import identify
    from roomfit.inversion.measurements import campaign_scene
    from roomfit.io.campaign import Campaign, read_campaign
    from roomfit.io.iso3382 import read_parameters
    from roomfit.io.responses import read_response
    from roomfit.io.results import read_result, write_result
    from roomfit.io.rooms import read_room
    from roomfit.io.rooms.model import PolygonSpec, RoomSpec
    from roomfit.materials.catalogue import catalogue, find_material
    from roomfit.materials.priors import Scattering, uniform_scattering
    from roomfit.measurement import ResponseSpec
    from roomfit.prediction.predict import predict_campaign
    from roomfit.prediction.prediction import Predicted
    from roomfit.prediction.setup import Change, read_change
    from roomfit.report.html import report_html
    from roomfit.report.text import answer_text
    from roomfit.response.energy import energy_rows, weigh
    from roomfit.results import Answer
    from roomfit.scene import Point, Room, Scene
    from roomfit.signals.decay import room_parameters
    from roomfit.signals.iso3382 import MeasuredValues
    from roomfit.tracing.paths import Paths, TraceSettings
    from roomfit.tracing.trace import trace
    from roomfit.uncertainty.posterior import AbsorptionPosterior
    from roomfit.uncertainty.smoothing import smooth_over_bands

__version__ = "0.1.0"

_HOME = {
    "Air": "air",
    "attenuation_per_m": "air",
    "speed_of_sound_m_s": "air",
    "estimate_coverage": "coverage.calibrate",
    "CoverageResult": "coverage.calibrate",
    "CoverageSettings": "coverage.truth",
    "read_change": "prediction.setup",
    "Change": "prediction.setup",
    "check_room": "commands",
    "design": "experiment_design.design",
    "export_result": "commands",
    "campaign_scene": "inversion.measurements",
    "identify": "inversion.identify",
    "identify_campaign_impedance": "impedance.campaign",
    "predict_campaign": "prediction.predict",
    "Bands": "bands",
    "bands_between": "bands",
    "CannotTell": "errors",
    "InputError": "errors",
    "NotConverged": "errors",
    "RoomfitError": "errors",
    "StoreError": "errors",
    "Cache": "cache",
    "cache_of": "cache",
    "Campaign": "io.campaign",
    "read_campaign": "io.campaign",
    "read_parameters": "io.iso3382",
    "read_response": "io.responses",
    "ResponseSpec": "measurement",
    "read_result": "io.results",
    "write_result": "io.results",
    "read_room": "io.rooms",
    "PolygonSpec": "io.rooms.model",
    "RoomSpec": "io.rooms.model",
    "Finding": "findings",
    "ImpedanceResult": "impedance.result",
    "WallModel": "impedance.fit",
    "identify_impedance": "impedance.identify",
    "ImpedanceSettings": "impedance.identify",
    "Nuisances": "impedance.wave_model",
    "Observed": "impedance.data",
    "catalogue": "materials.catalogue",
    "find_material": "materials.catalogue",
    "Scattering": "materials.priors",
    "uniform_scattering": "materials.priors",
    "Design": "experiment_design.choose",
    "answer_text": "report.text",
    "report_html": "report.html",
    "weigh": "response.energy",
    "energy_rows": "response.energy",
    "Room": "scene",
    "Point": "scene",
    "Scene": "scene",
    "MeasuredValues": "signals.iso3382",
    "room_parameters": "signals.decay",
    "trace": "tracing.trace",
    "Paths": "tracing.paths",
    "TraceSettings": "tracing.paths",
    "Answer": "results",
    "AbsorptionPosterior": "uncertainty.posterior",
    "Predicted": "prediction.prediction",
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
