"""Surfaces that do not absorb alike over their area."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from boxes_in_space import rotation
from coherent_cases import MATERIALS, objective_of, small_paths, small_scene, small_term
from roomfit.bands import Bands
from roomfit.diagnostics import uniformity
from roomfit.findings import Code
from roomfit.geometry.mesh import surface_area_m2
from roomfit.inversion import surface_scores
from roomfit.inversion.fits import CoherentTests
from roomfit.inversion.score_tests import FreedAbsorption
from roomfit.inversion.surface_scores import (
    N_CELLS,
    PlaneSurface,
    _score,
    _slopes,
    _strikes,
    plane_surfaces,
)
from roomfit.objective.coherent import with_coherence
from roomfit.objective.parameters import physical_values, start_vector
from roomfit.scene import shoebox_room
from seen import evidence

OCTAVES = np.log2([500.0, 1000.0])
SURFACES = plane_surfaces(shoebox_room((6.0, 4.5, 3.0), "plaster"))


def drawn(rng: np.random.Generator, surface: PlaneSurface, excess: np.ndarray):
    """Return the score of a surface that returns so much more, (2, N_CELLS), by a Gaussian law."""
    own = []
    for band, truth in enumerate(excess):
        # as many reflections as there are cells, each known to a fifth, of which a mean is unknown
        columns = 5.0 * rng.standard_normal((N_CELLS, N_CELLS))
        columns -= columns.mean(axis=1, keepdims=True)
        data = columns @ truth + rng.standard_normal(N_CELLS)
        own.append((band, columns.T @ data, columns.T @ columns))
    return _score(surface, own, OCTAVES)


def test_a_box_has_six_plane_surfaces_whose_cells_lie_in_them():
    assert [s.name for s in SURFACES] == ["west", "east", "south", "north", "floor", "ceiling"]
    for s in SURFACES:
        np.testing.assert_allclose(s.cells_m() @ s.normal, s.offset_m, atol=1e-12)
        size = np.prod(s.upper_m - s.lower_m)
        assert size in (pytest.approx(13.5), pytest.approx(18.0), pytest.approx(27.0))
    mesh = shoebox_room((6.0, 4.5, 3.0), "plaster").mesh
    assert sum(np.prod(s.upper_m - s.lower_m) for s in SURFACES) == pytest.approx(
        surface_area_m2(mesh)
    )


def test_uniform_surfaces_are_hardly_ever_doubted(monkeypatch):
    """By Markov's inequality at most once in 1000 at that level: more than 5 once in 2000 times.

    At the level that the check has, never.
    """
    rng = np.random.default_rng(11)
    none = np.zeros((2, N_CELLS))
    scores = [[drawn(rng, s, none) for s in SURFACES] for _ in range(1000)]
    assert not any(uniformity.most_uneven(s) for s in scores)
    monkeypatch.setattr(uniformity, "_LEVEL", 1e-3)
    assert sum(uniformity.most_uneven(s) is not None for s in scores) <= 5


def test_a_half_of_another_material_is_found_and_named():
    """ln(1 - a) off by .3 to either side, as .2 and .55 in place of .4."""
    rng = np.random.default_rng(12)
    none, named = np.zeros((2, N_CELLS)), []
    for _ in range(50):
        k = int(rng.integers(6))
        half = 0.3 * np.sign(
            SURFACES[k].cells_m() @ SURFACES[k].axes[0]
            - SURFACES[k].cells_m().mean(axis=0) @ SURFACES[k].axes[0]
        )
        scores = [
            drawn(rng, s, np.array([half, half]) if s is SURFACES[k] else none) for s in SURFACES
        ]
        best = uniformity.most_uneven(scores)
        named.append(best is not None and best.name == SURFACES[k].name)
    assert np.mean(named) > 0.9


def test_cells_of_a_box_are_struck_as_often_as_the_trace_counts():
    """Up to the third order: the trace enumerates images, the cells follow straight lines."""
    scene, paths = small_paths()
    term, surfaces = small_term(paths=paths), plane_surfaces(scene.room)
    strikes = _strikes(term.images, scene, [0, 1], surfaces).sum(axis=2)
    hits, n = term.images.hits, term.images.hits.sum(axis=1)
    low = (n > 0) & (n <= 3)
    assert low.sum() > 100
    for m in range(len(MATERIALS)):
        own = [k for k, s in enumerate(surfaces) if s.material == m]
        np.testing.assert_array_equal(strikes[low][:, own].sum(axis=1), hits[low, m])
    assert not strikes[~low].any()


def test_cells_of_a_box_that_stands_elsewhere_are_struck_alike():
    """Turned and moved with all that is in it, to the third order."""
    scene, paths = small_paths()
    images, turn, by_m = small_term(paths=paths).images, rotation(33.0), np.array([7.0, -3.0, 0.5])
    mesh = scene.room.mesh
    elsewhere = replace(mesh, vertices_m=mesh.vertices_m @ turn.T + by_m)
    room = replace(scene.room, mesh=elsewhere, shoebox_m=None)
    sources, receivers = (
        tuple(replace(p, position_m=turn @ p.position_m + by_m) for p in points)
        for points in (scene.sources, scene.receivers)
    )
    moved = replace(scene, room=room, sources=sources, receivers=receivers)
    turned = replace(images, image_to_receiver_m=images.image_to_receiver_m @ turn.T)
    found = _strikes(turned, moved, [0, 1], plane_surfaces(room))
    expected = _strikes(images, scene, [0, 1], plane_surfaces(scene.room))
    np.testing.assert_array_equal(found.sum(axis=2), expected.sum(axis=2))
    # the axes of a wall, and so the order of its cells, are others; some strike between two
    assert np.mean(np.sort(found, axis=2) != np.sort(expected, axis=2)) < 1e-4
    assert found.sum() > 200


def test_first_reflections_strike_where_their_mirror_law_says(monkeypatch):
    """Angles to the normal are equal on both sides, in a box taken for any polyhedron, too."""
    scene, paths = small_paths()
    term, surfaces = small_term(paths=paths), plane_surfaces(scene.room)
    first = term.images.hits.sum(axis=1) == 1
    boxed = _strikes(term.images, scene, [0, 1], surfaces)
    monkeypatch.setattr(surface_scores, "box_of", lambda _: None)
    strikes = _strikes(term.images, scene, [0, 1], surfaces)
    np.testing.assert_array_equal(strikes[first], boxed[first])
    source_m, receiver_m = scene.sources[0].position_m, scene.receivers[0].position_m
    for k, s in enumerate(surfaces):
        gaps = [abs(s.offset_m - p @ s.normal) for p in (source_m, receiver_m)]
        feet = [p + (s.offset_m - p @ s.normal) * s.normal for p in (source_m, receiver_m)]
        struck_m = (gaps[1] * feet[0] + gaps[0] * feet[1]) / sum(gaps)
        rows = np.flatnonzero(strikes[: term.images.offsets[1], k].sum(axis=1))
        assert rows.size == 1
        cell = int(np.argmax(strikes[rows[0], k]))
        size_m = (s.upper_m - s.lower_m) / (4, 3)
        off_m = np.abs(s.axes @ (struck_m - s.cells_m()[cell]))
        assert np.all(off_m <= 0.5 * size_m + 1e-9)


@pytest.mark.parametrize(("covariance", "gain"), [(0.0, 0), (1.0, 0), (0.0, -1), (1.0, -1)])
def test_all_cells_together_change_windows_as_the_absorption_does(covariance, gain):
    """Every image counted, whatever its order: d / d ln(1 - a) = -(1 - a) d / d a.

    Whether the level is unknown or absolute.
    """
    term = small_term()
    observations = tuple(replace(o, gain=gain) for o in term.energies.observations)
    early = tuple(replace(o, gain=gain) for o in term.early)
    energies = replace(term.energies, observations=observations)
    term = replace(term, energies=energies, early=early)
    n = term.geometry.sd.size
    term = with_coherence(term, covariance * np.eye(n))
    objective = objective_of(term)
    values, _ = physical_values(objective.parameters, start_vector(objective.parameters))
    _, _, derivatives = term.predict(values)
    slopes = _slopes(term, values, term.images.hits.copy())
    early = term.early_windows()
    # the last images ring beyond the last bin
    np.testing.assert_allclose(
        slopes[early],
        -(1.0 - values["absorption"]) * derivatives["absorption"][early],
        rtol=1e-5,
        atol=1e-6 * np.abs(slopes).max(),
    )


def test_the_finding_names_places_and_voids_their_material_alone():
    rng = np.random.default_rng(13)
    scene = small_scene()
    surfaces = plane_surfaces(scene.room)
    half = 0.4 * np.sign(np.arange(N_CELLS) - 5.5)
    scores = [drawn(rng, s, np.array([half, half]) * (s.name == "floor")) for s in surfaces]
    bands = Bands("octave", np.array([500.0, 1000.0]))
    seen = evidence(
        fits=SimpleNamespace(surfaces=tuple(scores), directivities=(), tests=CoherentTests()),
        measured=SimpleNamespace(bands=bands),
        materials=MATERIALS,
        absorption=np.full((3, 2), 0.4),
    )
    (finding,) = uniformity.check(seen)
    assert finding.code is Code.ABSORPTION_NOT_UNIFORM
    assert finding.about.materials == ("floor",)
    assert finding.about.bands_hz == (500.0, 1000.0)
    assert all(z == pytest.approx(0.0) for _, _, z in finding.about.points_m)
    # 0.6 is given back on average, and more and less of it by some cells
    (floor,) = (s for s in scores if s.name == "floor")
    row = max(floor.returned, key=np.ptp)
    least, most = (1.0 - 0.6 * np.exp(x) for x in (row.max(), row.min()))
    assert f"about {least:.2f} near" in finding.sentence and 0.0 < least < 0.4
    assert f"about {most:.2f} near" in finding.sentence and 0.4 < most < 1.0
    largest = max(s.evidence for s in scores)
    for gain, is_named in ((largest + 2.0, True), (largest + 6.0, False)):
        freed = FreedAbsorption(1, {0: 0.5 * gain, 1: 0.5 * gain}, {0: 0.2, 1: 0.2})
        seen.fits.tests = CoherentTests(freed_absorptions=(freed,))
        assert bool(list(uniformity.check(seen))) is is_named
    seen.fits.tests, seen.fits.directivities = CoherentTests(), ("fitted",)
    assert not list(uniformity.check(seen))


def test_rooms_without_pressures_are_not_examined():
    assert uniformity.most_uneven([]) is None


def test_another_explanation_gains_less_one_for_each_of_its_unknowns(monkeypatch):
    """A bent chain has one, a freed absorption one a band; the better of them counts."""
    freed = SimpleNamespace(gains={500.0: 4.0, 1000.0: 3.5})
    chain = SimpleNamespace(alone=[SimpleNamespace(gain=g) for g in (9.0, 8.0, 7.0)])
    asked = []

    def otherwise(clearest, freed_absorptions, chain=chain):
        monkeypatch.setattr(
            uniformity, "clearest_fault", lambda _, **given: asked.append(given) or clearest
        )
        tests = SimpleNamespace(freed_absorptions=freed_absorptions, chain=chain)
        return uniformity._otherwise(SimpleNamespace(fits=SimpleNamespace(tests=tests)))

    assert otherwise(None, (freed,)) == 5.5
    assert otherwise(1, (freed,)) == 7.0 and otherwise(2, ()) == 6.0
    assert asked == 3 * [{"is_directed": False}]
    assert otherwise(1, (freed,), None) == 5.5 and otherwise(1, (), None) == -np.inf
