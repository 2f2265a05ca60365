"""Boxes of known walls measured by an array of seven capsules: its beams against its centre alone.

    python benchmarks/arrays.py [--first SEED] [--rooms N] [--bands HZ ...] [--middle]
    python benchmarks/arrays.py --measured DATA [--step DEGREES]

Random boxes of `benchmarks/boxes.py` (image sources that add as pressures, positions 1 cm wrong,
noise 60 dB below the peak), eight pairs, each receiver seven capsules about a centre that are 1 mm
and 2 % wrong. Energies are fitted: of the centre alone, of the seven beams with their levels taken
for known (nominal), and with unknown levels of each beam, early and late.

--middle    sources and receivers at half the height
--measured  three states of R3VIVAL instead: DATA has the folders `r3vival` and `r3vival_array`
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import soundfile

import roomfit
from _beams import (
    Beams,
    BeamTerm,
    beam_levels,
    beam_term,
    beam_windows,
    with_levels,
)
from _microphone_arrays import (
    CAPSULE_ERROR,
    array_beams,
    array_weights,
    beam_patterns,
    capsule_responses,
    cross_patterns,
    level_errors,
)
from known_changes import ABSORBING, SAME, r3vival
from roomfit.base.air import Air, speed_of_sound_m_s
from roomfit.base.bands import Bands
from roomfit.checks.examine import eyring_start
from roomfit.demo.boxes import (
    NOISE_DB,
    PLAN_BANDS,
    POSITION_ERROR_M,
    WALLS,
    add_noise,
    pressure_response,
    true_box,
)
from roomfit.fit.bands import from_random_starts
from roomfit.fit.measurements import Measurements, collect_measurements
from roomfit.fit.paths import TracedPaths, redirected, traced_paths
from roomfit.fit.solve import estimate_energies, shared_error_covariance
from roomfit.fit.systematics import (
    inflated_by_adjacent_bands,
    relative_errors,
    shared_errors,
    with_shared_errors,
)
from roomfit.materials.priors import MaterialPrior, complete_priors, unknown_material
from roomfit.model.directivity import FittedDirectivity
from roomfit.model.energy import EnergyTerm
from roomfit.model.observation import energy_terms, fitted_in_band
from roomfit.model.parameters import Parameters, physical_values
from roomfit.model.patterns import directed_rows, directivity_factors
from roomfit.model.problem import Objective
from roomfit.model.weighing import window_of_rows
from roomfit.room.scene import Point, scene_of, shoebox_room
from roomfit.signals.filters import frequency_response, window_energies
from roomfit.solver.least_squares import BandFit, fit_band, score_band
from roomfit.uncertainty.gaussian import BandEstimate, band_estimate
from simulated_rooms.random_boxes import random_plan

RATE_HZ, DURATION_S = 16_000, 0.4
# Those of R3VIVAL's array, by the delays of its direct sounds; front is -x.
CAPSULES_M = np.array(
    [
        [0.0, 0.0, 0.0],
        [-0.0466, 0.0, 0.0],
        [0.0472, 0.0, 0.0],
        [0.0, -0.033, 0.0354],
        [0.0, 0.033, 0.0354],
        [0.0, -0.033, -0.0354],
        [0.0, 0.033, -0.0354],
    ]
)
CAPSULE_AT_M, CAPSULE_GAIN = 0.001, 0.02
FINER = 16  # steps of times within a sample
LENGTH_PER_S = speed_of_sound_m_s(Air())
DIRECT_S, SPEED_M_S = 9.96e-3, 344.5  # of R3VIVAL
MEASURED_ERROR = 0.05  # what the calibration of its capsules leaves up to 2 kHz
LATE_ERROR, COMMON_LATE_ERROR = 0.1, 0.2
ROUNDS = 3


class ArrayCase(NamedTuple):
    """A room as it was measured by an array, and what is true of it, if that is known."""

    measured: Measurements  # by the centre
    beams: dict[int, np.ndarray]  # by pair: seven signals on the samples of its response
    priors: tuple[MaterialPrior, ...]
    truth: np.ndarray | None  # (n_materials, n_bands)
    capsule_error: float = CAPSULE_ERROR  # left by the calibration


def array_box(seed: int, bands: Bands, *, middle: bool = False) -> ArrayCase:
    """Simulate a box with the array at each of its receivers."""
    rng = np.random.default_rng(seed)
    plan = random_plan(rng)
    if middle:
        half = 0.5 * plan.lengths_m[2]
        plan = replace(
            plan,
            sources_m={n: (x, y, half) for n, (x, y, _) in plan.sources_m.items()},
            receivers_m={n: (x, y, half) for n, (x, y, _) in plan.receivers_m.items()},
        )
    synthetic, true_at = true_box(plan, POSITION_ERROR_M, rng)
    scene = scene_of(
        shoebox_room(plan.lengths_m, dict(zip(WALLS, plan.materials, strict=True))),
        [Point(n, np.array(p), POSITION_ERROR_M) for n, p in plan.sources_m.items()],
        [Point(n, np.array(p), POSITION_ERROR_M) for n, p in plan.receivers_m.items()],
    )
    recorded, signals = [], {}
    levels = {s: rng.normal(0.0, 3.0, len(PLAN_BANDS)) for s in plan.sources_m}
    wrong = {r: CAPSULE_AT_M * rng.standard_normal(CAPSULES_M.shape) for r in plan.receivers_m}
    gains = {r: 1.0 + CAPSULE_GAIN * rng.standard_normal(len(CAPSULES_M)) for r in wrong}
    for pair, (s, r) in enumerate((s, r) for s in plan.sources_m for r in plan.receivers_m):
        channels = []
        for place, gain in zip(true_at[r] + CAPSULES_M + wrong[r], gains[r], strict=True):
            pressure = pressure_response(
                synthetic, true_at[s], place, DURATION_S, float(RATE_HZ), levels[s]
            )
            channels.append(gain * add_noise(pressure, NOISE_DB, rng))
        samples = np.array(channels)
        recorded.append(roomfit.Measurement(s, r, samples[0], RATE_HZ))
        c = synthetic.speed_of_sound_m_s
        signals[pair] = array_beams(samples, float(RATE_HZ), CAPSULES_M, c)
    measured = collect_measurements(scene, recorded, bands, {})
    own = [int(np.argmin(np.abs(PLAN_BANDS.centres_hz - f))) for f in bands.centres_hz]
    zero = np.zeros(len(bands))
    bare = [replace(unknown_material(m, len(bands)), scattering=zero) for m in plan.materials]
    order = [plan.materials.index(m) for m in scene.room.materials]
    priors = complete_priors(scene.room.materials, bare, bands)
    return ArrayCase(measured, signals, priors, plan.absorption[np.ix_(order, own)])


def beams_of_windows(
    case: ArrayCase, band: int, windows: EnergyTerm
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the energies of one band's windows in every beam of each pair, and their noise."""
    bands, out = case.measured.bands, []
    one = Bands(bands.kind, bands.centres_hz[band : band + 1])
    # noise of the capsules is independent
    (weights,) = array_weights(CAPSULES_M, one.exact_centres_hz, 343.0, case.capsule_error)
    louder = np.sum(np.abs(weights) ** 2, axis=1)[:, None]
    pairs = fitted_in_band(case.measured.responses, band)
    for pair, observed in zip(pairs, windows.observations, strict=True):
        responses = [replace(pair.response, pressure=p) for p in case.beams[pair.pair]]
        energy = [window_energies(one, r, observed.edges_s)[0] for r in responses]
        out.append((np.array(energy), louder * observed.noise))
    return out


# Directions in steps of about 2 degrees.
_POLAR, _AZIMUTH = 91, 180


def directions() -> np.ndarray:
    """Return a grid of directions, (n, 3), azimuth fastest."""
    polar = np.repeat(np.linspace(0.0, np.pi, _POLAR), _AZIMUTH)
    azimuth = np.tile(np.arange(_AZIMUTH) * 2.0 * np.pi / _AZIMUTH, _POLAR)
    return np.stack(
        [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], 1
    )


@cache
def cross_of(centre_hz: float, speed_of_sound_m_s: float, capsule_error: float) -> np.ndarray:
    """Return the products of the array's patterns in one octave for all `directions`."""
    one = Bands("octave", np.array([centre_hz]))
    found = cross_patterns(one, directions(), CAPSULES_M, speed_of_sound_m_s, capsule_error)
    return np.asarray(found[0])


def nearest_direction(u: np.ndarray) -> np.ndarray:
    """Return which of `directions` is nearest to each of some, shape (n,)."""
    polar = np.rint(np.arccos(np.clip(u[:, 2], -1.0, 1.0)) / np.pi * (_POLAR - 1)).astype(int)
    azimuth = np.rint(np.arctan2(u[:, 1], u[:, 0]) / (2.0 * np.pi) * _AZIMUTH).astype(int)
    return np.asarray(polar * _AZIMUTH + azimuth % _AZIMUTH)


def omni_estimate(
    case: ArrayCase, traced: TracedPaths, band: int, own: tuple[EnergyTerm, Parameters]
) -> tuple[BandEstimate, BandFit]:
    """Return what the centre alone says of a band."""
    term, parameters = own
    objective = Objective(parameters, (term,))
    fit, _ = from_random_starts(objective, fit_band(objective), np.random.default_rng(1), 3)
    noisy = shared_error_covariance(case.measured, traced)(band, objective, fit)
    return band_estimate(parameters, noisy, "energy"), fit


@dataclass(frozen=True)
class Kind:
    """How the beams' windows are weighed."""

    level_sd: float | None  # None: by the errors of the capsules
    late_sd: float
    common_sd: float


def beam_estimate(
    case: ArrayCase,
    traced: TracedPaths,
    band: int,
    own: tuple[EnergyTerm, Parameters],
    fit: BandFit,
    kind: Kind,
    errors: Sequence[Sequence[np.ndarray]],
) -> BandEstimate:
    """Return what the beams say of a band, from the answer of the centre on."""
    (omni, parameters), scene = own, case.measured.scene
    c = speed_of_sound_m_s(scene.air)
    bands = case.measured.bands
    one = Bands(bands.kind, bands.centres_hz[band : band + 1])
    cross = cross_of(float(bands.centres_hz[band]), c, case.capsule_error)
    came_from = nearest_direction(-traced.paths.arrival.astype(np.float64))
    beams = Beams(cross, tuple(came_from[rows.path] for rows in omni.rows))
    windows = beam_windows(omni, beams, beams_of_windows(case, band, omni))
    sd = level_errors(one, CAPSULES_M, c, case.capsule_error)[0]
    sd = sd if kind.level_sd is None else np.full_like(sd, kind.level_sd)
    levels = beam_levels(sd, kind.late_sd, kind.common_sd)
    with_beams = with_levels(parameters, levels)
    values = physical_values(parameters, fit.vector)[0]
    vector = np.append(fit.vector, np.zeros(len(levels.labels)))
    for _ in range(ROUNDS):
        term = beam_term(omni, beams, windows, values)
        objective = Objective(with_beams, (term,))
        found = score_band(objective, vector)
        vector = found.vector
        values = physical_values(with_beams, vector)[0]
    noisy = with_errors_of_beams(case, traced, band, objective, found, errors)
    return band_estimate(with_beams, noisy, "energy")


def with_errors_of_beams(
    case: ArrayCase,
    traced: TracedPaths,
    band: int,
    objective: Objective,
    fit: BandFit,
    errors: Sequence[Sequence[np.ndarray]],
) -> BandFit:
    """Return the fit of beams with the errors that windows share, as for a single microphone."""
    measured = case.measured
    (term,) = objective.terms
    assert isinstance(term, BeamTerm)
    values = physical_values(objective.parameters, fit.vector)[0]
    relative = relative_errors(
        measured.scene.air,
        measured.bands,
        term.windows,
        traced.paths,
        values["absorption"],
        (traced.scattering, traced.scattering_sd),
    )
    plain = Objective(objective.parameters, (term.windows,))
    files = fitted_in_band(measured.responses, band)
    sources = [int(measured.scene.pairs[m.pair][0]) for m in files for _ in range(term.n_beams)]
    as_energies = replace(fit, expected=term.windows.expected(values))
    shared = shared_errors(plain, as_energies, sources, relative)
    if errors:
        columns = []
        for of_pair in errors:
            changed = [
                directed_rows(rows, of_pair[o // term.n_beams])
                for o, rows in enumerate(term.windows.rows)
            ]
            columns.append(replace(term.windows, rows=tuple(changed)).predict(values)[1])
        shared["directivity"] = np.stack(columns, axis=1)
    if not measured.directivities:  # smooth walls: all paths are images
        lost = lost_coherence(traced, term, values["absorption"])
        shared["lost coherence"] = (as_energies.expected * lost)[:, None]
    shared = {name: term.decorrelated(columns) for name, columns in shared.items()}
    return with_shared_errors(objective, fit, shared)


def lost_coherence(traced: TracedPaths, term: BeamTerm, absorption: np.ndarray) -> np.ndarray:
    """Return the relative change of every window's energy if all images added as pressures.

    As `roomfit.fit.systematics.lost_coherence`, beam by beam: over slots of 40 ms, all pairs
    together, since the order of images on a lattice lowers late energy between hard walls.
    """
    windows, rate_hz = term.windows, 8_000.0
    one = Bands("octave", np.array([windows.centre_hz]))
    left = np.log(np.maximum(1.0 - absorption, 1e-30))
    slots, added, plain = [], [], []
    for o, (rows, observed) in enumerate(zip(windows.rows, windows.observations, strict=True)):
        u = -traced.paths.arrival[rows.path].astype(np.float64)
        sign = np.sign(beam_patterns(np.clip(u, -1.0, 1.0))[:, o % term.n_beams])
        energy = rows.weight_per_m2 * np.exp(rows.hits @ left)
        of_image = energy * (rows.batch < 0)  # rays that stand for one image arrive together
        times_s = traced.paths.length_m[rows.path] / LENGTH_PER_S
        end_s = observed.edges_s[-1] + 0.1
        n = round(end_s * rate_hz)
        grid = np.rint((times_s + 0.05) * rate_hz * FINER).astype(int)
        inside = grid < n * FINER
        impulses = np.bincount(grid[inside], (sign * np.sqrt(of_image))[inside], n * FINER)
        f = np.fft.rfftfreq(n, 1.0 / rate_hz)
        shape = frequency_response(one, f)[0]
        pressure = np.fft.irfft(np.fft.rfft(impulses)[: f.size] * shape, n)
        scale = 0.5 * n / np.sum(shape**2)
        edges = np.rint((observed.edges_s + 0.05) * rate_hz).astype(int)
        summed = np.concatenate([[0.0], np.cumsum(pressure**2)])
        added.append(scale * np.diff(summed[edges]))
        bins = (np.bincount(window_of_rows(rows), e, rows.n_windows) for e in (of_image, energy))
        image, whole = (observed.spreading @ x[: observed.spreading.shape[1]] for x in bins)
        is_known = image > 0.9 * whole
        added[-1] *= is_known
        plain.append(image * is_known)
        middle = np.maximum(0.5 * (observed.edges_s[1:] + observed.edges_s[:-1]), 0.0)
        slots.append((middle / 0.04).astype(int))
    sizes = [x.size for x in slots]
    beam = np.repeat(np.arange(len(sizes)) % term.n_beams, sizes)
    slot = np.concatenate(slots)
    shape = (slot.max() + 1, term.n_beams)
    coherent, of_energies = np.zeros(shape), np.zeros(shape)
    np.add.at(coherent, (slot, beam), np.concatenate(added))
    np.add.at(of_energies, (slot, beam), np.concatenate(plain))
    # where rays take over, what the last slot of images has
    last = int(np.flatnonzero(of_energies.min(axis=1) > 0.0)[-1])
    change = coherent[: last + 1] / np.maximum(of_energies[: last + 1], 1e-30) - 1.0
    return np.asarray(change[np.minimum(slot, last), beam])


def estimates(case: ArrayCase, kinds: dict[str, Kind]) -> dict[str, list[BandEstimate]]:
    """Return the answers by the centre alone and by the beams, all bands."""
    settings, measured = roomfit.Settings(model="energy"), case.measured
    start = eyring_start(measured)
    traced = traced_paths(measured, case.priors, settings, start, None, None)
    out: dict[str, list[BandEstimate]] = {"centre": [], **{name: [] for name in kinds}}
    found: tuple[FittedDirectivity, ...] = ()
    if measured.directivities:
        fits = estimate_energies(
            measured, case.priors, traced, start, settings, lambda own, _: own.estimate, None
        )
        found, out["centre"] = fits.directivities, list(fits.answers)
        traced = redirected(measured, traced, found)
    made = energy_terms(
        measured.scene, measured.bands, case.priors, measured.responses, traced.binned, start
    )
    for band, own in enumerate(made):
        if own is None:
            raise SystemExit("a band without data")
        alone, fit = omni_estimate(case, traced, band, own)
        if not found:
            out["centre"].append(alone)
        errors = directivity_errors(case, traced, found, band, own[0])
        for name, kind in kinds.items():
            answer = beam_estimate(case, traced, band, own, fit, kind, errors)
            out[name].append(answer)
    return {
        name: [a for a in inflated_by_adjacent_bands(own, case.priors) if a is not None]
        for name, own in out.items()
    }


def directivity_errors(
    case: ArrayCase,
    traced: TracedPaths,
    found: Sequence[FittedDirectivity],
    band: int,
    omni: EnergyTerm,
) -> list[list[np.ndarray]]:
    """Return by which share the energy of every row of each pair changes, one sd of b at a time."""
    source, measured = case.measured.scene.pairs[:, 0].tolist(), case.measured
    out = []
    for own in found:
        for j in range(3):
            moved = np.array(own.b)
            moved[band, j] += own.sd[band, j]
            factors = []
            for each in (own, replace(own, b=moved)):
                of_source = each.patterns()
                patterns = [of_source.get(s.name) for s in measured.scene.sources]
                factors.append(directivity_factors(traced.paths, patterns, source, band))
            share = factors[1] / np.maximum(factors[0], 1e-9) - 1.0
            out.append([share[rows.path] for rows in omni.rows])
    return out


KINDS = {
    "nominal": Kind(1e-3, 1e-3, 1e-3),
    "array": Kind(None, LATE_ERROR, COMMON_LATE_ERROR),
}


def array_r3vival(data: Path, state: str, step: int, bands: Bands) -> ArrayCase:
    """Return one state of R3VIVAL, capsules calibrated on the direct sounds of its sources."""
    scene, recorded, directivities = r3vival(data, state, step, ("150", "200"))
    samples = {m.source: channels(data, state, m.source) for m in recorded}
    rate_hz = float(recorded[0].response.sampling_rate_hz)
    centre = scene.receivers[0].position_m
    offsets = np.array([s.position_m for s in scene.sources]) - centre
    far = np.linalg.norm(offsets, axis=1)
    # 1.5 ms before the direct sound to 4.4 ms after it: the floor's reflection comes at 4.7 ms
    first, n = round((DIRECT_S - 0.0015) * rate_hz), round(0.0059 * rate_hz)
    fade = np.minimum(1.0, np.minimum(np.arange(n), np.arange(n)[::-1]) / (0.001 * rate_hz))
    direct = np.array([samples[s.name][:, first : first + n] * fade for s in scene.sources])
    responses, residual = capsule_responses(
        direct, rate_hz, offsets / far[:, None], CAPSULES_M, SPEED_M_S, far
    )
    f = np.linspace(0.0, 0.5 * rate_hz, responses.shape[1])
    # shorter than half a period of what is lower, and not to be trusted up there
    inside = np.clip(np.arange(f.size), *np.searchsorted(f, [250.0, 12_000.0]))
    responses = responses[:, inside]
    for name, own in zip(("level", "residual"), (np.abs(responses), residual[1:]), strict=True):
        near = [own[:, (f > b / 1.4) & (f < b * 1.4)] for b in bands.centres_hz]
        print(name, *(f"{np.sqrt(np.mean(x**2)):.3f}" for x in near))
    measured = collect_measurements(scene, recorded, bands, directivities)
    signals = {}
    for pair, (source, _) in enumerate(measured.scene.pairs.tolist()):
        own = samples[measured.scene.sources[source].name]
        beams = array_beams(own, rate_hz, CAPSULES_M, SPEED_M_S, MEASURED_ERROR, responses)
        signals[pair] = beams
    priors = complete_priors(scene.room.materials, (), bands)
    return ArrayCase(measured, signals, priors, None, MEASURED_ERROR)


def channels(data: Path, state: str, source: str) -> np.ndarray:
    """Return the samples of all capsules in the order of `CAPSULES_M`, (7, n_samples)."""
    three, _ = soundfile.read(data / "r3vival" / f"{state}_{source}.wav")
    four, _ = soundfile.read(data / "r3vival_array" / f"{state}_{source}.flac")
    n = min(len(three), len(four))
    return np.concatenate([three[:n].T, four[:n].T])


def measured_states(data: Path, step: int, bands: Bands) -> None:
    """Print what each state says of R3VIVAL's walls, and how states agree on unchanged ones."""
    found = {}
    for state in ABSORBING:
        case = array_r3vival(data, state, step, bands)
        found[state] = estimates(case, KINDS)
        for name, answers in found[state].items():
            print(f"{state} {name}")
            for f, a in zip(bands.centres_hz, answers, strict=True):
                walls = zip(case.measured.scene.room.materials, a.absorption, strict=True)
                shown = "  ".join(
                    f"{w} {x:.2f} ({low:.2f}-{high:.2f}){'' if sure else '?'}"
                    for (w, x), low, high, sure in zip(
                        walls, a.lower95, a.upper95, a.identifiable, strict=True
                    )
                )
                print(f"  {f:5.0f} Hz  chi2 {a.chi2_reduced:.2f}  {shown}", flush=True)
    for name in found["000"]:
        every = [a for state in found.values() for a in state[name]]
        half = np.array([a.upper95 - a.lower95 for a in every]) / 2.0
        sure = sum(int(a.identifiable.sum()) for a in every)
        z = unchanged(case.measured.scene.room.materials, {s: f[name] for s, f in found.items()})
        rms = np.sqrt(np.mean(z**2))
        print(
            f"{name:>8}  half {np.median(half):.3f}  identifiable {sure} of {half.size}"
            f"  {z.size} differences of unchanged walls over their sd: rms {rms:.2f}"
        )


def unchanged(walls: Sequence[str], states: dict[str, list[BandEstimate]]) -> np.ndarray:
    """Return differences of unchanged walls between states over their standard deviations."""
    out = []
    for (one, other), same in SAME["r3vival"].items():
        own = [walls.index(w) for w in same]
        for a, b in zip(states[one], states[other], strict=True):
            sd = [np.sqrt(np.diagonal(x.logit_covariance))[own] for x in (a, b)]
            out.append((a.logit_mean[own] - b.logit_mean[own]) / np.hypot(*sd))
    return np.concatenate(out)


def line(name: str, answers: Sequence[tuple[list[BandEstimate], np.ndarray]]) -> str:
    """Return one row of the table, over all materials, bands and rooms."""
    truth = np.concatenate([t.T.ravel() for _, t in answers])
    a, low, high = (
        np.concatenate([getattr(b, key) for found, _ in answers for b in found])
        for key in ("absorption", "lower95", "upper95")
    )
    sure = np.concatenate([b.identifiable for found, _ in answers for b in found])
    chi2 = np.median([b.chi2_reduced for found, _ in answers for b in found])
    held = (low <= truth) & (truth <= high)
    error = np.abs(a - truth)
    return (
        f"{name:>16} {np.median(error):7.3f} {np.sqrt(np.mean(error**2)):7.3f}"
        f" {100 * held.mean():6.0f} {np.median(high - low) / 2:7.3f} {chi2:6.2f}"
        f" {sure.sum():4d} of {sure.size} {(sure & ~held).sum():4d}"
    )


HEADER = "                  median     rms held %    half   chi2    sure     wrong"


def boxes(seeds: Sequence[int], bands: Bands, *, middle: bool) -> None:
    """Print each box, and all of them together."""
    found: dict[str, list[tuple[list[BandEstimate], np.ndarray]]] = {}
    print(HEADER)
    for seed in seeds:
        case = array_box(seed, bands, middle=middle)
        assert case.truth is not None
        for name, answer in estimates(case, KINDS).items():
            found.setdefault(name, []).append((answer, case.truth))
            print(line(f"{seed} {name}", found[name][-1:]), flush=True)
    for name, answers in found.items():
        print(line(f"all {name}", answers))


def main() -> None:
    """Run the rooms one after the other."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=300)
    parser.add_argument("--rooms", type=int, default=10)
    parser.add_argument("--bands", type=float, nargs="+", default=[500.0, 1000.0])
    parser.add_argument("--middle", action="store_true")
    parser.add_argument("--measured", type=Path)
    parser.add_argument("--step", type=int, default=60)
    asked = parser.parse_args()
    bands = Bands("octave", np.array(asked.bands))
    if asked.measured is not None:
        measured_states(asked.measured, asked.step, bands)
        return
    boxes(range(asked.first, asked.first + asked.rooms), bands, middle=asked.middle)


if __name__ == "__main__":
    main()
