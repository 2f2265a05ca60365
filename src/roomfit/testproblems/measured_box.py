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
from roomfit.testproblems.pressure_box import WALLS, BoxTruth, add_noise, pressure_response
from roomfit.typing import FloatArray, Progress

SAMPLING_RATE_HZ = 32_000.0
_DURATION_S = 0.8

# Octaves 63 to 8000 Hz: outside the fitted range, too, for a room does not end at 125 Hz.
_LENGTHS_M = (6.1, 4.7, 2.8)
_MATERIALS = {
    "west": ("curtain", (0.05, 0.07, 0.25, 0.45, 0.60, 0.65, 0.70, 0.70)),
    "east": ("brick", (0.02, 0.03, 0.03, 0.04, 0.05, 0.06, 0.07, 0.07)),
    "south": ("windows", (0.30, 0.28, 0.20, 0.12, 0.08, 0.05, 0.04, 0.04)),
    "north": ("panelling", (0.30, 0.25, 0.18, 0.12, 0.10, 0.10, 0.11, 0.12)),
    "floor": ("carpet", (0.04, 0.08, 0.14, 0.25, 0.37, 0.50, 0.60, 0.62)),
    "ceiling": ("tiles", (0.25, 0.35, 0.50, 0.65, 0.75, 0.80, 0.75, 0.70)),
}
_SOURCES_M = {"LS1": (1.20, 1.50, 1.10), "LS2": (4.85, 3.30, 1.62)}
_RECEIVERS_M = {
    "MP1": (4.10, 2.90, 1.20),
    "MP2": (2.30, 3.75, 1.45),
    "MP3": (5.20, 1.15, 1.83),
    "MP4": (3.10, 0.85, 0.92),
}


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
    folder: Path,
    rng: np.random.Generator,
    *,
    position_error_m: float = 0.01,
    noise_db: float = -60.0,
    progress: Progress | None = None,
) -> MeasuredBox:
    """Simulate eight measured responses of a box with six materials and write them as a campaign.

    Parameters
    ----------
    folder : Path
        An existing folder.
    rng : numpy.random.Generator
        Draws position errors, loudspeaker levels and noise.
    position_error_m : float
        Standard deviation of each true coordinate about the one told.
    noise_db : float
        Level of the noise relative to the peak of each response.
    """
    import soundfile

    bands = bands_between("octave", 63, 8000)
    air = Air()
    absorption = np.array([_MATERIALS[wall][1] for wall in WALLS])
    truth = BoxTruth(
        _LENGTHS_M,
        bands.centres_hz,
        absorption,
        attenuation_per_m(air, bands),
        speed_of_sound_m_s(air),
    )
    true_at = {
        name: np.array(told) + position_error_m * rng.standard_normal(3)
        for name, told in (*_SOURCES_M.items(), *_RECEIVERS_M.items())
    }
    levels_db = {s: rng.normal(0.0, 3.0, len(bands)) for s in _SOURCES_M}
    pairs = [(s, r) for s in _SOURCES_M for r in _RECEIVERS_M]
    for number, (s, r) in enumerate(pairs):
        pressure = pressure_response(
            truth, true_at[s], true_at[r], _DURATION_S, SAMPLING_RATE_HZ, levels_db[s]
        )
        soundfile.write(
            folder / f"{s}_{r}.wav",
            add_noise(pressure, noise_db, rng).astype(np.float32),
            int(SAMPLING_RATE_HZ),
            subtype="FLOAT",
        )
        if progress is not None:
            progress((number + 1) / len(pairs))
    campaign = write_text_atomically(folder / "campaign.toml", _campaign_text(pairs))
    names = tuple(_MATERIALS[wall][0] for wall in WALLS)
    return MeasuredBox(campaign, names, bands.centres_hz, absorption)


def _campaign_text(pairs: list[tuple[str, str]]) -> str:
    lines = ["[room]", f"shoebox = {list(_LENGTHS_M)}", "[room.materials]"]
    lines += [f'{wall} = "{material}"' for wall, (material, _) in _MATERIALS.items()]
    lines += ["[air]", "temperature_c = 20.0", "humidity_percent = 50.0"]
    for material, _ in _MATERIALS.values():
        lines += [f"[materials.{material}]", "scattering = 0.0  # smooth, bare walls"]
    for kind, points in (("sources", _SOURCES_M), ("receivers", _RECEIVERS_M)):
        for name, position in points.items():
            lines += [f"[{kind}.{name}]", f"position = {list(position)}", "position_sd = 0.01"]
    for s, r in pairs:
        lines += ["[[measurements]]", f'source = "{s}"', f'receiver = "{r}"']
        lines += [f'file = "{s}_{r}.wav"']
    lines += ["[identify]", 'bands = "octave"', "from_hz = 125", "to_hz = 4000", "seed = 1"]
    return "\n".join(lines) + "\n"
