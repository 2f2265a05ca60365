"""A campaign file with some keys changed, all else as it is written; shown before, undone after.

The text is changed statement by statement: whoever wrote it finds it in its order, with its
comments, and no package that rewrites TOML is needed.
"""

from __future__ import annotations

import json
import os
import re
import secrets
import tomllib
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from datetime import date, time
from hashlib import sha256
from itertools import groupby, pairwise
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

from roomfit.base.door import read_text
from roomfit.base.errors import InputError, located
from roomfit.base.findings import Edit
from roomfit.base.whole_files import locked, write_json_atomically, write_text_atomically
from roomfit.files.campaign import Campaign, read_campaign

_UNDO = ".roomfit-undo.json"  # the campaign before the last remedy, and the digest of it after
_Path: TypeAlias = tuple[str | int, ...]


def value_text(value: object) -> str:
    """Return a value as TOML writes it."""
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{_key_text([k])} = {value_text(v)}' for k, v in value.items())}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(value_text, value))}]"
    if isinstance(value, date | time):
        return value.isoformat()
    return repr(value) if isinstance(value, float) else json.dumps(value, ensure_ascii=False)


def _key_text(path: Sequence[str | int]) -> str:
    """Return the names of a path as a key with dots; what counts rows is left out."""
    names = (name for name in path if isinstance(name, str))
    return ".".join(n if re.fullmatch(r"[\w-]+", n, re.ASCII) else value_text(n) for n in names)


def heading(table: Sequence[str | int]) -> str:
    """Return a table as its first line names it."""
    text = f"[{_key_text(table)}]"
    return f"[{text}]" if table and isinstance(table[-1], int) else text


def lines_of(edits: Sequence[Edit]) -> list[str]:
    """Return what edits write, as somebody would by hand: each table once, and its keys below."""
    lines = []
    for table, own in groupby(edits, key=lambda edit: edit.table):
        number = f", no. {table[-1]}" if isinstance(table[-1], int) else ""
        keys = [f"{_key_text([edit.key])} = {value_text(edit.value)}" for edit in own]
        lines += [heading(table) + number, *keys]
    return lines


class _Statement(NamedTuple):
    """Whole lines of a file: a key, the line that begins a table, or a blank or a comment."""

    text: str
    table: _Path  # in which it stands, or which it begins
    key: tuple[str, ...] = ()  # below the table
    begins: bool = False  # a table

    def concerns(self, path: _Path) -> bool:
        """Whether it states a key, or begins a table, at a path or below it."""
        return (self.begins or bool(self.key)) and self.path[: len(path)] == path

    @property
    def path(self) -> _Path:
        return (*self.table, *self.key)


def edited_text(text: str, edits: Sequence[Edit]) -> str:
    """Return the text of a campaign with some keys changed; all else stays as it is written.

    A new key stands below the last one of its table, a new table at the end. Each line that is a
    comment stays, also of what is taken out.
    """
    what, found = "the campaign file is not valid TOML", ""
    try:
        expected, after = tomllib.loads(text), text
        what = "the campaign is written in a way that this cannot edit"
        for edit in edits:
            _set(expected, (*edit.table, edit.key), edit.value)
            after = _edited(after, edit)
        if _filled(tomllib.loads(after)) == _filled(expected):
            return after
    except (ValueError, RecursionError, TypeError, AttributeError) as error:
        found = f": {error}"[:200]
    raise InputError(
        what,
        found=", ".join(dict.fromkeys(heading(edit.table) for edit in edits)) + found,
        needed="tables such as [sources.NAME], one key a line",
        hint=f"write into campaign.toml by hand: {', '.join(lines_of(edits)[:5])}",
    )


def without_tables(text: str, tables: Collection[_Path]) -> str:
    """Return a text without some tables, and what is below them; lines that are comments stay."""
    return "".join(
        _comments(one.text) if any(one.table[: len(t)] == t for t in tables) else one.text
        for one in _statements(text)
    )


def _edited(text: str, edit: Edit) -> str:
    """Return a text with one key changed; whether that is all is for the caller to see."""
    own, path = list(_statements(text)), (*edit.table, edit.key)
    for i, one in enumerate(own):
        within = one.key and one.path == path[: len(one.path)]
        if within and (edit.value is not None or one.path != path):
            own[i] = one._replace(text=_with_value(one.text, path[len(one.path) :], edit.value))
            break
    else:
        if edit.value is not None:
            _add(own, edit, "\r\n" if "\r\n" in text else "\n")
        else:
            own = [s._replace(text=_comments(s.text)) if s.concerns(path) else s for s in own]
    return "".join(one.text for one in own)


def _add(own: list[_Statement], edit: Edit, end: str) -> None:
    """Add a key below the last one of its table, above comments that lead to the next one."""
    beside = [i for i, one in enumerate(own) if one.concerns(edit.table)]
    straight = [i for i in beside if own[i].table == edit.table]
    # a key of a table that is written as keys with dots is another of these
    dotted = [i for i in beside if len(own[i].table) < len(edit.table)]
    at, table, indent = max(straight or dotted, default=-1), edit.table, ""
    if at >= 0:
        last = own[at]
        table = last.table
        own[at] = last._replace(text=last.text + ("" if last.text.endswith("\n") else end))
        indent = last.text[: -len(last.text.lstrip())] if last.key else ""
    elif table:
        if before := "".join(one.text for one in own).rstrip():
            own[:] = [_Statement(f"{before}{end}{end}", ())]
        own.append(_Statement(heading(table) + end, table))
        at = len(own) - 1
    key = _key_text([*edit.table[len(table) :], edit.key])
    line = f"{indent}{key} = {value_text(edit.value)}{end}"
    own.insert(at + 1, _Statement(line, table))


def _statements(text: str) -> Iterator[_Statement]:
    """Yield a TOML file in its order, nothing left out."""
    table: _Path = ()
    rows: Counter[_Path] = Counter()
    waiting = ""
    for line in _lines(text):
        waiting += line
        bare = waiting.strip()
        if not bare or bare.startswith("#"):
            yield _Statement(waiting, table)
        elif not _is_toml(waiting):
            continue  # a value that goes on in the next line
        elif bare.startswith("["):
            table, names = (), _names(tomllib.loads(waiting))
            for name in names:
                table = (*table, name)
                rows[table] += bare.startswith("[[") and len(table) == len(names)
                table = (*table, rows[table]) if rows[table] else table
            yield _Statement(waiting, table, begins=True)
        else:
            key = _names(tomllib.loads(f"{waiting[: _equals(waiting)]}= 0"))
            yield _Statement(waiting, table, key)
        waiting = ""


def _lines(text: str) -> list[str]:
    """Return lines with their ends, by line feeds alone, as TOML has them."""
    return re.findall(r"[^\n]*\n|[^\n]+", text)


def _names(content: Any) -> tuple[str, ...]:
    """Return the names on the way to the one thing that a statement states."""
    if isinstance(content, list):
        return _names(content[0])
    if not isinstance(content, dict) or not content:
        return ()
    ((name, below),) = content.items()
    return (name, *_names(below))


def _equals(text: str) -> int:
    """Return where the = of a statement stands: the first one that is not part of the key."""
    return next(at for at in _indices("=", text) if _is_toml(f"{text[:at]}= 0"))


def _indices(letter: str, text: str) -> list[int]:
    return [found.start() for found in re.finditer(letter, text)]


def _is_toml(text: str) -> bool:
    try:
        tomllib.loads(text)
    except ValueError:
        return False
    return True


def _with_value(text: str, below: _Path, value: object) -> str:
    """Return a statement with another value, or with another at a path below; comments stay."""
    at = _equals(text) + 1
    # the first # behind something complete begins the comment
    ends = [i for i in _indices("#", text) if i > at and _is_toml(text[:i])]
    old = text[at : ends[0] if ends else None].rstrip()
    new = value
    if below:
        if "\n" in old:
            raise ValueError("a value of several lines")
        holder = tomllib.loads(f"x = {old}")
        _set(holder, ("x", *below), value)
        new = holder["x"]
    lead = old[: -len(old.lstrip())]
    return f"{_comments(old)}{text[:at]}{lead}{value_text(new)}{text[at + len(old) :]}"


def _comments(text: str) -> str:
    return "".join(line for line in _lines(text) if line.lstrip().startswith("#"))


def _set(part: Any, path: _Path, value: object) -> None:
    """Set or take out what stands at a path of plain content; tables are made where missing."""
    for name, below in pairwise(path):
        if isinstance(name, int):
            part += [{} for _ in range(name - len(part))]
            part = part[name - 1]
        else:
            part = part.setdefault(name, [] if isinstance(below, int) else {})
    if value is None:
        part.pop(path[-1], None)
    else:
        part[path[-1]] = list(value) if isinstance(value, tuple) else value


def _filled(content: Any) -> Any:
    """Return content without empty tables: one whose keys are gone need not be named."""
    if not isinstance(content, dict):
        return [_filled(one) for one in content] if isinstance(content, list) else content
    filled = {name: _filled(own) for name, own in content.items()}
    return {name: own for name, own in filled.items() if own != {}}


def stated(content: Any, edit: Edit) -> object:
    """Return what plain content says already at the place of an edit, None where nothing."""
    for name in (*edit.table, edit.key):
        if isinstance(name, int):
            content = (content if isinstance(content, list) else [])[name - 1 : name]
            content = content[0] if content else None
        else:
            content = content.get(name) if isinstance(content, Mapping) else None
    return content


# Shown before, written, undone after.


@dataclass(frozen=True, slots=True)
class Preview:
    """What a remedy would write into a campaign."""

    before: str  # the whole text
    after: str
    lines: tuple[tuple[str, str, str], ...]  # the table, its line as it is, and as it would be


def campaign_text(file: Path) -> str:
    """Return the text of a campaign file."""
    return read_text(file, "campaign file", most="campaign_bytes")


@contextmanager
def read_beside(folder: Path, text: str) -> Iterator[Campaign]:
    """Read what would be a campaign beside that of the folder, for paths are relative to it."""
    beside = folder / f".roomfit-{secrets.token_hex(8)}.toml"
    try:
        write_text_atomically(beside, text)
        yield read_campaign(beside, to_fit=False)
    finally:
        beside.unlink(missing_ok=True)


def preview(file: Path, edits: Sequence[Edit]) -> Preview:
    """Return what a campaign would be with some keys changed, and write nothing."""
    before = campaign_text(file)
    after, content, lines = edited_text(before, edits), tomllib.loads(before), []
    for edit in edits:
        old = stated(content, edit)
        now = "not stated" if old is None else lines_of([Edit(edit.table, edit.key, old)])[1]
        table, then = lines_of([edit])
        lines.append((table, now, then))
    with read_beside(file.parent, after):
        return Preview(before, after, tuple(lines))


@contextmanager
def sole_editor(file: Path, wait_s: float = 5.0) -> Iterator[None]:
    """Keep a file to this thread while it is read, changed and written, by a lock beside it.

    On a disk without locks nobody waits, nor where nothing can be written, which whoever writes
    will say.
    """
    # beside the name, not beside what it may be a link to: there the new file comes into being
    file = file.parent.resolve() / file.name
    can_write = os.access(file.parent, os.W_OK | os.X_OK)
    with locked(file, wait_s) if can_write else nullcontext():
        yield


def rewrite(file: Path, change: Callable[[str], str]) -> None:
    """Change the text of a campaign, which no other process of roomfit changes meanwhile.

    `change`: returns the text that is to stand there, of the one that does; where both are equal
    the file keeps its time.
    """
    with sole_editor(file), located(str(file)):
        before = campaign_text(file)
        after = change(before)
        if after != before:
            write_text_atomically(file, after)


def apply(file: Path, wanted: Preview) -> None:
    """Write what was previewed, and keep the text that was there: one step can be undone."""

    def change(text: str) -> str:
        if text != wanted.before:
            raise InputError(
                "the campaign has changed since this was shown",
                found="another text than before",
                needed="the text that the lines were shown for",
                hint="look at what is written now, and apply that",
            )
        kept = {"before": text, "written": sha256(wanted.after.encode()).hexdigest()}
        write_json_atomically(file.with_name(_UNDO), kept)
        return wanted.after

    rewrite(file, change)


def undoable(file: Path) -> str | None:
    """Return the campaign before the last remedy, None where there is none or it was edited since.

    Also where either cannot be read.
    """
    try:
        kept = json.loads(read_text(file.with_name(_UNDO), "text to be undone to"))
        same = kept["written"] == sha256(campaign_text(file).encode()).hexdigest()
        return str(kept["before"]) if same else None
    except (InputError, ValueError, KeyError, TypeError):
        return None


def undo(file: Path) -> None:
    """Write the campaign as it was before the last remedy, unless it was edited since."""

    def change(_: str) -> str:
        if (before := undoable(file)) is None:
            raise InputError(
                "nothing can be undone",
                found="no remedy, or a campaign that was edited after it",
                needed="the campaign as the last remedy left it",
                hint=f"edit {file.name} by hand",
            )
        return before

    rewrite(file, change)
    file.with_name(_UNDO).unlink(missing_ok=True)
