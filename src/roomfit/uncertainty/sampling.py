"""Samples of a band's posterior, and whether they may be trusted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from roomfit.errors import InputError
from roomfit.typing import FloatArray, Progress
from roomfit.uncertainty.chains import autocorrelation_steps, split_r_hat
from roomfit.uncertainty.log_posterior import LogPosterior
from roomfit.uncertainty.surrogate import Surrogate

# Of the first steps; the walkers begin close to the posterior.
_FORGOTTEN = 0.2
_LOOK_EVERY = 10


@dataclass(frozen=True, slots=True)
class SamplingSettings:
    """How much one band's samples may cost, and when there are enough.

    Attributes
    ----------
    most_evaluations : int
        Of the posterior.
    autocorrelations : float
        How many times longer than the autocorrelation every walker must have walked.
    largest_r_hat : float
        How much alike the halves of all walkers must be (`split_r_hat`).
    inner_steps : tuple of int, or None
        Steps under the surrogate between two evaluations, one of them at random: where the
        surrogate is far from the posterior only short walks are taken. None for
        `Surrogate.usual_steps`.
    """

    most_evaluations: int = 6_000
    autocorrelations: float = 20.0
    largest_r_hat: float = 1.1
    inner_steps: tuple[int, ...] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Sampled:
    """Draws from a posterior and what is known of their quality.

    Attributes
    ----------
    draws : float array, shape (n_draws, n_kept)
        The first steps left out.
    autocorrelation, r_hat : float arrays, shape (n_kept,)
    effective : float
        Draws over the longest autocorrelation time: so many independent ones tell as much.
    acceptance : float
        Share of proposals that were taken.
    evaluations : int
    converged : bool
        Whether the walkers have walked long enough and agree.
    """

    draws: FloatArray
    autocorrelation: FloatArray
    r_hat: FloatArray
    effective: float
    acceptance: float
    evaluations: int
    converged: bool


def sample(
    posterior: LogPosterior,
    near: Surrogate,
    rng: np.random.Generator,
    settings: SamplingSettings | None = None,
    *,
    progress: Progress | None = None,
) -> Sampled:
    """Return draws from a posterior by an ensemble of walkers [1]_.

    Of five proposals four are walks under the surrogate, weighed by how it differs from the
    posterior; the fifth is a difference of two other walkers [2]_, which needs no surrogate and
    frees what it leaves behind. Ends as soon as the samples are good enough, or the evaluations
    are used up: `Sampled.converged` says which.

    Parameters
    ----------
    posterior : LogPosterior
    near : Surrogate
    rng : numpy Generator
        The only source of chance: equal generators give equal draws.
    settings : SamplingSettings, optional
    progress : callable, optional

    Raises
    ------
    InputError
        The extra `posterior` is not installed.

    References
    ----------
    .. [1] D. Foreman-Mackey et al., "emcee: the MCMC hammer", PASP 125, 306-312 (2013).
    .. [2] C. J. F. ter Braak, "A Markov chain Monte Carlo version of the genetic algorithm
           differential evolution", Stat. Comput. 16, 239-249 (2006).
    """
    settings = SamplingSettings() if settings is None else settings
    emcee = _emcee()
    n = near.centre.size
    walkers = max(2 * n + 2, 12)
    quiet = _Quiet(posterior)
    sampler = emcee.EnsembleSampler(
        *(walkers, n, quiet),
        moves=[
            (_surrogate_move(emcee, near, settings.inner_steps or near.usual_steps, rng), 0.8),
            (emcee.moves.DEMove(), 0.2),
        ],
    )
    legacy = np.random.RandomState(rng.integers(2**31))
    start = emcee.State(_first_places(near, walkers, rng), random_state=legacy.get_state())
    steps = max(settings.most_evaluations // walkers - 1, _LOOK_EVERY)
    found: Sampled | None = None
    for number, _ in enumerate(sampler.sample(start, iterations=steps), start=1):
        if quiet.interrupted:
            raise KeyboardInterrupt
        if number % _LOOK_EVERY and number < steps:
            continue
        chain = sampler.get_chain(discard=int(_FORGOTTEN * number))
        taken = float(np.mean(sampler.acceptance_fraction))
        found = _judged(np.asarray(chain), taken, walkers * (number + 1), settings)
        if progress is not None:
            share = found.autocorrelation.max() * settings.autocorrelations / len(chain)
            progress(min(max(number / steps, 1.0 / max(share, 1.0)), 1.0))
        if found.converged:
            break
    assert found is not None  # noqa: S101 - the loop looks at its last step
    return found


class _Quiet:
    """A posterior that an interrupt leaves quickly: the sampler would print it as its own error."""

    def __init__(self, posterior: LogPosterior) -> None:
        self.posterior = posterior
        self.interrupted = False

    def __call__(self, kept: FloatArray) -> float:
        if self.interrupted:
            return -np.inf
        try:
            return self.posterior(kept)
        except KeyboardInterrupt:
            self.interrupted = True
            return -np.inf


def _judged(
    chain: FloatArray, acceptance: float, evaluations: int, settings: SamplingSettings
) -> Sampled:
    r_hat, length = split_r_hat(chain), autocorrelation_steps(chain)
    enough = len(chain) >= settings.autocorrelations * float(length.max())
    alike = bool(np.all(r_hat <= settings.largest_r_hat))
    return Sampled(
        chain.reshape(-1, chain.shape[2]),
        length,
        r_hat,
        chain.shape[0] * chain.shape[1] / float(length.max()),
        acceptance,
        evaluations,
        bool(enough and alike),
    )


def _first_places(near: Surrogate, walkers: int, rng: np.random.Generator) -> FloatArray:
    """Return where the walkers begin: all over the surrogate."""
    root = np.linalg.cholesky(near.covariance)
    places = near.centre + 0.5 * rng.standard_normal((walkers, near.centre.size)) @ root.T
    return near.walk(places, 400, rng)[0]


def _surrogate_move(
    emcee: Any, near: Surrogate, steps: tuple[int, ...], rng: np.random.Generator
) -> Any:
    """Return a move that walks under the surrogate; its class needs the lazily imported emcee."""

    def proposal(places: FloatArray, _others: Any, _random: Any) -> tuple[FloatArray, FloatArray]:
        there, gain = near.walk(np.asarray(places), int(rng.choice(steps)), rng)
        # the walk is reversible under the surrogate: to be undone as likely as it is less likely
        return there, -gain

    class SurrogateMove(emcee.moves.RedBlueMove):  # type: ignore[misc, name-defined, unused-ignore]
        get_proposal: Callable[..., Any] = staticmethod(proposal)

    return SurrogateMove()


def check_sampler() -> None:
    """Refuse to sample where the sampler is missing, before anything else takes its time.

    Raises
    ------
    InputError
        The extra `posterior` is not installed.
    """
    _emcee()


def _emcee() -> Any:
    """Import the sampler only when it is needed."""
    try:
        import emcee
    except ImportError as error:
        raise InputError(
            "sampling the posterior needs the package emcee",
            where="identify.method",
            found='method = "posterior" without it',
            needed="the extra `posterior`",
            hint='pip install "roomfit[posterior]", or method = "least-squares"',
        ) from error
    return emcee
