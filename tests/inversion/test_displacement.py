"""Positions and lengths that are off, by early reflections of simulated boxes that scatter."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

import roomfit
import roomfit.identification as whole
from boxes_in_space import box_with_doors
from roomfit.diagnostics import displacement as check_of_displacement
from roomfit.errors import InputError
from roomfit.findings import Code
from roomfit.forks import counted_evaluations
from roomfit.inversion import displacement as whole_displacement
from roomfit.inversion.displacement import (
    LENGTH_SD_M,
    displaced,
    displaced_terms,
    located,
    offset_steps,
    offsets_of,
)
from roomfit.io.campaign import read_campaign
from roomfit.io.inputs import identify_arguments
from roomfit.materials.priors import unknown_material
from roomfit.objective.problem import Objective
from roomfit.scene import PointGroup, Room, Scene
from roomfit.synthetic.boxes import (
    SAMPLING_RATE_HZ,
    WALLS,
    BoxPlan,
    add_noise,
    diffuse_echogram,
    modulated_noise,
    pressure_response,
    specular_box,
    true_box,
)
from seen import evidence
from simulated_rooms.random_boxes import random_plan
from small_campaign import write_campaign

BANDS = roomfit.bands_between("octave", 1000, 2000)
DURATION_S, SCATTERING = 0.4, 0.1


@cache
def simulated(seed: int) -> tuple[BoxPlan, tuple[roomfit.Measurement, ...]]:
    """Return a random box whose walls scatter, and its responses with noise at -60 dB."""
    rng = np.random.default_rng(seed)
    plan = random_plan(rng)
    truth, at = true_box(plan, 0.01, rng)
    walls = np.full(6, SCATTERING)
    specular = specular_box(truth, walls)
    receivers = np.array([at[r] for r in plan.receivers_m])
    found = []
    for source in plan.sources_m:
        level_db = rng.normal(0.0, 3.0, truth.centres_hz.size)
        echogram = diffuse_echogram(
            truth, walls, at[source], receivers, DURATION_S, rng, n_rays=20_000
        )
        for receiver, energy in zip(plan.receivers_m, echogram, strict=True):
            ends = at[source], at[receiver], DURATION_S, SAMPLING_RATE_HZ, level_db
            images = pressure_response(specular, *ends)
            rest = modulated_noise(
                energy, images.size, SAMPLING_RATE_HZ, truth.centres_hz, level_db, rng
            )
            pressure = add_noise(images + rest, -60.0, rng)
            found.append(roomfit.Measurement(source, receiver, pressure, SAMPLING_RATE_HZ))
    return plan, tuple(found)


def specified(plan: BoxPlan, shift_m=(0.0, 0.0, 0.0), longer_m=(0.0, 0.0, 0.0)) -> Scene:
    lengths_m = np.array(plan.lengths_m) + longer_m
    room = roomfit.shoebox_room(lengths_m, dict(zip(WALLS, plan.materials, strict=True)))
    points = [
        [roomfit.Point(n, np.array(p) + shift_m, 0.01) for n, p in named.items()]
        for named in (plan.sources_m, plan.receivers_m)
    ]
    return roomfit.scene_of(room, *points)


def fitted(scene: Scene, seed: int) -> roomfit.Result:
    plan, measurements = simulated(seed)
    everywhere = np.full(len(BANDS), SCATTERING)
    priors = [
        replace(unknown_material(m, len(BANDS)), scattering=everywhere) for m in plan.materials
    ]
    settings = roomfit.Settings(model="energy", n_random_starts=0)
    return roomfit.identify(scene, measurements, priors, BANDS, settings=settings)


def findings(result: roomfit.Result):
    return [f for f in result.findings if f.code == Code.DISPLACEMENT_DETECTED]


@pytest.mark.slow
def test_all_positions_that_are_30_cm_off_are_named_with_direction_and_size():
    result = fitted(specified(simulated(500)[0], shift_m=(0.3, 0.0, 0.0)), 500)
    (finding,) = findings(result)
    assert finding.evidence["what"] == "all positions"
    assert finding.evidence["axis"] == "x"
    assert finding.evidence["metres"] == pytest.approx(-0.3, abs=0.1)
    assert "-x, towards west" in finding.sentence
    assert not result.identifiable.any()


@pytest.mark.slow
def test_positions_are_doubted_in_a_box_of_many_triangles_too():
    """A panel in each wall, 108 triangles: images come from the lattice."""
    plan = simulated(500)[0]
    mesh = box_with_doors(plan.lengths_m, dict.fromkeys(range(6), (0.3, 0.6, 0.3, 0.6)))
    assert len(mesh.triangles) > 60
    own = [WALLS.index(s.name) if s.name in WALLS else int(s.name[5:]) for s in mesh.surfaces]
    scene = specified(plan, shift_m=(0.3, 0.0, 0.0))
    result = fitted(replace(scene, room=Room(mesh, plan.materials, np.array(own))), 500)
    (finding,) = findings(result)
    assert finding.evidence["what"] == "all positions"
    assert finding.evidence["axis"] == "x"
    assert finding.evidence["metres"] == pytest.approx(-0.3, abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [500, 502])
def test_a_room_described_correctly_is_not_doubted(seed):
    """No false alarm in these; the rate over more rooms stands in decision 0035."""
    assert findings(fitted(specified(simulated(seed)[0]), seed)) == []


@pytest.mark.slow
def test_an_offset_within_its_stated_deviation_is_fitted_and_reported():
    scene = specified(simulated(500)[0], shift_m=(0.15, 0.0, 0.0))
    scene = replace(scene, groups=(PointGroup("array", ("*",), (0.1, 0.0, 0.0)),))
    result = fitted(scene, 500)
    assert findings(result) == []
    assert result.geometry is not None
    at = result.geometry.labels.index("array x")
    change, sd = result.geometry.change[at], result.geometry.sd[at]
    assert abs(change + 0.15) < max(3.0 * sd, 0.03)
    assert sd < 0.1 and result.geometry.prior_sd[at] == 0.1


@pytest.mark.slow
def test_what_is_open_of_an_offset_is_in_the_covariance(monkeypatch):
    """As large as fits at other places are apart; here made 3 in the logit, to be seen."""
    real = []

    def keep(outline, sd_m):
        real.append(offset_steps(outline, sd_m))
        return {band: np.full_like(step, 3.0) for band, step in real[-1].items()}

    monkeypatch.setattr(whole_displacement, "offset_steps", keep)
    scene = specified(simulated(500)[0])
    scene = replace(scene, groups=(PointGroup("array", ("*",), (0.1, 0.0, 0.0)),))
    result = fitted(scene, 500)
    assert result.logit_covariance is not None
    for band, step in real[0].items():
        assert step.shape == (len(result.materials), 1)
        assert 0.0 < np.abs(step).max() < 1.0
        assert np.linalg.eigvalsh(result.logit_covariance[band] - 9.0).min() > -1e-9
        assert np.all(result.upper95[:, band] - result.lower95[:, band] > 0.7)


def test_derivatives_are_those_of_finite_differences(monkeypatch):
    kept = []

    def keep(outline):
        kept.append(outline)
        return located(outline)

    monkeypatch.setattr(whole, "located", keep)
    fitted(specified(simulated(500)[0]), 500)
    outline = kept[0]
    for own, term in zip(outline.bands, displaced_terms(outline, np.zeros(6)), strict=True):
        # where nothing has moved: what was measured, within what interference makes of it
        windows = np.log(Objective(own.parameters, (term,)).expected(own.start) / term.measured())
        assert abs(np.median(windows)) < 0.5 and np.quantile(np.abs(windows), 0.9) < 2.0
    shift_m = 0.05 * np.eye(len(outline.offsets))[0]
    for own, term in zip(outline.bands, displaced_terms(outline, shift_m), strict=True):
        objective = Objective(own.parameters, (term,))
        found = objective.predict(own.start)
        step = 1e-5
        for k in range(own.start.size):
            way = step * np.eye(own.start.size)[k]
            ahead, behind = (objective.expected(own.start + s * way) for s in (1.0, -1.0))
            numeric = (ahead - behind) / (2.0 * step)
            scale = np.abs(found.jacobian[:, k]).max()
            np.testing.assert_allclose(found.jacobian[:, k], numeric, atol=1e-6 * scale)


@pytest.mark.slow
@pytest.mark.parametrize(("shift_m", "share"), [(0.0, 0.7), (0.3, 1.0)])
def test_what_high_bands_rule_out_costs_less_and_changes_nothing(monkeypatch, shift_m, share):
    """Whether the room is described correctly or not."""
    kept = []

    def keep(outline):
        kept.append(outline)
        return located(outline)

    def located_and_counted():
        with counted_evaluations() as made:
            return located(kept[0]), made[0]

    monkeypatch.setattr(whole, "located", keep)
    fitted(specified(simulated(500)[0], shift_m=(shift_m, 0.0, 0.0)), 500)
    found, n = located_and_counted()
    monkeypatch.setattr(whole_displacement, "_RULED_OUT", np.inf)
    of_all, n_of_all = located_and_counted()
    np.testing.assert_array_equal(found.shift_m, of_all.shift_m)
    assert (found.beyond is None) == (of_all.beyond is None) == (shift_m == 0.0)
    if found.beyond is not None:
        for name in ("kind", "axis", "size_m", "sd_m", "gain"):
            assert getattr(found.beyond, name) == getattr(of_all.beyond, name)
    assert n <= share * n_of_all


def test_offsets_move_positions_and_the_far_wall():
    scene = specified(simulated(500)[0])
    offsets = offsets_of(scene)
    assert [o.label for o in offsets[:3]] == [f"all positions {a}" for a in "xyz"]
    assert [o.sd_m for o in offsets] == pytest.approx([0.01] * 3 + [LENGTH_SD_M] * 3)
    moved = displaced(scene, offsets, np.array([0.1, 0.0, 0.0, 0.0, -0.2, 0.0]))
    assert moved.sources[0].position_m - scene.sources[0].position_m == pytest.approx([0.1, 0, 0])
    lengths_m = np.array(moved.room.shoebox_m) - np.array(scene.room.shoebox_m)
    assert lengths_m == pytest.approx([0.0, -0.2, 0.0])
    assert moved.room.mesh.vertices_m.max(axis=0) == pytest.approx(moved.room.shoebox_m)


def test_groups_and_lengths_of_a_campaign_reach_the_scene(tmp_path):
    text = '[groups.array]\nmembers = ["LS1", "MP*"]\nsd = [0.1, 0.03, 0.0]\n[sources.LS1]'
    file = write_campaign(
        tmp_path,
        ("[sources.LS1]", text),
        ("shoebox = [3.9, 3.1, 2.5]", "shoebox = [3.9, 3.1, 2.5]\nlengths_sd = [0.1, 0.03, 0.0]"),
    )
    scene = identify_arguments(read_campaign(file))["scene"]
    assert scene.room.lengths_sd_m == (0.1, 0.03, 0.0)
    stated = {o.label: o.sd_m for o in offsets_of(scene) if o.is_stated}
    assert stated == {"array x": 0.1, "array y": 0.03, "length x": 0.1, "length y": 0.03}


@pytest.mark.parametrize(
    ("members", "sd", "message"),
    [
        ('["LS7"]', "0.1", "neither a source nor a receiver"),
        ("[]", "0.1", "members"),
        ('["LS1"]', "-0.1", "sd"),
        ('["LS1"]', "[0.1, 0.1]", "sd"),
    ],
)
def test_a_group_that_cannot_be_meant_is_refused(tmp_path, members, sd, message):
    table = f"[groups.array]\nmembers = {members}\nsd = {sd}\n[sources.LS1]"
    file = write_campaign(tmp_path, ("[sources.LS1]", table))
    with pytest.raises(InputError, match=message):
        read_campaign(file)


def test_only_a_box_has_lengths_that_are_uncertain():
    room = replace(roomfit.shoebox_room((6, 5, 3), "plaster"), shoebox_m=None)
    with pytest.raises(InputError, match="only a box"):
        replace(room, lengths_sd_m=(0.1, 0.1, 0.1))


def named_by(worth):
    """Return what is named of one displaced loudspeaker, sought from 0.8 m on."""
    ends = {"sources": (SimpleNamespace(name="S"),), "receivers": (SimpleNamespace(name="R"),)}
    scene = SimpleNamespace(room=SimpleNamespace(shoebox_m=None), **ends)
    own = whole_displacement.Offset("array", 0, 0.01, False, frozenset({"S"}), frozenset())
    outline = SimpleNamespace(
        offsets=(own,), moved_m=np.zeros(1), measured=SimpleNamespace(scene=scene)
    )
    found = whole_displacement._named(outline, worth, np.zeros(1), np.array([0.8]))
    own = {"sources": (), "receivers": ()}
    seen = evidence(
        fits=SimpleNamespace(displacement=found),
        measured=SimpleNamespace(scene=SimpleNamespace(**own)),
    )
    (finding,) = check_of_displacement.check(seen)
    return finding


def test_a_displacement_between_two_steps_of_the_grid_is_found_at_its_top():
    found = named_by(lambda m, _=False: 200.0 * float(np.exp(-0.5 * ((m[0] - 0.87) / 0.05) ** 2)))
    assert found.evidence["metres"] == pytest.approx(0.87, abs=5e-3)
    assert found.evidence["sd_m"] < 0.01
    assert "stand 0.870 +- 0.004 m" in found.sentence


def test_a_displacement_without_a_top_is_stated_without_a_deviation():
    found = named_by(lambda m, _=False: 200.0 * float(m[0] > 0.42))
    assert "about 0.5 m" in found.sentence
    assert "+-" not in found.sentence


def box_of_three_offsets(moved_m=(0.0, 0.0, 0.0)):
    """Return an outline of a box in which all points, its length or a receiver may be off in x."""
    scene = roomfit.scene_of(
        roomfit.shoebox_room((6.0, 5.0, 3.0), "plaster"), {"S": (1, 1, 1)}, {"R": (4, 3, 1)}
    )
    names = frozenset({"S"}), frozenset({"R"})
    offsets = (
        whole_displacement.Offset("all", 0, 0.01, False, *names),
        whole_displacement.Offset("", 0, 0.03, False),
        whole_displacement.Offset("R", 0, 0.01, False, frozenset(), names[1]),
        whole_displacement.Offset("all", 1, 0.01, False, *names),
    )
    moved = np.array([*moved_m, 0.0])
    return SimpleNamespace(offsets=offsets, moved_m=moved, measured=SimpleNamespace(scene=scene))


@pytest.mark.parametrize(
    ("top", "kind", "size_m", "farther"),
    [
        ((0.5, 0.0, 0.0, 0.0), "all", 0.5, (0.5, -0.5)),
        ((0.0, -0.65, 0.0, 0.0), "length", -0.65, (0.0, -0.65)),
        ((0.0, 0.0, 0.4, 0.0), "R", 0.4, (0.0, 0.0)),
        # a wall at the origin that stands farther off: a longer box whose points have moved as far
        ((0.43, 0.43, 0.0, 0.0), "wall", 0.43, (0.43, 0.0)),
    ],
)
def test_the_likeliest_way_to_move_is_named_with_its_size_and_the_walls_that_are_farther(
    top, kind, size_m, farther
):
    """By a normal law about each; the other axis keeps what it was fitted to."""
    outline, middle = box_of_three_offsets(), np.array(top)
    inverse = np.diag([1 / 0.02**2, 1 / 0.02**2, 1 / 0.02**2, 1 / 0.05**2])

    def worth(at, _roughly=False):
        off = at - middle - [0.0, 0.0, 0.0, 0.03]
        return 300.0 - 0.5 * float(off @ inverse @ off)

    inside = np.array([0.0, 0.0, 0.0, 0.03])
    found = whole_displacement._named(outline, worth, inside, middle)
    assert found is not None and found.kind == kind and found.axis == 0
    assert found.size_m == pytest.approx(size_m, abs=2e-3)
    sd_m = 0.02 / np.sqrt(2.0) if kind == "wall" else 0.02
    assert found.sd_m == pytest.approx(sd_m, rel=1e-3)
    ends = list(found.farther_m.values())
    np.testing.assert_allclose([x for x, _ in ends], farther, atol=2e-3)
    np.testing.assert_allclose([s for _, s in ends], [0.02, 0.02 * np.sqrt(2.0)], atol=1e-3)


def test_an_offset_that_is_stated_is_looked_for_a_step_of_the_grid_away():
    """The likeliest of the steps within seven deviations, if it gains more than half."""
    outline, step_m = box_of_three_offsets(), float(whole_displacement._GRID_M[0])
    stated = [replace(o, is_stated=k == 1) for k, o in enumerate(outline.offsets)]
    outline.offsets = tuple(stated)
    here_m = np.array([0.0, 0.01, 0.0, 0.0])

    def moved(by_m):
        return here_m + by_m * np.eye(4)[1]

    def stepped(top_m, gain):
        """Of a top so far from here, along the length; elsewhere nothing is likelier."""
        return whole_displacement._stated_step(
            outline,
            lambda at, _=False: gain * float(np.allclose(at, moved(top_m))),
            here_m,
        )

    for top_m in (-step_m, step_m):
        np.testing.assert_allclose(stepped(top_m, 0.51), moved(top_m))
        assert stepped(top_m, 0.49) is None
    reach_m = 7.0 * stated[1].sd_m
    within = max(g for g in whole_displacement._GRID_M if g < reach_m)
    beyond = min(g for g in whole_displacement._GRID_M if g >= reach_m)
    assert stepped(within, 9.0) is not None and stepped(beyond, 9.0) is None
    outline.offsets = tuple(replace(o, is_stated=False) for o in stated)
    assert stepped(step_m, 9.0) is None


def test_what_gains_too_little_or_is_within_the_specified_is_not_named():
    """10 units of log-likelihood beside the prior's, and 3.5 deviations of what is specified."""
    outline = box_of_three_offsets()
    far, limit_m = np.array([0.5, 0.0, 0.0, 0.0]), 3.5 * np.hypot(0.01, 0.035)
    prior = whole_displacement._log_prior(outline.offsets[0], 0.5)
    assert prior == pytest.approx(-2.5 * np.log1p(0.25 * 0.25 / (0.01**2 + 0.035**2)))

    def named(top_m, gain):
        """A top of so much gain over where nothing has moved."""
        return whole_displacement._named(
            outline,
            lambda at, _=False: (
                gain * (1.0 - float(np.sum((at - [top_m, 0, 0, 0]) ** 2)) / top_m**2) - 7.0
            ),
            np.zeros(4),
            far,
        )

    assert named(0.5, 10.1 - prior) is not None and named(0.5, 9.9 - prior) is None
    assert named(1.02 * limit_m, 60.0) is not None and named(0.98 * limit_m, 60.0) is None
    assert whole_displacement._named(outline, lambda *_: -np.inf, np.zeros(4), far) is None


def normal_law(covariance, mean):
    inverse = np.linalg.inv(covariance)
    return lambda at, _roughly=False: -0.5 * float((at - mean) @ inverse @ (at - mean))


@pytest.mark.parametrize("sd_m", [0.005, 0.3, 4.0])
def test_the_deviation_along_a_way_is_that_of_a_normal_law_and_ten_metres_at_most(sd_m):
    """Second differences of a parabola are exact, wherever they are taken."""
    law, at = normal_law(np.diag([sd_m**2, 1.0]), np.array([0.2, 0.0])), np.array([0.5, 0.1])
    found = whole_displacement._sd_along(law, at, np.array([1.0, 0.0]))
    assert found == pytest.approx(sd_m, rel=1e-6)
    for flat in (lambda _: 3.0, lambda at: float("inf") if at[0] > 0.5 else 0.0):
        nothing = whole_displacement._sd_along(flat, at, np.array([1.0, 0.0]))
        assert nothing == pytest.approx(10.0, rel=1e-12)


def test_the_covariance_of_offsets_is_that_of_a_normal_law_and_never_above_the_prior():
    """The others are fixed: the inverse of their part of the inverse. A prior of 10 m is none."""
    covariance = np.array([[0.04, 0.012, 0.0], [0.012, 0.01, 0.002], [0.0, 0.002, 0.09]])
    law, at = normal_law(covariance, np.zeros(3)), np.array([0.03, -0.02, 0.01])
    exact = np.linalg.inv(np.linalg.inv(covariance)[np.ix_([0, 2], [0, 2])])
    found = whole_displacement._covariance(law, at, [0, 2], np.full(2, 10.0))
    np.testing.assert_allclose(found, exact, rtol=1e-6)
    prior_sd_m = np.array([0.5, 0.1])
    flat = whole_displacement._covariance(lambda _at: 1.0, at, [0, 2], prior_sd_m)
    np.testing.assert_allclose(flat, np.diag(prior_sd_m**2), atol=1e-15)


@pytest.mark.parametrize(
    ("order", "kept_for_validation", "box", "n_offsets", "asked"),
    [
        *((1, 0, True, 1, True), (0, 0, True, 1, False), (1, 1, True, 1, False)),
        *((1, 0, False, 1, False), (1, 0, True, 0, False)),
    ],
)
def test_a_displacement_is_asked_for_from_four_responses_and_first_reflections_on(
    monkeypatch, order, kept_for_validation, box, n_offsets, asked
):
    """And of a box of any number of triangles, or of another room of 60 at most."""
    room = roomfit.shoebox_room((6.0, 5.0, 3.0), "plaster")
    scene = roomfit.scene_of(room, {"S": (1.5, 1.2, 1.5)}, {"R": (4.0, 3.5, 1.2)})
    if not box:
        monkeypatch.setattr(whole_displacement, "box_of", lambda _: None)
        monkeypatch.setattr(whole_displacement, "_MOST_TRIANGLES", 11)
    uses = ["fit"] * (4 - kept_for_validation) + ["validate"] * kept_for_validation
    responses = tuple(SimpleNamespace(measurement=SimpleNamespace(use=use)) for use in uses)
    measured = SimpleNamespace(scene=scene, bands=BANDS, responses=responses)
    settings = SimpleNamespace(image_order=order, duration_s=0.4, image_until_s=None)
    traced = SimpleNamespace(paths="paths", settings=settings)

    def stop(paths, _reach_m, found_order):
        assert (paths, found_order) == ("paths", 1)
        raise StopIteration

    monkeypatch.setattr(whole_displacement, "_early_images", stop)
    offsets = (object(),) * n_offsets
    arguments = (measured, (), traced, (), (None, ()), offsets, np.zeros(n_offsets))
    if asked:
        with pytest.raises(StopIteration):
            whole_displacement.displacement_model(*arguments)
    else:
        assert whole_displacement.displacement_model(*arguments) is None


def test_a_stated_offset_moves_absorption_by_half_the_difference_of_its_two_sides(monkeypatch):
    """Of fits that are linear in the offset; one that is not possible to either side is 0."""
    outline, slope = box_of_three_offsets(), np.array([3.0, -5.0])
    outline.offsets = tuple(
        replace(o, is_stated=k in (0, 1)) for k, o in enumerate(outline.offsets)
    )
    parameters = SimpleNamespace()
    outline.bands = [SimpleNamespace(band=b, parameters=parameters, start=None) for b in (2, 4)]
    n = len(outline.measured.scene.room.materials)
    asked, impossible = [], []

    def displaced_to(_scene, _offsets, way_m):
        asked.append(way_m)
        return tuple(way_m)

    monkeypatch.setattr(whole_displacement, "displaced", displaced_to)
    monkeypatch.setattr(whole_displacement, "_is_possible", lambda way_m: way_m not in impossible)
    monkeypatch.setattr(
        whole_displacement, "displaced_terms", lambda _, way_m: [(0, way_m), (1, way_m)]
    )
    monkeypatch.setattr(whole_displacement, "Objective", lambda _, terms: terms[0])
    monkeypatch.setattr(
        whole_displacement, "score_band", lambda term, *_, **__: SimpleNamespace(vector=term)
    )

    def absorption(_parameters, vector):
        band, way_m = vector
        by = -0.4 + slope[band] * way_m.sum() + 7.0 * way_m.sum() ** 2
        return {"absorption": np.full(n, 1.0 / (1.0 + np.exp(-by)))}, None

    monkeypatch.setattr(whole_displacement, "physical_values", absorption)
    sd_m = np.array([0.02, 0.01, 0.5, 0.5])
    found = whole_displacement.offset_steps(outline, sd_m)
    assert list(found) == [2, 4]
    for band, steps in zip((0, 1), found.values(), strict=True):
        # what is even in the offset cancels
        np.testing.assert_allclose(steps, np.tile(slope[band] * sd_m[:2], (n, 1)), rtol=1e-9)
    assert [tuple(way_m) for way_m in asked[:2]] == [(-0.02, 0, 0, 0), (0.02, 0, 0, 0)]
    impossible.append((0.0, 0.01, 0.0, 0.0))
    steps = whole_displacement.offset_steps(outline, sd_m)[2]
    assert np.all(steps[:, 1] == 0.0) and np.all(steps[:, 0] != 0.0)


def test_what_was_ruled_out_roughly_is_evaluated_where_it_is_asked_for_exactly(monkeypatch):
    """And nothing else twice; what is foreseen is rough."""
    asked = []

    def evaluated(_self, shift_m, roughly, _max_rounds):
        asked.append((float(shift_m[0]), roughly))
        return -np.inf if roughly and shift_m[0] > 1.0 else float(shift_m[0])

    monkeypatch.setattr(whole_displacement._LogL, "evaluated", evaluated)
    logl = whole_displacement._LogL(SimpleNamespace(bands=[]))
    ruled_out, kept = np.array([2.0]), np.array([0.5])
    assert [logl(ruled_out, True), logl(ruled_out, True)] == 2 * [-np.inf]
    assert logl(kept, True) == logl(kept) == logl(kept) == 0.5
    assert logl(ruled_out) == logl(ruled_out, True) == logl(ruled_out) == 2.0
    assert asked == [(2.0, True), (0.5, True), (2.0, False)]
    logl.foresee([ruled_out, np.array([3.0]), np.array([3.0])])
    assert asked[3:] == [(3.0, True)] and logl(np.array([3.0]), True) == -np.inf


def test_stated_offsets_are_found_where_the_data_and_what_is_stated_have_them(monkeypatch):
    """Of a normal law of the data, far off: the mean by both precisions, and the deviation."""
    outline, sd_m, data_sd_m, top_m = box_of_three_offsets(), 0.2, 0.02, 0.4
    outline.offsets = tuple(
        replace(o, is_stated=k == 1, sd_m=sd_m if k == 1 else o.sd_m)
        for k, o in enumerate(outline.offsets)
    )
    outline.moved_m = np.zeros(4)

    class Law:
        def __call__(self, at, _roughly=False):
            return -0.5 * float(np.sum((at - [0.0, top_m, 0.0, 0.0]) ** 2)) / data_sd_m**2

        def foresee(self, shifts_m):
            pass

    monkeypatch.setattr(whole_displacement, "logl_of", lambda _: Law())
    monkeypatch.setattr(whole_displacement, "_implausible", lambda *_: None)
    monkeypatch.setattr(whole_displacement, "_farthest", lambda *_: None)
    found = whole_displacement.located(outline)
    precision = 1.0 / sd_m**2 + 1.0 / data_sd_m**2
    assert found.shift_m[1] == pytest.approx(top_m / data_sd_m**2 / precision, abs=3e-3)
    assert found.sd_m[1] == pytest.approx(1.0 / np.sqrt(precision), rel=0.02)
    np.testing.assert_allclose(found.shift_m[[0, 2, 3]], 0.0, atol=5e-3)
    assert found.beyond is None


@pytest.mark.parametrize("moved_m", [0.0, 0.05])
def test_what_is_farthest_beyond_the_specified_is_looked_for_from_where_its_axis_is_as_specified(
    moved_m,
):
    """Other axes keep what they were fitted to. It must gain ten units beside its own prior."""
    outline = box_of_three_offsets((moved_m, 0.0, 0.0))
    inside, asked = np.array([0.01, 0.02, 0.0, 0.03]), []
    top = np.array([-moved_m, 0.0, -0.4, 0.03])
    prior = whole_displacement._log_prior(outline.offsets[2], 0.4)

    class Worth:
        def __init__(self, gain, here=-7.0, of_inside=-8.0):
            self.gain, self.here, self.of_inside = gain, here, of_inside

        def __call__(self, at, _roughly=False):
            if np.allclose(at, inside):
                return self.of_inside
            return self.here + self.gain * float(np.allclose(at, top))

        def foresee(self, shifts_m):
            asked.extend(shifts_m)

    def farthest(**given):
        return whole_displacement._farthest(outline, Worth(**given), inside)

    np.testing.assert_allclose(farthest(gain=10.1 - prior), top)
    assert farthest(gain=9.9 - prior) is None
    assert farthest(gain=60.0, of_inside=53.1) is None
    assert farthest(gain=60.0, of_inside=52.9) is not None
    # every offset, at either side of every step of the grid beyond 3.5 deviations, from its start
    limits_m = [3.5 * np.hypot(o.sd_m, 0.035) for o in outline.offsets]
    wanted = sum(2 * int(np.sum(g > m)) for m in limits_m for g in [whole_displacement._GRID_M])
    assert len(asked) == 4 * wanted
    assert any(np.allclose(a, [0.01, 0.02, 0.0, -0.3]) for a in asked)  # along y


def test_what_went_beyond_the_specified_step_by_step_is_far_itself_unless_it_was_stated():
    outline = box_of_three_offsets((0.1, 0.0, 0.0))
    limit_m = 3.5 * np.hypot(0.01, 0.035) - 0.1

    class Flat:
        def __call__(self, _at, _roughly=False):
            return 0.0

        def foresee(self, _shifts_m):
            pass

    for by_m, is_far in ((limit_m - 1e-4, False), (limit_m + 1e-4, True)):
        shift_m = np.array([by_m, 0.0, 0.0, 0.0])
        found = whole_displacement._farthest(outline, Flat(), shift_m)
        assert (found is not None) == is_far
        if is_far:
            np.testing.assert_array_equal(found, shift_m)
    outline.offsets = tuple(replace(o, is_stated=True) for o in outline.offsets)
    assert whole_displacement._farthest(outline, Flat(), shift_m) is None


@pytest.mark.parametrize("top_m", [-0.04, 0.03])
def test_an_offset_s_highest_point_is_looked_for_on_both_sides_within_its_reach(top_m):
    """A sharp top of the second of two offsets; one that is lower than where it stands is none."""

    def logl(shift_m):
        return -abs(float(shift_m[1]) - 0.01 - top_m) - 2.0 * abs(float(shift_m[0]) - 0.5)

    start_m = np.array([0.5, 0.01])
    found_m = whole_displacement._highest(logl, start_m, 1, 0.05)
    np.testing.assert_allclose(found_m, [0.5, 0.01 + top_m], atol=2e-3)
    assert whole_displacement._highest(logl, start_m, 0, 0.05) is start_m
