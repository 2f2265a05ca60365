"""What is kept of a run: found again by what it depends on, never broken, never in the way."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import shared_cache
from roomfit.base.air import Air
from roomfit.base.cache import (
    CACHE_FOLDER,
    BrokenRecordError,
    Cache,
    cache_files,
    cached,
    check_output_folder,
    digest,
    limited,
    load_record,
    make_room,
    save_record,
    user_cache,
    whole_output_folder,
)
from roomfit.base.errors import InputError
from roomfit.base.findings import Code
from roomfit.fit.trace_plan import cached_trace
from roomfit.materials.priors import uniform_scattering
from roomfit.room.mesh import shoebox_mesh
from roomfit.room.scene import Point, Scene, room_from_mesh
from roomfit.tracing.paths import TraceSettings
from roomfit.tracing.trace import trace
from small_campaign import ABSORPTION, write_campaign


@dataclass(frozen=True, eq=False)
class Sheet:
    """A record to keep."""

    name: str
    numbers: np.ndarray
    inner: Sheet | None = None


values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_nan=False)
    | st.text(max_size=5)
    | st.binary(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3)
    ),
    max_leaves=6,
)


def specified_apart(value: object) -> str:
    """Another road to equality of kind and value: Python's own text of it."""
    if isinstance(value, dict):
        return f"{{{sorted((k, specified_apart(v)) for k, v in value.items())}}}"
    if isinstance(value, list):
        return f"[{[specified_apart(v) for v in value]}]"
    return f"{type(value).__name__} {value!r}"


@pytest.mark.slow
@given(values, values)
def test_digests_are_equal_for_equal_values_and_for_no_others(one, other):
    assert (digest(one) == digest(other)) == (specified_apart(one) == specified_apart(other))


def test_a_digest_tells_shape_and_type_of_an_array_apart():
    row = np.arange(6.0)
    kinds = (row, row.reshape(2, 3), row.reshape(3, 2), row.astype(np.float32), row.tolist())
    assert len({digest(k) for k in kinds}) == len(kinds)
    assert digest(row.reshape(2, 3).T) == digest(np.ascontiguousarray(row.reshape(2, 3).T))
    assert digest(Sheet("a", row)) != digest(Sheet("b", row))


def test_a_record_comes_back_as_it_was(tmp_path):
    sheet = Sheet("a", np.array([[1, 2]], dtype=np.uint16), Sheet("b", np.array([np.nan, -0.0])))
    path = tmp_path / "a.npz"
    save_record(path, (sheet, {"x": [1, 2.5, None, True]}))
    back, table = load_record(path, (Sheet,))
    assert (back.name, back.inner.name, back.inner.inner) == ("a", "b", None)
    assert back.numbers.dtype == np.uint16
    assert back.numbers.tobytes() == sheet.numbers.tobytes()
    assert back.inner.numbers.tobytes() == sheet.inner.numbers.tobytes()
    assert table == {"x": (1, 2.5, None, True)}
    with pytest.raises(BrokenRecordError, match="Sheet"):
        load_record(path, ())


def test_every_altered_or_missing_byte_that_matters_is_found_out(tmp_path):
    """A byte turned anywhere, or the file cut anywhere, gives an error or the same record."""
    sheet = Sheet("a", np.arange(40.0))
    path = tmp_path / "a.npz"
    save_record(path, sheet)
    whole = path.read_bytes()
    refused = 0
    rng = np.random.default_rng(5)
    for place in rng.permutation(len(whole))[:300]:
        altered = bytearray(whole)
        altered[place] ^= 0xFF
        for content in (bytes(altered), whole[:place]):
            path.write_bytes(content)
            try:
                back = load_record(path, (Sheet,))
            except BrokenRecordError:
                refused += 1
                continue
            assert back.name == "a"
            np.testing.assert_array_equal(back.numbers, sheet.numbers)
    # every cut, and every byte turned but those of dates and the like that zip files carry
    assert refused > 450


def box_scene() -> Scene:
    mesh = shoebox_mesh((4.0, 3.0, 2.5))
    room = room_from_mesh(mesh, {s.name: "walls" for s in mesh.surfaces}, (4.0, 3.0, 2.5))
    return Scene(
        room,
        (Point("S", np.array([1.0, 1.0, 1.0])),),
        (Point("R", np.array([3.0, 2.0, 1.5])),),
        np.array([[0, 0]]),
        Air(),
    )


SETTINGS = TraceSettings(duration_s=0.1, n_rays=500, image_order=2, seed=3)


def same_paths(one, other) -> bool:
    names = ("pair", "length_m", "weight_per_m2", "hits_specular", "hits_diffuse", "batch")
    names += ("departure", "arrival", "sampling_scattering")
    return all(getattr(one, n).tobytes() == getattr(other, n).tobytes() for n in names)


def test_a_trace_is_found_again_with_the_same_bits_and_only_for_the_same_scene(tmp_path):
    scene, cache = box_scene(), Cache(tmp_path / "cache")
    scattering = uniform_scattering(scene.room.materials, 0.2)
    first = cached_trace(scene, SETTINGS, scattering, cache)
    again = cached_trace(scene, SETTINGS, scattering, cache)
    assert (first.found, again.found) == (False, True)
    assert same_paths(first.value.paths, again.value.paths)
    assert same_paths(trace(scene, SETTINGS, scattering).paths, again.value.paths)
    assert again.value.statistics.n_hits == first.value.statistics.n_hits
    moved = Scene(
        scene.room,
        (Point("S", np.array([1.0, 1.0, 1.0 + 1e-12])),),
        scene.receivers,
        scene.pairs,
        scene.air,
    )
    warmer = Scene(scene.room, scene.sources, scene.receivers, scene.pairs, Air(25.0))
    for other in (moved, warmer):
        assert not cached_trace(other, SETTINGS, scattering, cache).found
    other_s = uniform_scattering(scene.room.materials, 0.3)
    assert not cached_trace(scene, SETTINGS, other_s, cache).found


@pytest.mark.parametrize("damage", ["cut", "turned", "empty", "text"])
def test_a_damaged_file_is_reported_and_computed_anew(tmp_path, damage):
    scene, cache = box_scene(), Cache(tmp_path / "cache")
    scattering = uniform_scattering(scene.room.materials, 0.2)
    first = cached_trace(scene, SETTINGS, scattering, cache)
    (file,) = cache.folder.iterdir()
    whole = file.read_bytes()
    middle = len(whole) // 2
    file.write_bytes(
        {
            "cut": whole[:middle],
            "turned": whole[:middle] + bytes([whole[middle] ^ 1]) + whole[middle + 1 :],
            "empty": b"",
            "text": b"not an archive",
        }[damage]
    )
    again = cached_trace(scene, SETTINGS, scattering, cache)
    assert not again.found
    assert [f.code for f in again.findings] == [Code.CACHE_FILE_DAMAGED]
    assert same_paths(first.value.paths, again.value.paths)
    assert file.read_bytes() == whole
    assert cached_trace(scene, SETTINGS, scattering, cache).found


def keep(cache: Cache, key: int, n: int = 1000) -> bool:
    return cached(cache, "sheet", (key,), lambda: Sheet("x", np.full(n, float(key))), [Sheet]).found


def test_the_least_recently_used_go_when_the_limit_is_reached(tmp_path):
    cache = Cache(tmp_path, limit_bytes=20_000)  # two sheets of 8 kB and their outlines
    keep(cache, 1)
    os.utime(next(tmp_path.iterdir()), (1, 1))
    keep(cache, 2)
    assert keep(cache, 1)  # used: now the newest
    keep(cache, 3)
    assert sum(p.stat().st_size for p in tmp_path.iterdir()) <= cache.limit_bytes
    assert keep(cache, 1)
    assert not keep(cache, 2)
    assert not keep(cache, 4, n=10_000)
    assert not keep(cache, 4, n=10_000)  # larger than the limit: never kept


def test_a_cache_that_cannot_be_written_leaves_the_value_and_says_so(tmp_path):
    (tmp_path / "file").write_text("in the way")
    found = cached(
        Cache(tmp_path / "file" / "cache"), "sheet", (1,), lambda: Sheet("x", np.ones(3)), [Sheet]
    )
    assert found.value.numbers.tolist() == [1.0, 1.0, 1.0]
    # a file in the place of a folder cannot be read, either
    assert {f.code for f in found.findings} <= {Code.CACHE_NOT_WRITTEN, Code.CACHE_FILE_DAMAGED}
    assert Code.CACHE_NOT_WRITTEN in {f.code for f in found.findings}


@pytest.fixture
def own_cache(tmp_path, monkeypatch) -> Path:
    """The folder of this test's cache, for the processes that it starts, too."""
    monkeypatch.setenv("ROOMFIT_CACHE", str(tmp_path / "kept here"))
    return tmp_path / "kept here"


def test_no_test_writes_into_the_folder_of_whoever_runs_it():
    assert os.environ["ROOMFIT_CACHE"] == "off"
    assert user_cache() is None


def test_the_limit_stays_and_a_damaged_one_is_the_usual(own_cache):
    usual = user_cache().limit_bytes
    for key in range(3):
        keep(user_cache(), key)
    assert len(cache_files(limited(user_cache(), 20_000))) == 2
    assert user_cache().limit_bytes == 20_000
    assert keep(user_cache(), 2)
    (own_cache / "limit-bytes").write_text("much")
    assert user_cache().limit_bytes == usual


def test_incomplete_files_of_living_runs_stay_and_those_of_killed_ones_go(own_cache):
    keep(user_cache(), 1)
    living, killed = own_cache / ".sheet-a.npz.abcdefgh", own_cache / ".sheet-b.npz.abcdefgh"
    for file in (living, killed):
        file.write_bytes(b"half")
    os.utime(killed, (1, 1))
    make_room(Cache(own_cache, 0), 0)
    assert sorted(own_cache.iterdir()) == [living]


@pytest.mark.slow
def test_runs_that_share_a_cache_do_not_disturb_each_other(tmp_path):
    """Four processes write, find and remove the same twenty files."""
    program = [sys.executable, shared_cache.__file__, str(tmp_path)]
    runs = [subprocess.Popen([*program, str(seed)]) for seed in range(4)]
    assert [run.wait() for run in runs] == [0, 0, 0, 0]
    sizes = [status.st_size for _, status in cache_files(Cache(tmp_path))]
    # each makes room before it renames
    assert 0 < sum(sizes) <= shared_cache.LIMIT_BYTES + 3 * max(sizes)


def test_the_command_shows_limits_and_empties_the_cache(own_cache, capsys, monkeypatch):
    from roomfit.cli import main

    main(["cache"])
    assert "made when there is something to keep" in capsys.readouterr().out
    keep(user_cache(), 1)
    main(["cache", "--limit", "0.5"])
    shown = capsys.readouterr().out.splitlines()
    assert shown[0].startswith(f"{own_cache}: 0.0 MB of at most 500.0 MB")
    assert shown[1].split() == ["sheet", "1", "0.0", "MB"]
    main(["cache", "--clear"])
    assert cache_files(user_cache()) == []
    assert user_cache().limit_bytes == 500_000_000
    with pytest.raises(SystemExit):
        main(["cache", "--limit", "-1"])
    monkeypatch.setenv("ROOMFIT_CACHE", "off")
    capsys.readouterr()
    main(["cache"])
    assert "no cache" in capsys.readouterr().out


def test_without_a_cache_nothing_is_written(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert not cached(None, "sheet", (1,), lambda: Sheet("x", np.ones(3)), [Sheet]).found
    assert list(tmp_path.iterdir()) == []


def test_an_output_folder_with_nothing_but_a_cache_counts_as_empty(tmp_path):
    """Those of earlier roomfits lay there: they are ignored, and go with the result they served."""
    out = tmp_path / "out"
    (out / CACHE_FOLDER).mkdir(parents=True)
    (out / CACHE_FOLDER / "trace-0.npz").write_bytes(b"old")
    check_output_folder(out)
    with whole_output_folder(out) as folder:
        (folder / "result.json").write_text("new")
    assert sorted(p.name for p in out.iterdir()) == [".roomfit-files", "result.json"]
    assert [p.name for p in tmp_path.iterdir()] == ["out"]
    with pytest.raises(InputError, match="not empty"):
        check_output_folder(out)


def test_overwriting_leaves_no_file_of_the_earlier_run_and_every_foreign_one(tmp_path):
    out = tmp_path / "out"
    with whole_output_folder(out) as folder:
        for name in ("result.json", "decay_01_a.png", "decay_02_b.png"):
            (folder / name).write_text("old")
    (out / "notes.txt").write_text("mine")
    (out / "decay_1_notes.png").write_text("mine")
    with whole_output_folder(out, overwrite=True) as folder:
        (folder / "result.json").write_text("new")
        (folder / "decay_01_a.png").write_text("new")
    content = {p.name: p.read_text() for p in out.iterdir() if p.suffix}
    assert content == {
        "result.json": "new",
        "decay_01_a.png": "new",
        "notes.txt": "mine",
        "decay_1_notes.png": "mine",
    }


def test_an_error_while_overwriting_removes_nothing(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "decay_01_a.png").write_text("old")
    with (
        pytest.raises(RuntimeError),
        whole_output_folder(out, overwrite=True),
    ):
        raise RuntimeError
    assert (out / "decay_01_a.png").read_text() == "old"


# ---------------------------------------------------------------- runs that are killed


def prediction_command(folder: Path, out: Path) -> list[str]:
    """A prediction of four pairs whose absorption is specified by a small table."""
    campaign = folder / "campaign.toml"
    if not campaign.exists():
        more = "[sources.LS2]\nposition = [3.0, 2.5, 1.4]\n[receivers.MP1]"
        write_campaign(folder, ("[receivers.MP1]", more), ("from_hz = 500", "from_hz = 1000"))
        rows = ["material,band_hz,absorption,lower95,upper95,identifiable"]
        for name, a in ABSORPTION.items():
            rows += [f"{name},{f},{a},{a - 0.02},{a + 0.02},true" for f in (1000,)]
        (folder / "absorption.csv").write_text("\n".join(rows) + "\n")
    table = str(folder / "absorption.csv")
    program = [sys.executable, "-m", "roomfit", "predict", str(campaign)]
    return [*program, "--absorption", table, "--out", str(out), "--overwrite"]


def numbers_of(out: Path) -> dict:
    """Everything in predicted.json but how long it took and what was said of the cache."""
    content = json.loads((out / "predicted.json").read_text())
    del content["prediction"]["seconds"], content["content_sha256"]
    content["findings"] = [f for f in content["findings"] if not f["code"].startswith("cache-")]
    return content


def kept(folder: Path, kind: str) -> list[Path]:
    return sorted(folder.glob(f"{kind}-*.npz"))


@pytest.mark.slow
def test_a_killed_run_continues_and_ends_with_the_same_bits(tmp_path, own_cache):
    out, whole = tmp_path / "out", tmp_path / "whole"
    command = prediction_command(tmp_path / "campaign", out)
    run = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    # a pair's numbers are kept when they are done: the trace is, and three pairs are not
    while not kept(own_cache, "pair"):
        assert run.poll() is None
        time.sleep(0.01)
    run.send_signal(signal.SIGKILL)
    assert run.wait() == -signal.SIGKILL
    assert not out.exists()
    found = {p: p.stat().st_ino for kind in ("trace", "pair") for p in kept(own_cache, kind)}
    assert len(kept(own_cache, "pair")) < 4
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    assert len(kept(own_cache, "pair")) == 4
    # what was kept was used: nothing was written a second time
    assert {p: p.stat().st_ino for p in found} == found
    other = prediction_command(tmp_path / "campaign", whole)
    subprocess.run([*other, "--no-cache"], check=True, stdout=subprocess.DEVNULL)
    assert numbers_of(out) == numbers_of(whole)
    assert (out / "predicted.csv").read_bytes() == (whole / "predicted.csv").read_bytes()
    assert not list(tmp_path.rglob(CACHE_FOLDER))


@pytest.mark.slow
def test_two_runs_in_one_folder_do_not_break_each_other(tmp_path, own_cache):
    out = tmp_path / "out"
    command = prediction_command(tmp_path / "campaign", out)
    runs = [subprocess.Popen(command, stdout=subprocess.DEVNULL) for _ in range(2)]
    # the second is refused, or begins when the first is done
    assert sorted(run.wait() for run in runs) in ([0, 0], [0, 2])
    alone = prediction_command(tmp_path / "campaign", tmp_path / "alone")
    subprocess.run(alone, check=True, stdout=subprocess.DEVNULL)
    assert numbers_of(out) == numbers_of(tmp_path / "alone")
    assert [p.name for p in tmp_path.iterdir() if p.name.startswith(".")] == []
