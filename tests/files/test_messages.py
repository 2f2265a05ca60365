"""What is refused says what was found, what is needed and what to try."""

from __future__ import annotations

import numpy as np
import pytest

from roomfit.base.air import Air
from roomfit.base.arguments import float_array, int_array, unique_names
from roomfit.base.bands import Bands, bands_between
from roomfit.base.errors import InputError, located
from roomfit.batch.rooms import shard_of
from roomfit.files.campaign import read_campaign
from roomfit.files.draft import read_positions
from roomfit.files.iso3382 import read_parameters
from roomfit.files.responses import ResponseSpec, read_response
from roomfit.files.results import read_materials as read_table
from roomfit.files.reverberation import read_decay_times
from roomfit.files.rooms import read_model
from roomfit.files.rooms.model import PolygonSpec, RoomSpec
from roomfit.impedance.campaign import read_spectrum
from roomfit.predict.changes import read_change
from roomfit.room.build import build_mesh
from roomfit.room.scene import scene_of, shoebox_room, with_states
from roomfit.settings import Settings
from roomfit.signals.iso3382 import MeasuredValues
from roomfit.signals.measurement import Measurement

GEO = "PLANES\n[1 floor / 4 3 2 / brick]\nCORNERS\n1 0 0 0\n2 1 0 0\n3 0 1 0\n"
HEAD = "material,band_hz,absorption,lower95,upper95,identifiable\n"
ISO = "source,receiver,parameter,500,1000\n"
CAMPAIGN = (
    "format_version = 1\n[room]\nshoebox = [5, 4, 3]\n"
    "[sources.S]\nposition = [1, 1, 1]\n[receivers.R]\nposition = [2, 2, 1]\n"
)

# Ending of the file, its content, what is wrong, found and needed, each as words of the message.
ROOMS = [
    (".obj", "v 0 0\n", "three coordinates", "v 0 0", "v x y z"),
    (".obj", "v 0 0 0\n", "no faces", "1 vertices", '"f"'),
    (".geo", "TRANSLATE 1 0 0\n" + GEO, "without OBJECT", "no line OBJECT", "OBJECT"),
    (".geo", "OFFSETCO 1.5\n" + GEO, "whole number", "1.5", "OFFSETCO"),
    (".geo", GEO + "loop(4, i, 0, 3, 0, i, 0, 0)\n", "no step", "0 to 3 by 0", "10000"),
    (".geo", GEO + "4 width 0 0\n", "not defined", "width", "none"),
    (".geo", GEO + "4 x(9) 0 0\n", "no corner", "9", "1, 2, 3"),
    (".geo", GEO + "4 x(1,2) 0 0\n", "x() needs", "x(1,2)", "1 of them"),
    (".geo", GEO + "4 1/0 0 0\n", "no value", "1/0", "finite"),
    (".geo", GEO + "4 lock(1,2,3) lock(1,2,3) 0\n", "more than one lock", "2 of them", "one at"),
]  # fmt: skip


def refusal(call, *arguments) -> InputError:
    with pytest.raises(InputError) as caught:
        call(*arguments)
    return caught.value


def check_complete(error, what, found, needed) -> None:
    """Each part is there and says what it must; what to try is a sentence of several words."""
    assert what in error.what
    assert error.found and found in error.found, error
    assert error.needed and needed in error.needed, error
    assert error.hint and len(error.hint.split()) > 2, error


@pytest.mark.parametrize(("suffix", "content", "what", "found", "needed"), ROOMS)
def test_a_room_file_that_is_refused_says_found_needed_and_what_to_try(
    tmp_path, suffix, content, what, found, needed
):
    file = tmp_path / f"room{suffix}"
    file.write_text(content, encoding="utf-8")
    error = refusal(read_model, RoomSpec(file=file, unit="m"))
    check_complete(error, what, found, needed)
    assert str(file) in str(error.where)


@pytest.mark.parametrize(
    ("corners", "planes", "what", "found", "needed"),
    [
        ("1,0,0,0\n,1,0,0\n", "1,1,2,3\n", "corner without a number", "1, 0, 0", "number of its"),
        ("1,0,0,0\n1,1,0,0\n", "1,1,2,3\n", "corner is given twice", "1", "once"),
        ("", "1,1,2,3\n", "no corners", "heading alone", "number, x, y, z"),
        ("1,0,0,0\n", ",1,2,3\n", "plane without a number", "1, 2, 3", "number of its"),
        ("1,0,0,0\n", "1,1,2,3\n1,1,2,3\n", "plane is given twice", "1", "once"),
        ("1,0,0,0\n", "", "no planes", "heading alone", "three corners"),
    ],
)
def test_tables_of_corners_and_planes_that_are_refused_do_so_as_well(
    tmp_path, corners, planes, what, found, needed
):
    corner_file, plane_file = tmp_path / "corners.csv", tmp_path / "planes.csv"
    corner_file.write_text("number,x,y,z\n" + corners, encoding="utf-8")
    plane_file.write_text("number,corner 1,corner 2,corner 3\n" + planes, encoding="utf-8")
    spec = RoomSpec(polygons=PolygonSpec((corner_file,), (plane_file,)))
    check_complete(refusal(read_model, spec), what, found, needed)


@pytest.mark.parametrize(
    ("read", "content", "what", "found", "needed"),
    [
        (read_parameters, "source,receiver,parameter\nS,R,T30\n", "bands", "parameter", "fourth"),
        (read_parameters, ISO + ",R,T30,1,1\n", "without source", ",R,T30", "source,receiver"),
        (read_parameters, ISO + "S,R,T30,much,1\n", "not a number", "'much'", "a number, or an"),
        (read_parameters, ISO, "without values", "1 line", "lines of values"),
        (read_parameters, ISO + "S,R,T30_sd,-1,1\nS,R,T30,1,1\n", "below zero", "-1", "0 or more"),
        (read_decay_times, "name,500\nA,1.0,2.0\n", "more decay times", "2", "1, one for each"),
        (read_decay_times, "name,500\nA,long\n", "not a number", "'long'", "a time in s"),
        (read_decay_times, "name,500\n", "without values", "1 line", "a line of centres"),
        (read_positions, "# nothing\n", "is empty", "no line", "name, x, y, z"),
        (read_table, HEAD + "brick,500,a lot,0.1,0.2,true\n", "a number", "'a lot'", "a number"),
        (read_table, HEAD + "brick,500,0.1,0.1\n", "not a number", "''", "a number"),
    ],
)  # fmt: skip
def test_tables_of_numbers_that_are_refused_do_so_as_well(
    tmp_path, read, content, what, found, needed
):
    file = tmp_path / "table.csv"
    file.write_text(content, encoding="utf-8")
    check_complete(refusal(read, file), what, found, needed)


def test_a_cell_that_is_no_number_is_named_by_row_and_column(tmp_path):
    file = tmp_path / "absorption.csv"
    row = "brick,500,0.1,0.1,0.2,true\n"
    file.write_text(HEAD + row + row.replace("500,0.1,0.1", "1000,0.1,,"), encoding="utf-8")
    assert "column lower95 of row 2" in str(refusal(read_table, file).where)
    file = tmp_path / "times.csv"
    file.write_text("name,500,1000\nA,1.0,1.0\nB,1.0,one\n", encoding="utf-8")
    assert "line 3, column 3" in str(refusal(read_decay_times, file).where)


@pytest.mark.parametrize(
    ("line", "where", "found", "needed"),
    [
        ("[objects.people]\nabsorption_area_m2 = -1", "absorption_area_m2", "-1", "0 or more"),
        ("[materials.wall]\nabsorption = [0.1, 2]", "absorption[2]", "2", "1 or less"),
        ("[sources.T]\nposition = [1, 1]", "sources.T.position", "[1, 1]", "3 values or more"),
        ("[sources.T]", "sources.T", "no such key", "'position'"),
        ('[air]\ntemperature_c = "warm"', "air.temperature_c", "'warm'", "a valid number"),
    ],
)
def test_a_campaign_that_is_refused_does_so_as_well(tmp_path, line, where, found, needed):
    file = tmp_path / "campaign.toml"
    file.write_text(f"{CAMPAIGN}{line}\n", encoding="utf-8")
    error = refusal(read_campaign, file)
    check_complete(error, "campaign file", found, needed)
    assert str(error.where).endswith(where)


def test_checks_of_arrays_names_and_meshes_do_so_as_well(tmp_path):
    check_complete(refusal(int_array, "hits", [0.5], (None,)), "whole", "float64", "integers")
    check_complete(refusal(unique_names, "source", ["S", ""]), "without a name", "''", "one letter")
    check_complete(refusal(build_mesh, np.zeros((0, 3)), ()), "no faces", "of 0", "at least four")
    rew = tmp_path / "response.txt"
    rew.write_text("0 // Peak value before normalisation\n", encoding="utf-8")
    assert "REW" in refusal(read_response, ResponseSpec(rew)).what


def test_what_to_try_of_the_place_gives_way_to_that_of_the_error():
    """The place is put before an inner one, and left out where there is none."""
    with pytest.raises(InputError) as caught, located("a.csv", hint="look there"):
        raise InputError("wrong", where="line 3")
    assert (caught.value.where, caught.value.hint) == ("a.csv, line 3", "look there")
    with pytest.raises(InputError) as caught, located(hint="look there"):
        raise InputError("wrong", hint="better")
    assert (caught.value.where, caught.value.hint) == (None, "better")


def _spectrum(**arrays):
    return lambda folder: (
        np.savez(folder / "s.npz", **arrays),
        read_spectrum(folder / "s.npz"),
    )


BOX = shoebox_room((5, 4, 3), {"walls": "plaster"})
# What is asked for, what was found and what to try, each as words of the message.
CURES = [
    (lambda _: Air(humidity_percent=-40.0), "-40 %", "is 40 meant, without the sign?"),
    (lambda _: Air(temperature_c=293.0), "293 degrees C", "nearest that is accepted: 50 degrees"),
    (lambda _: Air(attenuation="iso9631"), "'iso9631'", "did you mean 'iso9613'?"),
    (lambda _: float_array("absorption", [0.1, 35.0], (2,), low=0, high=1), "35", "divide by 100"),
    (lambda _: float_array("delay", [np.nan], (1,)), "nan", "replace it by a finite number"),
    (lambda _: float_array("table", np.ones((2, 3)), (3, 2)), "(2, 3)", "transpose it"),
    (lambda _: float_array("rows", [[1.0], [1.0, 2.0]], (2, 2)), "inhomogeneous", "equal length"),
    (lambda _: unique_names("source", ["S", "S"]), "'S'", "rename one of them"),
    (lambda _: unique_names("source", ["S\u2028"]), "U+2028", "type the name anew"),
    (lambda _: bands_between("octave", 10.0, 20.0), "10 to 20 Hz", "widen it, as 31.5 to"),
    (lambda _: Bands("octave", np.array([60.0])), "60 Hz", "63 Hz and not 60 Hz"),
    (lambda _: Bands("octave", np.array([500.0, 250.0])), "[500.0, 250.0]", "sort them"),
    (lambda _: Settings(method="annealling"), "'annealling'", "did you mean 'annealing'?"),
    (lambda _: Measurement("S", "R", np.ones(9), None), "without a rate", "give sampling_rate_hz"),
    (lambda _: with_states(BOX, {"closed": {"north": ""}}), "''", "name it after what is seen"),
    (lambda _: scene_of(BOX, {"S": (1, 1, 1)}, {}), "none", "give scene_of one of each"),
    (lambda _: read_change("floor"), "'floor'", "floor=0.3"),
    (lambda _: shard_of((), (3, 2)), "3/2", "--shard 1/2"),
    (_spectrum(f=[100.0], tau=0.1), "f, tau", "store one of the two"),
    (_spectrum(f=[100.0], tau=0.1, p=np.ones(1)), "float64", "under the name magnitude"),
    (_spectrum(f=[100.0], tau=[0.1, 0.2], magnitude=[1.0]), "(2,)", "one spectrum a file"),
]


@pytest.mark.parametrize(("ask", "found", "cure"), CURES)
def test_a_refusal_shows_what_it_met_what_it_takes_and_a_cure(tmp_path, ask, found, cure):
    with pytest.raises(InputError) as refused:
        ask(tmp_path)
    error = refused.value
    assert found in (error.found or ""), str(error)
    assert error.needed, str(error)
    assert cure in (error.hint or ""), str(error)
    assert f"  try     {error.hint}" in str(error)


def test_a_spread_of_a_parameter_without_values_is_not_called_unknown():
    with pytest.raises(InputError, match="a spread without its value") as refused:
        MeasuredValues("S", "R", np.array([500.0]), {}, {"T30_s": np.ones(1)})
    assert refused.value.found == "'T30_s'"
