"""A disk without room for a result is told before the work."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import NamedTuple

import pytest

from roomfit.errors import StoreError
from roomfit.io.results import check_disk_room
from roomfit.prediction.campaign import WantedPairs
from roomfit.predictions import predict_to_folder
from small_campaign import ABSORPTION, run_command, write_campaign


class Disk(NamedTuple):
    total: int
    free: int


def absorption_table(folder: Path) -> Path:
    rows = [f"{m},{f},{a},{a},{a},true" for m, a in ABSORPTION.items() for f in (500, 1000)]
    heading = "material,band_hz,absorption,lower95,upper95,identifiable"
    table = folder / "absorption.csv"
    table.write_text("\n".join([heading, *rows]) + "\n")
    return table


def with_free(monkeypatch, disk: Disk) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _path: disk)


@pytest.mark.parametrize("command", ["identify", "batch", "predict", "predict without positions"])
def test_a_disk_without_room_is_told_before_the_work_and_nothing_is_written(
    tmp_path, monkeypatch, capsys, command
):
    """One megabyte is free, and a result takes more; nothing is traced or fitted before."""

    def worked(*_arguments, **_named):
        raise AssertionError("the work has begun")

    for place in ("identification.identify", "prediction.predict.predict"):
        monkeypatch.setattr(f"roomfit.{place}", worked)
    monkeypatch.setattr("roomfit.prediction.diffuse.predict_field", worked)
    with_free(monkeypatch, Disk(10**12, 10**6))
    campaign, table = write_campaign(tmp_path / "campaign"), absorption_table(tmp_path)
    if "without" in command:
        (tmp_path / "t.csv").write_text("name,500,1000\nA,0.6,0.6\n")
        campaign.write_text(
            'format_version = 1\n[room]\nshoebox = [5, 4, 3]\n[reverberation]\nfile = "../t.csv"\n'
        )
    more = ("--absorption", table) if command == "predict" else ()
    before = sorted(tmp_path.rglob("*"))
    words = (command.split()[0], campaign, *more, "--out", tmp_path / "out")
    assert run_command(monkeypatch, *words) == 2
    shown = capsys.readouterr().err
    assert "the disk has no room for the result" in shown and "1.0 MB free" in shown, shown
    assert "needed  about" in shown and "try     make room" in shown
    assert sorted(tmp_path.rglob("*")) == before


def test_a_map_of_many_points_asks_for_no_room_for_pictures_that_are_not_drawn(
    tmp_path, monkeypatch
):
    """Some 250 points: 20 kB each, where 200 kB would be 50 MB."""

    class BegunError(Exception):
        """Raised in place of the work."""

    def begun(**named):
        assert 200 < len(named["scene"].pairs) < 300
        raise BegunError

    monkeypatch.setattr("roomfit.prediction.predict.predict", begun)
    with_free(monkeypatch, Disk(10**12, 10**7))
    campaign, table = write_campaign(tmp_path / "campaign"), absorption_table(tmp_path)
    with pytest.raises(BegunError):
        predict_to_folder(campaign, table, tmp_path / "out", wanted=WantedPairs(grid_m=(1.2, 0.2)))


def test_the_room_that_a_result_needs_grows_with_pairs_and_results(tmp_path, monkeypatch):
    """To the byte on either side; a disk that tells nothing, or fails to, is not refused."""
    needed = 3 * 1_500_000 + 10 * 200_000
    with_free(monkeypatch, Disk(10**12, needed))
    check_disk_room(tmp_path / "new" / "out", 10, 3)
    with_free(monkeypatch, Disk(10**12, needed - 1))
    with pytest.raises(StoreError, match=r"(?s)6\.5 MB free.*about 6\.5 MB"):
        check_disk_room(tmp_path / "new" / "out", 10, 3)
    with_free(monkeypatch, Disk(0, 0))
    check_disk_room(tmp_path, 10)

    def fails(_path: object) -> Disk:
        raise OSError(38, "not implemented")

    monkeypatch.setattr(shutil, "disk_usage", fails)
    check_disk_room(tmp_path, 10)
