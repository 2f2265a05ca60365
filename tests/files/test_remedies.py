"""What a finding advises is derived from its code, what it is about and its evidence."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from roomfit.base.errors import InputError
from roomfit.base.findings import About, Code, Finding
from roomfit.files.campaign import Campaign, read_campaign
from roomfit.files.edits import Edit
from roomfit.files.remedies import Remedy, advice, advised, chosen, remedies, together

ROOM = """
[room]
shoebox = [6, 5, 3]
[sources.S1]
position = [1.5, 1.2, 1.5]
[sources.S2]
position = [1.5, 3.2, 1.5]
position_sd = 0.01
[receivers.R1]
position = [4.0, 3.5, 1.2]
[receivers.R2]
position = [5.0, 3.5, 1.2]
"""
ROWS = "".join(
    f'[[measurements]]\nsource = "{s}"\nreceiver = "{r}"\nfile = "{s}_{r}.wav"\n'
    for s in ("S1", "S2")
    for r in ("R1", "R2")
)


def campaign_of(folder: Path, text: str) -> Campaign:
    file = folder / "campaign.toml"
    file.write_text(text)
    return read_campaign(file, to_fit=False)


def doubt(code: Code, evidence: dict[str, Any] | None = None, **about: Any) -> Finding:
    """Return a finding whose sentence says nothing: a remedy that is read from it is none."""
    return Finding(code, About(**about), "...", evidence or {})


def written(found: tuple[Remedy, ...]) -> list[list[tuple[Any, ...]]]:
    return [[(*e.table, e.key, e.value) for e in one.edits] for one in found]


def test_files_of_another_gain_have_levels_of_their_own_and_the_others_share_theirs(
    tmp_path: Path,
) -> None:
    own = campaign_of(tmp_path, ROOM + ROWS)
    about = {"files": [str(tmp_path / "S1_R2.wav")], "pairs": [("S1", "R2")]}
    found = remedies(doubt(Code.LEVELS_APART, **about), own)
    assert written(found) == [[("measurements", 2, "level", "per-file")]]
    assert found[0].words == 'level = "per-file" for S1_R2.wav'


def test_what_all_recordings_need_stands_once_and_no_row_contradicts_it(tmp_path: Path) -> None:
    own = campaign_of(tmp_path, ROOM + ROWS + 'level = "absolute"\n')
    files = [str(m.response.path) for m in own.measurements]
    found = remedies(doubt(Code.LEVELS_APART, files=files), own)
    assert written(found) == [
        [("defaults", "level", "per-file"), ("measurements", 4, "level", "per-file")]
    ]
    assert found[0].words == 'level = "per-file" for all 4 recordings'


def test_a_file_that_was_found_by_its_name_gets_a_row_of_its_own(tmp_path: Path) -> None:
    for name in ("S1_R1", "S1_R2", "S2_R1"):
        (tmp_path / f"{name}.wav").touch()
    own = campaign_of(tmp_path, 'recordings = "{source}_{receiver}.wav"\n' + ROOM)
    found = remedies(doubt(Code.TIME_ZERO_MISMATCH, files=["elsewhere/S2_R1.wav"]), own)
    assert found == ()
    found = remedies(doubt(Code.TIME_ZERO_MISMATCH, files=["S2_R1.wav"]), own)
    row = [("source", "S2"), ("receiver", "R1"), ("file", "S2_R1.wav"), ("time_zero", "direct")]
    assert written(found) == [[("measurements", 1, *pair) for pair in row]]


def test_of_several_channels_of_a_file_the_one_in_brackets_is_meant(tmp_path: Path) -> None:
    rows = "".join(
        f'[[measurements]]\nsource = "S1"\nreceiver = "R{i}"\nfile = "a.wav"\nchannel = {i}\n'
        for i in (1, 2)
    )
    own = campaign_of(tmp_path, ROOM + rows)
    found = remedies(doubt(Code.TIME_ZERO_MISMATCH, files=[f"{tmp_path / 'a.wav'}[2]"]), own)
    assert written(found) == [[("measurements", 2, "time_zero", "direct")]]


def test_a_latency_is_counted_from_what_the_file_says_and_holds_once(tmp_path: Path) -> None:
    own = campaign_of(tmp_path, ROOM + "[defaults]\nlatency_s = 0.002\n" + ROWS)
    files = [str(m.response.path) for m in own.measurements]
    late, unknown = remedies(doubt(Code.RECORDINGS_LATE, {"late_s": 0.0051}, files=files), own)
    assert late.edits == (Edit(("defaults",), "latency_s", 0.0071),) and late.once
    assert late.words == "latency_s = 0.0071 for all 4 recordings"
    assert unknown.edits == (Edit(("defaults",), "time_zero", "unknown"),) and not unknown.once
    begins = doubt(Code.RECORDINGS_LATE, {"time_zero": "direct"}, files=files)
    assert written(remedies(begins, own)) == [[("defaults", "time_zero", "direct")]]


def test_exchanged_files_change_their_pairs_and_exchanged_points_their_positions(
    tmp_path: Path,
) -> None:
    own = campaign_of(tmp_path, ROOM + ROWS)
    files = [str(tmp_path / name) for name in ("S1_R1.wav", "S2_R2.wav")]
    (one,) = remedies(doubt(Code.EXCHANGED, {"files": files}, files=files), own)
    assert written((one,)) == [
        [
            ("measurements", 1, "source", "S2"),
            ("measurements", 1, "receiver", "R2"),
            ("measurements", 4, "source", "S1"),
            ("measurements", 4, "receiver", "R1"),
        ]
    ]
    (two,) = remedies(doubt(Code.EXCHANGED, {"receivers": ["R1", "R2"]}), own)
    assert written((two,)) == [
        [
            ("receivers", "R1", "position", (5.0, 3.5, 1.2)),
            ("receivers", "R2", "position", (4.0, 3.5, 1.2)),
        ]
    ]
    (three,) = remedies(doubt(Code.EXCHANGED, {"sources": ["S1"], "receivers": ["R2"]}), own)
    assert [e.table for e in three.edits] == [("sources", "S1"), ("receivers", "R2")]
    assert one.once and two.once and three.once


def test_exchanged_files_that_were_found_by_their_names_get_rows_with_the_other_pair(
    tmp_path: Path,
) -> None:
    for name in ("S1_R1", "S1_R2", "S2_R1"):
        (tmp_path / f"{name}.wav").touch()
    own = campaign_of(tmp_path, 'recordings = "{source}_{receiver}.wav"\n' + ROOM)
    files = [str(tmp_path / name) for name in ("S1_R1.wav", "S1_R2.wav")]
    (found,) = remedies(doubt(Code.EXCHANGED, {"files": files}, files=files), own)
    rows: dict[Any, dict[str, Any]] = {}
    for edit in found.edits:
        rows.setdefault(edit.table[1], {})[edit.key] = edit.value
    assert rows == {
        1: {"source": "S1", "receiver": "R2", "file": "S1_R1.wav"},
        2: {"source": "S1", "receiver": "R1", "file": "S1_R2.wav"},
    }


def test_a_source_that_is_not_omnidirectional_is_fitted_unless_its_pattern_is_stated(
    tmp_path: Path,
) -> None:
    finding = doubt(Code.SOURCE_NOT_OMNIDIRECTIONAL, {"source": "S2"})
    own = campaign_of(tmp_path, ROOM)
    assert written(remedies(finding, own)) == [[("sources", "S2", "directivity", "fit")]]
    stated = ROOM.replace("[receivers.R1]", 'directivity = "fit"\n[receivers.R1]')
    assert remedies(finding, campaign_of(tmp_path, stated)) == ()


def test_entries_of_the_catalogue_are_offered_for_materials_of_which_nothing_is_stated(
    tmp_path: Path,
) -> None:
    text = '[products.tile]\n[materials.ceiling]\nproduct = "tile"\n[materials.east]\n'
    own = campaign_of(tmp_path, ROOM + text + 'prior = "carpet-on-underlay"\n')
    entries = {
        "east": ["carpet-on-underlay", "curtain-medium-draped"],
        "floor": ["carpet-on-underlay", "no such entry", "curtain-medium-draped"],
        "ceiling": ["cork-tiles"],
        "west": [],
    }
    found = remedies(doubt(Code.BROAD_PRIOR_ASSUMED, {"entries": entries}), own)
    assert written(found) == [
        [("materials", "floor", "prior", "carpet-on-underlay")],
        [("materials", "floor", "prior", "curtain-medium-draped")],
        [("products", "tile", "prior", "cork-tiles")],
    ]


def test_scattering_is_fitted_or_stated_where_it_is_not_stated_or_0(tmp_path: Path) -> None:
    text = "[materials.walls]\nscattering = 0.0\n[materials.floor]\nscattering = 0.3\n"
    own = campaign_of(tmp_path, ROOM + text)
    evidence = {"materials": ["walls", "floor", "ceiling"], "scattering": 0.15}
    found = remedies(doubt(Code.SCATTERING_UNDERESTIMATED, evidence), own)
    assert written(found) == [
        [("materials", "walls", "scattering", value), ("materials", "ceiling", "scattering", value)]
        for value in ("fit", 0.15)
    ]


def test_standard_deviations_of_positions_are_offered_or_enlarged(tmp_path: Path) -> None:
    own = campaign_of(tmp_path, ROOM)
    evidence = {"points": ["S1", "R1", "R2"], "position_sd_m": 0.02}
    found = remedies(doubt(Code.POSITION_UNCERTAINTY_ASSUMED, evidence), own)
    assert [one.edits[0].value for one in found] == [0.005, 0.01, 0.02, 0.05]
    assert [e.table for e in found[0].edits] == [
        ("sources", "S1"),
        ("receivers", "R1"),
        ("receivers", "R2"),
    ]
    (larger,) = remedies(doubt(Code.POSITION_UNCERTAINTY_INFLATED, {"stretch": 2.5}), own)
    # 2.5 times the 2 cm that are assumed, and the 1 cm that are stated
    assert [e.value for e in larger.edits] == [0.05, 0.025, 0.05, 0.05] and larger.once


@pytest.mark.parametrize(
    ("code", "key", "value"),
    [
        (Code.POSITION_INCONSISTENT, "positions", "fit"),
        (Code.REFLECTION_DELAY_DETECTED, "wall_delays", True),
    ],
)
def test_what_was_excluded_is_fitted(tmp_path: Path, code: Code, key: str, value: object) -> None:
    found = remedies(doubt(code), campaign_of(tmp_path, ROOM))
    assert written(found) == [[("identify", key, value)]]


def test_what_stands_there_already_is_not_advised(tmp_path: Path) -> None:
    own = campaign_of(tmp_path, ROOM + '[identify]\npositions = "fit"\n')
    assert remedies(doubt(Code.POSITION_INCONSISTENT), own) == ()


def test_coordinates_in_another_unit_are_converted_with_the_room_or_without(
    tmp_path: Path,
) -> None:
    own = campaign_of(tmp_path, ROOM)
    feet = doubt(Code.COORDINATES_SCALED, {"factor": 0.3048, "unit": "ft"})
    both, alone = remedies(feet, own)
    points = [
        ("sources", "S1", "position", (0.4572, 0.3658, 0.4572)),
        ("sources", "S2", "position", (0.4572, 0.9754, 0.4572)),
        ("receivers", "R1", "position", (1.2192, 1.0668, 0.3658)),
        ("receivers", "R2", "position", (1.524, 1.0668, 0.3658)),
    ]
    assert written((both,)) == [[("room", "unit", "ft"), *points]]
    assert written((alone,)) == [points] and both.once and alone.once
    metres = doubt(Code.COORDINATES_SCALED, {"factor": 1.0 / 0.3048, "unit": "m"})
    (one,) = remedies(metres, own)  # the room is not read as feet
    assert one.edits[0] == Edit(("sources", "S1"), "position", (4.9213, 3.937, 4.9213))
    # a sampling rate, the temperature, or a drawing: the arrivals do not tell which
    assert remedies(doubt(Code.COORDINATES_SCALED, {"factor": 1.04}), own) == ()


def test_receivers_that_are_displaced_together_are_moved_and_a_single_point_is_opened(
    tmp_path: Path,
) -> None:
    own = campaign_of(tmp_path, ROOM)
    by = {"receivers": ["R1", "R2"], "metres": 0.5, "shift_m": [0.3, -0.4, 0.0]}
    (one,) = remedies(doubt(Code.DISPLACEMENT_DETECTED, by), own)
    assert written((one,)) == [
        [
            ("receivers", "R1", "position", (4.3, 3.1, 1.2)),
            ("receivers", "R2", "position", (5.3, 3.1, 1.2)),
        ]
    ]
    assert one.once and one.words == "R1, R2 moved by (+0.30, -0.40, +0.00) m"
    alone = doubt(Code.DISPLACEMENT_DETECTED, {"source": "S2", "metres": 0.254})
    assert written(remedies(alone, own)) == [[("sources", "S2", "position_sd", 0.25)]]
    far = doubt(Code.DISPLACEMENT_DETECTED, {"source": "S2", "metres": 1.4})
    assert remedies(far, own) == ()


@pytest.mark.parametrize(
    ("what", "expected"),
    [
        (
            "all positions",
            [("groups", "everything", "members", ("*",)),
             ("groups", "everything", "sd", (0.0, 0.25, 0.0))],
        ),
        ("length", [("room", "lengths_sd", (0.1, 0.25, 0.02))]),
        ("array", [("groups", "array", "sd", (0.05, 0.25, 0.05))]),
        (
            "wall",
            [("groups", "everything", "members", ("*",)),
             ("groups", "everything", "sd", (0.0, 0.25, 0.0)),
             ("room", "lengths_sd", (0.1, 0.25, 0.02))],
        ),
    ],
)  # fmt: skip
def test_what_early_reflections_find_displaced_is_fitted_within_its_size(
    tmp_path: Path, what: str, expected: list[tuple[Any, ...]]
) -> None:
    """24 cm with a standard deviation of 7 cm: 25 cm, along y; along the others as it was."""
    text = ROOM.replace("[sources.S1]", "lengths_sd = [0.1, 0.05, 0.02]\n[sources.S1]")
    own = campaign_of(tmp_path, text + '[groups.array]\nmembers = ["R*"]\nsd = 0.05\n')
    evidence = {"what": what, "axis": "y", "metres": -0.24, "sd_m": 0.07}
    assert written(remedies(doubt(Code.DISPLACEMENT_DETECTED, evidence), own)) == [expected]


def test_lines_that_are_shown_are_those_that_are_written_and_choices_have_numbers(
    tmp_path: Path,
) -> None:
    own = campaign_of(tmp_path, ROOM)
    found = [doubt(Code.POSITION_UNCERTAINTY_ASSUMED, {"points": ["S1", "R1"]})]
    code = Code.POSITION_UNCERTAINTY_ASSUMED
    shown = advice(found, own)[code]
    assert shown == [
        f"# {code}:1, position_sd = 0.005 for S1, R1",
        "[sources.S1]",
        "position_sd = 0.005",
        "[receivers.R1]",
        "position_sd = 0.005",
        f"# or {code}:2, position_sd = 0.01 for S1, R1",
        f"# or {code}:3, position_sd = 0.02 for S1, R1",
        f"# or {code}:4, position_sd = 0.05 for S1, R1",
    ]
    options = advised(found, own)
    assert chosen(options, f"{code}:3") is options[code][2]
    assert chosen(options, str(code)) is options[code][0]
    for wrong in ("levels-apart", f"{code}:5", f"{code}:0", f"{code}:x"):
        with pytest.raises(InputError, match=rf"(?s)no finding advises this.*{code}:1 to {code}:4"):
            chosen(options, wrong)
    own.path.unlink()
    assert advice(found, own) == {}, "an answer is not lost with its campaign"


@pytest.mark.parametrize("code", [Code.COORDINATES_SCALED, Code.DECAY_BENT])
def test_a_finding_that_nothing_written_can_help_has_no_remedy(tmp_path: Path, code: Code) -> None:
    assert remedies(doubt(code, {"factor": 0.3048}), campaign_of(tmp_path, ROOM)) == ()


def test_findings_that_say_one_thing_of_several_files_are_one(tmp_path: Path) -> None:
    own = campaign_of(tmp_path, ROOM + ROWS)
    each = [
        doubt(
            Code.TIME_ZERO_MISMATCH,
            files=[str(m.response.path)],
            pairs=[(m.source, m.receiver)],
        )
        for m in own.measurements
    ]
    whole = together(each)
    assert whole is not None
    assert written(remedies(whole, own)) == [[("defaults", "time_zero", "direct")]]
    assert together(each[:1]) is None
    assert (
        together([doubt(Code.EXCHANGED, files=["a"]), doubt(Code.EXCHANGED, files=["b"])]) is None
    )


def test_files_of_one_name_in_two_folders_are_told_apart_by_their_pairs(tmp_path: Path) -> None:
    rows = "".join(
        f'[[measurements]]\nsource = "S{i}"\nreceiver = "R1"\nfile = "{i}/a.wav"\n' for i in (1, 2)
    )
    own = campaign_of(tmp_path, ROOM + rows)
    about = {"files": ["a.wav"], "pairs": [("S2", "R1")]}
    found = remedies(doubt(Code.LEVEL_UNKNOWN, **about), own)
    assert written(found) == [[("measurements", 2, "level", "per-file")]]


def test_unlike_latencies_stay_unlike(tmp_path: Path) -> None:
    own = campaign_of(tmp_path, ROOM + ROWS + "latency_s = 0.001\n")
    files = [str(m.response.path) for m in own.measurements]
    late = remedies(doubt(Code.RECORDINGS_LATE, {"late_s": 0.002}, files=files), own)[0]
    assert [e.value for e in late.edits] == [0.002, 0.002, 0.002, 0.003]
    assert late.words == "latency_s for all 4 recordings"


def test_what_is_stated_otherwise_is_left_as_it_is(tmp_path: Path) -> None:
    """A pattern from a file, a standard deviation, a clock that says nothing."""
    text = ROOM.replace("position_sd = 0.01", 'position_sd = 0.01\ndirectivity = "S2.sofa"')
    own = campaign_of(tmp_path, text + ROWS + 'time_zero = "unknown"\n')
    assert remedies(doubt(Code.SOURCE_NOT_OMNIDIRECTIONAL, {"source": "S2"}), own) == ()
    assert remedies(doubt(Code.POSITION_UNCERTAINTY_ASSUMED, {"points": ["S2"]}), own) == ()
    last = str(tmp_path / "S2_R2.wav")
    assert remedies(doubt(Code.TIME_ZERO_MISMATCH, files=[last]), own) == ()
