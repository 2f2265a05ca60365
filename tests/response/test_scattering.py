"""Rows weighed for another scattering in each band, and the slope of their energies by it."""

from __future__ import annotations

import numpy as np
import pytest

from images_reference import SPEED_M_S, box_room, scene_of
from rays_reference import with_scattering
from roomfit.errors import InputError
from roomfit.materials.priors import Scattering, uniform_scattering
from roomfit.response.energy import EnergyRows, energy_rows, merge_equal_rows, regrouped_rows, weigh
from roomfit.response.scattering import (
    LEAST_EFFECTIVE_FRACTION,
    effective_sample_fraction,
    rows_for_band,
)
from roomfit.tracing.paths import Paths, TraceSettings
from roomfit.tracing.trace import trace
from roomfit.typing import FloatArray

EDGES_S = np.linspace(0.0, 0.06, 13)
NO_AIR = np.zeros(1)


@pytest.fixture(scope="module", params=["spheres", "rain"])
def paths(request: pytest.FixtureRequest) -> Paths:
    """Two pairs in a box, images to order 2 and rays, traced with s = 0.3."""
    scene = scene_of(box_room(), [[1.2, 1.5, 1.1]], [[4.1, 2.9, 1.2], [2.3, 3.7, 1.4]])
    settings = TraceSettings(0.06, 2**13, 2, 0.4, estimator=request.param)
    return trace(scene, settings, uniform_scattering(scene.room.materials, 0.3)).paths


def rows_of(paths: Paths) -> list[EnergyRows]:
    """Sort both pairs into windows."""
    return [energy_rows(paths, pair, EDGES_S, SPEED_M_S) for pair in range(2)]


def of(paths: Paths, s: FloatArray) -> Scattering:
    """Name the materials."""
    return Scattering(paths.materials, s)


def test_rows_weighed_anew_are_the_rows_of_paths_weighed_anew(paths):
    """Grouped into coarser windows as well."""
    wanted = of(paths, np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.0]))
    band, _ = rows_for_band(rows_of(paths), paths, wanted)
    coarse, _ = rows_for_band(
        [regrouped_rows(r, np.arange(0, r.n_windows, 3)) for r in rows_of(paths)], paths, wanted
    )
    for pair, rows in enumerate(band):
        other = energy_rows(with_scattering(paths, wanted), pair, EDGES_S, SPEED_M_S)
        np.testing.assert_array_equal(rows.weight_per_m2, other.weight_per_m2)
        np.testing.assert_array_equal(coarse[pair].weight_per_m2, other.weight_per_m2)
        assert rows.hits is not None


def test_more_scattering_takes_from_the_images_what_it_gives_to_the_rays(paths):
    """All walls alike and no absorption: images lose, and the expected sum stays in the late part.

    The steady rate c / V of a room without absorption holds for any s, so that the slope of the
    late energy is small against the energy: allowed is 0.5 of it per unit of s, from 8192 rays.
    """
    none = np.zeros((6, 1))

    def energies(s: float) -> list[FloatArray]:
        rows = rows_for_band(rows_of(paths), paths, of(paths, np.full(6, s)))[0]
        return [weigh(r, none, NO_AIR, derivative=False).energy for r in rows]

    for low, energy, high in zip(energies(0.299), energies(0.3), energies(0.301), strict=True):
        slope = (high - low) / 0.002
        late = slice(4, None)
        assert abs(slope[0, late].sum()) < 0.5 * energy[0, late].sum()


def test_the_sample_share_falls_as_the_wanted_scattering_leaves_the_traced_one(paths):
    """One where nothing changes, below the limit where the trace has to be made again."""
    shares = [
        rows_for_band(rows_of(paths), paths, of(paths, np.full(6, s)))[1]
        for s in (0.3, 0.35, 0.5, 0.8)
    ]
    assert shares[0] == 1.0
    assert np.all(np.diff(shares) <= 0.0)
    assert shares[2] < shares[1]
    assert shares[1] > 0.5
    assert shares[-1] < LEAST_EFFECTIVE_FRACTION


def test_the_sample_share_is_kishs_number_of_weights(paths):
    """Half of the rays without weight: half of the sample."""
    rows = rows_of(paths)[0]
    even = np.where(rows.batch >= 0, 1.0, 5.0)
    before = EnergyRows(*_columns(rows, even))
    ray = np.cumsum(rows.batch >= 0)
    after = EnergyRows(*_columns(rows, even * (ray % 2)))
    assert effective_sample_fraction(before, after) == pytest.approx(0.5, abs=0.01)


def _columns(rows: EnergyRows, weight: FloatArray) -> tuple[object, ...]:
    return (
        *(rows.materials, rows.n_windows, rows.offsets, weight),
        *(rows.hits, rows.length_m, rows.batch, rows.n_batches),
    )


def test_merged_rows_are_refused(paths):
    """They are no paths."""
    merged = [merge_equal_rows(r) for r in rows_of(paths)]
    with pytest.raises(InputError, match="no single paths"):
        rows_for_band(merged, paths, of(paths, np.full(6, 0.2)))
