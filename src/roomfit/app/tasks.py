"""What the page has done, by name: answers at once, and what takes long, of a project's folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from roomfit.app import project, views
from roomfit.app.what_if import ask_treatment, treatment_view, what_if, what_if_prepare
from roomfit.base.errors import InputError
from roomfit.base.typing import Progress
from roomfit.cli.identify import identify_to_folder
from roomfit.cli.listen import listen_to_folder
from roomfit.cli.predict import reverberation_to_folder
from roomfit.cli.treat import treat_to_folder
from roomfit.demo.boxes import demo_plan, write_measured_box
from roomfit.files.campaign import read_campaign
from roomfit.files.encoding import EditedFile, finding_of
from roomfit.files.remedies import changed_since
from roomfit.files.results import read_result_content


def answer_view(folder: Path, name: str) -> dict[str, Any]:
    """Return when an answer was made, and what it advises; nothing where there is none.

    ``stale``: whether the campaign has changed since; ``advised``: see `views.advice_view`.
    """
    file = folder / name / "result.json"
    if not file.is_file():
        return {}
    content, doubts = read_result_content(EditedFile(file))
    campaign_file = project.campaign_file(folder)
    stale = changed_since(content, campaign_file)
    advice: list[dict[str, Any]] = []
    if not doubts:
        with suppress(InputError):  # the campaign cannot be read any more
            campaign = read_campaign(campaign_file, to_fit=False)
            raised = [finding_of(f, "result.json") for f in content["findings"]]
            advice = views.advice_view(raised, campaign, changed=stale)
    return {"made": file.stat().st_mtime, "stale": stale, "advised": advice}


def identify(progress: Progress, folder: Path, quick: bool) -> None:
    """Identify, as ``roomfit identify [--quick]`` does, into the folder of this kind of answer."""
    out = project.inside(folder, folder / (project.QUICK if quick else project.FULL))
    file = project.campaign_file(folder)
    identify_to_folder(file, out, quick=quick, overwrite=True, progress=progress)


def reverberation(folder: Path) -> None:
    """Find the mean absorption from decay times alone, as ``roomfit reverberation`` does."""
    out = project.inside(folder, folder / project.MEAN)
    reverberation_to_folder(project.campaign_file(folder), out, overwrite=True)


def demo(progress: Progress, folder: Path) -> None:
    """Write the campaign of ``roomfit demo``: a simulated room of known absorption."""
    if project.has_campaign(folder):
        what, found = "the folder has a campaign already", "campaign.toml"
        needed, hint = "a folder without a campaign", "start roomfit app in a new folder"
        raise InputError(what, where=str(folder), found=found, needed=needed, hint=hint)
    write_measured_box(demo_plan(), folder, np.random.default_rng(1), progress)


def treat(progress: Progress, folder: Path, doubted: bool = False) -> str:
    """Choose what to hang where, as ``roomfit treat`` does; return the answer in words."""
    project.answer_file(folder, or_decay_times=True)
    answer = treat_to_folder(
        project.campaign_file(folder),
        project.best_result(folder),
        folder / project.TREATMENT_QUESTION,
        project.inside(folder, folder / project.TREATMENT),
        doubted=doubted,
        overwrite=True,
        progress=progress,
    )
    return str(answer)


def listen(
    progress: Progress, folder: Path, changes: list[str], dry: str = "", doubted: bool = False
) -> None:
    """Make what a change sounds like, as ``roomfit listen`` does."""
    result = project.answer_file(folder)
    if not changes:
        what, needed = "there is nothing to compare yet", "one change or more"
        raise InputError(what, found="no change", needed=needed, hint="change a wall under What if")
    listen_to_folder(
        project.campaign_file(folder),
        result,
        project.inside(folder, folder / project.LISTENED),
        changes,
        doubted=doubted,
        dry=project.upload_place(folder, project.DRY, dry) if dry else None,
        overwrite=True,
        progress=progress,
    )


def ready(_: Path) -> str:
    """Return a word: all that tasks need is imported."""
    return "ready"


WORKS: dict[str, Callable[..., Any]] = {f.__name__: f for f in (identify, demo, treat, listen)}
"""What takes long, by name: of a function for progress, and the folder."""
TASKS: dict[str, Callable[..., Any]] = {
    f.__name__: f
    for f in (
        views.room_view,
        views.set_room,
        views.recordings_view,
        views.table_positions,
        answer_view,
        reverberation,
        treatment_view,
        ask_treatment,
        views.measure,
        views.look_at_upload,
        project.export,
        what_if_prepare,
        what_if,
        ready,
    )
}
"""What is answered at once, by name."""


def carry_out(progress: Progress, task: str, folder: str, arguments: Mapping[str, Any]) -> Any:
    """Return the answer of a task, by its name, about a project."""
    if task in WORKS:
        return WORKS[task](progress, Path(folder), **arguments)
    return TASKS[task](Path(folder), **arguments)
