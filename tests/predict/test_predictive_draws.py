"""What predictions promise, by the covariance and by draws of the real model.

Rooms are simulated with other rays than the fit's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

import roomfit
from roomfit.base.logit import expit
from roomfit.files.results import read_result, write_result
from roomfit.predict.changes import Change
from roomfit.uncertainty.posterior import AbsorptionPosterior, draw_absorption

BANDS = roomfit.bands_between("octave", 1000, 1000)
FEW = roomfit.Settings(n_rays=3000, n_rays_beside_images=3000)
NAMES = ("T20_s", "EDT_s", "C80_dB", "D50_percent")
WALLS = ("west", "east", "south", "north", "floor", "ceiling")
SCATTERING = 0.4


@dataclass(frozen=True)
class Case:
    """A room of unknown walls, values of which were measured with errors, and its answer."""

    scene: roomfit.Scene
    true: np.ndarray
    measured: tuple[roomfit.MeasuredValues, ...]
    result: roomfit.Result


def known(scene: roomfit.Scene, absorption: np.ndarray) -> AbsorptionPosterior:
    n = len(absorption)
    a = absorption[:, None]
    scattering = np.full((n, 1), SCATTERING)
    names = scene.room.materials
    return AbsorptionPosterior(names, BANDS, a, a, a, np.zeros((1, n, n)), scattering=scattering)


def simulated(scene: roomfit.Scene, absorption: np.ndarray, rng) -> tuple:
    """Return values by other rays than the fit's, each with an error as large as it scatters."""
    other = replace(FEW, seed=99, n_draws=2)
    found = []
    for pair in roomfit.predict(
        roomfit.Question(scene, known(scene, absorption), settings=other)
    ).pairs:
        table = {
            name: v.predicted + v.sd_rest * rng.standard_normal(1)
            for name, v in pair.parameters.items()
            if name in NAMES
        }
        own = BANDS.centres_hz
        found.append(roomfit.MeasuredValues(pair.source, pair.receiver, own, table))
    return tuple(found)


def make_case(seed: int) -> Case:
    rng = np.random.default_rng(seed)
    lengths = tuple(float(x) for x in rng.uniform((4.0, 3.5, 2.4), (7.0, 5.5, 3.2)))
    room = roomfit.shoebox_room(lengths, dict(zip(WALLS, "abcdef", strict=True)))
    places = {f"R{i}": tuple(rng.uniform(0.8, np.array(lengths) - 0.8)) for i in range(3)}
    scene = roomfit.scene_of(room, {"S": (1.0, 1.0, 1.2)}, places)
    true = expit(rng.uniform(-3.0, 0.5, 6))
    measured = simulated(scene, true, rng)
    priors = [roomfit.material_prior(n, BANDS, scattering=SCATTERING) for n in room.materials]
    result = roomfit.identify(scene, measured, priors, BANDS, settings=FEW)
    return Case(scene, true, measured, result)


@pytest.fixture(scope="module")
def cases() -> list[Case]:
    return [make_case(seed) for seed in (1, 2, 3)]


def parameters(predicted: roomfit.Predicted):
    return [v for pair in predicted.pairs for n, v in pair.parameters.items() if n in NAMES]


@pytest.mark.slow
def test_estimates_lie_inside_their_intervals_and_fitted_values_about_the_middle(cases):
    """Of 36 values of three rooms, those of a pair alike: some 12 independent ones.

    95 % intervals miss 3 or more of 12 at 2 of 100; 10 or more of 12 on one side of the middle are
    seen at 4 of 100. With the seeds given neither happens.
    """
    held, below = [], []
    for case in cases:
        predicted = roomfit.predict(
            roomfit.Question(
                case.scene,
                roomfit.absorption_posterior(case.result),
                (),
                case.measured,
                settings=FEW,
            )
        )
        for v in parameters(predicted):
            assert v.lower95[0] <= v.predicted[0] <= v.upper95[0]
            held.append(v.lower95[0] <= v.measured[0] <= v.upper95[0])
            below.append(v.measured[0] < 0.5 * (v.lower95[0] + v.upper95[0]))
    assert np.mean(held) > 0.83
    assert 0.2 < np.mean(below) < 0.8


@pytest.mark.slow
def test_a_wall_whose_share_is_unknown_is_exchanged_within_the_interval(cases):
    """Each wall in turn for one of 0.6: 18 changes of mean T20, of which 95 % are to be held.

    Those of one room go together; 4 of 18 missed would be a third of a room's.
    """
    held = []
    for case in cases:
        for i, name in enumerate(case.scene.room.materials):
            change = Change(name, "value", (0.6,), (0.0,))
            own = roomfit.absorption_posterior(case.result)
            new = roomfit.predict(roomfit.Question(case.scene, own, (change,), settings=FEW)).mean[
                "T20_s"
            ]
            true = case.true.copy()
            true[i] = 0.6
            there = known(case.scene, true)
            expected = (
                roomfit.predict(roomfit.Question(case.scene, there, settings=FEW))
                .mean["T20_s"]
                .predicted[0]
            )
            held.append(new.lower95[0] <= expected <= new.upper95[0])
            assert new.lower95[0] <= new.predicted[0] <= new.upper95[0]
    assert np.sum(held) >= 15, held


@pytest.mark.slow
def test_draws_go_through_the_file_and_old_files_do_without(tmp_path):
    result = make_case(1).result
    own = roomfit.absorption_posterior(result).draws
    assert own is not None and own.shape == (FEW.n_draws, 6, 1)
    write_result(tmp_path, result, ())
    read = read_result(tmp_path / "result.json")
    assert read.draws is not None
    np.testing.assert_allclose(read.draws, own, atol=0.5001e-5)
    rng = np.random.default_rng(1)
    np.testing.assert_array_equal(draw_absorption(read, 50, rng), read.draws[:50])
    old = draw_absorption(replace(read, draws=None), 50, np.random.default_rng(1))
    assert old.shape == (50, 6, 1)
    assert not np.array_equal(old, read.draws[:50])
