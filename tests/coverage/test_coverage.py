"""`roomfit coverage`: rooms that are drawn, recordings that are simulated, what is counted."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest

from roomfit.base.bands import bands_between
from roomfit.base.cache import json_text, write_json_atomically
from roomfit.base.errors import InputError
from roomfit.base.findings import Code
from roomfit.cli.commands import estimate_coverage_to_folder
from roomfit.coverage.estimate import (
    CoverageResult,
    Found,
    Replicate,
    estimate_coverage,
    read_replicate,
    replicate_path,
    write_replicate,
)
from roomfit.coverage.output import coverage_figure, coverage_json
from roomfit.coverage.simulate import (
    BOX,
    CONVEX,
    TRACED,
    recorded,
    synthesis_of,
    synthetic_rate_hz,
    synthetic_sound,
    synthetic_table,
    traced_pressures,
)
from roomfit.coverage.statistics import (
    CoverageSample,
    coverage_at,
    coverage_rows,
    grouped_proportion,
    scaled_errors,
)
from roomfit.coverage.synthetic_room import (
    CoveragePlan,
    CoverageSettings,
    coverage_plan,
    draw_synthetic_room,
)
from roomfit.demo.boxes import add_noise, octave_shares
from roomfit.demo.polyhedra import convex_cells
from roomfit.files.campaign import read_campaign
from roomfit.files.iso3382 import read_parameters
from roomfit.files.rooms import read_room
from roomfit.files.rooms.model import RoomSpec
from roomfit.room.mesh import volume_m3
from simulated_rooms.polyhedral_rooms import (
    cell_volume_m3,
    l_shaped_cells,
    obj_text,
    paper_cells,
)
from small_campaign import run_command, small_responses, write_campaign, write_wav

CAMPAIGN = """
[room]
shoebox = [4.6, 3.7, 2.6]
[room.materials]
west = "plaster"
east = "plaster"
[air]
temperature_sd_c = 1.0
[materials.plaster]
scattering = 0.0
bounds = [0.05, 0.5]
[materials.south]
scattering = 0.0
[materials.north]
scattering = 0.0
same_absorption_as = "south"
[materials.floor]
scattering = 0.0
absorption = 0.3
[materials.ceiling]
scattering = 0.0
prior = {mean = 0.6, sd = 0.1}
[sources.LS1]
position = [1.2, 1.1, 1.3]
position_sd = 0.02
[receivers.MP1]
position = [3.3, 2.6, 1.5]
position_sd = 0.01
[receivers.MP2]
position = [3.4, 1.1, 0.9]
position_sd = 0.01
[[measurements]]
source = "LS1"
receiver = "MP1"
file = "not-measured-yet-1.wav"
[[measurements]]
source = "LS1"
receiver = "MP2"
file = "not-measured-yet-2.wav"
level = "absolute"
[identify]
from_hz = 1000
to_hz = 2000
"""


def campaign_file(folder: Path, text: str = CAMPAIGN) -> Path:
    file = folder / "campaign.toml"
    file.write_text(text)
    return file


def planned(folder: Path, text: str = CAMPAIGN) -> CoveragePlan:
    campaign = read_campaign(campaign_file(folder, text))
    return coverage_plan(campaign, CoverageSettings(snr_db=50.0))


def logit(a):
    return np.log(a) - np.log1p(-a)


# What is drawn.


def test_draws_have_the_spread_that_the_campaign_states(tmp_path):
    """400 draws: a mean is off by 4 standard errors once in 16,000, for 10 numbers each."""
    plan, rng = planned(tmp_path), np.random.default_rng(5)
    rooms = [draw_synthetic_room(plan, rng) for _ in range(400)]
    names = list(plan.room.materials)
    a = np.array([t.absorption for t in rooms])
    ceiling = logit(a[:, names.index("ceiling"), 1])
    sd = 0.1 / (0.6 * 0.4)
    assert abs(ceiling.mean() - logit(0.6)) < 4.0 * sd / np.sqrt(400)
    assert abs(ceiling.std() / sd - 1.0) < 4.0 / np.sqrt(800)
    broad = logit(a[:, names.index("south")])
    np.testing.assert_allclose(broad.std(axis=0), 1.5, rtol=4.0 / np.sqrt(800))
    # from one octave to the next, and two
    assert abs(np.corrcoef(broad[:, 0], broad[:, 1])[0, 1] - 0.95) < 0.025
    assert abs(np.corrcoef(broad[:, 0], broad[:, 2])[0, 1] - 0.95**2) < 0.05
    moved = np.array([t.receivers[0].position_m for t in rooms])
    np.testing.assert_allclose(moved.mean(axis=0), [3.3, 2.6, 1.5], atol=4e-2 / np.sqrt(400))
    np.testing.assert_allclose(moved.std(axis=0), 0.01, rtol=4.0 / np.sqrt(800))
    c = np.log([t.speed_of_sound_m_s for t in rooms])
    assert abs(c.std() / (0.5 / 293.15) - 1.0) < 4.0 / np.sqrt(800)


def test_what_is_known_tied_or_bounded_stays_so(tmp_path):
    plan, rng = planned(tmp_path), np.random.default_rng(6)
    names = list(plan.room.materials)
    for _ in range(20):
        synthetic = draw_synthetic_room(plan, rng)
        a = dict(zip(names, synthetic.absorption, strict=True))
        np.testing.assert_array_equal(a["floor"], 0.3)
        np.testing.assert_array_equal(a["north"], a["south"])
        assert np.all((a["plaster"] > 0.05) & (a["plaster"] < 0.5))
        np.testing.assert_array_equal(synthetic.level_db[1], 0.0)  # specified as absolute
        assert np.all(synthetic.level_db[0] != 0.0)
        assert not synthetic.scattering.any()
        assert not synthetic.delays_s.any()


def test_draws_about_an_answer_have_its_covariance(tmp_path):
    """South and ceiling go together in the answer; 400 draws, 4 standard errors."""
    plan = planned(tmp_path, CAMPAIGN.replace('same_absorption_as = "south"', ""))
    names = list(plan.room.materials)
    i, j = names.index("south"), names.index("ceiling")
    covariance = np.zeros((2, len(names), len(names)))
    covariance[:, [i, i, j, j], [i, j, i, j]] = [0.09, 0.05, 0.05, 0.16]
    mean = np.full((len(names), 2), 0.3)
    content = {
        "format": "roomfit-result",
        "format_version": 1,
        "bands_hz": [1000, 2000],
        "materials": {
            n: {
                "absorption": mean[k].tolist(),
                "lower95": [0.1, 0.1],
                "upper95": [0.5, 0.5],
                "identifiable": [True, True],
                "area_m2": 10.0,
            }
            for k, n in enumerate(names)
        },
        "posterior": {"logit_covariance": covariance.tolist()},
    }
    file = tmp_path / "result.json"
    file.write_text(json.dumps(content))
    settings = CoverageSettings(snr_db=50.0, result=file)
    plan = coverage_plan(plan.campaign, settings)
    rng = np.random.default_rng(7)
    drawn = logit(np.array([draw_synthetic_room(plan, rng).absorption for _ in range(400)]))
    found = np.cov(drawn[:, i, 1], drawn[:, j, 1])
    np.testing.assert_allclose(found, [[0.09, 0.05], [0.05, 0.16]], rtol=0.3)
    np.testing.assert_allclose(drawn[:, i].mean(axis=0), logit(0.3), atol=4 * 0.3 / np.sqrt(400))


def test_an_answer_of_other_bands_is_refused(tmp_path):
    plan = planned(tmp_path)
    file = tmp_path / "absorption.csv"
    rows = [f"{n},500,0.2,0.1,0.3,true" for n in plan.room.materials]
    head = "material,band_hz,absorption,lower95,upper95,identifiable"
    file.write_text("\n".join((head, *rows)) + "\n")
    with pytest.raises(InputError, match="other materials or bands"):
        coverage_plan(plan.campaign, CoverageSettings(snr_db=50.0, result=file))


def test_noise_and_length_are_those_of_the_measured_files(tmp_path):
    """Noise 50 and 40 dB below the peak: 9.6 dB apart with what was there; files of 0.5 s."""
    plans = []
    for level_db in (-50.0, -40.0):
        folder = tmp_path / f"{-level_db:g}"
        file = write_campaign(folder)
        for name, pressure in small_responses().items():
            noisy = add_noise(pressure, level_db, np.random.default_rng(13))
            write_wav(folder / f"LS1_{name}.wav", noisy)
        plans.append(coverage_plan(read_campaign(file), CoverageSettings()))
    quiet, loud = plans
    assert quiet.length_s == pytest.approx(0.5)
    assert quiet.snr_db.shape == (2, len(quiet.grid))
    # what counts as the noisy end of a file differs: its level is found within a decibel or two
    np.testing.assert_allclose(quiet.snr_db - loud.snr_db, 9.6, atol=3.0)


def test_a_changed_recording_makes_another_calibration(tmp_path):
    file = write_campaign(tmp_path)
    campaign = read_campaign(file)
    before = coverage_plan(campaign, CoverageSettings())
    assert coverage_plan(campaign, CoverageSettings(replicates=9)).digest == before.digest
    assert coverage_plan(campaign, CoverageSettings(seed=2)).digest != before.digest
    write_wav(tmp_path / "LS1_MP1.wav", 1.5 * small_responses()["MP1"])
    assert coverage_plan(campaign, CoverageSettings()).digest != before.digest
    # where nothing is read of it, it does not count
    stated = CoverageSettings(snr_db=50.0)
    reported = coverage_plan(campaign, stated).digest
    (tmp_path / "LS1_MP1.wav").unlink()
    assert coverage_plan(campaign, stated).digest == reported


# How it sounds.


def test_three_simulators_of_a_box_agree(tmp_path):
    """The lattice, the mirrored room, and the fit's own images: same pressures.

    The last two round arrival times to other fractions of a sample: 1/16 and 1/8, an error of
    some per cent of the peak at most.
    """
    plan = planned(tmp_path)
    synthetic = draw_synthetic_room(plan, np.random.default_rng(8))
    pairs = (("LS1", "MP1"), ("LS1", "MP2"))
    assert synthesis_of(plan, synthetic) == BOX
    rng = np.random.default_rng(1)
    _, box = synthetic_sound(replace(plan, length_s=0.06), synthetic, pairs, 16_000.0, rng)
    unboxed = replace(plan, length_s=0.06, room=replace(plan.room, shoebox_m=None))
    assert synthesis_of(unboxed, synthetic) == CONVEX
    _, convex = synthetic_sound(unboxed, synthetic, pairs, 16_000.0, rng)
    traced = traced_pressures(plan, synthetic, pairs, 0.06, 16_000.0, rng)
    for pair in pairs:
        expected = box[pair]
        np.testing.assert_allclose(convex[pair], expected, atol=1e-3 * np.abs(expected).max())
        difference = traced[pair] - expected
        assert np.sqrt(np.mean(difference**2) / np.mean(expected**2)) < 0.1


def test_a_convex_room_becomes_one_cell_and_others_none(tmp_path):
    for name, cells in (("paper", paper_cells()), ("l-shaped", l_shaped_cells())):
        file = tmp_path / f"{name}.obj"
        file.write_text(obj_text(cells))
        room, _ = read_room(RoomSpec(file=file, unit="m", up="z"))
        found = convex_cells(room)
        if name == "l-shaped":
            assert found is None
            continue
        assert found is not None
        assert cell_volume_m3(found) == pytest.approx(volume_m3(room.mesh), rel=1e-9)
        assert len(found.faces) < len(room.mesh.triangles)


def test_walls_that_scatter_and_odd_rooms_are_simulated_otherwise(tmp_path):
    text = CAMPAIGN.replace("scattering = 0.0", "scattering = 0.2")
    plan = planned(tmp_path, text)
    synthetic = draw_synthetic_room(plan, np.random.default_rng(9))
    assert synthesis_of(plan, synthetic) == "images and scattered noise of a box"
    pairs, brief = (("LS1", "MP1"), ("LS1", "MP2")), replace(plan, length_s=0.06)
    rng, rate_hz = np.random.default_rng(1), 16_000.0
    _, sound = synthetic_sound(brief, synthetic, pairs, rate_hz, rng)
    (source,) = synthetic.sources
    at = {p.name: p.position_m for p in synthetic.receivers}
    assert sound.keys() == set(pairs)
    for (_, receiver), pressure in sound.items():
        # the direct sound is that of its own receiver, and what is scattered comes behind it
        away_s = np.linalg.norm(at[receiver] - source.position_m) / 343.2
        first_s = np.argmax(np.abs(pressure) > 0.3 * np.abs(pressure).max()) / rate_hz
        assert first_s == pytest.approx(away_s, abs=3e-4)
        assert np.sum(pressure[int(1.2 * away_s * rate_hz) :] ** 2) > 0.0
    unboxed = replace(plan, room=replace(plan.room, shoebox_m=None))
    assert synthesis_of(unboxed, synthetic) == TRACED


def test_a_recording_is_late_and_its_noise_lies_where_it_was_asked():
    """A click between samples: its centre of energy is the delay; noise as far below as specified.

    At half the sampling rate a fraction of a sample has no meaning, which costs 4 microseconds. An
    octave of noise of 1 s holds 700 independent values or more: its level scatters by 0.2 dB.
    """
    grid, rate, rng = bands_between("octave", 500, 4000), 16_000.0, np.random.default_rng(3)
    click = np.zeros(16_000)
    click[800] = 1.0
    delay = 0.01 + 0.37 / rate
    clean = recorded(click, rate, grid, np.zeros(4), delay, np.full(4, 200.0), rng)
    times = np.arange(clean.size) / rate
    assert np.sum(times * clean**2) / np.sum(clean**2) == pytest.approx(
        800 / rate + delay, abs=1e-5
    )
    noisy = recorded(click, rate, grid, np.zeros(4), delay, np.full(4, 40.0), rng)
    frequencies = np.fft.rfftfreq(clean.size, 1.0 / rate)
    for share, low, high in zip(
        octave_shares(grid.centres_hz, frequencies), grid.lower_hz, grid.upper_hz, strict=True
    ):
        observed = np.fft.irfft(np.fft.rfft(clean) * share, clean.size) ** 2
        size = round(max(0.01, 4.0 / (high - low)) * rate)
        loudest = max(observed[i : i + size].mean() for i in range(0, observed.size - size, size))
        noise = np.abs(np.fft.rfft(noisy - clean)) ** 2 / clean.size**2
        inside = (frequencies >= low) & (frequencies < high)
        level = 2.0 * noise[inside].sum()
        if high < 0.5 * rate:  # the loudest block may be cut elsewhere: half of it at worst
            assert 10 * np.log10(loudest / level) == pytest.approx(40.0, abs=3.2)


def test_shares_of_third_octaves_add_to_one():
    grid = bands_between("third-octave", 100, 1000)
    inside = np.linspace(101.0, 990.0, 500)
    np.testing.assert_allclose(octave_shares(grid.exact_centres_hz, inside).sum(axis=0), 1.0)
    at_centres = octave_shares(grid.exact_centres_hz, grid.exact_centres_hz)
    np.testing.assert_allclose(at_centres, np.eye(len(grid)), atol=5e-3)


def test_a_synthetic_table_has_the_parameters_of_the_response(tmp_path):
    """Direct sound and an exponential tail of noise: G by hand, EDT the tail's; read back."""
    plan, rng = planned(tmp_path), np.random.default_rng(11)
    synthetic = draw_synthetic_room(plan, rng)
    step = synthetic.receivers[0].position_m - synthetic.sources[0].position_m
    distance = float(np.linalg.norm(step))
    rate, t60 = synthetic_rate_hz(plan.campaign.bands), 0.5
    first = distance / synthetic.speed_of_sound_m_s * rate
    n = np.arange(round(1.2 * rate))
    tail = np.where(n > first, 10.0 ** (-3.0 * (n - first) / rate / t60), 0.0)
    pressure = 1e-3 * tail * rng.standard_normal(n.size)
    spread = np.full(2, np.nan)
    pair = ("LS1", "MP1", {"G_dB": spread, "T30_s": spread, "EDT_s": spread})
    plan = replace(plan, tabulated=(pair,))
    text = synthetic_table(plan, synthetic, {("LS1", "MP1"): pressure}, rate, rng)
    file = tmp_path / "table.csv"
    file.write_text(text)
    (values,), _ = read_parameters(file)
    # energy of the noise over that of a click of 1/(4 pi 10 m), both of a flat spectrum
    g = 10.0 * np.log10(np.sum(pressure**2) * (4.0 * np.pi * 10.0) ** 2)
    np.testing.assert_allclose(values.values["G_dB"], g, atol=0.6)
    np.testing.assert_allclose(values.values["T30_s"], t60, rtol=0.08)
    np.testing.assert_allclose(values.values["EDT_s"], t60, rtol=0.2)


# What is counted.


@pytest.mark.slow
@given(st.integers(1, 40), st.integers(0, 40))
def test_independent_values_have_the_exact_binomial_interval(n, k):
    k = min(k, n)
    hit = (np.arange(n) < k)[:, None]
    share = grouped_proportion(hit, np.ones_like(hit))
    exact = binomtest(k, n).proportion_ci(0.95, method="exact")
    # the variance of a sample is n / (n - 1) of what the design effect compares with
    assert share.low <= exact.low + 1e-9
    assert share.high >= exact.high - 1e-9
    assert share.low == pytest.approx(exact.low, abs=0.06)
    assert share.high == pytest.approx(exact.high, abs=0.06)


def test_values_that_repeat_one_another_count_once():
    hit = np.arange(30) % 10 < 7
    once = grouped_proportion(hit[:, None], np.ones((30, 1), bool))
    often = grouped_proportion(np.tile(hit[:, None], (1, 50)), np.ones((30, 50), bool))
    assert often.count == 50 * once.count
    assert often.low == pytest.approx(once.low, abs=0.01)
    assert often.high == pytest.approx(once.high, abs=0.01)


def sample_of(rng: np.random.Generator, stretch: float, n: int = 400) -> CoverageSample:
    """Return answers whose logit errors are Gaussian, intervals `stretch` times too wide."""
    bands, sd = bands_between("octave", 500, 1000), 0.4
    true = rng.normal(-1.0, 1.0, (n, 3, 2))
    found = true + sd * rng.standard_normal(true.shape)
    low, high = (found + s * 1.959964 * stretch * sd for s in (-1.0, 1.0))
    a, x, lo, hi = (1.0 / (1.0 + np.exp(-z)) for z in (true, found, low, high))
    has_interval = np.ones(true.shape, dtype=bool)
    has_interval[:, 2] = False
    return CoverageSample(
        ("a", "b", "fixed"), bands, a, x, lo, hi, hi - lo < 0.2, has_interval,
        np.full((3, 2), 0.27), np.full((n, 2), 0.3), np.ones((n, 2)),
    )  # fmt: skip


@pytest.mark.parametrize(("stretch", "expected"), [(1.0, 0.95), (0.5, 0.673), (1.5, 0.9967)])
def test_coverage_is_that_of_the_gaussian_it_was_made_with(stretch, expected):
    """1600 values: 4 standard errors are 2.2 % at 95 % and 4.7 % at 67 %."""
    found = sample_of(np.random.default_rng(21), stretch)
    together = coverage_rows(found)[-1]
    assert together.holds.of == 1600
    error = 4.0 * np.sqrt(expected * (1.0 - expected) / 1600)
    assert abs(together.holds.value - expected) < error
    nominal = np.array([0.2, 0.5, 0.95])
    if stretch == 1.0:
        for share, p in zip(coverage_at(found, nominal), nominal, strict=True):
            assert abs(share.value - p) < 4.0 * np.sqrt(p * (1.0 - p) / 1600)
            assert share.low <= p <= share.high
    z = scaled_errors(found)
    assert np.count_nonzero(np.abs(z) <= 1.959964) == together.holds.count
    assert z.std() * stretch == pytest.approx(1.0, rel=4.0 / np.sqrt(3200))


# The command.


@pytest.mark.slow
def test_slices_stop_and_go_and_give_the_same_replicates(tmp_path):
    file = campaign_file(tmp_path)
    asked = CoverageSettings(replicates=2, snr_db=50.0)
    campaign = read_campaign(file)
    part = estimate_coverage(campaign, tmp_path / "a", replace(asked, first=1))
    assert (part.done, part.requested) == (1, 2)
    assert not replicate_path(tmp_path / "a", 0).exists()
    second = replicate_path(tmp_path / "a", 1)
    content, written = second.read_bytes(), second.stat().st_mtime_ns
    result = estimate_coverage_to_folder(file, tmp_path / "a", asked)
    assert (result.done, result.syntheses) == (2, {BOX: 2})
    assert second.stat().st_mtime_ns == written
    assert {p.name for p in (tmp_path / "a").iterdir()} == {
        *("replicates", "coverage.csv", "coverage.json", "coverage.png"),
        ".roomfit-files",
    }
    reported = json.loads((tmp_path / "a" / "coverage.json").read_text())
    del reported["content_sha256"]
    assert reported == json.loads(json_text(coverage_json(result)))
    # south and its twin north are one number, floor is known: three materials, two bands, twice
    assert reported["all"]["hold"]["of"] == 12
    assert "2 of 2 replicates" in str(result)
    # the same seed anywhere else; only the seconds may differ
    estimate_coverage(campaign, tmp_path / "b", replace(asked, first=1))
    again = json.loads(replicate_path(tmp_path / "b", 1).read_text())
    first = json.loads(content)
    for one in (first, again):
        del one["seconds"], one["content_sha256"]
    assert again == first
    # another campaign must not be mixed in
    campaign_file(tmp_path, CAMPAIGN.replace("4.6, 3.7", "4.7, 3.7"))
    with pytest.raises(InputError, match="belongs to another estimate of coverage"):
        estimate_coverage(read_campaign(file), tmp_path / "a", asked)


@pytest.mark.slow
def test_tables_alone_are_calibrated_too(tmp_path):
    """Values of two pairs, one row with a stated spread; what comes out belongs to the priors."""
    table = ["source,receiver,parameter,1000,2000", "LS1,MP1,T20_sd,0.02,0.02"]
    table += [f"LS1,{r},{k},{v}" for r in ("MP1", "MP2") for k, v in (("T20", "0.4,0.4"),
                                                                     ("C80", "9,9"))]  # fmt: skip
    (tmp_path / "values.csv").write_text("\n".join(table) + "\n")
    head, tail = CAMPAIGN.split("[[measurements]]", 1)
    text = head + '[[measurements]]\nparameters = "values.csv"\n[identify]'
    text += tail.split("[identify]")[1].replace("to_hz = 2000", "to_hz = 1000")
    # walls hard enough to ring beyond the synthetic recordings would leave no decay times
    text = text.replace("[materials.south]", "[materials.south]\nbounds = [0.2, 0.6]")
    campaign = read_campaign(campaign_file(tmp_path, text))
    result = estimate_coverage(campaign, tmp_path / "out", CoverageSettings(replicates=2))
    assert (result.done, result.refused, result.syntheses) == (2, (), {BOX: 2})
    together = coverage_rows(result.found)[-1]
    assert together.holds.of == 6
    # three numbers from four: no 95 % interval of six is off but by chance, three less than once
    assert together.holds.count >= 4


def test_refused_replicates_are_counted_and_reported_without_their_folder():
    found = sample_of(np.random.default_rng(1), 1.0, n=3)
    why = "the decay is cut short\n  where   /gone/0001.wav\n  found   12 dB\n  needed  15 dB"
    for refused, said in (
        ((why,), "1 replicate was refused; the first: the decay is cut short (12 dB)"),
        (("no sound", why), "2 replicates were refused; the first: no sound"),
    ):
        result = CoverageResult(5, 5, refused, {BOX: 5}, {}, found, "prior")
        assert str(result).splitlines()[-1] == said


def test_a_picture_of_coverage_holds_shares_with_their_own_intervals():
    """Over the nominal level, and in every band; intervals left, wrong certainty right of it."""
    found = sample_of(np.random.default_rng(1), 1.0, n=20)
    left, right = coverage_figure(found).axes
    nominal, own = left.get_lines()
    assert [tuple(x) for x in nominal.get_xydata()] == [(0, 0), (100, 100)]
    levels = 0.01 * own.get_xdata()
    wanted = coverage_at(found, levels)
    assert (levels[0], levels[-1], len(levels)) == (0.05, 0.99, 21)
    np.testing.assert_allclose(own.get_ydata(), [100.0 * p.value for p in wanted])
    band = left.collections[0].get_paths()[0].vertices
    for level, p in zip(levels, wanted, strict=True):
        at = band[np.isclose(band[:, 0], 100.0 * level), 1]
        assert (at.min(), at.max()) == pytest.approx((100.0 * p.low, 100.0 * p.high))
    rows = coverage_rows(found)[:-1]
    assert [t.get_text() for t in right.get_xticklabels()] == ["500", "1000"]
    for bars, name, shift in zip(
        right.containers, ("holds", "outside"), (-0.08, 0.08), strict=True
    ):
        points, _, (reach,) = bars.lines
        shares = [getattr(row, name) for row in rows]
        np.testing.assert_allclose(points.get_xdata(), np.arange(2) + shift)
        np.testing.assert_allclose(points.get_ydata(), [100.0 * s.value for s in shares])
        for (low, high), share in zip(reach.get_segments(), shares, strict=True):
            assert (low[1], high[1]) == pytest.approx((100.0 * share.low, 100.0 * share.high))
    upright = right.transData.inverted()
    aims = sorted(
        tuple(patch.get_window_extent().transformed(upright).intervaly) for patch in right.patches
    )
    np.testing.assert_allclose(aims, [(0.0, 5.0), (90.0, 98.0)], atol=1e-9)
    limits = left.get_xlim(), left.get_ylim(), right.get_xlim(), right.get_ylim()
    assert limits == ((0, 100), (0, 101), (-0.5, 1.5), (-2, 102))
    assert [(axes.get_xlabel(), axes.get_ylabel()) for axes in (left, right)] == [
        ("level of the interval (%)", "intervals that hold the true value (%)"),
        ("band (Hz)", "share of values (%)"),
    ]
    named = [[t.get_text() for t in axes.get_legend().get_texts()] for axes in (left, right)]
    assert named[0] == ["nominal", "range of chance", "found"]
    assert set(named[1]) == {"aimed at", "95 % intervals that hold", "identifiable but outside"}


def test_a_damaged_replicate_is_refused_and_not_counted(tmp_path):
    path = replicate_path(tmp_path, 3)
    path.parent.mkdir()
    for content in ("{", "[]", '{"format": "roomfit-replicate", "digest": "d"}'):
        path.write_text(content)
        with pytest.raises(InputError, match="damaged"):
            read_replicate(tmp_path, 3, "d")
    assert read_replicate(tmp_path, 4, "d") is None


def test_findings_of_a_replicate_come_back_as_codes_and_unknown_ones_are_refused(tmp_path):
    table, bands = np.full((2, 1), 0.5), np.ones(1)
    codes = (Code.BAND_NOT_FITTED, Code.MODEL_DOES_NOT_FIT)
    found = Found(table, table, table, table > 0.0, bands, bands, ("energy",), codes)
    path = write_replicate(tmp_path, Replicate(3, "d", BOX, table, None, found, 1.0))
    back = read_replicate(tmp_path, 3, "d").found.findings
    assert [type(code) for code in back] == [Code, Code]
    assert back == codes
    content = json.loads(path.read_text())
    content["findings"][0] = "band-not-known"
    write_json_atomically(path, content)
    with pytest.raises(InputError, match=r"unknown code[\s\S]*0003\.json[\s\S]*band-not-known"):
        read_replicate(tmp_path, 3, "d")


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--replicates", "0"], "replicates"),
        (["--replicates", "5", "--first", "5"], "first"),
        (["--replicates", "5", "--only", "0"], "only"),
        (["--workers", "0"], "workers"),
        (["--snr-db", "5"], "snr-db"),
        (["--from", "nothing.json"], "nothing.json"),
    ],
)
def test_bad_options_are_refused_before_any_work(tmp_path, monkeypatch, capsys, more, said):
    file = campaign_file(tmp_path)
    out = str(tmp_path / "out")
    given_options = [] if "--snr-db" in more else ["--snr-db", "50"]
    assert run_command(monkeypatch, "coverage", file, "--out", out, *given_options, *more) == 2
    assert said in capsys.readouterr().err
    assert not list(Path(out).glob("*"))


def test_an_output_folder_that_is_a_file_is_refused(tmp_path):
    (tmp_path / "out").write_text("mine")
    campaign = read_campaign(campaign_file(tmp_path))
    with pytest.raises(InputError, match="is a file"):
        estimate_coverage(campaign, tmp_path / "out", CoverageSettings(snr_db=50.0))
    assert (tmp_path / "out").read_text() == "mine"
