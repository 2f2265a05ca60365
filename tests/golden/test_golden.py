"""Answers of small rooms stay what they are, by commands alone: regression, and no proof of any.

A change that moves one is meant: `tests/helpers/golden_cases.py NAME` writes it anew.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator

import pytest

from golden_cases import ANSWERS, CASES


def leaves(found: object, at: str = "") -> Iterator[tuple[str, object]]:
    """Yield every number and word of a file with the keys that lead to it."""
    if isinstance(found, dict):
        for key, value in found.items():
            yield from leaves(value, f"{at}.{key}")
    elif isinstance(found, list):
        for i, value in enumerate(found):
            yield from leaves(value, f"{at}[{i}]")
    else:
        yield at, found


def differ(a: object, b: object) -> bool:
    if isinstance(a, float) and isinstance(b, float):
        # kernels round differently on other processors: a ten-thousandth of what matters
        return not math.isclose(a, b, rel_tol=1e-4, abs_tol=1e-5)
    return a != b


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_answers_of_a_small_room_are_those_that_are_kept(name, tmp_path):
    before = dict(leaves(json.loads((ANSWERS / f"{name}.json").read_text(encoding="utf-8"))))
    now = dict(leaves(CASES[name].run(tmp_path / name)))
    assert before.keys() == now.keys()
    assert {k: (v, now[k]) for k, v in before.items() if differ(v, now[k])} == {}
