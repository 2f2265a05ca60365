"""Every band of a campaign fitted, with its intervals."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from roomfit.app.certainty.certifying import affordable_certificate, certified_fit
from roomfit.app.certainty.starts import Starts, from_random_starts
from roomfit.app.progress import part
from roomfit.identification.certified.certificate import Certificate
from roomfit.identification.reweighted import BandFit, fit_band
from roomfit.identification.solvers import (
    Solver,
    annealing_solver,
    few_gauss_newton_steps,
    gauss_newton,
    simplex_solver,
)
from roomfit.materials.knowledge import MaterialKnowledge
from roomfit.objective.directed_problem import DIRECTIVITY
from roomfit.objective.energy_problem import EnergyProblem
from roomfit.objective.parameters import Parameters, leaders, position_of, to_free
from roomfit.objective.problem import BandProblem
from roomfit.typing import BoolArray, FloatArray, Progress
from roomfit.uncertainty.gaussian import (
    absorption_intervals,
    weighted_mean_interval,
)
from roomfit.uncertainty.profile import Profile
from roomfit.uncertainty.sampling import Sampled


@dataclass(frozen=True, slots=True, eq=False)
class MirrorTrial:
    """Where a second fit ended that began with absorptions exchanged by a symmetry.

    Attributes
    ----------
    absorption : float array, shape (n_materials,)
    gain : float
        Its log-likelihood less that of the first fit.
    """

    absorption: FloatArray
    gain: float


@dataclass(frozen=True, slots=True, eq=False)
class BandAnswer:
    """What one band's fit says of the walls.

    Attributes
    ----------
    absorption, lower95, upper95 : float arrays, shape (n_materials,)
    identifiable : bool array, shape (n_materials,)
    logit_mean : float array, shape (n_materials,)
        Logit of the absorption.
    logit_covariance : float array, shape (n_materials, n_materials)
        Its posterior covariance, misfit included; zeros where an absorption is held.
    mean : tuple of three floats
        Area-weighted mean absorption, its lower and its upper 95 % bound.
    phi, cost : float
        Zeros where nothing was fitted.
    evaluations : int
    converged : bool
    model : str
        "energy", "coherent", "values", or "prior" where nothing was fitted.
    directivity : tuple of float arrays (n,) and (n, n), or None
        Free numbers of the sources' unknown directivity and their covariance, misfit included.
    kinds : tuple of str
        How each interval was made: "gaussian", "profile", "sampled", "given", or "none" where the
        data tell nothing; empty: all Gaussian.
    profiles : tuple of Profile
        Of the absorptions that were looked at, `entry` counting materials.
    samples : float array, shape (n_draws, n_materials), or None
        Absorption drawn from the posterior, where that was asked for and came to rest.
    sampling : Sampled or None
        How the samples came about.
    mirrors : tuple of MirrorTrial, one a symmetry
    starts : Starts or None
        Where least squares from random starts ended, where they were tried.
    """

    absorption: FloatArray
    lower95: FloatArray
    upper95: FloatArray
    identifiable: BoolArray
    logit_mean: FloatArray
    logit_covariance: FloatArray
    mean: tuple[float, float, float]
    phi: float
    cost: float
    evaluations: int
    converged: bool
    model: str
    directivity: tuple[FloatArray, FloatArray] | None = None
    certificate: Certificate | None = None
    kinds: tuple[str, ...] = ()
    profiles: tuple[Profile, ...] = ()
    samples: FloatArray | None = None
    sampling: Sampled | None = None
    mirrors: tuple[MirrorTrial, ...] = ()
    starts: Starts | None = None


Refine: TypeAlias = Callable[[BandProblem, BandFit, BandAnswer, Progress | None], BandAnswer]
"""Problem, its fit and the Gaussian answer to a better answer."""

Allow: TypeAlias = Callable[[int, BandProblem, BandFit], BandFit]
"""Number of a band, its problem and its fit to the same fit, less sure."""


def fit_bands(
    problems: Iterable[BandProblem | None],
    knowledge: tuple[MaterialKnowledge, ...],
    areas_m2: FloatArray,
    method: str,
    seed: int,
    progress: Progress | None,
    *,
    watch: Callable[[int, BandProblem, BandFit], None] | None = None,
    allow: Allow | None = None,
    refine: Refine | None = None,
) -> tuple[BandAnswer, ...]:
    """Fit one band after the other; where there is no problem, what was known is the answer.

    Parameters
    ----------
    problems : iterable of BandProblem or None
        Taken one at a time, so that they may be made when they are needed.
    method : {"auto", "least-squares", "simplex", "annealing", "certified", "posterior"}
        "auto" is least squares, with a proof where one is affordable. The paper's two methods
        search with the same squares; after annealing's first round the simplex refines.
        "certified" is least squares with a proof.
    watch : callable, optional
        Called with every band that was fitted, its problem and its fit.
    allow : callable, optional
        Makes intervals allow for errors that a fit cannot see.
    refine : callable, optional
        Makes better intervals while a band's problem is at hand.
    """
    n_bands = knowledge[0].prior_logit_mean.size
    answers: list[BandAnswer] = []
    for band, problem in enumerate(problems):
        if problem is None:
            answers.append(untold_band(knowledge, band, areas_m2))
            continue
        done = part(progress, band / n_bands, (band + 1) / n_bands)
        if method == "certified":
            fit, proof = certified_fit(problem, progress=done)
            noisy = fit if allow is None else allow(band, problem, fit)
            own = band_answer(problem.parameters, noisy, areas_m2, "energy")
            own = own if refine is None else refine(problem, fit, own, None)
            answers.append(replace(own, certificate=proof))
            continue
        solver, refiner = _solvers(problem.parameters, method, np.random.default_rng(seed))
        fit = fit_band(problem, solver, refiner, progress=done)
        starts: Starts | None = None
        if method == "auto" and isinstance(problem, EnergyProblem) and fit.vector.size:
            fit, starts = from_random_starts(problem, fit, np.random.default_rng(seed))
        if watch is not None:
            watch(band, problem, fit)
        model = "energy" if problem.are_energies().any() else "values"
        noisy = fit if allow is None else allow(band, problem, fit)
        own = replace(band_answer(problem.parameters, noisy, areas_m2, model), starts=starts)
        if method == "auto":
            own = replace(own, certificate=affordable_certificate(problem, fit.vector))
        answers.append(own if refine is None else refine(problem, fit, own, done))
    return tuple(answers)


def band_answer(
    parameters: Parameters, fit: BandFit, areas_m2: FloatArray, model: str
) -> BandAnswer:
    """Return what one band's fit says of each material and of the room as a whole."""
    found = absorption_intervals(parameters, fit.vector, fit.information, fit.phi)
    mean = weighted_mean_interval(
        parameters, fit.vector, found.covariance, areas_m2 / areas_m2.sum()
    )
    block = next(b for b in parameters.blocks if b.name == "absorption")
    own: FloatArray = np.zeros((areas_m2.size, areas_m2.size))
    fitted = np.flatnonzero(block.fitted)
    first = position_of(parameters, "absorption")
    chosen = slice(first, first + fitted.size)
    own[np.ix_(fitted, fitted)] = found.covariance[chosen, chosen]
    leader = leaders(block)
    covariance = own[np.ix_(leader, leader)]
    return BandAnswer(
        found.absorption,
        found.lower95,
        found.upper95,
        found.identifiable,
        to_free(block, found.absorption),
        covariance,
        mean,
        fit.phi,
        fit.cost,
        fit.evaluations,
        fit.converged,
        model,
        _directivity(parameters, fit.vector, found.covariance),
        kinds=_kinds(found.lower95, found.upper95, block.fitted[leader]),
    )


def _kinds(lower: FloatArray, upper: FloatArray, fitted: BoolArray) -> tuple[str, ...]:
    untold = (lower == 0.0) & (upper == 1.0)
    return tuple(
        "given" if not own else "none" if nothing else "gaussian"
        for own, nothing in zip(fitted, untold, strict=True)
    )


def _directivity(
    parameters: Parameters, vector: FloatArray, covariance: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    block = next((b for b in parameters.blocks if b.name == DIRECTIVITY), None)
    if block is None:
        return None
    first = position_of(parameters, DIRECTIVITY)
    own = slice(first, first + len(block.labels))
    return vector[own], covariance[own, own]


def untold_band(
    knowledge: tuple[MaterialKnowledge, ...], band: int, areas_m2: FloatArray
) -> BandAnswer:
    """Return what is left of a band without data: what was known beforehand, and no more."""
    held = np.array([k.known is not None for k in knowledge])
    known = np.array([np.nan if k.known is None else k.known[band] for k in knowledge])
    logit = np.array([k.prior_logit_mean[band] for k in knowledge])
    lower = np.array([k.lower for k in knowledge])
    upper = np.array([k.upper for k in knowledge])
    expected = lower + (upper - lower) / (1.0 + np.exp(-logit))
    absorption = np.where(held, known, expected)
    least, most = np.where(held, known, 0.0), np.where(held, known, 1.0)
    share = areas_m2 / areas_m2.sum()
    sd = np.where(held, 0.0, [k.prior_logit_sd[band] for k in knowledge])
    return BandAnswer(
        absorption,
        least,
        most,
        held,
        logit,
        np.diag(sd**2),
        (float(share @ absorption), float(share @ least), float(share @ most)),
        0.0,
        0.0,
        0,
        True,
        "prior",
        kinds=_kinds(least, most, ~held),
    )


def _solvers(
    parameters: Parameters, method: str, rng: np.random.Generator
) -> tuple[Solver, Solver]:
    if method == "annealing":
        return annealing_solver(parameters, rng), simplex_solver(parameters)
    if method == "simplex":
        return simplex_solver(parameters), simplex_solver(parameters)
    return gauss_newton, few_gauss_newton_steps
