"""The proof that answers did not change finds what did: canonical contents and their comparison."""

from __future__ import annotations

import importlib
import io
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image
from PIL.PngImagePlugin import PngInfo

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
golden = importlib.import_module("golden")
digests = importlib.import_module("_golden_digests")
silent = importlib.import_module("_silent")

RESULT = {
    "bands_hz": [500.0, 1000.0],
    "materials": {
        "a brick wall": {
            "absorption": [0.1, 0.2],
            "lower95": [0.05, 0.1],
            "upper95": [0.15, 0.4],
            "identifiable": [True, False],
        }
    },
    "findings": [
        {"code": "places-move", "severity": "warning", "sentence": "A place moves by 2 cm."}
    ],
    "fit": {"model": "coherent", "evaluations": 53, "seconds": 1.25, "reasons": ["It is so."]},
    "provenance": {"roomfit": "0.1.0"},
}
TABLE = (
    "material,band_hz,absorption,lower95,upper95,identifiable\n"
    "brick,500,0.10000,0.05000,0.15000,true\n"
)
PAGE = (
    "<dl><dt>roomfit</dt><dd>0.1.0</dd><dt>time</dt><dd>102.5 s</dd><dt>seed</dt><dd>1</dd></dl>\n"
    f"<code>{'0a' * 32}</code>\n<p>T20 is 0.5 s</p>\n"
)


def unchanged(_result) -> None:
    """Leave the result as it is."""


def written(folder: Path, change=unchanged, table: str = TABLE, page: str = PAGE) -> Path:
    """Write what `golden.py run` leaves of one case, its result changed in place."""
    result = json.loads(json.dumps(RESULT))
    change(result)
    raw = folder / "work" / "box"
    raw.mkdir(parents=True)
    (raw / "result.json").write_text(json.dumps(result))
    (raw / "absorption.csv").write_text(table)
    (raw / "report.html").write_text(page)
    (raw / ".cache").mkdir()
    (raw / ".cache" / "trace.json").write_text(json.dumps(str(folder)))
    golden.freeze({"box": raw}, folder)
    return folder


def compared(tmp_path: Path, change=unchanged, **files: str):
    """Return the differences of a run from one that was changed."""
    first = written(tmp_path / "first")
    second = written(tmp_path / "second", change, **files)
    differences, lone = golden.compare_runs(first, second)
    assert not lone
    return {d.file: d for d in differences}


def exit_codes(differences) -> tuple[int, int]:
    """Return the exit code without and with --tolerance."""
    found = list(differences.values())
    return tuple(golden.print_differences(found, [], tolerance=t) for t in (False, True))


def brick(result):
    return result["materials"]["a brick wall"]


def test_times_versions_and_provenance_count_for_nothing(tmp_path):
    def change(result):
        result["fit"]["seconds"] = 9.0
        result["provenance"] = {"roomfit": "0.2.0", "inputs_sha256": {}}

    page = PAGE.replace("0.1.0", "0.2.0").replace("102.5", "7").replace("0a", "1b")
    differences = compared(tmp_path, change, page=page)
    assert differences == {}
    assert exit_codes(differences) == (0, 0)


def test_words_and_counts_are_reported_and_are_no_other_numbers(tmp_path):
    def change(result):
        result["findings"][0].update(code="position-inconsistent", sentence="Moved.")
        result["fit"]["evaluations"] = 435
        result["fit"]["reasons"] = ["Said otherwise.", "And more."]

    differences = compared(tmp_path, change, page=PAGE.replace("T20 is", "The T20 is"))
    assert set(differences) == {"result.json", "report.html"}
    assert not any(d.numbers for d in differences.values())
    assert exit_codes(differences) == (0, 0)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("materials", "a brick wall", "absorption"), [np.nextafter(0.1, 1.0), 0.2]),
        (("materials", "a brick wall", "identifiable"), [True, True]),
        (("bands_hz",), [500.0]),
        (("fit", "model"), "energy"),
        (("fit", "cost"), 3.0),
        (("findings",), []),
    ],
)
def test_a_last_bit_a_flag_a_length_a_model_a_key_and_a_finding_are_other_numbers(
    tmp_path, path, value
):
    def change(result):
        for key in path[:-1]:
            result = result[key]
        result[path[-1]] = value

    differences = compared(tmp_path, change)
    assert set(differences) == {"result.json"}
    assert differences["result.json"].numbers
    # only the last bit of an absorption is within the tolerance
    assert exit_codes(differences) == (1, 0 if path[-1] == "absorption" else 1)


@pytest.mark.parametrize(
    ("name", "off", "allowed"),
    [
        ("absorption", 0.9e-9, True),
        ("absorption", 1.1e-9, False),
        # the interval of the second band is 0.3 wide
        ("lower95", 2.9e-4, True),
        ("lower95", 3.1e-4, False),
        ("upper95", -2.9e-4, True),
        ("upper95", -3.1e-4, False),
    ],
)
def test_the_tolerance_is_of_absorption_and_of_the_interval_s_width(tmp_path, name, off, allowed):
    def change(result):
        brick(result)[name][1] += off

    differences = compared(tmp_path, change)
    fields = differences["result.json"].fields
    (one,) = fields.values()
    assert list(fields) == [f"materials.a brick wall.{name}[]"]
    # two numbers below one, each rounded at 1.1e-16
    assert one.largest == pytest.approx(abs(off), abs=3e-16)
    assert exit_codes(differences) == (1, 0 if allowed else 1)


@pytest.mark.parametrize(("value", "allowed"), [(1000.9, True), (1001.1, False), (None, False)])
def test_other_numbers_may_differ_by_a_thousandth_of_the_largest_of_their_field(
    tmp_path, value, allowed
):
    def change(result):
        result["bands_hz"][1] = value

    assert exit_codes(compared(tmp_path, change)) == (1, 0 if allowed else 1)


@pytest.mark.parametrize(
    ("old", "new", "codes"),
    [
        ("0.10000", "0.10001", (1, 0)),  # the last decimal that is written
        ("0.10000", "0.10002", (1, 1)),
        ("true", "false", (1, 1)),
        ("brick", "stone", (1, 1)),
    ],
)
def test_every_cell_of_a_table_counts(tmp_path, old, new, codes):
    differences = compared(tmp_path, table=TABLE.replace(old, new))
    assert set(differences) == {"absorption.csv"}
    assert exit_codes(differences) == codes


def test_a_file_that_is_gone_is_another_answer(tmp_path):
    first, second = written(tmp_path / "first"), written(tmp_path / "second")
    (second / "contents" / "box" / "absorption.csv.json").unlink()
    differences, _ = golden.compare_runs(first, second)
    assert [(d.file, d.missing) for d in differences] == [("absorption.csv", "second")]
    assert golden.print_differences(differences, [], tolerance=True) == 1


def test_cases_of_one_run_alone_are_an_error_and_not_agreement(tmp_path):
    first, second = written(tmp_path / "first"), tmp_path / "second"
    golden.freeze({}, second)
    differences, lone = golden.compare_runs(first, second)
    assert (differences, lone) == ([], ["box"])
    assert golden.print_differences(differences, lone, tolerance=False) == 1


def test_a_word_that_was_renamed_is_the_same_where_the_table_says_so(tmp_path, monkeypatch):
    def change(result):
        result["priors"] = result["fit"].pop("model")
        result["fit"]["kind"] = "pressures"

    def old(result):
        result["beforehand"] = result["fit"].pop("model")
        result["fit"]["kind"] = "coherent"

    first, second = written(tmp_path / "first", old), written(tmp_path / "second", change)
    assert len(golden.compare_runs(first, second)[0]) == 1
    names = {"beforehand": "priors", "coherent": "pressures"}
    monkeypatch.setattr(golden, "RENAMED", {**names})
    assert golden.compare_runs(first, second)[0] == []


def test_a_picture_is_its_pixels(tmp_path):
    def png(name: str, level: int, software: str) -> Path:
        note, stream = PngInfo(), io.BytesIO()
        note.add_text("Software", software)
        picture = Image.fromarray(np.full((3, 4), level, dtype=np.uint8))
        picture.save(stream, "png", pnginfo=note)
        path = tmp_path / name
        path.write_bytes(stream.getvalue())
        return path

    a, b, c = png("a.png", 7, "one"), png("b.png", 7, "another"), png("c.png", 8, "one")
    assert a.read_bytes() != b.read_bytes()
    whole = [digests.digests_of(digests.read_content(p)) for p in (a, b, c)]
    assert whole[0] == whole[1] != whole[2]
    assert whole[0]["numbers"] is None


def test_all_files_that_are_read_have_digests_and_hidden_ones_do_not_count(tmp_path):
    content = json.loads((written(tmp_path / "run") / "digests.json").read_text())
    files = content["cases"]["box"]
    assert set(files) == {"absorption.csv", "report.html", "result.json"}
    assert files["report.html"]["numbers"] is None
    assert files["result.json"]["numbers"] != files["result.json"]["whole"]


def test_what_functions_return_first_and_last_moves_and_so_does_one_that_runs_no_more():
    """A thousandth of the size; a function that has gone from its module is no difference."""
    with silent.returned(("air", "bands")) as last:
        air = importlib.import_module("roomfit.air")
        bands = importlib.import_module("roomfit.bands")
        octaves = bands.bands_between("octave", 500, 1000)
        bands.bands_between("octave", 125, 250)
        air.attenuation_per_m(air.Air(), octaves)
    kept = silent.sums(last)
    first, then = (kept[f"bands.bands_between{c}"] for c in (", first", ""))
    assert first[1] > 3.0 * then[1]
    # what was called once has one line
    assert "air.attenuation_per_m" in kept and "air.attenuation_per_m, first" not in kept
    assert silent.moved(kept, kept) == []
    number, size, weighed = kept["air.attenuation_per_m"]
    for change, expected in ((0.9e-3, []), (1.1e-3, ["air.attenuation_per_m"])):
        by = change * size
        for other in ([number, size + by, weighed], [number, size, weighed - by]):
            assert silent.moved(kept, {**kept, "air.attenuation_per_m": other}) == expected
    assert silent.moved(kept, {**kept, "air.attenuation_per_m": [number + 1, size, weighed]})
    fewer = {n: v for n, v in kept.items() if not n.startswith("air.attenuation")}
    assert silent.moved(kept, fewer) == ["air.attenuation_per_m"]
    assert silent.moved({**kept, "air.was_there_once": [0, 1.0, 1.0]}, kept) == []


def test_large_numbers_hide_no_small_ones_of_the_same_record():
    """Hertz beside absorption, 0.1 % of which is seen; what is of rounding is left out."""
    name = "air.attenuation_per_m"

    def sums_of(absorption, noise):
        return silent.sums({name: (np.array([8000.0, 16_000.0]), [absorption, noise])})

    kept = sums_of(np.array([0.1, 0.2]), np.array([1e-12]))
    assert silent.moved(kept, sums_of(np.array([0.1, 0.2]), np.array([-3e-12]))) == []
    assert silent.moved(kept, sums_of(np.array([0.1, 0.201]), np.array([1e-12]))) == [name]
    assert silent.moved(kept, sums_of(np.array([0.2, 0.1]), np.array([1e-12]))) == [name]


def test_what_a_picture_is_drawn_of_is_kept_with_its_words():
    """Numbers and words that functions of roomfit hand to axes, but not how they look."""

    def sums_of(code: str):
        axes = Figure().subplots()
        with silent.returned(("bands",)) as last:
            # as a function of a module of roomfit
            exec(f"def picture(axes):\n    {code}", module := {"__name__": "roomfit.made"})
            module["picture"](axes)
        return {n: v for n, v in silent.sums(last).items() if n.startswith("made.")}

    kept = sums_of("axes.plot([1.0, 2.0], label='T30 of 2 bands', color='C1')")
    assert kept["made.picture, drawn"][1] == pytest.approx(3.0)
    assert kept == sums_of("axes.plot([1.0, 2.0], label='T60 of 3 bands', color='C2')")
    for other in ("[2.0, 1.0], label='T30 of 2 bands'", "[1.0, 2.0], label='EDT of 2 bands'"):
        assert kept != sums_of(f"axes.plot({other})")
