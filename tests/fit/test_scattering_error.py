"""How scattering that is not exactly known enters the intervals; and how far decays are fitted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import roomfit
from roomfit.base.air import attenuation_per_m
from roomfit.base.bands import bands_between
from roomfit.fit.measurements import collect_measurements
from roomfit.fit.systematics import scattering_error
from roomfit.materials.priors import Scattering, unknown_material
from roomfit.model.binned import BinnedPaths, bin_paths, in_band
from roomfit.model.observation import energy_terms
from roomfit.model.scattering import scattering_weights
from roomfit.model.weighing import first_rows, reweighed_rows, weigh
from roomfit.room.scene import scene_of, shoebox_room
from roomfit.tracing.paths import TraceSettings
from roomfit.tracing.trace import trace
from small_campaign import LENGTHS_M, RATE_HZ, RECEIVERS_M, SOURCE_M, small_responses

BANDS = bands_between("octave", 1000, 1000)
NAMES = ("walls", "floor", "ceiling")
SAMPLED = np.array([0.2, 0.1, 0.3])


def measured(decay_range_db: float = 50.0):
    room = shoebox_room(LENGTHS_M, dict(zip(NAMES, NAMES, strict=True)))
    scene = scene_of(room, {"LS1": SOURCE_M}, RECEIVERS_M)
    responses = [roomfit.Measurement("LS1", n, p, RATE_HZ) for n, p in small_responses().items()]
    return collect_measurements(scene, responses, BANDS, {}, decay_range_db)


def test_the_error_is_the_change_of_the_energies_with_the_coefficient():
    """Finite differences, over paths that are weighed for coefficients on either side."""
    found = measured()
    scattering = Scattering(found.scene.room.materials, SAMPLED)
    settings = TraceSettings(duration_s=0.3, n_rays=5000, image_order=2)
    paths = trace(found.scene, settings, scattering).paths
    binned = bin_paths(found.scene, BANDS, paths, settings.duration_s)
    priors = tuple(unknown_material(n, 1) for n in NAMES)
    ((term, _),) = energy_terms(
        found.scene, BANDS, priors, found.responses, binned, np.array([0.2])
    )
    absorption, air = np.array([0.15, 0.4, 0.3]), attenuation_per_m(found.scene.air, BANDS)
    # the ceiling's coefficient was specified
    sd = np.array([0.05, 0.03, 0.0])
    error = scattering_error(paths, term, absorption, (SAMPLED, sd))

    def energies(step: float) -> np.ndarray:
        wanted = Scattering(found.scene.room.materials, SAMPLED + step * sd)
        factors = scattering_weights(paths, wanted)
        rows = tuple(reweighed_rows(r, factors) for r in binned.rows)
        coarse = in_band(BinnedPaths(binned.edges_s, rows), term.centre_hz)
        return np.concatenate(
            [
                o.spreading
                @ weigh(
                    first_rows(coarse.rows[o.pair], o.spreading.shape[1]), absorption[:, None], air
                )[0]
                for o in term.observations
            ]
        )

    step = 1e-3
    slope = (energies(step) - energies(-step)) / (2.0 * step) / energies(0.0)
    assert np.abs(slope).max() > 0.01
    np.testing.assert_allclose(error, slope, rtol=1e-4, atol=1e-6)


def test_unspecified_scattering_widens_intervals_and_does_not_move_the_answer():
    found = measured()
    responses = [m.measurement for m in found.responses]
    settings = roomfit.Settings(model="energy", n_rays=5000, n_random_starts=0)
    unspecified = roomfit.identify(found.scene, responses, (), BANDS, settings=settings)
    s = unspecified.scattering
    if not np.any(s > 0.0):  # the simulated walls are smooth, and may be found so
        pytest.skip("no scattering was found")
    priors = [replace(unknown_material(n, 1), scattering=s[i]) for i, n in enumerate(NAMES)]
    specified = roomfit.identify(found.scene, responses, priors, BANDS, settings=settings)
    np.testing.assert_allclose(unspecified.absorption, specified.absorption, atol=1e-9)
    widths = [r.upper95 - r.lower95 for r in (unspecified, specified)]
    assert np.all(widths[0] >= widths[1] - 1e-9)


def test_windows_end_where_the_decay_has_fallen_so_far():
    """Or at the noise, where that comes first; the levels are those of the decay curve."""
    deep, shallow = measured(200.0), measured(20.0)
    for one, other in zip(deep.responses, shallow.responses, strict=True):
        assert other.fit_end_s[0] < one.fit_end_s[0]
        level = np.interp(other.fit_end_s[0], other.curve.time_s, other.curve.energy_left[0])
        # within a sample of the curve
        assert 10.0 * np.log10(level / other.curve.energy_left[0, 0]) == pytest.approx(
            -20.0, abs=0.3
        )
        # 4 dB above the noise
        clear_s = one.noise.usable_end_s - np.log(2.5) * one.noise.tail_time_constant_s
        np.testing.assert_array_equal(one.fit_end_s, clear_s)
