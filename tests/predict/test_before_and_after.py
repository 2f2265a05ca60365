"""Before and after: side by side, and never the changed room against the old measurement."""

from __future__ import annotations

import numpy as np
import pytest

import roomfit
from roomfit.base.bands import bands_between
from roomfit.base.logit import logit
from roomfit.predict.changes import Change
from roomfit.predict.predict import predict
from roomfit.predict.question import Question
from roomfit.signals.decay import in_jnd
from roomfit.signals.iso3382 import MeasuredValues
from roomfit.uncertainty.posterior import AbsorptionPosterior

BANDS = bands_between("octave", 125, 8000)
FEW = roomfit.Settings(n_rays=2000, n_draws=8)
SIDES = ("west", "east", "south", "north", "ceiling")
MEASURED = MeasuredValues("S", "R", BANDS.centres_hz, {"T20_s": [0.8] * 7, "C80_dB": [4.0] * 7})


def foreseen(changes, known_walls: bool = True):
    room = roomfit.shoebox_room((6.0, 5.0, 3.0), dict.fromkeys(SIDES, "walls") | {"floor": "floor"})
    scene = roomfit.scene_of(room, {"S": (1.5, 1.2, 1.5)}, {"R": (4.0, 3.5, 1.2)})
    a, sd = np.full((2, 7), 0.15), np.array([0.1, 0.1 if known_walls else 0.0])[:, None]
    low, high = (1.0 / (1.0 + np.exp(-(logit(a) + s * 1.96 * sd))) for s in (-1, 1))
    if not known_walls:
        # as of a material that the result does not name
        low[1], high[1] = 0.0, 1.0
    covariance = np.tile(np.diag(sd[:, 0] ** 2), (7, 1, 1))
    known = AbsorptionPosterior(
        room.materials, BANDS, a, low, high, covariance, scattering=np.full(a.shape, 0.4)
    )
    return predict(Question(scene, known, changes, [MEASURED], settings=FEW))


CHANGE = Change("floor", "value", (0.5,) * 7, (0.05,) * 7)


@pytest.fixture(scope="module")
def compared():
    return foreseen([CHANGE])


def test_what_was_measured_is_judged_by_the_model_of_the_room_as_it_was(compared):
    for table in (compared.mean, compared.pairs[0].parameters):
        v = table["T20_s"]
        np.testing.assert_allclose(v.jnd, in_jnd("T20_s", v.measured, v.change.before))
        assert np.all(np.abs(v.jnd - in_jnd("T20_s", v.measured, v.predicted)) > 1.0)


def test_where_the_room_before_is_not_known_nothing_stands_against_the_measurement():
    found = foreseen([CHANGE], known_walls=False)
    assert not found.compares_states
    for v in (found.mean["T20_s"], found.pairs[0].parameters["C80_dB"]):
        assert np.isnan(v.jnd).all()
        assert np.isfinite(v.measured).all()
