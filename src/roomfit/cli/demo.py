"""``roomfit demo``: the identification of a room whose absorption is known."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np

from roomfit.base.table import Cell
from roomfit.base.typing import FloatArray, Progress, part
from roomfit.base.whole_files import sole_writer, whole_output_folder
from roomfit.cli.identify import identify_to_folder
from roomfit.demo.boxes import PLAN_BANDS, demo_plan, write_measured_box
from roomfit.report.blocks import Blocks, Drawing, Findings, Listed
from roomfit.report.figures import write_pictures
from roomfit.report.wording import band_tables
from roomfit.result import Result


def demo(**options: Any) -> Blocks:
    """Return absorption beside the truth, and how well it was found, see `run_demo`."""
    answer, true_absorption = run_demo(**options)
    covered = (answer.lower95 <= true_absorption) & (true_absorption <= answer.upper95)
    sure, rows = answer.identifiable, []
    for i, name in enumerate(answer.materials):
        cells = []
        for j in range(len(answer.bands)):
            mark = ("" if covered[i, j] else "!") + ("" if sure[i, j] else "?")
            small = f"{answer.lower95[i, j]:.2f}-{answer.upper95[i, j]:.2f}{mark}"
            both = f"{true_absorption[i, j]:.2f} {answer.absorption[i, j]:.2f}"
            cells.append(Cell(both, (small,)))
        rows.append((name, *cells))
    caption = (
        "Absorption: true, found and its 95 % interval; ! = the true value lies outside, "
        "? = not identifiable"
    )
    error = np.abs(answer.absorption - true_absorption)
    uniform = np.abs(answer.mean_absorption[0] - true_absorption)
    lines = (
        f"median error {np.median(error):.3f}, 90 % of errors below {np.quantile(error, 0.9):.3f}, "
        f"largest {error.max():.3f}",
        f"baseline, one absorption for all walls: median error {np.median(uniform):.3f}",
        f"coverage: the interval contains the truth in {covered.sum()} of {covered.size} cases "
        f"({100 * covered.mean():.0f} %)",
        f"called identifiable: {sure.sum()} of {sure.size}, of which {(sure & ~covered).sum()} "
        "outside their interval",
        f"{answer.seconds:.1f} s for the identification",
    )
    tables = band_tables(caption, "", answer.bands.centres_hz, rows)
    return Blocks("Demo", (*tables, Listed(lines)), (Findings(answer.findings),))


@sole_writer
def run_demo(
    out: Path,
    seed: int,
    *,
    overwrite: bool = False,
    png: bool = False,
    progress: Progress | None = None,
) -> tuple[Result, FloatArray]:
    """Write a simulated campaign into ``out/campaign`` and its identification into ``out/result``.

    Returned are the answer and the absorption with which its data were simulated, shape
    (n_materials, n_bands), in the answer's order.
    """
    with whole_output_folder(out, overwrite=overwrite) as folder:
        (folder / "campaign").mkdir()
        plan, rng = demo_plan(), np.random.default_rng(seed)
        logging.getLogger("roomfit").info("simulating measurements")
        campaign = write_measured_box(plan, folder / "campaign", rng, part(progress, 0.0, 0.4))
        answer = identify_to_folder(
            campaign, folder / "result", png=png, progress=part(progress, 0.4, 1.0)
        )
        rows = [plan.materials.index(name) for name in answer.materials]
        at = [int(np.argmin(np.abs(PLAN_BANDS.centres_hz - f))) for f in answer.bands.centres_hz]
        true_absorption: FloatArray = plan.absorption[np.ix_(rows, at)]
        title, of = "Absorption that was found, and the true one", (answer, true_absorption)
        picture = Drawing("absorption_and_truth", title, "", "absorption_figure", of)
        write_pictures(folder / "result", Blocks("", (picture,), ()), png_too=png)
    return answer, true_absorption
