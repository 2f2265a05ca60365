"""What to hang where, as its form has it: products and targets in treatment.toml, and the answer.

The form is the file: it changes keys, and what it does not show stays as it is written.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.items import AoT

from roomfit.app import project
from roomfit.cache import write_text_atomically
from roomfit.core import material_areas_m2
from roomfit.errors import InputError
from roomfit.io.campaign import read_toml
from roomfit.io.door import read_text
from roomfit.io.encoding import written_content
from roomfit.io.inputs import campaign_room
from roomfit.io.reverberation import read_decay_times
from roomfit.treatment.campaign import checked_treatment
from roomfit.typing import Progress

_FIRST = "# What may be hung where, and what is to be reached: roomfit treat, docs/treat.md\n"


def treatment_view(
    _: Progress, folder: str, bands_hz: Sequence[float] = (), fault: str = ""
) -> dict[str, Any]:
    """Return surfaces with their areas, what is asked, and the sentence of the last answer.

    Parameters
    ----------
    bands_hz : sequence of float
        In which targets may be; none: those of the decay times, of which T30 alone is predicted.
    fault : str
        What is wrong with the file, where that is known already.
    """
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
    """Write what is asked into treatment.toml, whole or not at all.

    Raises
    ------
    InputError
        Nothing may be covered, hung or reached; a value is out of range; or the file is written in
        a way that does not allow it.
    """
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
    """Return the text of a treatment file with another content; what is equal stays as written.

    Raises
    ------
    InputError
        The text is no TOML, or written in a way that does not allow it.

    Examples
    --------
    >>> written_question("[surfaces.a] # mine", {"surfaces": {"a": {}}, "probability": 0.8})
    'probability = 0.8\\n\\n[surfaces.a] # mine'
    """
    try:
        document = tomlkit.parse(text)
        _merge(document, question)
        after = tomlkit.dumps(document)
        as_wanted = tomllib.loads(after) == question
    except (ValueError, RecursionError):
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


def _merge(table: Any, content: Mapping[str, Any]) -> None:
    """Give a table of a document another content, key by key."""
    for key in [key for key in table if key not in content]:
        del table[key]
    for key, value in content.items():
        if isinstance(value, Mapping):
            if key not in table:
                above = bool(value) and all(isinstance(v, Mapping) for v in value.values())
                table[key] = tomlkit.table(is_super_table=above)
            _merge(table[key], value)
        elif isinstance(value, list) and value and isinstance(value[0], Mapping):
            if not isinstance(table.get(key), AoT):
                table[key] = tomlkit.aot()
            rows = table[key]
            while len(rows) > len(value):
                del rows[len(rows) - 1]
            for i, own in enumerate(value):
                if i == len(rows):
                    rows.append(tomlkit.table())
                _merge(rows[i], own)
        elif key not in table or table[key] != value:
            table[key] = value
