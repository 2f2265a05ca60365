"""What to hang where by a form, and decay times in the workbench: files alone, no browser."""

from __future__ import annotations

import asyncio
import copy
import os
import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("nicegui", reason="the workbench needs the extra app")

from nicegui import Client, ui
from nicegui.page import page

from roomfit.app import project, tasks, views
from roomfit.app.tasks import written_question
from roomfit.app.what_if_tab import TreatmentForm
from roomfit.base.errors import InputError
from roomfit.base.findings import Code
from roomfit.report.html import fragment
from roomfit.report.predicted import describe
from roomfit.treat.campaign import read_treatment

WRITTEN = """# of the client
probability = 0.8 # agreed

[surfaces."rear wall"]
free_m2 = 14 # measured
forbidden_m2 = [0.4, 0.2]

[products.own]
absorption = { centres_hz = [500, 2000], values = [0.9, 0.95] } # of the maker
cost_per_m2 = 60

[[targets]]
standard = "din-18041-a3" # in the contract

[[targets]]
parameter = "T30_s"
at_most = 0.8
"""


def nothing(_: float) -> None:
    """No progress is looked at."""


@pytest.fixture
def hall(tmp_path: Path) -> Path:
    """Return a project of a typed box and a table of decay times."""
    views.set_room(tmp_path, shoebox=[12.0, 8.0, 4.0])
    (tmp_path / "decay-times").mkdir()
    table = "place\t500 Hz\t1 kHz\t2 kHz\nfront\t1,3\t1,2\t1,1\nrear\t1,4\t1,2\t1,2\n"
    (tmp_path / "decay-times" / "pasted.csv").write_text(table)
    project.set_decay_times(tmp_path, "pasted.csv")
    return tmp_path


def test_what_the_form_changes_is_changed_and_all_else_stays_as_it_is_written() -> None:
    question = tomllib.loads(WRITTEN)
    assert written_question(WRITTEN, question) == WRITTEN
    question["surfaces"]["ceiling"] = {}
    question["surfaces"]["rear wall"]["free_m2"] = 12.5
    question["products"]["felt"] = {"catalogue": "curtain-heavy-draped"}
    question["targets"][1] = {"parameter": "STI", "at_least": 0.6}
    after = written_question(WRITTEN, question)
    assert tomllib.loads(after) == question
    for kept in (
        "# of the client",
        "# agreed",
        "# measured",
        "# of the maker",
        "# in the contract",
    ):
        assert kept in after
    del question["targets"][0], question["products"]["own"], question["probability"]
    assert tomllib.loads(written_question(after, question)) == question
    with pytest.raises(InputError, match="this cannot edit"):
        written_question("targets = [1]\n[surfaces\n", question)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"surfaces": {}}, "no surface may be covered"),
        ({"products": {}}, "nothing to hang"),
        ({"targets": []}, "no target"),
        ({"targets": [{"parameter": "T30_s"}]}, "target 1"),
        ({"probability": 1.0}, "probability"),
        ({"surfaces": {"ceiling": {"free_m2": -1.0}}}, "free_m2"),
        ({"of strangers": 1}, "of strangers"),
    ],
)
def test_what_cannot_be_asked_is_refused_and_the_file_stays(
    hall: Path, change: dict[str, Any], words: str
) -> None:
    file = hall / project.TREATMENT_QUESTION
    file.write_text(WRITTEN)
    question = tomllib.loads(WRITTEN) | change
    with pytest.raises(InputError, match=words):
        tasks.ask_treatment(hall, question)
    assert file.read_text() == WRITTEN and not list(hall.glob(".*"))


def test_decay_times_are_answered_as_the_command_line_answers_them(hall: Path) -> None:
    """The mean with its interval, and the square metres; no position was asked for."""
    tasks.reverberation(hall)
    assert not tasks.answer_view(hall, project.MEAN)["stale"]
    assert project.served_file(hall, "mean/reverberation.html").is_file()
    asked = tasks.treatment_view(hall)
    assert asked["bands_hz"] == [500.0, 1000.0, 2000.0] and asked["from_times"]
    assert asked["areas_m2"] == {"walls": 160.0, "floor": 96.0, "ceiling": 96.0}
    question = {
        "surfaces": {"ceiling": {"free_m2": 70.0}},
        "products": {"mineral-wool-50-mm": {"catalogue": "mineral-wool-50-mm", "piece_m2": 0.72}},
        "targets": [{"parameter": "T30_s", "at_most": 0.8}],
    }
    tasks.ask_treatment(hall, question)
    assert read_treatment(hall / project.TREATMENT_QUESTION).surfaces["ceiling"].free_m2 == 70.0
    tasks.treat(nothing, hall)
    sentence = tasks.treatment_view(hall)["sentence"]
    assert " m² mineral-wool-50-mm on ceiling: T30" in sentence
    assert (hall / project.TREATMENT / "treatment.png").is_file()  # for Word
    assert tasks.treatment_view(hall)["question"] == question
    project.set_room(hall, shoebox=(13.0, 8.0, 4.0))
    assert tasks.answer_view(hall, project.MEAN)["stale"]


def test_other_walls_from_decay_times_are_those_of_the_command(hall: Path, tmp_path: Path) -> None:
    """T30 with its intervals, before and after; another table of the same name is read anew."""
    from roomfit.cli.predict import predict_to_folder

    (tmp_path / "out").mkdir()
    view = tasks.what_if_prepare(hall)
    assert view["bands_hz"] == [500.0, 1000.0, 2000.0]
    assert view["treatment"]["from_times"] and not view["left_out"]
    changes = ["walls=x2,x1,x1", "ceiling=mineral-wool-50-mm"]
    for texts in ([], changes):
        own = tasks.what_if(hall, texts)
        campaign, out = project.campaign_file(hall), tmp_path / "out"
        found = predict_to_folder(campaign, None, out, texts, overwrite=True)
        assert own["shown"] == fragment(describe(found), first=True)
        changed = Code.MATERIALS_CHANGED
        said = [f.sentence for f in found.findings if f.code is not changed]
        assert [f["sentence"] for f in own["findings"]] == said
        whole = [f.sentence for f in found.findings if f.code is changed]
        assert len(whole) == bool(texts) == ("the mean of T30" in own["directions"])
        assert all(sentence.endswith(f" {own['directions']}") for sentence in whole)
    (doubt, *_) = [f for f in found.findings if f.code is Code.CHANGE_PRIOR_DOMINATED]
    assert doubt.sentence.endswith("or measure responses with positions, which tell walls apart.")
    assert "roomfit design" not in doubt.sentence
    # of the mean of what was measured, 1.35 s, and shorter where more is absorbed
    assert found.mean["T30_s"].change.before[0] == pytest.approx(1.35)
    assert found.mean["T30_s"].predicted[0] < 1.0 and "<td>1.35</td>" in own["shown"]
    # kept under names, side by side with the same numbers; what the page keeps the command takes
    project.keep_variant(hall, "thick ceiling", changes)
    project.keep_variant(hall, "<b>", ["walls=x2"])
    project.keep_variant(hall, "<b>", ["walls=x3"])
    kept = tasks.what_if_prepare(hall)["variants"]
    assert kept["names"] == ["thick ceiling", "<b>"] and "&lt;b&gt;" in kept["shown"]
    beside = predict_to_folder(campaign, None, out, project.variants(hall), overwrite=True)
    assert not beside.changes and beside.variants["<b>"].changes == ("walls=x3",)
    for name, value in found.mean.items():
        own_value = beside.variants["thick ceiling"].mean[name]
        np.testing.assert_allclose(own_value.predicted, value.predicted, rtol=1e-9)
        np.testing.assert_allclose(own_value.upper95, value.upper95, rtol=1e-9)
    assert f">{found.mean['T30_s'].predicted[0]:.2f} <small>" in kept["shown"]
    project.keep_variant(hall, "<b>", [])
    project.set_room(hall, shoebox=(13.0, 8.0, 4.0))
    assert tasks.what_if_prepare(hall)["variants"]["names"] == ["thick ceiling"]
    with pytest.raises(InputError, match="needs a name"):
        project.keep_variant(hall, " ", changes)
    table = hall / "decay-times" / "pasted.csv"
    table.write_text(table.read_text().replace("1,3", "2,3").replace("1,4", "2,4"))
    os.utime(table, (1.0, 1.0))
    assert "<td>2.35</td>" in tasks.what_if_prepare(hall)["shown"]


def test_a_volume_and_a_surface_have_one_slider_and_nothing_to_cover(tmp_path: Path) -> None:
    (tmp_path / "t30.csv").write_text("place,500\nall,1.3\n")
    text = '[reverberation]\nfile = "t30.csv"\nvolume_m3 = 384\nsurface_m2 = 352\n'
    project.campaign_file(tmp_path).write_text(text)
    view = tasks.what_if_prepare(tmp_path)
    assert list(view["absorption"]) == ["room"] and view["treatment"] is None
    before, after = re.findall(r"<td>([\d.]+)</td>", tasks.what_if(tmp_path, ["room=x2"])["shown"])
    assert float(before) == 1.3 and float(after) < 0.7


def test_decay_times_without_a_room_and_a_file_that_is_none_are_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no room yet"):
        project.set_decay_times(tmp_path, "pasted.csv")
    with pytest.raises(InputError, match="no answer yet"):
        tasks.treat(nothing, tmp_path)
    views.set_room(tmp_path, shoebox=[5.0, 4.0, 3.0])
    (tmp_path / project.TREATMENT_QUESTION).write_text("surfaces = 3")
    view = tasks.treatment_view(tmp_path, [1000.0])
    assert "treatment.toml" in view["fault"] and not view["from_times"]


@pytest.mark.slow
def test_what_does_not_fit_the_room_is_said_in_the_form_where_it_is_put_right(
    tmp_path: Path,
) -> None:
    """A ceiling of 1000 m2; sliders and charts go on, and so does the search once it is mended."""
    tasks.demo(nothing, tmp_path)
    file = project.campaign_file(tmp_path)
    few = "\n[settings]\nn_rays = 2000\nn_scattering_rays = 1000\n"
    file.write_text(file.read_text() + few)
    project.set_bands(tmp_path, 1000.0, 1000.0)
    tasks.identify(nothing, tmp_path, True)
    question: dict[str, Any] = {
        "surfaces": {"brick": {"free_m2": 1000.0}},
        "products": {"mineral-wool-50-mm": {"catalogue": "mineral-wool-50-mm"}},
        "targets": [{"parameter": "T20_s", "at_most": 0.4}],
    }
    tasks.ask_treatment(tmp_path, question)
    room = tasks.what_if_prepare(tmp_path)
    assert ">target<" not in room["shown"] and "more area is free" in room["treatment"]["fault"]
    assert room["treatment"]["areas_m2"]["brick"] == pytest.approx(4.7 * 2.8)
    del question["surfaces"]["brick"]["free_m2"]
    tasks.ask_treatment(tmp_path, question)
    room = tasks.what_if_prepare(tmp_path)
    assert ">target<" in room["shown"] and ">0.4<" in room["shown"]
    assert not room["treatment"]["fault"]
    assert not room["treatment"]["from_times"]
    tasks.treat(nothing, tmp_path)
    view = tasks.treatment_view(tmp_path, [1000.0])
    assert "m² mineral-wool-50-mm on brick" in view["sentence"]


class Bench:
    """A project that notes what is asked of it."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.jobs = folder, self
        self.asked: list[tuple[Any, ...]] = []

    async def ask(self, task: str, **own: Any) -> None:
        self.asked.append((task, own))

    def add(self, *own: Any, **_: Any) -> None:
        self.asked.append(own)


def test_the_form_has_what_the_file_has_and_asks_what_is_typed(hall: Path) -> None:
    (hall / project.TREATMENT_QUESTION).write_text(WRITTEN)
    view = tasks.treatment_view(hall)

    async def whole() -> None:
        client, bench = Client(page("/")), Bench(hall)

        def field(spoken: str) -> Any:
            (found,) = [e for e in client.elements.values() if e.props.get("aria-label") == spoken]
            return found

        with client:
            form = TreatmentForm(bench, lambda: False)  # type: ignore[arg-type]
        form.show(view)
        assert form.written() == tomllib.loads(WRITTEN)
        texts = [str(getattr(e, "text", "")) for e in client.elements.values()]
        assert "rear wall, not in this room" in texts and "standard din-18041-a3" in texts
        assert "ceiling, 96.0 m²" in texts
        assert field("Free area of rear wall in m²").value == 14
        assert field("At most, target 2").value == 0.8
        (cover,) = [e for e in client.elements.values() if getattr(e, "text", "") == texts[
            texts.index("ceiling, 96.0 m²")]]  # fmt: skip
        cover.set_value(True)
        field("Free area of ceiling in m²").set_value(70.0)
        (catalogue,) = [
            e
            for e in client.elements.values()
            if isinstance(e, ui.select) and "Add a product" in str(e.props["label"])
        ]
        catalogue.set_value("mineral-wool-50-mm")
        field("Piece of mineral-wool-50-mm in m²").set_value("0,72")
        field("Cost of own per m²").set_value(None)
        field("Bands of target 2").set_value([500.0])
        form.change_targets(0)
        # an answer that comes meanwhile takes nothing of this away
        drawn = set(client.elements)
        form.show(copy.deepcopy(view))
        assert set(client.elements) == drawn
        await form.search()
        (task, own), job = bench.asked
        assert task == "ask_treatment" and job[1] == "treat"
        question = own["question"]
        assert question["surfaces"]["ceiling"] == {"free_m2": 70.0}
        assert question["products"]["mineral-wool-50-mm"]["piece_m2"] == 0.72
        assert "cost_per_m2" not in question["products"]["own"]
        assert question["targets"] == [{"parameter": "T30_s", "at_most": 0.8, "bands_hz": [500.0]}]
        field("Bands of target 1").set_value([])  # typed and taken back
        assert form.written()["targets"] == [{"parameter": "T30_s", "at_most": 0.8}]
        field("Bands of target 1").set_value([500.0])
        # nor does the file that it has written itself
        drawn = set(client.elements)
        form.show({**view, "question": copy.deepcopy(question)})
        assert set(client.elements) == drawn
        # what another program writes into the file is shown
        form.show({**view, "question": {**view["question"], "probability": 0.9}})
        assert form.written()["probability"] == 0.9
        form.show({**view, "sentence": "All of <it>."})
        assert "All of <it>." in [getattr(e, "text", "") for e in client.elements.values()]

    asyncio.run(whole())
