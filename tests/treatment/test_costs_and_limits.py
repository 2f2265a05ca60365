"""What a treatment costs, what a standard asks, and how likely a target is: by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from report_cases import scene_of
from roomfit.bands import bands_between
from roomfit.geometry.mesh import shoebox_mesh
from roomfit.scene import room_from_mesh
from roomfit.signals.iso3382 import VALUE_NAMES
from roomfit.treatment import question as question_module
from roomfit.treatment import treat as treat_module
from roomfit.treatment.question import Product, Surface, Target, question_of
from roomfit.treatment.standards import standard_target


@pytest.mark.parametrize(("name", "per_m"), [("b3", 0.20), ("b4", 0.25), ("b5", 0.30)])
def test_rooms_below_two_and_a_half_metres_have_the_limits_of_one_that_high(name, per_m):
    """DIN 18041:2016, table 4: A/V of 0.20, 0.25 and 0.30 per metre up to 2.5 m, less above."""

    def limit_s(height_m: float) -> float:
        room = room_from_mesh(shoebox_mesh((6.0, 5.0, height_m)), {})
        return standard_target(f"din-18041-{name}", room)[0].high

    for height_m in (2.0, 2.3, 2.5):
        assert limit_s(height_m) == pytest.approx(0.16 / per_m, rel=0.002)
    # each doubling of the height adds 4.69 log10(2) to the reciprocal of A/V
    assert limit_s(5.0) - limit_s(2.5) == pytest.approx(0.16 * 4.69 * np.log10(2.0), rel=1e-6)


def test_a_piece_costs_its_area_times_the_price_of_a_square_metre(monkeypatch):
    bands = SimpleNamespace(centres_hz=np.array([500.0]))
    here = SimpleNamespace(room=None)
    room: Any = SimpleNamespace(absorption=SimpleNamespace(bands=bands), scene=here)
    columns = [(0, 0, 4.0), (0, 1, 2.0), (1, 0, 3.0)]
    monkeypatch.setattr(question_module, "material_areas_m2", lambda *_: np.array([9.0, 8.0]))
    monkeypatch.setattr(question_module, "pair_states", lambda _: np.array([0]))
    monkeypatch.setattr(question_module, "columns_of", lambda *_: (columns, {0: 9.0, 1: 8.0}))
    monkeypatch.setattr(question_module, "row_weights", lambda *_: np.ones((1, 1)))
    monkeypatch.setattr(question_module, "_product_draws", lambda *_: np.zeros((1, 2, 1)))
    a = np.array([0.5])
    products = (Product("foam", a, a, 30.0, 2.0), Product("panel", a, a, 55.0, 0.72))
    target = (Target("T30_s", high=0.5, bands_hz=(500.0,)),)
    asked = question_of(room, (Surface("walls"),), products, target)
    np.testing.assert_allclose(asked.cost, [60.0, 39.6, 60.0])


def test_the_odds_of_a_target_count_both_of_its_limits(monkeypatch):
    """By scipy, with a Gaussian rest of draws, and of logarithms of decay times.

    At most, at least (a decay time, in two rows), and between; and all at once.
    """
    rng = np.random.default_rng(4)
    rows, sd = rng.lognormal(0.0, 0.3, (64, 4)), np.array([0.2, 0.1, 0.15, 0.3])
    times = np.array([False, True, False, True])
    low = np.array([-np.inf, 0.9, 0.8, 0.7])
    high = np.array([1.1, np.inf, 1.2, np.inf])
    targets = (0, 1, 2, 1)  # the second has two rows
    number = SimpleNamespace(draws=np.zeros((64, 1, 1)), sti=None)
    monkeypatch.setattr(treat_module, "numbers_at", lambda *_: [number])
    monkeypatch.setattr(treat_module, "treated", lambda *_: None)
    monkeypatch.setattr(treat_module, "treated_draws", lambda *_: None)
    monkeypatch.setattr(treat_module, "predicted_means", lambda *_: (None, None))
    monkeypatch.setattr(treat_module, "rows_of", lambda *_: rows)
    monkeypatch.setattr(treat_module, "_rest_sd", lambda *_: sd)
    monkeypatch.setattr(treat_module, "limits_of", lambda _: (low, high))
    monkeypatch.setattr(treat_module, "is_time", lambda _: times)
    room = SimpleNamespace(scene=None, before=())
    monkeypatch.setattr(treat_module, "_missed", lambda *_: ())
    nothing = np.zeros(0)
    question: Any = SimpleNamespace(room=room, targets=(1, 2, 3), target=targets, cost=nothing)
    found = treat_module._outcome(question, nothing, nothing, 0.5)
    assert found.rows is rows
    odds, joint = treat_module._of_targets(question, found.odds)
    within = norm.cdf(high, rows, sd) - norm.cdf(low, rows, sd)
    in_logs = norm.cdf(np.log(rows), np.log(np.maximum(low, 1e-300)), sd)
    within = np.where(times, in_logs, within)
    np.testing.assert_allclose(
        odds, [within[:, 0].mean(), (within[:, 1] * within[:, 3]).mean(), within[:, 2].mean()]
    )
    assert joint == pytest.approx(within.prod(axis=1).mean())
    assert odds[1] < 0.7  # a target that is not met for certain


@pytest.mark.parametrize(
    ("t30", "words"),
    [
        ([[0.8, 0.7], [0.9, 0.8]], "measured before"),
        ([[0.8, np.nan], [0.9, 0.8]], "before, measured where it was"),
        ([[0.8, 0.7]], "before, measured where it was"),  # the other pair was not measured
        ([[np.nan] * 2] * 2, "predicted before"),  # T20 alone was
    ],
)
def test_only_what_was_measured_is_called_so(t30, words):
    scene = scene_of(receivers=("R1", "R2"))
    bands = bands_between("octave", 500, 1000)
    observed = []
    for receiver, row in zip(("R1", "R2"), t30, strict=False):
        values = np.full((len(VALUE_NAMES), 2), np.nan)
        values[VALUE_NAMES.index("T20_s")] = 0.8
        values[VALUE_NAMES.index("T30_s")] = row
        observed.append(SimpleNamespace(source="S1", receiver=receiver, values=values))
    room: Any = SimpleNamespace(
        scene=scene, observed=observed, absorption=SimpleNamespace(bands=bands)
    )
    assert treat_module._before_in_words(room) == words
