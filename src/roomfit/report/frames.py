"""Tables of results as data frames and as HTML, for notebooks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from importlib import import_module
from typing import Any

from roomfit.errors import InputError
from roomfit.findings import Finding


def data_frame(columns: Sequence[str], rows: Iterable[Sequence[object]], file: str) -> Any:
    """Return a pandas data frame.

    Parameters
    ----------
    columns : sequence of str
    rows : iterable of sequences, one value a column
    file : str
        Where the command line writes the same table, for the message.

    Raises
    ------
    InputError
        pandas, on which roomfit does not depend, is not installed.
    """
    try:
        pandas = import_module("pandas")
    except ImportError as error:
        raise InputError(
            "data frames need pandas",
            where="to_dataframe",
            found=str(error),
            needed="the package pandas, on which roomfit does not depend",
            hint=f"pip install pandas; or read {file}, which the command line writes",
        ) from error
    return pandas.DataFrame(list(rows), columns=list(columns))


def html_table(caption: str, columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table of texts, its first column as row headings."""
    head = "".join(f"<th>{escape(c)}</th>" for c in columns)
    body = "".join(
        f"<tr><th>{escape(first)}</th>" + "".join(f"<td>{escape(c)}</td>" for c in cells) + "</tr>"
        for first, *cells in rows
    )
    return f"<table><caption>{escape(caption)}</caption><tr>{head}</tr>{body}</table>"


def html_findings(findings: Iterable[Finding]) -> str:
    """Return findings as a list, nothing where there is none."""
    items = "".join(
        f"<li>{escape(f'{f.severity}: {f.sentence} [{f.code}]')}</li>" for f in findings
    )
    return f"<ul>{items}</ul>" if items else ""
