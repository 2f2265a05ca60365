"""The inner front door: what packages beside the core, and others' programs, build on.

`roomfit` answers whole questions; here are the nouns it answers them with. Everything beside the
core (predictions, designs, coverage, treatments, ...) takes these names and no others; what is not
listed may move. Names are loaded when they are first used.

>>> from roomfit.core import Parameters, absorption_block, complete_priors, bands_between
>>> octave = bands_between("octave", 1000, 1000)
>>> Parameters((absorption_block(complete_priors(("wall",), (), octave), 0, 0.2),)).blocks[0].name
'absorption'
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    # "as" says that a name is public
    from roomfit._checks import (
        check_known as check_known,
        check_name as check_name,
        check_range as check_range,
        did_you_mean as did_you_mean,
    )
    from roomfit._numba import (
        each_in_threads as each_in_threads,
        one_blas_thread as one_blas_thread,
    )
    from roomfit.air import (
        attenuation_per_m as attenuation_per_m,
        speed_of_sound_m_s as speed_of_sound_m_s,
    )
    from roomfit.bands import Bands as Bands, bands_between as bands_between
    from roomfit.cache import (
        Cache as Cache,
        cached as cached,
        write_json_atomically as write_json_atomically,
        write_text_atomically as write_text_atomically,
    )
    from roomfit.diagnostics.remaining import (
        VOID_ANY_MEAN as VOID_ANY_MEAN,
        Remaining as Remaining,
        what_remains as what_remains,
    )
    from roomfit.diagnostics.verdict import voids_walls as voids_walls
    from roomfit.errors import (
        FolderInUseError as FolderInUseError,
        InsufficientDataError as InsufficientDataError,
        InputError as InputError,
        RoomfitError as RoomfitError,
        StoreError as StoreError,
        located as located,
    )
    from roomfit.eyring import eyring_absorption as eyring_absorption
    from roomfit.findings import About as About, Code as Code, Finding as Finding
    from roomfit.geometry.mesh import area_vectors_m2 as area_vectors_m2
    from roomfit.geometry.mesh import volume_m3 as volume_m3
    from roomfit.identification import identify as identify
    from roomfit.inversion.diffuse import (
        ERROR_SD as ERROR_SD,
        LEAST_RELATIVE_SD as LEAST_RELATIVE_SD,
        DiffuseField as DiffuseField,
        field_posterior as field_posterior,
        mean_decay as mean_decay,
    )
    from roomfit.inversion.expected import (
        ExpectedFit as ExpectedFit,
        as_coherent as as_coherent,
        expected_fit as expected_fit,
    )
    from roomfit.inversion.measurements import observe as observe
    from roomfit.inversion.symmetry import mirror_planes as mirror_planes
    from roomfit.inversion.traced_room import (
        TracedRoom as TracedRoom,
        check_scene as check_scene,
        coherent_paths as coherent_paths,
        scene_decay_s as scene_decay_s,
        trace_room as trace_room,
    )
    from roomfit.logit import Z95 as Z95, expit as expit, logit as logit
    from roomfit.materials.catalogue import (
        catalogue_prior as catalogue_prior,
        suggested_entries as suggested_entries,
    )
    from roomfit.materials.priors import (
        MaterialPrior as MaterialPrior,
        complete_priors as complete_priors,
        logit_normal as logit_normal,
        object_absorption as object_absorption,
        object_area_m2 as object_area_m2,
        prior_logit_law as prior_logit_law,
    )
    from roomfit.measurement import (
        Level as Level,
        MeasuredPair as MeasuredPair,
        Measurement as Measurement,
        Use as Use,
    )
    from roomfit.objective.observation import absorption_block as absorption_block
    from roomfit.objective.parameters import (
        Block as Block,
        Parameters as Parameters,
        leaders as leaders,
    )
    from roomfit.objective.problem import DataTerm as DataTerm, Objective as Objective
    from roomfit.objective.reduced_rows import ReducedRows as ReducedRows
    from roomfit.objective.room_parameters import model_sd as model_sd
    from roomfit.response.directivity import (
        Directivities as Directivities,
        Directivity as Directivity,
        Pattern as Pattern,
        UnknownDirectivity as UnknownDirectivity,
    )
    from roomfit.results import Result as Result, result_doubts as result_doubts
    from roomfit.scene import (
        NEAREST_PAIR_M as NEAREST_PAIR_M,
        Point as Point,
        Room as Room,
        Scene as Scene,
        check_points as check_points,
        distances_m as distances_m,
        is_clear_of_walls as is_clear_of_walls,
        material_areas_m2 as material_areas_m2,
        named_pairs as named_pairs,
        pair_names as pair_names,
        pair_states as pair_states,
        select_pairs as select_pairs,
        wall_materials as wall_materials,
        scene_of as scene_of,
    )
    from roomfit.settings import Settings as Settings
    from roomfit.signals.decay import (
        DecayCurve as DecayCurve,
        FIT_RANGES_DB as FIT_RANGES_DB,
        in_jnd as in_jnd,
        jnd_of as jnd_of,
    )
    from roomfit.signals.iso3382 import (
        MeasuredValues as MeasuredValues,
        VALUE_NAMES as VALUE_NAMES,
        ValueName as ValueName,
    )
    from roomfit.signals.response import ImpulseResponse as ImpulseResponse
    from roomfit.signals.scaling import scaled_response as scaled_response
    from roomfit.signals.speech import (
        modulation_transfer as modulation_transfer,
        room_sti as room_sti,
        room_sti_weights as room_sti_weights,
        speech_bands as speech_bands,
        speech_levels as speech_levels,
        sti_missing as sti_missing,
    )
    from roomfit.solvers.least_squares import BandFit as BandFit, fit_band as fit_band
    from roomfit.typing import (
        BoolArray as BoolArray,
        FloatArray as FloatArray,
        IntArray as IntArray,
        Progress as Progress,
        part as part,
    )
    from roomfit.uncertainty.combinations import area_shares as area_shares
    from roomfit.uncertainty.other_room import (
        common_bands as common_bands,
        room_posterior as room_posterior,
    )
    from roomfit.uncertainty.posterior import (
        AbsorptionPosterior as AbsorptionPosterior,
        draw_absorption as draw_absorption,
        draw_prior as draw_prior,
    )
    from roomfit.forks import (
        end_with_parent as end_with_parent,
        in_forks as in_forks,
        in_this_process as in_this_process,
    )


# Where each name stands.
_HOME = {
    name: module
    for module, names in {
        "_checks": "check_known check_name check_range did_you_mean",
        "_numba": "each_in_threads one_blas_thread",
        "air": "attenuation_per_m speed_of_sound_m_s",
        "bands": "Bands bands_between",
        "cache": "Cache cached write_json_atomically write_text_atomically",
        "diagnostics.remaining": "Remaining VOID_ANY_MEAN what_remains",
        "diagnostics.verdict": "voids_walls",
        "errors": "FolderInUseError InsufficientDataError InputError RoomfitError StoreError "
        "located",
        "eyring": "eyring_absorption",
        "findings": "About Code Finding",
        "geometry.mesh": "area_vectors_m2 volume_m3",
        "identification": "identify",
        "inversion.diffuse": "DiffuseField ERROR_SD LEAST_RELATIVE_SD field_posterior mean_decay",
        "inversion.expected": "ExpectedFit as_coherent expected_fit",
        "inversion.measurements": "observe",
        "inversion.symmetry": "mirror_planes",
        "inversion.traced_room": "TracedRoom check_scene coherent_paths scene_decay_s trace_room",
        "logit": "Z95 expit logit",
        "materials.catalogue": "catalogue_prior suggested_entries",
        "materials.priors": "MaterialPrior complete_priors logit_normal object_absorption "
        "object_area_m2 prior_logit_law",
        "measurement": "Level MeasuredPair Measurement Use",
        "objective.observation": "absorption_block",
        "objective.parameters": "Block Parameters leaders",
        "objective.problem": "DataTerm Objective",
        "objective.reduced_rows": "ReducedRows",
        "objective.room_parameters": "model_sd",
        "response.directivity": "Directivities Directivity Pattern UnknownDirectivity",
        "results": "Result result_doubts",
        "scene": "NEAREST_PAIR_M Point Room Scene check_points distances_m "
        "is_clear_of_walls material_areas_m2 named_pairs pair_names "
        "pair_states scene_of select_pairs wall_materials",
        "settings": "Settings",
        "signals.decay": "DecayCurve FIT_RANGES_DB in_jnd jnd_of",
        "signals.iso3382": "MeasuredValues VALUE_NAMES ValueName",
        "signals.response": "ImpulseResponse",
        "signals.scaling": "scaled_response",
        "signals.speech": "modulation_transfer room_sti room_sti_weights speech_bands "
        "speech_levels sti_missing",
        "solvers.least_squares": "BandFit fit_band",
        "typing": "BoolArray FloatArray IntArray Progress part",
        "uncertainty.combinations": "area_shares",
        "uncertainty.other_room": "common_bands room_posterior",
        "uncertainty.posterior": "AbsorptionPosterior draw_absorption draw_prior",
        "forks": "end_with_parent in_forks in_this_process",
    }.items()
    for name in names.split()
}

__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'roomfit.core' has no attribute {name!r}")
    return getattr(import_module(f"roomfit.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return list(__all__)
