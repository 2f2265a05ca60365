"""What findings advise, as changes of the campaign file.

A finding says which key is to be what (`roomfit.base.findings.Remedy`); here this becomes the lines
of one campaign: in which table a recording stands, and what stands there already.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from roomfit.base.arguments import in_short
from roomfit.base.door import read_bytes
from roomfit.base.errors import InputError
from roomfit.base.findings import About, Code, Edit, Finding, Remedy
from roomfit.files.campaign import Campaign, read_toml
from roomfit.files.edits import lines_of, stated, value_text
from roomfit.files.responses.recordings import UnchosenChannelError
from roomfit.model.observation import DEFAULT_POSITION_SD_M

Advice: TypeAlias = Mapping[Code, Sequence[str]]
"""By code, the lines that findings advise to write into a campaign, as a reader may copy them."""
_MOST_LINES, _MOST_OPTIONS = 8, 12  # shown; all are written
_Content: TypeAlias = Mapping[str, Any]
_Rows: TypeAlias = dict[int, dict[str, Any]]  # by the place of a recording, its keys


def advised(
    findings: Sequence[Finding], campaign: Campaign, *, changed: bool = False
) -> dict[Code, tuple[Remedy, ...]]:
    """Return what findings advise to write into a campaign, those of one code together.

    Left out is what the campaign says already, and names that it does not have.

    Where the campaign was `changed` since they were raised, what counts from its values is none of
    it any more. Its file is read again, for it alone says in which table a value stands.
    """
    content, found = read_toml(campaign.path), {}
    for code in dict.fromkeys(f.code for f in findings):
        own = [f for f in findings if f.code is code and f.remedies]
        resolved = [
            (remedy, *_resolved(remedy, finding, campaign, content))
            for finding in own
            for remedy in finding.remedies
            if not (changed and remedy.once)
        ]
        # findings that say one thing of several recordings: that of all of them first
        said = [values for _, rows, _ in resolved for values in rows.values()]
        if 1 < len(own) == len(resolved) and all(v == said[0] and len(v) == 1 for v in said):
            every = {i: values for _, rows, _ in resolved for i, values in rows.items()}
            resolved.insert(0, (resolved[0][0], every, []))
        options = {r.words: r for x in resolved for r in _written(*x, campaign, content)}
        if options:
            found[code] = tuple(options.values())
    return found


def unchosen(error: UnchosenChannelError) -> Finding:
    """Return that no channel was chosen as a finding, with each choice as a remedy."""
    remedies = [
        Remedy([Edit(("defaults",), "channel", n)], f"channel = {n} for all recordings")
        for n in range(int(str(error.found).partition(" ")[0]))
    ]
    text, about = f"{error.what}: {error.found}.", About(files=[str(error.where)])
    return Finding(Code.RECORDING_UNUSABLE, about, text, remedies=remedies)


def advice(findings: Sequence[Finding], campaign: Campaign) -> Advice:
    """Return the lines of what findings advise, as text and report show them.

    Where there is a choice, each begins with its number and its words. Nothing where the campaign
    cannot be read any more: an answer that took minutes is not lost for that.
    """
    shown: dict[Code, list[str]] = {}
    try:
        found = advised(findings, campaign)
    except InputError:
        return shown
    for code, options in found.items():
        written = lines_of(options[0].edits)
        lines = written[:_MOST_LINES]
        if len(written) > _MOST_LINES:
            lines.append(f"# and {len(written) - _MOST_LINES} lines more")
        if options[1:]:
            lines.insert(0, f"# {code}:1, {options[0].words}")
            others = [f"# or {code}:{n}, {o.words}" for n, o in enumerate(options, start=1)]
            lines += others[1:_MOST_OPTIONS]
        if len(options) > _MOST_OPTIONS:
            lines.append(f"# and {len(options) - _MOST_OPTIONS} others")
        shown[code] = lines
    return shown


def changed_since(content: Mapping[str, Any], file: Path) -> bool:
    """Return whether the campaign of a ``result.json`` was changed since, or cannot be read."""
    inputs = content.get("provenance", {}).get("inputs_sha256", {})
    digests = [d for name, d in inputs.items() if Path(name).name == file.name]
    try:
        now = sha256(read_bytes(file, "campaign")).hexdigest()
    except InputError:
        return True
    return bool(digests) and now not in digests


def chosen(options: Mapping[Code, Sequence[Remedy]], wanted: str) -> Remedy:
    """Return the remedy that is named by a code, or by a code and its number as in ``CODE:2``."""
    name, _, number = wanted.partition(":")
    own = {code.value: found for code, found in options.items()}.get(name, ())
    n = int(number or 1) if (number or "1").isdecimal() else 0
    if not 0 < n <= len(own):
        known = [f"{c}:1 to {c}:{len(o)}" if o[1:] else str(c) for c, o in options.items()]
        raise InputError(
            "no finding advises this",
            where="--remedy",
            found=wanted,
            needed=", ".join(known) or "a finding that names what to write; there is none",
            hint="roomfit check CAMPAIGN shows them; for those of an answer add --result FOLDER",
        )
    return own[n - 1]


def is_file(named: str, file: str) -> bool:
    """Whether a name, perhaps without folders, or with more, or with a part in brackets, fits."""
    own = Path(file).parts
    for text in (named, named.rpartition("[")[0]):
        parts = Path(text).parts
        n = min(len(own), len(parts))
        if n and own[-n:] == parts[-n:]:
            return True
    return False


def _resolved(
    remedy: Remedy, finding: Finding, campaign: Campaign, content: _Content
) -> tuple[_Rows, list[Edit]]:
    """Return what a remedy says of recordings of a campaign, and of everything else."""
    rows: _Rows = {}
    edits = []
    for edit in remedy.edits:
        for table, now in _meant_tables(edit, finding, campaign, content):
            if edit.now and now not in edit.now:
                if remedy.words:  # those of all edits together
                    return {}, []
                continue
            value = _value(edit, now)
            if table[0] == "measurements":
                rows.setdefault(int(table[1]), {})[edit.key] = value
            else:
                edits.append(Edit(table, edit.key, value))
    return rows, edits


def _meant_tables(
    edit: Edit, finding: Finding, campaign: Campaign, content: _Content
) -> Iterator[tuple[tuple[str | int, ...], Any]]:
    """Yield the tables that an edit means, a recording by its place, and what is said there."""
    kind, *names = edit.table
    tables: Mapping[str, Mapping[str, Any]] = {
        "sources": campaign.source_tables,
        "receivers": campaign.receiver_tables,
    }
    points = tables.get(str(kind))
    if kind == "measurements":
        for file in finding.about.files if names == ["*"] else map(str, names):
            for i in _concerned(file, finding.about.pairs, campaign):
                yield (kind, i), getattr(campaign.measurements[i], edit.key)
    elif points is not None:
        for name in points if names == ["*"] else names:
            if name in points:
                yield (kind, name), getattr(points[str(name)], edit.key)
    else:
        now = stated(content, edit)
        if edit.key == "unit" and campaign.room.file is None:
            now = now or "m"
        yield edit.table, now


def _concerned(file: str, pairs: Sequence[tuple[str, str]], campaign: Campaign) -> Sequence[int]:
    """Return which measurements of a campaign are meant by a file, and by the pairs beside it."""
    own = list(enumerate(campaign.measurements))
    found = [i for i, m in own if m.response.where == file]
    # written on another machine, or by the name alone
    found = found or [i for i, m in own if is_file(file, str(m.response.path))]
    measured = campaign.measurements
    return [i for i in found if not pairs or (measured[i].source, measured[i].receiver) in pairs]


def _value(edit: Edit, now: Any) -> Any:
    """Return what is to stand where something stands now: to 0.1 mm, or 0.01 ms of a latency."""
    if edit.how == "set":
        return tuple(edit.value) if isinstance(edit.value, list) else edit.value
    if now is None and edit.key == "position_sd":
        now = DEFAULT_POSITION_SD_M
    old, by = np.asarray(now, dtype=np.float64), np.asarray(edit.value, dtype=np.float64)
    new = np.round(old + by if edit.how == "add" else old * by, 5 if edit.key == "latency_s" else 4)
    if edit.key == "position_sd":
        new = np.minimum(new, 1.0)  # no standard deviation may be larger
    return tuple(new.tolist()) if new.ndim else float(new)


def _written(
    remedy: Remedy, rows: _Rows, others: list[Edit], campaign: Campaign, content: _Content
) -> Iterator[Remedy]:
    """Yield a remedy as the keys that it changes in the file, unless all stand there already."""
    edits = [
        e
        for e in (*_of_recordings(campaign, content, rows), *others)
        if stated(content, e) != (list(e.value) if isinstance(e.value, tuple) else e.value)
    ]
    if not edits:
        return
    words = remedy.words
    if not words:
        named: list[str] = [str(e.table[1]) for e in others if len(e.table) > 1]
        said = list(rows.values()) or [{e.key: e.value} for e in others]
        ((key, value),) = said[0].items()
        words = f"{key} = {value_text(value)}" if all(v == said[0] for v in said) else key
        who = _names(campaign, list(rows)) if rows else in_short(list(dict.fromkeys(named)))
        words += f" for {who}" if who else ""
    yield Remedy(tuple(edits), words, remedy.once)


def _of_recordings(campaign: Campaign, content: _Content, values: _Rows) -> tuple[Edit, ...]:
    """Return what says something of some measurements, by their place in the campaign.

    One key under [defaults] where it holds of all, with the rows that state it themselves; else a
    row of each, a new one where its file was found by its name.
    """
    rows = content.get("measurements", [])
    own = [n for n, row in enumerate(rows, start=1) if "file" in row]
    first = next(iter(values.values()), {})
    if len(values) == len(campaign.measurements) > 1 and all(v == first for v in values.values()):
        common = [Edit(("defaults",), key, value) for key, value in first.items()]
        stating = [(n, key) for n in own for key in first if key in rows[n - 1]]
        return (*common, *(Edit(("measurements", n), key, first[key]) for n, key in stating))
    edits, n_new = [], 0
    for i, said in values.items():
        row = own[i] if i < len(own) else 0
        if not row:
            n_new += 1
            row, m, folder = len(rows) + n_new, campaign.measurements[i], campaign.path.parent
            path = m.response.path
            inside = folder in path.parents
            file = path.relative_to(folder).as_posix() if inside else str(path)
            said = {"source": m.source, "receiver": m.receiver, "file": file, **said}
        edits += [Edit(("measurements", row), key, value) for key, value in said.items()]
    return tuple(edits)


def _names(campaign: Campaign, chosen: Sequence[int]) -> str:
    """Return recordings in words: all of them, or their files."""
    n = len(campaign.measurements)
    if len(chosen) == n > 1:
        return f"all {n} recordings"
    return in_short([campaign.measurements[i].response.path.name for i in chosen])
