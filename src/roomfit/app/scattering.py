"""How much walls scatter: chosen by the likelihood, and suspected where nobody thought of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from roomfit.checks import read_only
from roomfit.errors import InputError
from roomfit.findings import Finding
from roomfit.typing import BoolArray, FloatArray, IntArray, Progress

GRID = (0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.5, 0.7)
# Walls that were taken for smooth are tried with these.
TRIALS = (0.1, 0.3)
# A model that explains the data by less than this in log likelihood is not thought better.
_SUSPICIOUS = 5.0
# Half of the 95 % point of chi-square with one degree of freedom.
_WITHIN_95 = 1.92
_MOST_SWEEPS = 2

# Takes coefficients (n_materials, n_bands); gives the best log likelihood of each band, (n_bands,).
ScatteringFit = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class ScatteringChoice:
    """The scattering that explains the data best, and what else would do.

    Attributes
    ----------
    coefficients : float array, shape (n_materials, n_bands)
    lower, upper : float arrays, shape (n_materials, n_bands)
        The least and the largest grid value whose log likelihood is within 1.92 of the best, all
        else as chosen; equal to the coefficient where that was told.
    log_likelihood : float array, shape (n_bands,)
        At the choice.
    evaluations : int
        How often `fit` was called.
    """

    coefficients: FloatArray
    lower: FloatArray
    upper: FloatArray
    log_likelihood: FloatArray
    evaluations: int

    def __post_init__(self) -> None:
        for name in ("coefficients", "lower", "upper", "log_likelihood"):
            object.__setattr__(self, name, read_only(np.array(getattr(self, name))))


def choose_scattering(
    fit: ScatteringFit,
    start: FloatArray,
    fitted: BoolArray,
    *,
    grid: Sequence[float] = GRID,
    common: bool = True,
    per_band: bool = False,
    progress: Progress | None = None,
) -> ScatteringChoice:
    """Return the scattering coefficients with the highest profile likelihood on a grid.

    First all unknown coefficients move together. With ``common=False`` they are then moved one
    after the other, each over the whole grid, until none moves or two rounds are done.

    Parameters
    ----------
    fit : callable
        Best log likelihood of every band for given coefficients, whatever the model.
    start : float array, shape (n_materials, n_bands)
        Where a coefficient is told, its value; elsewhere anything.
    fitted : bool array, shape (n_materials,)
        Which materials' coefficients are unknown.
    grid : sequence of float
        Values to try.
    common : bool
        One value for all unknown coefficients.
    per_band : bool
        Let every band choose its own; otherwise the sum over bands decides.

    Raises
    ------
    InputError
        No coefficient is unknown, or the grid is empty or leaves 0 to 1.
    """
    values = np.array(sorted(set(grid)))
    if not np.any(fitted):
        raise InputError("no scattering is to be fitted", needed="at least one unknown coefficient")
    if not values.size or not np.all((values >= 0.0) & (values <= 1.0)):
        raise InputError(
            "no such scattering coefficients", found=str(tuple(grid)), needed="values from 0 to 1"
        )
    unknown = np.flatnonzero(fitted)
    groups = [unknown] if common else [unknown, *unknown[:, None]]
    rounds = 0 if common else _MOST_SWEEPS
    n_fits = len(values) * (1 + rounds * unknown.size)
    search = _Search(fit, np.array(start, dtype=np.float64), values, per_band, n_fits, progress)
    search.move(groups[0])
    for _ in range(rounds):
        moved = [search.move(group) for group in groups[1:]]  # every one, not only to the first
        if not any(moved):
            break
    if progress is not None:
        progress(1.0)
    return ScatteringChoice(
        search.at, search.lower, search.upper, search.log_likelihood, search.evaluations
    )


class _Search:
    """The present coefficients and what is known about them."""

    def __init__(
        self,
        fit: ScatteringFit,
        start: FloatArray,
        values: FloatArray,
        per_band: bool,
        n_fits: int,
        progress: Progress | None,
    ) -> None:
        self.fit, self.values, self.per_band = fit, values, per_band
        self.at, self.lower, self.upper = start, start.copy(), start.copy()
        self.log_likelihood: FloatArray = np.full(start.shape[1], -np.inf)
        self.evaluations = 0
        self.n_fits, self.progress = n_fits, progress

    def move(self, group: IntArray) -> bool:
        """Move some coefficients together to the best value of the grid; say whether they moved."""
        before = self.at.copy()
        profile = np.array([self._at(group, value) for value in self.values])
        judged = profile
        if not self.per_band:
            judged = np.repeat(profile.sum(axis=1)[:, None], profile.shape[1], axis=1)
        best = np.argmax(judged, axis=0)
        self.at[group] = self.values[best]
        bands = np.arange(best.size)
        self.log_likelihood = profile[best, bands]
        good = judged >= judged[best, bands] - _WITHIN_95
        self.lower[group] = self.values[np.argmax(good, axis=0)]
        self.upper[group] = self.values[len(good) - 1 - np.argmax(good[::-1], axis=0)]
        return not np.array_equal(before, self.at)

    def _at(self, group: IntArray, value: float) -> FloatArray:
        trial = self.at.copy()
        trial[group] = value
        self.evaluations += 1
        if self.progress is not None:
            self.progress(min(self.evaluations / self.n_fits, 1.0))
        return np.asarray(self.fit(trial), dtype=np.float64)


def suspected_scattering(
    fit: ScatteringFit,
    materials: tuple[str, ...],
    assumed: FloatArray,
    log_likelihood: FloatArray,
    *,
    trials: Sequence[float] = TRIALS,
) -> tuple[Finding, ...]:
    """Return a finding where walls taken for smooth had better be taken for scattering.

    Parameters
    ----------
    fit : callable
        As in `choose_scattering`.
    assumed : float array, shape (n_materials, n_bands)
        Coefficients of the fit; those that are 0 everywhere are tried.
    log_likelihood : float array, shape (n_bands,)
        Of the fit with these.
    trials : sequence of float
        Coefficients to try for all smooth walls at once.

    Returns
    -------
    tuple of Finding
        "scattering-suspected" where a trial gains more than 5 in log likelihood, all bands
        together, and no band loses as much, which speaks for something else than scattering: a
        loudspeaker that rings, for instance. Empty otherwise, and where no wall is smooth.
    """
    smooth = ~np.any(assumed > 0.0, axis=1)
    if not smooth.any():
        return ()
    gains = []
    for value in trials:
        trial = np.where(smooth[:, None], value, assumed)
        gain = fit(trial) - log_likelihood
        gains.append(float(np.sum(gain)) if np.all(gain > -_SUSPICIOUS) else -np.inf)
    best = int(np.argmax(gains))
    if not gains[best] > _SUSPICIOUS:
        return ()
    names = [name for name, is_smooth in zip(materials, smooth, strict=True) if is_smooth]
    return (
        Finding(
            "scattering-suspected",
            "serious",
            f"The measurement is explained better if {', '.join(names)} scatter: a coefficient of "
            f"{trials[best]:g} raises the log likelihood by {gains[best]:.0f}. Walls that "
            "are told to be smooth make up for it, and nothing is called identifiable. Tell their "
            'scattering, or let it be fitted with scattering = "fit".',
            {"materials": names, "scattering": float(trials[best]), "gain": gains[best]},
        ),
    )
