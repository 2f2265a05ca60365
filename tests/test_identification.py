"""In which order a room is traced, fitted and examined, and what each step is handed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from roomfit import identification
from roomfit.errors import InputError
from roomfit.scene import PointGroup, scene_of, shoebox_room
from roomfit.settings import Settings


def patched(monkeypatch, spans=None, **given):
    """Replace functions of the module; parts of the progress are noted and are their ends."""

    def part(_progress, first, last):
        if spans is not None:
            spans.append((first, last))
        return first, last

    for name, function in ({"part": part} | given).items():
        monkeypatch.setattr(identification, name, function)


def test_a_group_of_positions_that_are_nobodys_is_refused_before_anything_is_done():
    here, there = {"S": (1.0, 1.0, 1.0)}, {"R1": (2.0, 1.5, 1.0)}
    group = PointGroup("array", ("R1", "P*"), 0.05)
    scene = replace(scene_of(shoebox_room((4.0, 3.0, 2.5), "a"), here, there), groups=(group,))
    with pytest.raises(InputError, match="names neither a source nor a receiver") as refused:
        identification.identify(scene, [])
    assert "'P*'" in str(refused.value) and "S, R1" in str(refused.value)


@pytest.mark.parametrize("quick", [False, True])
@pytest.mark.parametrize(
    ("can_be", "far_images", "model", "by_pressures"),
    [
        (True, True, "auto", True), (True, False, "auto", False), (True, False, "coherent", True),
        (False, True, "coherent", False), (False, True, "auto", False),
    ],
)  # fmt: skip
def test_pressures_are_fitted_where_they_can_be_and_images_reach_far_or_they_were_asked_for(
    monkeypatch, quick, can_be, far_images, model, by_pressures
):
    spans = []

    @dataclass(frozen=True)
    class Fits:
        answers: object
        surfaces: object = ()

    patched(
        monkeypatch,
        spans,
        eyring_start=lambda _: "start",
        is_coherent=lambda responses, _: can_be and responses == "responses",
        _refinement=lambda *arguments: ("refine", *arguments),
        estimate_energies=lambda *arguments: ("energies", *arguments),
        coherent_task=lambda *arguments: ("task", *arguments),
        initialise=lambda *arguments: ("state", *arguments),
        fit_coherent=lambda *arguments: ("coherent", *arguments),
        surface_scores=lambda coherent: ("scores", coherent),
        coherent_answers=lambda *arguments: Fits(arguments),
    )
    measured = SimpleNamespace(responses="responses")
    traced = SimpleNamespace(far_images=far_images)
    settings = Settings(model=model, quick=quick)
    found = identification._fits(measured, "priors", traced, settings, "progress")
    refine = ("refine", measured, "priors", settings)
    if not by_pressures:
        arguments = (measured, "priors", traced, "start", settings, refine, "progress")
        assert found == ("energies", *arguments)
        return
    state = ("state", ("task", measured, "priors", traced, "start", settings), traced)
    coherent = ("coherent", state, traced, (0.0, 0.75))
    assert found.answers == (coherent, settings, refine, (0.75, 1.0))
    assert found.surfaces == (() if quick else ("scores", coherent))
    assert spans == [(0.0, 0.75), (0.75, 1.0)]


@pytest.mark.parametrize("has_outline", [True, False])
@pytest.mark.parametrize("is_stated", [(False, True), (False, False)])
def test_a_room_is_fitted_again_where_offsets_that_are_stated_are_likeliest(
    monkeypatch, is_stated, has_outline
):
    """Others stay as specified; what is displaced beyond is looked for about the second fit."""
    spans, outlined, measured = [], [], SimpleNamespace(scene="scene", bands="bands",
                                                        directivities="patterns")  # fmt: skip

    def outline(measured, priors, traced, fits, offsets, moved_m):
        outlined.append((measured, priors, traced, fits, offsets, moved_m.tolist()))
        return f"outline {len(outlined)}" if has_outline else None

    offsets = tuple(SimpleNamespace(is_stated=s) for s in is_stated)
    again = SimpleNamespace(measured="measured again")
    given = SimpleNamespace(measured=measured)
    settings = Settings(decay_range_db=35.0)

    def recorded(*arguments):
        moved = ("displaced", "scene", offsets, (0.0, 0.2))
        assert arguments == (moved, "measurements", "bands", "patterns", 35.0)
        return again

    patched(
        monkeypatch,
        spans,
        offsets_of=lambda scene: offsets if scene == "scene" else (),
        _outline=outline,
        located=lambda own: SimpleNamespace(shift_m=np.array([0.1, 0.2]), of=own),
        displaced=lambda scene, own, moved_m: ("displaced", scene, own, tuple(moved_m.tolist())),
        recorded=recorded,
        _traced=lambda *arguments: (("used", arguments), "traced again"),
        _fits=lambda *arguments: ("fits", arguments),
        with_offsets=lambda fits, own, found: ("offsets", fits, own, found.of),
    )
    first = (measured, "priors", "traced", "fits", offsets, [0.0, 0.0])
    found = identification._with_positions_examined(
        given, "measurements", "priors", ("traced", "fits"), settings, "cache", "progress"
    )
    assert outlined[0] == first
    if not has_outline:
        assert found == (given, "traced", "fits") and len(outlined) == 1
        return
    if not any(is_stated):
        assert found == (given, "traced", ("offsets", "fits", "outline 1", "outline 1"))
        assert len(outlined) == 1
        return
    used = ("used", ("measured again", "priors", settings, "cache", (0.0, 0.45)))
    fits = ("fits", ("measured again", "priors", "traced again", used, (0.45, 1.0)))
    assert outlined[1] == (
        "measured again", "priors", "traced again", fits, offsets, [0.0, 0.2],
    )  # fmt: skip
    assert found == (again, "traced again", ("offsets", fits, "outline 2", "outline 2"))
    assert spans == [(0.0, 0.45), (0.45, 1.0)]


@pytest.mark.parametrize("changes", [{"quick": True}, {"method": "annealing"}])
def test_first_answers_and_the_papers_searches_take_positions_as_specified(monkeypatch, changes):
    patched(monkeypatch, offsets_of=None)
    given = SimpleNamespace(measured="measured")
    found = identification._with_positions_examined(
        given, "measurements", "priors", ("traced", "fits"), Settings(**changes), "cache", None
    )
    assert found == (given, "traced", "fits")


@pytest.mark.parametrize(
    ("settings", "intervals", "n_draws", "if_needed"),
    [
        ({}, "profile", True, True),
        ({"quick": True}, "gaussian", True, True),
        ({"method": "simplex"}, "gaussian", True, True),
        ({"method": "annealing"}, "gaussian", True, True),
        ({"method": "posterior"}, "posterior", True, True),
        ({"posterior_draws": False}, "profile", False, False),
        ({"posterior_draws": True}, "profile", True, False),
    ],
)
def test_intervals_are_those_of_the_method_and_profiles_by_default(
    monkeypatch, settings, intervals, n_draws, if_needed
):
    symmetries = [SimpleNamespace(exchange=x) for x in ((1, 0), (0, 1))]
    patched(
        monkeypatch,
        Refinement=lambda *arguments: arguments,
        mirror_symmetries=lambda *own: symmetries if own == ("measured", "priors") else (),
    )
    own = Settings(seed=5, n_draws=77, **settings)
    found = identification._refinement("measured", "priors", own)
    assert found == (intervals, 5, ((1, 0), (0, 1)), 77 if n_draws else 0, if_needed)


def test_draws_of_a_band_are_its_own_those_of_its_covariance_or_of_the_prior(monkeypatch):
    """In an order of its own, since bands are independent; none where no band has its own."""
    n_draws, asked = 50, []
    priors, seed = ("priors",), 9
    prior_mean, prior_law = np.arange(6.0).reshape(2, 3), np.arange(12.0).reshape(3, 2, 2)

    def of_covariance(*law, specified):
        asked.append((law, specified))
        return np.full((n_draws, 2), 0.5)

    patched(
        monkeypatch,
        plain_logit_law=lambda _: (prior_mean, prior_law),
        prior_absorptions=lambda _, band, n, _rng: np.full((n, 2), 0.25 * band),
        band_draws=of_covariance,
        are_specified=lambda own: ("specified", own),
    )
    drawn = np.arange(2.0 * n_draws).reshape(n_draws, 2)
    bands = (
        SimpleNamespace(draws=drawn, model="energy"),
        SimpleNamespace(draws=None, model="values"),
        SimpleNamespace(draws=None, model="prior"),
    )
    absorption, covariance = np.arange(6.0).reshape(2, 3) + 50.0, np.arange(12.0).reshape(3, 2, 2)
    evidence = SimpleNamespace(
        fits=SimpleNamespace(answers=bands), priors=priors, absorption=absorption,
        settings=Settings(seed=seed, n_draws=n_draws), logit_covariance=covariance,
    )  # fmt: skip
    found = identification._draws(evidence)
    assert found.shape == (n_draws, 2, 3)
    np.testing.assert_array_equal(
        found[:, :, 0], np.random.default_rng((seed, 0)).permutation(drawn)
    )
    np.testing.assert_array_equal(np.unique(found[:, :, 1]), [0.5])
    np.testing.assert_array_equal(np.unique(found[:, :, 2]), [0.5])
    ((law, specified),) = asked
    for number, wanted in enumerate(
        (absorption[:, 1], covariance[1], prior_mean[:, 1], prior_law[1], n_draws)
    ):
        np.testing.assert_array_equal(law[number], wanted)
    assert specified == ("specified", priors)
    evidence.fits = SimpleNamespace(answers=bands[1:])
    assert identification._draws(evidence) is None


def test_the_mean_over_the_room_is_its_first_combination_in_every_state(monkeypatch):
    def combination(x):
        return SimpleNamespace(value=x, lower95=x - 0.1, upper95=x + 0.2)

    patched(
        monkeypatch,
        _determined=lambda _, state: ([[combination(b + 10.0 * state), None] for b in (1, 2)],),
    )
    states = [SimpleNamespace(name=n) for n in ("full", "empty")]
    room = SimpleNamespace(states=states)
    evidence = SimpleNamespace(measured=SimpleNamespace(scene=SimpleNamespace(room=room)))
    found = identification._state_means(evidence)
    assert list(found) == ["full", "empty"]
    np.testing.assert_allclose(found["full"], [[11, 12], [10.9, 11.9], [11.2, 12.2]])
    np.testing.assert_allclose(found["empty"], [[21, 22], [20.9, 21.9], [21.2, 22.2]])
