"""A process that shares a cache with others: ``python shared_cache.py FOLDER SEED``."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from roomfit.base.cache import Cache, cached

LIMIT_BYTES = 45_000


@dataclass(frozen=True, eq=False)
class Sheet:
    """A record of 8 kB."""

    numbers: np.ndarray


def faults(folder: Path, seed: int) -> int:
    """Ask 200 times for one of 20 sheets, with room for 5; return how often one was wrong."""
    wrong = 0
    for key in np.random.default_rng(seed).integers(0, 20, 200).tolist():
        sheet = Sheet(np.full(1000, key))
        found = cached(Cache(folder, LIMIT_BYTES), "sheet", (key,), lambda s=sheet: s, [Sheet])
        wrong += bool(found.findings) or not (found.value.numbers == key).all()
    return wrong


if __name__ == "__main__":
    sys.exit(faults(Path(sys.argv[1]), int(sys.argv[2])))
