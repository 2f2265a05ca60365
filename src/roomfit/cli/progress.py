"""A progress bar on standard error, so that standard output stays a clean answer."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from roomfit.typing import Progress


@contextmanager
def progress_bar(label: str) -> Iterator[Progress]:
    """Give a function that moves a bar from 0 to 1; nothing is drawn where nobody watches."""
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Bar(*columns, console=console, transient=True, disable=not sys.stderr.isatty()) as bar:
        task = bar.add_task(label, total=1.0)
        yield lambda fraction: bar.update(task, completed=min(max(fraction, 0.0), 1.0))
