"""A source whose directivity is fitted: found, carried into intervals, and missed where not fitted.

The data come from image sources that add as pressures, enumerated and directed by code that shares
nothing with the fit (`roomfit.demo.boxes`).
"""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from report_cases import texts_of
from roomfit.base.air import Air, attenuation_per_m, speed_of_sound_m_s
from roomfit.base.bands import Bands, bands_between
from roomfit.base.errors import InputError
from roomfit.base.findings import Code
from roomfit.cli.identify import identify_to_folder
from roomfit.demo.boxes import SyntheticBox, add_noise, pressure_response
from roomfit.files.campaign import Campaign, read_campaign
from roomfit.files.inputs import load_campaign, material_priors, source_directivities
from roomfit.files.results import read_result, write_result
from roomfit.fit.directivity import directivity_parameters
from roomfit.fit.measurements import collect_measurements
from roomfit.identify import identify
from roomfit.materials.priors import unknown_material
from roomfit.model.directivity import FittedDirectivity
from roomfit.model.patterns import Pattern, UnknownDirectivity
from roomfit.report.tables import source_tables
from roomfit.uncertainty.other_room import room_posterior
from roomfit.uncertainty.posterior import AbsorptionPosterior
from small_campaign import ABSORPTION, LENGTHS_M, SMALL, SOURCE_M, write_wav

RATE_HZ = 16_000
B = np.array([0.5, 0.35, 0.0])
END_S = 0.08
POSITIONS_M = {
    "MP1": (2.9, 2.2, 1.3),
    "MP2": (3.1, 0.9, 1.6),
    "MP3": (0.7, 2.5, 1.7),
    "MP4": (2.2, 1.5, 0.7),
}


def box_truth() -> SyntheticBox:
    """Return the small campaign's room."""
    bands = bands_between("octave", 250, 4000)
    owners = ("walls", "walls", "walls", "walls", "carpet", "tiles")
    absorption = np.array([[ABSORPTION[name]] * len(bands) for name in owners])
    air = Air()
    return SyntheticBox(
        *(LENGTHS_M, bands.centres_hz, absorption, attenuation_per_m(air, bands)),
        speed_of_sound_m_s(air),
    )


@cache
def responses(*, directional: bool) -> dict[str, np.ndarray]:
    """Return the pressures at four receivers, noise at -60 dB."""
    rng, truth = np.random.default_rng(11), box_truth()
    flat = np.zeros(5)
    b = B if directional else None
    return {
        name: add_noise(
            pressure_response(truth, np.array(SOURCE_M), np.array(at), 0.25, RATE_HZ, flat, b),
            *(-60, rng),
        )
        for name, at in POSITIONS_M.items()
    }


def campaign(folder: Path, specified: str, *, directional: bool, more: str = "") -> Path:
    """Write a campaign of the four pairs whose source has a specified directivity."""
    text = SMALL[: SMALL.index("[receivers.MP1]")] + f"position_sd = 0.002\n{specified}\n"
    for name, at in POSITIONS_M.items():
        text += f"[receivers.{name}]\nposition = {list(at)}\nposition_sd = 0.002\n"
        text += f'[[measurements]]\nsource = "LS1"\nreceiver = "{name}"\nfile = "{name}.wav"\n'
        write_wav(folder / f"{name}.wav", responses(directional=directional)[name], RATE_HZ)
    path = folder / "campaign.toml"
    path.write_text(text + "[identify]\nfrom_hz = 500\nto_hz = 2000\n" + more)
    return path


def test_what_cannot_be_fitted_is_refused(tmp_path: Path) -> None:
    """The paper's searches, tables of values to be fitted along, and an aim without length."""
    (tmp_path / "t.csv").write_text("source,receiver,parameter,500\nLS1,MP1,T30,0.28\n")
    nowhere = "directivity = {aim = [0, 0, 0], b = 0.5, b_sd = 0.1}"
    for specified, more, words in (
        ('directivity = "fit"', 'method = "simplex"\n', "least squares"),
        ('directivity = "fit"', '[[measurements]]\nparameters = "t.csv"\n', "responses only"),
        (nowhere, "", "zero length"),
    ):
        path = campaign(tmp_path, specified, directional=False, more=more)
        with pytest.raises(InputError, match=words):
            given = load_campaign(path)
            known = (given[name] for name in ("scene", "measurements", "bands", "directivities"))
            directivity_parameters(collect_measurements(*known), given["settings"])


@pytest.mark.slow
def test_the_result_has_b_and_predicts_with_it(tmp_path: Path) -> None:
    """result.json holds b and its standard deviation by band; validated pairs have that source.

    Where that b is specified, in place of fitting it, the prediction of a pair is the same.
    """
    more = 'model = "energy"\nbands = [1000]\n'
    ends = ("from_hz = 500\nto_hz = 2000\n", "")
    asked = campaign(tmp_path, 'directivity = "fit"', directional=True, more=more)
    asked.write_text(_kept_apart(asked.read_text()).replace(*ends))
    answer = identify_to_folder(asked, tmp_path / "out")
    content = json.loads((tmp_path / "out" / "result.json").read_text())
    reported = content["directivity"]["LS1"]
    b, sd = np.array(reported["b"]), np.array(reported["sd"])
    assert b.shape == sd.shape == (1, 3)
    np.testing.assert_allclose(b, answer.directivities[0].b)
    assert np.all(np.abs(b[0] - B) <= 3.0 * sd[0])
    assert "Directivity of LS1" in (tmp_path / "out" / "report.html").read_text()
    posterior = read_result(tmp_path / "out" / "result.json")
    known = in_the_room(read_campaign(asked), posterior)
    predicted = known.directivities["LS1"]
    assert isinstance(predicted, Pattern)
    np.testing.assert_allclose(predicted.b, b)
    assert not known.findings
    length = float(np.linalg.norm(b[0]))
    known = f"directivity = {{aim = {b[0].tolist()}, b = {length}}}"
    rest = "".join(
        f"[materials.{name}]\nscattering = 0.0\nabsorption = {float(a[0])}\n"
        for name, a in zip(answer.materials, answer.absorption, strict=True)
    )
    text = asked.read_text().replace('directivity = "fit"', known)
    for name in answer.materials:
        text = text.replace(f"[materials.{name}]\nscattering = 0.0\n", "")
    asked.write_text(text + rest)
    again = identify(**load_campaign(asked))
    for one, other in zip(answer.pairs, again.pairs, strict=True):
        for name in ("EDT_s", "C80_dB", "D50_percent"):
            np.testing.assert_allclose(
                one.parameters[name].predicted, other.parameters[name].predicted, rtol=1e-9
            )


def in_the_room(campaign: Campaign, found: AbsorptionPosterior) -> AbsorptionPosterior:
    """Return what a result says of the materials and sources of a campaign in the same room."""
    priors = material_priors(campaign, found.materials, None, found.bands)
    return room_posterior(found, priors, found.bands, source_directivities(campaign, found.bands))


def test_a_further_source_of_a_fitted_loudspeaker_radiates_as_that_was_found_to() -> None:
    """About its own aim, in the bands that are asked for; of another make nothing is known."""
    bands, half = Bands("octave", np.array([500.0, 1000.0])), np.full((1, 2), 0.5)
    b, z = np.array([[0.4, 0.1, 0.0], [0.6, 0.2, 0.1]]), np.array([0.0, 0.0, 1.0])
    fitted = FittedDirectivity(
        "small box", b, 0.1 * np.ones((2, 3)), {"LS1": np.array([1.0, 0, 0])}
    )
    found = AbsorptionPosterior(
        ("walls",), bands, half, half, half, np.zeros((2, 1, 1)), directivities=fitted.patterns()
    )
    asked = {
        "LS7": UnknownDirectivity(aim=z, loudspeaker="small box"),
        "LS1": UnknownDirectivity(aim=-z, loudspeaker="small box"),
        "LS8": UnknownDirectivity(aim=z, loudspeaker="large box"),
    }
    upper = Bands("octave", np.array([1000.0]))
    known = room_posterior(found, (unknown_material("walls", 1),), upper, asked)
    assert set(known.directivities) == {"LS7", "LS1"}
    for name, aim in (("LS7", z), ("LS1", -z)):
        np.testing.assert_array_equal(known.directivities[name].b, b[1:])
        np.testing.assert_array_equal(known.directivities[name].aim, aim)
    (doubt,) = known.findings
    assert doubt.code == Code.DIRECTIVITY_NOT_KNOWN and doubt.evidence["sources"] == ["LS8"]


def _kept_apart(text: str) -> str:
    """Return a campaign whose last pair is predicted only."""
    return text.replace('file = "MP4.wav"\n', 'file = "MP4.wav"\nuse = "validate"\n')


def shared_campaign(folder: Path, speaker: str = "box") -> Path:
    """Write a campaign of two sources of one make, each with its own aim, |b| = 0.6 about it."""
    rng, truth = np.random.default_rng(12), box_truth()
    text = SMALL[: SMALL.index("[sources.LS1]")] + "[loudspeakers.box]\n"
    for name, place, aim in (
        ("LS1", SOURCE_M, (0.8, 0.6, 0.0)),
        ("LS2", (0.9, 2.4, 1.5), (0.6, -0.8, 0.0)),
    ):
        text += f"[sources.{name}]\nposition = {list(place)}\nposition_sd = 0.002\n"
        text += f'directivity = {{loudspeaker = "{speaker}", aim = {list(aim)}}}\n'
        for receiver in ("MP1", "MP2", "MP4"):
            pressure = pressure_response(
                *(truth, np.array(place), np.array(POSITIONS_M[receiver]), 0.25, RATE_HZ),
                *(np.zeros(5), 0.6 * np.array(aim)),
            )
            file = f"{name}_{receiver}.wav"
            write_wav(folder / file, add_noise(pressure, -60, rng), RATE_HZ)
            text += f'[[measurements]]\nsource = "{name}"\nreceiver = "{receiver}"\n'
            text += f'file = "{file}"\n'
    for receiver in ("MP1", "MP2", "MP4"):
        text += f"[receivers.{receiver}]\nposition = {list(POSITIONS_M[receiver])}\n"
        text += "position_sd = 0.002\n"
    path = folder / "campaign.toml"
    path.write_text(text + '[identify]\nmodel = "energy"\nfrom_hz = 1000\nto_hz = 2000\n')
    return path


@pytest.mark.slow
def test_sources_of_one_make_share_a_pattern_about_their_aims(tmp_path: Path) -> None:
    """One pattern is found for both, of first order as was simulated, and predicts for both.

    b within 2.6 of its standard deviations: six numbers, one false alarm in 18 rooms, none here.
    """
    answer = identify(**load_campaign(shared_campaign(tmp_path)))
    (found,) = answer.directivities
    assert found.source == "box"
    assert set(found.aims) == {"LS1", "LS2"}
    assert np.all(np.abs(found.b - np.array([0.6, 0.0, 0.0])) < 2.6 * found.sd)
    assert np.all(found.sd[:, 0] < 0.25)
    patterns = found.patterns()
    np.testing.assert_allclose(patterns["LS2"].aim, [0.6, -0.8, 0.0], atol=1e-12)
    assert "directivity index, dB (2 sources)" in str(answer)
    (table,) = source_tables(answer)
    assert [row[0] for row in texts_of(table)][1:] == ["order 1", "order 2", "order 3"]
    (tmp_path / "result").mkdir()
    write_result(tmp_path / "result", answer, ())
    again = read_result(tmp_path / "result" / "result.json")
    assert again.directivities is not None
    kept = again.directivities["LS2"]
    assert isinstance(kept, Pattern)
    np.testing.assert_allclose(kept.b, found.b, rtol=1e-6)
    np.testing.assert_allclose(kept.aim, [0.6, -0.8, 0.0], atol=1e-9)
