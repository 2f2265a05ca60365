"""Coverage of 95 % intervals, over rooms that other models simulated.

    python benchmarks/calibration.py [--boxes N] [--polyhedra N] [--first SEED]

Boxes of another program, pyroomacoustics (`other_boxes.py` says how), and convex rooms of our own
simulator of pressures (`polyhedra.py`), with positions specified 1 cm wrong and noise. Every room
is written as a campaign and identified as anybody's. Each share has its own 95 % interval, in which
values of one room count as less than independent ones. Baselines: the prior's mean, and one
absorption for all walls, from the decay. A second table groups intervals by how they were
made and by what was found: the spread of errors over what the intervals say is 1 where these are
right, less where they are too wide.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.special import betaincinv

from _other_box import write_other_box
from roomfit.base.errors import InsufficientDataError
from roomfit.base.logit import Z95, logit
from roomfit.files.inputs import load_campaign
from roomfit.identify import identify
from roomfit.materials.priors import DEFAULT_MEAN
from roomfit.result import Result
from simulated_rooms.measured_polyhedron import Shape, polyhedron_plan, write_measured_polyhedron

MOST_MATERIALS = 7
SHAPES: tuple[Shape, ...] = ("slanted", "paper")


@dataclass(frozen=True)
class Room:
    """One answer and the true absorption, (n_materials, n_bands)."""

    answer: Result
    true: np.ndarray


def box(seed: int) -> Room:
    """Identify a box of another program."""
    with tempfile.TemporaryDirectory() as folder:
        synthetic = write_other_box(seed, Path(folder))
        answer = identify(**load_campaign(synthetic.campaign))
    return Room(answer, synthetic.absorption_at(answer.bands.centres_hz))


def polyhedron(seed: int) -> Room:
    """Identify a room without right angles, or the paper's."""
    rng = np.random.default_rng([seed, 17])
    plan = polyhedron_plan(SHAPES[seed % len(SHAPES)], rng)
    with tempfile.TemporaryDirectory() as folder:
        synthetic = write_measured_polyhedron(plan, Path(folder), rng)
        answer = identify(**load_campaign(synthetic.campaign))
    rows = [synthetic.materials.index(name) for name in answer.materials]
    columns = [int(np.argmin(np.abs(synthetic.centres_hz - f))) for f in answer.bands.centres_hz]
    return Room(answer, synthetic.absorption[np.ix_(rows, columns)])


@dataclass(frozen=True)
class Pooled:
    """Answers to rooms whose absorption is known, each (n_rooms, MOST_MATERIALS, n_bands)."""

    true: np.ndarray
    absorption: np.ndarray
    lower95: np.ndarray
    upper95: np.ndarray
    identifiable: np.ndarray
    has_interval: np.ndarray  # not where a room has no such material, or nothing was fitted


@dataclass(frozen=True)
class Proportion:
    """A proportion with its own 95 % interval, 0 to 1 where there is nothing to count."""

    count: int
    of: int
    low: float
    high: float

    def __str__(self) -> str:
        if not self.of:
            return "-"
        return f"{100 * self.count / self.of:.0f} ({100 * self.low:.0f} to {100 * self.high:.0f}) %"


def grouped_proportion(hit: np.ndarray, counted: np.ndarray) -> Proportion:
    """Return a proportion of values that come in groups, (n_groups, ...), with its 95 % interval.

    Values of one room are correlated, so that they count less than as many independent ones. The
    interval is that of C. J. Clopper, E. S. Pearson, Biometrika 26, 404-413 (1934), for the number
    over the design effect, the variance of a group's sum over what independent values would have
    (J. N. K. Rao, A. J. Scott, Biometrics 48, 577-585, 1992), never below one.
    """
    groups = len(counted)
    sizes = counted.reshape(groups, -1).sum(axis=1)
    hits = (hit & counted).reshape(groups, -1).sum(axis=1)
    n, k = int(sizes.sum()), int(hits.sum())
    if n == 0:
        return Proportion(0, 0, 0.0, 1.0)
    p = k / n
    effect = 1.0
    if groups > 1 and 0 < k < n:
        spread = groups / (groups - 1) * float(np.sum((hits - p * sizes) ** 2)) / n**2
        effect = max(spread / (p * (1.0 - p) / n), 1.0)
    effective, count = n / effect, k / effect
    low = float(betaincinv(count, effective - count + 1.0, 0.025)) if k > 0 else 0.0
    high = float(betaincinv(count + 1.0, effective - count, 0.975)) if k < n else 1.0
    return Proportion(k, n, low, high)


def scaled_errors(found: Pooled, counted: np.ndarray) -> np.ndarray:
    """Return errors of those counted in standard deviations of logit absorption, (n_counted,).

    Each by the side of the interval on which the true value lies, so that one within +-1.96 lies
    in its 95 % interval; standard normal where intervals are right.
    """
    middle, true = logit(found.absorption), logit(found.true)
    up, down = logit(found.upper95) - middle, middle - logit(found.lower95)
    z = Z95 * (true - middle) / np.maximum(np.where(true > middle, up, down), 1e-12)
    return np.asarray(z[counted])


def pooled(rooms: list[Room]) -> Pooled:
    """Return all rooms in one record; materials that a room does not have are not counted."""
    n_bands = len(rooms[0].answer.bands)

    def stacked(arrays: list[np.ndarray]) -> np.ndarray:
        out = np.zeros((len(rooms), MOST_MATERIALS, n_bands), dtype=arrays[0].dtype)
        for i, array in enumerate(arrays):
            out[i, : len(array)] = array
        return out

    fitted = [np.array([m != "prior" for m in r.answer.models]) for r in rooms]
    return Pooled(
        stacked([r.true for r in rooms]),
        stacked([r.answer.absorption for r in rooms]),
        stacked([r.answer.lower95 for r in rooms]),
        stacked([r.answer.upper95 for r in rooms]),
        stacked([r.answer.identifiable for r in rooms]),
        stacked([np.tile(f, (len(r.true), 1)) for f, r in zip(fitted, rooms, strict=True)]),
    )


def show(rooms: list[Room]) -> None:
    """Print the pooled table, and intervals by group."""
    found = pooled(rooms)
    bands = rooms[0].answer.bands.centres_hz
    uniform = np.array([r.answer.mean_absorption[0] for r in rooms])[:, None, :]
    print(f"{len(rooms)} rooms (uniform: the area mean of each answer)")
    print(
        f"{'band':8}{'95 % intervals hold':>22}{'identifiable':>14}{'of these outside':>20}"
        f"{'width':>8}{'|error|':>9}{'prior':>8}{'uniform':>9}"
    )
    covered = (found.lower95 <= found.true) & (found.true <= found.upper95)
    for name, chosen in [(f"{f:g} Hz", bands == f) for f in bands] + [("all", bands > 0.0)]:
        counted = found.has_interval & chosen
        sure = counted & found.identifiable
        shown = (
            found.upper95 - found.lower95,
            np.abs(found.absorption - found.true),
            np.abs(DEFAULT_MEAN - found.true),
            np.abs(uniform - found.true),
        )
        width, error, prior, mean = (f"{np.median(values[counted]):.3f}" for values in shown)
        print(
            f"{name:8}{grouped_proportion(covered, counted)!s:>22}"
            f"{100 * sure.sum() / max(counted.sum(), 1):12.0f} %"
            f"{grouped_proportion(~covered, sure)!s:>20}{width:>8}{error:>9}{prior:>8}{mean:>9}"
        )
    _show_parts(found, rooms)


def _show_parts(found: Pooled, rooms: list[Room]) -> None:
    """Print how far off values are in units of their intervals, for parts of them."""
    kinds = np.full(found.has_interval.shape, "none", dtype="U9")
    for i, room in enumerate(rooms):
        for j, own in enumerate(room.answer.interval_kinds):
            kinds[i, : len(own), j] = own
    phi = np.array([r.answer.chi2_reduced for r in rooms])[:, None, :]
    bands = rooms[0].answer.bands.centres_hz
    parts = {kind: kinds == kind for kind in ("gaussian", "profile", "none")}
    parts |= {
        "phi below 1": np.broadcast_to(phi < 1.0, kinds.shape),
        "phi 1 to 1.3": np.broadcast_to((phi >= 1.0) & (phi < 1.3), kinds.shape),
        "phi above 1.3": np.broadcast_to(phi >= 1.3, kinds.shape),
        "true below .05": found.true < 0.05,
        "true .05 to .5": (found.true >= 0.05) & (found.true < 0.5),
        "true above .5": found.true >= 0.5,
    }
    parts |= {f"{f:g} Hz": np.broadcast_to(bands == f, kinds.shape) for f in bands}
    print(f"{'':16}values   hold  spread of errors  median width  median |error|")
    for name, part in parts.items():
        counted = found.has_interval & part
        if not counted.any():
            continue
        covered = (found.lower95 <= found.true) & (found.true <= found.upper95)
        share = grouped_proportion(covered, counted)
        z = scaled_errors(found, counted)
        width = np.median((found.upper95 - found.lower95)[counted])
        error = np.median(np.abs(found.absorption - found.true)[counted])
        spread = float(np.sqrt(np.mean(z**2)))
        print(
            f"{name:16}{share.of:6} {100 * share.count / share.of:5.1f} %  {spread:12.2f}"
            f"  {width:15.3f}  {error:12.4f}"
        )


def main() -> None:
    """Run room after room; the table so far after every fifth, and at the end."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--boxes", type=int, default=16)
    parser.add_argument("--polyhedra", type=int, default=4)
    parser.add_argument("--first", type=int, default=101)
    asked = parser.parse_args()
    tasks = [(box, asked.first + i) for i in range(asked.boxes)]
    tasks += [(polyhedron, asked.first + i) for i in range(asked.polyhedra)]
    done: list[Room] = []
    for make, seed in tasks:
        try:
            room = make(seed)
        except InsufficientDataError as refusal:
            print(f"{make.__name__} {seed} refused: {refusal.what}", flush=True)
            continue
        done.append(room)
        a = room.answer
        covered = (a.lower95 <= room.true) & (room.true <= a.upper95)
        codes = sorted({f.code for f in a.findings if f.severity != "info"})
        print(
            f"{make.__name__} {seed}: |error| {np.median(np.abs(a.absorption - room.true)):.4f}, "
            f"{covered.mean():.2f} hold, {a.identifiable.mean():.2f} identifiable, "
            f"{np.count_nonzero(a.identifiable & ~covered)} wrong, phi",
            *(f"{p:.1f}" for p in a.chi2_reduced),
            *codes,
            flush=True,
        )
        if len(done) % 5 == 0:
            show(done)
    if done:
        show(done)


if __name__ == "__main__":
    main()
