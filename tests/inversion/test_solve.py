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


def passed_on(monkeypatch, module, *, spans=None, **given):
    """Let each function of a module return its name with what it was handed, or what is given."""

    def part(progress, first, last):
        if spans is not None:
            spans.append((progress, first, last))
        return round(first, 9), round(last, 9)

    everything = {
        "in_forks": lambda function, of: [function(x) for x in of],
        "part": part,
        "material_areas_m2": lambda room: ("areas", room),
        "with_decay_errors": lambda found, areas, priors: (tuple(found), areas, priors),
        "band_directivities": lambda *arguments: arguments,
    }
    for name, function in (everything | given).items():
        monkeypatch.setattr(module, name, function)


def test_answers_by_pressures_take_energies_or_what_is_known_besides_where_there_are_none(
    monkeypatch,
):
    """Each band refined once by each model; progress runs without a gap to its end."""
    refined, spans = [], []

    def refine(own, done):
        refined.append((own, done))
        return "refined", own

    n = 4
    task = SimpleNamespace(
        scene=SimpleNamespace(room="room"), priors="priors", others="abcd", start="start",
        directivity_parameters="unknown",
    )  # fmt: skip
    bands = (None, *(SimpleNamespace(directivity=d) for d in "xyz"))
    fit = SimpleNamespace(
        state=SimpleNamespace(task=task, bands=bands), fits=(None,) * n, geometry="geometry",
        contradicted="contradicted", tests="tests",
    )  # fmt: skip
    passed_on(
        monkeypatch,
        solve,
        spans=spans,
        energy_estimates=lambda own: lambda b: None if b in (1, 3) else ("energies", own is fit, b),
        coherent_estimate=lambda own, b: ("pressures", own is fit, b) if b < 2 else None,
        inflated_by_adjacent_bands=lambda coherent, priors: [c and (c, priors) for c in coherent],
        decided=lambda own, energy, coherent: (
            energy[0], coherent[1], None if own is not fit else energy[2], None,
        ),
        without_responses=lambda *arguments: arguments,
        fitted_band=lambda *arguments: arguments,
    )  # fmt: skip
    found = solve.coherent_answers(fit, "settings", refine, "progress")
    alone = (3, ("d", "priors", 3, "start"), "priors", "settings", (0.95, 1.0))
    answers = (
        ("refined", ("energies", True, 0)),
        (("refined", ("pressures", True, 1)), "priors"),
        ("refined", ("energies", True, 2)),
        ("refined", alone),
    )
    assert found.answers == (answers, ("areas", "room"), "priors")
    assert (found.geometry, found.unknown_sources) == ("geometry", "unknown")
    assert (found.contradicted, found.tests) == ("contradicted", "tests")
    assert found.directivities == (
        task.scene, "unknown", (None, "x", "y", "z"), found.answers,
    )  # fmt: skip
    by_pressures = [(own, done) for own, done in refined if own[0] == "pressures"]
    assert [done for _, done in by_pressures] == [(0.0, 0.2), (0.2, 0.4)]
    assert all(done is None for own, done in refined if own[0] != "pressures")
    ends = [(first, last) for progress, first, last in spans if progress == "progress"]
    np.testing.assert_allclose(ends, [(0, 0.2), (0.2, 0.4), (0.4, 0.6), (0.6, 0.8), (0.95, 1)])


@pytest.mark.parametrize(
    ("against", "method", "quick", "fittable", "again"),
    [
        ((), "auto", False, True, False),
        (("S",), "auto", False, True, True),
        (("S",), "auto", True, True, False),
        (("S",), "auto", False, False, False),
        ((), "certified", False, True, False),
    ],
)
def test_bands_are_fitted_once_more_where_a_source_is_contradicted_and_can_be_fitted(
    monkeypatch, against, method, quick, fittable, again
):
    measured = SimpleNamespace(bands=(1, 2), scene=SimpleNamespace(room="room"))
    seen, spans = [], []

    def directed(*arguments):
        seen.append(arguments)
        return arguments[-1]

    def fitted(band, objective, priors, settings, done, shared):
        assert (priors, shared) == ("priors", "shared") and settings.method == method
        return SimpleNamespace(objective=None if band else objective, fit="fit", done=done)

    passed_on(
        monkeypatch,
        solve,
        spans=spans,
        directivity_parameters=lambda *_: None,
        omnidirectional=lambda _: "tested",
        directed_energies=directed,
        energy_objectives=lambda *arguments: lambda band: (band, arguments[-1]),
        source_scorer=lambda _m, traced, tested: lambda *own: (traced, tested, own),
        shared_error_covariance=lambda *_: "shared",
        fitted_band=fitted,
        contradicted_sources=lambda tested, scores: (
            against if scores and tested == "tested" else ()
        ),
        is_fittable=lambda *_: fittable,
        with_fitted_sources=lambda unknown, tested: (unknown, "fitted", tested),
        band_directivities=lambda _s, unknown, own, _e: (unknown, own),
    )
    settings = Settings(method=method, quick=quick)
    found = solve.estimate_energies(
        measured, "priors", "traced", "start", settings, lambda own, _: own.done, "progress"
    )
    assert [arguments[-1] for arguments in seen] == [None, (None, "fitted", "tested")][: 1 + again]
    assert all(a[:-1] == (measured, "priors", "traced", "start") for a in seen)
    unknown = (None, "fitted", "tested") if again else None
    assert found.unknown_sources == unknown and found.directivities == (unknown, unknown)
    assert found.contradicted == against
    assert found.answers == (((0.0, 0.5), (0.5, 1.0)), ("areas", "room"), "priors")


@pytest.mark.parametrize(
    ("apart", "model", "given", "answer"),
    [
        (1.99, "auto", "ec", "both c e"), (2.0, "auto", "ec", "c"), (0.0, "auto", "", None),
        (-1.99, "auto", "ec", "both e c"), (-2.0, "auto", "ec", "e"), (9.0, "auto", "e", "e"),
        (-9.0, "coherent", "ec", "c"), (-9.0, "auto", "c", "c"), (0.0, "auto", "ec", "both e c"),
    ],
)  # fmt: skip
def test_the_answer_is_that_of_larger_evidence_with_both_intervals_where_that_is_not_clear(
    monkeypatch, apart, model, given, answer
):
    monkeypatch.setattr(solve, "with_both_intervals", lambda a, b: f"both {a} {b}")
    energy, coherent_ = ("e" if "e" in given else None), ("c" if "c" in given else None)
    options = SimpleNamespace(model=model)
    found = solve._decided(energy, coherent_, np.array([100.0, 100.0 + apart]), options)
    assert found == answer


def test_few_responses_stand_for_all_and_fall_in_two_bands_alone():
    """Every n-th, so that eight remain at most; pairs are counted anew."""
    scene = roomfit.scene_of(
        roomfit.shoebox_room((6.0, 5.0, 3.0), "wall"),
        {"S": (1.5, 1.2, 1.5)},
        {f"R{i}": (4.0, 0.5 + 0.2 * i, 1.2) for i in range(20)},
    )

    @dataclass(frozen=True)
    class Noise:
        tail_time_constant_s: object

    @dataclass(frozen=True)
    class Heard:
        pair: int
        noise: Noise
        measurement: object

    @dataclass(frozen=True)
    class Everything:
        scene: object
        responses: object
        values: object

    def heard(pair, use="fit"):
        return Heard(pair, Noise(np.array([1.0, 2.0, 3.0])), SimpleNamespace(use=use))

    for n, step in ((1, 1), (8, 1), (9, 2), (16, 2), (17, 3)):
        given = (heard(19, "validate"), *(heard(i) for i in range(n)))
        found = solve._few(Everything(scene, given, ("values",)), np.array([True, False, True]))
        assert [r.pair for r in found.responses] == list(range(len(range(0, n, step))))
        names = [p.name for p in found.scene.receivers]
        assert len(found.scene.pairs) == len(found.responses) <= 8
        of_pair = [names[r] for _, r in found.scene.pairs]
        assert of_pair == [f"R{i}" for i in range(0, n, step)] and found.values == ()
        np.testing.assert_array_equal(found.responses[0].noise.tail_time_constant_s, [1, 0, 3])


def test_errors_that_windows_share_are_those_of_the_files_and_sources_of_a_band(monkeypatch):
    """Each source by its own number in the scene; what has no windows stays as it is."""
    scene = SimpleNamespace(room="room", air="air", pairs=np.array([[3, 0], [1, 2], [2, 1]]))
    measured = SimpleNamespace(scene=scene, bands="bands", responses="responses")
    traced = SimpleNamespace(paths="paths", scattering="s", scattering_sd="sd")
    files = [SimpleNamespace(pair=p) for p in (2, 0)]
    passed_on(
        monkeypatch,
        solve,
        fitted_in_band=lambda responses, band: (
            files if (responses, band) == ("responses", 5) else []
        ),
        physical_values=lambda parameters, vector: (
            {"absorption": (parameters, vector.size)},
            None,
        ),
        relative_errors=lambda *arguments: ("relative", *arguments),
        shared_errors=lambda *arguments: ("shared", *arguments),
        with_shared_errors=lambda *arguments, areas_m2: ("with", *arguments, areas_m2),
    )
    fit = SimpleNamespace(vector=np.zeros(4))
    objective = SimpleNamespace(as_energies=lambda _: "windows", parameters="parameters")
    add = solve.shared_error_covariance(measured, traced)
    walls = ("parameters", 4)
    relative = ("relative", "air", "bands", "windows", "paths", walls, ("s", "sd"))
    shared = ("shared", objective, fit, [2, 3], relative)
    assert add(5, objective, fit) == ("with", objective, fit, shared, ("areas", "room"))
    alone = SimpleNamespace(as_energies=lambda _: None, parameters="parameters")
    assert add(5, alone, fit) is fit
    nothing = SimpleNamespace(vector=np.zeros(0))
    assert add(5, objective, nothing) is nothing


def test_the_speed_of_sound_is_as_uncertain_as_the_settings_or_the_temperature_say():
    air = roomfit.Air(temperature_c=20.0)
    assert solve.prior_speed_sd(air, Settings(speed_of_sound_sd=0.02)) == 0.02
    found = solve.prior_speed_sd(air, Settings(temperature_sd_c=2.0))
    assert found == pytest.approx(2.0 / (2.0 * 293.15))
    assert solve.prior_speed_sd(air, Settings(temperature_sd_c=0.0)) == 1e-6
