"""The whole way: from a scene and measured pressures to impedances and a verdict."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from roomfit.errors import InputError
from roomfit.findings import Finding
from roomfit.geometry.measures import mean_free_path_m
from roomfit.impedance.answer import ImpedanceAnswer
from roomfit.impedance.choose import WallModel, first_curves, with_laws
from roomfit.impedance.enough import data_findings
from roomfit.impedance.fit import ImpedanceFit, reduced_chi2, refined, relaxed
from roomfit.impedance.intervals import material_answers, unknown_answer
from roomfit.impedance.model import Nuisances, WaveModel, wave_model
from roomfit.impedance.nuisances import found_nuisances, predicted_pairs, wall_condition
from roomfit.impedance.observed import (
    MODEL_ERROR,
    PLANE_MODEL_ERROR,
    Observed,
    level_at,
    standard_deviation,
)
from roomfit.impedance.problem import Problem, start_of
from roomfit.impedance.starts import (
    SAME_WITHIN,
    Start,
    distance,
    distinct,
    looked_around,
    share_in_best,
    thinned,
)
from roomfit.impedance.verdict import (
    ENOUGH_FREQUENCIES,
    LOUDEST_ESTIMATED_NOISE,
    Verdict,
    enough_identified,
    fits,
    likely_cause,
)
from roomfit.scene.scene import Scene
from roomfit.typing import FloatArray, Progress

N_RANDOM_STARTS = 3
# Another minimum whose cost at first sight is at most this many times the lowest is followed, too.
_RIVAL = 1.5


def identify_impedance(
    scene: Scene,
    observed: Observed,
    walls: Mapping[str, WallModel] | None = None,
    nuisances: Nuisances | None = None,
    *,
    rng: np.random.Generator,
    spherical: bool = True,
    model_error: float | None = None,
    n_random_starts: int = N_RANDOM_STARTS,
    progress: Progress | None = None,
) -> ImpedanceAnswer:
    """Return the reflection coefficient, absorption and impedance of every material of a room.

    Parameters
    ----------
    scene : Scene
        Pairs in the order of the pressures.
    observed : Observed
    walls : mapping of material to WallModel, optional
        Materials that are left out are splines.
    nuisances : Nuisances, optional
        What may be wrong about the measurement; left out: positions by 10 mm a coordinate unless
        the scene tells more, the speed of sound by 1 %, gains known.
    rng : numpy Generator
        Draws starts.
    spherical : bool
        False takes waves at the walls for plane, which is 5 times as wrong: for comparison.
    model_error : float, optional
        Error of the image model itself, relative, times wavenumber and mean free path; left out:
        0.16, or 1.3 with plane waves, as measured against exact wave fields. Less only for data
        that another image model made.
    n_random_starts : int
    progress : callable, optional

    Raises
    ------
    InputError
        Data, walls and scene do not belong together.
    """
    began = time.perf_counter()
    told = {name: (walls or {}).get(name, WallModel()) for name in scene.room.materials}
    problem = wave_problem(
        scene, observed, walls, nuisances, spherical=spherical, model_error=model_error
    )
    findings = data_findings(problem, told)
    if findings:
        return _without_fit(problem, findings, time.perf_counter() - began)
    starts = looked_around(problem, n_random_starts, rng, _part(progress, 0.0, 0.3))
    fit = refined(problem, starts[0].x, progress=_part(progress, 0.3, 0.6))
    rivals = _rivals(problem, starts, fit)
    if observed.noise is None:
        fit = _with_estimated_noise(fit)
    fit = with_laws(fit, told, rng).fit
    if progress is not None:
        progress(0.9)
    return _answer(fit, starts, rivals, observed, time.perf_counter() - began)


def _check_names(scene: Scene, walls: Mapping[str, WallModel]) -> None:
    for name in walls:
        if name not in scene.room.materials:
            raise InputError(
                "a model is told for a wall that does not exist",
                found=repr(name),
                needed=", ".join(scene.room.materials),
            )


def _part(progress: Progress | None, low: float, high: float) -> Progress | None:
    if progress is None:
        return None
    return lambda share: progress(low + (high - low) * min(share, 1.0))


def wave_problem(
    scene: Scene,
    observed: Observed,
    walls: Mapping[str, WallModel] | None = None,
    nuisances: Nuisances | None = None,
    *,
    spherical: bool = True,
    model_error: float | None = None,
) -> Problem:
    """Return what `identify_impedance` solves first; arguments as there.

    Raises
    ------
    InputError
        Data, walls and scene do not belong together.
    """
    told = {name: (walls or {}).get(name, WallModel()) for name in scene.room.materials}
    _check_names(scene, walls or {})
    usual = MODEL_ERROR if spherical else PLANE_MODEL_ERROR
    factor = usual if model_error is None else model_error
    model = wave_model(scene, observed.frequency_hz, observed.tau_s)
    sd = _deviation(model, observed, factor)
    curves = tuple(first_curves(told, observed.frequency_hz))
    return Problem(model, observed, sd, curves, nuisances or Nuisances(), spherical, factor)


def _deviation(model: WaveModel, observed: Observed, factor: float) -> FloatArray:
    free_path_m = mean_free_path_m(model.scene.room.mesh)
    sd = standard_deviation(observed, free_path_m, model.speed_m_s, factor)
    # exact data and an exact model: rounding, and images beyond the last
    return np.maximum(sd, 1e-4 * level_at(observed))


def _rivals(
    problem: Problem, starts: tuple[Start, ...], fit: ImpedanceFit
) -> tuple[ImpedanceFit, ...]:
    """Return fits of other minima that explain the data as well as the lowest does."""
    found = []
    for start in distinct(starts)[1:]:
        if start.cost > _RIVAL * starts[0].cost:
            continue
        other = refined(problem, start.x)
        as_good = reduced_chi2(other) <= max(1.2 * reduced_chi2(fit), 1.0)
        if as_good and distance(other.r0, fit.r0) > 5.0 * SAME_WITHIN:
            found.append(other)
    return tuple(found)


def _with_estimated_noise(fit: ImpedanceFit) -> ImpedanceFit:
    """Return the fit with the noise that its own residual tells, one rms for all frequencies."""
    problem = fit.problem
    scaled = np.reshape(fit.residual**2, (-1, *problem.sd.shape)).mean(axis=0) * problem.sd**2
    free = max(1.0 - fit.effective / len(fit.residual), 1e-2)
    left = float(np.mean(scaled)) / free
    of_model = float(np.mean(problem.sd**2))
    noise = np.full(problem.sd.shape, np.sqrt(max(left - 0.5 * of_model, 1e-3 * of_model)))
    observed = replace(problem.observed, noise=noise)
    sd = _deviation(problem.model, observed, problem.model_error)
    return refined(replace(problem, observed=observed, sd=sd), fit.x, fit.roughness_sd)


def _again(problem: Problem) -> ImpedanceFit:
    """Return the fit of a changed problem, from the start of its curves."""
    thin = thinned(problem)
    x, _, _ = relaxed(thin, start_of(thin))
    return refined(problem, x)


def _answer(
    fit: ImpedanceFit,
    starts: tuple[Start, ...],
    rivals: tuple[ImpedanceFit, ...],
    observed: Observed,
    seconds: float,
) -> ImpedanceAnswer:
    problem = fit.problem
    materials = material_answers(fit)
    findings: list[Finding] = []
    weaker = _weaker_findings(problem, observed)
    findings += weaker
    verdict, doubts = _verdict(fit, rivals, observed, enough_identified(materials), bool(weaker))
    findings += doubts
    return ImpedanceAnswer(
        problem.observed.frequency_hz,
        problem.observed.tau_s,
        materials,
        verdict,
        tuple(findings),
        found_nuisances(fit),
        reduced_chi2(fit),
        wall_condition(fit),
        round(share_in_best(starts) * len(starts)),
        len(starts),
        _pair_names(problem.model.scene),
        problem.observed.pressure,
        predicted_pairs(fit),
        problem.sd,
        "nothing moved any more" if fit.settled else "the most rounds were used up",
        fit.evaluations,
        fit.rounds,
        seconds,
    )


def _weaker_findings(problem: Problem, observed: Observed) -> list[Finding]:
    findings = []
    if observed.noise is None and problem.observed.noise is not None:
        level = float(np.mean(level_at(problem.observed)))
        share = float(problem.observed.noise.mean()) / level
        findings.append(
            Finding(
                "noise-estimated",
                "warning",
                f"The noise was not told; what the fit leaves ({share:.1%} of the level) was taken "
                "for it. A model that does not fit cannot be told from noise then.",
                {"noise_over_level": share},
            )
        )
    if not observed.has_phase:
        findings.append(
            Finding(
                "levels-only",
                "warning",
                "Only levels were given. Other walls than those found may explain them; phases "
                "would tell.",
                {},
            )
        )
    return findings


def _verdict(
    fit: ImpedanceFit,
    rivals: tuple[ImpedanceFit, ...],
    observed: Observed,
    identified: FloatArray,
    weaker: bool,
) -> tuple[Verdict, list[Finding]]:
    noise = fit.problem.observed.noise
    level = float(np.mean(level_at(fit.problem.observed)))
    estimated = observed.noise is None and noise is not None
    loud = estimated and float(np.mean(noise if noise is not None else 0.0)) > (
        LOUDEST_ESTIMATED_NOISE * level
    )
    if loud or not fits(fit):
        cause = (
            "what the fit leaves is larger than any noise should be"
            if loud
            else likely_cause(fit, _again)
        )
        sentence = (
            f"The model does not fit: it leaves {reduced_chi2(fit):.1f} times the expected squares."
            f" Likely cause: {cause}."
        )
        finding = Finding(
            "impedance-does-not-fit",
            "serious",
            sentence + " Do not use the walls found.",
            {"chi2": reduced_chi2(fit), "cause": cause},
        )
        return Verdict("does not fit", cause, sentence, weaker), [finding]
    names = fit.problem.model.scene.room.materials
    unsure = [n for n, share in zip(names, identified, strict=True) if share < ENOUGH_FREQUENCIES]
    if rivals or unsure:
        cause = (
            "other walls explain the data as well"
            if rivals
            else f"the data hardly depend on {', '.join(unsure)}"
        )
        sentence = f"Not identifiable: {cause}."
        finding = Finding(
            "impedance-not-identifiable",
            "serious",
            sentence + " More pairs, or pairs nearer to the walls concerned, would tell.",
            {"rivals": len(rivals), "materials": unsure},
        )
        return Verdict("not identifiable", cause, sentence, weaker), [finding]
    sentence = (
        f"Identified: the residual is {reduced_chi2(fit):.2f} of what noise and model error allow."
    )
    return Verdict("identified", "", sentence, weaker), []


def _pair_names(scene: Scene) -> tuple[tuple[str, str], ...]:
    return tuple((scene.sources[s].name, scene.receivers[r].name) for s, r in scene.pairs)


def _without_fit(
    problem: Problem, findings: tuple[Finding, ...], seconds: float
) -> ImpedanceAnswer:
    observed = problem.observed
    names = problem.model.scene.room.materials
    cause = "too few data"
    return ImpedanceAnswer(
        observed.frequency_hz,
        observed.tau_s,
        tuple(unknown_answer(name, "none", len(observed.frequency_hz)) for name in names),
        Verdict("not identifiable", cause, f"Not identifiable: {cause}.", False),
        findings,
        (),
        float("nan"),
        float("nan"),
        0,
        0,
        _pair_names(problem.model.scene),
        observed.pressure,
        np.zeros_like(observed.pressure),
        problem.sd,
        "nothing was fitted",
        0,
        0,
        seconds,
    )
