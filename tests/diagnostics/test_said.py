"""What checks say of numbers that are written down here, and from where on they say it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import roomfit
from roomfit.bands import bands_between
from roomfit.diagnostics import displacement, mirrors, positions, scattering, source_patterns
from roomfit.findings import Code
from roomfit.inversion.directivity import SourceGain
from roomfit.inversion.fits import Displacement, Freed
from roomfit.inversion.scattering import ChosenScattering, ScatteringTrial
from roomfit.objective.coherent import FittedGeometry
from seen import evidence, of_tests

BANDS = bands_between("octave", 500, 1000)
SCENE = roomfit.scene_of(
    roomfit.shoebox_room((6.0, 5.0, 3.0), {"floor": "carpet"} | dict.fromkeys(
        ("west", "east", "south", "north", "ceiling"), "walls")),
    {"S": (1.0, 1.5, 1.2)}, {"A": (4.0, 3.0, 1.2), "B": (2.0, 4.0, 1.6)},
)  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "points", "size_m", "sd_m", "words"),
    [
        ("array", {"S", "A"}, 0.31, 0.02, "array stand 0.31 +- 0.02 m farther along +x, towards "
         "east, than specified"),
        ("array", {"S", "A"}, -0.31, 0.004, "array stand 0.310 +- 0.004 m farther along -x, "
         "towards west"),
        ("wall", set(), 0.31, 0.02, "west stands 0.31 +- 0.02 m outside of where it"),
        ("wall", set(), -0.31, 0.02, "west stands 0.31 +- 0.02 m inside of where it"),
        ("length", set(), 0.31, 0.02, "the room is 0.31 +- 0.02 m longer along x than specified, "
         "as if east stood elsewhere"),
        ("length", set(), -0.31, 0.02, "the room is 0.31 +- 0.02 m shorter along x"),
        ("length", set(), 0.31, 0.3, "the room is about 0.3 m longer along x"),
    ],
)  # fmt: skip
def test_a_displacement_is_said_with_its_direction_and_size(kind, points, size_m, sd_m, words):
    ends = {"west": (0.31, 0.02), "east": (-0.05, 0.03)}
    own = Displacement(
        kind, frozenset(points), 0, size_m, sd_m, 0.01, 40.04, ("west", "east"), ends
    )
    seen = evidence(fits=SimpleNamespace(displacement=own), measured=SimpleNamespace(scene=SCENE))
    (finding,) = displacement.check(seen)
    assert words in finding.sentence
    assert (
        "raises the log-likelihood by 40; 0.01 m is its standard deviation; counted from all "
        "positions west is +0.31 +- 0.02 m farther and east is -0.05 +- 0.03 m farther."
    ) in finding.sentence
    assert finding.evidence["metres_farther"] == {"west": [0.31, 0.02], "east": [-0.05, 0.03]}
    at = [p.position_m.tolist() for p in (*SCENE.sources, *SCENE.receivers) if p.name in points]
    assert [list(p) for p in finding.about.points_m] == at


def test_delays_and_positions_that_were_excluded_are_told_by_what_they_gain():
    """15 units; of fixed positions one more for each unknown, or a tenth of one a window."""
    for gain, n in ((15.1, 1), (14.9, 0)):
        found = list(positions.check_delays(of_tests(freed_delays=Freed(gain, 3, 100))))
        assert len(found) == n
    for freed, n in (
        (Freed(27.1, 12, 100), 1),
        (Freed(26.9, 12, 100), 0),
        (Freed(40.1, 12, 400), 1),
        (Freed(39.9, 12, 400), 0),
    ):
        found = list(positions.check_fixed(of_tests(freed_positions=freed)))
        assert len(found) == n
        if found:
            assert found[0].code is Code.POSITION_INCONSISTENT
            assert found[0].evidence["n_windows"] == freed.n_windows
    assert not list(positions.check_delays(of_tests()))
    assert not list(positions.check_fixed(of_tests()))
    (finding,) = positions.check_inflated(of_tests(position_sd_scale=2.04))
    assert "positions are off 2.0 times as far" in finding.sentence
    assert not list(positions.check_inflated(of_tests(position_sd_scale=1.0)))


def test_what_moved_more_than_three_and_a_half_deviations_is_named_and_offsets_are_not():
    """Nor what had none; the last entry is an offset, which is judged by itself."""
    geometry = FittedGeometry(
        ("source S x", "receiver A y", "receiver B z", "speed of sound", "length x"),
        np.array([0.0351, -0.0351, 0.0349, 0.1, 0.9]),
        np.full(5, 0.001),
        np.array([0.01, 0.01, 0.01, 0.0, 0.01]),
        343.0,
        n_offsets=1,
    )
    seen = evidence(fits=SimpleNamespace(geometry=geometry), measured=SimpleNamespace(scene=SCENE))
    (finding,) = positions.check_shifts(seen)
    assert list(finding.evidence["labels"]) == ["source S x", "receiver A y"]
    assert "moved source S x, receiver A y by more than 3.5 prior" in finding.sentence
    assert finding.about.points_m == ((1.0, 1.5, 1.2), (4.0, 3.0, 1.2))
    still = SimpleNamespace(geometry=None)
    assert not list(positions.check_shifts(evidence(fits=still)))


@pytest.mark.parametrize(
    ("chosen", "words"),
    [
        (ChosenScattering(("a", "b"), (0.1, 0.1), (0.0, 0.0), (0.2, 0.2), False, True),
         "scattering of a, b is unspecified; 0.1 was assumed, which explains the responses well "
         "(0 to 0.2 do as well)."),
        (ChosenScattering(("a",), (0.1,), (0.1,), (0.1,), False, True), "well (others do worse)."),
        (ChosenScattering(("a",), (0.1,), (0.0,), (0.2,), False, False), "0.1 was assumed."),
        (ChosenScattering(("a", "b"), (0.1, 0.3), (0.05, 0.2), (0.2, 0.4), True, True),
         "of 8 values each: a 0.1 (0.05 to 0.2), b 0.3 (0.2 to 0.4)."),
    ],
)  # fmt: skip
def test_scattering_is_said_with_what_does_as_well(chosen, words):
    seen = evidence(traced=SimpleNamespace(chosen_scattering=(chosen,)))
    (finding,) = scattering.check_chosen(seen)
    assert words in finding.sentence
    fitted = Code.SCATTERING_FITTED if chosen.is_fitted else Code.SCATTERING_ASSUMED
    assert finding.code is fitted and list(finding.about.materials) == list(chosen.materials)


@pytest.mark.parametrize(
    ("gains", "is_told"),
    [((5.1, 0.0), True), ((4.9, 0.0), False), ((10.0, -3.9), True), ((10.0, -4.1), False)],
)
def test_smooth_walls_are_doubted_by_all_bands_together_and_by_none_that_loses(gains, is_told):
    """More than 5 units in all, and no band that loses 4."""

    def seen(unknown=None, contradicted=()):
        trial = ScatteringTrial(("a",), 0.15, np.array(gains))
        fits = SimpleNamespace(unknown_sources=unknown, contradicted=contradicted)
        return evidence(traced=SimpleNamespace(scattering_trial=trial), fits=fits)

    found = list(scattering.check(seen()))
    assert bool(found) is is_told
    if found:
        assert "a coefficient of 0.15 raises the log likelihood by" in found[0].sentence
        assert found[0].evidence["gain"] == pytest.approx(sum(gains))
    assert not list(scattering.check(seen(unknown="fitted")))
    assert not list(scattering.check(seen(contradicted=("S",))))


def test_a_source_that_is_not_omnidirectional_is_said_with_where_it_radiates_most():
    """Of two bands the stronger: along (0.6, 0, 0.8)."""
    b = np.array([[0.0, 0.1, 0.0], [0.3, 0.0, 0.4]])
    own = SourceGain("S", 33.3, b)
    for fitted, code, words in (
        (None, Code.SOURCE_NOT_OMNIDIRECTIONAL, "no material is called identifiable"),
        (SimpleNamespace(sources=("S",)), Code.SOURCE_PATTERN_FITTED, "It was fitted together"),
    ):
        seen = evidence(
            fits=SimpleNamespace(unknown_sources=fitted, contradicted=(own,)),
            measured=SimpleNamespace(scene=SCENE),
        )
        (finding,) = source_patterns.check(seen)
        assert finding.code is code and words in finding.sentence
        assert "towards (0.6, 0.0, 0.8) raises the log-likelihood by 33" in finding.sentence
        assert {tuple(p) for p in finding.about.pairs} == {("S", "A"), ("S", "B")}


def test_what_is_about_some_materials_in_some_bands_alone_names_each():
    """Both bands of both: by name and band; else one by one."""
    both = mirrors._about(("a", "b", "c"), BANDS, np.array([[True] * 2, [True] * 2, [False] * 2]))
    assert both.materials == ("a", "b") and both.bands_hz == (500.0, 1000.0) and not both.entries
    some = np.array([[True, False], [True, True], [False, False]])
    one_by_one = mirrors._about(("a", "b", "c"), BANDS, some)
    assert one_by_one.entries == (("a", 500.0), ("b", 500.0), ("b", 1000.0))
