"""Sources taken for omnidirectional that the data contradict."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from roomfit.app.directing.unknown import Directed, Directing
from roomfit.findings import Finding
from roomfit.identification.reweighted import BandFit
from roomfit.identification.scoring import score_band
from roomfit.objective.directed_problem import (
    UnknownDirectivities,
    directed,
    vectors_of,
    with_unknown,
)
from roomfit.objective.energy_problem import EnergyProblem
from roomfit.objective.softened import SoftenedProblem
from roomfit.typing import FloatArray

# Three unknowns that explain nothing gain one and a half in log-likelihood on average: more is
# looked at closely.
_BY_CHANCE = 1.5
# A third of it where three windows count as one; 9 are asked for in six bands. Six omnidirectional
# sources in three boxes of another program (benchmarks/other_boxes.py) gained 2 to 4 in all, of six
# with |b| = 0.5 one gained 4, the others 21 to 52.
_A_BAND, _CONTRADICTS = 0.5, 6.0


@dataclass(frozen=True, slots=True, eq=False)
class DirectivityDoubt:
    """What one band says against omnidirectional sources.

    Attributes
    ----------
    gain : float array, shape (n_sources,)
        By how much the log-likelihood rises if a source may have its own b, the prior of b
        counted against it.
    b : float array, shape (n_sources, 3)
        What it would then have.
    """

    gain: FloatArray
    b: FloatArray


def directivity_doubt(
    problem: EnergyProblem, fit: BandFit, how: Directed, factor: FloatArray | None = None
) -> DirectivityDoubt:
    """Return what a fitted band says against each of its sources.

    First by Rao's score test [1]_: one evaluation at the answer, with the derivative by b, tells
    the gain to second order. Where that is more than chance gives, the source's b is fitted, and
    the full log-likelihoods are compared. What the model misses anyway, phi above 1, counts
    against the gain.

    Parameters
    ----------
    problem : EnergyProblem
        Without directivity.
    fit : BandFit
        Of this problem; room parameters that were fitted along stand behind its windows.
    how : Directed
        Of its sources.
    factor : float array, shape (n_windows,), optional
        By which the fit's variances were enlarged.

    References
    ----------
    .. [1] C. R. Rao, "Large sample tests of statistical hypotheses concerning several parameters",
           Proc. Camb. Phil. Soc. 44, 50-57 (1948).
    """
    soft = np.ones(problem.measured().size) if factor is None else factor
    gains, steps = _second_order_gains(_asked(problem, how, soft), fit)
    for s, name in enumerate(how.unknown.sources):
        if gains[s] > _BY_CHANCE:
            own = slice(3 * s, 3 * s + 3)
            unknown = UnknownDirectivities(
                (name,), how.unknown.mean[own], how.unknown.root[own, own]
            )
            alone = replace(how, unknown=unknown, source=np.where(how.source == s, 0, -1))
            plain = SoftenedProblem(problem, soft)
            gains[s], steps[s] = _full_gain(_asked(problem, alone, soft), plain, fit, steps[s])
    return DirectivityDoubt(gains, vectors_of(how.unknown, steps.ravel()))


def _asked(problem: EnergyProblem, how: Directed, soft: FloatArray) -> SoftenedProblem:
    """Return the problem with the directivity of some sources unknown."""
    unknown = with_unknown(problem, how.unknown)
    return SoftenedProblem(directed(unknown, how.unknown, how.source, how.departure), soft)


def _second_order_gains(asked: SoftenedProblem, fit: BandFit) -> tuple[FloatArray, FloatArray]:
    """Return half the squared score of each b over its variance, (n,), and a step of it, (n, 3).

    Each source by itself, as if the others were omnidirectional.
    """
    n = fit.vector.size
    size = len(asked.parameters.blocks[-1].labels)
    found = asked.predict(np.concatenate((fit.vector, np.zeros(size))))
    heard, misfit = found.expected.size, max(fit.phi, 1.0)
    spread = asked.counted_as_one() * fit.variance[:heard] * misfit
    residual = fit.measured[:heard] - found.expected
    gains, steps = np.zeros(size // 3), np.zeros((size // 3, 3))
    for s in range(size // 3):
        own = found.jacobian[:, n + 3 * s : n + 3 * s + 3]
        weighed = own / spread[:, None]
        # all other unknowns stand at their best: only b has a slope there
        score = weighed.T @ residual
        cross = weighed.T @ found.jacobian[:, :n]
        information = weighed.T @ own + np.eye(3)
        information -= cross @ np.linalg.solve(fit.information / misfit, cross.T)
        steps[s] = np.linalg.solve(information, score)
        gains[s] = 0.5 * float(steps[s] @ score)
    return gains, steps


def _full_gain(
    asked: SoftenedProblem, plain: SoftenedProblem, fit: BandFit, free: FloatArray
) -> tuple[float, FloatArray]:
    """Return by how much the log-likelihood rises if b is fitted, and its free numbers."""
    alone = fit if fit.measured.size == plain.measured().size else score_band(plain, fit.vector)
    free_fit = score_band(asked, np.concatenate((fit.vector, free)))
    found = free_fit.vector[-3:]
    rise = (free_fit.log_likelihood - alone.log_likelihood) / max(free_fit.phi, 1.0)
    return float(rise - 0.5 * found @ found), np.asarray(found)


def source_findings(
    suspects: Directing | None, doubts: Mapping[int, DirectivityDoubt]
) -> tuple[Finding, ...]:
    """Return a finding for each source taken for omnidirectional that the data contradict.

    Parameters
    ----------
    suspects : Directing or None
    doubts : mapping of band to DirectivityDoubt
    """
    if suspects is None or not doubts:
        return ()
    needed = _A_BAND * len(doubts) + _CONTRADICTS
    total = np.sum([d.gain for d in doubts.values()], axis=0)
    findings = []
    for s, name in enumerate(suspects.sources):
        if total[s] <= needed:
            continue
        b = np.array([doubts[band].b[s] for band in sorted(doubts)])
        strongest = b[int(np.argmax(np.linalg.norm(b, axis=1)))]
        towards = ", ".join(f"{x:.1f}" for x in strongest / np.linalg.norm(strongest))
        findings.append(
            Finding(
                "source-directs",
                "serious",
                f"{name} was taken for omnidirectional, and the data contradict that: they are "
                f"likelier if it sends more towards ({towards}). Absorption makes up for it, so "
                "nothing is called identifiable. Tell its directivity, or let it be fitted with "
                'directivity = "fit".',
                {"source": name, "log_likelihood_gain": float(total[s]), "b": b.tolist()},
            )
        )
    return tuple(findings)
