"""The one door for files: regular files, limits, and a process that may die."""

from __future__ import annotations

import os
import socket
import sys
from pathlib import Path

import numpy as np
import pytest

from roomfit.base.door import LIMITS, limit, read_bytes
from roomfit.base.errors import InputError
from roomfit.base.table import Table, csv_of
from roomfit.files.campaign import read_campaign
from roomfit.files.directivity import read_directivity
from roomfit.files.encoding import one_line
from roomfit.files.exports import catt_text
from roomfit.files.responses import read_response
from roomfit.files.results import read_materials
from roomfit.files.rooms import read_mesh
from roomfit.files.schema import ResponseSpec, RoomSpec

POSIX = pytest.mark.skipif(sys.platform == "win32", reason="pipes and devices of POSIX")


def special(folder: Path, kind: str, name: str) -> Path:
    path = folder / name
    match kind:
        case "pipe":
            os.mkfifo(path)
        case "device":
            path = Path("/dev/zero")
        case "link to a device":
            path.symlink_to("/dev/zero")
        case "folder":
            path.mkdir()
        case "socket":
            # the name of a socket must be short
            os.chdir(folder)
            socket.socket(socket.AF_UNIX).bind(name)
        case "link to nothing":
            path.symlink_to(folder / "nothing")
    return path


@POSIX
@pytest.mark.parametrize(
    "kind", ["pipe", "device", "link to a device", "folder", "socket", "link to nothing"]
)
def test_only_regular_files_are_read(tmp_path, kind, monkeypatch):
    """A pipe would be waited for, a device has no end."""
    monkeypatch.chdir(tmp_path)
    path = special(tmp_path, kind, "a")
    with pytest.raises(InputError, match=r"regular file|does not exist") as refused:
        read_bytes(path, "file")
    word = kind.removeprefix("link to ").replace("nothing", "not exist")
    assert word in str(refused.value)


@POSIX
@pytest.mark.parametrize(
    "read",
    [
        lambda path: read_mesh(RoomSpec(file=path.with_suffix(".obj"), unit="m")),
        lambda path: read_mesh(RoomSpec(file=path.with_suffix(".dxf"), unit="m")),
        lambda path: read_mesh(RoomSpec(file=path.with_suffix(".glb"), unit="m")),
        lambda path: read_response(ResponseSpec(path.with_suffix(".wav"))),
        lambda path: read_response(ResponseSpec(path.with_suffix(".sofa"))),
        lambda path: read_directivity(path.with_suffix(".sofa"), None),
        lambda path: read_materials(path.with_suffix(".csv")),
        lambda path: read_campaign(path.with_suffix(".toml")),
    ],
)
def test_every_reader_refuses_a_pipe(tmp_path, read):
    for ending in (".obj", ".dxf", ".glb", ".wav", ".sofa", ".csv", ".toml"):
        os.mkfifo(tmp_path / f"a{ending}")
    with pytest.raises(InputError, match="a pipe"):
        read(tmp_path / "a")


def test_outlines_that_cross_each_other_are_refused_before_they_take_minutes(tmp_path):
    """100 polygons of 99 corners each took a minute: every piece is cut by many others."""
    rng = np.random.default_rng(1)
    lines, faces = [], []
    for polygon in range(100):
        corners = rng.uniform(0.0, 5.0, (99, 2)).round(6)
        lines += [f"v {x} {y} {0.05 * polygon}" for x, y in corners]
        faces.append("f " + " ".join(str(99 * polygon + k + 1) for k in range(99)))
    file = tmp_path / "crossing.obj"
    file.write_text("\n".join([*lines, *faces]))
    with pytest.raises(InputError, match=r"pairs of faces(?s:.*)crossings=NUMBER"):
        read_mesh(RoomSpec(file=file, unit="m"))


def test_a_file_beyond_a_limit_is_refused_with_the_limits_name(tmp_path, monkeypatch):
    (tmp_path / "a").write_bytes(b"x" * 100)
    monkeypatch.setenv("ROOMFIT_LIMITS", "file_bytes=99")
    with pytest.raises(InputError, match=r"100 bytes(?s:.*)at most 99(?s:.*)file_bytes=NUMBER"):
        read_bytes(tmp_path / "a", "file")
    monkeypatch.setenv("ROOMFIT_LIMITS", "faces=7, file_bytes=1e2")
    assert read_bytes(tmp_path / "a", "file") == b"x" * 100
    assert limit("faces") == 7.0
    assert limit("corners") == LIMITS["corners"][0]


def test_the_table_on_the_page_is_that_of_the_code():
    page = (Path(__file__).parents[2] / "docs" / "campaign-file.md").read_text(encoding="utf-8")
    for name, (most, text) in LIMITS.items():
        assert f"| `{name}` | {most:,.0f} | {text} |" in page


def test_no_name_becomes_a_formula_or_a_statement(tmp_path):
    names = ["=1+1", "+x", "-x", "@x", "'=1", "plain", "\tx", "-0.5"]
    rows = [
        line for line in csv_of(Table("", ["name"], [[n] for n in names])).split("\n")[1:] if line
    ]
    assert rows == ["'=1+1", "'+x", "'-x", "'@x", "''=1", "plain", "'\tx", "-0.5"]
    head = ["material", "band_hz", "absorption", "lower95", "upper95", "identifiable"]
    values = ["500", "0.3", "0.2", "0.4", "true"]
    path = tmp_path / "absorption.csv"
    path.write_text(csv_of(Table("", head, [[name, *values] for name in names[:6]])))
    assert list(read_materials(path)[0].names) == names[:6]
    hostile = "wall\r\nINCLUDE evil\x0b\x85\u2028\x1aabs x = <1 1 1 1 1 1>"
    table = np.full((1, 8), 0.3)
    text = catt_text({hostile: "wall"}, table, table, [f"remark of {hostile}"])
    assert len(text.splitlines()) == 2
    assert one_line("a\x1b[2J\nb") == "a?[2J b"
