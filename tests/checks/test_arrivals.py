"""One cause, one sentence: what several recordings show together, before any fit."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import roomfit
from roomfit.base.air import Air, speed_of_sound_m_s
from roomfit.base.errors import InputError, RoomfitError
from roomfit.base.findings import Code
from roomfit.checks.arrivals import arrival_findings
from roomfit.checks.examine import BEFORE_THE_FIT, examine, recorded
from roomfit.checks.usable import check_recordings
from roomfit.report.check import parameters_csv
from roomfit.room.scene import scene_of, shoebox_room

RATE_HZ = 48_000
C = speed_of_sound_m_s(Air())
ROOM = shoebox_room((8.0, 6.0, 3.2), {"walls": "plaster", "floor": "carpet"})
SOURCES = {"LS1": (1.2, 1.4, 1.3), "LS2": (6.6, 4.3, 1.5), "LS3": (2.4, 4.9, 1.1)}
RECEIVERS = {
    "M1": (4.1, 2.3, 1.2),
    "M2": (5.6, 1.2, 1.4),
    "M3": (3.3, 3.9, 1.7),
    "M4": (7.1, 2.9, 1.1),
}
SCENE = scene_of(ROOM, SOURCES, RECEIVERS)
BANDS = roomfit.bands_between("octave", 500, 2000)


def response(distance_m: float, rng: np.random.Generator, gain: float = 1.0) -> np.ndarray:
    """A click of half a millisecond at the direct sound, then a decay of 0.5 s, noise at -60 dB.

    The reverberant field has one level everywhere; it begins 2 ms after the direct sound.
    """
    t = np.arange(int(0.8 * RATE_HZ)) / RATE_HZ
    since = t - distance_m / C
    click = np.exp(-(((since - 1e-4) * 15_000) ** 2)) / distance_m
    tail = 0.1 * rng.normal(size=t.size) * np.exp(-6.9 * t / 0.5) * (since > 2e-3)
    return gain * (click + tail + 1e-4 * rng.normal(size=t.size))


def recordings(
    seed: int = 1, *, at: dict[str, tuple[float, float, float]] | None = None, sd_m: float = 0.0
) -> list[roomfit.Measurement]:
    """All pairs, points off by a standard deviation or where `at` has them."""
    rng = np.random.default_rng(seed)
    true = {n: np.add(p, rng.normal(0, sd_m, 3)) for n, p in {**SOURCES, **RECEIVERS}.items()}
    true.update({name: np.array(p) for name, p in (at or {}).items()})
    return [
        roomfit.Measurement(
            s,
            r,
            response(float(np.linalg.norm(true[s] - true[r])), rng),
            RATE_HZ,
            name=f"{s}_{r}.wav",
        )
        for s in SOURCES
        for r in RECEIVERS
    ]


def changed(files: list[roomfit.Measurement], change, chosen=None) -> list[roomfit.Measurement]:
    return [
        replace(m, samples=change(np.asarray(m.samples))) if chosen is None or chosen(m) else m
        for m in files
    ]


def late(seconds: float):
    n = round(seconds * RATE_HZ)
    return (lambda x: np.append(np.zeros(n), x[:-n])) if n > 0 else (lambda x: x[-n:])


def test_a_delay_is_stated_by_the_peaks_of_band_limited_pulses():
    """Windowed sinc pulses 40 samples late at fractions of a sample, as simulators make them.

    The onset, 20 dB below the peak, comes two to three samples before.
    """
    n, files = np.arange(4000), []
    noise = 1e-4 * np.random.default_rng(5).standard_normal(n.size)
    speed_m_s = speed_of_sound_m_s(SCENE.air)
    for m in recordings():
        at_m = {p.name: p.position_m for p in (*SCENE.sources, *SCENE.receivers)}
        at = 40.0 + RATE_HZ * math.dist(at_m[m.source], at_m[m.receiver]) / speed_m_s
        window = np.where(np.abs(n - at) < 40.0, np.cos(np.pi * (n - at) / 80.0) ** 2, 0.0)
        files.append(replace(m, samples=window * np.sinc(n - at) + noise))
    (found,) = causes(SCENE, files)
    assert found.evidence["late_s"] * RATE_HZ == pytest.approx(40.0, abs=0.2)
    assert "(40 samples)" in found.sentence


def voids(findings) -> list:
    return [f for f in findings if f.code.voids_identifiability]


def measured_findings(files, scene=SCENE):
    return examine(BEFORE_THE_FIT, recorded(scene, files, BANDS, {}))


def causes(scene, files):
    return list(arrival_findings(scene, files))


def test_a_campaign_as_specified_raises_nothing():
    assert measured_findings(recordings()) == ()


def test_a_common_delay_is_one_sentence_with_the_key_to_set():
    """38 samples at 48 kHz; no single recording and no wall is blamed as well."""
    findings = measured_findings(changed(recordings(), late(0.00079)))
    (found,) = findings
    assert found.code is Code.RECORDINGS_LATE
    assert found.sentence == (
        "All 12 files are 0.79 ms late (38 samples): set latency_s = "
        f"{found.evidence['latency_s']:g}"
        ' or time_zero = "unknown".'
    )
    assert found.evidence["late_s"] == pytest.approx(0.00079, abs=1 / RATE_HZ)
    set_so = [
        replace(m, latency_s=found.evidence["latency_s"])
        for m in changed(recordings(), late(0.00079))
    ]
    assert measured_findings(set_so) == ()


def test_a_fit_that_refuses_a_file_names_the_cause_of_all():
    """Half a second of silence before files that end in the decay, and before whole ones."""
    files = changed(recordings(), lambda x: np.append(np.zeros(RATE_HZ // 2), x[: RATE_HZ // 25]))
    with pytest.raises(InputError, match="the decay") as refused:
        measured_findings(files)
    assert refused.value.hint.startswith("All 12 files began 0.50 s before emission")
    few = roomfit.Settings(n_rays=2000, quick=True)
    whole = changed(recordings(), lambda x: np.append(np.zeros(RATE_HZ // 2), x))
    with pytest.raises(RoomfitError, match="one level") as refused:
        roomfit.identify(SCENE, whole, bands=BANDS, settings=few)
    assert refused.value.hint.startswith("All 12 files began 0.50 s before emission")


@pytest.mark.parametrize("silence_s", [0.05, 0.2, 1.0, 4.0])
@pytest.mark.parametrize("time_zero", ["emission", "unknown", "direct"])
def test_silence_before_the_sound_leaves_the_decay_what_it_is(silence_s, time_zero):
    """Of one file, whatever its clock; the latency that is named resolves it."""
    (own,) = recordings()[:1]
    plain = check_recordings(SCENE, [own], BANDS)
    before = np.zeros(round(silence_s * RATE_HZ))
    late = replace(own, samples=np.append(before, own.samples), time_zero=time_zero)
    checked = check_recordings(SCENE, [late], BANDS)
    np.testing.assert_allclose(checked.decay_s, plain.decay_s, rtol=2e-3)
    np.testing.assert_allclose(checked.decay_range_db, plain.decay_range_db, atol=1.0)
    edits = [e for f in checked.findings for r in f.remedies for e in r.edits]
    if time_zero == "emission":
        (latency_s,) = (e.value for e in edits if e.key == "latency_s")
        assert check_recordings(SCENE, [replace(late, latency_s=latency_s)], BANDS).findings == ()
    else:
        assert checked.findings == ()


def test_two_sounds_in_one_file_are_refused():
    """A response repeated, also softly, and a click long before it; an echo is no second sound."""
    (own,) = recordings()[:1]
    x = np.asarray(own.samples)
    click = np.append(np.max(x), np.zeros(RATE_HZ // 3))
    for samples in (np.append(x, x), np.append(x, 0.1 * x), np.append(click, x)):
        checked = check_recordings(SCENE, [replace(own, samples=samples)], BANDS)
        assert "a second sound" in " ".join(f.sentence for f in checked.findings)
    echo = x + np.append(np.zeros(RATE_HZ // 10), x)[: len(x)]
    assert not check_recordings(SCENE, [replace(own, samples=echo)], BANDS).in_doubt


def test_sources_with_delays_of_their_own_are_a_sentence_each():
    files = changed(recordings(), late(0.002), lambda m: m.source == "LS2")
    found = voids(measured_findings(changed(files, late(0.001), lambda m: m.source == "LS3")))
    assert [f.code for f in found] == [Code.RECORDINGS_LATE] * 2
    assert ["LS2_M1" in f.sentence for f in found] == [True, False]


def test_files_that_begin_at_their_direct_sound_say_so():
    files = [
        replace(m, samples=np.asarray(m.samples)[int(np.argmax(np.abs(m.samples))) - 20 :])
        for m in recordings()
    ]
    (found,) = voids(measured_findings(files))
    assert 'set time_zero = "direct"' in found.sentence
    assert voids(measured_findings([replace(m, time_zero="direct") for m in files])) == []


@pytest.mark.parametrize("delay_s", [0.0, 0.004])
def test_feet_for_metres_are_recognised_with_and_without_a_delay(delay_s):
    files = recordings()
    if delay_s:
        files = changed(files, late(delay_s))
    in_feet = scene_of(
        shoebox_room(np.array([8.0, 6.0, 3.2]) / 0.3048, "plaster"),
        {n: np.array(p) / 0.3048 for n, p in SOURCES.items()},
        {n: np.array(p) / 0.3048 for n, p in RECEIVERS.items()},
    )
    (found,) = causes(in_feet, files)
    assert found.code is Code.COORDINATES_SCALED
    assert "feet are read as metres" in found.sentence
    assert found.evidence == {"factor": 0.3048, "unit": "ft"}


@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_another_scale_is_no_delay(factor):
    """A sampling rate that is wrong by a tenth, or a drawing: lateness grows with distance."""
    files = [
        replace(m, samples=np.asarray(m.samples), sampling_rate_hz=RATE_HZ / factor)
        for m in recordings()
    ]
    (found,) = causes(SCENE, files)
    assert found.code is Code.COORDINATES_SCALED
    assert found.evidence["factor"] == pytest.approx(factor, abs=0.02)
    assert "unit" not in found.evidence


@pytest.mark.parametrize("metres", [0.5, 1.0])
def test_receivers_displaced_together_are_neither_a_delay_nor_a_scale(metres):
    """An array put down by another origin than its coordinates were measured from."""
    by = np.array([0.6, -0.8, 0.0]) * metres
    at = {name: tuple(np.add(p, by)) for name, p in RECEIVERS.items()}
    (found,) = causes(SCENE, recordings(at=at))
    assert found.code is Code.DISPLACEMENT_DETECTED
    assert found.sentence.startswith("By the direct sounds all 4 receivers stand elsewhere")
    assert found.evidence["metres"] == pytest.approx(metres, abs=0.03)
    assert len(found.about.points_m) == 4
    # moved by what was found, they are where they stand
    np.testing.assert_allclose(found.evidence["shift_m"], by, atol=0.05)
    shift_m = found.evidence["shift_m"]
    there = {name: tuple(np.add(p, shift_m)) for name, p in RECEIVERS.items()}
    assert causes(scene_of(SCENE.room, SOURCES, there), recordings(at=at)) == []


def test_explanations_that_are_as_likely_are_named_beside_each_other():
    """Two distances that are alike: a delay, or each source's, or a scale."""
    near = {"M1": (4.1, 2.3, 1.2), "M2": (4.2, 2.5, 1.2), "M3": (4.0, 2.2, 1.3)}
    scene = scene_of(ROOM, {"LS1": SOURCES["LS1"]}, near)
    rng = np.random.default_rng(3)
    files = [
        roomfit.Measurement(
            "LS1",
            name,
            response(1.1 * float(np.linalg.norm(np.subtract(SOURCES["LS1"], at))), rng),
            RATE_HZ,
            name=f"{name}.wav",
        )
        for name, at in near.items()
    ]
    (found,) = causes(scene, files)
    assert found.code in (Code.RECORDINGS_LATE, Code.COORDINATES_SCALED)
    assert " Or " in found.sentence


def test_two_exchanged_files_are_named():
    files = recordings()
    a, b = (
        next(i for i, m in enumerate(files) if m.name == n) for n in ("LS1_M1.wav", "LS1_M4.wav")
    )
    one, other = files[a], files[b]
    files[a], files[b] = replace(one, samples=other.samples), replace(other, samples=one.samples)
    (found,) = voids(measured_findings(files))
    assert found.code is Code.EXCHANGED
    assert found.sentence.startswith("LS1_M1.wav and LS1_M4.wav are exchanged")


def test_two_exchanged_positions_are_named():
    at = {"M1": RECEIVERS["M4"], "M4": RECEIVERS["M1"]}
    (found,) = voids(measured_findings(recordings(at=at)))
    assert found.evidence == {"receivers": ["M1", "M4"]}


def test_a_source_and_a_receiver_that_are_exchanged_are_named():
    """Between them the sound travels as far as it should."""
    one, other = SCENE.sources[0], SCENE.receivers[2]
    scene = replace(
        SCENE,
        sources=(replace(one, position_m=other.position_m), *SCENE.sources[1:]),
        receivers=tuple(
            replace(p, position_m=one.position_m) if p is other else p for p in SCENE.receivers
        ),
    )
    (found,) = causes(scene, recordings())
    assert found.code is Code.EXCHANGED
    assert found.evidence == {"sources": [one.name], "receivers": [other.name]}


def test_one_file_that_arrives_elsewhere_is_no_displaced_microphone():
    """A microphone that is 2 m off is so for both sources, or for one of them by rare chance."""
    files = changed(recordings(), late(2.0 / 343.0), lambda m: m.name == "LS1_M3.wav")
    assert not causes(SCENE, files)


@pytest.mark.parametrize("delay_s", [0.0, 0.003])
def test_a_microphone_off_by_a_decimetre_is_named_with_a_distance(delay_s):
    """Positions of the others are off by 5 mm, as measured with care."""
    scene = replace(
        SCENE,
        sources=tuple(replace(p, position_sd_m=0.005) for p in SCENE.sources),
        receivers=tuple(replace(p, position_sd_m=0.005) for p in SCENE.receivers),
    )
    moved = tuple(np.add(RECEIVERS["M3"], (0.1, -0.1, 0.0)))
    files = recordings(2, at={"M3": moved}, sd_m=0.005)
    if delay_s:
        files = changed(files, late(delay_s))
    found = [f for f in causes(scene, files) if f.code is Code.DISPLACEMENT_DETECTED]
    others = [f.code for f in causes(scene, files) if f.code is not found[0].code]
    assert others == ([Code.RECORDINGS_LATE] if delay_s else [])
    assert found[0].evidence["receiver"] == "M3"
    assert 0.05 < found[0].evidence["metres"] < 0.2


@pytest.mark.slow
def test_positions_as_specified_are_taken_for_displaced_less_than_once_in_a_hundred():
    """Errors of exactly the specified standard deviation, 2 cm a coordinate; one in a thousand
    is what chi-square promises for Gaussian errors."""
    alarms = 0
    for seed in range(60):
        files = recordings(seed, sd_m=0.02)
        alarms += bool([f for f in causes(SCENE, files) if "elsewhere" in f.sentence])
    assert alarms == 0


@pytest.mark.parametrize("names", [{"LS1_M2.wav"}, {"LS2_M1.wav", "LS2_M3.wav"}])
def test_another_gain_is_named_with_its_decibels(names):
    files = changed(recordings(), lambda x: 2.0 * x, lambda m: m.name in names)
    (found,) = voids(measured_findings(files))
    assert found.code is Code.LEVELS_APART
    assert found.evidence["step_db"] == pytest.approx(6.02, abs=1.0)
    assert 'level = "per-file"' in found.sentence
    assert voids(measured_findings([replace(m, level="per-file") for m in files])) == []


def test_files_that_were_normalised_one_by_one_are_named():
    """Each to the same peak; of one source, whose files share a gain, and of no other."""
    files = changed(recordings(), lambda x: 0.9 * x / np.abs(x).max(), lambda m: m.source == "LS2")
    (found,) = voids(measured_findings(files))
    assert found.code is Code.LEVELS_APART
    assert "the same peak, 0.9" in found.sentence and "one by one" in found.sentence
    assert {pair[0] for pair in found.about.pairs} == {"LS2"}
    assert voids(measured_findings([replace(m, level="per-file") for m in files])) == []


def test_opposite_polarity_is_named_and_voids_nothing():
    files = changed(recordings(), lambda x: -x, lambda m: m.receiver == "M2")
    (found,) = measured_findings(files)
    assert found.code is Code.POLARITY_DIFFERS
    assert found.sentence.startswith("3 of 12 files (LS1_M2.wav, LS2_M2.wav, LS3_M2.wav)")
    assert not found.code.voids_identifiability


def test_coordinates_in_millimetres_are_named_although_no_response_is_that_long():
    """Every single file would be refused for ending before its direct sound."""
    far = scene_of(
        shoebox_room((800.0, 600.0, 320.0), "plaster"),
        {n: 100 * np.array(p) for n, p in SOURCES.items()},
        {n: 100 * np.array(p) for n, p in RECEIVERS.items()},
    )
    files = [replace(m, samples=np.asarray(m.samples)[: RATE_HZ // 4]) for m in recordings()]
    with pytest.raises(InputError, match="ends before the direct sound"):
        recorded(far, files, BANDS, {})
    first = check_recordings(far, files, BANDS).findings[0]
    assert "centimetres are read as metres" in first.sentence


def test_which_recording_is_usable_in_which_band_is_a_table():
    """Noise 40 dB louder in one file leaves no decay range for T20 there."""
    rng = np.random.default_rng(5)
    files = changed(
        recordings(), lambda x: x + 0.02 * rng.normal(size=x.size), lambda m: m.name == "LS3_M4.wav"
    )
    checked = check_recordings(SCENE, files, BANDS)
    assert checked.usable.shape == (12, 3)
    assert np.array_equal(checked.has_t20.all(axis=1), [True] * 11 + [False])
    assert np.all(checked.decay_s == pytest.approx(0.5, rel=0.1))
    # 2000 sqrt(T / V)
    assert checked.schroeder_hz == pytest.approx(2000 * np.sqrt(checked.decay_s / 153.6), rel=1e-3)
    np.testing.assert_allclose(checked.onset_s, checked.travel_s, atol=4 / RATE_HZ)
    row = next(line for line in str(checked).split("\n") if "LS3_M4.wav" in line)
    # arrival in ms, and three bands of which noise leaves too little
    assert f"{1e3 * checked.travel_s[-1]:.1f}" in row and row.count("<") == 3
    page = checked._repr_html_()
    assert "2000" in page and "&lt;" in page


def test_decays_are_as_bent_as_the_sum_of_two_exponentials(tmp_path):
    """ISO 3382-2:2008, annex B, of the curve in closed form: T of .3 s, and of 1.5 s 17 dB below.

    Tolerances are three standard deviations of the mean over twelve recordings of noise.
    """
    t = np.arange(int(2.4 * RATE_HZ)) / RATE_HZ
    rng = np.random.default_rng(8)
    files = [
        replace(m, samples=np.append(np.zeros(int(RATE_HZ * d / C)), rng.normal(size=t.size) * e))
        for m in recordings()
        for d in [float(np.linalg.norm(np.subtract(SOURCES[m.source], RECEIVERS[m.receiver])))]
        for e in [np.sqrt(10 ** (-6 * t / 0.3) + 0.02 * 10 ** (-6 * t / 1.5))]
    ]
    checked = check_recordings(SCENE, files, BANDS)
    level_db = 10 * np.log10((0.3 * 10 ** (-6 * t / 0.3) + 0.03 * 10 ** (-6 * t / 1.5)) / 0.33)
    exact = {}
    for name, depth in (("T20_s", 25), ("T30_s", 35)):
        own = (level_db < -5) & (level_db > -depth)
        exact[name] = -60 / np.polyfit(t[own], level_db[own], 1)[0]
        np.testing.assert_allclose(checked.parameter(name).mean(axis=0), exact[name], rtol=0.06)
    bent = 1e3 * (1 - np.corrcoef(t[own], level_db[own])[0, 1] ** 2)
    curvature = 100 * (exact["T30_s"] / exact["T20_s"] - 1)
    assert curvature > 15 and bent > 15
    assert checked.curvature_percent.mean() == pytest.approx(curvature, abs=4)
    assert checked.nonlinearity_permille.mean() == pytest.approx(bent, rel=0.15)
    straight = check_recordings(SCENE, recordings(), BANDS)
    assert abs(straight.curvature_percent.mean()) < 2 and straight.nonlinearity_permille.mean() < 3
    said = str(checked)
    assert "12 pairs of 3 sources and 4 receivers: as many as ISO 3382-2 asks for the prec" in said
    assert "At 500 Hz to 2 kHz decays are bent" in said
    assert "7 pairs" in str(check_recordings(SCENE, files[:7], BANDS))
    table = tmp_path / "room_parameters.csv"
    table.write_text(parameters_csv(checked))
    read = roomfit.read_parameters(table)[0]
    assert len(read) == 12
    np.testing.assert_allclose([v.values["T20_s"] for v in read], checked.parameter("T20_s"), 1e-3)
    lines = checked.plot().axes[0].get_lines()
    _, curve, *_ = [line for line in lines if line.get_gid() == "class:curve-2"]
    level = np.interp(curve.get_xdata(), checked.pairs[2].direct_s + t, level_db)
    assert np.abs(level - curve.get_ydata())[level > -40].mean() < 1.5


# The room and its positions.
