"""Maps: where their points are, and that each number is the one predicted there."""

from __future__ import annotations

import csv

import numpy as np
import pytest

import roomfit
from roomfit.base.bands import bands_between
from roomfit.base.errors import InputError
from roomfit.base.logit import logit
from roomfit.base.table import csv_of
from roomfit.predict.grid import grid_records, grid_scene
from roomfit.predict.predict import predict
from roomfit.predict.question import Question
from roomfit.uncertainty.posterior import AbsorptionPosterior
from small_campaign import run_command

BANDS = bands_between("octave", 500, 1000)
SOURCES = {"S": (1.2, 1.4, 1.5), "far": (5.2, 4.1, 1.5)}


def hall():
    room = roomfit.shoebox_room((6.0, 5.0, 3.0), "walls")
    return roomfit.scene_of(room, SOURCES, {"R": (4.0, 3.5, 1.2)})


def absorption():
    a, sd = np.full((1, 2), 0.2), 0.2
    low, high = (1.0 / (1.0 + np.exp(-(logit(a) + s * 1.96 * sd))) for s in (-1, 1))
    law = np.full((2, 1, 1), sd**2)
    return AbsorptionPosterior(("walls",), BANDS, a, low, high, law, scattering=0.0 * a + 0.3)


@pytest.fixture(scope="module")
def mapped():
    scene = grid_scene(hall(), 1.2, 2.0)
    few = roomfit.Settings(n_rays=2000, n_draws=8)
    return scene, predict(Question(scene, absorption(), settings=few))


def test_points_lie_on_the_plane_within_the_room_and_away_from_the_sources():
    """Middles of cells of 50 x 50 cm; a source takes the points within half a metre."""
    scene = grid_scene(hall(), 1.2, 0.5)
    at_m = np.array([r.position_m for r in scene.receivers])
    assert len(at_m) == 12 * 10
    assert set(at_m[:, 2]) == {1.2}
    np.testing.assert_allclose(at_m.mean(axis=0)[:2], (3.0, 2.5))
    for axis, length in ((0, 6.0), (1, 5.0)):
        places = np.unique(at_m[:, axis])
        np.testing.assert_allclose(np.diff(places), 0.5)
        assert places[0] == pytest.approx(length - places[-1])
    for s, source in enumerate(SOURCES.values()):
        own = scene.pairs[scene.pairs[:, 0] == s, 1]
        distance_m = np.linalg.norm(at_m - source, axis=1)
        assert set(own.tolist()) == set(np.flatnonzero(distance_m >= 0.5).tolist())


def test_points_outside_of_the_room_are_left_out(tmp_path):
    """A prism over a right triangle: of 36 cells 15 are in front of the slope, 6 on it."""
    low = ["0 0 0", "6 0 0", "0 6 0"]
    corners = [f"v {x}" for x in (*low, *(f"{x[:-1]}3" for x in low))]
    faces = ["f 1 3 2", "f 4 5 6", "f 1 2 5 4", "f 2 3 6 5", "f 3 1 4 6"]
    file = tmp_path / "prism.obj"
    file.write_text("\n".join([*corners, "usemtl walls", *faces]))
    room, _ = roomfit.read_room(roomfit.RoomSpec(file=str(file), unit="m", up="z"))
    scene = roomfit.scene_of(room, {"S": (0.1, 5.0, 2.9)}, {"R": (1.0, 2.0, 1.2)})
    at_m = np.array([r.position_m for r in grid_scene(scene, 1.2, 1.0).receivers])
    assert len(at_m) == 15
    assert (at_m[:, 0] + at_m[:, 1] < 5.9).all()


def test_every_number_of_the_table_is_that_of_its_pair(mapped, tmp_path):
    scene, predicted = mapped
    (tmp_path / "grid.csv").write_text(csv_of(grid_records(predicted, scene)), encoding="utf-8")
    rows = list(csv.DictReader((tmp_path / "grid.csv").open(encoding="utf-8")))
    assert {r["parameter"] for r in rows} >= {"T30_s", "EDT_s", "C80_dB", "D50_percent"}
    places = {p.name: p.position_m for p in scene.receivers}
    for pair in predicted.pairs:
        at_m = places[pair.receiver]
        (row,) = [
            r
            for r in rows
            if (r["source"], r["parameter"], r["band_hz"]) == (pair.source, "C80_dB", "1000")
            and (float(r["x_m"]), float(r["y_m"])) == (at_m[0], at_m[1])
        ]
        v = pair.parameters["C80_dB"]
        assert float(row["predicted"]) == pytest.approx(v.predicted[1], abs=1e-4)
        width = v.upper95[1] - v.lower95[1]
        assert float(row["width95"]) == pytest.approx(width, abs=1e-4)
    assert len(grid_records(predicted, scene).rows) == len(rows)


@pytest.mark.parametrize(
    ("height_m", "spacing_m", "words"),
    [
        (1.2, 0.0, "a height and a spacing"),
        (np.nan, 1.0, "a height and a spacing"),
        (3.5, 1.0, "no point of the grid"),
        (1.2, 0.01, "more pairs than can be predicted"),
        (1.2, 6e-19, "more pairs than can be predicted"),  # more than an integer of 64 bits
    ],
)
def test_a_grid_that_cannot_be_is_refused(height_m, spacing_m, words):
    with pytest.raises(InputError, match=words):
        grid_scene(hall(), height_m, spacing_m)


CAMPAIGN = """
[room]
shoebox = [6, 5, 3]
materials = { walls = "walls", floor = "walls", ceiling = "walls" }
[sources.S]
position = [1.5, 1.2, 1.5]
[receivers.R]
position = [4.0, 3.5, 1.2]
[identify]
from_hz = 1000
to_hz = 1000
[settings]
n_rays = 2000
n_draws = 4
[[measurements]]
parameters = "measured.csv"
"""


def test_the_command_maps_the_room_in_place_of_its_receivers(tmp_path, monkeypatch, capsys):
    """What was measured at these does not hinder it."""
    (tmp_path / "measured.csv").write_text("source,receiver,parameter,1000\nS,R,T30,0.5\n")
    (tmp_path / "campaign.toml").write_text(CAMPAIGN)
    table = "material,band_hz,absorption,lower95,upper95,identifiable\n"
    (tmp_path / "found.csv").write_text(f"{table}walls,1000,0.3,0.25,0.36,true\n")
    call = ["predict", tmp_path / "campaign.toml", "--absorption", tmp_path / "found.csv"]
    assert run_command(monkeypatch, *call, "--out", tmp_path / "a", "--grid", "1.2,2.5") == 0
    names = {p.name for p in (tmp_path / "a").iterdir()}
    assert names >= {"grid.csv", "predicted.csv", "predicted.html", "predicted.json"}
    rows = list(csv.DictReader((tmp_path / "a" / "grid.csv").open(encoding="utf-8")))
    # without that which is 30 cm from the source
    assert {(r["x_m"], r["y_m"]) for r in rows} == {
        *(("4.250", "1.250"), ("1.750", "3.750"), ("4.250", "3.750"))
    }
    assert "grid.csv" in capsys.readouterr().out
    assert run_command(monkeypatch, *call, "--out", tmp_path / "b", "--grid", "1.2") == 2
