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
    from roomfit.air import Air
    from roomfit.bands import Bands, bands_between
    from roomfit.commands import export_result
    from roomfit.coverage.estimate import estimate_coverage
    from roomfit.coverage.synthetic_room import CoverageSettings
    from roomfit.diagnostics.usable import check_recordings
    from roomfit.errors import InputError, InsufficientDataError, RoomfitError, StoreError
    from roomfit.experiment_design.campaign import design_arguments
    from roomfit.experiment_design.candidates import DesignOptions
    from roomfit.experiment_design.design import design
    from roomfit.findings import Finding
    from roomfit.identification import identify
    from roomfit.impedance.data import Observed
    from roomfit.impedance.identify import ImpedanceSettings, identify_impedance
    from roomfit.io.campaign import read_campaign
    from roomfit.io.inputs import load_campaign
    from roomfit.io.iso3382 import read_parameters
    from roomfit.io.responses import read_response
    from roomfit.io.responses.recordings import ResponseSpec
    from roomfit.io.results import read_result, write_result
    from roomfit.io.rooms import read_room
    from roomfit.io.rooms.model import RoomSpec
    from roomfit.materials.catalogue import material_prior
    from roomfit.measurement import Measurement
    from roomfit.prediction.campaign import predict_arguments
    from roomfit.prediction.predict import predict
    from roomfit.report.html import report_html
    from roomfit.results import Result, absorption_posterior
    from roomfit.scene import Point, scene_of, shoebox_room, with_states
    from roomfit.settings import Settings
    from roomfit.signals.iso3382 import MeasuredValues

__version__ = "0.1.0"

__all__ = [
    "Air",
    "Bands",
    "CoverageSettings",
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
    "estimate_coverage",
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
    "absorption_posterior": "results",
    "Air": "air",
    "Bands": "bands",
    "bands_between": "bands",
    "InsufficientDataError": "errors",
    "CoverageSettings": "coverage.synthetic_room",
    "design": "experiment_design.design",
    "design_arguments": "experiment_design.campaign",
    "DesignOptions": "experiment_design.candidates",
    "estimate_coverage": "coverage.estimate",
    "export_result": "commands",
    "Finding": "findings",
    "identify": "identification",
    "check_recordings": "diagnostics.usable",
    "identify_impedance": "impedance.identify",
    "ImpedanceSettings": "impedance.identify",
    "InputError": "errors",
    "load_campaign": "io.inputs",
    "material_prior": "materials.catalogue",
    "MeasuredValues": "signals.iso3382",
    "Measurement": "measurement",
    "Observed": "impedance.data",
    "Point": "scene",
    "predict": "prediction.predict",
    "predict_arguments": "prediction.campaign",
    "read_campaign": "io.campaign",
    "read_parameters": "io.iso3382",
    "read_response": "io.responses",
    "read_result": "io.results",
    "read_room": "io.rooms",
    "report_html": "report.html",
    "ResponseSpec": "io.responses.recordings",
    "Result": "results",
    "RoomfitError": "errors",
    "RoomSpec": "io.rooms.model",
    "scene_of": "scene",
    "Settings": "settings",
    "shoebox_room": "scene",
    "with_states": "scene",
    "StoreError": "errors",
    "write_result": "io.results",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'roomfit' has no attribute {name!r}")
    return getattr(import_module(f"roomfit.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
