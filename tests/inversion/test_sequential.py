"""Which error of the model a band is fitted with, and where its fit begins."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from coherent_cases import objective_of, small_term
from roomfit.inversion import sequential
from roomfit.inversion.sequential import (
    NOISES,
    CoherentBand,
    CoherentOptions,
    fit_in_rounds,
    forward_pass,
)
from roomfit.objective.parameters import start_vector
from roomfit.solvers.least_squares import score_band


def tried(monkeypatch: pytest.MonkeyPatch, said: list[tuple[float, float]], **options):
    """Return the noises that are tried and the one that is chosen, and all starts.

    `said` has the log-likelihood and the reduced chi-square of a fit with each of `NOISES`.
    """
    noises, starts = [], []

    def fit(band, start, noise, joint, **_):
        likelihood, chi2 = said[NOISES.index(noise)]
        noises.append(noise)
        starts.append(start)
        answer = SimpleNamespace(chi2_reduced=chi2, vector=np.array([0.5]))
        return SimpleNamespace(fit=answer, log_likelihood=likelihood, found=None, noise=noise)

    monkeypatch.setattr(sequential, "fit_in_rounds", fit)
    nothing = SimpleNamespace(fitted=np.zeros(0, dtype=bool))
    monkeypatch.setattr(sequential, "geometry_block", lambda _: nothing)
    band = SimpleNamespace(
        coherent=SimpleNamespace(geometry=None), energy_fit=SimpleNamespace(vector=np.array([0.1]))
    )
    (best,) = forward_pass([band], CoherentOptions(model="coherent"), None, **options)
    return noises, best.noise, [float(s[0]) for s in starts]


@pytest.mark.parametrize(("n_geometry", "settled_sd"), [(0, None), (3, 0.1)])
def test_only_what_is_fitted_once_more_ends_early(monkeypatch, n_geometry, settled_sd):
    """Without an unknown position no pass follows, and the fit ends as near as any other."""
    asked = []

    def fit(*_, **how):
        asked.append(how["settled_sd"])
        answer = SimpleNamespace(chi2_reduced=0.5)
        return SimpleNamespace(fit=answer, log_likelihood=0.0, found=None)

    monkeypatch.setattr(sequential, "fit_in_rounds", fit)
    free = SimpleNamespace(fitted=np.ones(n_geometry, dtype=bool))
    monkeypatch.setattr(sequential, "geometry_block", lambda _: free)
    band = SimpleNamespace(
        coherent=SimpleNamespace(geometry=None), energy_fit=SimpleNamespace(vector=np.array([0.1]))
    )
    forward_pass([band], CoherentOptions(model="coherent"), None)
    assert asked == [settled_sd]


@pytest.mark.parametrize(
    ("said", "n_tried", "chosen"),
    [
        # as the model says: nothing else is tried
        ([(0.0, 0.9), (9.0, 0.5), (9.0, 0.5), (9.0, 0.5)], 1, 0),
        ([(0.0, 1.4), (5.0, 1.0), (9.0, 0.9), (9.0, 0.5)], 2, 1),
        # a larger error of the model that is less likely ends the search
        ([(0.0, 1.4), (-1.0, 1.1), (9.0, 0.9), (9.0, 0.5)], 2, 0),
        # a random phase that is less likely does not: 40 measured responses at 4 kHz
        ([(16164.0, 13.5), (18356.2, 4.30), (18355.8, 4.30), (19072.0, 1.77)], 4, 3),
        ([(0.0, 2.0), (5.0, 1.5), (4.0, 1.4), (4.5, 1.1)], 4, 1),
    ],
)
def test_errors_of_the_model_grow_while_that_is_likelier(monkeypatch, said, n_tried, chosen):
    noises, best, _ = tried(monkeypatch, said)
    assert noises == list(NOISES[:n_tried])
    assert best == NOISES[chosen]


def test_a_later_pass_begins_where_an_earlier_one_ended(monkeypatch):
    said = [(0.0, 0.9)] * 4
    assert tried(monkeypatch, said)[2] == [0.1]
    assert tried(monkeypatch, said, starts=[np.array([0.3, 7.0])])[2] == [0.3]
    assert tried(monkeypatch, said, starts=[None])[2] == [0.1]


def largest_array(record: object) -> int:
    """Return the number of entries of the largest array in a record and all that it holds."""
    if isinstance(record, np.ndarray):
        return record.size
    parts: list[object] = []
    if is_dataclass(record):
        parts = [getattr(record, f.name) for f in fields(record)]
    elif isinstance(record, dict):
        parts = list(record.values())
    elif isinstance(record, tuple | list):
        parts = list(record)
    return max((largest_array(p) for p in parts), default=0)


@pytest.mark.parametrize("rounds", [1, 2])
def test_a_fit_holds_no_paths_and_what_was_fitted_is_made_again_bit_by_bit(rounds):
    """Passes over the bands hold up to three fits of each: their paths would fill the memory."""
    term = small_term()
    energies = objective_of(term.energies)
    start = start_vector(energies.parameters)
    band = CoherentBand(energies, score_band(energies, start, max_rounds=2), term)
    whole = np.append(start, np.zeros(term.geometry.sd.size))
    found = fit_in_rounds(band, whole, NOISES[2], None, rounds=rounds, max_rounds=2)
    assert largest_array(band) >= term.images.weight.size > 4 * whole.size**2 > 0
    assert largest_array(found) <= max(whole.size**2, term.measured().size)
    again = found.objective(band)
    np.testing.assert_array_equal(again.predict(found.fit.vector).expected, found.fit.expected)
    np.testing.assert_array_equal(again.variance(found.fit.vector), found.fit.variance)
