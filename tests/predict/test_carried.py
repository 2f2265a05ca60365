"""How alike reflections interfere before and after a wall is exchanged."""

from __future__ import annotations

import numpy as np
import pytest

from roomfit.base.bands import Bands
from roomfit.model.reduced_rows import ReducedRows
from roomfit.model.weighing import EnergyRows
from roomfit.signals.iso3382 import VALUE_NAMES

OCTAVE = Bands("octave", np.array([1000.0]))
N_BINS, N_EACH = 40, 20
NAMES = ("T20_s", "EDT_s", "C50_dB", "C80_dB", "G_dB")
SECOND, NONE = np.array([False, True]), np.array([False, False])  # which walls are exchanged


@pytest.fixture(scope="module")
def few():
    """Return 800 weak paths in bins of 10 ms, of which more meet the second wall the later."""
    rng = np.random.default_rng(5)
    at = np.repeat(np.arange(N_BINS), N_EACH)
    hits = np.stack([rng.poisson(0.8 * at), rng.poisson(0.1 * at)], axis=1)
    rows = EnergyRows(
        ("rest", "wall"),
        N_BINS,
        np.arange(0, at.size + 1, N_EACH),
        rng.uniform(0.5, 1.5, at.size),
        hits.astype(np.uint16),
        np.zeros(at.size),
        np.zeros(at.size, dtype=np.int32),
        1,
    )
    return ReducedRows(OCTAVE, 0.01 * np.arange(N_BINS + 1), 0.0, (rows,))


def simulated(few: ReducedRows, states: np.ndarray, *, n_rooms: int, n_parts: int) -> np.ndarray:
    """Return the correlations of values of random phases, of paths that meet the wall anew.

    Every bin has so many independent parts as a wide band has in it, each the squared sum of the
    pressures of all its paths.
    """
    rng, (rows,) = np.random.default_rng(8), few.by_band
    roots = [
        np.sqrt(rows.weight_per_m2 * np.prod((1.0 - a[:, 0]) ** rows.hits, axis=1)) for a in states
    ]
    meets = (rows.hits[:, 1] > 0) & (states[0][1, 0] != states[1][1, 0])
    energies = np.empty((2, n_rooms, 1, N_BINS))
    for room in range(n_rooms):
        z = rng.normal(size=(2, 2, n_parts, meets.size))
        z[1] = np.where(meets, z[1], z[0])
        for state, root in enumerate(roots):
            pressure = (root * z[state]).reshape(2, n_parts, N_BINS, N_EACH).sum(axis=3)
            energies[state, room, 0] = np.mean(pressure**2, axis=(0, 1))
    values = [few.values(e)[:, :, 0] for e in energies]
    return np.array(
        [np.corrcoef(values[0][:, k], values[1][:, k])[0, 1] for k in range(len(VALUE_NAMES))]
    )


@pytest.mark.slow
@pytest.mark.parametrize("after", [0.05, 0.5])
def test_values_scatter_together_as_those_of_random_pressures_do(few, after):
    """Within .08: 1,200 rooms know no correlation to .03, and one of .5 to .022."""
    before, changed = np.array([[0.2], [0.15]]), np.array([[0.2], [after]])
    found = few.scatter_correlation(before, changed, SECOND)[:, 0]
    drawn = simulated(few, np.stack([before, changed]), n_rooms=1200, n_parts=60)
    at = [VALUE_NAMES.index(name) for name in NAMES]
    np.testing.assert_allclose(found[at], drawn[at], atol=0.08)
    # late energy meets the wall more often than early one
    t20, level = (found[VALUE_NAMES.index(n)] for n in ("T20_s", "G_dB"))
    assert 0.01 < t20 < level < 0.98


def test_what_does_not_change_scatters_as_it_did(few):
    same = np.array([[0.2], [0.15]])
    np.testing.assert_allclose(few.scatter_correlation(same, same, NONE), 1.0)


def test_a_single_path_interferes_with_nothing(few):
    """Under a direct sound that outweighs all C50 scatters with the late energy, by hand."""
    (rows,) = few.by_band
    weight, batch = rows.weight_per_m2.copy(), rows.batch.copy()
    hits = rows.hits.copy()
    weight[0], batch[0], hits[0] = 1e3 * weight[:N_EACH].sum(), -1, 0
    weight[1:N_EACH] = 1e-12
    direct = EnergyRows(rows.materials, N_BINS, rows.offsets, weight, hits, rows.length_m, batch, 1)
    before, after = np.array([[0.2], [0.15]]), np.array([[0.2], [0.5]])
    alone = ReducedRows(OCTAVE, few.edges_s, 0.0, (direct,))
    found = alone.scatter_correlation(before, after, SECOND)[VALUE_NAMES.index("C50_dB"), 0]
    avoiding = np.array([[0.2], [1.0]])
    late = alone.energies(np.stack([before, after, avoiding]))[:, 0, 5:] ** 2
    expected = late[2].sum() / np.sqrt(late[0].sum() * late[1].sum())
    assert found == pytest.approx(expected, rel=0.1)


def test_an_exchanged_wall_reflects_anew_whatever_it_absorbs(few):
    """As alike as if it took all of what meets it, by hand; a wall that stays is as it was."""
    before = np.array([[0.2], [0.15]])
    at = VALUE_NAMES.index("G_dB")
    turned = few.scatter_correlation(before, before, SECOND)[at, 0]
    away = few.energies(np.stack([before, np.array([[0.2], [1.0]])]))[:, 0] ** 2
    assert turned == pytest.approx(away[1].sum() / away[0].sum(), rel=1e-6)
    nearly = few.scatter_correlation(before, before + np.array([[0.0], [1e-6]]), SECOND)[at, 0]
    assert nearly == pytest.approx(turned, rel=1e-4)
    never = few.scatter_correlation(before, np.array([[0.2], [1.0 - 1e-9]]), SECOND)
    assert np.all(np.isfinite(never))
