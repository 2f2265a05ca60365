"""What coverage draws anew: positions, directivities and levels, each by its own law."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from roomfit.air import Air
from roomfit.bands import bands_between
from roomfit.coverage import estimate
from roomfit.coverage.synthetic_room import _b, _levels, _moved
from roomfit.errors import InputError
from roomfit.geometry.mesh import shoebox_mesh
from roomfit.response.directivity import UnknownDirectivity
from roomfit.scene import Point

N = 4000  # a standard deviation of so many errs by 1.1 %: four times that


@pytest.mark.parametrize(("stated", "sd_m"), [(0.1, 0.1), (None, 0.02)])
def test_a_point_is_moved_by_its_stated_deviation_or_by_two_centimetres(stated, sd_m):
    point, rng = Point("S", (1.0, 2.0, 3.0), position_sd_m=stated), np.random.default_rng(2)
    away = np.array([_moved(point, rng).position_m for _ in range(N)]) - point.position_m
    np.testing.assert_allclose(away.std(axis=0), sd_m, rtol=0.045)
    assert np.abs(away.mean(axis=0)).max() < 4.0 * sd_m / np.sqrt(N)


def test_a_directivity_is_drawn_about_its_mean_and_no_amplitude_is_negative():
    """A long vector is cut to length 1, of a cardioid; known sources have none."""
    near = UnknownDirectivity(mean=np.array([0.3, 0.0, -0.2]), sd=0.05)
    plan = SimpleNamespace(
        directivities={"S": near, "T": UnknownDirectivity(sd=20.0)},
        campaign=SimpleNamespace(path="campaign.toml"),
    )
    rng = np.random.default_rng(3)
    drawn = np.array([_b(plan, "S", rng) for _ in range(N)])
    np.testing.assert_allclose(drawn.std(axis=0), 0.05, rtol=0.045)
    assert np.abs(drawn.mean(axis=0) - near.mean).max() < 4.0 * 0.05 / np.sqrt(N)
    lengths = [float(np.linalg.norm(_b(plan, "T", rng))) for _ in range(200)]
    assert max(lengths) == pytest.approx(1.0, rel=1e-12)
    assert np.mean(np.isclose(lengths, 1.0)) > 0.9
    assert _b(plan, "another", rng) is None
    plan.directivities["U"] = UnknownDirectivity(loudspeaker="box")
    with pytest.raises(InputError, match="several sources share"):
        _b(plan, "U", rng)


def test_levels_are_of_a_source_of_a_file_or_known():
    """Files of one source share its level; an absolute one has none to draw."""
    levels = ("per-source", "per-source", "per-file", "per-file", "absolute")
    files = [
        SimpleNamespace(level=level, source=source)
        for level, source in zip(levels, "SSSTT", strict=True)
    ]
    plan = SimpleNamespace(
        campaign=SimpleNamespace(
            measurements=files, sources=[SimpleNamespace(name="S"), SimpleNamespace(name="T")]
        ),
        grid=np.zeros(3),
    )
    found = _levels(plan, np.random.default_rng(4))
    assert found.shape == (5, 3)
    np.testing.assert_array_equal(found[0], found[1])
    np.testing.assert_array_equal(found[4], 0.0)
    assert len({*found[0], *found[2], *found[3]}) == 9


def test_without_an_answer_the_absorption_is_that_of_eyring_of_the_measured_decay(monkeypatch):
    """4 V ln(1e6) / (c S T) is its exponent; of the median of T20, else T30, else of the priors."""
    lengths_m, speed_m_s = (6.0, 5.0, 3.0), 343.0
    volume_m3, surface_m2 = 90.0, 126.0
    air = Air(attenuation="none")
    prior = np.array([[0.1, 0.2, 0.3], [0.3, 0.4, 0.7]])
    monkeypatch.setattr(estimate, "_prior_middle", lambda _plan: prior)
    plan = SimpleNamespace(
        room=SimpleNamespace(mesh=shoebox_mesh(lengths_m)),
        campaign=SimpleNamespace(air=air, bands=bands_between("octave", 500, 2000)),
    )

    def pair(**times):
        found = {n: SimpleNamespace(measured=np.array(row)) for n, row in times.items()}
        return SimpleNamespace(parameters=found)

    nan = np.nan
    pairs = [
        pair(T20_s=[0.5, nan, nan], T30_s=[9.0, 0.8, nan]),
        pair(T20_s=[0.6, nan, nan], T30_s=[9.0, 0.8, nan], EDT_s=[9.0, 9.0, nan]),
        pair(T20_s=[4.0, nan, nan]),
    ]
    answer = SimpleNamespace(pairs=pairs, speed_of_sound_m_s=speed_m_s)
    found = estimate._uniform(plan, answer)
    times_s = np.array([0.6, 0.8])
    eyring = -np.expm1(-4.0 * volume_m3 * np.log(1e6) / (speed_m_s * surface_m2 * times_s))
    np.testing.assert_allclose(found, [*eyring, 0.5], rtol=1e-9)
