"""Use case: do the intervals of this campaign hold what they promise?"""

from __future__ import annotations

import shutil
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from roomfit.app.calibrating.plan import CalibrationPlan, calibration_plan
from roomfit.app.calibrating.replicate import replicated
from roomfit.app.calibrating.settings import CalibrationSettings
from roomfit.app.progress import part
from roomfit.app.workers import in_pool, worker_pool
from roomfit.errors import CannotTell, InputError, StoreError
from roomfit.files.campaign.campaign import Campaign
from roomfit.files.replicates import Replicate, read_replicate, write_replicate
from roomfit.typing import Progress
from roomfit.uncertainty.calibration import Calibration

_SCRATCH = ".making-"


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationResult:
    """What all replicates that are there say together.

    Attributes
    ----------
    asked, done : int
        Replicates of the whole calibration, and those that are there.
    refused : tuple of str
        Why roomfit gave no answer to some of them.
    roads : mapping of road to count
        How their responses were made.
    findings : mapping of code to count
        Above "info", over the replicates that were answered.
    found : Calibration
    drawn_from : str
        "prior" or "answer".
    """

    asked: int
    done: int
    refused: tuple[str, ...]
    roads: dict[str, int]
    findings: dict[str, int]
    found: Calibration
    drawn_from: str


def calibrate(
    campaign: Campaign,
    out: Path,
    settings: CalibrationSettings | None = None,
    *,
    progress: Progress | None = None,
) -> CalibrationResult:
    """Make a campaign anew many times with known truths, identify each, and count.

    Every replicate is a file of its own in ``out/replicates``; those that are there already are
    not made again, so that a run that was stopped goes on, and several machines may each take a
    slice (`CalibrationSettings.first` and `only`) of one folder.

    Parameters
    ----------
    campaign : Campaign
    out : Path
        Made if needed. What lies there must belong to the same campaign and settings.
    settings : CalibrationSettings, optional
    progress : callable, optional

    Raises
    ------
    InputError
        Something in the campaign or its files is not as needed, or the folder holds replicates of
        another calibration.
    CannotTell
        No replicate could be answered.
    StoreError
        The disk refuses.
    """
    settings = CalibrationSettings() if settings is None else settings
    _check_folder(out)
    plan = calibration_plan(campaign, settings)
    there = {n: read_replicate(out, n, plan.digest) for n in range(settings.replicates)}
    missing = [n for n in settings.numbers if there[n] is None]
    with _scratch(out) as scratch:
        _make(plan, settings, missing, out, scratch, progress)
    return collected(plan, out, settings)


def _make(
    plan: CalibrationPlan,
    settings: CalibrationSettings,
    missing: list[int],
    out: Path,
    scratch: Path,
    progress: Progress | None,
) -> None:
    if settings.workers == 1:
        for done, number in enumerate(missing):
            share = part(progress, done / len(missing), (done + 1) / len(missing))
            write_replicate(out, replicated(plan, settings.seed, number, scratch, share))
        return
    tasks = [partial(_task, plan, settings.seed, n, out, scratch) for n in missing]
    with worker_pool(settings.workers) as pool:
        try:
            in_pool(pool, tasks, progress)
        except BaseException:
            # workers look for the folder as they go on; without it they stop within seconds
            shutil.rmtree(scratch, ignore_errors=True)
            raise


def _task(plan: CalibrationPlan, seed: int, number: int, out: Path, scratch: Path) -> None:
    """Make one replicate in a worker, unless the work was called off."""

    def watch(_: float) -> None:
        if not scratch.is_dir():
            raise KeyboardInterrupt

    write_replicate(out, replicated(plan, seed, number, scratch, watch))


def collected(plan: CalibrationPlan, out: Path, settings: CalibrationSettings) -> CalibrationResult:
    """Return what the replicates that are there say together.

    Raises
    ------
    CannotTell
        None of them was answered.
    """
    there = [read_replicate(out, n, plan.digest) for n in range(settings.replicates)]
    done = [r for r in there if r is not None]
    answered = [r for r in done if r.found is not None]
    refused = tuple(r.refused for r in done if r.refused is not None)
    if not answered:
        raise CannotTell(
            "no replicate could be identified",
            where=str(plan.campaign.path),
            found=f"{len(refused)} refused; the first: {refused[0].splitlines()[0]}"
            if refused
            else "none was made",
            hint="more measurements, or less noise",
        )
    codes = Counter(code for r in answered if r.found for code in r.found.findings)
    return CalibrationResult(
        settings.replicates,
        len(done),
        refused,
        dict(Counter(r.road for r in done)),
        dict(codes.most_common()),
        _calibration(plan, answered),
        "prior" if plan.answer is None else "answer",
    )


def _calibration(plan: CalibrationPlan, answered: list[Replicate]) -> Calibration:
    found = [r.found for r in answered if r.found is not None]
    free = np.array([k.known is None and k.tied_to is None for k in plan.knowledge])
    fitted = np.array([[model != "prior" for model in f.models] for f in found])
    prior = np.array(
        [
            k.lower + (k.upper - k.lower) / (1.0 + np.exp(-k.prior_logit_mean))
            for k in plan.knowledge
        ]
    )
    if plan.answer is not None:
        prior = plan.answer.absorption
    return Calibration(
        plan.room.materials,
        plan.campaign.bands,
        np.array([r.true for r in answered]),
        np.array([f.absorption for f in found]),
        np.array([f.lower95 for f in found]),
        np.array([f.upper95 for f in found]),
        np.array([f.identifiable for f in found]),
        free[None, :, None] & fitted[:, None, :],
        prior,
        np.array([f.uniform for f in found]),
        np.array([f.phi for f in found]),
    )


def _check_folder(out: Path) -> None:
    nearest: Path | None = next((p for p in (out, *out.absolute().parents) if p.exists()), None)
    if nearest is not None and not nearest.is_dir():
        raise InputError(
            "the output folder is a file" if nearest == out else "the output folder is in a file",
            where=str(out),
            hint="choose another name",
        )


@contextmanager
def _scratch(out: Path) -> Iterator[Path]:
    """Give a folder for made responses on the same disk, and remove it in any case."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        folder = Path(tempfile.mkdtemp(prefix=_SCRATCH, dir=out))
    except OSError as error:
        raise StoreError(
            "the output folder cannot be written to", where=str(out), found=str(error)
        ) from error
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
