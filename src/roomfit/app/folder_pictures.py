"""The pictures of an answer as files in its folder."""

from __future__ import annotations

from pathlib import Path

from roomfit.files.store import write_bytes_atomically
from roomfit.typing import Progress
from roomfit.uncertainty.answer import Answer

# The report shows the decays of all pairs; as files of their own they would take minutes.
MOST_DECAY_PICTURES = 12


def write_pictures(folder: Path, answer: Answer, progress: Progress | None = None) -> None:
    """Write absorption, what is identifiable, profiles, samples and decays as PNG files.

    Profiles and samples only where there are some; decays of the first twelve pairs.

    Parameters
    ----------
    folder : Path
    answer : Answer
    progress : callable, optional

    Raises
    ------
    StoreError
        The disk refuses.
    """
    from roomfit.report.answer_pictures import absorption_figure, decay_figure
    from roomfit.report.certainty_pictures import (
        corner_figure,
        identifiability_figure,
        profiles_figure,
    )
    from roomfit.report.pictures import png

    write_bytes_atomically(folder / "absorption.png", png(absorption_figure(answer)))
    write_bytes_atomically(folder / "identifiable.png", png(identifiability_figure(answer)))
    bent, corner = profiles_figure(answer), corner_figure(answer)
    if bent is not None:
        write_bytes_atomically(folder / "profiles.png", png(bent))
    if corner is not None:
        write_bytes_atomically(folder / f"corner_{corner[0]:g}_hz.png", png(corner[1]))
    heard = [(number, p) for number, p in enumerate(answer.pairs, start=1) if p.decay]
    for number, pair in heard[:MOST_DECAY_PICTURES]:
        name = f"decay_{number:02d}_{_in_file_name(pair.source)}_{_in_file_name(pair.receiver)}"
        write_bytes_atomically(folder / f"{name}.png", png(decay_figure(answer, pair)))
        if progress is not None:
            progress(number / len(answer.pairs))


def _in_file_name(name: str) -> str:
    """Return a name without what a path gives a meaning to."""
    return "".join(c if c.isalnum() or c in "-_." else "_" for c in name)[:60]
