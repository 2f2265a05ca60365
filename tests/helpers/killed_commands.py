"""Each command over an earlier result, killed before every touch of the disk.

What a command computes and draws is left out: only how its results come into their folder. In a
process of its own, because it forks: ``python killed_commands.py COMMAND FOLDER``.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

from roomfit.table import Table

from roomfit.settings import Settings

STEPS = ("open", "os.", "shutil.", "tempfile.", "ctypes.", "fcntl.")
WORD = ["old"]


def word(*_: Any, **__: Any) -> str:
    return WORD[0]


def word_as_table(*_: Any, **__: Any) -> Table:
    return Table("", (WORD[0],), ())


def word_as_bytes(*_: Any, **__: Any) -> bytes:
    return WORD[0].encode()


def nothing(*_: Any, **__: Any) -> None:
    return None


def empty(*_: Any, **__: Any) -> dict[str, Any]:
    return {"scene": None, "measurements": ()}


def writes(*names: str) -> Callable[..., None]:
    from roomfit.base.whole_files import write_text_atomically

    def write(folder: Path, *_: Any) -> None:
        for name in names:
            write_text_atomically(folder / name, WORD[0])

    return write


PREDICTIONS = "roomfit.predictions."
STUBS: dict[str, dict[str, Any]] = {
    "identify": {
        "roomfit.io.campaign.read_campaign": lambda *_: SimpleNamespace(
            project=None, path=Path("c.toml")
        ),
        "roomfit.io.project.project_details": lambda *_: {},
        "roomfit.io.inputs.identify_arguments": lambda *_: {**empty(), "settings": Settings()},
        "roomfit.identification.identify": lambda **_: SimpleNamespace(
            settings=Settings(), findings=()
        ),
        "roomfit.inversion.measurements.measured_scene": nothing,
        "roomfit.report.figures.answer_figures": lambda *_, **__: {},
        "roomfit.report.room_figure.room_figure": nothing,
        "roomfit.report.html.mean_decay_figure": nothing,
        "roomfit.report.html.report_html": word,
        "roomfit.report.usable.remaining_usable": lambda _: (),
        "roomfit.io.results.write_result": writes("result.json", "absorption.csv"),
        "roomfit.report.figures.write_pictures": writes("absorption.png"),
    },
    "predict": {
        PREDICTIONS + "prepared_field": nothing,
        "roomfit.io.results.read_result": nothing,
        "roomfit.prediction.campaign.predict_arguments": lambda *_: {
            "scene": SimpleNamespace(pairs=())
        },
        "roomfit.prediction.predict.predict": lambda **_: SimpleNamespace(
            compares_states=True, pairs=(SimpleNamespace(source="S", receiver="R"),)
        ),
        "roomfit.prediction.output.write_predicted": writes("predicted.json", "predicted.csv"),
        "roomfit.prediction.output.change_figure": nothing,
        "roomfit.prediction.output.predicted_decay_figure": nothing,
    },
    "design": {
        "roomfit.experiment_design.campaign.design_arguments": lambda *_: {},
        "roomfit.experiment_design.design.design": nothing,
        "roomfit.experiment_design.output.write_design": writes("design.json", "design.csv"),
        "roomfit.experiment_design.output.design_map": nothing,
        "roomfit.experiment_design.output.design_gain": nothing,
    },
    "paper": {
        "roomfit.suh2001.output.repeat_paper": nothing,
        "roomfit.suh2001.output._tables": lambda _: {"methods": word_as_table()},
        "roomfit.suh2001.output._figures": lambda _: {"figure2": None},
        "roomfit.suh2001.output.paper_json": lambda _: {"word": WORD[0]},
        "roomfit.suh2001.output.png": word_as_bytes,
    },
    "impedance": {
        "roomfit.impedance.campaign.read_campaign": nothing,
        "roomfit.impedance.campaign.identify_campaign_impedance": lambda *_, **__: SimpleNamespace(
            materials=(SimpleNamespace(name="wool"),), evaluations=0, pairs=()
        ),
        "roomfit.impedance.output.impedance_records": word_as_table,
        "roomfit.impedance.output.impedance_content": lambda *_: {"word": WORD[0]},
        "roomfit.impedance.output.walls_figure": nothing,
        "roomfit.impedance.output.png": word_as_bytes,
    },
}


def run(command: str, out: Path) -> None:
    """Run a command into a folder, whose files then hold the word of the hour."""
    from roomfit.suh2001.output import run_paper

    from roomfit import commands
    from roomfit.impedance.campaign import impedance_to_folder

    campaign = out.parent / "none.toml"
    calls: dict[str, Callable[[], object]] = {
        "identify": lambda: identify_to_folder(campaign, out, overwrite=True),
        "predict": lambda: predict_to_folder(campaign, campaign, out, overwrite=True),
        "design": lambda: commands.design_to_folder(campaign, out, overwrite=True),
        "paper": lambda: run_paper(out, overwrite=True),
        "impedance": lambda: impedance_to_folder(campaign, out, overwrite=True),
    }
    usual = {
        "roomfit.io.campaign.read_campaign": nothing,
        PREDICTIONS + "read_campaign": nothing,
        "roomfit.report.figures.png": word_as_bytes,
    }
    with ExitStack() as stack:
        for name, stub in {**usual, **STUBS[command]}.items():
            stack.enter_context(patch(name, stub))
        calls[command]()


def forked(command: str, out: Path, killed_at: int = 0) -> bool:
    """Run a command in a process of its own; return whether it came to its end."""
    child = os.fork()
    if child == 0:
        left = [killed_at]

        def watch(event: str, _: object) -> None:
            if event.startswith(STEPS):
                left[0] -= 1
                if left[0] == 0:
                    os.kill(os.getpid(), signal.SIGKILL)

        sys.addaudithook(watch)
        try:
            run(command, out)
        except BaseException:  # noqa: BLE001 -- whatever it is, the child must end here
            sys.excepthook(*sys.exc_info())
            os._exit(1)
        os._exit(0)
    ended = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert ended in (0, -signal.SIGKILL), ended
    return ended == 0


def content(out: Path) -> dict[str, str]:
    """Return the result's own files."""
    files = (p for p in out.rglob("*") if p.is_file() and p.name != ".roomfit-files")
    return {p.relative_to(out).as_posix(): p.read_text() for p in files}


def outcomes(command: str, folder: Path) -> Iterator[str]:
    """Yield which result is there, killed before each step, until the command ends."""
    saved = {}
    for word in ("new", "old"):
        WORD[0] = word
        run(command, folder / word / "out")
        saved[word] = content(folder / word / "out")
        (folder / word / "out" / "notes.txt").write_text("mine")
    assert saved["old"].keys() == saved["new"].keys() and len(saved["old"]) >= 3
    WORD[0], step, ended = "new", 0, False
    while not ended:
        step += 1
        out = folder / str(step) / "out"
        shutil.copytree(folder / "old", out.parent)
        ended = forked(command, out, step)
        found = content(out)
        assert found.pop("notes.txt", "") == "mine", (step, sorted(found))
        assert found in saved.values(), (step, found)
        # the next run goes on, and removes what is left
        run(command, out)
        assert content(out) == saved["new"] | {"notes.txt": "mine"}, step
        assert [p.name for p in out.parent.iterdir()] == ["out"], (step, list(out.parent.iterdir()))
        shutil.rmtree(out.parent)
        yield "old" if found == saved["old"] else "new"


if __name__ == "__main__":
    print(json.dumps(list(outcomes(sys.argv[1], Path(sys.argv[2])))))
