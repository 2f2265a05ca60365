"""What to hang where, as its form has it: products and targets in treatment.toml, and the answer.

The form is the file: it changes keys, and what it does not show stays as it is written.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeAlias

from roomfit.app import project
from roomfit.base.door import read_text
from roomfit.base.errors import InputError
from roomfit.base.typing import Progress
from roomfit.base.whole_files import write_text_atomically
from roomfit.files.campaign import read_toml
from roomfit.files.edits import Edit, edited_text, heading, without_tables
from roomfit.files.encoding import written_content
from roomfit.files.inputs import campaign_room
from roomfit.files.reverberation import read_decay_times
from roomfit.room.scene import material_areas_m2
from roomfit.treat.campaign import checked_treatment

_FIRST = "# What may be hung where, and what is to be reached: roomfit treat, docs/treat.md\n"


def treatment_view(
    _: Progress, folder: str, bands_hz: Sequence[float] = (), fault: str = ""
) -> dict[str, Any]:
    """Return surfaces with their areas, what is asked, and the sentence of the last answer."""
    root = Path(folder)
    with project.filled_campaign(root) as campaign:
        room = campaign_room(campaign)
        times = campaign.reverberation
    from_times = False
    if times is not None and not bands_hz:
        from_times = True
        bands_hz = read_decay_times(root / times.file)[1].centres_hz.tolist()
    question: dict[str, Any] = {}
    file, answer = (root / name for name in (project.TREATMENT_QUESTION, project.TREATMENT))
    try:
        if file.is_file():
            question = read_toml(file, "treatment file")
            checked_treatment(file, question)
    except InputError as error:
        fault = str(error)
    sentence = ""
    with suppress(InputError, LookupError, TypeError):  # none yet, or of an earlier version
        sentence = written_content(answer / "treatment.json", "treatment")[0]["sentence"]
    return {
        "areas_m2": dict(
            zip(room.materials, material_areas_m2(room).round(2).tolist(), strict=True)
        ),
        "bands_hz": list(bands_hz),
        "from_times": from_times,
        "question": question,
        "fault": fault,
        "sentence": str(sentence),
    }


def ask_treatment(_: Progress, folder: str, question: dict[str, Any]) -> None:
    """Write what is asked into treatment.toml, whole or not at all."""
    for key, what, hint in (
        ("surfaces", "no surface may be covered", "tick a surface"),
        ("products", "there is nothing to hang", "choose a product from the catalogue"),
        ("targets", "there is no target", "add a target"),
    ):
        if not question.get(key):
            raise InputError(what, found="none", needed="at least one", hint=hint)
    for number, target in enumerate(question["targets"], start=1):
        if not {"at_most", "at_least", "value", "standard"} & set(target):
            raise InputError(
                "a target has no limit",
                where=f"target {number}",
                found="two empty fields",
                needed="a number below At most, At least, or both",
                hint="type one, or remove the target",
            )
    file = Path(folder) / project.TREATMENT_QUESTION
    text = read_text(file, "treatment file", most="campaign_bytes") if file.is_file() else _FIRST
    after = written_question(text, question)
    checked_treatment(file, tomllib.loads(after))
    if after != text:
        write_text_atomically(file, after)


def written_question(text: str, question: Mapping[str, Any]) -> str:
    """Return the text of a treatment file with another content; what is equal stays as written."""
    then = _tables(question)
    try:
        now = _tables(tomllib.loads(text))
        after = without_tables(text, [table for table in now if table not in then])
        edits = [Edit(t, k, v) for t, own in then.items() for k, v in own.items()]
        edits = [e for e in edits if now.get(e.table, {}).get(e.key) != e.value]
        gone = [Edit(t, k, None) for t in then for k in now.get(t, {}) if k not in then[t]]
        after = edited_text(after, [*gone, *edits])
        # of a table without keys its first line is all
        bare = [t for t, own in then.items() if not own and t not in now and _ends(t, then)]
        if bare:
            after = "".join((after.rstrip("\n"), *(f"\n\n{heading(t)}" for t in bare), "\n"))
        as_wanted = tomllib.loads(after) == question
    except (ValueError, RecursionError, InputError):
        as_wanted = False
    if not as_wanted:
        raise InputError(
            "the treatment file is written in a way that this cannot edit",
            where=project.TREATMENT_QUESTION,
            found="tables of another form than [surfaces.NAME], [products.NAME], [[targets]]",
            needed="one table for each, one key a line",
            hint="rename the file, and fill the form anew",
        )
    return after


_Tables: TypeAlias = dict[tuple[str | int, ...], dict[str, Any]]


def _tables(content: Mapping[str, Any], path: tuple[str | int, ...] = ()) -> _Tables:
    """Return what stands in each table itself; rows of tables are counted from 1."""
    found: _Tables = {path: {}}
    for key, value in content.items():
        if isinstance(value, Mapping):
            found |= _tables(value, (*path, key))
        elif isinstance(value, list) and value and isinstance(value[0], Mapping):
            for number, row in enumerate(value, start=1):
                found |= _tables(row, (*path, key, number))
        else:
            found[path][key] = value
    return found


def _ends(table: tuple[str | int, ...], tables: _Tables) -> bool:
    return not any(t[: len(table)] == table for t in tables if t != table)
