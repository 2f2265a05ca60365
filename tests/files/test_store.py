"""Writing leaves the old file or the new one, never half of one."""

from __future__ import annotations

import json
import os

import pytest

from roomfit.base.whole_files import (
    write_bytes_atomically,
    write_json_atomically,
    write_text_atomically,
)


def test_a_file_is_replaced_whole_and_nothing_is_left_beside_it(tmp_path):
    target = tmp_path / "a.txt"
    write_text_atomically(target, "old")
    write_bytes_atomically(target, b"new")
    assert target.read_text() == "new"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def test_who_has_the_old_file_open_or_under_another_name_keeps_it(tmp_path):
    path, other = tmp_path / "a.json", tmp_path / "b.json"
    path.write_bytes(b"old content")
    os.link(path, other)
    with path.open("rb") as reader:
        write_bytes_atomically(path, b"new")
        assert reader.read() == b"old content"
    assert other.read_bytes() == b"old content"
    assert path.read_bytes() == b"new"


def test_content_that_cannot_be_written_leaves_the_old_file(tmp_path):
    target = tmp_path / "a.json"
    write_json_atomically(target, {"x": 1})
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json_atomically(target, {"x": float("nan")})
    assert json.loads(target.read_text())["x"] == 1
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]
