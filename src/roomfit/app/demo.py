"""Use case: see the main job at work on a room whose truth is known."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from roomfit.app.identify import identify_to_folder
from roomfit.app.progress import part
from roomfit.files.store import new_output_folder, write_bytes_atomically
from roomfit.testproblems.measured_box import demo_plan, write_measured_box
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
    """
    from roomfit.report.answer_pictures import absorption_figure
    from roomfit.report.pictures import png

    new_output_folder(out, overwrite=overwrite)
    folder = new_output_folder(out / "campaign", overwrite=overwrite)
    rng = np.random.default_rng(seed)
    box = write_measured_box(demo_plan(), folder, rng, progress=part(progress, 0.0, 0.4))
    answer = identify_to_folder(
        box.campaign, out / "result", overwrite=overwrite, progress=part(progress, 0.4, 1.0)
    )
    rows = [box.materials.index(name) for name in answer.materials]
    columns = [int(np.argmin(np.abs(box.centres_hz - f))) for f in answer.bands.centres_hz]
    truth = box.absorption[np.ix_(rows, columns)]
    picture = png(absorption_figure(answer, truth))
    write_bytes_atomically(out / "result" / "absorption_and_truth.png", picture)
    return DemoResult(answer, truth)
