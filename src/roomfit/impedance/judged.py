"""From a fit to an answer: what it found, what is doubtful, and the verdict."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from roomfit.findings import Finding
from roomfit.impedance.answer import ImpedanceAnswer
from roomfit.impedance.fit import ImpedanceFit, reduced_chi2
from roomfit.impedance.intervals import material_answers, unknown_answer
from roomfit.impedance.nuisances import found_nuisances, predicted_pairs, wall_condition
from roomfit.impedance.observed import Observed, level_at
from roomfit.impedance.problem import Problem
from roomfit.impedance.starts import Start, share_in_best
from roomfit.impedance.verdict import (
    ENOUGH_FREQUENCIES,
    LOUDEST_ESTIMATED_NOISE,
    Verdict,
    enough_identified,
    fits,
    likely_cause,
)
from roomfit.scene.scene import Scene
from roomfit.typing import FloatArray

Again = Callable[[Problem], ImpedanceFit]
"""Fits a changed problem from the start of its curves."""


def judged_answer(
    fit: ImpedanceFit,
    starts: tuple[Start, ...],
    rivals: tuple[ImpedanceFit, ...],
    observed: Observed,
    seconds: float,
    again: Again,
) -> ImpedanceAnswer:
    """Return the answer of a fit.

    Parameters
    ----------
    fit : ImpedanceFit
    starts : tuple of Start
    rivals : tuple of ImpedanceFit
        Other minima that explain the data as well.
    observed : Observed
        As it was told; `fit` may hold an estimate of the noise.
    seconds : float
    again : callable
        To look for the cause where the model does not fit.
    """
    problem = fit.problem
    materials = material_answers(fit)
    findings: list[Finding] = []
    weaker = _weaker_findings(problem, observed)
    findings += weaker
    identified = enough_identified(materials)
    verdict, doubts = _verdict(fit, rivals, observed, identified, bool(weaker), again)
    findings += doubts
    return ImpedanceAnswer(
        problem.observed.frequency_hz,
        problem.observed.tau_s,
        materials,
        verdict,
        tuple(findings),
        found_nuisances(fit),
        reduced_chi2(fit),
        fit.model_error,
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
    again: Again,
) -> tuple[Verdict, list[Finding]]:
    noise = fit.problem.observed.noise
    level = float(np.mean(level_at(fit.problem.observed)))
    estimated = observed.noise is None and noise is not None
    loud = (
        estimated
        and noise is not None
        and (float(np.mean(noise)) > LOUDEST_ESTIMATED_NOISE * level)
    )
    if loud or not fits(fit):
        cause = (
            "what the fit leaves is larger than any noise should be"
            if loud
            else likely_cause(fit, again)
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


def answer_without_fit(
    problem: Problem, findings: tuple[Finding, ...], seconds: float
) -> ImpedanceAnswer:
    """Return the answer where the data cannot hold the unknowns: nothing but that."""
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
        math.nan,
        math.nan,
        math.nan,
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
