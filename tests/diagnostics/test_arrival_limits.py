"""From where on arrivals say something: made-up distances and times on both sides of each limit."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.special import chdtri

from roomfit.diagnostics import arrivals
from roomfit.diagnostics.arrivals import _Arrivals
from roomfit.findings import Code
from roomfit.scene import Point

C, RATE_HZ, TOLERANCE_M = 340.0, 48_000.0, 0.05
SOURCE = (0.0, 0.0, 1.0)


def arrived(distance_m: Any, path_m: Any, *, latency_s: Any = 0.0, sd_m: Any = 0.0) -> Any:
    """Return arrivals of one source at receivers along x, or in directions of their own."""
    distance_m, path_m = np.array(distance_m, dtype=float), np.array(path_m, dtype=float)
    latencies = np.broadcast_to(latency_s, path_m.shape)
    source = Point("S", SOURCE, position_sd_m=sd_m)
    angle = np.arange(distance_m.size)
    at = np.column_stack((np.cos(angle), np.sin(angle), 0.0 * angle)) * distance_m[:, None] + SOURCE
    receivers = [Point(f"R{i}", tuple(x), position_sd_m=sd_m) for i, x in enumerate(at)]
    files = [
        SimpleNamespace(
            source="S", receiver=r.name, name=f"{r.name}.wav", where=f"{r.name}.wav",
            latency_s=float(late), response=SimpleNamespace(sampling_rate_hz=RATE_HZ),
        )
        for r, late in zip(receivers, latencies, strict=True)
    ]  # fmt: skip
    tolerance_m = np.full(path_m.size, TOLERANCE_M)
    sources = [source] * path_m.size
    own: Any = (files, sources, receivers, path_m, path_m, distance_m, tolerance_m, C)
    return _Arrivals(*own)


@pytest.mark.parametrize(
    ("distance_m", "spread_m", "is_raised"),
    [
        ((2.0, 3.0, 4.0), 0.049, True),
        ((2.0, 3.0, 4.0), 0.051, False),
        # three tolerances apart at least, and three files
        ((2.0, 2.1, 2.151), 0.0, True),
        ((2.0, 2.1, 2.149), 0.0, False),
        ((2.0, 4.0), 0.0, False),
    ],
)
def test_files_begin_at_their_direct_sound_where_their_own_clocks_agree(
    distance_m, spread_m, is_raised
):
    """Whatever latency is specified of each; the time is the mean on the files' own clocks."""
    late_s = np.linspace(0.0, 0.01, len(distance_m))
    own_m = 1.0 + np.linspace(0.0, spread_m, len(distance_m))
    found = arrivals._begin_at_direct(arrived(distance_m, own_m - C * late_s, latency_s=late_s))
    assert bool(found) is is_raised
    if found:
        own_ms = 1e3 * own_m.mean() / C
        assert f"{own_ms:.2f} ms after the first sample" in found[0].finding.sentence
        assert f"({distance_m[0]:.2f} to {distance_m[-1]:.2f} m)" in found[0].finding.sentence


@pytest.mark.parametrize(
    ("factor", "unit"),
    [(0.3048, "ft"), (0.0254, "in"), (0.01, "cm"), (0.001, "mm"), (1 / 0.3048, "m"), (0.5, "")],
)
def test_another_unit_is_found_from_three_files_whose_distances_differ(factor, unit):
    """Beside any common delay, to the tolerance of each; by three tolerances of distance."""
    for distance_m, off_m, is_raised in (
        (np.array([20.0, 50.0, 90.0]), 0.049, True),
        (np.array([20.0, 50.0, 90.0]), 0.051, False),
        (np.array([2.0, 9.0]), 0.0, False),
        (np.array([2.0, 2.1, 2.149]), 0.0, False),
    ):
        off = np.zeros(distance_m.size)
        off[0] = off_m
        found = arrivals._other_unit(arrived(distance_m, factor * distance_m + 1.0 + off))
        assert bool(found) is (is_raised and bool(unit))
        if found:
            assert found[0].finding.evidence == {"factor": factor, "unit": unit}
    near = np.array([2.0, 2.1, 2.151])
    assert bool(arrivals._other_unit(arrived(near, factor * near))) is True


def test_files_begin_anywhere_where_two_of_them_lead_by_a_tenth_of_a_second_at_least():
    """The least and the largest are said."""
    distance_m = np.array([2.0, 3.0])
    for lead_s, is_raised in ((0.0999, False), (0.1001, True)):
        found = arrivals._begin_anywhere(
            arrived(distance_m, distance_m + C * np.array([lead_s, 2]))
        )
        assert bool(found) is is_raised
    assert "All 2 files begin before" in found[0].finding.sentence
    assert "0.10 to 2.00 s" in found[0].finding.sentence
    assert arrivals._begin_anywhere(arrived([2.0], [2.0 + C])) == ()


def test_a_scale_is_that_of_least_squares_and_a_unit_where_it_is_within_three_hundredths():
    """A tolerance for each file, and three files; what all arrivals say is a line through zero."""
    distance_m = np.array([2.0, 3.0, 5.0, 7.0])
    for factor, unit in ((0.3048 * 1.029, "ft"), (0.3048 * 1.031, None), (0.9, None)):
        made = arrivals._stretched(arrived(distance_m, factor * distance_m))
        assert made is not None
        evidence = made.verdicts[0].finding.evidence
        assert evidence.get("unit") == unit
        assert evidence["factor"] == pytest.approx(0.3048 if unit else factor)
        said = f"all positions are {evidence['factor']:.4g} times as far apart"
        assert made.words == said
    off = np.array([0.0, 0.0, 0.0, 0.03])
    made = arrivals._stretched(arrived(distance_m, 0.8 * distance_m + off))
    factor = float((0.8 * distance_m + off) @ distance_m / (distance_m @ distance_m))
    assert made.verdicts[0].finding.evidence["factor"] == pytest.approx(factor, rel=1e-12)
    assert arrivals._stretched(arrived(distance_m, 0.8 * distance_m + 10.0 * off)) is None
    assert arrivals._stretched(arrived(distance_m[:2], 0.8 * distance_m[:2])) is None
    # arrivals as specified but for chance need no scale; a clear one need not be all there is
    rest = np.array([0.045, -0.045, 0.045, -0.03])
    assert arrivals._stretched(arrived(distance_m, distance_m + rest)) is None
    assert arrivals._stretched(arrived(distance_m, 1.5 * distance_m + rest)) is not None


@pytest.mark.parametrize("sd_m", [0.0, 0.03, None])
def test_errors_of_arrivals_are_those_of_onsets_and_of_the_positions_they_share(sd_m):
    """A centimetre and a sample each; the source's, along each path, belongs to all of them."""
    distance_m = np.array([2.0, 3.0, 5.0])
    found = arrived(distance_m, distance_m + 0.1, sd_m=sd_m)
    along = np.array([(np.array(r.position_m) - SOURCE) for r in found.receiver])
    along /= distance_m[:, None]
    onset_m = 0.01 + C / RATE_HZ
    own_m = 0.02 if sd_m is None else sd_m
    covariance = onset_m**2 * np.eye(3) + own_m**2 * (along @ along.T + np.eye(3))
    white = arrivals._whitening(found)
    np.testing.assert_allclose(white @ covariance @ white.T, np.eye(3), atol=1e-9)
    # rounded up to what the median of the rest says
    robust = covariance + (0.2**2 - onset_m**2) * np.eye(3)
    white = arrivals._whitening(found, 0.2)
    np.testing.assert_allclose(white @ robust @ white.T, np.eye(3), atol=1e-9)
    # derivatives by all coordinates are those of finite differences
    for point, columns in arrivals._derivatives(found).items():
        for axis, step in enumerate(1e-6 * np.eye(3)):
            moved = [
                np.array(p.position_m) + (step if p is point else 0.0)
                for p in (*found.source[:1], *found.receiver)
            ]
            away = np.linalg.norm(np.array(moved[1:]) - moved[0], axis=1)
            np.testing.assert_allclose(columns[:, axis], (away - distance_m) / 1e-6, atol=1e-6)
    # Student's t of four degrees of freedom, and Laplace's width of one unknown over its range
    rest_m = np.array([0.01, -0.02, 0.015])
    inverse, ones = np.linalg.inv(covariance), np.ones(3)
    chi2, information = rest_m @ inverse @ rest_m, ones @ inverse @ ones
    expected = -3.5 * np.log(1.0 + chi2 / 4.0) + 0.5 * np.log(2.0 * np.pi / information)
    evidence = arrivals._evidence(found, rest_m, ones[:, None], np.array([3.0]))
    assert evidence == pytest.approx(expected - np.log(3.0), rel=1e-9)
    # what is left is chance up to once in a thousand
    for share, is_chance in ((0.999, True), (1.001, False)):
        size = np.sqrt(share * chdtri(2, 1e-3) / chi2)
        assert arrivals._is_adequate(found, size * rest_m, 1) is is_chance


@pytest.mark.parametrize(
    ("late_s", "latencies", "words", "latency_s"),
    [
        (0.012345678, 0.0, "are 12.35 ms late (593 samples): set latency_s = 0.01235", 0.01235),
        (-0.002, 0.0, "are 2.00 ms early (96 samples): set latency_s = -0.002", -0.002),
        (0.0999, 0.0, "are 99.90 ms late", 0.0999),
        (0.1001, 0.0, "begin 0.10 s before the sound is emitted (4805 samples)", 0.1001),
        (0.012345678, (0.0, 0.1, 0.0), "late (593 samples): add 0.01235 to their latency_s", None),
    ],
)
def test_a_delay_is_said_in_milliseconds_and_samples_with_the_key_to_set(
    late_s, latencies, words, latency_s
):
    files = arrived([2.0, 3.0, 5.0], [2.0, 3.0, 5.0], latency_s=latencies).measurements
    verdict = arrivals._late(files, late_s, 5)
    assert words in verdict.finding.sentence
    assert verdict.finding.sentence.startswith("3 of 5 files (R0.wav, R1.wav, R2.wav) ")
    assert verdict.finding.evidence["latency_s"] == latency_s
    assert verdict.correction.late_s == late_s


def test_delays_are_looked_for_where_all_files_agree_and_more_than_one_does():
    """To a tolerance about their median, which must exceed one; the peaks say by how much."""
    distance_m = np.array([2.0, 3.0, 5.0])
    ones = np.ones((3, 1))
    for off_m, middle_m, is_raised in (
        (0.049, 1.0, True),
        (0.051, 1.0, False),
        (0.0, 0.051, True),
        (0.0, 0.049, False),
    ):
        late_m = middle_m + np.array([0.0, 0.0, off_m])
        made = arrivals._late_by(arrived(distance_m, distance_m + late_m), ones)
        assert (made is not None) is is_raised
    assert arrivals._late_by(arrived([2.0], [3.0]), np.ones((1, 1))) is None
    found = arrived(distance_m, distance_m + 1.0)
    found = _Arrivals(**{
        **{k: getattr(found, k) for k in _Arrivals.__dataclass_fields__},
        "peak_m": distance_m + np.array([1.2, 1.1, 1.4]),
    })  # fmt: skip
    made = arrivals._late_by(found, ones)
    assert made.verdicts[0].finding.evidence["late_s"] == pytest.approx(1.2 / C)
    expected = arrivals._evidence(found, np.zeros(3), ones, np.array([2.0 * np.log(1e4)]))
    assert made.evidence == pytest.approx(expected, rel=1e-12)


def test_how_a_point_is_displaced_is_said_from_five_centimetres_on_by_each_of_its_paths():
    """Beside a delay that its other files have in common; the longest is the least it moved."""
    distance_m = np.array([2.0, 3.0, 5.0, 4.0])
    others = np.array([True, True, True, False])
    for moved_m, is_raised in ((0.049, False), (0.051, True), (-0.2, True)):
        late_m = 0.3 + np.array([0.0, 0.0, 0.0, moved_m])
        found = arrived(distance_m, distance_m + late_m)
        raised = arrivals._displacement(found, found.receiver[3], others, np.ones((4, 1)))
        assert bool(raised) is is_raised
    (verdict,) = raised
    assert verdict.finding.code is Code.DISPLACEMENT_DETECTED
    assert verdict.finding.evidence["receiver"] == "R3"
    assert verdict.finding.evidence["metres"] == pytest.approx(0.2)
    assert "by 0.20 m or more" in verdict.finding.sentence
    assert "as if it were 20 cm nearer to S; those" in verdict.finding.sentence
    (verdict,) = arrivals._displacement(found, found.source[0], ~others, np.ones((4, 1)))
    assert verdict.finding.evidence["source"] == "S"
    assert "20 cm farther from R0, 20 cm farther from R1, 20 cm" in verdict.finding.sentence
    assert verdict.finding.evidence["files"] == ["R0.wav", "R1.wav", "R2.wav"]


def test_two_files_are_exchanged_where_that_mends_both_and_there_is_a_third():
    """To the tolerance of each, beside a common delay."""
    distance_m, swapped = np.array([2.0, 3.0, 5.0, 4.0]), np.array([3.0, 2.0, 5.0, 4.0])
    for off_m, n, is_raised in (
        (0.049, 4, True),
        (0.051, 4, False),
        (0.0, 3, True),
        (0.0, 2, False),
    ):
        path_m = swapped + np.array([off_m, 0.0, 0.0, 0.0])
        found = arrivals._exchanged(arrived(distance_m[:n], path_m[:n]))
        assert bool(found) is is_raised, (off_m, n)
        if found:
            assert found[0].finding.evidence == {"files": ["R0.wav", "R1.wav"]}
    late = arrived(np.array([2.0, 3.0, 5.0, 4.0, 6.0]), np.array([3.0, 2.0, 5.0, 4.0, 6.0]) + 0.6)
    assert bool(arrivals._exchanged(late))
    assert arrivals._exchanged(arrived(distance_m, distance_m + 0.2 * np.eye(4)[0])) == ()
