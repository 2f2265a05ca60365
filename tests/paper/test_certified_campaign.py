"""``method = "certified"`` in a campaign: what is proven, specified and refused."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import roomfit
from roomfit.files.inputs import identify_arguments
from small_campaign import write_campaign

# one band, and one material known, so that two absorptions and a gain are left
CHANGES = (
    ("to_hz = 1000", 'to_hz = 500\nmethod = "certified"'),
    ("[materials.tiles]\n", "[materials.tiles]\nabsorption = 0.3\n"),
)


@pytest.mark.slow
def test_auto_proves_what_is_affordable(tmp_path: Path) -> None:
    """Two materials and a gain: energies are certified, and the answer's distance is reported."""
    changes = (("to_hz = 1000", 'to_hz = 500\nmodel = "energy"'), *CHANGES[1:])
    path = write_campaign(tmp_path / "in", *changes)
    answer = roomfit.identify(**roomfit.load_campaign(path))
    assert answer.method == "least-squares"
    roomfit.write_result(tmp_path, answer, (path,))
    proof = json.loads((tmp_path / "result.json").read_text())["fit"]["certified"]
    assert proof["status"] == "certified"
    assert "energies" in proof["objective"]
    (band,) = proof["bands"]
    assert band["delta"] >= 0.25
    best = np.array(proof["clusters"][0]["minimiser"][:2])
    assert band["distance"] == pytest.approx(np.max(np.abs(best - answer.absorption[:2, 0])))
    assert band["distance"] < 0.2 * np.max((answer.upper95 - answer.lower95)[:2])


def test_certificates_of_pressures_and_room_parameters_are_refused(tmp_path: Path) -> None:
    """Told at once, before anything is traced."""
    change = ("to_hz = 1000", 'to_hz = 500\nmethod = "certified"\nmodel = "coherent"')
    campaign = roomfit.read_campaign(write_campaign(tmp_path, change))
    with pytest.raises(roomfit.InputError, match="a certificate exists for energies"):
        roomfit.identify(**identify_arguments(campaign))


def test_an_identification_loads_the_global_search_only_where_it_is_asked_for() -> None:
    """No module that a fit imports imports it."""
    code = (
        "import sys, roomfit.identify; "
        "print([m for m in sys.modules if m.startswith('roomfit.paper')])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
