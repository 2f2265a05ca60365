"""What a remedy writes into a campaign: shown before, nothing else changed, undone byte by byte."""

from __future__ import annotations

from pathlib import Path

import pytest

from roomfit.base.errors import InputError
from roomfit.base.findings import Edit
from roomfit.files.edits import Preview, apply, preview, undo, undoable

WRITTEN = """# of my room
[room]
shoebox = [6, 5, 3]

[sources.S1]
position = [1.5, 1.2, 1.5]  # by tape

# receivers, by laser
[receivers."R 1"]
position = [4.0, 3.5, 1.2]

[identify]
positions = "fixed"  # for now
"""


def remedied(folder: Path, text: str, *edits: Edit) -> Preview:
    (folder / "campaign.toml").write_text(text)
    return preview(folder / "campaign.toml", edits)


def test_a_remedy_changes_its_keys_and_keeps_comments_and_order(tmp_path: Path) -> None:
    wanted = remedied(
        tmp_path,
        WRITTEN,
        Edit(("sources", "S1"), "directivity", "fit"),
        Edit(("receivers", "R 1"), "position", (4.0, 3.0, 1.25)),
        Edit(("identify",), "positions", "fit"),
        Edit(("materials", "walls"), "prior", "cork-tiles"),
        Edit(("materials", "walls"), "scattering", 0.1),
    )
    expected = WRITTEN.replace("# by tape\n", '# by tape\ndirectivity = "fit"\n')
    expected = expected.replace("[4.0, 3.5, 1.2]", "[4.0, 3.0, 1.25]")
    expected = expected.replace('"fixed"', '"fit"')
    expected += '\n[materials.walls]\nprior = "cork-tiles"\nscattering = 0.1\n'
    assert wanted.after == expected
    assert wanted.lines[:2] == (
        ("[sources.S1]", "not stated", 'directivity = "fit"'),
        ('[receivers."R 1"]', "position = [4.0, 3.5, 1.2]", "position = [4.0, 3.0, 1.25]"),
    )
    assert (tmp_path / "campaign.toml").read_text() == WRITTEN, "a preview writes nothing"
    assert [p.name for p in tmp_path.iterdir()] == ["campaign.toml"]


def test_rows_of_measurements_are_changed_by_their_number_and_new_ones_come_last(
    tmp_path: Path,
) -> None:
    row = '\n[[measurements]]\nsource = "S1"\nreceiver = "R 1"\nfile = "{}.wav" # {}\n'
    text = WRITTEN + row.format("a", 1) + "\n# the other\n" + row.format("b", 2)
    new = {"source": "S1", "receiver": "R 1", "file": "c.wav", "level": "per-file"}
    wanted = remedied(
        tmp_path,
        text,
        Edit(("measurements", 1), "level", "per-file"),
        *[Edit(("measurements", 3), key, value) for key, value in new.items()],
    )
    added = "".join(f'{key} = "{value}"\n' for key, value in new.items())
    expected = text.replace("# 1\n", '# 1\nlevel = "per-file"\n')
    assert wanted.after == f"{expected}\n[[measurements]]\n{added}"
    assert wanted.lines[0] == ("[[measurements]], no. 1", "not stated", 'level = "per-file"')


def test_a_campaign_that_cannot_be_edited_key_by_key_is_refused_and_stays(tmp_path: Path) -> None:
    text = WRITTEN + "[materials]\nwalls = {scattering = 0.1}\n"
    edit = Edit(("materials", "walls"), "prior", "cork-tiles")
    assert "cork-tiles" in remedied(tmp_path, text, edit).after
    edit = Edit(("materials", "floor"), "prior", "cork-tiles")
    inline = "materials = {walls = {scattering = 0.1}}\n" + WRITTEN
    assert '{prior = "cork-tiles"}' in remedied(tmp_path, inline, edit).after
    several = 'states = [\n  {name = "empty"},\n]\n' + WRITTEN
    with pytest.raises(InputError, match=r"cannot edit(?s:.*)\[\[states\]\]"):
        remedied(tmp_path, several, Edit(("states", 1), "name", "full"))
    assert (tmp_path / "campaign.toml").read_text() == several


def test_a_remedy_can_be_undone_byte_by_byte_and_only_while_nobody_edits(tmp_path: Path) -> None:
    file = tmp_path / "campaign.toml"
    assert undoable(tmp_path / "campaign.toml") is None
    wanted = remedied(tmp_path, WRITTEN, Edit(("identify",), "positions", "fit"))
    apply(tmp_path / "campaign.toml", wanted)
    assert file.read_text() == wanted.after and undoable(tmp_path / "campaign.toml")
    undo(tmp_path / "campaign.toml")
    assert file.read_text() == WRITTEN and undoable(tmp_path / "campaign.toml") is None
    assert [p.name for p in tmp_path.iterdir()] == ["campaign.toml"]
    with pytest.raises(InputError, match="nothing can be undone"):
        undo(tmp_path / "campaign.toml")
    apply(tmp_path / "campaign.toml", wanted)
    file.write_text(wanted.after + "# mine\n")
    assert undoable(tmp_path / "campaign.toml") is None
    with pytest.raises(InputError, match="nothing can be undone"):
        undo(tmp_path / "campaign.toml")
    assert file.read_text() == wanted.after + "# mine\n"
