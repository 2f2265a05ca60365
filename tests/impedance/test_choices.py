"""What is chosen of curves, laws and verdicts, by made-up numbers on both sides of each limit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from roomfit.base.errors import InputError
from roomfit.impedance.fit import WallModel
from roomfit.impedance.laws import CausalCurve, as_spline, causal_curve, constant, spline
from simulated_rooms.wall_impedances import miki_material


def damped(f: Any, tau_s: float = 0.01) -> Any:
    return np.asarray(f, dtype=float) - 0.5j / (np.pi * tau_s)


def test_a_material_by_miki_has_his_numbers_at_one_and_his_powers_elsewhere():
    own, wave = miki_material(np.array([1.0 + 0j, 0.1, 0.01]))
    assert own[0] == 1.070 - 0.107j and wave[0] == 1.109 - 0.160j
    np.testing.assert_allclose((own[1:] - 1.0) / (own[0] - 1.0), 10.0 ** np.array([0.632, 1.264]))
    np.testing.assert_allclose((wave[1:] - 1.0) / (wave[0] - 1.0), 10.0 ** np.array([0.618, 1.236]))


@pytest.mark.parametrize(
    ("low", "high", "n"),
    # every quarter octave, but 25 Hz apart: 100, 125, 150, 178, 212, ..., 504
    [(400.0, 1500.0, 9), (100.0, 500.0, 10), (50.0, 150.0, 5)],
)
def test_a_spline_has_knots_a_quarter_octave_or_25_hz_apart_and_adds_to_one(low, high, n):
    """Two functions more than knots; no second difference of what is straight."""
    f = np.arange(low, high + 1.0, 5.0)
    curve = spline(f, 0.3 - 0.4j)
    assert curve.basis.shape == (f.size, n + 2)
    np.testing.assert_allclose(curve.basis.sum(axis=1), 1.0, rtol=1e-12)
    np.testing.assert_allclose(curve.r0(curve.start), 0.3 - 0.4j, rtol=1e-12)
    line = np.arange(n + 2.0)
    assert curve.roughness.shape == (2 * n, 2 * n + 4)
    np.testing.assert_allclose(curve.roughness @ np.tile(line, 2), 0.0, atol=1e-12)
    bent = np.zeros(2 * n + 4)
    bent[3] = 1.0
    assert sorted(curve.roughness[:n] @ bent)[:2] == [-2.0, 0.0] and not np.any(
        curve.roughness[n:] @ bent
    )
    # where it must be passive: at the frequencies, and at eight points a knot besides
    dense, slope = curve.between(curve.start)
    assert len(dense) == f.size + 8 * n and slope.shape == (len(dense), 2 * n + 4)
    np.testing.assert_allclose(dense, 0.3 - 0.4j, rtol=1e-12)
    level = constant(f, 0.2 + 0.1j)
    np.testing.assert_allclose(level.r0(level.start), 0.2 + 0.1j)
    assert level.kind == "constant" and level.basis.shape == (f.size, 1)
    assert level.roughness.shape == (0, 2)


@pytest.mark.parametrize("f", [np.arange(100.0, 1001.0, 25.0), np.array([100.0, 200, 400, 800])])
def test_a_density_reaches_three_octaves_beyond_the_data_by_two_knots_an_octave(f):
    """Coefficients of a straight line are its abscissae; of few frequencies fewer knots."""
    curve = causal_curve(damped(f))
    assert isinstance(curve, CausalCurve)
    free = spline(f)
    n_inner = free.basis.shape[1] - 2
    at = curve.log_coefficients
    assert len(at) == n_inner + 12 + 2
    middle = 0.5 * np.log(f[0] * f[-1])
    assert at[0] == pytest.approx(np.log(f[0] / 8.0) - middle)
    assert at[-1] == pytest.approx(np.log(f[-1] * 8.0) - middle)
    half = 0.5 * np.log(2.0)
    np.testing.assert_allclose(np.diff(at[2:6]), half)
    np.testing.assert_allclose(curve.density.sum(axis=1), 1.0, rtol=1e-12)
    np.testing.assert_allclose(
        curve.roughness[:, : len(at)], np.diff(np.eye(len(at)), 2, axis=0), atol=0
    )
    assert not curve.roughness[:, len(at) :].any()
    assert as_spline(curve).basis is curve.basis and as_spline(free) is free
    # at 0.03 of a unit the factor departs by a thousandth
    x = curve.start
    n = len(at)
    x[n : n + free.basis.shape[1]] += 1.0
    y = [(1.0 - r) / (1.0 + r) for r in (curve.r0(curve.start), curve.r0(x))]
    np.testing.assert_allclose(y[1] / y[0], np.exp(0.03), rtol=1e-9)
    turned = curve.start
    turned[n + free.basis.shape[1] :] += 1.0
    there = curve.r0(turned)
    np.testing.assert_allclose((1.0 - there) / (1.0 + there) / y[0], np.exp(0.03j), rtol=1e-9)


def test_a_wall_may_start_as_one_that_gives_back_all_and_no_more():
    for start_r0 in (1.0, -1.0, 1.0j, 0.6 - 0.8j):
        assert WallModel(start_r0=start_r0).start_r0 == start_r0
    with pytest.raises(InputError, match="more than it receives") as caught:
        WallModel(start_r0=0.8 + 0.7j)
    assert "|R0| = 1.063" in str(caught.value)
