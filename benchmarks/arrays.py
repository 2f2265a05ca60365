"""Boxes of known walls heard by an array of seven capsules: its beams against its centre alone.

    python benchmarks/arrays.py [--first SEED] [--rooms N] [--bands HZ ...] [--middle]
    python benchmarks/arrays.py --measured DATA [--step DEGREES]

Random boxes of `benchmarks/boxes.py` (image sources that add as pressures, positions 1 cm wrong, noise
60 dB below the peak), eight pairs, each receiver seven capsules about a centre, which are 1 mm and
2 % wrong. Energies are fitted: of the centre alone, of the seven beams with variances of single
windows and nothing else (nominal), and with errors that all windows of a beam share.

--middle    sources and receivers at half the height
--measured  three states of R3VIVAL instead: DATA has the folders `r3vival` and `r3vival_array`
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

import roomfit
from roomfit.bands import Bands
from roomfit.diagnostics.checks import eyring_start
from roomfit.inversion.measurements import Measurements, collect_measurements
from roomfit.inversion.paths import TracedPaths, traced_paths
from roomfit.inversion.solve import shared_error_covariance
from roomfit.inversion.systematics import (
    inflated_by_adjacent_bands,
    relative_errors,
    shared_errors,
    with_shared_errors,
)
from roomfit.materials.priors import MaterialPrior, complete_priors, unknown_material
from roomfit.objective.beams import (
    BeamTerm,
    Beams,
    beam_levels,
    beam_term,
    beam_windows,
    with_levels,
)
from roomfit.objective.energy import EnergyTerm
from roomfit.objective.observation import energy_terms, fitted_in_band
from roomfit.objective.parameters import Parameters, physical_values
from roomfit.objective.problem import Objective
from roomfit.scene import Point, material_areas_m2, scene_of, shoebox_room
from roomfit.signals.filters import window_energies
from roomfit.signals.microphone_arrays import (
    CAPSULE_ERROR,
    array_beams,
    cross_patterns,
    level_errors,
)
from roomfit.solvers.least_squares import BandFit, fit_band, score_band
from roomfit.synthetic.boxes import (
    NOISE_DB,
    PLAN_BANDS,
    POSITION_ERROR_M,
    WALLS,
    add_noise,
    pressure_response,
    true_box,
)
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
LATE_ERROR = 0.05
ROUNDS = 3


class Heard(NamedTuple):
    """A room as it was measured by an array, and what is true of it, if that is known."""

    measured: Measurements  # by the centre
    beams: dict[int, np.ndarray]  # by pair: seven signals on the samples of its response
    priors: tuple[MaterialPrior, ...]
    truth: np.ndarray | None  # (n_materials, n_bands)


def heard_box(seed: int, bands: Bands, *, middle: bool = False) -> Heard:
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
    return Heard(measured, signals, priors, plan.absorption[np.ix_(order, own)])


def beams_of_windows(
    heard: Heard, band: int, windows: EnergyTerm
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the energies of one band's windows in every beam of each pair, and their noise."""
    bands, out = heard.measured.bands, []
    one = Bands(bands.kind, bands.centres_hz[band : band + 1])
    pairs = fitted_in_band(heard.measured.responses, band)
    for pair, observed in zip(pairs, windows.observations, strict=True):
        responses = [replace(pair.response, pressure=p) for p in heard.beams[pair.pair]]
        energy = [window_energies(one, r, observed.edges_s)[0] for r in responses]
        # noise of the capsules is independent: white noise tells what each beam makes of it
        white = np.random.default_rng(1).standard_normal((len(CAPSULES_M), 1 << 15))
        rate_hz = pair.response.sampling_rate_hz
        made = array_beams(white, rate_hz, CAPSULES_M, 343.0)
        end = np.array([0.1, 0.9]) * white.shape[1] / rate_hz
        of_white = [
            window_energies(one, roomfit_response(x, rate_hz), end)[0, 0] for x in (*made, white[0])
        ]
        noise = observed.noise * np.array(of_white[:-1])[:, None] / of_white[-1]
        out.append((np.array(energy), noise))
    return out


def roomfit_response(pressure: np.ndarray, rate_hz: float) -> object:
    """Return samples from emission on."""
    from roomfit.signals.response import ImpulseResponse

    return ImpulseResponse(pressure, rate_hz)


# Directions in steps of about 2 degrees.
_POLAR, _AZIMUTH = 91, 180


def directions() -> np.ndarray:
    """Return a grid of directions, (n, 3), azimuth fastest."""
    polar = np.repeat(np.linspace(0.0, np.pi, _POLAR), _AZIMUTH)
    azimuth = np.tile(np.arange(_AZIMUTH) * 2.0 * np.pi / _AZIMUTH, _POLAR)
    return np.stack(
        [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], 1
    )


def nearest_direction(u: np.ndarray) -> np.ndarray:
    """Return which of `directions` is nearest to each of some, shape (n,)."""
    polar = np.rint(np.arccos(np.clip(u[:, 2], -1.0, 1.0)) / np.pi * (_POLAR - 1)).astype(int)
    azimuth = np.rint(np.arctan2(u[:, 1], u[:, 0]) / (2.0 * np.pi) * _AZIMUTH).astype(int)
    return polar * _AZIMUTH + azimuth % _AZIMUTH


def omni_estimate(
    heard: Heard, traced: TracedPaths, band: int, own: tuple[EnergyTerm, Parameters]
) -> tuple[BandEstimate, BandFit]:
    """Return what the centre alone says of a band."""
    term, parameters = own
    objective = Objective(parameters, (term,))
    fit = fit_band(objective)
    noisy = shared_error_covariance(heard.measured, traced)(band, objective, fit)
    areas_m2 = material_areas_m2(heard.measured.scene.room)
    return band_estimate(parameters, noisy, areas_m2, "energy"), fit


@dataclass(frozen=True)
class Kind:
    """How the beams' windows are weighed."""

    level_sd: float | None  # None: by the errors of the capsules
    late_sd: float
    model: str = "coherent"


def beam_estimate(
    heard: Heard,
    traced: TracedPaths,
    band: int,
    own: tuple[EnergyTerm, Parameters],
    fit: BandFit,
    kind: Kind,
) -> tuple[BandEstimate, BandFit, Objective]:
    """Return what the beams say of a band, from the answer of the centre on."""
    (omni, parameters), scene = own, heard.measured.scene
    c = roomfit.air.speed_of_sound_m_s(scene.air)
    bands = heard.measured.bands
    one = Bands(bands.kind, bands.centres_hz[band : band + 1])
    (cross,) = cross_patterns(one, directions(), CAPSULES_M, c)
    came_from = nearest_direction(-traced.paths.arrival.astype(np.float64))
    beams = Beams(cross, tuple(came_from[rows.path] for rows in omni.rows))
    windows = beam_windows(omni, beams, beams_of_windows(heard, band, omni))
    sd = level_errors(one, CAPSULES_M, c)[0]
    sd = sd if kind.level_sd is None else np.full_like(sd, kind.level_sd)
    levels = beam_levels(sd, np.full_like(sd, kind.late_sd))
    with_beams = with_levels(parameters, levels)
    values = physical_values(parameters, fit.vector)[0]
    vector = np.append(fit.vector, np.zeros(2 * sd.size))
    for _ in range(ROUNDS):
        term = beam_term(omni, beams, windows, values, kind.model)
        objective = Objective(with_beams, (term,))
        found = score_band(objective, vector)
        vector = found.vector
        values = physical_values(with_beams, vector)[0]
    noisy = with_errors_of_beams(heard, traced, band, objective, found)
    return band_estimate(with_beams, noisy, material_areas_m2(scene.room), "energy"), found, objective


def with_errors_of_beams(
    heard: Heard, traced: TracedPaths, band: int, objective: Objective, fit: BandFit
) -> BandFit:
    """Return the fit of beams with the errors that windows share, as for a single microphone."""
    measured = heard.measured
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
    shared = {name: term.decorrelated(columns) for name, columns in shared.items()}
    return with_shared_errors(objective, fit, shared)


def estimates(heard: Heard, kinds: dict[str, Kind]) -> dict[str, list[BandEstimate]]:
    """Return the answers by the centre alone and by the beams, all bands."""
    settings = roomfit.Settings(model="energy")
    start = eyring_start(heard.measured)
    traced = traced_paths(heard.measured, heard.priors, settings, start, None, None)
    measured = heard.measured
    made = energy_terms(
        measured.scene, measured.bands, heard.priors, measured.responses, traced.binned, start
    )
    out: dict[str, list[BandEstimate]] = {"centre": [], **{name: [] for name in kinds}}
    for band, own in enumerate(made):
        if own is None:
            raise SystemExit("a band without data")
        alone, fit = omni_estimate(heard, traced, band, own)
        out["centre"].append(alone)
        for name, kind in kinds.items():
            out[name].append(beam_estimate(heard, traced, band, own, fit, kind)[0])
    areas_m2 = material_areas_m2(measured.scene.room)
    return {
        name: list(inflated_by_adjacent_bands(found, areas_m2, heard.priors))
        for name, found in out.items()
    }


KINDS = {
    "nominal": Kind(1e-3, 1e-3),
    "array": Kind(None, LATE_ERROR),
}


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
        heard = heard_box(seed, bands, middle=middle)
        assert heard.truth is not None
        for name, answer in estimates(heard, KINDS).items():
            found.setdefault(name, []).append((answer, heard.truth))
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
    asked = parser.parse_args()
    bands = Bands("octave", np.array(asked.bands))
    boxes(range(asked.first, asked.first + asked.rooms), bands, middle=asked.middle)


if __name__ == "__main__":
    main()
