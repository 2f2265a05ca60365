"""Use case: see the main job at work on a room whose truth is known."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from roomfit.app.identify import identify_to_folder
from roomfit.app.progress import part
from roomfit.files.store import whole_output_folder, write_bytes_atomically
from roomfit.testproblems.measured_box import MeasuredBox, demo_plan, write_measured_box
from roomfit.typing import FloatArray, Progress
from roomfit.uncertainty.answer import Answer


@dataclass(frozen=True, slots=True, eq=False)
class DemoResult:
    """An answer and the truth behind the data.

    Attributes
    ----------
    answer : Answer
    true_absorption : float array, shape (n_materials, n_bands)
        In the answer's order of materials and bands.
    """

    answer: Answer
    true_absorption: FloatArray


def run_demo(
    out: Path, seed: int, *, overwrite: bool = False, progress: Progress | None = None
) -> DemoResult:
    """Write a simulated campaign into ``out/campaign`` and its identification into ``out/result``.

    Raises
    ------
    InputError
        The folder is not empty and `overwrite` is false.
    StoreError
        The disk refuses.
    """
    from roomfit.report.answer_pictures import absorption_figure
    from roomfit.report.pictures import png

    with whole_output_folder(out, overwrite=overwrite) as folder:
        (folder / "campaign").mkdir()
        box = write_measured_box(
            demo_plan(),
            folder / "campaign",
            np.random.default_rng(seed),
            progress=part(progress, 0.0, 0.4),
        )
        answer = identify_to_folder(
            box.campaign, folder / "result", progress=part(progress, 0.4, 1.0)
        )
        truth = _truth(box, answer)
        picture = png(absorption_figure(answer, truth))
        write_bytes_atomically(folder / "result" / "absorption_and_truth.png", picture)
    return DemoResult(answer, truth)


def _truth(box: MeasuredBox, answer: Answer) -> FloatArray:
    """Return the true absorption in the answer's order of materials and bands."""
    rows = [box.materials.index(name) for name in answer.materials]
    columns = [int(np.argmin(np.abs(box.centres_hz - f))) for f in answer.bands.centres_hz]
    return box.absorption[np.ix_(rows, columns)]
