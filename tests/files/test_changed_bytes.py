"""Files that roomfit writes and reads again notice a changed byte, an edit and a misspelt key."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from report_cases import answer_of, scene_of, with_bands
from roomfit.base.errors import InputError, RoomfitError
from roomfit.base.findings import Code
from roomfit.base.whole_files import content_digest
from roomfit.cli.predict import predict_to_folder
from roomfit.files.encoding import EditedFile, written_content
from roomfit.files.results import (
    read_materials,
    read_result,
    write_result,
)
from small_campaign import run_command, write_campaign

SEED, PLACES = 20_261, 500


def answered():
    return answer_of(scene_of())


def written(folder):
    """Write an answer of three materials in six bands, with all that a posterior can hold."""
    answer = answered()
    m, n = len(answer.bands), len(answer.materials)
    draws = np.random.default_rng(3).uniform(0.1, 0.9, (5, n, m))
    full = with_bands(answer, draws=draws)
    write_result(folder, replace(full, scattering=np.full((n, m), 0.1)), ())
    return folder / "result.json"


def damaged(content: bytes):
    """Yield a file with one byte changed, at seeded places: any byte, or a digit for a digit."""
    rng = np.random.default_rng(SEED)
    digits = np.flatnonzero([chr(b).isdigit() for b in content])
    for number in range(PLACES):
        altered = bytearray(content)
        place = rng.choice(digits) if number % 2 and len(digits) else rng.integers(len(content))
        old = altered[place]
        new = 48 + rng.integers(10) if number % 2 and len(digits) else rng.integers(256)
        altered[place] = new if new != old else (old ^ 1)
        yield bytes(altered)


def whole_text(value):
    """Return all of a value as text, every digit of every number."""
    with np.printoptions(threshold=10**9, floatmode="unique"):
        return repr(value)


def read_otherwise(path, read):
    """Return how many damages are read as something else, and how many are refused."""
    whole, right = path.read_bytes(), whole_text(read(path))
    others = refused = 0
    for content in damaged(whole):
        path.write_bytes(content)
        try:
            others += whole_text(read(path)) != right
        except RoomfitError:
            refused += 1
    path.write_bytes(whole)
    return others, refused


def test_no_changed_byte_of_a_result_is_read_as_another_result(tmp_path):
    others, refused = read_otherwise(written(tmp_path), read_result)
    # what is left is space between the parts, and digits beyond the last that a number keeps
    assert others == 0 and refused > 0.75 * PLACES


def test_no_changed_byte_of_a_table_beside_its_result_is_read_as_another(tmp_path):
    written(tmp_path)
    others, refused = read_otherwise(tmp_path / "absorption.csv", read_result)
    assert (others, refused) == (0, PLACES)


def test_a_changed_result_is_refused_with_a_sentence_and_taken_as_edited(tmp_path, monkeypatch):
    path = written(tmp_path)
    content = json.loads(path.read_text())
    content["materials"]["floor"]["absorption"][2] = 0.5
    path.write_text(json.dumps(content))
    for read in (read_result, read_materials):
        with pytest.raises(InputError, match="was changed after roomfit wrote it") as refused:
            read(path)
        assert all((refused.value.where, refused.value.found, refused.value.needed))
        assert "--edited" in str(refused.value)
    found = read_result(EditedFile(path))
    assert found.absorption[1, 2] == 0.5
    assert found.result_findings[0].code is Code.RESULT_EDITED
    out = tmp_path / "out.csv"
    assert run_command(monkeypatch, "export", path, "--format", "csv", "--out", out) == 2
    assert not out.exists()
    assert (
        run_command(monkeypatch, "export", path, "--format", "csv", "--out", out, "--edited") == 0
    )
    assert "0.50000" in out.read_text()


@pytest.mark.parametrize("command", ["predict", "listen", "treat", "design", "compare"])
def test_every_command_that_reads_a_result_takes_an_edited_one_on_request(
    tmp_path, monkeypatch, capsys, command
):
    """It gets beyond the result, to what is missing behind it."""
    path = written(tmp_path)
    content = json.loads(path.read_text())
    content["bands_hz"][0] = 63.0
    path.write_text(json.dumps(content))
    campaign = write_campaign(tmp_path / "room")
    beside = {"treat": [tmp_path / "none.toml"], "compare": []}.get(command, [])
    own = "--result" if command == "design" else "--absorption"
    arguments = [path, path] if command == "compare" else [campaign, *beside, own, path]
    if command == "treat":
        beside[0].write_text("")
    places = [] if command == "compare" else ["--out", tmp_path / "out"]
    said = []
    for more in ([], ["--edited"]):
        run_command(monkeypatch, command, *arguments, *places, *more)
        said.append("was changed after roomfit wrote it" in capsys.readouterr().err)
    # without a treatment the campaign of one is refused before the result is read
    assert said == [command != "treat", False]


def test_the_digest_is_that_of_the_text_without_spaces_and_without_itself(tmp_path):
    """So another program checks it, after any formatting of the file."""
    path = written(tmp_path)
    content = json.loads(path.read_text())
    stated = content.pop("content_sha256")
    assert content_digest(content) == stated
    path.write_text(json.dumps(json.loads(path.read_text()), indent=4).replace("\n", "\r\n"))
    assert read_result(path).result_findings == ()
    table = tmp_path / "absorption.csv"
    table.write_bytes(table.read_bytes().replace(b"\n", b"\r\n"))
    assert read_materials(table)[0].findings == ()


@pytest.mark.parametrize(
    ("table", "key", "wrong"),
    [
        ("", "posterior", "poste2ior"),
        ("posterior", "logit_covariance", "logit_covarience"),
        ("fit", "phi", "phy"),
        ("materials.floor", "upper95", "uper95"),
        ("findings[1]", "about", "abuot"),
    ],
)
def test_an_unknown_key_is_refused_and_the_nearest_named(tmp_path, table, key, wrong):
    path = written(tmp_path)
    content = json.loads(path.read_text())
    content["findings"] = [
        {"code": "few-rays", "severity": "warning", "sentence": "A.", "about": {}, "evidence": {}}
    ]
    place = {
        "": content,
        "posterior": content["posterior"],
        "fit": content["fit"],
        "materials.floor": content["materials"]["floor"],
        "findings[1]": content["findings"][0],
    }[table]
    place[wrong] = place.pop(key)
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match="unknown key") as refused:
        read_result(EditedFile(path))
    assert refused.value.found == repr(wrong) and repr(key) in str(refused.value.hint)
    assert str(refused.value.where).endswith(table or "top level")


@pytest.mark.slow
def test_no_changed_byte_of_a_prediction_is_read_as_another(tmp_path, monkeypatch):
    """From end to end: a campaign is identified and predicted, and both answers are damaged."""
    campaign, folder = write_campaign(tmp_path / "room"), tmp_path / "found"
    assert run_command(monkeypatch, "identify", campaign, "--out", folder, "--quick") == 0
    predict_to_folder(campaign, folder / "result.json", tmp_path / "out")

    def prediction(path):
        content, _ = written_content(path, "prediction")
        return {key: whole_text(value) for key, value in content.items() if key in known}

    path = tmp_path / "out" / "predicted.json"
    known = json.loads(path.read_text()).keys() - {"content_sha256"}
    assert read_otherwise(path, prediction)[0] == 0
    assert read_otherwise(folder / "result.json", read_result)[0] == 0
