"""Several starts, of which the best are refined: do they agree?"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from roomfit.impedance.curves import Spline
from roomfit.impedance.fit import relaxed
from roomfit.impedance.layout import layout_of, r0_of, start_of
from roomfit.impedance.model import at_frequencies
from roomfit.impedance.observed import Observed
from roomfit.impedance.problem import Problem
from roomfit.typing import ComplexArray, FloatArray, Progress

# Frequencies that a first look keeps for each function of the smoothest curve, about.
_PER_FUNCTION = 2
# Minima whose R0 differ by less (rms, worst material) are one.
SAME_WITHIN = 0.01
_LARGEST_START = 0.95


class Start(NamedTuple):
    """Where one start led at first sight, with plane waves and short paths.

    Attributes
    ----------
    x : float array, shape (n_unknowns,)
    r0 : complex array, shape (n_materials, n_frequencies kept)
    cost : float
    """

    x: FloatArray
    r0: ComplexArray
    cost: float


def looked_around(
    problem: Problem,
    n_random: int,
    rng: np.random.Generator,
    progress: Progress | None = None,
) -> tuple[Start, ...]:
    """Return where the usual start and random ones lead, lowest cost first.

    The usual start is that of the curves (0.8 unless told); random ones are even over the disc of
    passive walls, each material for itself. All at fewer frequencies, with plane waves.
    """
    thin = thinned(problem)
    layout = layout_of(thin)
    found = []
    for number in range(1 + n_random):
        x = start_of(thin)
        if number > 0:
            for place, curve in zip(layout.curves, thin.curves, strict=True):
                x[place] = _random_start(curve.start, isinstance(curve, Spline), rng)
        x, cost, _ = relaxed(thin, x, gain=1e-5)
        found.append(Start(x, r0_of(thin, layout, x), cost))
        if progress is not None:
            progress((number + 1) / (1 + n_random))
    return tuple(sorted(found, key=lambda s: s.cost))


def _random_start(usual: FloatArray, is_spline: bool, rng: np.random.Generator) -> FloatArray:
    if not is_spline:
        return np.asarray(usual + rng.normal(size=usual.shape))
    r0 = _LARGEST_START * np.sqrt(rng.random()) * np.exp(2j * np.pi * rng.random())
    return np.repeat([r0.real, r0.imag], len(usual) // 2)


def distance(a: ComplexArray, b: ComplexArray) -> float:
    """Return the rms difference over frequency of the worst material."""
    return float(np.sqrt(np.mean(np.abs(a - b) ** 2, axis=1)).max())


def distinct(starts: tuple[Start, ...], within: float = SAME_WITHIN) -> tuple[Start, ...]:
    """Return one start for each minimum, lowest first."""
    kept: list[Start] = []
    for start in starts:
        if all(distance(start.r0, other.r0) > within for other in kept):
            kept.append(start)
    return tuple(kept)


def share_in_best(starts: tuple[Start, ...], within: float = SAME_WITHIN) -> float:
    """Return the share of starts that led to the lowest minimum."""
    return float(np.mean([distance(s.r0, starts[0].r0) <= within for s in starts]))


def thinned(problem: Problem) -> Problem:
    """Return the problem at about as few frequencies as its curves allow."""
    n_f = len(problem.observed.frequency_hz)
    most = max((c.basis.shape[1] for c in problem.curves if isinstance(c, Spline)), default=n_f)
    every = max(n_f // (_PER_FUNCTION * most), 1)
    if every == 1:
        return problem
    chosen = np.arange(0, n_f, every)
    observed = problem.observed
    return replace(
        problem,
        model=at_frequencies(problem.model, chosen),
        observed=Observed(
            observed.frequency_hz[chosen],
            observed.tau_s,
            observed.pressure[:, chosen],
            None if observed.noise is None else observed.noise[:, chosen],
            observed.has_phase,
        ),
        sd=problem.sd[:, chosen],
        curves=tuple(c.at(chosen) for c in problem.curves),
    )
