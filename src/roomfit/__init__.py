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
    from roomfit.coverage.estimate import CoverageResult, estimate_coverage
    from roomfit.coverage.synthetic_room import CoverageSettings
    from roomfit.errors import CannotTell, InputError, NotConverged, RoomfitError, StoreError
    from roomfit.experiment_design.campaign import design_arguments
    from roomfit.experiment_design.candidates import DesignOptions
    from roomfit.experiment_design.design import Design, design
    from roomfit.findings import Finding
    from roomfit.impedance.campaign import identify_campaign_impedance
    from roomfit.impedance.data import Observed
    from roomfit.impedance.fit import WallModel
    from roomfit.impedance.identify import ImpedanceSettings, identify_impedance
    from roomfit.impedance.result import ImpedanceResult
    from roomfit.impedance.wave_model import Nuisances
    from roomfit.inversion.identify import identify
    from roomfit.io.campaign import Campaign, read_campaign
    from roomfit.io.iso3382 import read_parameters
    from roomfit.io.responses import read_response
    from roomfit.io.responses.spec import ResponseSpec
    from roomfit.io.results import read_result, write_result
    from roomfit.io.rooms import read_room
    from roomfit.io.rooms.model import PolygonSpec, RoomSpec
    from roomfit.materials.catalogue import catalogue, find_material
    from roomfit.materials.priors import Scattering, uniform_scattering
    from roomfit.prediction.campaign import predict_arguments, room_posterior
    from roomfit.prediction.changes import Change, read_change
    from roomfit.prediction.predict import Predicted, predict
    from roomfit.report.html import report_html
    from roomfit.report.text import answer_text
    from roomfit.response.energy import energy_rows, weigh
    from roomfit.results import Answer, absorption_posterior
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
    "estimate_coverage": "coverage.estimate",
    "CoverageResult": "coverage.estimate",
    "CoverageSettings": "coverage.synthetic_room",
    "read_change": "prediction.changes",
    "Change": "prediction.changes",
    "check_room": "commands",
    "design": "experiment_design.design",
    "design_arguments": "experiment_design.campaign",
    "DesignOptions": "experiment_design.candidates",
    "export_result": "commands",
    "identify": "inversion.identify",
    "identify_campaign_impedance": "impedance.campaign",
    "predict": "prediction.predict",
    "predict_arguments": "prediction.campaign",
    "room_posterior": "prediction.campaign",
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
    "ResponseSpec": "io.responses.spec",
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
    "Design": "experiment_design.design",
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
    "absorption_posterior": "results",
    "AbsorptionPosterior": "uncertainty.posterior",
    "Predicted": "prediction.predict",
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
