"""Whether echoes agree with the specified outline: boxes described correctly and wrongly."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d
from scipy.signal import butter, hilbert, sosfiltfilt

from roomfit.base.air import Air
from roomfit.base.findings import Code
from roomfit.checks.walls import outline_findings
from roomfit.demo.boxes import SyntheticBox, add_noise, pressure_response
from roomfit.files.rooms import read_room
from roomfit.files.schema import RoomSpec
from roomfit.room.scene import Point, Scene
from roomfit.signals.response import ImpulseResponse, echo_prominence

C = 343.0
RATE_HZ = 16_000.0
CENTRES_HZ = 125.0 * 2.0 ** np.arange(7)


def specified_and_observed(
    seed: int, specified_m: tuple[float, float, float], true_m=(6.0, 5.0, 3.0)
):
    """Return a scene with the specified outline and responses of the true one, origin shared."""
    rng = np.random.default_rng(seed)
    truth = SyntheticBox(true_m, CENTRES_HZ, rng.uniform(0.1, 0.5, (6, 7)), np.zeros(7), C)
    low, high = np.full(3, 0.7), np.minimum(specified_m, true_m) - 0.7
    sources = [Point(f"S{i}", rng.uniform(low, high)) for i in range(2)]
    receivers = [Point(f"R{i}", rng.uniform(low, high)) for i in range(5)]
    room, _ = read_room(RoomSpec(shoebox=specified_m))
    pairs = [(s, r) for s in range(2) for r in range(5)]
    air = Air(speed_of_sound_m_s=C)
    scene = Scene(room, tuple(sources), tuple(receivers), np.array(pairs), air)
    responses = []
    for number, (s, r) in enumerate(pairs):
        at = sources[s].position_m, receivers[r].position_m
        pressure = pressure_response(truth, *at, 0.12, RATE_HZ, np.zeros(7))
        responses.append((number, ImpulseResponse(add_noise(pressure, -50.0, rng), RATE_HZ)))
    return scene, responses


@pytest.mark.parametrize("seed", range(1, 9))
def test_a_room_described_correctly_raises_no_doubt(seed):
    """No false alarm in eight seeded rooms; there was none in a hundred either."""
    assert outline_findings(*specified_and_observed(seed, (6.0, 5.0, 3.0))) == ()


@pytest.mark.parametrize(
    ("specified_m", "surface", "metres"),
    [
        ((6.5, 5.0, 3.0), "east", -0.5),
        ((6.0, 4.4, 3.0), "north", 0.6),
        ((6.0, 5.0, 3.4), "ceiling", -0.4),
        ((8.5, 5.0, 3.0), "east", -2.5),
    ],
)
def test_a_wall_described_wrongly_is_named_with_its_distance(specified_m, surface, metres):
    (finding,) = outline_findings(*specified_and_observed(3, specified_m))
    assert finding.code == Code.WALL_POSITION_MISMATCH
    assert finding.evidence["surface"] == surface
    assert finding.evidence["metres_outward"] == pytest.approx(metres, abs=0.05)
    assert surface in finding.sentence


def test_few_responses_are_not_examined():
    """Two sources and five pairs tell the wall; with four, one of 196 right rooms was doubted."""
    scene, responses = specified_and_observed(3, (6.5, 5.0, 3.0))
    five = responses[:3] + responses[5:7]
    (finding,) = outline_findings(scene, five)
    assert finding.evidence["surface"] == "east"
    assert outline_findings(scene, five[1:]) == ()


@pytest.mark.parametrize("rate_hz", [8_000.0, 44_100.0])
def test_prominence_is_that_of_a_butterworth_filter_forth_and_back(rate_hz):
    """By scipy's own filters, with silence about the file; nothing wraps from end to beginning."""
    rng, n = np.random.default_rng(6), round(0.4 * rate_hz)
    pressure = rng.standard_normal(n) * np.exp(-20.0 * np.arange(n) / rate_hz)
    pressure[: n // 10] *= 1e-3
    edges_hz = (800.0, min(8000.0, 0.45 * rate_hz))
    band = butter(4, edges_hz, btype="band", fs=rate_hz, output="sos")
    squared = np.abs(hilbert(sosfiltfilt(band, np.pad(pressure, n))))[n:-n] ** 2
    energy = uniform_filter1d(squared, max(round(3e-4 * rate_hz), 1))
    level = np.log(energy + 1e-9 * energy.max())
    expected = level - uniform_filter1d(level, round(0.01 * rate_hz))
    found = echo_prominence(ImpulseResponse(pressure, rate_hz))
    np.testing.assert_allclose(found, expected, atol=1e-6)
