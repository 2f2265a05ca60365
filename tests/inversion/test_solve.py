"""What the settings of a user become in a fit of pressures."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

import roomfit
from roomfit.bands import bands_between
from roomfit.inversion import coherent, directivity, solve
from roomfit.inversion.sequential import CoherentOptions
from roomfit.inversion.solve import coherent_task
from roomfit.response.directivity import UnknownDirectivity
from roomfit.settings import Settings

BANDS = bands_between("octave", 500, 1000)


def task_of(settings: Settings, **measured):
    scene = roomfit.scene_of(
        roomfit.shoebox_room((6.0, 5.0, 3.0), {}),
        {"S": (1.5, 1.2, 1.5), "T": (4.5, 1.2, 1.5)},
        {"R": (4.0, 3.5, 1.2)},
    )
    all_of_it = {"responses": (), "values": (), "directivities": {}, **measured}
    found = SimpleNamespace(scene=scene, bands=BANDS, **all_of_it)
    traced = SimpleNamespace(fit_until_s=0.7, scattering=None, scattering_sd=None, binned=None)
    return coherent_task(found, (), traced, np.zeros(2), settings)


@pytest.mark.parametrize(
    ("settings", "options"),
    [
        ({"positions": "fixed"}, {"positions": "fixed"}),
        ({"positions": "fit"}, {"positions": "fit"}),
        ({"model": "coherent"}, {"model": "coherent"}),
        ({"model": "auto"}, {"model": "auto"}),
        ({"reflection_delays": False}, {"delays": False}),
        ({"coherent_until_s": 0.13}, {"end_s": 0.13}),
        ({"speed_of_sound_sd": 0.004}, {"speed_sd": 0.004}),
        ({"max_rounds": 7}, {"max_rounds": 7}),
        ({"quick": True}, {"quick": True}),
    ],
)
def test_each_setting_changes_the_option_it_is_of_and_no_other(settings, options):
    usual = Settings()
    own = {
        "positions": "fit", "delays": True, "model": "auto", "end_s": usual.coherent_until_s,
        "late_end_s": 0.7, "speed_sd": usual.speed_of_sound_sd, "max_rounds": usual.max_rounds,
        "quick": False,
    }  # fmt: skip
    assert task_of(Settings(**settings)).settings == CoherentOptions(**{**own, **options})


def test_a_source_is_fitted_tested_or_taken_as_it_is_specified():
    """One without a directivity is tested for one, unless another is unknown and fitted."""
    bare = task_of(Settings())
    assert bare.directivity_parameters is None and bare.tested_sources.sources == ("S", "T")
    fitted = task_of(Settings(), directivities={"S": UnknownDirectivity()})
    assert fitted.tested_sources is None and fitted.directivity_parameters.sources == ("S",)
    known = task_of(Settings(), directivities={"S": SimpleNamespace()})
    assert known.directivity_parameters is None and known.tested_sources.sources == ("T",)


@pytest.mark.parametrize(
    ("method", "values", "fits"),
    [("auto", (), True), ("annealing", (), False), ("auto", ("table",), False)],
)
def test_what_contradicts_an_omnidirectional_source_is_fitted_to_responses_alone(
    monkeypatch, method, values, fits
):
    """By least squares, and where no room parameters are fitted as well."""
    monkeypatch.setattr("roomfit.inversion.solve.value_terms", lambda *_: [None, None])
    task = task_of(Settings(method=method), values=values)
    assert task.fits_contradicted is fits and task.others == ((), ())


def test_evidence_is_compared_where_a_band_was_fitted_both_ways(monkeypatch):
    """Not in bands without data, nor in those that were fitted by energies alone."""
    monkeypatch.setattr(coherent, "log_evidences", lambda own, fit: (own, fit))
    state = SimpleNamespace(bands=(1.0, None, 2.0, 3.0))
    found = coherent._log_evidences(state, (None, None, 5.0, 6.0))
    np.testing.assert_array_equal(found, [[np.nan] * 2, [np.nan] * 2, [2.0, 5.0], [3.0, 6.0]])


def test_directivities_of_energies_are_those_of_the_files_that_are_fitted(monkeypatch):
    """Band by band, each with its own windows; a band without data has none, and no fit."""
    measured = SimpleNamespace(scene="scene", bands=BANDS, responses=("one", "two", "three"))
    traced = SimpleNamespace(paths="paths", binned="binned")
    given = {
        "row_bases": lambda *arguments: arguments,
        "energy_terms": lambda *_: [None, ("term", "parameters")],
        "fitted_in_band": lambda responses, band: responses[: band + 1],
        "directed_band": lambda *arguments: arguments,
        "energy_objective": lambda *arguments: arguments,
        "fit_band": lambda objective: ("fit", *objective),
        "directivities_under_cavity_priors": lambda *arguments: arguments,
    }
    for name, function in given.items():
        monkeypatch.setattr(directivity, name, function)
    made = directivity.directed_energies(measured, (), traced, np.zeros(2), "unknown")
    bases = ("unknown", "scene", "paths", "binned")
    own = ("unknown", "scene", bases, "term", ("one", "two"))
    assert made == ("unknown", BANDS, [None, own], [None, ("fit", "term", "parameters", own)])
    assert directivity.directed_energies(measured, (), traced, np.zeros(2), None) == (None, None)


@pytest.mark.parametrize(
    ("positions", "mean", "moved"),
    [("fit", "there", True), ("fixed", "there", False), ("fit", None, False)],
)
def test_paths_are_traced_anew_from_where_low_bands_have_found_the_positions(
    monkeypatch, positions, mean, moved
):
    """Where positions are fitted and some band has determined them."""
    options = SimpleNamespace(late_end_s=0.5, model="auto", positions=positions, quick=False)
    task = SimpleNamespace(
        settings=options, measured=(), directivity_parameters="some", scene="scene", bands=BANDS
    )
    own = tuple(SimpleNamespace(coherent=SimpleNamespace(geometry="geometry")) for _ in range(2))
    found = None if mean is None else SimpleNamespace(mean=mean)
    given = {
        "cut_at": lambda binned, end_s: (binned, end_s),
        "rebuild": lambda state: replace(state, bands=own),
        "release": lambda state: state,
        "forward_pass": lambda *_: [None, SimpleNamespace(found=found)],
        "current_absorption": lambda *_: "absorption",
        "moved_scene": lambda *asked: (asked, "origin"),
        "_vectors": lambda _: ("first",),
    }
    for name, function in given.items():
        monkeypatch.setattr(coherent, name, function)
    traced = SimpleNamespace(
        again=lambda place: ("moved paths", "moved weights", place),
        paths="paths",
        factors="weights",
        binned="binned",
    )
    state = coherent.initialise(task, traced)
    at = (state.paths, state.weights, state.binned, state.origin)
    place = ("scene", "geometry", mean)
    assert at == (
        ("moved paths", "moved weights", (place, 0.5), "origin")
        if moved
        else ("paths", "weights", ("binned", 0.5), None)
    )
    assert state.first == (("first",) if positions == "fit" else ())


@dataclass
class Traced:
    far_images: bool
    again: object = "again"


@pytest.mark.parametrize(
    ("given", "chosen"),
    [
        # by how much pressures are likelier at 250 Hz and at 1 kHz
        ({"gains": (3.0, 1.0)}, "auto"),
        ({"gains": (-3.0, 1.0)}, "auto"),
        ({"gains": (3.0, -1.9)}, "auto"),
        ({"gains": (3.0, -2.0)}, "energy"),
        ({"gains": (-1.0, -1.0)}, "energy"),
        ({"gains": (3.0, -5.0), "scale": 1.1}, "auto"),
        ({"gains": (-3.0, -5.0), "scale": 1.1}, "energy"),
        ({"gains": (3.0, -5.0), "model": "coherent"}, "coherent"),
        ({"gains": (3.0, -5.0), "is_coherent": False}, "auto"),
        ({"gains": (3.0, -5.0), "far": False}, "auto"),
        ({"gains": (3.0, -5.0), "without": (1, "data")}, "auto"),
        ({"gains": (3.0, 5.0), "without": (3, "fit")}, "energy"),
        ({"gains": (3.0, -5.0), "bands_hz": (1000, 4000)}, "auto"),
    ],
)
def test_few_responses_choose_energies_where_they_contradict_pressures(monkeypatch, given, chosen):
    """Two bands decide, where the settings leave it open and there is anything to go by."""
    bands = bands_between("octave", *given.get("bands_hz", (125, 4000)))
    missing, what = given.get("without", (None, None))
    n = len(bands)
    state = SimpleNamespace(
        bands=[None if what == "data" and b == missing else b for b in range(n)]
    )
    fits = [None if what == "fit" and b == missing else b for b in range(n)]
    scale = given.get("scale", 1.0)
    functions = {
        "is_coherent": lambda *_: given.get("is_coherent", True),
        "_few": lambda _, chosen: np.flatnonzero(chosen).tolist(),
        "traced_paths": lambda *_: Traced(given.get("far", True)),
        "coherent_task": lambda few, *_: SimpleNamespace(few=few, settings="settings"),
        "initialise": lambda task, traced: (task.few, traced.again),
        "with_sources_examined": lambda found, _: state if found == ([1, 3], None) else found,
        "forward_pass": lambda *_: fits,
        "log_evidences": lambda own, _: (7.0, 7.0 + given["gains"][{1: 0, 3: 1}[own]]),
        "contradicted_position_sd_scale": lambda *_: scale,
    }
    for name, function in functions.items():
        monkeypatch.setattr(solve, name, function)
    measured = SimpleNamespace(bands=bands, responses=())
    settings = Settings(model=given.get("model", "auto"))
    assert solve.chosen_model(measured, (), np.zeros(n), settings) == chosen


@pytest.mark.parametrize("model", ["auto", "coherent"])
def test_bands_that_contradict_pressures_have_no_fit_by_them_where_the_model_is_chosen(
    monkeypatch, model
):
    state = SimpleNamespace(bands=["a", "b"], task=SimpleNamespace(settings=Settings(model=model)))
    fits = ["fit of a", None]
    for contradicted in (False, True):
        monkeypatch.setattr(
            coherent, "contradicts_geometry", lambda *given, c=contradicted: c and given[1] is fits
        )
        chosen_otherwise = contradicted and model == "auto"
        expected = [None, None] if chosen_otherwise else fits
        assert coherent._uncontradicted(state, fits) == expected
