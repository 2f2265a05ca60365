"""Background noise that falls: how often an exponential window is found, and found where none is.

    python benchmarks/noise_tail.py [--seeds 101 300] [--power 30] [--boxes 20]

Campaigns of one to eight files at 16, 44.1 or 48 kHz: a click, reflections that become dense, a
decay of .2 to 2.5 s (half of them bent, fast at first), 2 to 30 ms before the direct sound, white
noise or noise that falls by 3 or 6 dB an octave. Windows exp(-t / T) of the pressure are put over
noise and sound. And boxes of another program, pyroomacoustics, by images and 20,000 rays that
scatter by .1, without noise and with it 60 dB below the peak, as they are and under a window.

"fast" counts campaigns whose window changes the decay rate as measured by 5 % or more: others do
less to absorption than intervals allow for, and are not named.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np

import roomfit
from roomfit.base.typing import FloatArray
from roomfit.checks import noise_tail
from roomfit.fit.measurements import collect_measurements
from roomfit.signals.response import ImpulseResponse

NOISES_DB = (-40.0, -50.0, -60.0, -70.0)
WINDOWS_S = (0.1, 0.2, 0.3, 0.5, 1.0, 2.0)
BOX_RATE_HZ = 16_000


def is_found(measured: list[Any]) -> bool:
    """Return whether the background noise of a campaign is said to fall."""
    evidence: Any = SimpleNamespace(measured=SimpleNamespace(responses=measured))
    return bool(list(noise_tail.check(evidence)))


def campaign(
    seed: int, noise_db: float | None, colour: int = 0, window_s: float = np.inf
) -> tuple[list[Any], float]:
    """Return files, and by how much their energy decays in a second."""
    rng = np.random.default_rng([seed, 77])
    n_files = int(rng.choice([1, 2, 4, 8]))
    rate_hz = float(rng.choice([16_000, 44_100, 48_000]))
    decay_s = float(np.exp(rng.uniform(np.log(0.2), np.log(2.5))))
    lead_s = rng.uniform(0.002, 0.03)
    t = np.arange(int((decay_s * rng.uniform(0.7, 2.5) + lead_s + 0.01) * rate_hz)) / rate_hz
    second_s, is_bent = decay_s * rng.uniform(0.3, 0.8), rng.random() < 0.5
    ring_per_s = 13.8 / decay_s + 2.0 / window_s
    out = []
    for _ in range(n_files):
        direct_s = lead_s + rng.uniform(0.003, 0.02)
        since = np.maximum(t - direct_s, 0.0)
        envelope = np.exp(-6.91 * since / decay_s)
        if is_bent:
            envelope += 2.0 * np.exp(-6.91 * since / second_s)
        density = np.minimum(1.0, 0.02 + 4e6 * since**2 / rate_hz)
        sparse = (rng.random(t.size) < density) / np.sqrt(density)
        x = 0.15 * rng.standard_normal(t.size) * envelope * sparse * (t > direct_s)
        x[int(direct_s * rate_hz)] = 1.0
        if noise_db is not None:
            x = x + 10.0 ** (noise_db / 20.0) * coloured(rng, t.size, rate_hz, colour)
        response = ImpulseResponse(x * np.exp(-t / window_s), rate_hz)
        out.append(
            SimpleNamespace(
                response=response,
                direct_s=direct_s,
                noise=SimpleNamespace(tail_time_constant_s=np.full(2, 1.0 / ring_per_s)),
                measurement=SimpleNamespace(use="fit", where="a file"),
            )
        )
    return out, ring_per_s


def coloured(rng: np.random.Generator, n: int, rate_hz: float, colour: int) -> FloatArray:
    """Return noise of unit power that falls by so many times 3 dB an octave above 50 Hz."""
    white = rng.standard_normal(n)
    if not colour:
        return white
    f_hz = np.maximum(np.fft.rfftfreq(n, 1.0 / rate_hz), 50.0)
    out = np.fft.irfft(np.fft.rfft(white) * f_hz ** (-0.5 * colour), n)
    return np.asarray(out / out.std())


def other_box(seed: int, scattering: float, n_rays: int) -> tuple[Any, list[list[FloatArray]]]:
    """Return a described box and the other program's responses, as it gives them."""
    import pyroomacoustics as pra

    rng = np.random.default_rng(seed)
    np.random.seed(seed)  # noqa: NPY002, which its rays are drawn with
    lengths = np.round(rng.uniform((4.5, 3.6, 2.4), (9.0, 7.0, 3.8)), 2)
    groups = ("ends", "ends", "sides", "sides", "floor", "ceiling")
    absorption = dict(zip(dict.fromkeys(groups), rng.uniform(0.05, 0.7, 4), strict=True))
    walls = ("west", "east", "south", "north", "floor", "ceiling")
    materials = {
        w: pra.Material(energy_absorption=float(absorption[g]), scattering=scattering or None)
        for w, g in zip(walls, groups, strict=True)
    }
    room = pra.ShoeBox(
        lengths, fs=BOX_RATE_HZ, materials=materials, max_order=20, ray_tracing=n_rays > 0
    )
    if n_rays:
        room.set_ray_tracing(n_rays=n_rays, receiver_radius=0.3)
    sources = rng.uniform(0.6, lengths - 0.6, (2, 3))
    receivers = rng.uniform(0.6, lengths - 0.6, (4, 3))
    while np.linalg.norm(sources[:, None] - receivers, axis=-1).min() < 1.0:
        receivers = rng.uniform(0.6, lengths - 0.6, (4, 3))
    for at in sources:
        room.add_source(list(at))
    room.add_microphone_array(receivers.T)
    room.compute_rir()
    scene = roomfit.scene_of(
        roomfit.shoebox_room(tuple(lengths), dict(zip(walls, groups, strict=True))),
        {f"S{i}": tuple(p) for i, p in enumerate(sources)},
        {f"R{j}": tuple(p) for j, p in enumerate(receivers)},
    )
    return scene, [[np.asarray(room.rir[j][i]) for j in range(4)] for i in range(2)]


def box_cases(
    seed: int, responses: list[list[FloatArray]], scene: Any
) -> Iterator[tuple[str, bool]]:
    """Yield what is found without and with noise, without and with a window."""
    for noise_db, window_s in ((None, np.inf), (-60.0, np.inf), (-60.0, 0.5), (-60.0, 0.3)):
        rng = np.random.default_rng([seed, 9])
        files = []
        for i, row in enumerate(responses):
            for j, response in enumerate(row):
                x = response
                if noise_db is not None:
                    x = x + np.abs(x).max() * 10 ** (noise_db / 20) * rng.standard_normal(x.size)
                x = x * np.exp(-np.arange(x.size) / BOX_RATE_HZ / window_s)
                files.append(
                    roomfit.Measurement(f"S{i}", f"R{j}", x, float(BOX_RATE_HZ), time_zero="direct")
                )
        try:
            measured = collect_measurements(
                scene, files, roomfit.bands_between("octave", 500, 2000), {}
            )
        except roomfit.base.errors.InputError:
            continue
        name = f"noise {noise_db or 'none'}, window {window_s:g} s"
        yield name, is_found(list(measured.responses))


def main() -> None:
    """Print a line for each kind of noise, window and box."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", type=int, nargs=2, default=(101, 300))
    parser.add_argument("--power", type=int, default=30, help="how many of the seeds get windows")
    parser.add_argument("--boxes", type=int, default=20)
    asked = parser.parse_args()
    seeds = range(asked.seeds[0], asked.seeds[1] + 1)
    kinds = [(noise, 0) for noise in (None, *NOISES_DB)] + [(-50.0, 1), (-50.0, 2)]
    for noise_db, colour in kinds:
        n = sum(is_found(campaign(seed, noise_db, colour)[0]) for seed in seeds)
        print(
            f"right, noise {noise_db}, -{3 * colour} dB an octave: {n} of {len(seeds)}", flush=True
        )
    for noise_db in NOISES_DB:
        for window_s in WINDOWS_S:
            made = [campaign(seed, noise_db, 0, window_s) for seed in seeds[: asked.power]]
            hits = [is_found(files) for files, _ in made]
            fast = [2.0 / window_s > 0.05 * ring for _, ring in made]
            n = sum(h for h, f in zip(hits, fast, strict=True) if f)
            print(
                f"window {window_s:g} s, noise {noise_db:g} dB: {sum(hits)} of {len(hits)}, "
                f"of the fast {n} of {sum(fast)}",
                flush=True,
            )
    for scattering, n_rays in ((0.1, 20_000), (0.0, 20_000), (0.0, 0)):
        found: dict[str, list[bool]] = {}
        for seed in seeds[: asked.boxes]:
            scene, responses = other_box(seed, scattering, n_rays)
            for name, hit in box_cases(seed, responses, scene):
                found.setdefault(name, []).append(hit)
        for name, hits in found.items():
            print(
                f"boxes, scattering {scattering:g}, {n_rays} rays, {name}: "
                f"{sum(hits)} of {len(hits)}",
                flush=True,
            )


if __name__ == "__main__":
    main()
