"""Rows weighed by kernels against the readable form, finite differences and laws."""

from __future__ import annotations

import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rays_reference import batch_energies
from roomfit.base.errors import InputError
from roomfit.base.typing import FloatArray
from roomfit.model.energy import squared_image_rows
from roomfit.model.patterns import amplitude_and_slope
from roomfit.model.weighing import (
    EnergyRows,
    RowPattern,
    directed_rows,
    merge_equal_rows,
    weigh,
    weigh_parts,
    window_of_rows,
)


def surviving_energy(hits, coefficients):
    """Return ``(1 - a) ** hits`` multiplied over materials, (n_paths, n_bands)."""
    return np.prod((1.0 - coefficients) ** hits[:, :, None], axis=1)


EXTREMES = st.sampled_from([0.0, 1.0, 1.0 - 1e-9, 1e-9])
COEFFICIENT = st.one_of(EXTREMES, st.floats(0.0, 1.0))
SEED = st.integers(0, 2**32 - 1)


def random_rows(
    seed: int, n_rows: int = 300, n_materials: int = 3, n_windows: int = 5, mean_hits: float = 2.0
) -> EnergyRows:
    """Return rows with everything drawn at random; a window may be empty."""
    rng = np.random.default_rng(seed)
    window = np.sort(rng.integers(0, n_windows, n_rows))
    offsets = np.searchsorted(window, np.arange(n_windows + 1))
    return EnergyRows(
        tuple(f"material {m}" for m in range(n_materials)),
        n_windows,
        offsets,
        rng.uniform(0.0, 1.0, n_rows),
        rng.poisson(mean_hits, (n_rows, n_materials)).astype(np.uint16),
        rng.uniform(1.0, 100.0, n_rows),
        rng.integers(-1, 8, n_rows).astype(np.int32),
        8,
    )


def table(seed: int, n_materials: int, n_bands: int) -> FloatArray:
    """Return random coefficients, one in four of them 0 or 1."""
    rng = np.random.default_rng(seed)
    a = rng.uniform(0.0, 1.0, (n_materials, n_bands))
    return np.where(rng.random(a.shape) < 0.25, np.round(a), a)


def in_numpy(rows: EnergyRows, a: FloatArray, attenuation: FloatArray) -> FloatArray:
    """Return the window energies in the readable form, (n_bands, n_windows)."""
    row = surviving_energy(rows.hits, a) * rows.weight_per_m2[:, None]
    row = row * np.exp(-rows.length_m[:, None] * attenuation)
    window = window_of_rows(rows)
    return np.array([np.bincount(window, column, rows.n_windows) for column in row.T])


def slopes(rows: EnergyRows, a: FloatArray, air: FloatArray) -> FloatArray:
    """Return the derivative of the energies of one band, (n_materials, n_windows)."""
    return weigh_parts(rows, None, a[:, 0], float(air[0]), derivative=True).by_absorption.T


@given(SEED, st.integers(1, 9), st.integers(1, 4))
def test_the_kernel_equals_the_readable_form(seed: int, n_materials: int, n_bands: int) -> None:
    """Powers from a table, pieces and blocks change nothing beyond rounding."""
    rows = random_rows(seed, n_materials=n_materials)
    a, attenuation = table(seed, n_materials, n_bands), np.linspace(0.0, 0.02, n_bands)
    # positive terms only: 300 sums and 11 products, each rounded once, 311 * 2**-53 = 3.5e-14
    np.testing.assert_allclose(
        weigh(rows, a, attenuation), in_numpy(rows, a, attenuation), rtol=1e-13, atol=0.0
    )


@given(SEED, st.lists(COEFFICIENT, min_size=3, max_size=3))
def test_the_derivative_equals_finite_differences(seed: int, alphas: list[float]) -> None:
    """Central inside, one-sided and of second order at a = 0 and a = 1."""
    rows = random_rows(seed)
    a, air = np.array(alphas)[:, None], np.array([0.003])
    derivative = slopes(rows, a, air)
    assert np.all(np.isfinite(derivative))
    h = 1e-5
    largest = np.max(np.abs(weigh(rows, np.zeros((3, 1)), air))) + 1.0
    for m in range(3):
        centre = min(max(a[m, 0], 2 * h), 1.0 - 2 * h)
        steps = centre + h * np.array([-2.0, -1.0, 1.0, 2.0]) - a[m, 0]
        energies = [weigh(rows, _moved(a, m, s), air)[0] for s in steps]
        # slope at 0 of the cubic through four points
        slope = np.linalg.solve(np.vander(steps / h, increasing=True), np.array(energies))[1] / h
        # third-order error below E'''' h**3 < 1e-9 E, rounding 2**-53 E / h = 1e-11 E
        np.testing.assert_allclose(derivative[m], slope, rtol=0.0, atol=1e-8 * largest)


def test_a_black_wall_has_the_slope_of_the_paths_that_touch_it_once() -> None:
    """At a = 1: 0 for no hit, minus the rest of the product for one, 0 for more; never nan."""
    rows = EnergyRows(
        ("black", "other"),
        1,
        np.array([0, 3]),
        np.array([1.0, 2.0, 4.0]),
        np.array([[0, 1], [1, 2], [2, 0]], dtype=np.uint16),
        np.zeros(3),
        np.full(3, -1, dtype=np.int32),
    )
    a = np.array([[1.0], [0.5]])
    assert weigh(rows, a, np.zeros(1)).tolist() == [[0.5]]
    assert slopes(rows, a, np.zeros(1))[:, 0].tolist() == [-2.0 * 0.5**2, -1.0]


def test_one_thread_and_two_give_the_same_bits() -> None:
    """And so does leaving the derivative out."""
    rows = random_rows(6, n_rows=150_000)
    a, air = table(6, 3, 2), np.array([0.0, 0.01])
    before = numba.get_num_threads()
    results = []
    try:
        for n in (1, min(2, numba.config.NUMBA_NUM_THREADS)):
            numba.set_num_threads(n)
            results.append((weigh(rows, a, air), slopes(rows, a[:, 1:], air[1:])))
    finally:
        numba.set_num_threads(before)
    for first, second in zip(*results, strict=True):
        np.testing.assert_array_equal(first, second)
    parts = weigh_parts(rows, None, a[:, 1], 0.01, derivative=True)
    np.testing.assert_array_equal(parts.energy, weigh(rows, a, air)[1])


def test_air_takes_exp_of_minus_m_d() -> None:
    """A single path of 10 m in air of 0.1 per metre keeps 1/e."""
    hits, batch = np.zeros((1, 1), dtype=np.uint16), np.array([-1], dtype=np.int32)
    rows = EnergyRows(("wall",), 1, np.array([0, 1]), np.ones(1), hits, np.array([10.0]), batch)
    energy = weigh(rows, np.zeros((1, 1)), np.array([0.1]))
    np.testing.assert_allclose(energy, np.exp(-1.0), rtol=1e-15)


@given(SEED)
def test_merged_rows_keep_energies_and_slopes(seed: int) -> None:
    """Without air, rows of equal window and hits are worth their sum."""
    rows = random_rows(seed, mean_hits=0.7)
    merged = merge_equal_rows(rows)
    a = table(seed, 3, 2)
    for found in (weigh, slopes):
        one, other = (found(r, a, np.zeros(2)) for r in (rows, merged))
        np.testing.assert_allclose(other, one, rtol=1e-12, atol=1e-300)
    keys = np.column_stack([window_of_rows(merged), merged.hits])
    assert len(np.unique(keys, axis=0)) == len(merged)


def test_merging_in_air_errs_by_the_stated_bound() -> None:
    """Lengths within one window of 1 m, m = 0.02: below (0.02 * 1)**2 / 8 = 5e-5, and too low."""
    rng = np.random.default_rng(8)
    n = 2000
    rows = EnergyRows(
        ("wall",),
        1,
        np.array([0, n]),
        rng.random(n),
        rng.integers(0, 3, (n, 1)).astype(np.uint16),
        10.0 + rng.random(n),
        np.zeros(n, dtype=np.int32),
        1,
    )
    a, air = np.array([[0.3]]), np.array([0.02])
    exact = weigh(rows, a, air)[0, 0]
    merged = merge_equal_rows(rows)
    assert len(merged) == 3
    error = 1.0 - weigh(merged, a, air)[0, 0] / exact
    assert 0.0 < error < 5e-5 * 1.02  # the next order adds a fraction of m D


def test_batches_and_images_make_up_the_whole() -> None:
    """Image paths are exact and belong to no batch."""
    rows = random_rows(9)
    a, air = table(9, 3, 2), np.array([0.0, 0.01])
    batches = batch_energies(rows, a, air)
    image = rows.batch < 0
    offsets = np.concatenate(([0], np.cumsum(image)))[rows.offsets]
    each = (rows.weight_per_m2, rows.hits, rows.length_m, rows.batch)
    images = EnergyRows(rows.materials, rows.n_windows, offsets, *(x[image] for x in each))
    total = batches.sum(axis=0) + weigh(images, a, air)
    assert batches.shape == (8, 2, 5)
    np.testing.assert_allclose(total, weigh(rows, a, air), rtol=1e-12)


def test_bad_coefficients_are_refused() -> None:
    """Out of range, not a number, or of the wrong shape."""
    rows = random_rows(11)
    for bad in (1.01, -0.01, np.nan):
        with pytest.raises(InputError, match="absorption coefficient is out of range"):
            weigh(rows, np.array([[0.1], [bad], [0.1]]), np.zeros(1))
    with pytest.raises(InputError, match="absorption coefficient has the wrong shape"):
        weigh(rows, np.zeros((2, 1)), np.zeros(1))
    with pytest.raises(InputError, match="air attenuation is out of range"):
        weigh(rows, np.zeros((3, 1)), np.array([-1.0]))


def _moved(a: FloatArray, m: int, step: float) -> FloatArray:
    moved = a.copy()
    moved[m, 0] = min(max(moved[m, 0] + step, 0.0), 1.0)
    return moved


def drawn_pattern(seed: int, n_rows: int, *, single: bool) -> RowPattern:
    """Return a strong directivity and directions, in single precision as traced or in double."""
    rng = np.random.default_rng(seed)
    basis = rng.standard_normal((n_rows, 3))
    basis /= np.linalg.norm(basis, axis=1)[:, None]
    return RowPattern(rng.normal(0.0, 0.7, 3), basis.astype(np.float32) if single else basis)


def weigh_directed(
    rows: EnergyRows, pattern: RowPattern, a: FloatArray, air: float, *, derivative: bool = True
) -> FloatArray:
    """Return energy and slopes of one pass as columns."""
    found = weigh_parts(rows, pattern, a, air, derivative=derivative)
    return np.column_stack((found.energy, found.columns[:, 2 + len(found.batches) :]))


def directed_in_steps(
    rows: EnergyRows, pattern: RowPattern, a: FloatArray, air: float
) -> FloatArray:
    """Return the same columns by rows weighed once for the energy and once for each part of b."""
    amplitude, slope = amplitude_and_slope(pattern.b, pattern.basis.astype(np.float64))
    whole, one = directed_rows(rows, amplitude**2), (a[:, None], np.array([air]))
    by_b = [weigh(directed_rows(rows, 2.0 * amplitude * s), *one)[0] for s in slope.T]
    return np.column_stack([weigh(whole, *one)[0], *slopes(whole, *one), *by_b])


@given(SEED, st.integers(1, 7), st.booleans(), st.sampled_from([0.0, 0.01]))
def test_a_directed_source_in_one_pass_equals_row_by_row(
    seed: int, n_materials: int, single: bool, air: float
) -> None:
    """Energy and slopes, black walls among them."""
    rows, a = random_rows(seed, n_materials=n_materials), table(seed, n_materials, 1)[:, 0]
    pattern = drawn_pattern(seed, len(rows), single=single)
    found = weigh_directed(rows, pattern, a, air)
    expected = directed_in_steps(rows, pattern, a, air)
    # slopes by b have terms of both signs: 300 of them, each rounded, of at most the largest
    largest = np.abs(expected).max(axis=0) + np.abs(expected[:, :1]).max()
    assert np.all(np.abs(found - expected) <= 1e-12 * largest)
    alone = weigh_directed(rows, pattern, a, air, derivative=False)
    np.testing.assert_array_equal(alone[:, 0], found[:, 0])


@given(SEED)
def test_slopes_of_a_directed_source_are_those_of_finite_differences(seed: int) -> None:
    """By b: central differences of a smooth function, third derivatives of order one."""
    rows, a = random_rows(seed), np.random.default_rng(seed).uniform(0.05, 0.9, 3)
    pattern = drawn_pattern(seed, len(rows), single=False)
    found = weigh_directed(rows, pattern, a, 0.003)
    h = 1e-5
    for k, step in enumerate(h * np.eye(3)):
        high, low = (
            weigh_directed(rows, RowPattern(pattern.b + s * step, pattern.basis), a, 0.003)[:, 0]
            for s in (1.0, -1.0)
        )
        more, less = (weigh_directed(rows, pattern, a + s * step, 0.003)[:, 0] for s in (1.0, -1.0))
        largest = np.abs(found).max()
        np.testing.assert_allclose(found[:, 4 + k], (high - low) / (2 * h), atol=1e-7 * largest)
        np.testing.assert_allclose(found[:, 1 + k], (more - less) / (2 * h), atol=1e-7 * largest)


@given(SEED, st.booleans(), st.booleans())
def test_parts_of_the_variance_in_one_pass_equal_three(seed: int, single: bool, bare: bool) -> None:
    """Energies, squares of single images and batches, each by rows weighed for it alone."""
    rows, a = random_rows(seed), table(seed, 3, 1)[:, 0]
    pattern = None if bare else drawn_pattern(seed, len(rows), single=single)
    found = weigh_parts(rows, pattern, a, 0.01)
    factor = np.ones(len(rows)) if pattern is None else pattern.factor()
    walls, air = a[:, None], np.array([0.01])
    turned = directed_rows(rows, factor.astype(np.float64))
    squared = squared_image_rows(turned)
    expected = (
        weigh(turned, walls, air)[0],
        weigh(squared, walls, air)[0],
        batch_energies(turned, walls, air)[:, 0],
    )
    # the pattern of single precision is turned into a factor in single precision there
    near = 1e-12 if pattern is None or not single else 1e-5
    for own, other in zip((found.energy, found.squares, found.batches), expected, strict=True):
        np.testing.assert_allclose(own, other, rtol=near, atol=1e-12 * other.max())
    whole = weigh_parts(rows, pattern, a, 0.01, derivative=True)
    for own, other in zip(whole[:3], found[:3], strict=True):
        np.testing.assert_array_equal(own, other)
    expected_slopes = slopes(turned, walls, air)
    largest = 1e-12 * np.abs(expected_slopes).max()
    np.testing.assert_allclose(whole.by_absorption.T, expected_slopes, rtol=near, atol=largest)
