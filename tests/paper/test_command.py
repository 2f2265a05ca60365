"""``roomfit paper`` from end to end."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

COMMAND = (sys.executable, "-m", "roomfit", "paper", "--out")


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that one run with one seed leaves behind."""
    folder = tmp_path_factory.mktemp("paper") / "out"
    done = subprocess.run(
        [*COMMAND, str(folder), "--seeds", "1"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "reconstructed" in done.stdout
    return folder


@pytest.fixture(scope="module")
def content(written: Path) -> dict[str, Any]:
    """paper.json of that run."""
    parsed: dict[str, Any] = json.loads((written / "paper.json").read_text())
    return parsed


@pytest.mark.slow
def test_paper_json_holds_what_the_paper_says(content: dict[str, Any]) -> None:
    """Arrivals and Table 2 beside the printed ones."""
    assert content["arrivals_ms"] == content["arrivals_ms_paper"]
    assert len(content["table2"]) == 20
    assert set(content["table2"][0]) == {"alpha1", "alpha2", "paper", "ours"}
    assert content["table2_max_relative_error"] <= 0.015


@pytest.mark.slow
def test_searches_find_and_proofs_hold_the_truth_of_every_problem(content: dict[str, Any]) -> None:
    """Annealing finds all; every problem has one region near the lowest error, and one minimum."""
    annealed = [s for s in content["searches"] if s["method"] == "annealing"]
    assert [s["problem"] for s in annealed] == list(content["truth"])
    assert all(s["found"] == 1 and s["largest_error"] <= 0.005 for s in annealed)
    for name, truth in content["truth"].items():
        proof = content["certified"][name]
        (only,) = proof["clusters"]
        assert proof["complete"] and only["unique"]
        assert np.all(np.array(only["lower"]) <= truth) and np.all(truth <= np.array(only["upper"]))


@pytest.mark.slow
def test_the_table_and_pictures_lie_beside_it(written: Path) -> None:
    names = {p.name for p in written.iterdir()}
    pictures = {f"figure{i}.png" for i in (2, 3, 4, 5)}
    # the list of what roomfit wrote, by which it may be replaced
    assert names == {"paper.json", "table2.csv", ".roomfit-files", *pictures}
    assert len((written / "table2.csv").read_text().splitlines()) == 21
    for name in pictures:
        data = (written / name).read_bytes()
        assert data[:8] == b"\x89PNG\r\n\x1a\n" and len(data) > 20_000
