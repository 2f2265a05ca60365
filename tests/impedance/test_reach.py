"""Intervals of a wall's quantities: by draws of R0, by differences, and from where on shown."""

from __future__ import annotations

import numpy as np
import pytest

from roomfit.impedance.laws import absorption_normal, absorption_random, impedance_of_r0
from roomfit.impedance.result import (
    material_impedance,
)

SPREAD = np.array([[4.0, 1.0], [1.0, 2.0]])


@pytest.mark.parametrize("r0", [0.6 - 0.3j, -0.2 + 0.5j, 0.05 + 0.02j])
def test_small_errors_of_r0_reach_as_far_as_the_derivatives_say(r0):
    """1.96 standard deviations of each quantity by 20,000 draws, known to 2 %."""
    covariance = 1e-6 * SPREAD
    found = material_impedance("wall", "spline", np.array([r0]), covariance[None])
    off = np.random.default_rng(1).multivariate_normal([0.0, 0.0], covariance, size=20_000)
    drawn = r0 + off[:, 0] + 1j * off[:, 1]
    for name, values in (
        ("r0", drawn),
        ("absorption_normal", absorption_normal(drawn)),
        ("absorption_random", absorption_random(drawn)),
        ("admittance", (1.0 - drawn) / (1.0 + drawn)),
        ("impedance", impedance_of_r0(drawn)),
    ):
        middle = getattr(found, name)[0]
        low, high = getattr(found, f"{name}_lower95")[0], getattr(found, f"{name}_upper95")[0]
        own = np.trace(covariance) if name == "absorption_normal" else 0.0
        for part, extra in (("real", own), ("imag", 0.0)):
            reach = 1.96 * np.std(getattr(values, part))
            above = float(getattr(np.asarray(high - middle), part))
            below = float(getattr(np.asarray(middle - low), part))
            assert above == pytest.approx(reach, rel=0.03, abs=1e-9), (name, part)
            assert below == pytest.approx(reach + extra, rel=0.03, abs=1e-9), (name, part)
    assert found.identified[0] and found.impedance_shown[0]


def test_a_wall_is_identified_to_a_fifth_of_r0_and_its_impedance_shown_to_a_fifth_of_itself():
    """Of the wider of both parts; else it is no number. Walls stay passive."""
    r0 = np.array([0.5 + 0.0j])
    for share, is_identified in ((0.999, True), (1.001, False)):
        for part in (0, 1):
            variance = np.full(2, 1e-10)
            variance[part] = (share * 0.1 / 1.959964) ** 2
            found = material_impedance("wall", "spline", r0, np.diag(variance)[None])
            assert bool(found.identified[0]) is is_identified
    # z = 3, and dz = 2 / 0.25 dR0 = 8 dR0: a half width of 0.3 is one of 0.0375
    for share, is_shown in ((0.999, True), (1.001, False)):
        variance = np.array([(share * 0.0375 / 1.959964) ** 2, 1e-10])
        found = material_impedance("wall", "spline", r0, np.diag(variance)[None])
        assert bool(found.impedance_shown[0]) is is_shown
        assert bool(np.isfinite(found.impedance[0])) is is_shown
        assert bool(np.isfinite(found.impedance_upper95[0])) is is_shown
    wide = material_impedance("wall", "spline", np.array([0.9 - 0.9j]), np.eye(2)[None])
    assert wide.r0_upper95[0] == 1.0 + 1.0j and wide.r0_lower95[0].imag == -1.0
    assert wide.absorption_normal_lower95[0] == 0.0 and wide.absorption_random_upper95[0] == 1.0
    for name in ("r0", "absorption_normal", "impedance", "identified"):
        assert not getattr(wide, name).flags.writeable
    for edge in (1.0, -1.0):
        rigid = material_impedance("wall", "spline", np.array([edge + 0j]), 1e-6 * np.eye(2)[None])
        assert np.isfinite(rigid.admittance[0]) and not np.isnan(rigid.absorption_random[0])
