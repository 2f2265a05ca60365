"""A campaign that is edited says what it said, but for the keys that were set, and keeps its words.

Texts are composed of the forms that TOML has for a table: lines below a head, keys with dots, and
values in braces, with comments, blank lines and values of several lines wherever they may stand.
"""

from __future__ import annotations

import copy
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from roomfit.app import project
from roomfit.base.errors import InputError
from roomfit.base.findings import Edit
from roomfit.files.edits import (
    Preview,
    apply,
    edited_text,
    lines_of,
    preview,
    undo,
    undoable,
    value_text,
    without_tables,
)

NAMES = ("LS1", "R 1", "a.b", "größe", "x#y", "p=q")
names = st.sampled_from(NAMES)
remarks = st.lists(st.sampled_from(["\n", "# one = 1\n", "  # [sources.LS1]\n", "#\n"]), max_size=3)
ends = st.sampled_from(["", "  # by tape", " # [a] = 'b'"])
POSITIONS = ("[1, 2, 3]", "[\n  1, # x\n  # y\n  2,\n  3,\n]", "[1.5, 2, 3] ")


@st.composite
def tables(draw: st.DrawFn, kind: str, key: str, values: tuple[str, ...]) -> str:
    """Return the text of tables of a kind, each with a key, in one of TOML's forms."""
    own = draw(st.lists(names, unique=True, max_size=3))
    form = draw(st.sampled_from(["heads", "dots", "braces"]))
    if not own:
        return ""
    text = "" if form == "heads" else f"[{kind}]{draw(ends)}\n"
    for name in own:
        quoted = value_text({name: 0})[1:-5]
        value = draw(st.sampled_from(values[:1] if form == "braces" else values))
        line = {
            "heads": f"[{kind}.{quoted}]{draw(ends)}\n{key} = {value}",
            "dots": f"{quoted}.{key} = {value}",
            "braces": f"{quoted} = {{ {key} = {value} }}",
        }[form]
        text += f"{''.join(draw(remarks))}{line}{draw(ends)}\n"
    return text


@st.composite
def campaigns(draw: st.DrawFn) -> str:
    parts = [
        "[room]\nshoebox = [6, 5, 3]\n",
        draw(tables("sources", "position", POSITIONS)),
        draw(tables("receivers", "position", POSITIONS)),
        draw(tables("materials", "prior", ('"cork-tiles"', '"""\n# a = 1\n"""', "'''=#'''"))),
        draw(st.sampled_from(["", "[identify]\nfrom_hz = 250 # low\n[identify.design]\nn = 1\n"])),
        draw(st.sampled_from(["", '[[measurements]]\nfile = "a"\n# last\n[[measurements]]\n'])),
    ]
    first = draw(st.sampled_from(["", 'recordings = "{source}_{receiver}.wav" # names\n']))
    text = first + "".join("".join(draw(remarks)) + part for part in draw(st.permutations(parts)))
    text = text if draw(st.booleans()) else text.rstrip("\n")
    return text.replace("\n", draw(st.sampled_from(["\n", "\r\n"])))


def remarks_of(text: str) -> list[str]:
    """Return lines that begin as comments do, in values of several lines as well."""
    return sorted(line.strip() for line in text.splitlines() if line.lstrip().startswith("#"))


def filled(content: Any) -> Any:
    """Return content without empty tables."""
    if not isinstance(content, dict):
        return content
    own = {key: filled(value) for key, value in content.items()}
    return {key: value for key, value in own.items() if value != {}}


def position(content: dict[str, Any], kind: str, name: str) -> None:
    content.setdefault(kind, {}).setdefault(name, {})["position"] = [4.0, 5.0, 6.0]


CHANGES: list[tuple[Callable[[Path, str], None], Callable[[dict[str, Any], str], None]]] = [
    (
        lambda folder, name: project.set_position(folder, "sources", name, (4.0, 5.0, 6.0)),
        lambda content, name: position(content, "sources", name),
    ),
    (
        lambda folder, name: project.set_position(folder, "receivers", name, None),
        lambda content, name: content.get("receivers", {}).pop(name, None),
    ),
    (
        lambda folder, name: project.set_prior(folder, name, "carpet-on-underlay"),
        lambda content, name: (
            content.setdefault("materials", {})
            .setdefault(name, {})
            .update(prior="carpet-on-underlay")
        ),
    ),
    (
        lambda folder, name: project.set_prior(folder, name, None),
        lambda content, name: content.get("materials", {}).get(name, {}).pop("prior", None),
    ),
    (
        lambda folder, _: project.set_bands(folder, 500.0, 2000.0),
        lambda content, _: content.setdefault("identify", {}).update(from_hz=500.0, to_hz=2000.0),
    ),
]


@pytest.mark.slow
@pytest.mark.parametrize(("change", "law"), CHANGES)
@settings(
    max_examples=150,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(text=campaigns(), name=names)
def test_only_what_was_set_is_another_and_every_comment_stays(
    tmp_path: Path,
    change: Callable[[Path, str], None],
    law: Callable[[dict[str, Any], str], None],
    text: str,
    name: str,
) -> None:
    file = project.campaign_file(tmp_path)
    file.write_bytes(text.encode())
    expected = copy.deepcopy(tomllib.loads(text))
    law(expected, name)
    change(tmp_path, name)
    after = file.read_bytes().decode()
    assert filled(tomllib.loads(after)) == filled(expected)
    assert remarks_of(after) == remarks_of(text)


def test_a_point_that_is_placed_leaves_the_comments_of_the_next_table_where_they_are(
    tmp_path: Path,
) -> None:
    """What was written by a package for TOML stood below them, in the table that they lead to."""
    file = project.campaign_file(tmp_path)
    text = "[sources.S1]\nposition = [1, 2, 3]\n\n# receivers\n[receivers.R1]\n# soon\n"
    file.write_text(text)
    project.set_position(tmp_path, "receivers", "R1", (4.0, 3.5, 1.2))
    project.set_position(tmp_path, "sources", "S1", (1.0, 2.0, 3.5))
    assert file.read_text() == (
        "[sources.S1]\nposition = [1.0, 2.0, 3.5]\n\n# receivers\n"
        "[receivers.R1]\nposition = [4.0, 3.5, 1.2]\n# soon\n"
    )


def test_rows_are_told_apart_by_their_number_and_a_key_of_none_stands_first() -> None:
    text = '[[measurements]]\nfile = "a"\n[[measurements]]\nfile = "b"\n[identify]\n'
    edits = [
        Edit(("measurements", 2), "level", "per-file"),
        Edit(("measurements", 3), "file", "c"),
        Edit((), "recordings", "{source}_{receiver}.wav"),
    ]
    after = tomllib.loads(edited_text(text, edits))
    assert after["measurements"] == [
        {"file": "a"},
        {"file": "b", "level": "per-file"},
        {"file": "c"},
    ]
    assert after["recordings"] == "{source}_{receiver}.wav"
    assert lines_of(edits[:2]) == [
        "[[measurements]], no. 2",
        'level = "per-file"',
        "[[measurements]], no. 3",
        'file = "c"',
    ]


def test_tables_are_taken_out_with_what_is_below_them_and_comments_stay():
    text = "# top\n[a]\nx = 1  # of x\n# of b\n[[b]]\ny = 1\n[b.c]\nz = 2\n\n[[b]]\ny = 3\n"
    after = without_tables(text, [("b", 1), ("a",)])
    assert after == "# top\n# of b\n[[b]]\ny = 3\n"
    assert without_tables(text, []) == text


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


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_ends_of_lines_stay_and_the_last_one_may_be_missing(tmp_path: Path, end: str) -> None:
    text = WRITTEN.rstrip("\n").replace("\n", end)
    after = edited_text(text, [Edit(("identify",), "wall_delays", True)])
    assert after == f"{text}{end}wall_delays = true{end}"


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


def test_what_was_shown_is_not_written_over_what_somebody_else_has_written(tmp_path: Path) -> None:
    wanted = remedied(tmp_path, WRITTEN, Edit(("identify",), "positions", "fit"))
    (tmp_path / "campaign.toml").write_text(WRITTEN + "# mine\n")
    with pytest.raises(InputError, match="has changed since"):
        apply(tmp_path / "campaign.toml", wanted)
    assert (tmp_path / "campaign.toml").read_text() == WRITTEN + "# mine\n"
