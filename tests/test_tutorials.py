"""The tutorials, as a user walks them: every block runs, and prints what the page says."""

from __future__ import annotations

import contextlib
import io
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[1] / "docs"
PAGES = sorted(DOCS.glob("tutorial-*.md"))
BLOCK = re.compile(r"^```(sh|python|text)\n(.*?)^```$", re.M | re.S)


def walked(page: str, folder: Path):
    """Yield for every block of output what the page says and what was printed before it."""
    program = folder / "roomfit"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m roomfit "$@"\n')
    program.chmod(0o755)
    environment = {**os.environ, "PATH": f"{folder}:{os.environ['PATH']}", "MPLBACKEND": "Agg"}
    printed, names = "", {"__name__": "__main__"}
    for kind, block in BLOCK.findall(page):
        if kind == "text":
            yield block, printed
        elif kind == "sh":
            done = subprocess.run(
                ["bash", "-euc", block], cwd=folder, env=environment, capture_output=True, text=True
            )
            assert done.returncode == 0, f"{block}\n{done.stdout}\n{done.stderr}"
            printed = done.stdout
        else:
            with contextlib.redirect_stdout(io.StringIO()) as stream, contextlib.chdir(folder):
                exec(compile(block, "tutorial", "exec"), names)
            printed = stream.getvalue()


def missing(said: str, printed: str) -> list[str]:
    """Return the lines of a page that were not printed in this order; ``...`` leaves lines out."""
    rest, lost = iter([" ".join(line.split()) for line in printed.split("\n")]), []
    for line in filter(None, (" ".join(line.split()) for line in said.split("\n"))):
        if line != "..." and line not in rest:
            lost.append(line)
    return lost


def test_a_line_that_is_not_printed_or_not_in_this_order_is_missed():
    assert missing("a  b\n...\nc\n", "a b\nx\nc\n") == []
    assert missing("c\na b\n", "a b\nc\n") == ["a b"]
    assert missing("a 0.25\n", "a 0.26\n") == ["a 0.25"]


@pytest.mark.slow
@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_a_tutorial_prints_what_its_page_says(path, tmp_path):
    if path.stem != "tutorial-hall-owner":
        pytest.importorskip("pyroomacoustics")
    page = path.read_text(encoding="utf-8")
    shown = [(said, missing(said, printed), printed) for said, printed in walked(page, tmp_path)]
    assert len(shown) >= 3
    for said, lost, printed in shown:
        assert not lost, f"{lost} of\n{said}\nis not in\n{printed}"


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_a_number_in_the_words_of_a_tutorial_stands_in_its_blocks(path):
    """So that no sentence keeps a figure that its page prints no longer."""
    page = path.read_text(encoding="utf-8")
    blocks = " ".join(block for _, block in BLOCK.findall(page))
    words = re.sub(r"`[^`]*`", "", BLOCK.sub("", page))
    figures = set(re.findall(r"\d+\.\d+", words))
    assert figures <= set(re.findall(r"\d+\.\d+", blocks))


def test_there_are_three_walks():
    assert {p.stem for p in PAGES} == {
        f"tutorial-{who}" for who in ("consultant", "hall-owner", "researcher")
    }
