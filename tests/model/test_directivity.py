"""Directivity as an unknown: derivatives, signs, and the priors that bands leave each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from coherent_cases import objective_of, small_geometry, small_paths, small_term
from roomfit.base.bands import bands_between
from roomfit.fit.directivity import (
    CORRELATION_PER_OCTAVE,
    band_information,
    cavity_priors,
    directivities_under_cavity_priors,
)
from roomfit.model.directivity import (
    BandDirectivities,
    DirectivityParameters,
    UnknownDirectivities,
    directed,
    directivity_block,
)
from roomfit.model.early import fixed_paths
from roomfit.model.energy import EnergyTerm
from roomfit.model.parameters import Parameters, position_of, start_vector
from roomfit.model.patterns import Pattern, directivity_factors, pattern_basis
from roomfit.model.problem import Objective
from roomfit.pressures.data_term import CoherentTerm, with_coherence
from roomfit.pressures.geometry import whole_covariance
from roomfit.solver import BandFit, Ending

B = np.array([0.5, -0.4, 0.3])
SMALL_B = np.array([0.3, -0.2, 0.1])  # no pressure turns its sign, about any axis
AIM = np.array([0.6, 0.0, 0.8])


def unknown_source() -> UnknownDirectivities:
    """Return a source with a correlated spread about a mean that is not zero."""
    root = np.array([[0.5, 0.0, 0.0], [0.1, 0.4, 0.0], [-0.1, 0.2, 0.3]])
    return UnknownDirectivities(("S",), np.array([0.1, 0.0, -0.1]), root)


def directed_case(*, coherent: bool, aim: np.ndarray | None = None) -> Objective:
    """Return the small room with its one source's directivity unknown, its aim known or not."""
    windows: EnergyTerm | CoherentTerm = small_term()
    unknown = unknown_source()
    _, paths = small_paths()
    basis = tuple(pattern_basis(paths.departure[r.path], aim) for r in windows.energies.rows)
    if coherent:
        windows = with_coherence(windows, 0.09 * whole_covariance(small_geometry()))
        windows = windows.aimed((aim, aim))
    else:
        windows = windows.energies
    absorption, gain, *geometry = objective_of(windows).parameters.blocks
    blocks = (absorption, gain, directivity_block(unknown), *geometry)
    directivity = BandDirectivities(unknown, np.zeros(2, dtype=np.int64), basis, (aim, aim))
    return Objective(Parameters(blocks), (directed(windows, directivity),))


def at_b(case: Objective, b: np.ndarray) -> np.ndarray:
    """Return a vector at which the source has a given b."""
    vector = start_vector(case.parameters)
    first = position_of(case.parameters, "directivity")
    vector[first : first + 3] = np.linalg.solve(unknown_source().root, b - unknown_source().mean)
    rest = vector[first + 3 :]
    rest[:] = 0.3 * np.random.default_rng(4).standard_normal(rest.size)
    return vector


@pytest.mark.parametrize("coherent", [False, True])
@pytest.mark.parametrize("b", [B, 2.0 * B])
@pytest.mark.parametrize("aim", [None, AIM])
def test_the_whole_jacobian_is_that_of_finite_differences(
    coherent: bool, b: np.ndarray, aim: np.ndarray | None
) -> None:
    """Absorption, gain, directivity and geometry; at |b| = 1.4 some pressures change sign.

    Central differences of 1e-5 of smooth functions: 1e-9 relative. Times are off by the spreading
    kernel, 1e-5 of an amplitude: its slope by some 1e-3.
    """
    case = directed_case(coherent=coherent, aim=aim)
    vector = at_b(case, b)
    jacobian = case.predict(vector).jacobian
    first_time = position_of(case.parameters, "geometry")
    for k in range(vector.size):
        step = 1e-5 * np.eye(vector.size)[k]
        high, low = (case.predict(vector + s * step).expected for s in (1.0, -1.0))
        near = 2e-3 if k >= first_time else 1e-7
        np.testing.assert_allclose(
            jacobian[:, k],
            (high - low) / 2e-5,
            rtol=0,
            atol=near * np.abs(jacobian[:, k]).max(),
            err_msg=str(k),
        )


@pytest.mark.parametrize("coherent", [False, True])
@pytest.mark.parametrize("aim", [None, AIM])
def test_known_b_is_the_problem_of_weights_that_have_it(
    coherent: bool, aim: np.ndarray | None
) -> None:
    """Means and variances equal those of paths weighed first, where no sign turns.

    Directions of rows are those of the trace, those of images come from their image transforms,
    both in single precision: 1e-6.
    """
    case, b = directed_case(coherent=coherent, aim=aim), SMALL_B
    scene, paths = small_paths()
    factors = directivity_factors(paths, [Pattern(b, aim)], scene.pairs[:, 0].tolist(), 0)
    weighted = replace(paths, weight_per_m2=paths.weight_per_m2 * factors)
    whole = small_term(paths=weighted)
    plain = objective_of(whole.energies)
    if coherent:
        plain = objective_of(with_coherence(whole, 0.09 * whole_covariance(small_geometry())))
    vector = at_b(case, b)
    first = position_of(case.parameters, "directivity")
    without = np.delete(vector, np.arange(first, first + 3))
    ours, theirs = case.predict(vector), plain.predict(without)
    scale = np.abs(theirs.expected).max()
    np.testing.assert_allclose(ours.expected, theirs.expected, rtol=1e-5, atol=1e-6 * scale)
    np.testing.assert_allclose(
        case.variance(vector), plain.variance(without), rtol=1e-4, atol=1e-6 * scale**2
    )


def test_paths_that_stay_are_weighed_as_the_source_sends() -> None:
    """Also in the pieces of windows and in the Monte-Carlo variance, beside paths weighed first."""
    (term,) = directed_case(coherent=False).terms
    scene, paths = small_paths()
    factors = directivity_factors(paths, [Pattern(SMALL_B, None)], scene.pairs[:, 0].tolist(), 0)
    weighted = replace(paths, weight_per_m2=paths.weight_per_m2 * factors)
    absorption = np.full(small_term().energies.rows[0].hits.shape[1], 0.2)
    found = fixed_paths(term.windows, term.directivity, absorption, SMALL_B[None])
    right = fixed_paths(small_term(paths=weighted).energies, None, absorption, np.zeros((0, 3)))
    for name in ("energy", "fine_energy", "tracing", "mean_hits"):
        ours, theirs = getattr(found, name), getattr(right, name)
        np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-6 * np.abs(theirs).max())
    omnidirectional = fixed_paths(small_term().energies, None, absorption, np.zeros((0, 3)))
    assert np.abs(found.fine_energy / omnidirectional.fine_energy - 1.0).max() > 0.1


def linear_band(rng: np.random.Generator, n: int, rank: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the likelihood of a linear band with unit noise, in so many directions of n."""
    matrix = rng.standard_normal((rank, n))
    return matrix.T @ matrix, matrix.T @ rng.standard_normal(rank)


@pytest.mark.parametrize("seed", range(3))
def test_a_cavity_prior_is_the_posterior_without_the_band_s_own_data(seed: int) -> None:
    """Bayes by conditioning, term by term: the own data put back give the posterior of all.

    The information form inside against the covariance form here, one band after the other.
    """
    rng = np.random.default_rng(seed)
    octaves, n = np.array([0.0, 1.0, 2.0, 3.5]), 3
    likelihoods = [linear_band(rng, n, 5), linear_band(rng, n, 2), None, linear_band(rng, n, 1)]
    found = cavity_priors(likelihoods, octaves, 0.8, n)
    prior = np.kron(0.8 ** np.abs(octaves[:, None] - octaves), np.eye(n))
    for band, (mean, covariance) in enumerate(found):
        m, c = np.zeros(len(prior)), prior
        for other, one in enumerate(likelihoods):
            if other == band or one is None:
                continue
            pick = np.eye(len(prior))[n * other : n * (other + 1)]
            information, weighted_mean = one
            value, vectors = np.linalg.eigh(information)
            determined = value > 1e-9
            rows = np.sqrt(value[determined])[:, None] * vectors.T[determined] @ pick
            data = (vectors.T[determined] @ weighted_mean) / np.sqrt(value[determined])
            gain = c @ rows.T @ np.linalg.inv(rows @ c @ rows.T + np.eye(int(determined.sum())))
            m, c = m + gain @ (data - rows @ m), c - gain @ rows @ c
        own = slice(n * band, n * (band + 1))
        np.testing.assert_allclose(mean, m[own], atol=1e-9)
        np.testing.assert_allclose(covariance, c[own, own], atol=1e-9)


def test_a_band_takes_over_what_the_other_says_of_b_as_far_as_octaves_are_correlated():
    """Of two bands: the normal law of one given the other, by conditioning, in b itself."""
    prior = UnknownDirectivities(("S",), np.array([0.1, 0.0, -0.2]), 0.5 * np.eye(3))
    specified = DirectivityParameters(prior, np.array([0]), (None,))
    bands = bands_between("octave", 500, 2000)
    directed_by = BandDirectivities(unknown_source(), np.array([0]), (), (None,))
    precision, z = np.diag([4.0, 9.0, 1e-9]), np.array([0.6, -0.3, 0.0])
    vector = np.concatenate(([7.0], z))  # what comes before the directivity does not matter
    information = np.eye(4)
    information[1:, 1:] += precision
    fit = BandFit(
        *(vector, 0.0, 1.0, information, np.zeros(1), np.ones(1), np.zeros(1), 0.0, 1),
        Ending.CONVERGED,
    )
    none, *two = directivities_under_cavity_priors(
        specified, bands, (None, directed_by, directed_by), (None, fit, None)
    )
    assert none is None
    own, other = (band.unknown for band in two if band is not None)
    # the band itself: as specified, for the other has no fit
    np.testing.assert_allclose(own.mean, [0.1, 0.0, -0.2], atol=1e-9)
    np.testing.assert_allclose(own.root @ own.root.T, 0.25 * np.eye(3), rtol=1e-6)
    # the other: the data alone have mean (1 + 1 / p) z, and the correlation is that of an octave
    correlation, p = CORRELATION_PER_OCTAVE, np.diag(precision)
    with np.errstate(divide="ignore"):
        gain = correlation / (1.0 + 1.0 / p)
    mean = gain * (1.0 + 1.0 / p) * z
    variance = 1.0 - gain * correlation
    np.testing.assert_allclose(other.mean, prior.mean + 0.5 * mean, atol=1e-6)
    np.testing.assert_allclose(other.root @ other.root.T, 0.25 * np.diag(variance), atol=1e-6)
    assert other.sources == ("S",)


def test_a_band_s_information_is_marginal_over_its_other_unknowns() -> None:
    """A linear band: its likelihood with the first two unknowns minimised out, prior taken out."""
    rng = np.random.default_rng(5)
    matrix, data = rng.standard_normal((40, 5)), 0.1 * rng.standard_normal(40)
    prior = np.diag([0.0, 0.0, 1.0, 1.0, 1.0])
    information = matrix.T @ matrix + prior
    vector = np.linalg.solve(information, matrix.T @ data)
    nothing = np.zeros(40)
    fit = BandFit(
        *(vector, 0.0, 0.5, information, nothing, nothing + 1.0, data, 0.0, 1, Ending.CONVERGED),
    )
    alone, weighted_mean = band_information(fit, 2)
    free = matrix[:, :2]
    left = matrix[:, 2:] - free @ np.linalg.lstsq(free, matrix[:, 2:], rcond=None)[0]
    np.testing.assert_allclose(alone, left.T @ left, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(weighted_mean, left.T @ data, atol=1e-9)
    poor = band_information(replace(fit, chi2_reduced=4.0), 2)
    np.testing.assert_allclose(poor[0], alone / 4.0)
    np.testing.assert_allclose(poor[1], weighted_mean / 4.0)
