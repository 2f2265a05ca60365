"""Rooms measured or described wrongly, one fault at a time: is any confident number wrong?

    python benchmarks/hostile.py [--rooms 4 2 7] [--measured DATA] [--faults NAME ...] [--pairs 8]
        [--list]

Every fault is a function of one case, which is a described room with its recordings. The rooms are
boxes of another program, pyroomacoustics (`_other_box.py`), named by their seed, octaves 500 to
2000 Hz, positions 1 cm off; with --measured also state 000 of R3VIVAL in DATA/r3vival, where the
answer without a fault stands for the true one, and a value is wrong where both intervals miss it.

Printed for every case: how many values are called identifiable, how many of these miss their 95 %
interval ("out") and by more than .01 ("wrong"), the farthest miss, and the findings; "VOID" before
those that void identifiability. Absorption that the campaign fixes is not counted.
"""

from __future__ import annotations

import argparse
import math
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import resample_poly

import roomfit
from _other_box import write_other_box
from roomfit.base.errors import InputError, InsufficientDataError
from roomfit.base.findings import Code
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.demo.boxes import WALLS
from roomfit.files.inputs import load_campaign
from roomfit.identify import identify
from roomfit.materials.priors import MaterialPrior, unknown_material
from roomfit.result import Result
from roomfit.room.scene import Point, Scene

BANDS = roomfit.bands_between("octave", 500, 2000)
# Findings of nearly every one of these rooms: their decays are short.
QUIET = {Code.DECAY_RANGE_TOO_SMALL, Code.BELOW_SCHROEDER_FREQUENCY}
NEGLIGIBLE = 0.01


@dataclass(frozen=True)
class Case:
    """A described room with its recordings, and the absorption that is true of it."""

    arguments: dict[str, Any]  # of `roomfit.identify`
    absorption: FloatArray  # (n_materials, n_bands), materials in the order of the room
    interval: tuple[FloatArray, FloatArray] | None = None  # of a measured room's own answer

    @property
    def scene(self) -> Scene:
        """The described room."""
        scene: Scene = self.arguments["scene"]
        return scene

    @property
    def files(self) -> list[roomfit.Measurement]:
        """The recordings."""
        return list(self.arguments["measurements"])


Fault = Callable[[Case], Case]


def pressure(m: roomfit.Measurement) -> FloatArray:
    """Return the samples of a recording."""
    return np.array(m.samples, dtype=np.float64)


def with_files(case: Case, files: list[roomfit.Measurement]) -> Case:
    """Return the case with other recordings."""
    return replace(case, arguments={**case.arguments, "measurements": files})


def with_scene(case: Case, **changes: Any) -> Case:
    """Return the case with a scene described otherwise."""
    scene = replace(case.scene, **changes)
    return replace(case, arguments={**case.arguments, "scene": scene})


def on_samples(change: Callable[[FloatArray, float, float], FloatArray], first: int = -1) -> Fault:
    """Return what changes the samples of all files, or of the first ones.

    Parameters
    ----------
    change : callable
        Of samples, sampling rate in Hz, and the peak of all files.
    """

    def fault(case: Case) -> Case:
        peak = max(float(np.abs(pressure(m)).max()) for m in case.files)
        files = [
            replace(m, samples=change(pressure(m), float(m.sampling_rate_hz or 0), peak))
            if first < 0 or i < first
            else m
            for i, m in enumerate(case.files)
        ]
        return with_files(case, files)

    return fault


def envelope(x: FloatArray, rate_hz: float, seconds: float) -> FloatArray:
    """Return the root of the mean square over so many seconds about every sample."""
    n = max(int(seconds * rate_hz), 1)
    return np.sqrt(np.convolve(x**2, np.ones(n) / n, mode="same"))


def positions_off(metres: float) -> Fault:
    """Return what moves every specified position by so much in a random direction."""

    def fault(case: Case) -> Case:
        rng = np.random.default_rng(5)
        lengths = np.array(case.scene.room.shoebox_m)

        def moved(points: tuple[Point, ...]) -> tuple[Point, ...]:
            out = []
            for p in points:
                step = rng.standard_normal(3)
                at = p.position_m + metres * step / np.linalg.norm(step)
                out.append(replace(p, position_m=np.clip(at, 0.2, lengths - 0.2)))
            return tuple(out)

        return with_scene(
            case, sources=moved(case.scene.sources), receivers=moved(case.scene.receivers)
        )

    return fault


def swapped(case: Case) -> Case:
    """Exchange two files."""
    files = case.files
    one, other = files[0], files[1]
    files[0], files[1] = (
        replace(one, samples=other.samples),
        replace(other, samples=one.samples),
    )
    return with_files(case, files)


def ends_exchanged(case: Case) -> Case:
    """Exchange the positions of one source and one receiver."""
    (s, *sources), (r, *receivers) = case.scene.sources, case.scene.receivers
    return with_scene(
        case,
        sources=(replace(s, position_m=r.position_m), *sources),
        receivers=(replace(r, position_m=s.position_m), *receivers),
    )


def one_louder(case: Case) -> Case:
    """Raise one microphone, or one source where there is one microphone only, by 6 dB."""
    name = case.scene.receivers[0].name
    louder = [m.receiver == name for m in case.files]
    if all(louder):
        louder = [i % 2 == 0 for i in range(len(louder))]
    return with_files(
        case,
        [
            replace(m, samples=2.0 * pressure(m)) if up else m
            for m, up in zip(case.files, louder, strict=True)
        ],
    )


def other_room(case: Case) -> Case:
    """Take one file from a box of another seed."""
    with tempfile.TemporaryDirectory() as folder:
        other = load_campaign(write_other_box(11, Path(folder), n_pairs=1).campaign)
    measured = other["measurements"][0]
    assert isinstance(measured, roomfit.Measurement)
    taken = pressure(measured)
    first = case.files[0]
    rate_hz = int(first.sampling_rate_hz or 0)
    taken = resample_poly(taken, rate_hz // 1000, 16)
    taken *= np.abs(pressure(first)).max() / np.abs(taken).max()
    return with_files(case, [replace(first, samples=taken), *case.files[1:]])


def wrong_rate(case: Case) -> Case:
    """Specify 48 where it was 44.1."""
    files = [
        replace(m, sampling_rate_hz=float(m.sampling_rate_hz or 0) * 48 / 44.1) for m in case.files
    ]
    return with_files(case, files)


def twice(case: Case) -> Case:
    """Give every recording twice, under another name of its microphone."""
    again = tuple(replace(r, name=f"{r.name} b") for r in case.scene.receivers)
    n = len(case.scene.receivers)
    pairs = case.scene.pairs
    both = np.concatenate([pairs, pairs + np.array([0, n])])
    files = case.files + [
        replace(m, receiver=f"{m.receiver} b", name=f"{m.name} b") for m in case.files
    ]
    return with_files(
        with_scene(case, receivers=(*case.scene.receivers, *again), pairs=both), files
    )


def scaled(case: Case) -> Case:
    """Specify room and positions 1.1 times as large."""
    return _boxed(case, 1.1 * np.array(case.scene.room.shoebox_m), lambda p: 1.1 * p)


def mirrored(case: Case) -> Case:
    """Specify the plan mirrored: data cannot tell east from west."""
    lengths = np.array(case.scene.room.shoebox_m)
    return _boxed(case, lengths, lambda p: np.array([lengths[0] - p[0], p[1], p[2]]))


def longer(metres: float) -> Fault:
    """Return what puts the east wall so much farther out."""

    def fault(case: Case) -> Case:
        lengths = np.array(case.scene.room.shoebox_m) + np.array([metres, 0.0, 0.0])
        return _boxed(case, lengths, lambda p: p)

    return fault


def _boxed(case: Case, lengths_m: FloatArray, at: Callable[[FloatArray], FloatArray]) -> Case:
    names = case.scene.room.materials
    room = roomfit.shoebox_room(lengths_m.tolist(), dict(zip(WALLS, names, strict=True)))
    return with_scene(
        case,
        room=room,
        sources=tuple(replace(s, position_m=at(s.position_m)) for s in case.scene.sources),
        receivers=tuple(replace(r, position_m=at(r.position_m)) for r in case.scene.receivers),
    )


def wall_specified(by: float) -> Fault:
    """Return what fixes the absorption of the last material, the ceiling, so much off."""

    def fault(case: Case) -> Case:
        true = case.absorption[-1]
        known = np.where(true + by < 0.95, true + by, true - by)
        priors = list(case.arguments["materials"])
        priors[-1] = replace(priors[-1], known=np.clip(known, 0.02, 0.98))
        return replace(case, arguments={**case.arguments, "materials": tuple(priors)})

    return fault


def too_warm(case: Case) -> Case:
    """Specify 35 degrees for 20, and exactly."""
    air = roomfit.Air(temperature_c=35.0, humidity_percent=50.0)
    settings = replace(case.arguments["settings"], temperature_sd_c=0.01)
    case = with_scene(case, air=air)
    return replace(case, arguments={**case.arguments, "settings": settings})


def power(exponent: float) -> Fault:
    """Return a compressor, or an expander above 1, of the samples."""
    return on_samples(lambda x, _, peak: np.sign(x) * np.abs(x / peak) ** exponent)


def exponential_window(seconds: float) -> Fault:
    """Return what multiplies by exp(-t / seconds)."""
    return on_samples(lambda x, rate_hz, _: x * np.exp(-np.arange(x.size) / rate_hz / seconds))


def _limited(x: FloatArray, rate_hz: float, peak: float) -> FloatArray:
    return np.asarray(
        x * np.minimum(1.0, 0.3 * peak / np.maximum(3.0 * envelope(x, rate_hz, 2e-3), 1e-12))
    )


def _gated(x: FloatArray, rate_hz: float, _: float) -> FloatArray:
    own = envelope(x, rate_hz, 10e-3)
    return np.asarray(np.where(own > 0.01 * own.max(), x, 0.0))


def _denoised(x: FloatArray, rate_hz: float, _: float) -> FloatArray:
    own = envelope(x, rate_hz, 20e-3)
    floor = np.sqrt(np.mean(x[-x.size // 20 :] ** 2))
    return np.asarray(
        x * np.sqrt(np.maximum(1.0 - (2.0 * floor / np.maximum(own, 1e-12)) ** 2, 0.0))
    )


def _averaged(x: FloatArray, *_: float) -> FloatArray:
    """Return the mean of eight in which people move: time runs 3 in 10,000 faster or slower."""
    rng = np.random.default_rng(7)
    t = np.arange(x.size, dtype=np.float64)
    fine = resample_poly(x, 8, 1)
    dense = np.arange(fine.size) / 8.0
    each = [np.interp(t * (1 + 3e-4 * rng.standard_normal()), dense, fine) for _ in range(8)]
    return np.asarray(np.mean(each, axis=0))


def _hum(x: FloatArray, rate_hz: float, _: float) -> FloatArray:
    t = np.arange(x.size) / rate_hz
    hum = sum(a * np.sin(2 * np.pi * f * t) for f, a in ((50, 1.0), (100, 0.5), (150, 0.7)))
    return np.asarray(x + 0.1 * np.abs(x).max() / 1.3 * np.asarray(hum))


def _few_bits(x: FloatArray, _: float, peak: float) -> FloatArray:
    return np.round(x / peak * 127.0) / 127.0


def ten_seconds_at_192_khz(case: Case) -> Case:
    """Continue every file to 10 s with noise as at its end, and resample it: no fault, but long."""
    files = []
    for i, m in enumerate(case.files):
        x, rate_hz = pressure(m), int(m.sampling_rate_hz or 0)
        noise = np.std(x[-x.size // 20 :]) * np.random.default_rng(i).standard_normal(10 * rate_hz)
        noise[: x.size] = x
        common = math.gcd(192_000, rate_hz)
        longer = resample_poly(noise, 192_000 // common, rate_hz // common)
        files.append(replace(m, samples=longer, sampling_rate_hz=192_000.0))
    return with_files(case, files)


FAULTS: dict[str, Fault] = {
    "none": lambda case: case,
    "compressor 0.9": power(0.9),
    "expander 1.1": power(1.1),
    "exponential window 0.3 s": exponential_window(0.3),
    "exponential window 1 s": exponential_window(1.0),
    "limiter": on_samples(_limited),
    "clipped at half": on_samples(lambda x, _, peak: np.clip(x, -0.5 * peak, 0.5 * peak)),
    "noise gate": on_samples(_gated),
    "denoised": on_samples(_denoised),
    "people move": on_samples(_averaged),
    "8 bit": on_samples(_few_bits),
    "resampled": on_samples(lambda x, *_: resample_poly(resample_poly(x, 3, 4), 4, 3)),
    "10 s at 192 kHz": ten_seconds_at_192_khz,
    "hum -20 dB": on_samples(_hum),
    "every file twice": twice,
    "ceiling fixed and right": wall_specified(0.0),
    "ceiling fixed .1 off": wall_specified(0.1),
    "ceiling fixed .3 off": wall_specified(0.3),
    "35 degrees, exactly": too_warm,
    "3 cm": positions_off(0.03),
    "10 cm": positions_off(0.1),
    "30 cm": positions_off(0.3),
    "files swapped": swapped,
    "ends exchanged": ends_exchanged,
    "one +6 dB": one_louder,
    "another room's file": other_room,
    "sampling rate": wrong_rate,
    "5 ms late": on_samples(lambda x, rate_hz, _: np.pad(x, (round(5e-3 * rate_hz), 0)), 1),
    "reversed": on_samples(lambda x, *_: x[::-1].copy(), 1),
    "silent": on_samples(lambda x, *_: 0.0 * x, 1),
    "polarity": on_samples(lambda x, *_: -x, 1),
    "1.1 times": scaled,
    "mirrored": mirrored,
    "wall 0.3 m out": longer(0.3),
    "wall missing": longer(2.5),
}


def box(
    seed: int,
    n_pairs: int,
    bands: roomfit.Bands = BANDS,
    scattering: float = 0.0,
    simulated: Mapping[str, Any] | None = None,
) -> Case:
    """Return a box of the other program.

    `scattering` is what is specified of every wall; `simulated` are further arguments of
    `write_other_box`.
    """
    with tempfile.TemporaryDirectory() as folder:
        made = write_other_box(seed, Path(folder), n_pairs=n_pairs, **(simulated or {}))
        arguments = load_campaign(made.campaign)
    truth = dict(zip(made.materials, made.absorption_at(bands.centres_hz), strict=True))
    return described(arguments, truth, bands, scattering)


def described(
    arguments: Mapping[str, Any],
    truth: Mapping[str, FloatArray],
    bands: roomfit.Bands,
    scattering: float,
) -> Case:
    """Return a case in these bands with broad priors.

    `truth` is the absorption of each material, (n_bands,); `scattering` is specified of each.
    """
    names = arguments["scene"].room.materials
    n = len(bands)
    priors = tuple(
        replace(unknown_material(name, n), scattering=np.full(n, scattering)) for name in names
    )
    return Case(
        {**arguments, "bands": bands, "materials": priors}, np.array([truth[k] for k in names])
    )


def measured_room(data: Path) -> Case:
    """Return state 000 of R3VIVAL with six loudspeakers; its own answer stands for the truth."""
    from known_changes import r3vival

    scene, files, directivities = r3vival(data, "000", 60, ["200"])
    names = scene.room.materials
    arguments: dict[str, Any] = {
        "scene": scene,
        "measurements": files,
        "materials": tuple(unknown_material(n, len(BANDS)) for n in names),
        "bands": BANDS,
        "directivities": directivities,
        "settings": roomfit.Settings(),
    }
    found = identify(**arguments)
    return Case(arguments, found.absorption, (found.lower95, found.upper95))


@dataclass(frozen=True)
class Outcome:
    """What became of one case."""

    refused: str = ""
    n_identifiable: int = 0
    out: int = 0
    wrong: int = 0
    farthest: float = 0.0
    codes: tuple[Code, ...] = ()
    phi: tuple[float, ...] = ()
    seconds: float = 0.0


def outcome(case: Case, fault: Fault) -> Outcome:
    """Identify a case with a fault."""
    cpu = time.process_time()
    try:
        case = fault(case)
        answer = identify(**case.arguments)
    except (InputError, InsufficientDataError) as refusal:
        return Outcome(refused=refusal.what, seconds=time.process_time() - cpu)
    miss = missed_by(answer, case)
    sure = answer.identifiable & ~fixed(case.arguments["materials"])
    codes = {f.code for f in answer.findings if f.severity != "info"} - QUIET
    return Outcome(
        "",
        int(sure.sum()),
        int((sure & (miss > 0.0)).sum()),
        int((sure & (miss > NEGLIGIBLE)).sum()),
        float(miss[sure].max(initial=0.0)),
        tuple(sorted(codes)),
        tuple(answer.chi2_reduced.round(1).tolist()),
        time.process_time() - cpu,
    )


def fixed(priors: tuple[MaterialPrior, ...]) -> BoolArray:
    """Return which absorptions a campaign fixes, shape (n_materials, 1)."""
    return np.array([[k.known is not None] for k in priors])


def missed_by(answer: Result, case: Case) -> FloatArray:
    """Return how far the true absorption lies outside of each interval, 0 or more."""
    true = case.absorption
    miss = np.maximum(np.maximum(answer.lower95 - true, true - answer.upper95), 0.0)
    if case.interval is not None:
        low, high = case.interval
        a = answer.absorption
        miss = np.minimum(miss, np.maximum(np.maximum(low - a, a - high), 0.0))
    return np.asarray(miss)


def line(room: str, name: str, o: Outcome) -> str:
    """Return one row."""
    if o.refused:
        return f"{room:>8} {name:<26} refused: {o.refused}"
    codes = sorted(o.codes, key=lambda c: not c.voids_identifiability)
    words = " ".join(f"VOID:{c}" if c.voids_identifiability else str(c) for c in codes)
    phi = " ".join(f"{p:.1f}" for p in o.phi)
    return (
        f"{room:>8} {name:<26} {o.n_identifiable:4d} {o.out:4d} {o.wrong:5d} {o.farthest:5.2f}"
        f" {o.seconds:4.0f} s  {phi}  {words}"
    )


def main() -> None:
    """Run the faults room by room, a line each."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--rooms", type=int, nargs="*", default=[4, 2, 7])
    parser.add_argument("--measured", type=Path, help="the folder that holds r3vival")
    parser.add_argument("--faults", nargs="+", choices=list(FAULTS), default=list(FAULTS))
    parser.add_argument("--pairs", type=int, default=8, choices=(2, 4, 8, 16))
    parser.add_argument("--list", action="store_true", help="print the names of the faults")
    asked = parser.parse_args()
    if asked.list:
        print("\n".join(FAULTS))
        return
    print(f"{'room':>8} {'fault':<26} iden  out wrong   far    CPU  phi  findings", flush=True)
    cases: list[tuple[str, Callable[[], Case]]] = [
        (str(seed), partial(box, seed, asked.pairs)) for seed in asked.rooms
    ]
    if asked.measured is not None:
        cases.append(("r3vival", partial(measured_room, asked.measured)))
    for room, make in cases:
        case = make()
        for name in asked.faults:
            print(line(room, name, outcome(case, FAULTS[name])), flush=True)


if __name__ == "__main__":
    main()
