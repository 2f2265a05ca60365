"""Impulse responses of a box whose walls scatter, from a road that shares nothing with the model.

What is reflected specularly all the way comes from image sources that add as pressures. All else is
noise whose power in time follows rays of an own tracer, in plain numpy: walls of a box only, energy
conserved at every hit, other seeds and other random numbers than those of `roomfit.tracing`.

A campaign as somebody might have measured it, in a box whose walls are known.

Sources stand a centimetre or so from where the campaign says, the loudspeaker's level changes from
octave to octave and is told to nobody, and every file holds noise.

Image sources of a box with something on one of its walls that nobody was told of.

An open door, a curtain, a window: a rectangle with an absorption of its own. A path strikes it
where its straight line, unfolded over the mirrored boxes, crosses that wall within the rectangle.
Nothing bends around its edges: a door of 2 m2 is treated as rays see it.

Impulse responses of a box from image sources that add as pressures, with phase and noise.

A road to data that shares nothing with the model that is fitted: no rays, no energies, no windows,
no filters of `roomfit.signals`, an own enumeration of the images, positions that differ from the
ones told, a loudspeaker whose gain varies over frequency, and background noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from roomfit.air import Air, attenuation_per_m, speed_of_sound_m_s
from roomfit.bands import bands_between
from roomfit.cache import write_text_atomically
from roomfit.errors import InputError
from roomfit.logit import expit
from roomfit.typing import BoolArray, ComplexArray, FloatArray, IntArray, Progress

WALLS = ("west", "east", "south", "north", "floor", "ceiling")

# Images are laid on a grid so many times finer than the samples and brought down by the Fourier
# transform: at 16 times and 16 kHz, half a step is 2 microseconds, 0.05 rad at 4 kHz.
_OVERSAMPLING = 16
_NOTHING = 1e-30  # of energy


@dataclass(frozen=True, slots=True, eq=False)
class SyntheticBox:
    """A box whose walls are known.

    Attributes
    ----------
    lengths_m : tuple of three floats
        In x, y, z; one corner at the origin.
    centres_hz : float array, shape (n_bands,)
        Centres of adjacent octaves or third octaves, rising; absorption holds at a centre and
        changes smoothly in between.
    absorption : float array, shape (6, n_bands)
        Energy absorption of west, east, south, north, floor, ceiling.
    attenuation_per_m : float array, shape (n_bands,)
        Energy attenuation of the air.
    speed_of_sound_m_s : float
    delays_s : tuple of six floats
        What each wall adds to the travel time at every reflection, in the order of absorption.
    """

    lengths_m: tuple[float, float, float]
    centres_hz: FloatArray
    absorption: FloatArray
    attenuation_per_m: FloatArray
    speed_of_sound_m_s: float
    delays_s: tuple[float, ...] = (0.0,) * 6


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
    what each wall reflects. What holds at the octaves' centres goes over smoothly in between. The
    loudspeaker's levels come with the phase that a causal filter of least delay has.

    Parameters
    ----------
    synthetic : SyntheticBox
    source_m, receiver_m : float arrays, shape (3,)
    duration_s, sampling_rate_hz : float
    level_db : float array, shape (n_bands,)
        Level of the loudspeaker at each octave's centre.
    b : float array, shape (3,), optional
        The loudspeaker sends with the amplitude ``1 + b . u`` in direction u; left out: alike.

    Returns
    -------
    float array, shape (n_samples,)
        In the unit in which a unit source's direct sound is ``1 / (4 pi r)``, band-limited.
    """
    images = box_images(synthetic, source_m, receiver_m, duration_s)
    sent = None
    if b is not None:
        sent = 1.0 + box_departures(synthetic, source_m, receiver_m, duration_s) @ b
    return pressure_of_images(images, synthetic, duration_s, sampling_rate_hz, level_db, sent)


class SyntheticWalls(Protocol):
    """What is true of walls and air, whatever the shape of the room; see `SyntheticBox`."""

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

    Parameters
    ----------
    images : tuple of float arrays
        Length (n_images,), and hits (n_images, n_walls) in the order of the truth's absorption.
    synthetic : SyntheticWalls
    duration_s, sampling_rate_hz : float
    level_db : float array, shape (n_bands,)
    sent : float array, shape (n_images,), optional
        Amplitude, of either sign, with which the loudspeaker feeds each image; left out: 1.
    """
    lengths, hits = images
    factor = np.ones(lengths.size) if sent is None else sent
    n_samples = round(duration_s * sampling_rate_hz)
    fine_rate_hz = sampling_rate_hz * _OVERSAMPLING
    # padded to twice the length, so that the tails of the band-limited impulses do not wrap around
    n_fine = 2 * n_samples * _OVERSAMPLING
    times = lengths / synthetic.speed_of_sound_m_s + hits @ np.array(synthetic.delays_s)
    index = np.round(times * fine_rate_hz).astype(np.int64)
    frequencies = np.linspace(0.0, 0.5 * sampling_rate_hz, n_samples + 1)
    spectrum = np.zeros(frequencies.size, dtype=np.complex128)
    for band, share in enumerate(octave_shares(synthetic.centres_hz, frequencies)):
        # a wall of absorption 1 still lets a path pass that never strikes it: 0 times log 0 is 0
        left = np.log(np.maximum(1.0 - synthetic.absorption[:, band], _NOTHING))
        lost = hits @ left - synthetic.attenuation_per_m[band] * lengths
        amplitude = factor * np.exp(0.5 * lost) / (4.0 * np.pi * lengths)
        impulse_grid = np.bincount(index, amplitude, n_fine)
        spectrum += share * np.fft.rfft(impulse_grid)[: frequencies.size]
    spectrum *= loudspeaker(synthetic.centres_hz, level_db, frequencies)
    return np.asarray(np.fft.irfft(spectrum, 2 * n_samples)[:n_samples])


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
    """Return steps from receiver to all images in time (3, n), hits (n, 6), where mirrored (3, n).

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


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """A rectangle on a wall.

    Attributes
    ----------
    wall : str
        west, east, south, north, floor or ceiling.
    lower_m, upper_m : tuples of two floats
        Opposite corners along the wall's two axes, in the order x, y, z without the wall's own.
    absorption : float array, shape (n_bands,)
        In the bands of the room's truth; 1 for an opening.
    """

    wall: str
    lower_m: tuple[float, float]
    upper_m: tuple[float, float]
    absorption: FloatArray

    def __post_init__(self) -> None:
        if self.wall not in WALLS:
            raise InputError("no such wall", found=repr(self.wall), needed=", ".join(WALLS))


def patch_area_m2(patch: Patch) -> float:
    """Return the area of a patch."""
    return float(np.prod(np.subtract(patch.upper_m, patch.lower_m)))


def patched_response(
    synthetic: SyntheticBox,
    patch: Patch,
    source_m: FloatArray,
    receiver_m: FloatArray,
    duration_s: float,
    sampling_rate_hz: float,
    level_db: FloatArray,
) -> FloatArray:
    """Return the sound pressure at the receiver as `pressure_response` does, patch included.

    The patch takes part of its wall's hits and adds no delay.
    """
    steps, hits, _ = box_lattice(synthetic, source_m, receiver_m, duration_s)
    on_patch = patch_hits(synthetic.lengths_m, patch, receiver_m, steps)
    wall = WALLS.index(patch.wall)
    parted = np.column_stack((hits, on_patch)).astype(np.float64)
    parted[:, wall] -= on_patch
    both = replace(
        synthetic,
        absorption=np.vstack((synthetic.absorption, patch.absorption)),
        delays_s=(*synthetic.delays_s, 0.0),
    )
    lengths = np.asarray(np.linalg.norm(steps, axis=0), dtype=np.float64)
    return pressure_of_images((lengths, parted), both, duration_s, sampling_rate_hz, level_db)


def patch_hits(
    lengths_m: tuple[float, float, float],
    patch: Patch,
    receiver_m: FloatArray,
    steps_m: FloatArray,
) -> IntArray:
    """Return how often the path of each image strikes the patch.

    Parameters
    ----------
    lengths_m : tuple of three floats
    patch : Patch
    receiver_m : float array, shape (3,)
    steps_m : float array, shape (3, n_images)
        From the receiver to the images.

    Returns
    -------
    int array, shape (n_images,)
    """
    axis, far = divmod(WALLS.index(patch.wall), 2)
    others = [other for other in range(3) if other != axis]
    side, step = lengths_m[axis], steps_m[axis]
    count = np.zeros(step.size, dtype=np.int64)
    reach = int(np.ceil(np.abs(step).max(initial=0.0) / side)) + 2
    for plane in range(-reach, reach + 1):
        if plane % 2 != far:  # even planes are mirrors of the wall at 0, odd ones of the other
            continue
        met = np.flatnonzero(_between(receiver_m[axis], step, plane * side))
        if not met.size:
            continue
        share = (plane * side - receiver_m[axis]) / step[met]
        inside = np.ones(met.size, dtype=np.bool_)
        for k, other in enumerate(others):
            place = _folded(receiver_m[other] + share * steps_m[other, met], lengths_m[other])
            inside &= (place >= patch.lower_m[k]) & (place <= patch.upper_m[k])
        count[met[inside]] += 1
    return count


def _between(start: float, step: FloatArray, plane: float) -> BoolArray:
    """Whether lines of given steps cross a plane."""
    return np.asarray((start - plane) * (start + step - plane) < 0.0)


def _folded(place: FloatArray, length: float) -> FloatArray:
    """Return where a point of the mirrored boxes lies in the box itself."""
    within = np.mod(place, 2.0 * length)
    return np.asarray(np.where(within > length, 2.0 * length - within, within))


SAMPLING_RATE_HZ = 32_000.0
_DURATION_S = 0.8


@dataclass(frozen=True, slots=True, eq=False)
class BoxPlan:
    """A box to be measured: what is true of it, and where people believe the equipment stands.

    Attributes
    ----------
    lengths_m : tuple of three floats
    materials : tuple of six str
        Of west, east, south, north, floor and ceiling.
    absorption : float array, shape (6, 8)
        In octaves from 63 to 8000 Hz: outside the fitted range, too, for a room does not end at
        125 Hz.
    sources_m, receivers_m : mapping of name to position
    """

    lengths_m: tuple[float, float, float]
    materials: tuple[str, ...]
    absorption: FloatArray
    sources_m: dict[str, tuple[float, float, float]]
    receivers_m: dict[str, tuple[float, float, float]]


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


def random_plan(rng: np.random.Generator) -> BoxPlan:
    """Return a box of 4.5-9 x 3.6-7 x 2.4-3.8 m with six materials drawn anew in every octave.

    Absorption is even in logit between 0.01 and 0.97, and changes from octave to octave by about a
    third of its spread over materials. Positions stay 0.6 m clear of the walls.
    """
    lengths = rng.uniform((4.5, 3.6, 2.4), (9.0, 7.0, 3.8))
    low, high = np.log(0.01 / 0.99), np.log(0.97 / 0.03)
    free = rng.uniform(low, high, (6, 1)) + np.cumsum(rng.normal(0.0, 0.4, (6, 8)), axis=1)
    absorption = expit(np.clip(free, low, high))

    def place() -> tuple[float, float, float]:
        x, y, z = rng.uniform(0.6, lengths - 0.6)
        return float(x), float(y), float(z)

    return BoxPlan(
        (float(lengths[0]), float(lengths[1]), float(lengths[2])),
        tuple(f"material_{wall}" for wall in WALLS),
        absorption,
        {name: place() for name in ("LS1", "LS2")},
        {name: place() for name in ("MP1", "MP2", "MP3", "MP4")},
    )


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredBox:
    """A simulated campaign and the truth behind it.

    Attributes
    ----------
    campaign : Path
        The campaign file; its WAV files lie beside it.
    materials : tuple of str
    centres_hz : float array, shape (n_bands,)
        Octaves that the truth covers, 63 to 8000 Hz.
    absorption : float array, shape (n_materials, n_bands)
    """

    campaign: Path
    materials: tuple[str, ...]
    centres_hz: FloatArray
    absorption: FloatArray


def write_measured_box(
    plan: BoxPlan,
    folder: Path,
    rng: np.random.Generator,
    *,
    position_error_m: float = 0.01,
    noise_db: float = -60.0,
    patch: Patch | None = None,
    progress: Progress | None = None,
) -> MeasuredBox:
    """Simulate measured responses of every pair in a box and write them as a campaign.

    Parameters
    ----------
    plan : BoxPlan
    folder : Path
        An existing folder.
    rng : numpy.random.Generator
        Draws position errors, loudspeaker levels and noise.
    position_error_m : float
        Standard deviation of each true coordinate about the one told.
    noise_db : float
        Level of the noise relative to the peak of each response.
    patch : Patch, optional
        On one of the walls, in the plan's octaves; the campaign does not tell of it.
    """
    import soundfile

    bands = bands_between("octave", 63, 8000)
    air = Air()
    synthetic = SyntheticBox(
        plan.lengths_m,
        bands.centres_hz,
        plan.absorption,
        attenuation_per_m(air, bands),
        speed_of_sound_m_s(air),
    )
    true_at = {
        name: np.array(position_m) + position_error_m * rng.standard_normal(3)
        for name, position_m in (*plan.sources_m.items(), *plan.receivers_m.items())
    }
    levels_db = {s: rng.normal(0.0, 3.0, len(bands)) for s in plan.sources_m}
    pairs = [(s, r) for s in plan.sources_m for r in plan.receivers_m]
    for number, (s, r) in enumerate(pairs):
        ends = (true_at[s], true_at[r], _DURATION_S, SAMPLING_RATE_HZ, levels_db[s])
        pressure = (
            pressure_response(synthetic, *ends)
            if patch is None
            else patched_response(synthetic, patch, *ends)
        )
        soundfile.write(
            folder / f"{s}_{r}.wav",
            add_noise(pressure, noise_db, rng).astype(np.float32),
            int(SAMPLING_RATE_HZ),
            subtype="FLOAT",
        )
        if progress is not None:
            progress((number + 1) / len(pairs))
    text = campaign_text(plan, pairs, position_error_m)
    campaign = write_text_atomically(folder / "campaign.toml", text)
    return MeasuredBox(campaign, plan.materials, bands.centres_hz, plan.absorption)


def campaign_text(
    plan: BoxPlan,
    pairs: list[tuple[str, str]],
    position_error_m: float,
    *,
    scattering: str = "0.0  # smooth, bare walls",
) -> str:
    """Return a campaign file that tells what people believe about a box.

    Parameters
    ----------
    scattering : str
        What is written of every wall's scattering.
    """
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


_BIN_S = 0.5e-3
_RADIUS_M = 0.3
_N_RAYS = 100_000
_RAYS_AT_ONCE = 20_000
# Energies are 1/(4 pi r^2) where the square of the pressure is 1/(4 pi r)^2.
_PRESSURE_SQUARED = 1.0 / (4.0 * np.pi)


@dataclass(frozen=True, slots=True, eq=False)
class DiffuseEchogram:
    """Energy that arrives after at least one diffuse reflection.

    Attributes
    ----------
    energy : float array, shape (n_receivers, n_bands, n_bins)
        In each bin, 1/m2 for a source of unit power.
    bin_s : float
    """

    energy: FloatArray
    bin_s: float


def diffuse_echogram(
    synthetic: SyntheticBox,
    scattering: FloatArray,
    source_m: FloatArray,
    receivers_m: FloatArray,
    duration_s: float,
    rng: np.random.Generator,
    *,
    n_rays: int = _N_RAYS,
) -> DiffuseEchogram:
    """Follow rays that the walls of a box reflect, and note which cross spheres of 0.3 m.

    At each wall a ray goes on by Lambert's law with probability s and like a ball otherwise; it
    keeps ``1 - a`` of its energy in either case, band by band.

    Parameters
    ----------
    scattering : float array, shape (6,)
        Of the walls in the order of `truth`.
    receivers_m : float array, shape (n_receivers, 3)
        0.3 m or more from every wall.
    """
    n_bins = round(duration_s / _BIN_S)
    energy = np.zeros((len(receivers_m), synthetic.absorption.shape[1], n_bins))
    for start in range(0, n_rays, _RAYS_AT_ONCE):
        n = min(_RAYS_AT_ONCE, n_rays - start)
        _add_rays(synthetic, scattering, source_m, receivers_m, n, rng, energy)
    volume = 4.0 / 3.0 * np.pi * _RADIUS_M**3
    return DiffuseEchogram(energy / (n_rays * volume), _BIN_S)


def _add_rays(
    synthetic: SyntheticBox,
    scattering: FloatArray,
    source_m: FloatArray,
    receivers_m: FloatArray,
    n: int,
    rng: np.random.Generator,
    energy: FloatArray,
) -> None:
    """Add the chords of some rays, times what is left of their energy."""
    lengths = np.array(synthetic.lengths_m)
    place = np.tile(np.asarray(source_m, dtype=np.float64), (n, 1))
    course = _unit(rng.standard_normal((n, 3)))
    left = np.ones((n, synthetic.absorption.shape[1]))
    travelled, diffuse = np.zeros(n), np.zeros(n, dtype=np.bool_)
    reach = synthetic.speed_of_sound_m_s * energy.shape[2] * _BIN_S
    while len(place):
        with np.errstate(divide="ignore"):
            gap = np.where(course > 0.0, lengths - place, place) / np.abs(course)
        axis = np.argmin(gap, axis=1)
        every = np.arange(len(place))
        flight = np.maximum(gap[every, axis], 0.0)
        _catch(synthetic, receivers_m, place, course, flight, travelled, left, diffuse, energy)
        travelled = travelled + flight
        place = np.clip(place + flight[:, None] * course, 0.0, lengths)
        high = course[every, axis] > 0.0
        wall = 2 * axis + high
        left = left * (1.0 - synthetic.absorption[wall])
        course[every, axis] *= -1.0
        drawn = rng.random(len(place)) < scattering[wall]
        course[drawn] = _lambert(axis[drawn], high[drawn], rng)
        diffuse = diffuse | drawn
        on = travelled < reach
        place, course, left = place[on], course[on], left[on]
        travelled, diffuse = travelled[on], diffuse[on]


def _catch(
    synthetic: SyntheticBox,
    receivers_m: FloatArray,
    place: FloatArray,
    course: FloatArray,
    flight: FloatArray,
    travelled: FloatArray,
    left: FloatArray,
    diffuse: BoolArray,
    energy: FloatArray,
) -> None:
    """Note the crossings of one flight of every ray that some wall has scattered."""
    n_bins = energy.shape[2]
    for receiver, centre in enumerate(receivers_m):
        way = centre - place
        nearest = np.einsum("ij,ij->i", way, course)
        square = _RADIUS_M**2 - (np.einsum("ij,ij->i", way, way) - nearest**2)
        met = np.flatnonzero(diffuse & (square > 0.0) & (nearest > 0.0) & (nearest < flight))
        arrived = travelled[met] + nearest[met]
        index = (arrived / synthetic.speed_of_sound_m_s / _BIN_S).astype(np.int64)
        met, index, arrived = (x[index < n_bins] for x in (met, index, arrived))
        chord = 2.0 * np.sqrt(square[met])
        for band, attenuation in enumerate(synthetic.attenuation_per_m):
            weight = chord * left[met, band] * np.exp(-attenuation * arrived)
            energy[receiver, band] += np.bincount(index, weight, n_bins)


def _lambert(axis: np.ndarray, high: BoolArray, rng: np.random.Generator) -> FloatArray:
    """Draw directions off walls across given axes: a point of the sphere added to the normal."""
    normal = np.zeros((axis.size, 3))
    normal[np.arange(axis.size), axis] = np.where(high, -1.0, 1.0)
    return _unit(normal + _unit(rng.standard_normal((axis.size, 3))))


def _unit(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1)[:, None])


def scattered_response(
    synthetic: SyntheticBox,
    scattering: FloatArray,
    source_m: FloatArray,
    receiver_m: FloatArray,
    echogram: FloatArray,
    duration_s: float,
    sampling_rate_hz: float,
    level_db: FloatArray,
    rng: np.random.Generator,
) -> FloatArray:
    """Return the sound pressure at the receiver: thinned image sources and modulated noise.

    Each image keeps ``1 - s`` of its energy at every wall. The noise is white, its power follows
    the echogram of each band, and both pass the same band shares and the same loudspeaker.

    Parameters
    ----------
    scattering : float array, shape (6,)
    echogram : float array, shape (n_bands, n_bins)
        Of this receiver, from `diffuse_echogram`.
    duration_s, sampling_rate_hz, level_db
        As for `pressure_response`.
    """
    kept = (1.0 - synthetic.absorption) * (1.0 - scattering)[:, None]
    specular = pressure_response(
        *(replace(synthetic, absorption=1.0 - kept), source_m, receiver_m),
        *(duration_s, sampling_rate_hz, level_db),
    )
    noise = modulated_noise(
        *(echogram, _BIN_S, specular.size, sampling_rate_hz, synthetic.centres_hz, level_db, rng)
    )
    return np.asarray(specular + noise)


def modulated_noise(
    echogram: FloatArray,
    bin_s: float,
    n_samples: int,
    sampling_rate_hz: float,
    centres_hz: FloatArray,
    level_db: FloatArray,
    rng: np.random.Generator,
) -> FloatArray:
    """Return noise whose power in time follows an echogram, band by band, shape (n_samples,).

    Parameters
    ----------
    echogram : float array, shape (n_bands, n_bins)
        Energy of each bin, 1/m2 for a source of unit power.
    bin_s : float
    centres_hz, level_db : float arrays, shape (n_bands,)
        As for `pressure_response`.
    """
    times_s = np.arange(n_samples) / sampling_rate_hz
    bins = np.minimum((times_s / bin_s).astype(int), echogram.shape[1] - 1)
    power = _PRESSURE_SQUARED * echogram / (bin_s * sampling_rate_hz)
    white = rng.standard_normal(n_samples)
    frequencies = np.linspace(0.0, 0.5 * sampling_rate_hz, n_samples + 1)
    spectrum = np.zeros(n_samples + 1, dtype=np.complex128)
    for share, of_band in zip(octave_shares(centres_hz, frequencies), power, strict=True):
        spectrum += share * np.fft.rfft(white * np.sqrt(of_band[bins]), 2 * n_samples)
    spectrum *= loudspeaker(centres_hz, level_db, frequencies)
    return np.asarray(np.fft.irfft(spectrum, 2 * n_samples)[:n_samples])


def write_scattering_box(
    plan: BoxPlan,
    scattering: FloatArray,
    folder: Path,
    rng: np.random.Generator,
    *,
    specified_scattering: str = "0.0",
    position_error_m: float = 0.01,
    noise_db: float = -60.0,
    n_rays: int = _N_RAYS,
    progress: Progress | None = None,
) -> MeasuredBox:
    """Simulate measured responses of a box whose walls scatter and write them as a campaign.

    Parameters
    ----------
    scattering : float array, shape (6,)
        Of west, east, south, north, floor and ceiling, the same in every octave.
    specified_scattering : str
        What the campaign says of every wall's scattering, as written there.
    folder, rng, position_error_m, noise_db
        As for `write_measured_box`.
    n_rays : int
        A source.
    """
    import soundfile

    bands, air = bands_between("octave", 63, 8000), Air()
    attenuation, c = attenuation_per_m(air, bands), speed_of_sound_m_s(air)
    synthetic = SyntheticBox(plan.lengths_m, bands.centres_hz, plan.absorption, attenuation, c)
    true_at = {
        name: np.array(place) + position_error_m * rng.standard_normal(3)
        for name, place in (*plan.sources_m.items(), *plan.receivers_m.items())
    }
    receivers = np.array([true_at[r] for r in plan.receivers_m])
    for number, s in enumerate(plan.sources_m):
        level_db = rng.normal(0.0, 3.0, len(bands))
        echogram = diffuse_echogram(
            *(synthetic, scattering, true_at[s], receivers, _DURATION_S, rng), n_rays=n_rays
        )
        for receiver, r in enumerate(plan.receivers_m):
            pressure = scattered_response(
                *(synthetic, scattering, true_at[s], true_at[r], echogram.energy[receiver]),
                *(_DURATION_S, SAMPLING_RATE_HZ, level_db, rng),
            )
            samples = add_noise(pressure, noise_db, rng).astype(np.float32)
            file = folder / f"{s}_{r}.wav"
            soundfile.write(file, samples, int(SAMPLING_RATE_HZ), subtype="FLOAT")
        if progress is not None:
            progress((number + 1) / len(plan.sources_m))
    pairs = [(s, r) for s in plan.sources_m for r in plan.receivers_m]
    text = campaign_text(plan, pairs, position_error_m, scattering=specified_scattering)
    campaign = write_text_atomically(folder / "campaign.toml", text)
    return MeasuredBox(campaign, plan.materials, bands.centres_hz, plan.absorption)
