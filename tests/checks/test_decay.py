"""Decays that are not reproduced, first reflections that contradict the fit, fits that go on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import roomfit
from roomfit.base.air import Air, attenuation_per_m, speed_of_sound_m_s
from roomfit.base.bands import bands_between
from roomfit.base.findings import Code
from roomfit.checks import decay
from roomfit.checks.decay import certain_misses, decay_misses
from roomfit.checks.reflections import (
    WallReflectance,
    isolated_reflections,
    reflection_findings,
    wall_returns,
)
from roomfit.checks.verdict import voided
from roomfit.demo.boxes import SyntheticBox, pressure_response
from roomfit.fit.measurements import collect_measurements
from roomfit.fit.paths import traced_paths
from roomfit.materials.priors import complete_priors
from roomfit.model.patterns import Pattern
from roomfit.result import Compared, ComparedPair
from roomfit.settings import Settings

OCTAVES = bands_between("octave", 125, 4000)
# ISO 3382-2:2008, A.1 and A.2 with n = 10.
SCATTER = {"T20_s": 0.88 * np.sqrt(1.19), "T30_s": 0.55 * np.sqrt(1.152)}


def compared(time_s: float, off: float, rng: np.random.Generator | None) -> ComparedPair:
    """Return one pair of a room of one decay, predicted off by a factor, measured as ISO says."""
    bandwidth_hz = OCTAVES.upper_hz - OCTAVES.lower_hz
    table = {}
    for name, factor in SCATTER.items():
        sd = factor / np.sqrt(bandwidth_hz * time_s)
        noise = np.zeros(len(OCTAVES)) if rng is None else sd * rng.standard_normal(len(OCTAVES))
        measured, predicted = time_s * (1.0 + noise), np.full(len(OCTAVES), time_s * off)
        jnd = (predicted - measured) / (0.05 * measured)
        table[name] = Compared(measured, predicted, measured, jnd)
    return ComparedPair("S", "R", "fit", table, None)


def test_random_decays_of_right_rooms_are_doubted_in_fewer_than_one_room_in_twenty() -> None:
    """Six octaves, four pairs of 0.5 s: 3 standard deviations twelve times, 3 % of rooms; and 2 JND
    besides. 500 rooms, so that 41 of them would be 3.3 standard deviations above one in twenty.
    """
    rng = np.random.default_rng(31)
    fitted = [True] * len(OCTAVES)
    alarms = sum(
        bool(decay_misses(OCTAVES, [compared(0.5, 1.0, rng) for _ in range(4)], fitted))
        for _ in range(500)
    )
    assert alarms <= 40


def test_a_decay_30_percent_too_long_is_missed_and_one_8_percent_too_long_is_not() -> None:
    """Two pairs of 2 s without noise: every octave has a scatter below 5 %."""
    fitted = [True] * 5 + [False]
    missed = decay_misses(OCTAVES, [compared(2.0, 1.3, None)] * 2, fitted)
    assert [m.band for m in missed] == [0, 1, 2, 3, 4]
    assert missed[3].jnd["T20_s"][0] == pytest.approx(6.0)
    assert missed[3].number == 2
    assert decay_misses(OCTAVES, [compared(2.0, 1.08, None)] * 2, fitted) == ()
    kept = [replace(compared(2.0, 1.3, None), use="validate")]
    assert decay_misses(OCTAVES, kept, fitted) == ()


def test_a_decay_that_pressures_reproduce_is_not_missed_though_energies_miss_it() -> None:
    """And one that the fitted windows miss by 30 % as well, is: pairs of 2 s without noise."""
    pairs, fitted = [compared(2.0, 1.3, None)] * 3, [True] * len(OCTAVES)
    as_fitted = [
        {"T20_s": np.array([[2.0] * 3, [2.0 * off] * 3])}
        for off in (1.3, 1.05, 1.0, 0.7, 1.05, 1.3)
    ]
    found = decay_misses(OCTAVES, pairs, fitted, [*as_fitted[:4], {}, as_fitted[5]])
    assert [m.band for m in found] == [0, 3, 4, 5]


# One box of six materials, measured twice over, as image sources with phase have it.
LENGTHS_M = (8.0, 6.5, 5.0)
WALLS = ("west", "east", "south", "north", "floor", "ceiling")
TRUE = np.array([0.15, 0.3, 0.2, 0.1, 0.8, 0.4])
HIGH = bands_between("octave", 2000, 4000)
RECEIVERS = {"R1": (4.9, 3.6, 1.9), "R2": (5.8, 2.4, 2.6), "R3": (3.3, 4.4, 1.6)}
SOURCES = {"S1": (2.1, 2.2, 1.7), "S2": (2.6, 4.9, 2.4)}


@pytest.fixture(scope="module")
def measured_box():
    """Measurements and paths of the box, with absorption known at two octaves."""
    wide = bands_between("octave", 1000, 8000)
    truth = SyntheticBox(
        LENGTHS_M,
        wide.centres_hz,
        np.tile(TRUE[:, None], len(wide)),
        attenuation_per_m(Air(), wide),
        speed_of_sound_m_s(Air()),
    )
    room = roomfit.shoebox_room(LENGTHS_M, dict(zip(WALLS, WALLS, strict=True)))
    scene = roomfit.scene_of(room, SOURCES, RECEIVERS)
    rng = np.random.default_rng(3)
    responses = []
    for s, at in SOURCES.items():
        for r, to in RECEIVERS.items():
            p = pressure_response(truth, np.array(at), np.array(to), 0.3, 16_000, np.zeros(4))
            p = p + 1e-3 * np.abs(p).max() * rng.standard_normal(p.size)
            responses.append(roomfit.Measurement(s, r, p, 16_000, level="per-file"))
    measured = collect_measurements(scene, responses, HIGH, {})
    materials = [roomfit.material_prior(n, HIGH, scattering=0.0) for n in WALLS]
    priors = complete_priors(room.materials, materials, HIGH)
    settings = Settings(n_rays=500, n_rays_beside_images=500, n_scattering_rays=500)
    traced = traced_paths(measured, priors, settings, np.full(2, 0.3), None)
    return measured, priors, traced


def test_isolated_reflections_give_back_what_the_walls_do(measured_box) -> None:
    """With all other walls right, each within four of its standard deviations and right on average
    within three of that of the mean, whose weights do not depend on what was measured."""
    measured, _, traced = measured_box
    found = isolated_reflections(measured, traced, np.tile(TRUE[:, None], 2))
    assert len(found) >= 20
    assert {r.wall for r in found} >= {"floor", "north"}
    z = np.array([(r.returned - (1.0 - TRUE[WALLS.index(r.wall)])) / r.sd for r in found])
    assert np.abs(z).max() < 4.0
    assert abs(z.mean()) < 3.0 / np.sqrt(z.size)
    for r in found:
        assert r.predicted == pytest.approx(1.0 - TRUE[WALLS.index(r.wall)])
        assert r.wall == r.material


@pytest.mark.parametrize(("known", "many"), [(False, True), (True, True), (True, False)])
def test_a_floor_that_the_fit_has_far_too_hard_is_named_and_no_other(
    measured_box, known, many
) -> None:
    """.8 fitted as .24 (.20 to .28): serious where the source's directivity is specified.

    And where there are 8 reflections, here each taken four times, which agree.
    """
    measured, priors, traced = measured_box
    fit = np.tile(TRUE[:, None], 2)
    fit[4] = 0.24
    if known:
        patterns = {s: Pattern(np.zeros((2, 3))) for s in SOURCES}
        measured = replace(measured, directivities=patterns)
    seen = isolated_reflections(measured, traced, fit) * (4 if many else 1)
    returns = wall_returns(seen, measured, traced.scattering)
    findings = list(reflection_findings(returns, HIGH, WALLS, (fit, fit - 0.04, fit + 0.04)))
    doubted = voided(findings[0], priors, HIGH)
    assert [f.code for f in findings] == [Code.REFLECTION_DISAGREES]
    assert findings[0].evidence["wall"] == "floor"
    assert 4000.0 in findings[0].evidence["bands_hz"]
    is_serious = known and many
    assert findings[0].severity == ("serious" if is_serious else "warning")
    # of 8 that differ as no interference explains, none says more than a hint
    apart = [
        r._replace(returned=r.returned + 0.5 * (-1) ** (4 * i // len(seen)))
        for i, r in enumerate(seen)
    ]
    differing = reflection_findings(
        wall_returns(apart, measured, traced.scattering), HIGH, WALLS, (fit, fit - 0.04, fit + 0.04)
    )
    assert all(f.severity == "warning" for f in differing)
    np.testing.assert_array_equal(doubted[:4] | doubted[5], False)
    assert bool(doubted[4, 1]) is is_serious
    right = np.tile(TRUE[:, None], 2)
    seen = isolated_reflections(measured, traced, right)
    returns = wall_returns(seen, measured, traced.scattering)
    bounds = right, right - 0.04, right + 0.04
    assert not list(reflection_findings(returns, HIGH, WALLS, bounds))


def returned(absorption: float, sd: float, band: int, *, known: bool) -> WallReflectance:
    return WallReflectance("floor", "carpet", band, 9, absorption, sd, known, True)


@pytest.mark.parametrize("known", [False, True])
def test_reflections_contradict_a_fit_where_both_intervals_lie_apart(known) -> None:
    """Fitted .3 (.2 to .4): 1.96 deviations of .1 reach .4 from .596 downwards, .2 from .004 up."""
    fitted = tuple(np.full((1, 2), x) for x in (0.3, 0.2, 0.4))
    bands = bands_between("octave", 500, 1000)
    for absorption, is_named in ((0.59, False), (0.602, True), (0.01, False), (-0.002, True)):
        seen = [returned(absorption, 0.1, 0, known=known), returned(0.3, 0.1, 1, known=known)]
        found = list(reflection_findings(seen, bands, ["carpet"], fitted))
        assert bool(found) is is_named
    both = [returned(0.7, 0.05, 0, known=known), returned(0.9, 0.1, 1, known=known)]
    (finding,) = reflection_findings(both, bands, ["carpet"], fitted)
    assert (
        "from floor (carpet) that stand alone contradict the fitted absorption: 500 Hz 0.70 (0.60 "
        "to 0.80, 9 of them) against 0.30 (0.20 to 0.40); 1000 Hz 0.90 (0.70 to 1.00, 9 of them)"
    ) in finding.sentence
    assert finding.severity == ("serious" if known else "warning")
    # 10 log10(0.3 / 0.7) and 10 log10(0.1 / 0.7)
    assert ("radiates -3.7, -8.5 dB towards this wall" in finding.sentence) is not known
    assert ("not called identifiable there" in finding.sentence) is known
    assert finding.evidence["reflections_lower_upper_fitted_lower_upper"][0] == pytest.approx(
        [0.7, 0.602, 0.798, 0.3, 0.2, 0.4]
    )


def test_a_miss_within_the_answers_own_uncertainty_is_none(measured_box) -> None:
    """Absorption .7 of the true one is missed for sure where it is fixed, not where it is unknown:
    with a standard deviation of 2 in the logit."""
    from roomfit.fit.compare import compare_all

    measured, _, traced = measured_box
    fit = 0.7 * np.tile(TRUE[:, None], 2)
    misses = decay_misses(HIGH, compare_all(measured, traced.binned, fit)[0], [True, True])
    assert [m.band for m in misses] == [0, 1]
    sure, vague = (np.tile(v * np.eye(6), (2, 1, 1)) for v in (0.0, 4.0))
    kept = certain_misses(measured, traced, misses, fit, sure, Settings())
    assert [m.band for m in kept] == [0, 1]
    assert all(v > 0.0 for m in kept for v, _ in m.jnd.values())
    assert certain_misses(measured, traced, misses, fit, vague, Settings()) == ()


def test_decay_times_scatter_as_the_standard_says_of_ten_decays_at_each_position():
    """ISO 3382-2:2008, annex A, for n = 10; relative, times the root of bandwidth and time."""
    of_standard = {"T20_s": (0.88, 1.90), "T30_s": (0.55, 1.52)}
    for name, (factor, more) in of_standard.items():
        assert decay.DECAY_SCATTER[name] == pytest.approx(factor * np.sqrt(1.0 + 0.1 * more))
    assert decay.DECAY_SCATTER["EDT_s"] == pytest.approx(1.97 * np.sqrt(1.28))
