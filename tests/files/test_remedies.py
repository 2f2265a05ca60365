"""What a finding advises becomes lines of one campaign, in the tables where values stand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile

from roomfit.base.errors import InputError
from roomfit.base.findings import About, Code, Edit, Finding, Remedy
from roomfit.cli import main
from roomfit.files.campaign import Campaign, read_campaign
from roomfit.files.remedies import advice, advised, chosen

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
CODE = Code.LEVELS_APART


def campaign_of(folder: Path, text: str) -> Campaign:
    file = folder / "campaign.toml"
    file.write_text(text)
    return read_campaign(file, to_fit=False)


def doubt(*remedies: Remedy, pairs: Any = ()) -> Finding:
    return Finding(CODE, About(pairs=pairs), "...", remedies=remedies)


def of_files(key: str, value: object, *files: object, **more: Any) -> Remedy:
    return Remedy([Edit(("measurements", str(f)), key, value, **more) for f in files])


def options(own: Campaign, *findings: Finding, **more: Any) -> list[Remedy]:
    return list(advised(findings, own, **more).get(CODE, ()))


def written(found: list[Remedy]) -> list[list[tuple[Any, ...]]]:
    return [[(*e.table, e.key, e.value) for e in one.edits] for one in found]


def files_of(own: Campaign) -> list[Path]:
    return [m.response.path for m in own.measurements]


def test_what_all_recordings_need_stands_once_and_no_row_contradicts_it(tmp_path: Path) -> None:
    own = campaign_of(tmp_path, ROOM + ROWS + 'level = "absolute"\n')
    found = options(own, doubt(of_files("level", "per-file", *files_of(own))))
    assert written(found) == [
        [("defaults", "level", "per-file"), ("measurements", 4, "level", "per-file")]
    ]
    assert found[0].words == 'level = "per-file" for all 4 recordings'
    one = options(own, doubt(of_files("level", "per-file", "S1_R2.wav")))
    assert written(one) == [[("measurements", 2, "level", "per-file")]]
    assert one[0].words == 'level = "per-file" for S1_R2.wav'


def test_a_file_that_was_found_by_its_name_gets_a_row_of_its_own(tmp_path: Path) -> None:
    for name in ("S1_R1", "S1_R2", "S2_R1"):
        (tmp_path / f"{name}.wav").touch()
    own = campaign_of(tmp_path, 'recordings = "{source}_{receiver}.wav"\n' + ROOM)
    assert options(own, doubt(of_files("time_zero", "direct", "elsewhere/S2_R1.wav"))) == []
    found = options(own, doubt(of_files("time_zero", "direct", "S2_R1.wav")))
    row = [("source", "S2"), ("receiver", "R1"), ("file", "S2_R1.wav"), ("time_zero", "direct")]
    assert written(found) == [[("measurements", 1, *pair) for pair in row]]


def test_recordings_are_told_apart_by_channel_and_by_pair(tmp_path: Path) -> None:
    rows = "".join(
        f'[[measurements]]\nsource = "S{i}"\nreceiver = "R1"\nfile = "a.wav"\nchannel = {i}\n'
        for i in (1, 2)
    )
    own = campaign_of(tmp_path, ROOM + rows)
    direct = of_files("time_zero", "direct", f"{tmp_path / 'a.wav'}[2]")
    assert written(options(own, doubt(direct))) == [[("measurements", 2, "time_zero", "direct")]]
    alone = of_files("time_zero", "direct", "a.wav")
    found = options(own, doubt(alone, pairs=[("S1", "R1")]))
    assert written(found) == [[("measurements", 1, "time_zero", "direct")]]


def test_a_latency_is_counted_from_what_the_file_says(tmp_path: Path) -> None:
    own = campaign_of(tmp_path, ROOM + "[defaults]\nlatency_s = 0.002\n" + ROWS)
    late = of_files("latency_s", 0.0051, *files_of(own), how="add")
    (found,) = options(own, doubt(late))
    assert written([found]) == [[("defaults", "latency_s", 0.0071)]]
    assert found.words == "latency_s = 0.0071 for all 4 recordings"
    own = campaign_of(tmp_path, ROOM + ROWS + "latency_s = 0.001\n")
    (found,) = options(own, doubt(of_files("latency_s", 0.002, *files_of(own), how="add")))
    assert [e.value for e in found.edits] == [0.002, 0.002, 0.002, 0.003]
    assert found.words == "latency_s for all 4 recordings"


def test_positions_are_moved_and_scaled_and_uncertainties_stay_within_a_metre(
    tmp_path: Path,
) -> None:
    own = campaign_of(tmp_path, ROOM)
    moved = Remedy([Edit(("receivers", "R1"), "position", (0.3, -0.4, 0.0), "add")], "moved")
    assert written(options(own, doubt(moved))) == [
        [("receivers", "R1", "position", (4.3, 3.1, 1.2))]
    ]
    every = [Edit((kind, "*"), "position_sd", 60.0, "scale") for kind in ("sources", "receivers")]
    (larger,) = options(own, doubt(Remedy(every, "larger")))
    # of the 2 cm that are assumed, and the 1 cm that is stated
    assert [e.value for e in larger.edits] == [1.0, 0.6, 1.0, 1.0]


def test_what_is_stated_otherwise_or_already_or_is_not_there_is_left_as_it_is(
    tmp_path: Path,
) -> None:
    text = ROOM.replace("position_sd = 0.01", 'position_sd = 0.01\ndirectivity = "S2.sofa"')
    own = campaign_of(tmp_path, text + '[identify]\npositions = "fit"\n')
    edits = (
        Edit(("sources", "S2"), "directivity", "fit", now=("omni",)),
        Edit(("sources", "S2"), "position_sd", 0.02, now=(None,)),
        Edit(("sources", "S9"), "position_sd", 0.02),
        Edit(("identify",), "positions", "fit"),
    )
    assert options(own, *(doubt(Remedy([edit])) for edit in edits)) == []


def test_findings_that_say_one_thing_of_several_files_are_one(tmp_path: Path) -> None:
    own = campaign_of(tmp_path, ROOM + ROWS)
    each = [doubt(of_files("time_zero", "direct", file)) for file in files_of(own)]
    whole, *alone = options(own, *each)
    assert written([whole]) == [[("defaults", "time_zero", "direct")]]
    assert len(alone) == 4


def test_what_counts_from_earlier_values_is_no_remedy_of_a_changed_campaign(tmp_path: Path) -> None:
    own = campaign_of(tmp_path, ROOM)
    edit = [Edit(("sources", "S1"), "position", (1.0, 0.0, 0.0), "add")]
    finding = doubt(Remedy(edit, "moved", once=True))
    assert len(options(own, finding)) == 1
    assert options(own, finding, changed=True) == []


def test_lines_that_are_shown_are_those_that_are_written_and_choices_have_numbers(
    tmp_path: Path,
) -> None:
    own = campaign_of(tmp_path, ROOM)
    points = (("sources", "S1"), ("receivers", "R1"))
    sds = (0.005, 0.01, 0.05)
    found = [doubt(*(Remedy([Edit(p, "position_sd", sd) for p in points]) for sd in sds))]
    assert advice(found, own)[CODE] == [
        f"# {CODE}:1, position_sd = 0.005 for S1, R1",
        "[sources.S1]",
        "position_sd = 0.005",
        "[receivers.R1]",
        "position_sd = 0.005",
        f"# or {CODE}:2, position_sd = 0.01 for S1, R1",
        f"# or {CODE}:3, position_sd = 0.05 for S1, R1",
    ]
    every = advised(found, own)
    assert chosen(every, f"{CODE}:3") is every[CODE][2]
    assert chosen(every, str(CODE)) is every[CODE][0]
    for wrong in ("exchanged", f"{CODE}:4", f"{CODE}:0", f"{CODE}:x"):
        with pytest.raises(InputError, match=rf"(?s)no finding advises this.*{CODE}:1 to {CODE}:3"):
            chosen(every, wrong)
    own.path.unlink()
    assert advice(found, own) == {}, "an answer is not lost with its campaign"


def test_a_channel_that_was_not_chosen_is_chosen_by_a_remedy(tmp_path, capsys):
    """Of all recordings at once, whichever it is; the command names it, and no channel is taken."""
    own = campaign_of(tmp_path, ROOM + ROWS)
    rng = np.random.default_rng(1)
    for file in files_of(own):
        decay = rng.normal(size=(12_000, 2)) * np.exp(-np.arange(12_000) / 1600.0)[:, None]
        soundfile.write(file, np.vstack([np.zeros((200, 2)), decay]), 16_000, subtype="FLOAT")
    with pytest.raises(SystemExit):
        main(["check", str(own.path)])
    assert "--remedy recording-unusable:1" in " ".join(capsys.readouterr().err.split())
    main(["check", str(own.path), "--remedy", "recording-unusable:2"])
    chosen_now = read_campaign(own.path, to_fit=False).measurements
    assert [m.response.channel for m in chosen_now] == [1] * 4
