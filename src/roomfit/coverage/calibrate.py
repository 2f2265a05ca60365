"""Use case: do the intervals of this campaign hold what they promise?

One replicate: draw a truth, make its responses, identify them, and keep what came out.

Replicates of a calibration: one small JSON file each, so that a killed run loses one at most.
"""

from __future__ import annotations

import json
import shutil
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from roomfit._numba import in_pool, worker_pool
from roomfit.air import attenuation_per_m
from roomfit.cache import write_json_atomically
from roomfit.coverage.simulate import (
    synthetic_campaign,
    synthetic_rate_hz,
    synthetic_sound,
    wanted_pairs,
)
from roomfit.coverage.statistics import CoverageSample
from roomfit.coverage.truth import (
    CoveragePlan,
    CoverageSettings,
    coverage_plan,
    draw_synthetic_room,
)
from roomfit.errors import CannotTell, InputError, RoomfitError, StoreError
from roomfit.eyring import eyring_absorption
from roomfit.findings import Code, code_of
from roomfit.geometry.mesh import surface_area_m2, volume_m3
from roomfit.inversion.identify import identify
from roomfit.io.campaign import Campaign
from roomfit.logit import expit
from roomfit.results import Answer
from roomfit.typing import BoolArray, FloatArray, Progress, part

FOLDER = "replicates"
_FORMAT, _VERSION = "roomfit-replicate", 1


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What an identification said of a made campaign.

    Attributes
    ----------
    absorption, lower95, upper95 : float arrays, shape (n_materials, n_bands)
    identifiable : bool array, shape (n_materials, n_bands)
    uniform : float array, shape (n_bands,)
        Eyring's absorption of the measured decay.
    chi2_reduced : float array, shape (n_bands,)
    models : tuple of str, one a band
    findings : tuple of Code
        Codes of all findings above "info", each once.
    """

    absorption: FloatArray
    lower95: FloatArray
    upper95: FloatArray
    identifiable: BoolArray
    uniform: FloatArray
    chi2_reduced: FloatArray
    models: tuple[str, ...]
    findings: tuple[Code, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Replicate:
    """One made campaign.

    Attributes
    ----------
    number : int
    digest : str
        Of the campaign and the settings that it belongs to.
    synthesis : str
        How its responses were made.
    true : float array, shape (n_materials, n_bands)
    refused : str or None
        Why roomfit gave no answer.
    found : Found or None
        None where it gave none.
    seconds : float
    """

    number: int
    digest: str
    synthesis: str
    true: FloatArray
    refused: str | None
    found: Found | None
    seconds: float

    @staticmethod
    def found_in(answer: Answer, uniform: FloatArray) -> Found:
        """Return what is kept of an answer."""
        codes = sorted({f.code for f in answer.findings if f.severity != "info"})
        return Found(
            answer.absorption,
            answer.lower95,
            answer.upper95,
            answer.identifiable,
            uniform,
            answer.chi2_reduced,
            answer.models,
            tuple(codes),
        )


def replicate_path(out: Path, number: int) -> Path:
    """Return where a replicate lies within the output folder."""
    return Path(out) / FOLDER / f"{number:04d}.json"


def write_replicate(out: Path, replicate: Replicate) -> Path:
    """Write one replicate, aside first; its folder is made if needed.

    Raises
    ------
    StoreError
        The disk refuses.
    """
    path = replicate_path(out, replicate.number)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(
            "the folder of replicates cannot be made", where=str(path.parent), found=str(error)
        ) from error
    content: dict[str, Any] = {
        "format": _FORMAT,
        "format_version": _VERSION,
        "digest": replicate.digest,
        "number": replicate.number,
        "road": replicate.synthesis,
        "true": replicate.true.tolist(),
        "refused": replicate.refused,
        "seconds": round(replicate.seconds, 2),
    }
    found = replicate.found
    if found is not None:
        for name in ("absorption", "lower95", "upper95", "identifiable", "uniform", "phi"):
            content[name] = getattr(found, {"phi": "chi2_reduced"}.get(name, name)).tolist()
        content["models"], content["findings"] = (
            list(found.models),
            [c.value for c in found.findings],
        )
    return write_json_atomically(path, content)


def read_replicate(out: Path, number: int, digest: str) -> Replicate | None:
    """Return a replicate of a calibration; None where there is none yet.

    Raises
    ------
    InputError
        The file is damaged, or belongs to another campaign, other settings or another version.
    """
    path = replicate_path(out, number)
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise _damaged(path, str(error)) from error
    if not isinstance(content, dict) or content.get("format") != _FORMAT:
        raise _damaged(path, "another kind of file")
    if content.get("digest") != digest:
        raise InputError(
            "a replicate belongs to another calibration",
            where=str(path),
            found="another campaign, other measured files, --from, --snr-db or --seed, or another "
            "version of roomfit",
            needed="the same as it was made with",
            hint="choose another folder",
        )
    try:
        return _replicate(content, path)
    except (KeyError, TypeError, ValueError) as error:
        raise _damaged(path, f"{type(error).__name__}: {error}") from error


def _replicate(content: dict[str, Any], path: Path) -> Replicate:
    found = None
    if content["refused"] is None:
        absorption, lower95, upper95 = (
            np.array(content[name], dtype=np.float64)
            for name in ("absorption", "lower95", "upper95")
        )
        found = Found(
            absorption,
            lower95,
            upper95,
            np.array(content["identifiable"], dtype=np.bool_),
            np.array(content["uniform"], dtype=np.float64),
            np.array(content["phi"], dtype=np.float64),
            tuple(content["models"]),
            tuple(code_of(text, str(path)) for text in content["findings"]),
        )
    return Replicate(
        int(content["number"]),
        content["digest"],
        content["road"],
        np.array(content["true"], dtype=np.float64),
        content["refused"],
        found,
        float(content["seconds"]),
    )


def _damaged(path: Path, why: str) -> InputError:
    return InputError(
        "a replicate is damaged",
        where=str(path),
        found=why,
        hint="remove it; it will be made again",
    )


# Keeps the draws of a calibration apart from those of other tasks with the same seed.
_PURPOSE = 31


def replicated(
    plan: CoveragePlan,
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
    synthetic = draw_synthetic_room(plan, rng)
    pairs = wanted_pairs(plan)
    sound = synthetic_sound(plan, synthetic, pairs, synthetic_rate_hz(plan.campaign.bands), rng)
    true = synthetic.absorption[:, plan.columns]
    with tempfile.TemporaryDirectory(dir=scratch, prefix=f"{number:04d}-") as folder:
        campaign = synthetic_campaign(plan, synthetic, sound, Path(folder), rng)
        try:
            answer = identify(campaign, progress=part(progress, 0.3, 1.0))
        except StoreError:
            raise
        except RoomfitError as error:
            seconds = time.perf_counter() - began
            return Replicate(number, plan.digest, sound.synthesis, true, str(error), None, seconds)
    seconds = time.perf_counter() - began
    found = Replicate.found_in(answer, _uniform(plan, answer))
    return Replicate(number, plan.digest, sound.synthesis, true, None, found, seconds)


def _uniform(plan: CoveragePlan, answer: Answer) -> FloatArray:
    """Return Eyring's absorption of the measured decay in every band, the null model; or the prior.

    The median over pairs of T20, else of EDT.
    """
    mesh = plan.room.mesh
    attenuation = attenuation_per_m(plan.campaign.air, plan.campaign.bands)
    mean: FloatArray = np.array(
        [k.lower + (k.upper - k.lower) * expit(k.prior_logit_mean)
         for k in plan.priors]
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


_SCRATCH = ".making-"


@dataclass(frozen=True, slots=True, eq=False)
class CoverageResult:
    """What all replicates that are there say together.

    Attributes
    ----------
    requested, done : int
        Replicates of the whole calibration, and those that are there.
    refused : tuple of str
        Why roomfit gave no answer to some of them.
    syntheses : mapping of road to count
        How their responses were made.
    findings : mapping of code to count
        Above "info", over the replicates that were answered.
    found : CoverageSample
    drawn_from : str
        "prior" or "answer".
    """

    requested: int
    done: int
    refused: tuple[str, ...]
    syntheses: dict[str, int]
    findings: dict[Code, int]
    found: CoverageSample
    drawn_from: str


def estimate_coverage(
    campaign: Campaign,
    out: Path,
    settings: CoverageSettings | None = None,
    *,
    progress: Progress | None = None,
) -> CoverageResult:
    """Make a campaign anew many times with known truths, identify each, and count.

    Every replicate is a file of its own in ``out/replicates``; those that are there already are
    not made again, so that a run that was stopped goes on, and several machines may each take a
    slice (`CoverageSettings.first` and `only`) of one folder.

    Parameters
    ----------
    campaign : Campaign
    out : Path
        Made if needed. What lies there must belong to the same campaign and settings.
    settings : CoverageSettings, optional
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
    settings = CoverageSettings() if settings is None else settings
    _check_folder(out)
    plan = coverage_plan(campaign, settings)
    there = {n: read_replicate(out, n, plan.digest) for n in range(settings.replicates)}
    missing = [n for n in settings.numbers if there[n] is None]
    with _scratch(out) as scratch:
        _make(plan, settings, missing, out, scratch, progress)
    return collected(plan, out, settings)


def _make(
    plan: CoveragePlan,
    settings: CoverageSettings,
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


def _task(plan: CoveragePlan, seed: int, number: int, out: Path, scratch: Path) -> None:
    """Make one replicate in a worker, unless the work was called off."""

    def watch(_: float) -> None:
        if not scratch.is_dir():
            raise KeyboardInterrupt

    write_replicate(out, replicated(plan, seed, number, scratch, watch))


def collected(plan: CoveragePlan, out: Path, settings: CoverageSettings) -> CoverageResult:
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
    return CoverageResult(
        settings.replicates,
        len(done),
        refused,
        dict(Counter(r.synthesis for r in done)),
        dict(codes.most_common()),
        _coverage_sample(plan, answered),
        "prior" if plan.answer is None else "answer",
    )


def _coverage_sample(plan: CoveragePlan, answered: list[Replicate]) -> CoverageSample:
    found = [r.found for r in answered if r.found is not None]
    free = np.array([k.known is None and k.tied_to is None for k in plan.priors])
    fitted = np.array([[model != "prior" for model in f.models] for f in found])
    prior = np.array(
        [k.lower + (k.upper - k.lower) * expit(k.prior_logit_mean) for k in plan.priors]
    )
    if plan.answer is not None:
        prior = plan.answer.absorption
    return CoverageSample(
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
        np.array([f.chi2_reduced for f in found]),
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
