"""Boxes of random size and materials, and boxes whose walls scatter, as campaigns."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from roomfit.base.logit import expit
from roomfit.base.typing import FloatArray
from roomfit.demo.boxes import (
    DURATION_S,
    NOISE_DB,
    POSITION_ERROR_M,
    SAMPLING_RATE_HZ,
    WALLS,
    BoxPlan,
    add_noise,
    pressure_response,
    true_box,
    write_box_campaign,
)
from simulated_rooms.scattering_box import diffuse_echogram, modulated_noise, specular_box


def random_plan(rng: np.random.Generator) -> BoxPlan:
    """Return a box of 4.5-9 x 3.6-7 x 2.4-3.8 m with six random materials.

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


def write_scattering_box(
    plan: BoxPlan,
    scattering: FloatArray,
    folder: Path,
    rng: np.random.Generator,
    *,
    specified_scattering: str = "0.0",
    n_rays: int = 100_000,
) -> Path:
    """Simulate measured responses of a box whose walls scatter, write them, return the campaign.

    Parameters
    ----------
    scattering : float array, shape (6,)
        Of west, east, south, north, floor and ceiling, the same in every octave.
    folder, rng
        As of `write_measured_box`.
    specified_scattering : str
        Of every wall, as written in the campaign.
    n_rays : int
        Of each source.
    """
    synthetic, true_at = true_box(plan, POSITION_ERROR_M, rng)
    specular = specular_box(synthetic, scattering)
    receivers = np.array([true_at[r] for r in plan.receivers_m])
    responses = {}
    for s in plan.sources_m:
        level_db = rng.normal(0.0, 3.0, synthetic.centres_hz.size)
        echogram = diffuse_echogram(
            synthetic, scattering, true_at[s], receivers, DURATION_S, rng, n_rays=n_rays
        )
        for r, energy in zip(plan.receivers_m, echogram, strict=True):
            ends = (true_at[s], true_at[r], DURATION_S, SAMPLING_RATE_HZ, level_db)
            images = pressure_response(specular, *ends)
            pressure = images + modulated_noise(
                energy, images.size, SAMPLING_RATE_HZ, synthetic.centres_hz, level_db, rng
            )
            responses[s, r] = add_noise(pressure, NOISE_DB, rng)
    return write_box_campaign(plan, folder, responses, scattering=specified_scattering)
