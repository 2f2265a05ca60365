"""One replicate: draw a truth, make its responses, identify them, and keep what came out."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np

from roomfit.air import attenuation_per_m
from roomfit.app.calibrating.plan import CalibrationPlan
from roomfit.app.calibrating.recording import made_campaign, made_rate_hz, wanted_pairs
from roomfit.app.calibrating.sound import made_sound
from roomfit.app.calibrating.truth import draw_truth
from roomfit.app.identify import identify
from roomfit.app.progress import part
from roomfit.errors import RoomfitError, StoreError
from roomfit.files.replicates import Replicate
from roomfit.geometry.measures import surface_area_m2, volume_m3
from roomfit.identification.start import eyring_absorption
from roomfit.typing import FloatArray, Progress
from roomfit.uncertainty.answer import Answer

# Keeps the draws of a calibration apart from those of other tasks with the same seed.
_PURPOSE = 31


def replicated(
    plan: CalibrationPlan,
    seed: int,
    number: int,
    scratch: Path,
    progress: Progress | None = None,
) -> Replicate:
    """Return what one replicate tells; the same for the same seed and number, whoever asks.

    Where roomfit refuses the made campaign, the replicate tells the refusal.

    Parameters
    ----------
    scratch : Path
        An existing folder for the made files, which are removed again.

    Raises
    ------
    StoreError
        The disk refuses.
    """
    began = time.perf_counter()
    rng = np.random.default_rng([seed, _PURPOSE, number])
    truth = draw_truth(plan, rng)
    pairs = wanted_pairs(plan)
    sound = made_sound(plan, truth, pairs, made_rate_hz(plan.campaign.bands), rng)
    true = truth.absorption[:, plan.columns]
    with tempfile.TemporaryDirectory(dir=scratch, prefix=f"{number:04d}-") as folder:
        campaign = made_campaign(plan, truth, sound, Path(folder), rng)
        try:
            answer = identify(campaign, progress=part(progress, 0.3, 1.0))
        except StoreError:
            raise
        except RoomfitError as error:
            seconds = time.perf_counter() - began
            return Replicate(number, plan.digest, sound.road, true, str(error), None, seconds)
    seconds = time.perf_counter() - began
    found = Replicate.found_in(answer, _uniform(plan, answer))
    return Replicate(number, plan.digest, sound.road, true, None, found, seconds)


def _uniform(plan: CalibrationPlan, answer: Answer) -> FloatArray:
    """Return Eyring's absorption of the measured decay in every band, the null model; or the prior.

    The median over pairs of T20, else of EDT.
    """
    mesh = plan.room.mesh
    attenuation = attenuation_per_m(plan.campaign.air, plan.campaign.bands)
    mean: FloatArray = np.array(
        [k.lower + (k.upper - k.lower) / (1.0 + np.exp(-k.prior_logit_mean))
         for k in plan.knowledge]
    ).mean(axis=0)  # fmt: skip
    out = []
    for band in range(len(plan.campaign.bands)):
        t = np.nan
        for name in ("T20_s", "T30_s", "EDT_s"):
            rows = [p.parameters[name].measured for p in answer.pairs if name in p.parameters]
            known = [float(row[band]) for row in rows if np.isfinite(row[band])]
            if known and not np.isfinite(t):
                t = float(np.median(known))
        if not np.isfinite(t):
            out.append(float(mean[band]))
            continue
        rate = 6.0 * float(np.log(10.0)) / t
        ends = (volume_m3(mesh), surface_area_m2(mesh), answer.speed_of_sound_m_s)
        out.append(eyring_absorption(rate, *ends, float(attenuation[band])))
    return np.array(out)
