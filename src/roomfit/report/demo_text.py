"""True beside found absorption, and what a trivial guess would have reached."""

from __future__ import annotations

import numpy as np

from roomfit.report.answer_text import findings_text
from roomfit.typing import BoolArray, FloatArray
from roomfit.uncertainty.answer import Answer


def demo_text(answer: Answer, true_absorption: FloatArray) -> str:
    """Return the table of truth and answer with intervals, and how the errors compare.

    Parameters
    ----------
    answer : Answer
    true_absorption : float array, shape (n_materials, n_bands)
    """
    parts = [_table(answer, true_absorption), _summary(answer, true_absorption)]
    parts.append(findings_text(answer.findings))
    return "\n\n".join(p for p in parts if p)


def _table(answer: Answer, true_absorption: FloatArray) -> str:
    width = max(len(n) for n in answer.materials)
    cell = f"{'true':>5} {'found':>5} {'95 %':>9} "
    lines = [
        "Absorption: true, found and its 95 % interval; ! = the interval misses the truth, "
        "? = not identifiable",
        f"{'Hz':<{width}}  " + " ".join(f"{f:^22g}" for f in answer.bands.centres_hz),
        f"{'':<{width}}  " + " ".join(f"{cell:<22}" for _ in answer.bands.centres_hz),
    ]
    held = _held(answer, true_absorption)
    for i, name in enumerate(answer.materials):
        cells = []
        for j in range(len(answer.bands)):
            mark = ("" if held[i, j] else "!") + ("" if answer.identifiable[i, j] else "?")
            bounds = f"{answer.lower95[i, j]:.2f}-{answer.upper95[i, j]:.2f}"
            text = f"{true_absorption[i, j]:5.2f} {answer.absorption[i, j]:5.2f} {bounds}{mark}"
            cells.append(f"{text:<22}")
        lines.append(f"{name:<{width}}  " + " ".join(cells).rstrip())
    return "\n".join(lines)


def _summary(answer: Answer, true_absorption: FloatArray) -> str:
    error = np.abs(answer.absorption - true_absorption)
    held = _held(answer, true_absorption)
    uniform = np.abs(answer.mean_absorption[0] - true_absorption)
    sure = answer.identifiable
    lines = [
        f"median error {np.median(error):.3f}, 90 % of errors below {np.quantile(error, 0.9):.3f}, "
        f"largest {error.max():.3f}",
        f"null model, one absorption for all walls: median error {np.median(uniform):.3f}",
        f"intervals hold the truth in {held.sum()} of {held.size} cases "
        f"({100 * held.mean():.0f} %)",
        f"called identifiable: {sure.sum()} of {sure.size}, of which {(sure & ~held).sum()} "
        "outside their interval",
        f"{answer.seconds:.1f} s for the identification",
    ]
    return "\n".join(lines)


def _held(answer: Answer, true_absorption: FloatArray) -> BoolArray:
    return np.asarray((answer.lower95 <= true_absorption) & (true_absorption <= answer.upper95))
