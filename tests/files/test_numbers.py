"""Every number of a campaign file: absurd ones are refused with a reason, none makes it fail."""

from __future__ import annotations

import json
import math
import warnings
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from number_limits import ELSEWHERE, limits, table
from roomfit.base.errors import InputError, RoomfitError
from roomfit.design.campaign import design_arguments
from roomfit.design.candidates import Region, grid_positions
from roomfit.files.campaign import read_campaign
from roomfit.files.inputs import identify_arguments
from roomfit.impedance.campaign import impedance_arguments
from small_campaign import write_campaign

DOCS = Path(__file__).parents[2] / "docs" / "campaign-file.md"
ABSURD = (0, -1, math.nan, math.inf, -math.inf, 1e300, -1e300, 1e-300, 10**30)

GOOD: dict[str, Any] = {
    "format_version": 1,
    "room": {
        "shoebox": [3.9, 3.1, 2.5],
        "materials": {"walls": "walls", "floor": "carpet", "ceiling": "tiles"},
        "lengths_sd": [0.1, 0.1, 0.1],
    },
    "air": {"temperature_c": 20.0},
    "materials": {
        "walls": {"scattering": {"centres_hz": [500, 1000], "values": [0.1, 0.2]}},
        "carpet": {"prior": {"mean": 0.3, "sd": 0.1}, "bounds": [0.1, 0.9], "scattering": 0.1},
        "tiles": {"product": "panel"},
    },
    "products": {"panel": {"sd": 0.3, "prior": {"mean": 0.3, "sd": 0.1}, "bounds": [0.1, 0.9]}},
    "loudspeakers": {"box": {"b_sd": 0.5}},
    "sources": {"LS1": {"position": [1.0, 1.2, 1.1]}},
    "receivers": {"MP1": {"position": [2.9, 2.2, 1.3]}, "MP2": {"position": [3.1, 0.9, 1.6]}},
    "states": [],
    "groups": {"all": {"members": ["*"], "sd": 0.1}},
    "measurements": [
        {"source": "LS1", "receiver": "MP1", "file": "LS1_MP1.wav"},
        {"source": "LS1", "receiver": "MP2", "file": "LS1_MP2.wav"},
    ],
    "identify": {"from_hz": 500, "to_hz": 1000},
    "settings": {},
    "impedance": {},
    "design": {},
    "speech": {"level_dba": 60.0},
}
# places that need something beside them
INSTEAD: dict[str, Any] = {
    "sources.NAME.directivity.b": {"aim": [1, 0, 0], "b": 0.5},
    "sources.NAME.directivity.b_sd": {"aim": [1, 0, 0], "b": 0.5, "b_sd": 0.1},
    "sources.NAME.directivity.aim": {"aim": [1, 0, 0], "b": 0.5},
    "sources.NAME.directivity.up": {"loudspeaker": "box", "aim": [1, 0, 0], "up": [0, 0, 1]},
}
LISTS = {
    **{key: [1.0, 0.8, 1.0] for key in ("sources.NAME.position", "receivers.NAME.position")},
    **{key: [0.5, 0.5, 0.5] for key in ("room.shoebox", "room.lengths_sd")},
    **{key: [0.2, 0.9] for key in ("materials.NAME.bounds", "products.NAME.bounds")},
    **{key: [[1.0, 1.0, 1.0]] for key in ("design.sources", "design.receivers")},
    **{key: [1.0, 1.5] for key in ("design.source_heights_m", "design.receiver_heights_m")},
    "design.region_m": [[0.5, 0.5, 0.5], [3.0, 2.0, 2.0]],
    "materials.NAME.scattering.centres_hz": [500.0, 1000.0],
    "materials.NAME.scattering.values": [0.1, 0.2],
    "materials.NAME.absorption.centres_hz": [500.0, 1000.0],
    "materials.NAME.absorption.values": [0.1, 0.2],
    "materials.NAME.prior.centres_hz": [500.0, 1000.0],
    "products.NAME.prior.centres_hz": [500.0, 1000.0],
    "objects.NAME.absorption_area_m2.centres_hz": [500.0, 1000.0],
    "objects.NAME.absorption_area_m2.values": [1.0, 2.0],
    "objects.NAME.prior.centres_hz": [500.0, 1000.0],
    "objects.NAME.outlines": [[[1.0, 0.8, 0.0], [2.0, 0.8, 0.0], [2.0, 2.0, 0.0]]],
    "sources.NAME.directivity.aim": [1.0, 0.0, 0.0],
    "sources.NAME.directivity.up": [0.0, 0.0, 1.0],
    "identify.bands": [500.0, 1000.0],
    "room.polygons.drop": [3],
    "speech.noise_db": [40.0] * 7,
}


def toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(k)} = {toml(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    return json.dumps(value) if isinstance(value, str) else repr(value)


def with_first(value: Any, number: float) -> Any:
    """Return a list with its innermost first number replaced."""
    return [with_first(value[0], number), *value[1:]] if isinstance(value, list) else number


def written(folder: Path, place: str, number: float) -> Path:
    """Write the good campaign with a number at its place, first of its list."""
    content = deepcopy(GOOD)
    if place in INSTEAD:
        content["sources"]["LS1"]["directivity"] = deepcopy(INSTEAD[place])
    parts = place.split(".")
    own = {
        "materials": "walls" if "scattering" in place else "carpet",
    }
    if place.startswith("room.polygons"):
        content["room"] = {"polygons": {"corners": ["a.csv"], "planes": ["b.csv"]}}
    if ".absorption" in place:
        content["materials"]["carpet"].pop("prior")
    if ".absorption." in place:
        at_frequencies = {"centres_hz": [500.0, 1000.0], "values": [0.1, 0.2]}
        content["materials"]["carpet"]["absorption"] = at_frequencies
    if place.endswith("prior.centres_hz"):
        at_frequencies = {"mean": [0.3, 0.3], "sd": [0.1, 0.1]}
        content["materials"]["carpet"]["prior"].update(at_frequencies)
        content["products"]["panel"]["prior"].update(at_frequencies)
    if place.startswith("objects"):
        content["objects"] = {"people": {"prior": {"mean": 1.0, "sd": 0.5}}}
    if place.startswith("objects.NAME.absorption_area_m2"):
        by_frequency = {"centres_hz": [500.0, 1000.0], "values": [1.0, 2.0]}
        content["objects"] = {"people": {"absorption_area_m2": by_frequency}}
    if place == "objects.NAME.prior.centres_hz":
        content["objects"]["people"]["prior"] = {"mean": [1.0, 1.0], "sd": [0.5, 0.5]}
    if place.startswith("reverberation"):
        content["reverberation"] = {"file": "a.csv"}
    if place.endswith("scattering"):
        content["materials"]["walls"] = {}
    inner: Any = content
    for before, part in zip(["", *parts[:-2]], parts[:-1], strict=True):
        if part == "NAME":
            part = own.get(before, next(iter(inner), "NAME"))
        inner = inner.setdefault(part, {}) if isinstance(inner, dict) else inner[0][part]
    last = parts[-1] if parts[-1] != "NAME" else "r0"
    inner = inner[0] if isinstance(inner, list) else inner
    inner[last] = with_first(LISTS[place], number) if place in LISTS else number
    path = folder / "campaign.toml"
    path.write_text("\n".join(f"{key} = {toml(v)}" for key, v in content.items()))
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("numbers")
    write_campaign(made)
    (made / "a.csv").write_text("number,x,y,z\n1,0,0,0\n2,1,0,0\n3,0,1,0\n4,0,0,1\n")
    faces = ("1,3,2", "1,2,4", "2,3,4", "1,4,3")
    (made / "b.csv").write_text("\n".join(f"{i},m,1,{f}" for i, f in enumerate(faces)))
    return made


@pytest.mark.parametrize("place", sorted(limits()))
def test_an_absurd_number_is_refused_or_taken_but_nothing_fails(folder: Path, place: str) -> None:
    """Up to the point where a fit would begin, without a warning of any library."""
    for number in ABSURD:
        path = written(folder, place, number)
        arguments: Any = identify_arguments
        if place.startswith(("design", "impedance.", "materials.NAME.impedance")):
            arguments = design_arguments if place.startswith("design") else impedance_arguments
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                arguments(read_campaign(path))
        except RoomfitError as error:
            assert isinstance(error, InputError), (number, error)
            reported = [error.where, error.found, error.needed, error.hint]
            assert error.where and sum(map(bool, reported)) > 1, (number, str(error))


def test_every_number_has_limits_with_a_reason_and_they_are_documented() -> None:
    for place, (low, high, why) in limits().items():
        if place not in ELSEWHERE:
            assert low is not None and high is not None and why, place
            assert -1e9 <= low < high <= 2**63, place
    text = DOCS.read_text(encoding="utf-8")
    missing = [row for row in table() if row not in text]
    assert not missing, "run python tests/helpers/number_limits.py:\n" + "\n".join(missing)


@pytest.mark.parametrize(
    ("table", "keys", "words"),
    [
        ("impedance", {"step_hz": 0.1, "to_hz": 20000}, r"199000(?s:.*)0 to 5000"),
        ("design", {"grid_m": 0.1, "wall_distance_m": 0.01}, r"at most 20000(?s:.*)wider spacing"),
    ],
)
def test_grids_of_too_many_points_are_refused(folder: Path, table: str, keys, words: str) -> None:
    content = deepcopy(GOOD) | {table: keys}
    (folder / "grid.toml").write_text("\n".join(f"{k} = {toml(v)}" for k, v in content.items()))
    campaign = read_campaign(folder / "grid.toml")
    with pytest.raises(InputError, match=words):
        if table == "impedance":
            impedance_arguments(campaign)
        else:
            arguments = design_arguments(campaign)
            region = Region(np.zeros(3), np.array([20.0, 20.0, 2.0]))
            grid_positions(arguments["scene"].room, region, arguments["options"].grid_m)
