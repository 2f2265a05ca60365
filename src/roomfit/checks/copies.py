"""Whether one recording stands in two places."""

from __future__ import annotations

from collections.abc import Iterator

from roomfit.base.findings import About, Code, Finding
from roomfit.checks.evidence import Law, Recorded, file_name, pair_of

_EQUAL = Law(
    "no two recordings are equal, sample by sample",
    "equality of samples, up to a factor and a delay",
)
LAWS = {Code.RECORDING_COUNTED_ONCE: _EQUAL, Code.RECORDING_OF_TWO_PAIRS: _EQUAL}


def check(evidence: Recorded) -> Iterator[Finding]:
    """Yield a finding for each copy: left out where it stands where the first one does."""
    for copy in evidence.measured.copies:
        one, other = copy.one, copy.other
        files = [one.where, other.where]
        about = About(files=files, pairs=tuple(dict.fromkeys((pair_of(one), pair_of(other)))))
        said = f"{file_name(one)} and {file_name(other)} are one recording, sample by sample"
        numbers = {"files": files, "metres_apart": round(copy.apart_m, 4)}
        if copy.is_left_out:
            text = f"{said}: it was counted once."
            yield Finding(Code.RECORDING_COUNTED_ONCE, about, text, numbers)
        else:
            text = (
                f"{said}, of places that are {copy.apart_m:.2f} m apart or of two states of the "
                "room: one of them is wrong. No material is called identifiable."
            )
            yield Finding(Code.RECORDING_OF_TWO_PAIRS, about, text, numbers)
