"""The line of noise and single reflections, computed once more from plain numbers."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import nnls
from scipy.signal import butter, sosfilt
from scipy.special import digamma, polygamma

from roomfit.diagnostics import noise_tail
from roomfit.diagnostics.noise_tail import _Levels
from roomfit.diagnostics.reflections import IsolatedReflection, _wall, wall_returns
from roomfit.signals.response import ImpulseResponse

RING_PER_S = 20.0


def levels_of(seed: int, rate: float = 4.0, share: float = 0.0, n_before: int = 3) -> Any:
    """Return levels of a file: a line, reverberation at its end, and scatter by its variance."""
    rng = np.random.default_rng(seed)
    time_s = np.append(np.linspace(0.0, 0.01, n_before), np.linspace(0.6, 0.8, 8))
    variance = rng.uniform(0.01, 0.04, time_s.size)
    since_s = time_s - time_s[-8]
    ringing = np.where(since_s >= 0.0, np.exp(-RING_PER_S * np.maximum(since_s, 0.0)), 0.0)
    level = -rate * time_s + share * ringing + np.sqrt(variance) * rng.normal(size=time_s.size)
    return _Levels(time_s, level - 7.0 + seed, variance, 0.02, 3.0 + seed)


@pytest.mark.parametrize("share", [0.0, 0.8, -0.8])
def test_the_line_of_all_files_is_that_of_weighted_least_squares(share):
    """A height each, one rate, and one share of reverberation that is not negative."""
    files = [levels_of(seed, share=share) for seed in (1, 2, 3)]
    columns, level = [], np.concatenate([f.level for f in files])
    root = 1.0 / np.sqrt(np.concatenate([f.variance for f in files]))
    for i, f in enumerate(files):
        since_s = f.time_s - f.time_s[-8]
        ringing = np.exp(-RING_PER_S * np.abs(since_s)) * (since_s >= 0.0)
        columns.append(np.column_stack((np.tile(np.eye(3)[i], (11, 1)), -f.time_s, ringing)))
    matrix = np.concatenate(columns)
    # heights may have either sign, the share of reverberation may not
    both = np.column_stack((matrix[:, :4], -matrix[:, :4], matrix[:, 4]))
    solution, norm = nnls(root[:, None] * both, root * level)
    covariance = np.linalg.inv((root[:, None] * matrix).T @ (root[:, None] * matrix))
    rate, sd, chi2, n_free = noise_tail._least_squares(
        files, [-f.time_s for f in files], RING_PER_S
    )
    assert rate == pytest.approx(solution[3] - solution[7], rel=1e-6)
    assert share == 0.0 or bool(solution[8] == 0.0) is (share < 0.0)
    assert sd == pytest.approx(np.sqrt(covariance[3, 3]), rel=1e-9)
    assert chi2 == pytest.approx(norm**2, rel=1e-6)
    assert n_free == 33 - 3 - 2


def test_a_line_has_its_dispersion_its_excess_and_its_gain_over_steady_noise():
    """Dispersion widens the deviation where it exceeds 1; straight up to chance, or three times."""
    for seeds, dispersion, is_straight in (
        ((1, 2, 3), 0.5, True),
        ((1, 2, 3), 2.99, True),
        ((1, 2, 3), 3.01, False),
        # chi-square of eight at a thousandth is 26.12
        ((1,), 3.26, True),
        ((1,), 3.27, False),
    ):
        files = [levels_of(seed) for seed in seeds]
        *_, chi2, n_free = noise_tail._least_squares(files, [-f.time_s for f in files], RING_PER_S)
        grown = np.sqrt(dispersion * n_free / chi2)
        files = [f._replace(level=grown * (f.level + 4.0 * f.time_s) - 4.0 * f.time_s)
                 for f in files]  # fmt: skip
        line = noise_tail._fitted(files, RING_PER_S, 25.0)
        rate, sd, chi2, n_free = noise_tail._least_squares(
            files, [-f.time_s for f in files], RING_PER_S
        )
        assert line.rate_per_s == rate and line.n_free == n_free
        assert line.dispersion == pytest.approx(dispersion) == chi2 / n_free
        assert line.sd == pytest.approx(sd * np.sqrt(max(chi2 / n_free, 1.0)))
        assert line.is_straight is is_straight
        excess = []
        for f in files:
            weights = 1.0 / f.variance
            at_early = np.average(f.level + rate * (f.time_s - 0.02), weights=weights)
            excess.append(f.early - at_early)
        assert line.excess == pytest.approx(np.median(excess))
        steady = noise_tail._steady_chi2(files, 25.0)
        gain = 0.5 * (steady - chi2) / max(chi2 / n_free, 1.0)
        assert line.over_steady == pytest.approx(gain)


def test_steady_noise_is_tried_with_reverberation_of_every_size_and_rate():
    """Loop by loop: levels of each file after the sound, and others of its own before it."""
    files = [levels_of(seed, share=1.0) for seed in (1, 2)]
    best = np.inf
    for slower in np.linspace(0.4, 1.0, 7):
        for over in np.geomspace(0.01, 100.0, 41):
            total = 0.0
            for f in files:
                after = f.time_s[-8:] - f.time_s[-8]
                rest = f.level[-8:] - np.log1p(over * np.exp(-slower * RING_PER_S * after))
                weights = 1.0 / f.variance[-8:]
                total += np.sum(weights * (rest - np.average(rest, weights=weights)) ** 2)
            best = min(best, total)
    for f in files:
        weights = 1.0 / f.variance[:-8]
        off = f.level[:-8] - np.average(f.level[:-8], weights=weights)
        best += np.sum(weights * off**2)
    assert noise_tail._steady_chi2(files, RING_PER_S) == pytest.approx(best, rel=1e-9)


def noisy(n: int, rate_hz: float, direct: int, first: int = 0, n_silent: int = 0) -> Any:
    """Return a file of noise, silent at its ends, whose direct sound comes at a sample."""
    pressure = np.random.default_rng(3).normal(size=n)
    pressure[:first] = 0.0
    pressure[n - n_silent :] = 0.0
    response = ImpulseResponse(pressure, rate_hz)
    return SimpleNamespace(response=response, direct_s=direct / rate_hz)


@pytest.mark.parametrize("direct", [100, 400])
def test_levels_of_a_file_are_those_of_its_blocks_filtered_by_scipy(direct):
    """Of a millisecond, eight at most, until 3 ms before; eight of a share of what follows."""
    rate_hz, first, n_silent = 8000.0, 7, 11
    m = noisy(2000, rate_hz, direct, first, n_silent)
    found = noise_tail._levels(m, 0.25)
    x = sosfilt(butter(4, 500.0, btype="high", fs=rate_hz, output="sos"), m.response.pressure)
    x = sosfilt(butter(8, 0.25 * rate_hz, fs=rate_hz, output="sos"), x)
    begin, stop, end = first + 4, direct - 24, 2000 - n_silent
    n_before = min((stop - begin) // 8, 8)
    size = int(0.25 * (end - direct)) // 8
    edges = np.linspace(begin, stop, n_before + 1).astype(int).tolist()
    blocks = list(pairwise(edges))
    blocks += [(a, a + size) for a in range(end - 8 * size, end, size)]
    assert found.time_s.size == n_before + 8
    middle_s = [0.5 * (a + b) / rate_hz for a, b in blocks]
    np.testing.assert_allclose(found.time_s, middle_s, rtol=1e-12)
    power = np.abs(np.fft.rfft(x[end - 8 * size :])) ** 2
    power = np.convolve(power, np.ones(17) / 17, "same")
    per_sample = power.sum() ** 2 / (power.size * np.sum(power**2))
    for (a, b), level, variance in zip(blocks, found.level, found.variance, strict=True):
        half_free = 0.5 * (b - a) * per_sample
        mean = digamma(half_free) - np.log(half_free)
        assert level == pytest.approx(np.log(np.mean(x[a:b] ** 2)) - mean, abs=1e-6)
        assert variance == pytest.approx(float(polygamma(1, half_free)), rel=1e-6)
    assert found.early_s == pytest.approx((direct + 80) / rate_hz)
    assert found.early == pytest.approx(np.log(np.mean(x[direct : direct + 160] ** 2)), abs=1e-6)


@pytest.mark.parametrize(
    ("rate_hz", "direct", "is_enough"),
    # two blocks of a millisecond end 3 ms before the direct sound, and begin half a millisecond in
    [(8000.0, 44, True), (8000.0, 43, False), (4000.0, 100, True), (3999.0, 100, False)],
)
def test_a_file_tells_of_noise_from_two_blocks_before_its_sound_and_from_4_khz_on(
    rate_hz, direct, is_enough
):
    found = noise_tail._levels(noisy(1500, rate_hz, direct), 0.4)
    assert (found is not None) is is_enough


def test_a_first_reflection_is_of_the_wall_towards_which_it_turns():
    """Of a shoebox by the largest component and its sign; elsewhere by its material."""
    room: Any = SimpleNamespace(shoebox_m=np.ones(3), materials=("plaster", "wood"))
    for axis, names in enumerate((("west", "east"), ("south", "north"), ("floor", "ceiling"))):
        for sign, name in zip((-1.0, 1.0), names, strict=True):
            towards = np.array([0.5, -0.5, 0.5])
            towards[axis] = sign * 2.0
            assert _wall(room, towards, 1) == name
    assert _wall(SimpleNamespace(shoebox_m=None, materials=room.materials), towards, 1) == "wood"


def test_what_a_wall_returns_is_the_weighted_mean_of_its_reflections_with_all_their_errors():
    """Scatter beyond the deviations widens them; 1 dB by source, 0.1 by angle; two or more."""

    def of(values, sds, sources=("S1", "S1", "S2"), wall="floor", band=1):
        rows = zip(values, sds, sources, strict=False)
        return [IsolatedReflection(s, "R", wall, "wood", band, v, sd, 0.7) for v, sd, s in rows]

    measured: Any = SimpleNamespace(
        directivities={"S1": "known", "S2": None},
        scene=SimpleNamespace(room=SimpleNamespace(materials=("plaster", "wood"))),
    )
    scattering = np.array([[0.0, 0.5], [0.3, 0.2]])

    def expected(values, sds, n_sources):
        w = 1.0 / np.square(sds)
        mean = np.sum(w * values) / w.sum()
        excess = np.sum(w * (values - mean) ** 2) / (len(values) - 1)
        variance = max(excess, 1.0) / w.sum()
        variance += max(mean, 0.0) * 0.7 * (np.log(10.0) / 10.0) ** 2 / n_sources
        return 1.0 - mean / 0.8, np.sqrt(variance / 0.8**2 + 0.01)

    for values, sds in (
        ((0.5, 0.52, 0.49), (0.05, 0.1, 0.08)),
        ((0.2, 0.6, 0.9), (0.05, 0.1, 0.08)),
        ((-0.2, -0.1, -0.15), (0.05, 0.1, 0.08)),
    ):
        alone = of(values[:1], sds, wall="west")
        (found,) = wall_returns([*of(values, sds), *alone], measured, scattering)
        absorption, sd = expected(np.array(values), np.array(sds), 2)
        assert (found.wall, found.material, found.band, found.number) == ("floor", "wood", 1, 3)
        assert found.absorption == pytest.approx(absorption, rel=1e-12)
        assert found.sd == pytest.approx(sd, rel=1e-12)
        assert found.has_directivity is False
    (found,) = wall_returns(of((0.5, 0.6), (0.1, 0.1)), measured, scattering)
    assert found.has_directivity is True and found.number == 2
    assert found.sd == pytest.approx(expected(np.array([0.5, 0.6]), np.array([0.1, 0.1]), 1)[1])
    two_bands = [*of((0.5, 0.6), (0.1, 0.1), band=0), *of((0.5, 0.6), (0.1, 0.1))]
    assert [r.band for r in wall_returns(two_bands, measured, scattering)] == [0, 1]
