"""What `roomfit paper` leaves behind: paper.json, CSV tables and pictures."""

from __future__ import annotations

from pathlib import Path

from roomfit.app.suh2001.figures import paper_figures
from roomfit.app.suh2001.json_content import paper_json
from roomfit.app.suh2001.repeat import PaperResult, PaperSettings, repeat_paper
from roomfit.app.suh2001.tables import paper_tables
from roomfit.files.store import (
    check_output_folder,
    whole_output_folder,
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
    check_output_folder(folder, overwrite=overwrite)
    result = repeat_paper(settings, progress=progress)
    with whole_output_folder(folder, overwrite=overwrite) as aside:
        for name, text in paper_tables(result).items():
            write_text_atomically(aside / name, text)
        for name, figure in paper_figures(result).items():
            write_bytes_atomically(aside / name, png(figure))
        write_json_atomically(aside / "paper.json", paper_json(result))
    return result
