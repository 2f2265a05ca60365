"""A disk without room for a result is told before the work."""

from __future__ import annotations

import shutil
from typing import NamedTuple

import pytest

from roomfit.base.errors import StoreError
from roomfit.files.results import check_disk_room


class Disk(NamedTuple):
    total: int
    free: int


def with_free(monkeypatch, disk: Disk) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _path: disk)


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
