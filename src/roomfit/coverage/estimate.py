"""Coverage of a campaign's intervals: synthetic replicates of it are identified and counted.

A replicate draws everything that the campaign leaves open, simulates its recordings by a model
other than that of the fit, and identifies them. It is a small JSON file of its own, so that a
killed run loses one at most.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from roomfit.base.air import attenuation_per_m
from roomfit.base.cache import (
    check_output_folder,
    hidden_folder,
    make_folder,
    nearest_existing,
    shared_folder,
    write_json_atomically,
)
from roomfit.base.errors import InputError, InsufficientDataError, RoomfitError, StoreError
from roomfit.base.findings import Code, code_of
from roomfit.base.logit import expit
from roomfit.base.typing import BoolArray, FloatArray, Progress, part
from roomfit.base.workers import (
    bundled,
    cluster_pool,
    completed,
    keep_one_thread,
    result_of,
    worker_pool,
)
from roomfit.coverage.simulate import (
    synthetic_campaign,
    synthetic_rate_hz,
    synthetic_sound,
    wanted_pairs,
)
from roomfit.coverage.statistics import CoverageSample
from roomfit.coverage.synthetic_room import (
    CoveragePlan,
    CoverageSettings,
    coverage_plan,
    draw_synthetic_room,
)
from roomfit.files.campaign import Campaign
from roomfit.files.encoding import written_content
from roomfit.files.inputs import identify_arguments
from roomfit.identify import compile_kernels, identify
from roomfit.materials.priors import prior_logit_law
from roomfit.model.eyring import eyring_absorption
from roomfit.result import Result
from roomfit.room.mesh import surface_area_m2, volume_m3

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FOLDER = "replicates"
_FORMAT, _VERSION = "roomfit-replicate", 1


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What is kept of the answer to a synthetic campaign."""

    absorption: FloatArray  # (n_materials, n_bands), as the next three
    lower95: FloatArray
    upper95: FloatArray
    identifiable: BoolArray
    uniform: FloatArray  # (n_bands,), Eyring's absorption of the measured decay: a baseline
    chi2_reduced: FloatArray  # (n_bands,)
    models: tuple[str, ...]  # one a band
    findings: tuple[Code, ...]  # of all findings above "info", each once


@dataclass(frozen=True, slots=True, eq=False)
class Replicate:
    """One synthetic campaign."""

    number: int
    digest: str  # of the campaign and the settings that it belongs to
    synthesis: str  # how its responses were simulated
    true: FloatArray  # (n_materials, n_bands), absorption
    refused: str | None  # why roomfit gave no answer
    found: Found | None  # None where it gave none
    seconds: float


def replicate_path(out: Path, number: int) -> Path:
    """Return where a replicate lies within the output folder."""
    return Path(out) / FOLDER / f"{number:04d}.json"


# Keys of a replicate's file that have another name here.
_KEYS = {"phi": "chi2_reduced"}
_ARRAYS = ("absorption", "lower95", "upper95", "identifiable", "uniform", "phi")


def write_replicate(out: Path, replicate: Replicate) -> Path:
    """Write one replicate, aside first; its folder is made if needed.

    Raises
    ------
    StoreError
        The disk refuses.
    """
    path = replicate_path(out, replicate.number)
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
        for key in _ARRAYS:
            content[key] = getattr(found, _KEYS.get(key, key)).tolist()
        content["models"] = list(found.models)
        content["findings"] = [code.value for code in found.findings]
    with shared_folder(out, alone=False):
        make_folder(path.parent)
        return write_json_atomically(path, content)


def read_replicate(out: Path, number: int, digest: str) -> Replicate | None:
    """Return a replicate; None where there is none yet.

    Raises
    ------
    InputError
        The file is damaged, or belongs to another campaign, other settings or another version.
    """
    path = replicate_path(out, number)
    if not path.exists():
        return None
    try:
        content, _ = written_content(path, "replicate")
    except InputError as error:
        raise _damaged(path, str(error.found or error.what)) from error
    if not isinstance(content, dict) or content.get("format") != _FORMAT:
        raise _damaged(path, "another kind of file")
    if content.get("digest") != digest:
        raise InputError(
            "a replicate belongs to another estimate of coverage",
            where=str(path),
            found="another campaign, other measured files, --from, --snr-db or --seed, or another "
            "version of roomfit",
            needed="the same as it was simulated with",
            hint="choose another folder",
        )
    try:
        return _replicate(content, path)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise _damaged(path, f"{type(error).__name__}: {error}") from error


def _replicate(content: dict[str, Any], path: Path) -> Replicate:
    found = None
    if content["refused"] is None:
        arrays: dict[str, Any] = {
            _KEYS.get(key, key): np.array(content[key], bool if key == "identifiable" else float)
            for key in _ARRAYS
        }
        codes = tuple(code_of(text, str(path)) for text in content["findings"])
        found = Found(**arrays, models=tuple(content["models"]), findings=codes)
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
    what = "a replicate is damaged"
    needed = "a replicate as roomfit coverage has written it"
    hint = "remove it; it will be simulated again"
    return InputError(what, where=str(path), found=why, needed=needed, hint=hint)


# Keeps these draws apart from those of other tasks with the same seed.
_PURPOSE = 31


def replicated(
    plan: CoveragePlan,
    seed: int,
    number: int,
    scratch: Path,
    progress: Progress | None = None,
) -> Replicate:
    """Return one replicate; the same for the same seed and number, whoever asks.

    Where roomfit refuses the synthetic campaign, the replicate holds the refusal.

    `scratch`: an existing folder for the synthetic files, which are removed again.

    Raises
    ------
    StoreError
        The disk refuses.
    """
    began = time.perf_counter()
    rng = np.random.default_rng([seed, _PURPOSE, number])
    synthetic = draw_synthetic_room(plan, rng)
    rate_hz = synthetic_rate_hz(plan.campaign.bands)
    synthesis, pressures = synthetic_sound(plan, synthetic, wanted_pairs(plan), rate_hz, rng)
    found, refused = None, None
    with tempfile.TemporaryDirectory(dir=scratch, prefix=f"{number:04d}-") as folder:
        campaign = synthetic_campaign(plan, synthetic, pressures, Path(folder), rng)
        try:
            # through files, as a campaign's own recordings come: their format limits them alike
            answer = identify(**identify_arguments(campaign), progress=part(progress, 0.3, 1.0))
        except StoreError:
            raise
        except RoomfitError as error:
            refused = str(error)
        else:
            found = _found(plan, answer)
    return Replicate(
        number,
        plan.digest,
        synthesis,
        synthetic.absorption[:, plan.columns],
        refused,
        found,
        time.perf_counter() - began,
    )


def _found(plan: CoveragePlan, answer: Result) -> Found:
    return Found(
        answer.absorption,
        answer.lower95,
        answer.upper95,
        answer.identifiable,
        _uniform(plan, answer),
        answer.chi2_reduced,
        answer.models,
        tuple(sorted({f.code for f in answer.findings if f.severity != "info"})),
    )


def _prior_middle(plan: CoveragePlan) -> FloatArray:
    """Return the middle absorption of every prior, shape (n_materials, n_bands)."""
    mean, _ = prior_logit_law(plan.priors)
    return np.array(
        [
            k.lower + (k.upper - k.lower) * expit(own)
            for k, own in zip(plan.priors, mean, strict=True)
        ]
    )


def _uniform(plan: CoveragePlan, answer: Result) -> FloatArray:
    """Return Eyring's absorption of the measured decay in every band, or the mean of the priors.

    Of the median over pairs of T20, else of T30, else of EDT.
    """
    mesh = plan.room.mesh
    attenuation = attenuation_per_m(plan.campaign.air, plan.campaign.bands)
    out: FloatArray = _prior_middle(plan).mean(axis=0)
    for band in range(len(plan.campaign.bands)):
        for name in ("T20_s", "T30_s", "EDT_s"):
            rows = [p.parameters[name].measured for p in answer.pairs if name in p.parameters]
            known = [float(row[band]) for row in rows if np.isfinite(row[band])]
            if known:
                out[band] = eyring_absorption(
                    6.0 * float(np.log(10.0)) / float(np.median(known)),
                    volume_m3(mesh),
                    surface_area_m2(mesh),
                    answer.speed_of_sound_m_s,
                    float(attenuation[band]),
                )
                break
    return out


@dataclass(frozen=True, slots=True, eq=False)
class CoverageResult:
    """What all replicates that are there say together."""

    requested: int  # replicates of the whole estimate
    done: int  # those that are there
    refused: tuple[str, ...]  # why roomfit gave no answer to some of them
    syntheses: dict[str, int]  # how often responses were simulated in which way
    findings: dict[Code, int]  # above "info", over the replicates that were answered
    found: CoverageSample
    drawn_from: str  # "prior" or "answer"

    def __str__(self) -> str:
        """Return the table, what it means, and what was doubtful or refused."""
        from roomfit.coverage.output import coverage_text

        return coverage_text(self)

    def _repr_html_(self) -> str:
        """Return the table in HTML, for notebooks."""
        from roomfit.coverage.output import coverage_html

        return coverage_html(self)

    def plot(self) -> Figure:
        """Return coverage over the level of the interval, and of 95 % intervals by band."""
        from roomfit.coverage.output import coverage_figure

        return coverage_figure(self.found)

    def to_dataframe(self) -> Any:
        """Return a pandas data frame of one row a band, then all of them, as coverage.csv.

        Without pandas, on which roomfit does not depend, an `InputError` says what to install.
        """
        from roomfit.base.table import data_frame
        from roomfit.coverage.output import coverage_records

        return data_frame(coverage_records(self), "coverage.csv")


def estimate_coverage(
    campaign: Campaign,
    out: Path,
    settings: CoverageSettings | None = None,
    *,
    progress: Progress | None = None,
) -> CoverageResult:
    """Estimate how often intervals hold the true absorption, over synthetic replicates.

    The campaign is simulated many times with known absorption, and each time identified. Every
    replicate is a file of its own in ``out/replicates``; those that are there already are not
    simulated again, so that a run that was stopped goes on, and several machines may each take a
    slice (`CoverageSettings.first` and `only`) of one folder.

    Parameters
    ----------
    campaign : Campaign
        Its recordings need not exist where `CoverageSettings.snr_db` is given.
    out : Path
        Made if needed. What lies there must belong to the same campaign and settings.
    settings : CoverageSettings, optional
    progress : callable, optional
        Called with the share of the work that is done, 0 to 1.

    Returns
    -------
    CoverageResult
        Proportions, dimensionless, 0 to 1, with their own 95 % intervals: see
        `roomfit.coverage.statistics.coverage_rows`.

    Raises
    ------
    InputError
        Something in the campaign or its files is not as needed, or the folder holds replicates of
        another campaign or other settings.
    InsufficientDataError
        No replicate could be answered.
    StoreError
        The disk refuses.

    Notes
    -----
    Absorption drawn from the prior and intervals computed from simulated data make coverage exact
    on average where model and noise are right: S. Talts, M. Betancourt, D. Simpson, A. Vehtari,
    A. Gelman, "Validating Bayesian inference algorithms with simulation-based calibration",
    arXiv:1804.06788 (2018).

    Examples
    --------
    One replicate, too few for a statement; ``roomfit coverage`` makes 200.

    >>> import roomfit
    >>> text = '''
    ... [room]
    ... shoebox = [6, 5, 3]
    ... materials = { walls = "felt", ceiling = "felt" }
    ... [materials]
    ... felt.absorption = 0.8
    ... [sources.S]
    ... position = [1.5, 1.2, 1.5]
    ... [receivers.R]
    ... position = [4.0, 3.5, 1.2]
    ... [identify]
    ... from_hz = 1000
    ... to_hz = 1000
    ... [settings]
    ... n_rays = 2000
    ... [[measurements]]
    ... parameters = "measured.csv"
    ... '''
    >>> table = "source,receiver,parameter,1000\\nS,R,T30,0.2\\n"
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "campaign.toml"
    ...     _ = file.write_text(text)
    ...     _ = file.with_name("measured.csv").write_text(table)
    ...     settings = roomfit.CoverageSettings(replicates=1)
    ...     result = estimate_coverage(roomfit.read_campaign(file), Path(folder) / "out", settings)
    >>> result.done
    1
    """
    settings = CoverageSettings() if settings is None else settings
    check_output_folder(out, overwrite=True)
    plan = coverage_plan(campaign, settings)
    there = {n: read_replicate(out, n, plan.digest) for n in range(settings.replicates)}
    missing = [n for n in settings.numbers if there[n] is None]
    # on the same disk, beside the output folder, which may be put into its place anew meanwhile
    at = out.resolve()
    with shared_folder(at, alone=True):
        pass  # what killed runs have left behind is gone
    with hidden_folder(nearest_existing(at.parent), f".{at.name}.making-") as scratch:
        _simulate(plan, settings, missing, out, scratch, progress)
    return collected(plan, out, settings)


def _simulate(
    plan: CoveragePlan,
    settings: CoverageSettings,
    missing: list[int],
    out: Path,
    scratch: Path,
    progress: Progress | None,
) -> None:
    if settings.workers == 1 and settings.scheduler is None:
        for done, number in enumerate(missing):
            share = part(progress, done / len(missing), (done + 1) / len(missing))
            write_replicate(out, replicated(plan, settings.seed, number, scratch, share))
        return
    tasks = [partial(_task, plan, settings.seed, n, out.absolute(), scratch) for n in missing]
    workers = (
        worker_pool(settings.workers)
        if settings.scheduler is None
        else cluster_pool(scheduler=settings.scheduler, warm=compile_kernels)
    )
    with workers as pool:
        try:
            taken_s: list[float] = []
            bundles = bundled(tasks, lambda: float(np.median(taken_s)) if taken_s else None)
            # the first to end tell how long the others take
            for _, future in completed(pool, bundles):
                seconds: list[float] = result_of(future)
                taken_s += seconds
                if progress is not None:
                    progress(len(taken_s) / len(tasks))
        except BaseException:
            # workers look for the folder as they go on; without it they stop within seconds
            shutil.rmtree(scratch, ignore_errors=True)
            raise


def _task(plan: CoveragePlan, seed: int, number: int, out: Path, scratch: Path) -> float:
    """Write one replicate in a worker, unless the work was called off; return its seconds."""

    def watch(_: float) -> None:
        if not scratch.is_dir():
            raise StoreError("the work was called off", where=str(scratch))

    keep_one_thread()
    replicate = replicated(plan, seed, number, scratch, watch)
    write_replicate(out, replicate)
    return replicate.seconds


def collected(plan: CoveragePlan, out: Path, settings: CoverageSettings) -> CoverageResult:
    """Return what the replicates that are there say together.

    Raises
    ------
    InsufficientDataError
        None of them was answered.
    """
    there = [read_replicate(out, n, plan.digest) for n in range(settings.replicates)]
    done = [r for r in there if r is not None]
    answered = [r for r in done if r.found is not None]
    refused = tuple(r.refused for r in done if r.refused is not None)
    if not answered:
        raise InsufficientDataError(
            "no replicate could be identified",
            where=str(plan.campaign.path),
            found=f"{len(refused)} refused; the first: {refused[0].splitlines()[0]}"
            if refused
            else "none is there",
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
    names = [_KEYS.get(key, key) for key in _ARRAYS]
    arrays: dict[str, Any] = {name: np.array([getattr(f, name) for f in found]) for name in names}
    return CoverageSample(
        materials=plan.room.materials,
        bands=plan.campaign.bands,
        true=np.array([r.true for r in answered]),
        has_interval=free[None, :, None] & fitted[:, None, :],
        prior=_prior_middle(plan) if plan.answer is None else plan.answer.absorption,
        **arrays,
    )
