"""Boxes measured in another program, pyroomacoustics, and written as campaigns.

Image sources with phase that the other program enumerates, delays, filters and adds. The speed of
sound and the air of ISO 9613-1 are imposed on it, because its own differ. Its responses begin 40
samples late, which is taken off; between the octaves' centres it interpolates what a wall reflects.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from roomfit.base.air import Air, attenuation_per_m, speed_of_sound_m_s
from roomfit.base.bands import bands_between
from roomfit.demo.boxes import WALLS, SyntheticBox, add_noise, pressure_response

RATE_HZ = 16_000
LATE_SAMPLES = 40
DURATION_S = 0.45
HYBRID_ORDER = 20  # of images where rays follow, as that program's users take it


@dataclass(frozen=True)
class OtherBox:
    """What is true of a simulated room, and its campaign file."""

    campaign: Path
    lengths_m: np.ndarray
    materials: tuple[str, ...]
    absorption: np.ndarray  # (6, 7), octaves 125 to 8000 Hz
    positions_m: dict[str, np.ndarray]  # true ones
    speed_of_sound_m_s: float
    delays_s: np.ndarray  # (6,), what each wall adds at every reflection
    b: dict[str, np.ndarray]  # of each source: amplitude 1 + b . u in direction u

    def absorption_at(self, centres_hz: np.ndarray) -> np.ndarray:
        """Return the absorption at the centres of bands, (6, n_bands).

        Between the octaves' centres linear in the logarithm of frequency, as a reading of what the
        simulators do there: their band filters overlap by a half octave.
        """
        octaves = np.log(bands_between("octave", 125, 8000).centres_hz)
        return np.array([np.interp(np.log(centres_hz), octaves, row) for row in self.absorption])


def write_other_box(
    seed: int,
    folder: Path,
    *,
    n_pairs: int = 8,
    position_error_m: float = 0.01,
    c_error: float = 0.0,
    delay_s: float = 0.0,
    top_hz: float = 4000.0,
    strength: float = 0.0,
    specified: str = "omni",
    noise_db: float | None = None,
    rate_hz: int = RATE_HZ,
    scattering: float | None = None,
    objects_m2: float = 0.0,
    from_hz: float = 125.0,
    between: tuple[float, float] = (0.0, 1.0),
    covered: tuple[int, np.ndarray] | None = None,
    image_order: int = HYBRID_ORDER,
) -> OtherBox:
    """Simulate a random box from a seed and write it as a campaign into an existing folder.

    The room, the places and the materials of a seed are the same for any position error.

    Parameters
    ----------
    strength : float
        Length of b of every source, each with an aim of its own; the other program's cardioids.
    specified : str
        What the campaign says of the directivity: "omni" or "fit".
    noise_db : float, optional
        Level of the noise below the peak, -inf for none; left out: -60 to -45, drawn.
    scattering : float, optional
        Of every wall: images to `image_order`, then 20,000 rays of the other program; left out:
        image sources alone.
    objects_m2 : float
        Equivalent absorption area A of what stands in the room, in every band: the other program's
        pressures fall by ``exp(-A c t / (8 V))``. The campaign says nothing of it.
    between : tuple of float
        Lowest and highest absorption, by which what is drawn is clipped.
    covered : tuple of int and float array, optional
        A wall, by its number, and its absorption in seven octaves in place of its own.
    """
    import soundfile

    rng = np.random.default_rng([seed, 3])
    lengths = _lengths(rng)
    low, high = np.log(0.01 / 0.99), np.log(0.97 / 0.03)
    logit = rng.uniform(low, high, (6, 1)) + np.cumsum(rng.normal(0.0, 0.4, (6, 7)), axis=1)
    absorption = np.clip(1.0 / (1.0 + np.exp(-np.clip(logit, low, high))), *between)
    if covered is not None:
        absorption[covered[0]] = covered[1]
    n_sources, n_receivers = {1: (1, 1), 2: (1, 2), 4: (2, 2), 8: (2, 4), 16: (4, 4)}[n_pairs]
    places = _places(rng, lengths)
    at = {f"LS{i + 1}": places[i] for i in range(n_sources)}
    at |= {f"MP{i + 1}": places[4 + i] for i in range(n_receivers)}
    errors = rng.standard_normal((8, 3))
    drawn_db = rng.uniform(-60.0, -45.0)
    noise_db = drawn_db if noise_db is None else noise_db
    true = {n: p + position_error_m * errors[_place(n)] for n, p in at.items()}
    c = speed_of_sound_m_s(Air()) * (1.0 + c_error)
    pairs = [(s, r) for s in at if s[0] == "L" for r in at if r[0] == "M"]
    b = _aims(seed, lengths, [s for s in at if s[0] == "L"], at, strength)
    delays = np.where(absorption[:, 2] > 0.5, delay_s, 0.0)
    if delay_s:
        responses = _delayed(lengths, absorption, true, pairs, c, delays)
    else:
        box = lengths, absorption, scattering
        responses = _simulated(box, true, pairs, c, b, rate_hz, seed, image_order)
    rate = c * objects_m2 / (8.0 * float(np.prod(lengths)))
    for (s, r), whole in zip(pairs, responses, strict=True):
        pressure = whole * np.exp(-rate * np.arange(len(whole)) / rate_hz)
        noisy = add_noise(pressure, noise_db, rng).astype(np.float32)
        soundfile.write(folder / f"{s}_{r}.wav", noisy, rate_hz, subtype="FLOAT")
    materials = tuple(f"material_{wall}" for wall in WALLS)
    campaign = folder / "campaign.toml"
    fitted_hz = from_hz, top_hz
    text = _campaign_text(lengths, materials, at, pairs, position_error_m, fitted_hz, specified)
    campaign.write_text(text)
    return OtherBox(campaign, lengths, materials, absorption, true, c, delays, b)


def _aims(
    seed: int,
    lengths: np.ndarray,
    sources: list[str],
    at: dict[str, np.ndarray],
    strength: float,
) -> dict[str, np.ndarray]:
    """Return b of every source: towards the middle of the room, as people do, 30 degrees off."""
    rng = np.random.default_rng([seed, 5])
    out = {}
    for name in sources:
        toward = 0.5 * lengths - at[name]
        toward /= np.linalg.norm(toward)
        aim = toward + np.tan(np.pi / 6.0) * np.cross(toward, rng.standard_normal(3))
        out[name] = strength * aim / np.linalg.norm(aim)
    return out


def _place(name: str) -> int:
    return int(name[2:]) - 1 + (4 if name[0] == "M" else 0)


def _lengths(rng: np.random.Generator) -> np.ndarray:
    while True:
        lengths = rng.uniform((4.5, 3.6, 2.4), (9.0, 7.0, 3.8))
        if np.min(np.abs(np.diff(np.sort(lengths)))) > 0.15:  # no two sides alike
            return np.round(lengths, 3)


def _places(rng: np.random.Generator, lengths: np.ndarray) -> np.ndarray:
    """Return four sources and four receivers, 0.6 m from the walls and each pair 1 m apart."""
    while True:
        places = rng.uniform(0.6, lengths - 0.6, (8, 3))
        if np.min(np.linalg.norm(places[:4, None] - places[None, 4:], axis=-1)) > 1.0:
            return places


def _simulated(
    box: tuple[np.ndarray, np.ndarray, float | None],
    places: dict[str, np.ndarray],
    pairs: list[tuple[str, str]],
    c: float,
    b: dict[str, np.ndarray],
    rate_hz: int,
    seed: int,
    image_order: int,
) -> list[np.ndarray]:
    """Return the other program's responses of all pairs, time 0 at the emission.

    `box`: lengths, absorption, and scattering, None for image sources alone; `seed`: of its rays.
    """
    import pyroomacoustics as pra

    pra.random.seed(seed)

    lengths, absorption, scattering = box
    octaves = bands_between("octave", 125, 8000)
    names = ("west", "east", "south", "north", "floor", "ceiling")
    materials = {
        name: pra.Material(
            {"coeffs": list(a), "center_freqs": list(octaves.centres_hz)}, scattering
        )
        for name, a in zip(names, absorption, strict=True)
    }
    # every image that arrives in time: |i| + |j| + |k| is largest along (1/Lx, 1/Ly, 1/Lz)
    order = int(np.ceil(c * DURATION_S * np.sqrt(np.sum(lengths**-2.0)))) + 2
    sources = list(dict.fromkeys(s for s, _ in pairs))
    receivers = list(dict.fromkeys(r for _, r in pairs))
    room = pra.ShoeBox(
        list(lengths),
        fs=rate_hz,
        materials=materials,
        max_order=order if scattering is None else image_order,
        air_absorption=True,
        ray_tracing=scattering is not None,
    )
    room.set_sound_speed(c)
    if scattering is not None:
        room.set_ray_tracing(n_rays=20_000, receiver_radius=0.5)
    heard = bands_between("octave", 125, 125.0 * 2.0 ** (room.octave_bands.n_bands - 1))
    room.air_absorption = attenuation_per_m(Air(), heard)
    for s in sources:
        room.add_source(list(places[s]), directivity=_cardioid(b[s]))
    room.add_microphone_array(np.array([places[r] for r in receivers]).T)
    room.compute_rir()
    out = []
    n = round(DURATION_S * rate_hz)
    for s, r in pairs:
        rir = np.asarray(room.rir[receivers.index(r)][sources.index(s)], dtype=np.float64)
        out.append(rir[LATE_SAMPLES : LATE_SAMPLES + n])
    return out


def _cardioid(b: np.ndarray) -> Any:
    """Return the other program's source of amplitude 1 + b . u over 1 + |b|; None for b = 0."""
    from pyroomacoustics.directivities import CardioidFamily, DirectionVector

    length = float(np.linalg.norm(b))
    if length == 0.0:
        return None
    x, y, z = b / length
    axis = DirectionVector(np.arctan2(y, x), np.arccos(z), degrees=False)
    return CardioidFamily(axis, p=1.0 / (1.0 + length))


def _delayed(
    lengths: np.ndarray,
    absorption: np.ndarray,
    places: dict[str, np.ndarray],
    pairs: list[tuple[str, str]],
    c: float,
    delays_s: np.ndarray,
) -> list[np.ndarray]:
    """Return responses of walls that delay, from our own independent images."""
    octaves = bands_between("octave", 125, 8000)
    air = attenuation_per_m(Air(), octaves)
    sides = (float(lengths[0]), float(lengths[1]), float(lengths[2]))
    truth = SyntheticBox(sides, octaves.centres_hz, absorption, air, c, tuple(delays_s.tolist()))
    flat = np.zeros(len(octaves))
    return [
        pressure_response(truth, places[s], places[r], DURATION_S, float(RATE_HZ), flat)
        for s, r in pairs
    ]


def _campaign_text(
    lengths: np.ndarray,
    materials: tuple[str, ...],
    at: dict[str, np.ndarray],
    pairs: list[tuple[str, str]],
    position_error_m: float,
    between_hz: tuple[float, float],
    directivity: str,
) -> str:
    lines = ["[room]", f"shoebox = {lengths.tolist()}", "[room.materials]"]
    lines += [f'{wall} = "{name}"' for wall, name in zip(WALLS, materials, strict=True)]
    lines += ["[air]", "temperature_c = 20.0", "humidity_percent = 50.0"]
    for name in materials:
        lines += [f"[materials.{name}]", "scattering = 0.0"]
    for name, position in at.items():
        kind = "sources" if name[0] == "L" else "receivers"
        lines += [f"[{kind}.{name}]", f"position = {position.tolist()}"]
        lines += [f"position_sd = {position_error_m}"]
        if kind == "sources":
            lines += [f'directivity = "{directivity}"']
    for s, r in pairs:
        lines += ["[[measurements]]", f'source = "{s}"', f'receiver = "{r}"']
        lines += [f'file = "{s}_{r}.wav"']
    low, high = between_hz
    lines += ["[identify]", 'bands = "octave"', f"from_hz = {low:g}", f"to_hz = {high:g}"]
    lines += ["seed = 1"]
    return "\n".join(lines) + "\n"
