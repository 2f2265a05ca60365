"""Impulse responses and campaigns of boxes with known walls, independent of the fitted model.

Image sources add as pressures: no rays, no energies, no windows, no filters of `roomfit.signals`,
an own enumeration of the images, positions that differ from the specified ones, a loudspeaker whose
unspecified gain varies over frequency, and background noise.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from roomfit.base.air import Air, attenuation_per_m, speed_of_sound_m_s
from roomfit.base.bands import bands_between
from roomfit.base.typing import BoolArray, ComplexArray, FloatArray, Progress
from roomfit.base.whole_files import write_text_atomically

WALLS = ("west", "east", "south", "north", "floor", "ceiling")

# Images are gridded so many times finer than the samples and brought down by the Fourier
# transform: at 16 times and 16 kHz, half a step is 2 microseconds, 0.05 rad at 4 kHz.
_OVERSAMPLING = 16
_NOTHING = 1e-30  # of energy


@dataclass(frozen=True, slots=True, eq=False)
class SyntheticBox:
    """A box whose walls are known."""

    lengths_m: tuple[float, float, float]  # in x, y, z; one corner at the origin
    # (n_bands,), of adjacent octaves or third octaves, rising; absorption applies at a centre and
    # changes smoothly in between
    centres_hz: FloatArray
    absorption: FloatArray  # (6, n_bands), of west, east, south, north, floor, ceiling
    attenuation_per_m: FloatArray  # (n_bands,), of energy in air
    speed_of_sound_m_s: float
    delays_s: tuple[float, ...] = (0.0,) * 6  # of each wall at every reflection


def pressure_response(
    synthetic: SyntheticBox,
    source_m: FloatArray,
    receiver_m: FloatArray,
    duration_s: float,
    sampling_rate_hz: float,
    level_db: FloatArray,
    b: FloatArray | None = None,
) -> FloatArray:
    """Return the sound pressure at the receiver after an impulse at the source at time 0.

    Every image within the duration contributes ``1 / (4 pi r)`` at time r / c, times the root of
    what each wall reflects, interpolated smoothly between the octaves' centres. The loudspeaker's
    levels have the phase of a minimum-phase filter.

    Shape (n_samples,). Shapes: `source_m, receiver_m` (3,), `level_db` (n_bands,), `b` (3,).
    """
    images = box_images(synthetic, source_m, receiver_m, duration_s)
    sent = None
    if b is not None:
        sent = 1.0 + box_departures(synthetic, source_m, receiver_m, duration_s) @ b
    return pressure_of_images(images, synthetic, duration_s, sampling_rate_hz, level_db, sent)


class SyntheticWalls(Protocol):
    """Known walls and air, whatever the shape of the room; see `SyntheticBox`."""

    @property
    def centres_hz(self) -> FloatArray: ...
    @property
    def absorption(self) -> FloatArray: ...
    @property
    def attenuation_per_m(self) -> FloatArray: ...
    @property
    def speed_of_sound_m_s(self) -> float: ...
    @property
    def delays_s(self) -> tuple[float, ...]: ...


def pressure_of_images(
    images: tuple[FloatArray, FloatArray],
    synthetic: SyntheticWalls,
    duration_s: float,
    sampling_rate_hz: float,
    level_db: FloatArray,
    sent: FloatArray | None = None,
) -> FloatArray:
    """Return the sound pressure that images of one pair make together, see `pressure_response`.

    Shapes: `level_db` (n_bands,), `sent` (n_images,).
    """
    lengths, hits = images
    factor = np.ones(lengths.size) if sent is None else sent
    n_samples = round(duration_s * sampling_rate_hz)
    times_s = lengths / synthetic.speed_of_sound_m_s + hits @ np.array(synthetic.delays_s)

    def amplitude(band: int) -> FloatArray:
        # with absorption 1, a path that never strikes the wall is unchanged: 0 times log 0 is 0
        left = np.log(np.maximum(1.0 - synthetic.absorption[:, band], _NOTHING))
        lost = hits @ left - synthetic.attenuation_per_m[band] * lengths
        return np.asarray(factor * np.exp(0.5 * lost) / (4.0 * np.pi * lengths))

    spectrum = spectrum_of_impulses(
        times_s, amplitude, synthetic.centres_hz, n_samples, sampling_rate_hz, _OVERSAMPLING
    )
    frequencies = np.linspace(0.0, 0.5 * sampling_rate_hz, n_samples + 1)
    spectrum *= loudspeaker(synthetic.centres_hz, level_db, frequencies)
    return np.asarray(np.fft.irfft(spectrum, 2 * n_samples)[:n_samples])


def spectrum_of_impulses(
    times_s: FloatArray,
    amplitude: Callable[[int], FloatArray],
    centres_hz: FloatArray,
    n_samples: int,
    sampling_rate_hz: float,
    oversampling: int,
) -> ComplexArray:
    """Return the spectrum, (n_samples + 1,), of impulses whose amplitudes differ between bands.

    `amplitude` gives those of a band, by its index. Twice the length, so that the tails of the
    band-limited impulses do not wrap around.
    """
    index = np.round(times_s * sampling_rate_hz * oversampling).astype(np.int64)
    frequencies = np.linspace(0.0, 0.5 * sampling_rate_hz, n_samples + 1)
    spectrum = np.zeros(n_samples + 1, dtype=np.complex128)
    for band, share in enumerate(octave_shares(centres_hz, frequencies)):
        impulse_grid = np.bincount(index, amplitude(band), 2 * n_samples * oversampling)
        spectrum += share * np.fft.rfft(impulse_grid)[: n_samples + 1]
    return spectrum


def box_images(
    synthetic: SyntheticBox, source_m: FloatArray, receiver_m: FloatArray, duration_s: float
) -> tuple[FloatArray, FloatArray]:
    """Return length (n_images,) and hits per wall (n_images, 6) of all images in time.

    J. B. Allen and D. A. Berkley, "Image method for efficiently simulating small-room acoustics",
    J. Acoust. Soc. Am. 65, 943-950 (1979): along each axis the images lie at 2 n L + s with |n|
    hits on either wall, and at 2 n L - s with |n - 1| on the wall at 0 and |n| on the other.
    """
    steps, hits, _ = box_lattice(synthetic, source_m, receiver_m, duration_s)
    return np.asarray(np.linalg.norm(steps, axis=0)), hits


def box_departures(
    synthetic: SyntheticBox, source_m: FloatArray, receiver_m: FloatArray, duration_s: float
) -> FloatArray:
    """Return where the sound of each of `box_images` leaves the source, unit vectors (n_images, 3).

    From image to receiver, mirrored along the axes along which the image is.
    """
    steps, _, mirrored = box_lattice(synthetic, source_m, receiver_m, duration_s)
    away = -steps / np.linalg.norm(steps, axis=0)
    return np.asarray(np.where(mirrored, -away, away).T)


def box_lattice(
    synthetic: SyntheticBox, source_m: FloatArray, receiver_m: FloatArray, duration_s: float
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return steps from receiver to all images in time (3, n), hits (n, 6), mirrored axes (3, n).

    Hits count west, east, south, north, floor, ceiling.
    """
    reach_m = synthetic.speed_of_sound_m_s * duration_s
    offsets, low_hits, high_hits, turned = [], [], [], []
    for length, s, r in zip(synthetic.lengths_m, source_m, receiver_m, strict=True):
        n = np.arange(-int(reach_m / (2 * length)) - 2, int(reach_m / (2 * length)) + 3)
        offsets.append(np.concatenate((2 * n * length + s - r, 2 * n * length - s - r)))
        low_hits.append(np.concatenate((np.abs(n), np.abs(n - 1))))
        high_hits.append(np.concatenate((np.abs(n), np.abs(n))))
        turned.append(np.repeat([False, True], n.size))
    squares = [o**2 for o in offsets]
    whole = squares[0][:, None, None] + squares[1][:, None] + squares[2]
    chosen = np.nonzero(whole < (reach_m * (1.0 - 1e-9)) ** 2)
    steps = np.stack([offsets[axis][chosen[axis]] for axis in range(3)])
    hits = [h[chosen[axis]] for axis in range(3) for h in (low_hits[axis], high_hits[axis])]
    mirrored = np.stack([turned[axis][chosen[axis]] for axis in range(3)])
    return steps, np.stack(hits, axis=1), mirrored


def add_noise(pressure: FloatArray, level_db: float, rng: np.random.Generator) -> FloatArray:
    """Return the response with white Gaussian noise of a level relative to its peak."""
    sd = float(np.max(np.abs(pressure))) * 10.0 ** (level_db / 20.0)
    return np.asarray(pressure + sd * rng.standard_normal(pressure.size))


def loudspeaker(
    centres_hz: FloatArray, level_db: FloatArray, frequencies_hz: FloatArray
) -> ComplexArray:
    """Return the minimum-phase spectrum whose level runs smoothly through those at the centres.

    Its phase is the Hilbert transform of its log magnitude, by folding the cepstrum.
    A. V. Oppenheim, R. W. Schafer, Discrete-Time Signal Processing, 3rd ed., 2010, section 13.
    """
    steps = _per_octave(centres_hz) * np.log2(np.maximum(frequencies_hz, 1.0) / centres_hz[0])
    level = np.interp(steps, np.arange(centres_hz.size), level_db)
    cepstrum = np.fft.irfft(level * np.log(10.0) / 20.0)
    n = cepstrum.size
    cepstrum[1 : n // 2] *= 2.0
    cepstrum[n // 2 + 1 :] = 0.0
    return np.exp(np.fft.rfft(cepstrum))


def octave_shares(centres_hz: FloatArray, frequencies_hz: FloatArray) -> FloatArray:
    """Return the share of each band at each frequency; shares add to one inside the range.

    Octaves, or third octaves where the centres lie that near. A share falls from 1 at its own
    centre to 0 at its neighbours', so that walls and loudspeaker change smoothly over frequency;
    steps would ring for tens of milliseconds, as no wall does.
    """
    n = _per_octave(centres_hz)
    ends = centres_hz[0] * 2.0 ** (np.arange(-1, centres_hz.size) / n)
    steps = n * np.log2(np.maximum(frequencies_hz, 1e-3)[None, :] / ends[:, None])
    above = 0.5 * (1.0 - np.cos(np.pi * np.clip(steps, 0.0, 1.0)))
    return np.asarray(above[:-1] - above[1:])


def _per_octave(centres_hz: FloatArray) -> int:
    """Return how many bands make an octave; a single band is an octave."""
    return 1 if centres_hz.size < 2 else round(1.0 / float(np.log2(centres_hz[1] / centres_hz[0])))


SAMPLING_RATE_HZ = 32_000.0
DURATION_S = 0.8
POSITION_ERROR_M = 0.01
NOISE_DB = -60.0
PLAN_BANDS = bands_between("octave", 63, 8000)  # also outside the fitted range
SMOOTH = "0.0  # smooth, bare walls"  # scattering as a campaign specifies it


@dataclass(frozen=True, slots=True, eq=False)
class BoxPlan:
    """A box to be measured: its true walls, and the specified positions."""

    lengths_m: tuple[float, float, float]
    materials: tuple[str, ...]  # of west, east, south, north, floor and ceiling
    absorption: FloatArray  # (6, 8), in `PLAN_BANDS`
    sources_m: dict[str, tuple[float, float, float]]  # by name
    receivers_m: dict[str, tuple[float, float, float]]  # by name


def demo_plan() -> BoxPlan:
    """Return the room of the demo: six walls of common make."""
    walls = {
        "curtain": (0.05, 0.07, 0.25, 0.45, 0.60, 0.65, 0.70, 0.70),
        "brick": (0.02, 0.03, 0.03, 0.04, 0.05, 0.06, 0.07, 0.07),
        "windows": (0.30, 0.28, 0.20, 0.12, 0.08, 0.05, 0.04, 0.04),
        "panelling": (0.30, 0.25, 0.18, 0.12, 0.10, 0.10, 0.11, 0.12),
        "carpet": (0.04, 0.08, 0.14, 0.25, 0.37, 0.50, 0.60, 0.62),
        "tiles": (0.25, 0.35, 0.50, 0.65, 0.75, 0.80, 0.75, 0.70),
    }
    return BoxPlan(
        (6.1, 4.7, 2.8),
        tuple(walls),
        np.array(list(walls.values())),
        {"LS1": (1.20, 1.50, 1.10), "LS2": (4.85, 3.30, 1.62)},
        {
            "MP1": (4.10, 2.90, 1.20),
            "MP2": (2.30, 3.75, 1.45),
            "MP3": (5.20, 1.15, 1.83),
            "MP4": (3.10, 0.85, 0.92),
        },
    )


def simulated_responses(
    plan: BoxPlan, rng: np.random.Generator, progress: Progress | None = None
) -> dict[tuple[str, str], FloatArray]:
    """Return simulated impulse responses of every source with every receiver of a box.

    Image sources whose pressures add; a loudspeaker with a spectrum and a phase of its own. True
    positions are a centimetre off the specified ones; noise lies 60 dB below each response's peak.

    `rng`: draws position errors, loudspeaker levels and noise.

    Shape (n_samples,).
    """
    synthetic, true_at = true_box(plan, POSITION_ERROR_M, rng)
    levels_db = {s: rng.normal(0.0, 3.0, len(PLAN_BANDS)) for s in plan.sources_m}
    pairs = [(s, r) for s in plan.sources_m for r in plan.receivers_m]
    found = {}
    for number, (s, r) in enumerate(pairs):
        pressure = pressure_response(
            synthetic, true_at[s], true_at[r], DURATION_S, SAMPLING_RATE_HZ, levels_db[s]
        )
        found[s, r] = add_noise(pressure, NOISE_DB, rng)
        if progress is not None:
            progress((number + 1) / len(pairs))
    return found


def true_box(
    plan: BoxPlan, position_error_m: float, rng: np.random.Generator
) -> tuple[SyntheticBox, dict[str, FloatArray]]:
    """Return the box of a plan in usual air, and true positions about the specified ones."""
    attenuation, c = attenuation_per_m(Air(), PLAN_BANDS), speed_of_sound_m_s(Air())
    synthetic = SyntheticBox(plan.lengths_m, PLAN_BANDS.centres_hz, plan.absorption, attenuation, c)
    return synthetic, {
        name: np.array(position_m) + position_error_m * rng.standard_normal(3)
        for name, position_m in (*plan.sources_m.items(), *plan.receivers_m.items())
    }


def write_measured_box(
    plan: BoxPlan, folder: Path, rng: np.random.Generator, progress: Progress | None = None
) -> Path:
    """Write `simulated_responses` into an existing folder, as a campaign; return its file."""
    return write_box_campaign(plan, folder, simulated_responses(plan, rng, progress))


def write_box_campaign(
    plan: BoxPlan,
    folder: Path,
    responses: Mapping[tuple[str, str], FloatArray],
    *,
    position_error_m: float = POSITION_ERROR_M,
    scattering: str = SMOOTH,
) -> Path:
    """Write responses of a box as WAV files and `campaign_text` beside them; return its file."""
    import soundfile

    for (s, r), pressure in responses.items():
        samples = pressure.astype(np.float32)
        soundfile.write(folder / f"{s}_{r}.wav", samples, int(SAMPLING_RATE_HZ), subtype="FLOAT")
    text = campaign_text(plan, list(responses), position_error_m, scattering=scattering)
    return write_text_atomically(folder / "campaign.toml", text)


def campaign_text(
    plan: BoxPlan,
    pairs: list[tuple[str, str]],
    position_error_m: float,
    *,
    scattering: str = SMOOTH,
) -> str:
    """Return a campaign file of a box; `scattering` is the specified one of every wall."""
    lines = ["[room]", f"shoebox = {list(plan.lengths_m)}", "[room.materials]"]
    lines += [f'{wall} = "{name}"' for wall, name in zip(WALLS, plan.materials, strict=True)]
    lines += ["[air]", "temperature_c = 20.0", "humidity_percent = 50.0"]
    for name in plan.materials:
        lines += [f"[materials.{name}]", f"scattering = {scattering}"]
    for kind, points in (("sources", plan.sources_m), ("receivers", plan.receivers_m)):
        for name, position in points.items():
            lines += [f"[{kind}.{name}]", f"position = {list(position)}"]
            lines += [f"position_sd = {position_error_m}"]
    for s, r in pairs:
        lines += ["[[measurements]]", f'source = "{s}"', f'receiver = "{r}"']
        lines += [f'file = "{s}_{r}.wav"']
    lines += ["[identify]", 'bands = "octave"', "from_hz = 125", "to_hz = 4000", "seed = 1"]
    return "\n".join(lines) + "\n"
