"""Rooms of flat walls: errors and intervals of the partly coherent fit, energies beside it.

    python benchmarks/polyhedra.py [--rooms paper slanted l-shaped turned] [--seeds 1 2 3]
        [--position-error 0.01] [--plane-error 0] [--loudspeaker-db 3] [--no-energy]

Responses come from `roomfit.demo.polyhedra`, which follows pressures from cell to
cell, shares no code with the search for image sources, and goes on for longer than any fit; files
are written as a campaign and read back as anybody's. Those of the turned box, which has a door and
a window, come from pyroomacoustics, and what paths strike from balls sent along them. Sources and
receivers stand some --position-error away from where they are given, in each coordinate, and the
planes of the drawing --plane-error along their normals (rooms of one cell). Loudspeakers differ by
--loudspeaker-db from octave to octave, except in the turned box. The null model gives all walls of
a room the area mean of the fitted answer.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from roomfit.files.campaign import Campaign, read_campaign
from roomfit.files.inputs import identify_arguments
from roomfit.identify import identify
from roomfit.result import Result
from simulated_rooms.measured_polyhedron import (
    MeasuredPolyhedron,
    polyhedron_plan,
    write_measured_polyhedron,
)

ROOMS = ("paper", "slanted", "l-shaped", "turned")


@dataclass(frozen=True)
class Outcome:
    """One room by one model: what was found, and what is true in the same bands."""

    answer: Result
    true: np.ndarray  # (n_materials, n_bands)

    @property
    def error(self) -> np.ndarray:
        """Absolute error, shape (n_materials, n_bands)."""
        return np.asarray(np.abs(self.answer.absorption - self.true))

    @property
    def covered(self) -> np.ndarray:
        """Whether the interval holds the truth, shape (n_materials, n_bands)."""
        return (self.answer.lower95 <= self.true) & (self.true <= self.answer.upper95)

    @property
    def null_error(self) -> np.ndarray:
        """Absolute error of the room's own mean on every wall, shape (n_materials, n_bands)."""
        share = self.answer.areas_m2 / self.answer.areas_m2.sum()
        return np.asarray(np.abs(share @ self.answer.absorption - self.true))


def outcome(measured: MeasuredPolyhedron, campaign: Campaign) -> Outcome:
    """Identify a campaign and set the truth beside the answer."""
    answer = identify(**identify_arguments(campaign))
    rows = np.array([measured.materials.index(name) for name in answer.materials])
    bands = np.searchsorted(measured.centres_hz, np.array(answer.bands.centres_hz) / 1.2)
    return Outcome(answer, measured.absorption[np.ix_(rows, bands)])


def show(title: str, done: list[Outcome]) -> None:
    """Print one pooled table."""
    error, held, sure, width, null = (
        np.concatenate([x.ravel() for x in column])
        for column in (
            [o.error for o in done],
            [o.covered for o in done],
            [o.answer.identifiable for o in done],
            [o.answer.upper95 - o.answer.lower95 for o in done],
            [o.null_error for o in done],
        )
    )
    wrong = 1.0 - held[sure].mean() if sure.any() else 0.0
    print(f"{title}: {len(done)} rooms, {error.size} values")
    print(f"  |error| median {np.median(error):.4f}", end="")
    print(f"  90 % {np.quantile(error, 0.9):.4f}  largest {error.max():.3f}")
    print(f"  95 % intervals hold {held.mean():.3f}, median width {np.median(width):.3f}")
    print(f"  identifiable {sure.mean():.2f}, of which outside their interval {wrong:.3f}")
    print(f"  null model |error| median {np.median(null):.4f}  90 % {np.quantile(null, 0.9):.4f}")
    by_band = np.median(np.concatenate([o.error for o in done]), axis=0)
    print("  median by band", " ".join(f"{x:.3f}" for x in by_band))
    print(f"  seconds a room {np.mean([o.answer.seconds for o in done]):.1f}")


def show_one(shape: str, seed: int, o: Outcome) -> None:
    """Print one room's line."""
    phi = " ".join(f"{x:.2f}" for x in o.answer.chi2_reduced)
    print(
        f"{shape} {seed}: median {np.median(o.error):.4f}  90 % {np.quantile(o.error, 0.9):.4f}"
        f"  hold {o.covered.mean():.2f}  {o.answer.seconds:.1f} s  phi {phi} ",
        *dict.fromkeys(o.answer.models),
        *dict.fromkeys(f.code for f in o.answer.findings),
        flush=True,
    )


def main() -> None:
    """Run the rooms and print a table for each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rooms", nargs="+", default=list(ROOMS), choices=ROOMS)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--position-error", type=float, default=0.01)
    parser.add_argument("--plane-error", type=float, default=0.0)
    parser.add_argument("--loudspeaker-db", type=float, default=3.0)
    parser.add_argument("--no-energy", action="store_true", help="leave out energies alone")
    arguments = parser.parse_args()
    for shape in arguments.rooms:
        done: dict[str, list[Outcome]] = {"partly coherent": [], "energy only": []}
        for seed in arguments.seeds:
            with tempfile.TemporaryDirectory() as folder:
                measured = write_measured_polyhedron(
                    polyhedron_plan(shape, np.random.default_rng([seed, 7])),
                    Path(folder),
                    np.random.default_rng([seed, 8]),
                    position_error_m=arguments.position_error,
                    plane_error_m=arguments.plane_error,
                    loudspeaker_db=arguments.loudspeaker_db,
                    other_program=shape == "turned",
                )
                campaign = read_campaign(measured.campaign)
                done["partly coherent"].append(outcome(measured, campaign))
                show_one(shape, seed, done["partly coherent"][-1])
                if not arguments.no_energy:
                    energies = replace(
                        campaign, settings=replace(campaign.settings, model="energy")
                    )
                    done["energy only"].append(outcome(measured, energies))
        for title, outcomes in done.items():
            if outcomes:
                show(f"{shape}, {title}", outcomes)


if __name__ == "__main__":
    main()
