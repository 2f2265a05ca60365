"""Seats and audience in a campaign: their strip is counted, once, in every command by hand."""

from __future__ import annotations

import json

import numpy as np
import pytest

import roomfit
from box_files import obj
from roomfit.base.air import Air, attenuation_per_m, speed_of_sound_m_s
from roomfit.base.errors import InputError
from roomfit.base.findings import Code
from roomfit.files.campaign import read_campaign
from roomfit.files.inputs import campaign_room, check_campaign, room_priors
from roomfit.files.questions import diffuse_field
from roomfit.materials.priors import object_area_m2
from small_campaign import run_command

# by hand: 12 x 8 m of seats at the front wall x = 0, a strip along three sides, of 0.5 m
HALL, SEATS_M2, WHOLE_M2 = (20.0, 12.0, 8.0), 96.0, 12.5 * 9.0
VOLUME_M3, SURFACE_M2 = 1920.0, 2 * (240.0 + 160.0 + 96.0)
CAMPAIGN = """
[room]
shoebox = [20, 12, 8]
[materials.floor]
absorption = 0.02
[materials.ceiling]
absorption = 0.1
[materials.west]
absorption = 0.1
[materials.east]
absorption = 0.1
[materials.south]
absorption = 0.1
[materials.north]
absorption = 0.1
[objects.stalls]
outlines = [[[0, 2, 0], [12, 2, 0], [12, 10, 0], [0, 10, 0]]]
absorption_area_m2 = "audience-medium"
[reverberation]
file = "t30.csv"
formula = "Sabine"
"""
BANDS = roomfit.bands_between("octave", 500, 1000)
MEDIUM = np.array([0.80, 0.83])  # Beranek and Hidaka, at 500 and 1000 Hz


def sabine_s(walls_m2: float, objects_m2: np.ndarray) -> np.ndarray:
    """Return 55.3 V / (c (A + 4 m V)), with 24 ln 10 = 55.26."""
    air = 4.0 * VOLUME_M3 * attenuation_per_m(Air(), BANDS)
    return (
        24.0 * np.log(10.0) * VOLUME_M3 / speed_of_sound_m_s(Air()) / (walls_m2 + objects_m2 + air)
    )


WALLS_M2 = 0.02 * 240.0 + 0.1 * (SURFACE_M2 - 240.0)
TIMES_S = sabine_s(WALLS_M2, WHOLE_M2 * MEDIUM)


@pytest.fixture
def folder(tmp_path):
    rows = [f"p{i};{TIMES_S[0]:.6f};{TIMES_S[1]:.6f}".replace(".", ",") for i in range(3)]
    (tmp_path / "t30.csv").write_text("\n".join(["place;500;1000", *rows]))
    (tmp_path / "campaign.toml").write_text(CAMPAIGN)
    return tmp_path


def campaign_of(folder, text=CAMPAIGN):
    (folder / "campaign.toml").write_text(text)
    return read_campaign(folder / "campaign.toml", to_fit=False, decay_times=True)


def test_the_decay_time_of_a_hall_with_audience_is_sabine_by_hand(folder):
    """96 m2 of seats absorb as 112.5 m2: 12.5 m by 9 m, the wall's side without a strip."""
    field, room = diffuse_field(campaign_of(folder))
    walls = np.array([k.known for k in field.priors])
    np.testing.assert_allclose(field.times_s(walls), TIMES_S, rtol=1e-9)
    assert room is not None and "stalls" not in room.materials
    without = CAMPAIGN.replace("[reverberation]", "edge_m = 0\n[reverberation]")
    bare, _ = diffuse_field(campaign_of(folder, without))
    np.testing.assert_allclose(
        bare.times_s(walls), sabine_s(WALLS_M2, SEATS_M2 * MEDIUM), rtol=1e-9
    )


def test_walls_are_found_beside_the_audience_from_decay_times(folder, monkeypatch):
    """The ceiling is not known and has a wide prior: 0.1 comes out, as the times were made."""
    text = CAMPAIGN.replace("[materials.ceiling]\nabsorption = 0.1", "[materials.ceiling]")
    (folder / "campaign.toml").write_text(text)
    files = [folder / "campaign.toml", "--out", folder / "out"]
    assert run_command(monkeypatch, "reverberation", *files) == 0
    content = json.loads((folder / "out" / "result.json").read_text())
    # a tenth of its own, as the time is known to 5 %, which are a fifth of the ceiling's share
    assert content["materials"]["ceiling"]["absorption"] == pytest.approx([0.1, 0.1], rel=0.1)


def test_panels_in_a_hall_with_audience_are_those_of_sabine_by_hand(folder, monkeypatch):
    """From the time with audience to 10 % less: panels of 0.9 on a ceiling of 0.1."""
    target = 0.9 * TIMES_S[1]
    (folder / "treatment.toml").write_text(
        "[surfaces.ceiling]\n[products.panel]\nabsorption = 0.9\nsd = 0.01\npiece_m2 = 0.05\n"
        f"[[targets]]\nat_most = {target:.6f}\nbands_hz = [1000]\n"
    )
    files = [folder / "campaign.toml", folder / "treatment.toml", "--out", folder / "out"]
    assert run_command(monkeypatch, "treat", *files) == 0
    content = json.loads((folder / "out" / "treatment.json").read_text())
    (first,) = content["arrangements"]
    hung = first["hung"][0]["area_m2"]
    assert hung > 20.0
    by_hand = sabine_s(WALLS_M2 + 0.8 * hung, WHOLE_M2 * MEDIUM)
    assert first["mean"]["T30_s"]["predicted"] == pytest.approx(by_hand, rel=1e-4)


IDENTIFIED = CAMPAIGN.partition("[reverberation]")[0] + (
    "[sources.S]\nposition = [15, 6, 1.5]\n[receivers.R]\nposition = [6, 5, 1.2]\n"
    "[identify]\nfrom_hz = 500\nto_hz = 1000\n"
)


def test_identify_has_the_same_area_known_or_with_the_prior_of_the_catalogue(folder):
    campaign = campaign_of(folder, IDENTIFIED)
    known = room_priors(campaign, campaign_room(campaign))[-1]
    assert known.known is not None
    np.testing.assert_allclose(object_area_m2(known.known, VOLUME_M3), WHOLE_M2 * MEDIUM, rtol=1e-6)
    fitted = campaign_of(folder, IDENTIFIED.replace("absorption_area_m2", "prior"))
    law = room_priors(fitted, campaign_room(fitted))[-1]
    middle = law.upper / (1.0 + np.exp(-law.prior_logit_mean))
    spread = law.prior_logit_sd * (1.0 - middle / law.upper)
    areas = object_area_m2(middle, VOLUME_M3) * np.exp(0.5 * spread**2)
    np.testing.assert_allclose(areas, WHOLE_M2 * MEDIUM, rtol=0.02)


def test_the_area_is_told_and_so_is_that_of_seats_that_are_drawn(folder):
    room = campaign_room(campaign_of(folder, IDENTIFIED))
    (stated,) = [f for f in room.findings if f.code is Code.AUDIENCE_AREA]
    assert "stalls: 96.0 m2 of seats absorb as 112.5 m2" in stated.sentence
    checked = check_campaign(campaign_of(folder, IDENTIFIED)).findings
    assert stated.sentence in [f.sentence for f in checked]
    (folder / "box.obj").write_bytes(obj())
    drawn = '[room]\nfile = "box.obj"\nunit = "m"\n[materials.plaster]\nprior = "audience-heavy"\n'
    (stated,) = [
        f
        for f in campaign_room(campaign_of(folder, drawn)).findings
        if f.code is Code.AUDIENCE_AREA
    ]
    assert stated.evidence == pytest.approx({"level_m2": 40.0, "upright_m2": 54.0})
    assert "'audience-heavy'" in stated.sentence


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("absorption = 0.02", 'prior = "seats-heavy-empty"', r"absorb twice(.|\n)*'floor'"),
        ("outlines =", "count = 3\noutlines =", r"measured in two ways(.|\n)*count, outlines"),
        ("outlines = [[[0, 2, 0]", "outlines = [[[0, 2, 9]", "no air|stands upright"),
        ("absorption_area_m2", "prior", r"no object from the walls(.|\n)*absorption_area_m2"),
        ('"audience-medium"', '"person-seated"', r"another kind(.|\n)*count"),
        ("edge_m", "edge_mm", "edge_m"),
    ],
)
def test_seats_that_cannot_be_meant_are_refused(folder, old, new, words):
    text = CAMPAIGN.replace("[reverberation]", "edge_m = 0.5\n[reverberation]").replace(old, new)
    with pytest.raises(InputError, match=words):
        diffuse_field(campaign_of(folder, text))
