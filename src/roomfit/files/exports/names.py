"""Names that other programs can take."""

from __future__ import annotations

import re
import unicodedata


def short_names(names: tuple[str, ...], longest: int) -> dict[str, str]:
    """Return a name of ASCII letters, digits and underscores for each, beginning with a letter.

    No two are alike, not even in another case: some programs do not tell them apart.

    Examples
    --------
    >>> short_names(("Wand grün", "wall", "Wall"), 15)
    {'Wand grün': 'Wand_grun', 'wall': 'wall', 'Wall': 'Wall_2'}
    """
    given: dict[str, str] = {}
    for name in names:
        plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode()
        word = re.sub(r"[^A-Za-z0-9]+", "_", plain).strip("_") or "material"
        word = word if word[0].isalpha() else f"m_{word}"
        candidate, number = word[:longest], 1
        while candidate.lower() in (g.lower() for g in given.values()):
            number += 1
            candidate = f"{word[: longest - len(str(number)) - 1]}_{number}"
        given[name] = candidate
    return given
