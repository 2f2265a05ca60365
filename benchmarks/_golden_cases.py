"""The small cases of `golden.py`: campaign folders of known rooms, and the commands run on them.

Every case writes its inputs with the project's own simulators, which share nothing with the fit,
and then drives the program by its command line alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import soundfile

from roomfit.base.air import Air, attenuation_per_m, speed_of_sound_m_s
from roomfit.base.bands import bands_between
from roomfit.base.typing import FloatArray
from roomfit.demo.boxes import (
    SyntheticBox,
    add_noise,
    demo_plan,
    pressure_response,
)
from roomfit.impedance.data import Observed
from roomfit.impedance.wave_model import at_rest, predicted_pressure, wave_model
from simulated_rooms.impedance_box import (
    LENGTHS_M,
    PAIRS,
    RECEIVERS_M,
    SOURCES_M,
    SPEED_M_S,
    SURFACES,
    WALLS,
    box_scene,
    noisy,
    true_r0,
)
from simulated_rooms.measured_polyhedron import polyhedron_plan, write_measured_polyhedron
from simulated_rooms.random_boxes import write_scattering_box

RunCommand = Callable[..., None]
"""Runs one command of roomfit: its arguments; the last one names the output folder."""

# What the commands are called: the one line to change when one is renamed.
DEMO, IDENTIFY, IMPEDANCE, PREDICT, DESIGN, PAPER, REVERBERATION, TREAT = (
    *("demo", "identify", "impedance", "predict", "design", "paper"),
    *("reverberation", "treat"),
)

_RATE_HZ = 16_000
_SIZE_M = (3.9, 3.1, 2.5)
_SOURCE_M = (1.0, 1.2, 1.1)
_PLACES_M = MappingProxyType(
    {
        "MP1": (2.9, 2.2, 1.3),
        "MP2": (3.1, 0.9, 1.6),
        "MP3": (0.7, 2.5, 1.7),
        "MP4": (2.2, 1.5, 0.7),
    }
)
_ABSORPTION = MappingProxyType({"walls": 0.15, "carpet": 0.4, "tiles": 0.3})
_OWNERS = ("walls", "walls", "walls", "walls", "carpet", "tiles")
_B = (0.5, 0.35, 0.0)
_COLOUR_DB = (-6.0, -3.0, 0.0, -4.0, 2.0)  # of a loudspeaker, in octaves from 250 to 4000 Hz
# ISO 3382 values of the two pairs of the box as its walls are, at 500 and 1000 Hz. Written down, so
# that a change of the analysis shows in the cases that read responses and not in those of values.
_VALUES = MappingProxyType(
    {
        ("MP1", "EDT"): (0.33, 0.31),
        ("MP1", "T20"): (0.36, 0.35),
        ("MP1", "C80"): (10.1, 10.6),
        ("MP2", "EDT"): (0.32, 0.30),
        ("MP2", "T20"): (0.37, 0.34),
        ("MP2", "C80"): (10.6, 11.2),
    }
)
# In another state of the box, whose floor is covered: measured at a third place.
_COVERED = """
[[states]]
name = "covered"
materials = {floor = "rug"}
[materials.rug]
scattering = 0.0
[objects.people]
prior = {mean = 1.0, sd = 0.5}
states = ["covered"]
[[measurements]]
source = "LS1"
receiver = "MP3"
file = "covered.wav"
state = "covered"
"""
_DECAY_TIMES = """
[room]
shoebox = [8, 6, 3]
[room.materials]
walls = "walls"
floor = "floor"
ceiling = "ceiling"
[materials.ceiling]
absorption = 0.1
[reverberation]
file = "t30.csv"
formula = "Fitzroy"
"""
_TREATMENT = """
probability = 0.7
[surfaces.CEILING]
free_m2 = 9
[products.panel]
absorption = 0.9
sd = 0.02
piece_m2 = 0.6
cost_per_m2 = 60
[products.foil]
absorption = 0.5
piece_m2 = 1.0
cost_per_m2 = 30
[[targets]]
at_most = LIMIT
bands_hz = [1000]
"""
_HALL = """
[room]
shoebox = [9, 7, 4]
materials = {walls = "bricks", floor = "parquet", ceiling = "ceiling"}
[materials.parquet]
absorption = "parquet-on-concrete"
[materials.ceiling]
scattering = 0.3
[objects.audience]
outlines = [[[2.5, 1, 0], [8.5, 1, 0], [8.5, 6, 0], [2.5, 6, 0]]]
absorption_area_m2 = "audience-medium"
[sources.S]
position = [1.2, 3.1, 1.6]
directivity = {aim = [1, 0, 0], b = 0.4}
[receivers.A]
position = [4.2, 3.9, 1.2]
[receivers.B]
position = [7.1, 2.2, 1.2]
[speech]
level_dba = 60
noise_db = [45, 42, 40, 38, 36, 34, 32]
[identify]
from_hz = 125
to_hz = 8000
[settings]
n_rays = 4000
"""
# At 125 Hz; it rises by a tenth of that an octave.
_HALL_ABSORPTION = MappingProxyType({"bricks": 0.05, "parquet": 0.08, "ceiling": 0.3})
_HALL_TREATMENT = """
number = 1
probability = 0.6
[surfaces.bricks]
free_m2 = 8
forbidden = [[[0, 3, 0], [0, 4, 0], [0, 4, 2.1], [0, 3, 2.1]]]
[products.panel]
absorption = {centres_hz = [125, 500, 2000, 8000], values = [0.2, 0.8, 0.9, 0.85]}
piece_m2 = 4.0
[[targets]]
standard = "din-18041-a3"
[[targets]]
parameter = "STI"
at_least = 0.65
"""
_IMPEDANCE_HZ = np.arange(200.0, 501.0, 20.0)
_TAU_S = 0.006


@dataclass(frozen=True, slots=True)
class Case:
    """A case: its name, what it exercises, and the function that writes and runs it."""

    name: str
    about: str
    run: Callable[[Path, RunCommand], None]


def _responses(
    names: tuple[str, ...],
    b: tuple[float, ...] | None,
    absorption: Mapping[str, float] = _ABSORPTION,
    level_db: tuple[float, ...] = (0.0,) * 5,
) -> Mapping[str, FloatArray]:
    """Return the pressures in the box at some receivers, noise at -60 dB."""
    bands, air = bands_between("octave", 250, 4000), Air()
    truth = SyntheticBox(
        _SIZE_M,
        bands.centres_hz,
        np.array([[absorption[owner]] * len(bands) for owner in _OWNERS]),
        attenuation_per_m(air, bands),
        speed_of_sound_m_s(air),
    )
    rng, levels = np.random.default_rng(11), np.array(level_db)
    source, directed = np.array(_SOURCE_M), None if b is None else np.array(b)
    return {
        name: add_noise(
            pressure_response(
                truth, source, np.array(_PLACES_M[name]), 0.3, _RATE_HZ, levels, directed
            ),
            -60.0,
            rng,
        )
        for name in names
    }


def _write_box(
    folder: Path,
    *,
    files: tuple[str, ...] = ("MP1", "MP2"),
    values: tuple[str, ...] = (),
    identify: str = "from_hz = 500\nto_hz = 1000",
    materials: Mapping[str, str] = MappingProxyType({}),
    source: str = "",
    b: tuple[float, ...] | None = None,
) -> Path:
    """Write a campaign of the box of 30 m3 and return its path.

    Parameters
    ----------
    folder : Path
        An existing folder.
    files, values : tuple of receiver names
        Measured by an impulse response; by a table of ISO 3382 values.
    identify : str
        The campaign's table of this name.
    materials : mapping of material to lines of its table
    source : str
        Further lines of the source's table.
    b : tuple of float, optional
        Directivity of the true source, as for `pressure_response`.
    """
    lines = ["[room]", f"shoebox = {list(_SIZE_M)}", "[room.materials]"]
    lines += ['walls = "walls"', 'floor = "carpet"', 'ceiling = "tiles"']
    for name in _ABSORPTION:
        lines += [f"[materials.{name}]", "scattering = 0.0", materials.get(name, "")]
    lines += ["[sources.LS1]", f"position = {list(_SOURCE_M)}", "position_sd = 0.005", source]
    for name in dict.fromkeys((*files, *values)):
        lines += [f"[receivers.{name}]", f"position = {list(_PLACES_M[name])}"]
        lines += ["position_sd = 0.005"]
    for name, pressure in _responses(files, b).items():
        _write_wav(folder / f"{name}.wav", pressure)
        lines += ["[[measurements]]", 'source = "LS1"', f'receiver = "{name}"']
        lines += [f'file = "{name}.wav"']
    if values:
        rows = ["source,receiver,parameter,500,1000"]
        for (receiver, parameter), row in _VALUES.items():
            if receiver in values:
                rows.append(f"LS1,{receiver},{parameter},{row[0]},{row[1]}")
        (folder / "values.csv").write_text("\n".join(rows) + "\n")
        lines += ["[[measurements]]", 'parameters = "values.csv"']
    path = folder / "campaign.toml"
    path.write_text("\n".join([*lines, "[identify]", identify]) + "\n")
    return path


def _write_wav(path: Path, pressure: FloatArray) -> None:
    soundfile.write(path, np.asarray(pressure, dtype=np.float32), _RATE_HZ, subtype="FLOAT")


def _set_bands(campaign: Path, from_hz: int, to_hz: int) -> None:
    """Narrow the bands of a campaign that a simulator wrote."""
    text = campaign.read_text()
    for old, new in (("from_hz = 125", from_hz), ("to_hz = 4000", to_hz)):
        if old not in text:
            raise ValueError(f"{campaign} has no line {old!r}: the simulator writes it otherwise")
        text = text.replace(old, f"{old.split('=')[0]}= {new}")
    campaign.write_text(text)


def _identify(run: RunCommand, campaign: Path, folder: Path, name: str = "result") -> Path:
    run(IDENTIFY, campaign, "--out", folder / name)
    return folder / name


def _demo(folder: Path, run: RunCommand) -> None:
    run(DEMO, "--seed", 1, "--out", folder / "demo")


def _l_shaped(folder: Path, run: RunCommand) -> None:
    rng = np.random.default_rng(3)
    plan = polyhedron_plan("l-shaped", rng)
    pairs = (("LS1", "MP2"), ("LS1", "MP4"))
    kept = replace(
        plan,
        # walls that swallow much: short responses, and few reflections to follow
        absorption=np.full(plan.absorption.shape, 0.45) + 0.05 * rng.uniform(-1, 1, (6, 1)),
        duration_s=0.12,
        sources_m={"LS1": plan.sources_m["LS1"]},
        receivers_m={name: plan.receivers_m[name] for _, name in pairs},
        pairs=pairs,
    )
    campaign = write_measured_polyhedron(kept, folder, rng).campaign
    _set_bands(campaign, 1000, 1000)
    text = campaign.read_text() + 'positions = "fixed"\nwall_delays = false\n'
    for known in ("inner walls", "west", "south", "ends"):
        head = f'[materials."{known}"]\n'
        text = text.replace(head, f"{head}absorption = 0.45\n")
    campaign.write_text(text)
    _identify(run, campaign, folder)


def _parameters(folder: Path, run: RunCommand) -> None:
    campaign = _write_box(folder, files=(), values=("MP1", "MP2"))
    # unspecified, and to be assumed
    campaign.write_text(campaign.read_text().replace("scattering = 0.0\n", ""))
    _identify(run, campaign, folder)


def _parameters_and_responses(folder: Path, run: RunCommand) -> None:
    files = ("MP1", "MP3", "MP4")
    campaign = _write_box(folder, files=files, values=("MP2",))
    for name, pressure in _responses(files, None, level_db=_COLOUR_DB).items():
        _write_wav(folder / f"{name}.wav", pressure)
    _identify(run, campaign, folder)


def _directivity(folder: Path, run: RunCommand) -> None:
    reported = 'directivity = "fit"'
    campaign = _write_box(folder, files=tuple(_PLACES_M), source=reported, b=_B)
    _identify(run, campaign, folder)


def _scattering(folder: Path, run: RunCommand) -> None:
    plan = demo_plan()
    kept = replace(
        plan,
        sources_m={"LS1": plan.sources_m["LS1"]},
        receivers_m={name: plan.receivers_m[name] for name in ("MP1", "MP2")},
    )
    rng, walls = np.random.default_rng(5), np.full(6, 0.15)
    campaign = write_scattering_box(
        kept, walls, folder, rng, specified_scattering='"fit"', n_rays=10_000
    )
    _set_bands(campaign, 1000, 1000)
    _identify(run, campaign, folder)


def _impedance(folder: Path, run: RunCommand) -> None:
    scene = box_scene()
    model = wave_model(scene, _IMPEDANCE_HZ, _TAU_S)
    ones = np.ones((len(PAIRS), _IMPEDANCE_HZ.size), dtype=np.complex128)
    unit = Observed(_IMPEDANCE_HZ, _TAU_S, ones, np.zeros(ones.shape))
    pressure = predicted_pressure(model, true_r0(unit, scene.room.materials), at_rest(model))
    observed = noisy(_IMPEDANCE_HZ, _TAU_S, pressure, 40.0, np.random.default_rng(1))
    noise = np.broadcast_to(0.0 if observed.noise is None else observed.noise, ones.shape)
    lines = ["[room]", f"shoebox = {list(LENGTHS_M)}", "[room.materials]"]
    lines += [f'{surface} = "{WALLS.get(surface, "plaster")}"' for surface in SURFACES]
    lines += ["[air]", f"speed_of_sound_m_s = {SPEED_M_S}", 'attenuation = "none"']
    for kind, letter, places in (("sources", "S", SOURCES_M), ("receivers", "R", RECEIVERS_M)):
        for number, place in enumerate(places):
            lines += [f"[{kind}.{letter}{number}]", f"position = {list(place)}"]
    for number, (s, r) in enumerate(PAIRS):
        np.savez(
            folder / f"pair{number}.npz",
            f=_IMPEDANCE_HZ,
            tau=_TAU_S,
            p=observed.pressure[number],
            noise=noise[number],
        )
        lines += ["[[measurements]]", f'source = "S{s}"', f'receiver = "R{r}"']
        lines += [f'spectrum = "pair{number}.npz"']
    lines += ["[impedance]", "random_starts = 1", 'speed_of_sound = "fixed"']
    lines += ["from_hz = 200", "to_hz = 500", "[materials.plaster]", 'impedance = "auto"']
    campaign = folder / "campaign.toml"
    campaign.write_text("\n".join(lines) + "\n")
    run(IMPEDANCE, campaign, "--out", folder / "result")


def _what_follows(folder: Path, run: RunCommand) -> None:
    campaign = _write_box(
        folder,
        identify='from_hz = 1000\nto_hz = 1000\nmodel = "energy"\n'
        "[design]\nnew_sources = 1\nsource_distance_m = 0.8\nreceiver_distance_m = 0.5\ndraws = 2",
        materials={"tiles": "prior = {mean = 0.3, sd = 0.1}"},
    )
    found = _identify(run, campaign, folder) / "result.json"
    change = ("--set", "carpet=0.2+-0.05")
    run(
        *(PREDICT, campaign, "--absorption", found, *change),
        *("--out", folder / "predicted"),
    )
    chosen = ("--candidates", 40, "--choose", 1, "--result", found)
    run(DESIGN, campaign, *chosen, "--out", folder / "designed")
    wanted = _written(folder / "treatment.toml", _treatment("tiles", 0.25))
    run(TREAT, campaign, wanted, "--absorption", found, "--out", folder / "treated")


def _written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def _treatment(surface: str, t30_s: float) -> str:
    return _TREATMENT.replace("CEILING", surface).replace("LIMIT", str(t30_s))


def _states(folder: Path, run: RunCommand) -> None:
    smooth = 'from_hz = 500\nto_hz = 1000\nmodel = "energy"'
    campaign = _write_box(folder, identify=smooth)
    covered = _responses(("MP3",), None, {**_ABSORPTION, "carpet": 0.7})["MP3"]
    _write_wav(folder / "covered.wav", covered)
    place = f"[receivers.MP3]\nposition = {list(_PLACES_M['MP3'])}\nposition_sd = 0.005\n"
    campaign.write_text(campaign.read_text() + place + _COVERED)
    found = _identify(run, campaign, folder) / "result.json"
    run(
        *(PREDICT, campaign, "--absorption", found, "--state", "covered"),
        *("--doubted", "--out", folder / "predicted"),
    )


def _decay_times(folder: Path, run: RunCommand) -> None:
    campaign = _written(folder / "campaign.toml", _DECAY_TIMES)
    (folder / "t30.csv").write_text("place,500,1000\nfront,1.12,1.08\nback,1.08,1.12\n")
    wanted = _written(folder / "treatment.toml", _treatment("ceiling", 0.8))
    run(REVERBERATION, campaign, "--out", folder / "found")
    run(PREDICT, campaign, "--set", "ceiling=0.5+-0.05", "--out", folder / "predicted")
    run(TREAT, campaign, wanted, "--out", folder / "treated")


def _hall(folder: Path, run: RunCommand) -> None:
    campaign = _written(folder / "campaign.toml", _HALL)
    rows = ["material,band_hz,absorption,lower95,upper95,identifiable"]
    for name, first in _HALL_ABSORPTION.items():
        for i, band_hz in enumerate((125, 250, 500, 1000, 2000, 4000, 8000)):
            a = f"{first * (1.0 + 0.1 * i):.3f}"
            rows.append(f"{name},{band_hz},{a},{a},{a},true")
    known = _written(folder / "known.csv", "\n".join(rows) + "\n")
    predict = (PREDICT, campaign, "--absorption", known)
    run(*predict, "--set", "bricks=0.3+-0.05", "--out", folder / "predicted")
    run(*predict, "--grid", "1.2,4", "--out", folder / "mapped")
    wanted = _written(folder / "treatment.toml", _HALL_TREATMENT)
    run(TREAT, campaign, wanted, "--absorption", known, "--out", folder / "treated")


def _paper(folder: Path, run: RunCommand) -> None:
    run(PAPER, "--seeds", 2, "--workers", 1, "--out", folder / "paper")


CASES = (
    Case("demo", "the demo's shoebox: eight responses, six octaves", _demo),
    Case("l-shaped", "a room that is no box, from a mesh: two responses, one octave", _l_shaped),
    Case("parameters", "a table of ISO 3382 values alone, scattering unspecified", _parameters),
    Case(
        "mixed",
        "three coloured responses, ISO 3382 values of a pair",
        _parameters_and_responses,
    ),
    Case("directivity", "first-order directivity of the source fitted", _directivity),
    Case("scattering", "scattering of the walls fitted", _scattering),
    Case("impedance", "impedances of three materials from damped spectra", _impedance),
    Case("follow-up", "prediction, design and a treatment after a fit", _what_follows),
    Case("states", "two states, objects in one, smooth over bands, and a prediction", _states),
    Case("decay-times", "mean absorption, prediction and treatment by decay times", _decay_times),
    Case("hall", "speech, a map, seats and a standard in a hall of known absorption", _hall),
    Case("paper", "the paper's searches and certificates, two seeds", _paper),
)
