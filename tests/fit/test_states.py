"""Measurements of a room in several states, fitted together."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import roomfit
from roomfit.base.air import Air, attenuation_per_m, speed_of_sound_m_s
from roomfit.base.bands import bands_between
from roomfit.base.errors import InputError
from roomfit.demo.boxes import SyntheticBox, add_noise, pressure_response
from roomfit.identify import identify
from roomfit.predict.changes import read_change
from roomfit.predict.predict import predict
from roomfit.predict.question import Question
from roomfit.result import absorption_posterior
from roomfit.room.scene import scene_of, select_pairs, shoebox_room, with_states
from roomfit.settings import Settings
from roomfit.signals.measurement import Measurement

RATE_HZ = 8000
LENGTHS_M = (4.4, 3.6, 2.6)
SOURCES = {"A": (1.0, 1.2, 1.1), "B": (3.6, 2.9, 1.5)}
RECEIVERS = {"M": (2.9, 0.8, 1.6), "N": (1.4, 2.7, 1.3)}
TRUTH = {"west": 0.1, "east": 0.2, "south": 0.08, "north": 0.15, "floor": 0.35, "ceiling": 0.25}
CLOSED = {"south": "curtain"}
BANDS = bands_between("octave", 1000, 1000)
FEW = Settings(model="energy", n_rays=3000)


@cache
def responses(curtain: float | None) -> dict[tuple[str, str], np.ndarray]:
    """Image sources with phase and noise, with the south wall as described or behind a curtain."""
    centres = bands_between("octave", 500, 2000)
    walls = TRUTH | ({} if curtain is None else {"south": curtain})
    absorption = np.array([[a] * len(centres) for a in walls.values()])
    air = Air()
    box = SyntheticBox(
        LENGTHS_M,
        centres.centres_hz,
        absorption,
        attenuation_per_m(air, centres),
        speed_of_sound_m_s(air),
    )
    rng = np.random.default_rng(3)
    flat = np.zeros(len(centres))
    return {
        (s, r): add_noise(
            pressure_response(box, np.array(a), np.array(b), 0.5, RATE_HZ, flat), -60, rng
        )
        for s, a in SOURCES.items()
        for r, b in RECEIVERS.items()
    }


def measured(curtain: float | None, state: str = "", **settings) -> list[Measurement]:
    return [
        Measurement(s, r, pressure, RATE_HZ, state=state, **settings)
        for (s, r), pressure in responses(curtain).items()
    ]


def scene(states: dict[str, dict[str, str]]):
    room = with_states(shoebox_room(LENGTHS_M, {n: n for n in TRUTH}), states)
    return scene_of(room, SOURCES, RECEIVERS)


def smooth(materials):
    return [roomfit.material_prior(name, BANDS, scattering=0.0) for name in materials]


@cache
def joint():
    both = scene({"closed": CLOSED})
    data = [*measured(None), *measured(0.7, "closed")]
    return identify(both, data, smooth(both.room.materials), BANDS, settings=FEW)


@pytest.mark.slow
def test_both_states_are_found_and_share_what_did_not_change():
    result = joint()
    truth = np.array([*TRUTH.values(), 0.7])
    held = (result.lower95[:, 0] <= truth) & (truth <= result.upper95[:, 0])
    assert held.sum() >= 6  # of 7 intervals, one may miss: less often than once in 25 fits
    curtain, south = (result.materials.index(n) for n in ("curtain", "south"))
    assert result.absorption[curtain, 0] - result.absorption[south, 0] > 0.4
    # two states tell more of the walls that both have than either of them
    alone = scene({})
    first = identify(alone, measured(None), smooth(TRUTH), BANDS, settings=FEW)
    same = [i for i, n in enumerate(TRUTH) if n != "south"]
    widths = [np.mean((r.upper95 - r.lower95)[same]) for r in (result, first)]
    assert widths[0] < 0.95 * widths[1]
    assert {p.state for p in result.pairs} == {"", "closed"}
    assert result.state_means["closed"][0, 0] > result.mean_absorption[0, 0] + 0.05


@pytest.mark.slow
def test_a_state_that_changes_nothing_changes_nothing():
    """Where levels are absolute, a name for the state of some responses is only a name."""
    data = measured(None, level="absolute")
    named = [replace(m, state="again") if m.receiver == "N" else m for m in data]
    same = scene({"again": {"floor": "floor"}})
    plain, split = (
        identify(s, d, smooth(TRUTH), BANDS, settings=FEW)
        for s, d in ((scene({}), data), (same, named))
    )
    np.testing.assert_allclose(split.absorption, plain.absorption, rtol=1e-9)
    np.testing.assert_allclose(split.upper95, plain.upper95, rtol=1e-6)


@pytest.mark.slow
def test_pressures_are_fitted_in_every_state():
    both = scene({"closed": CLOSED})
    data = [*measured(None), *measured(0.7, "closed")]
    result = identify(
        both, data, smooth(both.room.materials), BANDS, settings=replace(FEW, model="coherent")
    )
    truth = np.array([*TRUTH.values(), 0.7])
    assert result.models == ("coherent",)
    held = (result.lower95[:, 0] <= truth) & (truth <= result.upper95[:, 0])
    assert held.sum() >= 6  # as above
    curtain, south = (result.materials.index(n) for n in ("curtain", "south"))
    assert result.lower95[curtain, 0] > result.upper95[south, 0]


@pytest.mark.slow
def test_a_change_to_a_material_of_another_state_is_that_state():
    both, found = scene({"closed": CLOSED}), absorption_posterior(joint())
    # neither doubted, which would leave splits open, nor widened by what eight short files depart
    found = replace(found, result_findings=(), fitted=())
    # image sources alone; sound is followed for longer where the room is livelier before
    every = replace(FEW, most_images=1_500_000)
    opened = select_pairs(both, slice(0, 1))
    closed = replace(opened, pair_state=np.ones(1, dtype=np.int32))
    changed = predict(Question(opened, found, [read_change("south=curtain")], settings=every)).mean[
        "T30_s"
    ]
    state = predict(Question(closed, found, settings=every)).mean["T30_s"]
    np.testing.assert_allclose(changed.predicted, state.predicted, rtol=0.03)
    # draws weigh a sample of the paths
    np.testing.assert_allclose(changed.sd_absorption, state.sd_absorption, rtol=0.5)
    assert changed.change is not None
    assert changed.change.change_upper95[0] < 1.0
    mixed = replace(both, pair_state=np.array([0, 1, 0, 1]))
    with pytest.raises(InputError, match="one state"):
        predict(Question(mixed, found, settings=FEW))
