"""A campaign as somebody might have measured it, in a box whose walls are known.

Sources stand a centimetre or so from where the campaign says, the loudspeaker's level changes from
octave to octave and is told to nobody, and every file holds noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from roomfit.air import Air, attenuation_per_m, speed_of_sound_m_s
from roomfit.bands import bands_between
from roomfit.files.store import write_text_atomically
from roomfit.testproblems.patched_box import Patch, patched_response
from roomfit.testproblems.pressure_box import WALLS, BoxTruth, add_noise, pressure_response
from roomfit.typing import FloatArray, Progress

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
    logit = rng.uniform(low, high, (6, 1)) + np.cumsum(rng.normal(0.0, 0.4, (6, 8)), axis=1)
    absorption = 1.0 / (1.0 + np.exp(-np.clip(logit, low, high)))

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
    truth = BoxTruth(
        plan.lengths_m,
        bands.centres_hz,
        plan.absorption,
        attenuation_per_m(air, bands),
        speed_of_sound_m_s(air),
    )
    true_at = {
        name: np.array(told) + position_error_m * rng.standard_normal(3)
        for name, told in (*plan.sources_m.items(), *plan.receivers_m.items())
    }
    levels_db = {s: rng.normal(0.0, 3.0, len(bands)) for s in plan.sources_m}
    pairs = [(s, r) for s in plan.sources_m for r in plan.receivers_m]
    for number, (s, r) in enumerate(pairs):
        ends = (true_at[s], true_at[r], _DURATION_S, SAMPLING_RATE_HZ, levels_db[s])
        pressure = (
            pressure_response(truth, *ends)
            if patch is None
            else patched_response(truth, patch, *ends)
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
