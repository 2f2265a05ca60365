"""Faults: findings so serious that a room cannot be traced, and how they become errors."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from roomfit.errors import InputError
from roomfit.findings import Finding
from roomfit.typing import FloatArray


def fault(
    code: str,
    what: str,
    *,
    where: str | None = None,
    found: str | None = None,
    needed: str | None = None,
    hint: str | None = None,
    **evidence: Any,
) -> Finding:
    """Return a serious finding that keeps the parts of an error message apart.

    `roomfit check` lists all faults of a room; everything else stops at the first, see `refuse`.
    """
    parts = {"where": where, "found": found, "needed": needed, "try": hint}
    told = {key: text for key, text in parts.items() if text}
    place = f" at {where}" if where else ""
    count = f": {found}" if found else ""
    return Finding(code, "serious", f"{what}{place}{count}.", {"what": what, **told, **evidence})


def refuse(findings: Iterable[Finding]) -> None:
    """Raise the first serious finding as an error; return where there is none.

    Raises
    ------
    InputError
        Says what, where, found, needed and try, and how many more faults there are.
    """
    serious = [f for f in findings if f.severity == "serious"]
    if not serious:
        return
    told = serious[0].evidence
    hints = [str(told["try"])] if "try" in told else []
    if len(serious) > 1:
        others = sorted({f.code for f in serious[1:]})
        hints.append(f"there are {len(serious) - 1} more faults ({', '.join(others)})")
    raise InputError(
        str(told.get("what", serious[0].sentence)),
        where=told.get("where"),
        found=told.get("found"),
        needed=told.get("needed"),
        hint="; ".join(hints) or None,
    )


def place(point_m: FloatArray) -> str:
    """Return a point as text, in metres to the millimetre.

    Examples
    --------
    >>> place(np.array([1.0, 2.5, -0.00001]))
    '(1.000, 2.500, 0.000) m'
    """
    x, y, z = np.round(np.asarray(point_m, dtype=np.float64), 3) + 0.0  # no "-0.000"
    return f"({x:.3f}, {y:.3f}, {z:.3f}) m"
