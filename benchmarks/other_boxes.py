"""Boxes of another program, pyroomacoustics: errors, intervals, and what each ingredient is worth.

    python benchmarks/other_boxes.py [--seeds 1 2 3 4 5] [--pairs 8] [--position-error 0.01]
        [--unfitted] [--energy] [--no-delays] [--c-error 0] [--delay-ms 0] [--top-hz 4000]
        [--third-octaves] [--strength 0] [--directivity omni] [--quick]
        [--objects A] [--kept]

What is run and timed is `roomfit identify` on campaign files, without writing its folder.

Boxes of 4.5-9 x 3.6-7 x 2.4-3.8 m, no two sides alike, six materials from 0.01 to 0.97, positions
0.6 m clear of the walls and given with an error, noise 45 to 60 dB below the peak. --delay-ms lets
the walls that absorb more than a half delay what they reflect; the other program cannot, so those
data are made by `roomfit.demo.boxes`'s images. --strength gives every source the
other program's cardioid of that |b|, 30 degrees off the middle of the room; --directivity says
what the campaign tells of it. --quick shows
the first answer beside the full one, and how much wider its intervals are. --objects
puts an absorption of A m2 into every room, in the octaves of 500 and 1000 Hz: the campaigns are
fitted without a word of it, and with its prior of mean and standard deviation A. --kept fits every
second response and predicts the others: errors of room parameters in just noticeable differences,
beside the mean of the fitted responses; the scattering is that of the campaign, none. The null
model gives all walls of a room the area mean of the fitted answer.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from _other_box import OtherBox, write_other_box
from roomfit.base.findings import Code
from roomfit.files.inputs import load_campaign
from roomfit.identify import identify
from roomfit.result import Result
from roomfit.signals.decay import in_jnd

# Findings of nearly every one of these rooms: their decays are short, some bands low.
QUIET = {Code.DECAY_RANGE_TOO_SMALL, Code.BELOW_SCHROEDER_FREQUENCY}


@dataclass(frozen=True)
class Outcome:
    """One room: what was found, and what is true."""

    box: OtherBox
    answer: Result
    seconds: float
    cpu_seconds: float

    @property
    def true(self) -> np.ndarray:
        """True absorption in the fitted bands, shape (n_materials, n_bands)."""
        return self.box.absorption_at(self.answer.bands.centres_hz)


def outcome(box: OtherBox, third_octaves: bool, more: str, *, quick: bool = False) -> Outcome:
    """Identify one campaign with more lines at its end."""
    text = box.campaign.read_text() + more
    if third_octaves:
        text = text.replace('bands = "octave"', 'bands = "third-octave"')
    box.campaign.write_text(text)
    began, cpu = time.perf_counter(), time.process_time()
    arguments = load_campaign(box.campaign)
    arguments["settings"] = replace(arguments["settings"], quick=quick)
    answer = identify(**arguments)
    return Outcome(box, answer, time.perf_counter() - began, time.process_time() - cpu)


def show(done: list[Outcome]) -> None:
    """Print the pooled table."""
    true, found, low, high, sure = (
        np.concatenate([x.ravel() for x in column])
        for column in (
            [o.true for o in done],
            [o.answer.absorption for o in done],
            [o.answer.lower95 for o in done],
            [o.answer.upper95 for o in done],
            [o.answer.identifiable for o in done],
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
    null = np.concatenate([np.abs(one_for_all(o) - o.true).ravel() for o in done])
    print(f"null model |error| median {np.median(null):.4f}  90 % {np.quantile(null, 0.9):.4f}")
    by_band = np.concatenate([np.abs(o.answer.absorption - o.true) for o in done])
    print("median by band", " ".join(f"{x:.3f}" for x in np.median(by_band, axis=0)))


def _show_means(done: list[Outcome]) -> None:
    errors, held, c_errors = [], [], []
    for o in done:
        share = o.answer.areas_m2 / o.answer.areas_m2.sum()
        true = share @ o.true
        mean, low, high = o.answer.mean_absorption
        errors += list(np.abs(mean - true))
        held += list((low <= true) & (true <= high))
        if o.answer.geometry is not None:
            c = o.answer.geometry.speed_of_sound_m_s
            c_errors.append(abs(c / o.box.speed_of_sound_m_s - 1.0))
    print(
        f"area mean |error| median {np.median(errors):.4f}  90 % {np.quantile(errors, 0.9):.4f}"
        f"  intervals hold {np.mean(held):.2f}"
    )
    _show_directivity(done)
    if c_errors:
        print(f"speed of sound, largest relative error {max(c_errors):.5f}")
    print(
        f"seconds a room {np.mean([o.seconds for o in done]):.1f}, of the processor "
        f"{np.mean([o.cpu_seconds for o in done]):.1f}"
    )


def _show_directivity(done: list[Outcome]) -> None:
    """Print how far fitted b are off, component by component, and how often intervals hold."""
    pairs = [(o.box.b[d.source], d) for o in done for d in o.answer.directivities]
    if not pairs:
        return
    errors = np.abs(np.concatenate([(d.b - true).ravel() for true, d in pairs]))
    sd = np.concatenate([d.sd.ravel() for _, d in pairs])
    print(
        f"b: |error| of a component median {np.median(errors):.3f}, 90 % "
        f"{np.quantile(errors, 0.9):.3f}, largest {errors.max():.2f}, "
        f"intervals hold {np.mean(errors <= 1.96 * sd):.3f}"
    )


def keep_every_second(campaign: Path) -> None:
    """Keep every second measurement of a campaign for validation."""
    head, *measurements = campaign.read_text().split("[[measurements]]\n")
    for i in range(1, len(measurements), 2):
        measurements[i] = 'use = "validate"\n' + measurements[i]
    campaign.write_text("[[measurements]]\n".join([head, *measurements]))


def show_kept(done: list[Outcome]) -> None:
    """Print errors of responses that were not fitted, in just noticeable differences, by band."""
    print(
        f"kept, mean |JND|{'':<12}" + " ".join(f"{f:6g}" for f in done[0].answer.bands.centres_hz)
    )
    pairs = [p for o in done for p in o.answer.pairs if p.use == "validate"]
    for name in pairs[0].parameters:
        own = [p.parameters[name] for p in pairs]
        off = np.array([c.jnd for c in own])
        null = np.array([in_jnd(name, c.measured, c.null) for c in own])
        known = np.isfinite(off) & np.isfinite(null)
        for label, error in ((name, off), ("  mean of the others", null)):
            means = np.where(known, np.abs(error), 0.0).sum(axis=0) / np.maximum(
                known.sum(axis=0), 1
            )
            cells = " ".join(f"{m:6.2f}" for m in means)
            print(f"{label:<28}{cells}  all {np.abs(error[known]).mean():.2f}")
    added = [o.answer.by_pressures for o in done if o.answer.by_pressures is not None]
    print(f"by pressures: {sum(int(a.sum()) for a in added)} of {sum(a.size for a in added)} bands")


def one_for_all(o: Outcome) -> np.ndarray:
    """Return the room's own mean for every wall, shape (n_materials, n_bands)."""
    share = o.answer.areas_m2 / o.answer.areas_m2.sum()
    return np.tile(share @ o.answer.absorption, (share.size, 1))


def main() -> None:
    """Run the rooms and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3, 4, 5])
    parser.add_argument("--pairs", type=int, default=8, choices=(1, 2, 4, 8, 16))
    parser.add_argument("--position-error", type=float, default=0.01)
    parser.add_argument("--c-error", type=float, default=0.0)
    parser.add_argument("--delay-ms", type=float, default=0.0)
    parser.add_argument("--top-hz", type=float, default=4000.0)
    parser.add_argument("--unfitted", action="store_true", help="positions and c as specified")
    parser.add_argument("--strength", type=float, default=0.0, help="|b| of every source")
    parser.add_argument(
        "--directivity", choices=("omni", "fit"), default="omni", help="as specified"
    )
    parser.add_argument("--energy", action="store_true", help="energies alone")
    parser.add_argument("--no-delays", action="store_true", help="walls that do not delay")
    parser.add_argument("--third-octaves", action="store_true")
    parser.add_argument("--quick", action="store_true", help="first answers beside")
    parser.add_argument("--objects", type=float, default=0.0, help="m2 in every room")
    parser.add_argument("--kept", action="store_true", help="every second response is predicted")
    arguments = parser.parse_args()
    more = 'positions = "fixed"\n' if arguments.unfitted else ""
    more += "wall_delays = false\n" if arguments.no_delays else ""
    more += 'model = "energy"\n' if arguments.energy else ""
    between_hz = (500.0, 1000.0) if arguments.objects else (125.0, arguments.top_hz)
    done, first, furnished = [], [], []
    for seed in arguments.seeds:
        with tempfile.TemporaryDirectory() as folder:
            box = write_other_box(
                seed,
                Path(folder),
                n_pairs=arguments.pairs,
                position_error_m=arguments.position_error,
                c_error=arguments.c_error,
                delay_s=1e-3 * arguments.delay_ms,
                from_hz=between_hz[0],
                top_hz=between_hz[1],
                objects_m2=arguments.objects,
                strength=arguments.strength,
                specified=arguments.directivity,
            )
            if arguments.kept:
                keep_every_second(box.campaign)
            done.append(outcome(box, arguments.third_octaves, more))
            if arguments.quick:
                first.append(outcome(box, False, "", quick=True))
            if arguments.objects:
                prior = f"prior = {{mean = {arguments.objects}, sd = {arguments.objects}}}"
                furnished.append(outcome(box, False, f"[objects.things]\n{prior}\n"))
                _show_objects(furnished[-1], arguments.objects)
        answer = done[-1].answer
        phi = " ".join(f"{p:.2f}" for p in answer.chi2_reduced)
        print(f"seed {seed}: {done[-1].seconds:.1f} s, phi {phi}", end="  ")
        codes = {f.code for f in answer.findings if f.severity != "info"} - QUIET
        print(" ".join(answer.models), *sorted(codes))
        if arguments.delay_ms and answer.geometry is not None:
            _show_delays(done[-1])
    show(done)
    if arguments.kept:
        show_kept(done)
    for name, others in (
        ("first answers", first),
        ("with objects", furnished),
    ):
        if others:
            print(f"\n{name}")
            show(others)
    if first:
        width, full = (np.array([_widths(o.answer) for o in each]) for each in (first, done))
        print(
            f"mean width {width.mean():.3f}, {width.mean() / full.mean():.2f} of the full answers'"
        )


def _show_objects(o: Outcome, true_m2: float) -> None:
    """Print the area of what stands in the room in every band."""
    found = o.answer.objects
    assert found is not None
    bands = zip(found.area_m2[0], found.lower95_m2[0], found.upper95_m2[0], strict=True)
    text = ", ".join(f"{a:.2f} ({low:.2f} to {high:.2f})" for a, low, high in bands)
    held = (found.lower95_m2[0] <= true_m2) & (true_m2 <= found.upper95_m2[0])
    print(f"   objects {text} m2, true {true_m2:g}, held {held.sum()} of {held.size}")


def _widths(answer: Result) -> np.ndarray:
    """Return the widths of all intervals, shape (n_materials, n_bands)."""
    return answer.upper95 - answer.lower95


def _show_delays(o: Outcome) -> None:
    g = o.answer.geometry
    assert g is not None
    found = [x for label, x in zip(g.labels, g.change, strict=True) if label.startswith("delay")]
    worst = np.max(np.abs(np.array(found) - o.box.delays_s))
    print(f"   delays found within {1e3 * worst:.4f} ms")


if __name__ == "__main__":
    main()
