"""The effect of a wrong description of a room on the answer: wider intervals, findings, or none.

    python benchmarks/sensitivity.py [--first SEED] [--rooms N] [--faults NAME ...]

Boxes of `roomfit.demo.boxes` (pressures of image sources, noise, eight pairs, six
octaves, positions 1 cm off), one fault at a time in what the campaign specifies. Where a wall of
two materials is specified as one, the true absorption is its mean over the area. "wrong" are values
called identifiable whose 95 % interval does not cover the true value; "far" those of them that miss
it by more than half of the interval's width, which no chance explains. "base" is the error of a
baseline, which gives all walls of a room the fitted area mean.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from _misspecified import FAULTS, Fault, true_absorption_of, write_misspecified
from roomfit.base.findings import Code
from roomfit.files.inputs import load_campaign
from roomfit.identify import identify
from roomfit.result import Result

# Findings that short decays and low bands have in any of these rooms.
QUIET = {Code.DECAY_RANGE_TOO_SMALL, Code.BELOW_SCHROEDER_FREQUENCY}
HEAD = "fault                    |error|  90 %  cover  width ident.  wrong   far   base  findings"


@dataclass(frozen=True)
class Outcome:
    """One campaign: its answer and the true absorption."""

    answer: Result
    true: np.ndarray

    @property
    def codes(self) -> set[Code]:
        """Findings that raise a doubt of this room in particular."""
        return {f.code for f in self.answer.findings if f.severity != "info"} - QUIET


def outcome(fault: Fault, seed: int) -> Outcome:
    """Simulate, describe wrongly, and identify."""
    with tempfile.TemporaryDirectory() as folder:
        misspecified = write_misspecified(fault, seed, Path(folder))
        answer = identify(**load_campaign(misspecified.campaign))
    return Outcome(answer, true_absorption_of(misspecified, answer))


def line(name: str, done: list[Outcome]) -> str:
    """Return one row of the table, pooled over rooms."""
    true, value, low, high, identifiable, baseline = (
        np.concatenate([np.asarray(x, dtype=float).ravel() for x in column])
        for column in (
            [o.true for o in done],
            [o.answer.absorption for o in done],
            [o.answer.lower95 for o in done],
            [o.answer.upper95 for o in done],
            [o.answer.identifiable for o in done],
            [np.tile(o.answer.mean_absorption[0], (len(o.true), 1)) for o in done],
        )
    )
    error, covered = np.abs(value - true), (low <= true) & (true <= high)
    is_identifiable = identifiable > 0.0
    miss = np.maximum(low - true, true - high)
    wrong = is_identifiable & ~covered
    far = wrong & (miss > 0.5 * (high - low))
    counts = Counter(code for o in done for code in o.codes)
    codes = " ".join(f"{code}:{n}" for code, n in sorted(counts.items()))
    return (
        f"{name:<24} {np.median(error):6.3f} {np.quantile(error, 0.9):6.3f} {covered.mean():6.2f}"
        f" {np.median(high - low):6.3f} {is_identifiable.mean():6.2f} {wrong.sum():6d}"
        f" {far.sum():5d} {np.median(np.abs(baseline - true)):6.3f}  {codes}"
    )


def main() -> None:
    """Run room by room and print the pooled table last."""
    names = [fault.name for fault in FAULTS]
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=920)
    parser.add_argument("--rooms", type=int, default=3)
    parser.add_argument("--faults", nargs="+", choices=names, default=names, metavar="NAME")
    asked = parser.parse_args()
    done: dict[str, list[Outcome]] = {name: [] for name in asked.faults}
    print(HEAD)
    for seed in range(asked.first, asked.first + asked.rooms):
        for fault in FAULTS:
            if fault.name in done:
                done[fault.name].append(outcome(fault, seed))
                print(line(f"{seed} {fault.name}", done[fault.name][-1:]), flush=True)
    print(HEAD)
    for name, all_of in done.items():
        print(line(name, all_of))


if __name__ == "__main__":
    main()
