"""Boxes of another program, pyroomacoustics: errors, intervals, and what each ingredient is worth.

    python benchmarks/other_boxes.py [--seeds 1 2 3 4 5] [--pairs 8] [--position-error 0.01]
        [--unfitted] [--energy] [--no-delays] [--c-error 0] [--delay-ms 0] [--top-hz 4000]

Boxes of 4.5-9 x 3.6-7 x 2.4-3.8 m, no two sides alike, six materials from 0.01 to 0.97, positions
0.6 m clear of the walls and told with an error, noise 45 to 60 dB below the peak. --delay-ms lets
the walls that absorb more than a half delay what they reflect; the other program cannot, so those
data are made by `roomfit.testproblems.pressure_box`'s images. The null model gives all walls of a
room the area mean of the fitted answer.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from _other_box import OtherBox, write_other_box
from roomfit.app.coherent.fit import CoherentFit, CoherentOptions, fit_coherent
from roomfit.app.measuring import measure
from roomfit.app.problems import bin_paths
from roomfit.bands import Bands
from roomfit.files.campaign.campaign import read_campaign
from roomfit.files.campaign.materials import material_knowledge
from roomfit.files.rooms.read import read_room
from roomfit.materials.scattering import uniform_scattering
from roomfit.scene.room import material_areas_m2
from roomfit.scene.scene import Scene
from roomfit.tracing.images import trace_images

ALL_ORDERS = 1000
START = 0.2


@dataclass(frozen=True)
class Outcome:
    """One room: what was found, and what is true."""

    box: OtherBox
    fit: CoherentFit
    areas_m2: np.ndarray
    bands: Bands
    seconds: float

    def table(self, name: str) -> np.ndarray:
        """Return one column of every band's answer, shape (n_materials, n_bands)."""
        return np.stack([getattr(a, name) for a in self.fit.answers], axis=1)

    @property
    def true(self) -> np.ndarray:
        """True absorption in the fitted bands, shape (n_materials, n_bands)."""
        return self.box.absorption[:, : len(self.bands)]


def outcome(box: OtherBox, options: CoherentOptions) -> Outcome:
    """Identify one campaign."""
    began = time.perf_counter()
    campaign = read_campaign(box.campaign)
    room, _ = read_room(campaign.room)
    knowledge = material_knowledge(campaign, room.materials)
    sources, receivers = campaign.sources, campaign.receivers
    every = np.array([(s, r) for s in range(len(sources)) for r in range(len(receivers))])
    scene = Scene(room, sources, receivers, every, campaign.air)
    measured, _ = measure(campaign, scene)
    still = uniform_scattering(room.materials, 0.0)
    paths = trace_images(scene, ALL_ORDERS, options.end_s, still)
    binned = bin_paths(scene, campaign.bands, paths, options.end_s)
    start = np.full(len(campaign.bands), START)
    fit = fit_coherent(
        scene, campaign.bands, knowledge, measured, paths, binned, start, options=options
    )
    seconds = time.perf_counter() - began
    return Outcome(box, fit, material_areas_m2(room), campaign.bands, seconds)


def show(done: list[Outcome]) -> None:
    """Print the pooled table."""
    true, found, low, high, sure = (
        np.concatenate([x.ravel() for x in column])
        for column in (
            [o.true for o in done],
            [o.table("absorption") for o in done],
            [o.table("lower95") for o in done],
            [o.table("upper95") for o in done],
            [o.table("identifiable") for o in done],
        )
    )
    error = np.abs(found - true)
    inside = (low <= true) & (true <= high)
    print(f"rooms {len(done)}, values {error.size}")
    print(f"|error| median {np.median(error):.4f}", end="")
    print(f"  90 % {np.quantile(error, 0.9):.4f}  largest {error.max():.3f}")
    print(f"95 % intervals hold {inside.mean():.3f}, median width {np.median(high - low):.3f}")
    wrong = 1.0 - inside[sure].mean() if sure.any() else 0.0
    print(f"identifiable {sure.mean():.2f}, of which outside their interval {wrong:.3f}")
    _show_means(done)
    null = np.concatenate([np.abs(_null(o) - o.true).ravel() for o in done])
    print(f"null model |error| median {np.median(null):.4f}  90 % {np.quantile(null, 0.9):.4f}")
    by_band = np.concatenate([np.abs(o.table("absorption") - o.true) for o in done])
    print("median by band", " ".join(f"{x:.3f}" for x in np.median(by_band, axis=0)))


def _show_means(done: list[Outcome]) -> None:
    errors, held, c_errors = [], [], []
    for o in done:
        share = o.areas_m2 / o.areas_m2.sum()
        true = share @ o.true
        means = np.array([a.mean for a in o.fit.answers])
        errors += list(np.abs(means[:, 0] - true))
        held += list((means[:, 1] <= true) & (true <= means[:, 2]))
        if o.fit.geometry is not None:
            c = o.fit.geometry.speed_of_sound_m_s
            c_errors.append(abs(c / o.box.speed_of_sound_m_s - 1.0))
    print(
        f"area mean |error| median {np.median(errors):.4f}  90 % {np.quantile(errors, 0.9):.4f}"
        f"  intervals hold {np.mean(held):.2f}"
    )
    if c_errors:
        print(f"speed of sound, largest relative error {max(c_errors):.5f}")
    print(f"seconds a room {np.mean([o.seconds for o in done]):.1f}")


def _null(o: Outcome) -> np.ndarray:
    """Return the room's own mean for every wall, shape (n_materials, n_bands)."""
    share = o.areas_m2 / o.areas_m2.sum()
    return np.tile(share @ o.table("absorption"), (share.size, 1))


def main() -> None:
    """Run the rooms and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3, 4, 5])
    parser.add_argument("--pairs", type=int, default=8, choices=(1, 2, 4, 8, 16))
    parser.add_argument("--position-error", type=float, default=0.01)
    parser.add_argument("--c-error", type=float, default=0.0)
    parser.add_argument("--delay-ms", type=float, default=0.0)
    parser.add_argument("--top-hz", type=float, default=4000.0)
    parser.add_argument("--unfitted", action="store_true", help="positions and c as told")
    parser.add_argument("--energy", action="store_true", help="energies alone")
    parser.add_argument("--no-delays", action="store_true", help="walls that do not delay")
    told = parser.parse_args()
    options = CoherentOptions(
        positions="fixed" if told.unfitted else "fit",
        delays=not told.no_delays,
        model="energy" if told.energy else "auto",
    )
    done = []
    for seed in told.seeds:
        with tempfile.TemporaryDirectory() as folder:
            box = write_other_box(
                seed,
                Path(folder),
                n_pairs=told.pairs,
                position_error_m=told.position_error,
                c_error=told.c_error,
                delay_s=1e-3 * told.delay_ms,
                top_hz=told.top_hz,
            )
            done.append(outcome(box, options))
        answers = done[-1].fit.answers
        phi = " ".join(f"{a.phi:.2f}" for a in answers)
        print(f"seed {seed}: {done[-1].seconds:.1f} s, phi {phi}", end="  ")
        print(" ".join(a.model for a in answers), *(f.code for f in done[-1].fit.findings))
        if told.delay_ms and done[-1].fit.geometry is not None:
            _show_delays(done[-1])
    show(done)


def _show_delays(o: Outcome) -> None:
    g = o.fit.geometry
    assert g is not None
    found = [x for label, x in zip(g.labels, g.change, strict=True) if label.startswith("delay")]
    worst = np.max(np.abs(np.array(found) - o.box.delays_s))
    print(f"   delays found within {1e3 * worst:.4f} ms")


if __name__ == "__main__":
    main()
