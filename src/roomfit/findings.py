"""A doubt that stops nothing: told alike by report, command line and result file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal

Severity = Literal["info", "warning", "serious"]


@dataclass(frozen=True, slots=True, eq=False)
class Finding:
    """Something that a user must know before trusting a number.

    Attributes
    ----------
    code : str
        Short and stable, in kebab case, for programs: ``"time-zero-disagrees"``.
    severity : {"info", "warning", "serious"}
        info: good to know; warning: look at it; serious: do not use the numbers it concerns.
    sentence : str
        One or two sentences for a person, with the place and the numbers.
    evidence : mapping
        The numbers behind the sentence, ready for JSON.
    """

    code: str
    severity: Severity
    sentence: str
    evidence: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "evidence", MappingProxyType(dict(self.evidence)))
