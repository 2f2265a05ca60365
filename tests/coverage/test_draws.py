"""What coverage draws anew: positions, directivities and levels, each by its own law."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from roomfit.air import Air
from roomfit.bands import bands_between
from roomfit.coverage import estimate, simulate, synthetic_room
from roomfit.coverage.synthetic_room import (
    CoverageSettings,
    _b,
    _levels,
    _moved,
    synthetic_bands,
)
from roomfit.errors import InputError, StoreError
from roomfit.geometry.mesh import shoebox_mesh
from roomfit.response.directivity import UnknownDirectivity
from roomfit.scene import Point
from roomfit.workers import worker_pool

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


def test_what_an_error_drives_out_of_the_possible_range_is_clipped_or_left_out():
    """Shares of energy to 0 and 100 %; times of zero or less are none; levels are any number."""
    values = np.array([-3.0, 0.0, 55.0, 104.0])
    for name, expected in (
        ("D50_percent", [0.0, 0.0, 55.0, 100.0]),
        ("C80_dB", values),
        ("T30_s", [np.nan, np.nan, 55.0, 104.0]),
    ):
        np.testing.assert_array_equal(simulate._possible(name, values), expected)


def test_rays_become_noise_by_the_energies_of_their_milliseconds_and_images_become_clicks(
    monkeypatch,
):
    """Of one pair alone; each ray in the bin in which it arrives, in every band by itself."""
    rate_hz, n = 8000.0, 800
    bands, rng = bands_between("octave", 500, 1000), np.random.default_rng(5)
    times_s = np.array([0.010, 0.0305, 0.0309, 0.0999, 0.0500, 0.020])
    energy = rng.random((2, 6))
    own = np.array([True, True, True, True, False, True])
    images = np.array([True, False, False, False, False, False])
    given = []

    def noise(*arguments):
        given.extend(arguments)
        return np.full(n, 0.25)

    monkeypatch.setattr(simulate, "modulated_noise", noise)
    plan = SimpleNamespace(grid=bands)
    found = simulate._pressure(plan, times_s, energy, own, images, n, rate_hz, rng)
    echogram, *rest = given
    size_s = simulate.ECHOGRAM_BIN_S
    expected = np.zeros((2, int(np.ceil(n / rate_hz / size_s)) + 1))
    for i in (1, 2, 3, 5):
        expected[:, int(times_s[i] / size_s)] += energy[:, i]
    np.testing.assert_allclose(echogram, expected, rtol=1e-14)
    assert rest[:3] == [n, rate_hz, bands.centres_hz] and rest[4] is rng
    np.testing.assert_array_equal(rest[3], np.zeros(2))
    # without rays there is the click alone, at its time
    click = simulate._pressure(plan, times_s, energy, own & images, images, n, rate_hz, rng)
    assert np.argmax(np.abs(click)) == round(0.010 * rate_hz)
    np.testing.assert_allclose(found, click + 0.25, rtol=1e-12)
    # twice the pressure is four times the energy
    twice = simulate._pressure(plan, times_s, 4.0 * energy, own & images, images, n, rate_hz, rng)
    np.testing.assert_allclose(twice, 2.0 * click, rtol=1e-9)


def test_the_energy_of_a_path_is_its_weight_less_walls_air_and_directivity(monkeypatch):
    """Written out; a wall of absorption 1 leaves nothing, and bands have their own factors."""
    attenuation = np.array([0.001, 0.002, 0.01])
    monkeypatch.setattr(simulate, "attenuation_per_m", lambda _air, _grid: attenuation)
    counts = np.array([[0, 1], [2, 3], [1, 0]])
    monkeypatch.setattr(simulate, "hits", lambda _paths: counts)

    class Three(SimpleNamespace):
        def __len__(self):
            return 3

    paths = Three(length_m=np.array([3.0, 20.0, 8.0]), weight_per_m2=np.array([0.1, 0.02, 0.03]))
    absorption = np.array([[0.1, 0.3, 1.0], [0.5, 0.2, 0.4]])
    factors = np.array([[1.0, 2.0, 0.5], [3.0, 0.1, 1.5]])
    plan = SimpleNamespace(
        campaign=SimpleNamespace(air=None), grid=np.zeros(3), nearest=np.array([0, 0, 1])
    )
    room = SimpleNamespace(absorption=absorption)
    for own in (None, factors):
        found = simulate._energies(plan, room, paths, own)
        for band, path in np.ndindex(3, 3):
            left = np.prod((1.0 - absorption[:, band]) ** counts[path])
            left *= paths.weight_per_m2[path] * np.exp(-attenuation[band] * paths.length_m[path])
            left *= 1.0 if own is None else own[plan.nearest[band], path]
            assert found[band, path] == pytest.approx(left, rel=1e-12, abs=1e-30)


@pytest.mark.parametrize("scheduler", [None, "tcp://there"])
def test_replicates_that_are_missing_are_each_made_once_by_workers_or_a_cluster(
    tmp_path, monkeypatch, scheduler
):
    """With the seed and the number; progress is their share. One that fails calls off the rest."""
    made, written, pools, done = [], [], [], []

    def replicated(_plan, seed, number, scratch, watch):
        watch(0.0)
        made.append((seed, number))
        if number == 9:
            raise InputError("no such replicate", found="9", needed="less", hint="less")
        return SimpleNamespace(number=number, seconds=100.0)

    def pool_of(*workers, **more):
        pools.append((workers, more))
        return worker_pool(1)

    monkeypatch.setattr(estimate, "replicated", replicated)
    monkeypatch.setattr(estimate, "write_replicate", lambda out, r: written.append((out, r.number)))
    monkeypatch.setattr(estimate, "worker_pool", pool_of)
    monkeypatch.setattr(estimate, "cluster_pool", pool_of)
    kept = []
    monkeypatch.setattr(estimate, "keep_one_thread", lambda: kept.append(1))
    monkeypatch.chdir(tmp_path)
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    settings = CoverageSettings(seed=5, workers=3 if scheduler is None else 1, scheduler=scheduler)
    simulated = partial(estimate._simulate, SimpleNamespace(), settings)
    simulated([2, 4, 7], Path("out"), scratch, done.append)
    assert made == [(5, 2), (5, 4), (5, 7)] and len(kept) == 3
    assert written == [(tmp_path / "out", n) for n in (2, 4, 7)]
    np.testing.assert_allclose(done, [1 / 3, 2 / 3, 1.0])
    compiled = {"scheduler": scheduler, "warm": estimate.compile_kernels}
    assert pools == [((3,), {}) if scheduler is None else ((), compiled)]
    with pytest.raises(InputError, match="no such replicate"):
        simulated([1, 9, 3], Path("out"), scratch, None)
    assert not scratch.exists()
    # where the folder has gone a worker stops
    with pytest.raises(StoreError, match="called off"):
        simulated([6], Path("out"), scratch, None)
    assert (5, 6) not in made


def test_one_process_makes_missing_replicates_in_order_each_with_its_part_of_progress(
    tmp_path, monkeypatch
):
    """Halves of a half each, where a replicate reports its middle and its end."""
    done, written = [], []

    def replicated(_plan, seed, number, scratch, share):
        assert (seed, scratch) == (1, tmp_path)
        share(0.5)
        share(1.0)
        return number

    monkeypatch.setattr(estimate, "replicated", replicated)
    monkeypatch.setattr(estimate, "write_replicate", lambda out, n: written.append((out, n)))
    settings = CoverageSettings(seed=1, workers=1)
    estimate._simulate(SimpleNamespace(), settings, [3, 8], Path("out"), tmp_path, done.append)
    assert written == [(Path("out"), 3), (Path("out"), 8)]
    np.testing.assert_allclose(done, [0.25, 0.5, 0.75, 1.0])


@pytest.mark.parametrize(
    ("kind", "low", "high", "expected"),
    [
        ("octave", 500, 1000, (250, 500, 1000, 2000)),
        ("octave", 1000, 1000, (500, 1000, 2000)),
        ("third-octave", 500, 800, (400, 500, 630, 800, 1000)),
    ],
)
def test_bands_of_a_simulation_reach_one_band_beyond_the_fitted_ones(kind, low, high, expected):
    found = synthetic_bands(bands_between(kind, low, high))
    assert found.kind == kind
    np.testing.assert_allclose(found.centres_hz, expected, rtol=0.01)


def test_settings_of_coverage_are_refused_beyond_their_limits_and_name_their_slice():
    """Each limit itself is taken."""
    most: dict[str, Any] = {"replicates": 100_000, "seed": 2**63 - 1, "workers": 1024}
    for own in (most, {"replicates": 1}, {"snr_db": 20.0}, {"snr_db": 90.0}, {"first": 199},
                {"seed": 0}, {"only": 200}, {"only": 1}):  # fmt: skip
        CoverageSettings(**own)
    for bad in ({"replicates": 100_001}, {"replicates": 0}, {"snr_db": 19.9}, {"snr_db": 90.1},
                {"first": 200}, {"first": -1}, {"seed": -1}, {"only": 201}, {"only": 0},
                {"workers": 0}, {"workers": 1025}, {"seed": 2**63}):  # fmt: skip
        with pytest.raises(InputError, match="out of range") as caught:
            CoverageSettings(**bad)
        assert next(iter(bad)).replace("_", "-") in str(caught.value)
    assert CoverageSettings(replicates=9, first=2, only=3).numbers == range(2, 5)
    assert CoverageSettings(replicates=4, first=2, only=3).numbers == range(2, 4)
    assert CoverageSettings(replicates=4, first=2).numbers == range(2, 4)


def test_errors_of_clocks_are_shared_by_the_files_of_a_source():
    """Of 20 microseconds from emission on where none is stated, of none from the direct sound."""

    def file(source, time_zero, sd=None):
        response = SimpleNamespace(time_zero=time_zero)
        return SimpleNamespace(source=source, response=response, latency_sd_s=sd)

    files = [
        file("S", "emission"), file("S", "emission", 1e-3), file("S", "direct", 1e-3),
        file("S", "unknown", 1e-3), file("T", "emission"),
    ]  # fmt: skip
    sources = [SimpleNamespace(name=n) for n in "ST"]
    plan = SimpleNamespace(campaign=SimpleNamespace(sources=sources, measurements=files))
    rng = np.random.default_rng(8)
    drawn = np.array([synthetic_room._latency_s(plan, rng) for _ in range(N)])
    np.testing.assert_allclose(
        drawn.std(axis=0), [2e-5, 1e-3, 0.0, 5e-3, 2e-5], rtol=0.045, atol=1e-12
    )
    np.testing.assert_allclose(drawn[:, 1], 50.0 * drawn[:, 0], rtol=1e-9)
    np.testing.assert_allclose(drawn[:, 3], 250.0 * drawn[:, 0], rtol=1e-9)
    assert abs(np.corrcoef(drawn[:, 0], drawn[:, 4])[0, 1]) < 4.0 / np.sqrt(N)


@pytest.mark.parametrize(
    ("kind", "per_octave", "correlation"),
    [("octave", None, 0.95), ("octave", 0.6, 1.0 - 0.5 * 0.16), ("octave", 9.0, 0.0),
     ("third-octave", None, 0.95 ** (1 / 3))],
)  # fmt: skip
def test_draws_run_over_the_bands_as_smoothly_as_the_campaign_states(kind, per_octave, correlation):
    """Standard normal in every band; 4,000 draws know a correlation to 5 (1 - r**2) / 63."""
    plan = SimpleNamespace(
        campaign=SimpleNamespace(settings=SimpleNamespace(smoothness_per_octave=per_octave)),
        grid=bands_between(kind, 500, 1000),
    )
    drawn = synthetic_room._smooth_normal(plan, 1.5, N, np.random.default_rng(9))
    np.testing.assert_allclose(drawn.std(axis=1).mean(), drawn.std(axis=1).mean())
    for a, b in zip(drawn.T[:-1], drawn.T[1:], strict=True):
        assert a.std() == pytest.approx(1.0, abs=5.0 / np.sqrt(2 * N))
        close = 5.0 * (1.0 - correlation**2) / np.sqrt(N)
        assert np.corrcoef(a, b)[0, 1] == pytest.approx(correlation, abs=close)


def test_scattering_is_one_draw_for_all_walls_but_those_that_are_specified():
    """Log-uniform from 0.02 to 0.4; of an answer what it was found with."""

    def prior(scattering=None, fit=False):
        return SimpleNamespace(fit_scattering=fit, scattering=scattering)

    own = np.array([0.1, 0.3])
    plan = SimpleNamespace(
        campaign=SimpleNamespace(bands=np.zeros(2)),
        priors=[prior(own), prior(), prior(own, fit=True)],
        answer=None,
    )
    rng = np.random.default_rng(10)
    drawn = np.array([synthetic_room._scattering(plan, rng) for _ in range(N)])
    np.testing.assert_array_equal(drawn[:, 0], np.tile(own, (N, 1)))
    np.testing.assert_array_equal(drawn[:, 1], drawn[:, 2])
    np.testing.assert_array_equal(drawn[:, 1, 0], drawn[:, 1, 1])
    logs = np.log(drawn[:, 1, 0])
    assert np.log(0.02) <= logs.min() < np.log(0.0202) and np.log(0.396) < logs.max() <= np.log(0.4)
    assert logs.mean() == pytest.approx(0.5 * np.log(0.008), abs=0.07)
    plan.answer = SimpleNamespace(scattering=np.array([[0.5, 0.5], [0.6, 0.6], [0.7, 0.7]]))
    found = synthetic_room._scattering(plan, rng)
    np.testing.assert_array_equal(found, [own, [0.6, 0.6], [0.7, 0.7]])


def test_a_sample_of_coverage_has_an_interval_where_a_material_was_free_and_a_band_fitted():
    """Known and tied materials have none; replicates without an answer are left out."""
    priors = [SimpleNamespace(known=k, tied_to=t) for k, t in
              ((None, None), (np.zeros(2), None), (None, "a"))]  # fmt: skip
    plan = SimpleNamespace(
        priors=priors,
        room=SimpleNamespace(materials=("a", "b", "c")),
        campaign=SimpleNamespace(bands=bands_between("octave", 500, 1000)),
        answer=SimpleNamespace(absorption=np.full((3, 2), 0.25)),
    )

    def replicate(n, models):
        a = np.full((3, 2), 0.1 * n)
        found = estimate.Found(a, 0.5 * a, 2.0 * a, a > 0.0, a[0], 3.0 * a[0], models, ())
        return SimpleNamespace(found=found, true=a + 0.01)

    answered = [replicate(1, ("energy", "prior")), replicate(2, ("coherent", "energy"))]
    found = estimate._coverage_sample(plan, answered)
    expected = np.zeros((2, 3, 2), dtype=bool)
    expected[:, 0] = [[True, False], [True, True]]
    np.testing.assert_array_equal(found.has_interval, expected)
    np.testing.assert_allclose(found.true[:, 0, 0], [0.11, 0.21])
    np.testing.assert_allclose(found.lower95[:, 1, 1], [0.05, 0.1])
    np.testing.assert_allclose(found.upper95[:, 1, 1], [0.2, 0.4])
    np.testing.assert_allclose(found.chi2_reduced[:, 0], [0.3, 0.6])
    np.testing.assert_array_equal(found.prior, np.full((3, 2), 0.25))
