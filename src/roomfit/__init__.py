"""roomfit: the absorption of a real room's walls from impulse responses measured in it.

The front door: what stands in `__all__` is public, everything else may move. Names are loaded when
they are first used, so that ``import roomfit`` costs nothing.

>>> import roomfit
>>> roomfit.bands_between("octave", 125, 500).centres_hz.tolist()
[125.0, 250.0, 500.0]
"""

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
    from roomfit.findings import Code, Finding
    from roomfit.impedance.data import Observed
    from roomfit.impedance.fit import WallModel
    from roomfit.impedance.identify import ImpedanceSettings, identify_impedance
    from roomfit.impedance.result import ImpedanceResult
    from roomfit.impedance.wave_model import Nuisances
    from roomfit.inversion.identify import identify
    from roomfit.io.campaign import Campaign, read_campaign
    from roomfit.io.inputs import load_campaign
    from roomfit.io.iso3382 import read_parameters
    from roomfit.io.responses import read_response
    from roomfit.io.responses.spec import ResponseSpec
    from roomfit.io.results import read_result, write_result
    from roomfit.io.rooms import read_room
    from roomfit.io.rooms.model import PolygonSpec, RoomSpec
    from roomfit.materials.catalogue import catalogue, find_material, material_prior
    from roomfit.materials.priors import MaterialPrior, Scattering, uniform_scattering
    from roomfit.measurement import Measurement
    from roomfit.prediction.campaign import predict_arguments, room_posterior
    from roomfit.prediction.changes import Change, read_change
    from roomfit.prediction.predict import Predicted, predict
    from roomfit.report.html import report_html
    from roomfit.response.directivity import UnknownDirectivity
    from roomfit.response.energy import energy_rows, weigh
    from roomfit.results import Result, absorption_posterior
    from roomfit.scene import Point, Room, Scene, scene_of, shoebox_room
    from roomfit.settings import Settings
    from roomfit.signals.decay import room_parameters
    from roomfit.signals.iso3382 import MeasuredValues
    from roomfit.tracing.paths import Paths, TraceSettings
    from roomfit.tracing.trace import trace
    from roomfit.uncertainty.posterior import AbsorptionPosterior
    from roomfit.uncertainty.smoothing import smooth_over_bands

__version__ = "0.1.0"

__all__ = [
    "AbsorptionPosterior",
    "Air",
    "Bands",
    "Cache",
    "Campaign",
    "CannotTell",
    "Change",
    "Code",
    "CoverageResult",
    "CoverageSettings",
    "Design",
    "DesignOptions",
    "Finding",
    "ImpedanceResult",
    "ImpedanceSettings",
    "InputError",
    "MaterialPrior",
    "MeasuredValues",
    "Measurement",
    "NotConverged",
    "Nuisances",
    "Observed",
    "Paths",
    "Point",
    "PolygonSpec",
    "Predicted",
    "ResponseSpec",
    "Result",
    "Room",
    "RoomSpec",
    "RoomfitError",
    "Scattering",
    "Scene",
    "Settings",
    "StoreError",
    "TraceSettings",
    "UnknownDirectivity",
    "WallModel",
    "__version__",
    "absorption_posterior",
    "attenuation_per_m",
    "bands_between",
    "cache_of",
    "catalogue",
    "check_room",
    "design",
    "design_arguments",
    "energy_rows",
    "estimate_coverage",
    "export_result",
    "find_material",
    "identify",
    "identify_impedance",
    "load_campaign",
    "material_prior",
    "predict",
    "predict_arguments",
    "read_campaign",
    "read_change",
    "read_parameters",
    "read_response",
    "read_result",
    "read_room",
    "report_html",
    "room_parameters",
    "room_posterior",
    "scene_of",
    "shoebox_room",
    "smooth_over_bands",
    "speed_of_sound_m_s",
    "trace",
    "uniform_scattering",
    "weigh",
    "write_result",
]

# Where each name stands: what type checkers read above, for use.
_HOME = {
    "absorption_posterior": "results",
    "AbsorptionPosterior": "uncertainty.posterior",
    "Air": "air",
    "attenuation_per_m": "air",
    "Bands": "bands",
    "bands_between": "bands",
    "Cache": "cache",
    "cache_of": "cache",
    "Campaign": "io.campaign",
    "CannotTell": "errors",
    "catalogue": "materials.catalogue",
    "Change": "prediction.changes",
    "check_room": "commands",
    "Code": "findings",
    "CoverageResult": "coverage.estimate",
    "CoverageSettings": "coverage.synthetic_room",
    "design": "experiment_design.design",
    "Design": "experiment_design.design",
    "design_arguments": "experiment_design.campaign",
    "DesignOptions": "experiment_design.candidates",
    "energy_rows": "response.energy",
    "estimate_coverage": "coverage.estimate",
    "export_result": "commands",
    "find_material": "materials.catalogue",
    "Finding": "findings",
    "identify": "inversion.identify",
    "identify_impedance": "impedance.identify",
    "ImpedanceResult": "impedance.result",
    "ImpedanceSettings": "impedance.identify",
    "InputError": "errors",
    "load_campaign": "io.inputs",
    "material_prior": "materials.catalogue",
    "MaterialPrior": "materials.priors",
    "MeasuredValues": "signals.iso3382",
    "Measurement": "measurement",
    "NotConverged": "errors",
    "Nuisances": "impedance.wave_model",
    "Observed": "impedance.data",
    "Paths": "tracing.paths",
    "Point": "scene",
    "PolygonSpec": "io.rooms.model",
    "predict": "prediction.predict",
    "predict_arguments": "prediction.campaign",
    "Predicted": "prediction.predict",
    "read_campaign": "io.campaign",
    "read_change": "prediction.changes",
    "read_parameters": "io.iso3382",
    "read_response": "io.responses",
    "read_result": "io.results",
    "read_room": "io.rooms",
    "report_html": "report.html",
    "ResponseSpec": "io.responses.spec",
    "Result": "results",
    "Room": "scene",
    "room_parameters": "signals.decay",
    "room_posterior": "prediction.campaign",
    "RoomfitError": "errors",
    "RoomSpec": "io.rooms.model",
    "Scattering": "materials.priors",
    "Scene": "scene",
    "scene_of": "scene",
    "Settings": "settings",
    "shoebox_room": "scene",
    "smooth_over_bands": "uncertainty.smoothing",
    "speed_of_sound_m_s": "air",
    "StoreError": "errors",
    "trace": "tracing.trace",
    "TraceSettings": "tracing.paths",
    "uniform_scattering": "materials.priors",
    "UnknownDirectivity": "response.directivity",
    "WallModel": "impedance.fit",
    "weigh": "response.energy",
    "write_result": "io.results",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'roomfit' has no attribute {name!r}")
    return getattr(import_module(f"roomfit.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
