"""What must not be taken for another: keys of kept results, draws, orders, rows of tables."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from roomfit import batch
from roomfit import cache as cache_module
from roomfit._numba import at_most_threads
from roomfit.air import Air
from roomfit.bands import bands_between
from roomfit.cache import Cache, Cached, cached, digest, write_bytes_atomically
from roomfit.coverage import estimate
from roomfit.coverage.synthetic_room import CoverageSettings
from roomfit.geometry.mesh import shoebox_mesh
from roomfit.inversion import trace_plan
from roomfit.materials.priors import Scattering, uniform_scattering
from roomfit.prediction import predict
from roomfit.scene import Point, Scene, room_from_mesh
from roomfit.tracing.paths import TraceSettings
from roomfit.workers import in_pool


def test_another_code_is_another_key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def found() -> bool:
        return cached(Cache(tmp_path), "pair", (1,), lambda: 2.5, ()).found

    assert (found(), found()) == (False, True)
    monkeypatch.setattr(cache_module, "code_digest", lambda: "another")
    assert (found(), found()) == (False, True)


def test_another_code_or_another_file_is_another_address_of_a_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And the same is the same, wherever the folder lies."""
    text = '[room]\nshoebox = [6, 5, 3]\n[[measurements]]\nparameters = "measured.csv"\n'
    addresses = []
    for where, value in (("a", 0.3), ("b", 0.3), ("a", 0.4)):
        folder = tmp_path / where / "hall"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "campaign.toml").write_text(text)
        (folder / "measured.csv").write_text(f"source,receiver,parameter,1000\nS,R,T30,{value}\n")
        addresses.append(batch.room_tasks([folder / "campaign.toml"])[0].address)
    assert addresses[0] == addresses[1] != addresses[2]
    assert all(addresses)
    last = tmp_path / "b" / "hall" / "campaign.toml"
    (first_answer,) = batch.room_tasks([last], quick=True)
    assert first_answer.address not in addresses
    monkeypatch.setattr(batch, "code_digest", lambda: "another")
    assert batch.room_tasks([last])[0].address not in addresses


def changed(value: Any) -> Any:
    """Return another value of the same kind, valid for each field of a trace."""
    others = {"sobol": "fibonacci", "spheres": "rain", None: 0.02}
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return value - 1 if value == 65_535 else value + 1
    return others[value] if value in others else 0.5 * value


def scene() -> Scene:
    room = room_from_mesh(shoebox_mesh((3.0, 2.5, 2.0)), {})
    points = tuple((Point(name, at),) for name, at in (("S", (1, 1, 1)), ("R", (2, 2, 1))))
    return Scene(room, *points, np.array([[0, 0]]), Air())


def test_every_setting_of_a_trace_and_all_of_its_scene_are_in_its_key(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Another value of any field, another key; the same values, the same key."""
    keys = []

    def kept(_: object, kind: str, parts: tuple[Any, ...], *more: object) -> Cached[Any]:
        keys.append(digest(kind, *parts))
        return Cached(SimpleNamespace(paths=SimpleNamespace(pair=[])), found=True)

    monkeypatch.setattr(trace_plan, "cached", kept)
    settings, here = TraceSettings(duration_s=0.05), scene()
    rough = uniform_scattering(here.room.materials, 0.1)
    trace_plan.cached_trace(here, settings, rough, None)
    trace_plan.cached_trace(scene(), TraceSettings(duration_s=0.05), rough, None)
    assert len(set(keys)) == 1
    names = [f.name for f in fields(TraceSettings)]
    for name in names:
        other = replace(settings, **{name: changed(getattr(settings, name))})
        trace_plan.cached_trace(here, other, rough, None)
    scenes = (
        replace(here, air=Air(temperature_c=21.0)),
        replace(here, sources=(Point("S", (1, 1, 1.01)),)),
        replace(here, receivers=(Point("R", (2, 2, 1.01)),)),
        replace(here, room=room_from_mesh(shoebox_mesh((3.0, 2.5, 2.01)), {})),
    )
    for other_scene in scenes:
        trace_plan.cached_trace(other_scene, settings, rough, None)
    tables = [uniform_scattering(here.room.materials, 0.11)]
    tables.append(Scattering(rough.materials, np.stack([rough.coefficients] * 2)))
    for table in tables:
        trace_plan.cached_trace(here, settings, table, None)
    assert len(set(keys)) == 1 + len(names) + len(scenes) + len(tables)


def test_all_that_a_prediction_of_a_pair_depends_on_is_in_its_key(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    keys: list[str] = []

    def kept(_: object, kind: str, parts: tuple[Any, ...], *more: object) -> Cached[Any]:
        keys.append(digest(kind, *parts))
        return Cached(None, found=True)

    monkeypatch.setattr(predict, "cached", kept)
    octaves = bands_between("octave", 500, 1000)
    thirds = bands_between("third-octave", 500, 1000)
    a, draws, speech = np.full((2, 2), 0.3), np.full((5, 2, 2), 0.3), (np.full(7, 60.0),) * 2

    def key(
        *, at=None, bands=octaves, traced="k", absorption=a, drawn=draws, speech_db=speech, n=1
    ) -> None:
        here = scene() if at is None else at
        room: Any = SimpleNamespace(
            scene=replace(here, pairs=np.array([[0, 0]] * n)),
            traced=SimpleNamespace(key=traced, by_pressures=None),
            absorption=SimpleNamespace(bands=bands, fitted_jnd=None),
            few=[None] * n,
            speech_db=speech_db,
        )
        predict._exact_numbers(room, absorption, drawn, None, None)

    key()
    key()
    assert len(set(keys)) == 1
    key(at=replace(scene(), air=Air(temperature_c=21.0)))
    key(bands=thirds)
    key(traced="another")
    key(absorption=a + 0.01)
    key(drawn=draws + 0.01)
    key(speech_db=None)
    key(speech_db=(np.full(7, 61.0), speech[1]))
    key(speech_db=(speech[0], np.full(7, 61.0)))
    assert len(set(keys)) == 9
    before = len(set(keys))
    with at_most_threads(1):  # copies of the process would note keys of their own
        key(n=2)  # two pairs of one scene
    assert len(set(keys)) == before + 2


def test_replicates_of_one_seed_differ_and_each_is_the_same_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: dict[tuple[int, int], float] = {}

    class Drawn(Exception):  # noqa: N818 -- ends the replicate where it has its numbers
        pass

    def draw(_: object, rng: np.random.Generator) -> None:
        drawn[asked] = float(rng.random())
        raise Drawn

    monkeypatch.setattr(estimate, "draw_synthetic_room", draw)
    plan: Any = SimpleNamespace()
    for asked in [(seed, number) for seed in (1, 2) for number in range(20)]:
        for _ in range(2):
            before = drawn.get(asked)
            with pytest.raises(Drawn):
                estimate.replicated(plan, *asked, tmp_path)
            assert before in (None, drawn[asked])
    assert len(set(drawn.values())) == 40


def test_a_resumed_estimate_tells_its_progress_from_0_to_1(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of what it does itself; what is there already counts for nothing."""
    said: list[float] = []

    def replicated(_: object, seed: int, number: int, scratch: Path, progress: Any) -> int:
        progress(0.5)
        progress(1.0)
        return number

    monkeypatch.setattr(estimate, "replicated", replicated)
    monkeypatch.setattr(estimate, "write_replicate", lambda *_: None)
    plan: Any = SimpleNamespace()
    settings = CoverageSettings(replicates=40)
    estimate._simulate(plan, settings, [36, 37, 39, 38], tmp_path, tmp_path, said.append)
    assert said == pytest.approx([0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875, 1.0])


def test_a_file_is_replaced_and_never_written_into(tmp_path: Path) -> None:
    """Who has the old one open, or under another name, keeps it whole."""
    path, other = tmp_path / "a.json", tmp_path / "b.json"
    path.write_bytes(b"old content")
    os.link(path, other)
    with path.open("rb") as reader:
        write_bytes_atomically(path, b"new")
        assert reader.read() == b"old content"
    assert other.read_bytes() == b"old content"
    assert path.read_bytes() == b"new"


def test_results_of_a_pool_stand_in_the_order_of_their_tasks() -> None:
    """The first task ends last."""

    def late(number: int) -> int:
        time.sleep(0.02 * (4 - number))
        return number

    said: list[float] = []
    tasks: list[Callable[[], int]] = [partial(late, n) for n in range(4)]
    with ThreadPoolExecutor(4) as pool:
        assert in_pool(pool, tasks, said.append) == [0, 1, 2, 3]
    assert said == [0.25, 0.5, 0.75, 1.0]


def test_a_row_of_many_rooms_shows_the_worst_band_and_the_mean_of_the_middle_ones(
    tmp_path: Path,
) -> None:
    bands = [500.0, 1000.0, 2000.0]
    mean = {"kind": "mean", "absorption": 0.2, "lower95": 0.1, "upper95": 0.4}
    content = {
        "format": "roomfit-result",
        "format_version": 1,
        "bands_hz": bands,
        "materials": {"walls": {"identifiable": [True, False, True]}},
        "combinations": [
            {**mean, "band_hz": f, "absorption": a, "lower95": a - 0.1, "upper95": a + 0.3}
            for f, a in zip(bands, (0.2, 0.4, 0.9), strict=True)
        ],
        "pairs": [
            {
                "use": use,
                "parameters": {
                    "T20_s": {"measured": [m, 2 * m, 9.0], "predicted": [m + 0.1, 2 * m, 9.0]}
                },
            }
            for use, m in (("fit", 0.5), ("fit", 0.7), ("validate", 5.0))
        ],
        "findings": [
            {"code": "few-rays", "severity": "warning"},
            {"code": "dc-offset", "severity": "info"},
        ],
        "fit": {"phi": [0.9, 3.25, 1.1], "seconds": 4.0},
    }
    cache_module.write_json_atomically(tmp_path / "result.json", content)
    row = batch._answered("hall", tmp_path, "rooms/hall")
    assert row.chi2_reduced == 3.25
    assert row.mean == pytest.approx((0.3, 0.2, 0.6))
    assert row.decay_s == pytest.approx((0.9, 0.95))
    assert (row.identifiable, row.values, row.seconds) == (2, 3, 4.0)
    assert row.findings == ("few-rays",)
    assert json.loads((tmp_path / "result.json").read_text())["fit"]["phi"] == [0.9, 3.25, 1.1]
