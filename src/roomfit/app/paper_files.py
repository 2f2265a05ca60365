"""What `roomfit paper` leaves behind: paper.json, CSV tables and pictures."""

from __future__ import annotations

from pathlib import Path

from roomfit.app.paper import PaperResult, PaperSettings, repeat_paper
from roomfit.app.paper_figures import paper_figures
from roomfit.app.paper_json import paper_json
from roomfit.app.paper_tables import paper_tables
from roomfit.files.store import (
    new_output_folder,
    write_bytes_atomically,
    write_json_atomically,
    write_text_atomically,
)
from roomfit.report.pictures import png
from roomfit.typing import Progress


def run_paper(
    folder: Path,
    settings: PaperSettings | None = None,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> PaperResult:
    """Repeat the paper and write paper.json, CSV tables and pictures into a folder.

    Nothing is written before everything is known.

    Raises
    ------
    InputError
        The folder exists and is not empty, and `overwrite` is false.
    """
    folder = new_output_folder(folder, overwrite=overwrite)
    result = repeat_paper(settings, progress=progress)
    for name, text in paper_tables(result).items():
        write_text_atomically(folder / name, text)
    for name, figure in paper_figures(result).items():
        write_bytes_atomically(folder / name, png(figure))
    write_json_atomically(folder / "paper.json", paper_json(result))
    return result
