"""The nouns of `roomfit.core`: a room traced once, and an objective of a kind of data of one's own."""  # noqa: E501

from __future__ import annotations

import numpy as np
import pytest

from roomfit.base.air import attenuation_per_m
from roomfit.base.bands import Bands, bands_between
from roomfit.base.errors import InputError
from roomfit.fit.traced_room import trace_room
from roomfit.materials.priors import complete_priors
from roomfit.model.observation import absorption_block
from roomfit.model.parameters import Parameters
from roomfit.model.problem import DataTerm, Objective
from roomfit.room.scene import distances_m, scene_of, shoebox_room
from roomfit.settings import Settings
from roomfit.solver import fit_band
from roomfit.uncertainty.posterior import AbsorptionPosterior

NAMES = ("T20_s", "C80_dB", "G_dB")
BANDS = bands_between("octave", 500, 1000)


@pytest.fixture(scope="module")
def room():
    lengths, receivers = (5.0, 4.0, 3.0), {"R": (3.5, 2.8, 1.2), "Q": (4.1, 1.0, 1.5)}
    materials = {"floor": "carpet", "ceiling": "plaster", "walls": "plaster"}
    scene = scene_of(shoebox_room(lengths, materials), {"S": (1.2, 1.0, 1.5)}, receivers)
    a = np.array([[{"carpet": 0.4, "plaster": 0.2}[m]] * 2 for m in scene.room.materials])
    n = len(a)
    known = AbsorptionPosterior(
        scene.room.materials, BANDS, a, 0.9 * a, 1.1 * a, np.stack([0.01 * np.eye(n)] * 2),
        scattering=np.full((n, 2), 0.3),
    )  # fmt: skip
    return trace_room(scene, known, settings=Settings(n_rays=4000, seed=1)), a


def test_derivatives_of_room_parameters_are_those_of_their_differences(room):
    """Central differences over .002 in absorption; levels bend at every bin, where T20 has kinks."""  # noqa: E501
    traced, a = room
    values, slopes = traced.predict(a, NAMES)
    assert slopes.shape == (*values.shape, len(a))
    for material in range(len(a)):
        step = np.zeros_like(a)
        step[material] = 1e-3
        high, low = (traced.predict(a + sign * step, NAMES)[0] for sign in (1.0, -1.0))
        expected = (high - low) / 2e-3
        scale = np.abs(slopes).max(axis=(0, 2, 3))[:, None]
        assert np.all(np.abs(slopes[..., material] - expected) < [[0.01], [1e-4], [1e-4]] * scale)


def test_the_first_energy_of_a_pair_is_that_of_its_direct_sound(room):
    """``exp(-m r) / (4 pi r^2)``; the next sound comes a wall later."""
    traced, a = room
    energies = traced.energies(a)
    air = attenuation_per_m(traced.scene.air, BANDS)
    for pair, r in enumerate(distances_m(traced.scene)):
        first = energies[pair][:, np.argmax(energies[pair].any(axis=0))]
        np.testing.assert_allclose(first, np.exp(-air * r) / (4.0 * np.pi * r**2), rtol=1e-9)


def test_values_of_a_pair_alone_are_those_among_others(room):
    traced, a = room
    for pair in range(2):
        alone, _ = traced.of_pair(pair).predict(a, NAMES)
        np.testing.assert_array_equal(alone[0], traced.predict(a, NAMES)[0][pair])


def test_a_room_parameter_without_a_name_is_refused(room):
    traced, a = room
    with pytest.raises(InputError, match="no name of a room parameter"):
        traced.predict(a, ())


class AbsorptionArea(DataTerm):
    """One measured absorption area, in m2."""

    is_gamma = False

    def __init__(self, measured_m2: float, sd_m2: float, areas_m2: np.ndarray) -> None:
        self.measured_m2, self.sd_m2, self.areas_m2 = measured_m2, sd_m2, areas_m2

    def measured(self):
        return np.array([self.measured_m2])

    def predict(self, values):
        area = self.expected(values)
        return area, area, {"absorption": self.areas_m2[None]}

    def expected(self, values):
        return np.array([self.areas_m2 @ values["absorption"]])

    def variance_parts(self, values):  # noqa: ARG002
        return {"stated": np.array([self.sd_m2**2])}

    def correlation_length(self, start):  # noqa: ARG002
        return np.ones(1)


@pytest.fixture
def objective():
    priors = complete_priors(("walls", "carpet"), (), Bands("octave", np.array([1000.0])))
    areas = np.array([60.0, 30.0])
    term = AbsorptionArea(24.0, 0.1, areas)
    return Objective(Parameters((absorption_block(priors, 0, 0.2),)), (term,)), areas


def test_a_kind_of_data_of_ones_own_is_fitted(objective):
    """An area known to .1 m2 outweighs priors of the logit: 24 m2 within its standard deviation."""
    own, areas = objective
    fit = fit_band(own)
    assert fit.converged
    assert areas @ (1.0 / (1.0 + np.exp(-fit.vector))) == pytest.approx(24.0, abs=0.1)


def test_an_objective_says_by_how_much_it_misses_and_how_likely_that_is(objective):
    """By hand: a normal law of .1 m2; the derivative of absorption by its logit is a (1 - a)."""
    own, areas = objective
    vector = np.array([-1.0, 0.5])
    a = 1.0 / (1.0 + np.exp(-vector))
    missed = (24.0 - areas @ a) / 0.1
    np.testing.assert_allclose(own.residual(vector), [missed])
    density = -0.5 * missed**2 - np.log(0.1 * np.sqrt(2.0 * np.pi))
    assert own.logl(vector) == pytest.approx(density, rel=1e-12)
    by = areas * a * (1.0 - a)
    np.testing.assert_allclose(own.jacobian(vector), by[None], rtol=1e-12)
    np.testing.assert_allclose(own.information(a), np.outer(by, by) / 0.01, rtol=1e-7)
