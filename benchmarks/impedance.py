"""Impedances found again: the table A1 to A10 of docs/impedance.md.

``scripts/bench impedance`` runs all, half an hour on one core; ``scripts/bench impedance A3 A9``
some. Fields are exact waves of a box (`simulated_rooms.exact_box`) but in A6 and A10.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np

from _impedance_rooms import random_case
from roomfit.base.air import Air
from roomfit.base.typing import ComplexArray, FloatArray
from roomfit.fit.simplex import (
    Fit,
    anneal,
    downhill_simplex,
    random_simplex,
)
from roomfit.impedance.data import Observed, complex_frequency_hz
from roomfit.impedance.fit import continuation, distance, distinct, multistart, polish, start_of
from roomfit.impedance.fit import r0_of as r0_matrix
from roomfit.impedance.identify import ImpedanceSettings, identify_impedance, wave_problem
from roomfit.impedance.laws import absorption_normal, impedance_of_r0
from roomfit.impedance.result import ImpedanceResult
from roomfit.impedance.wave_model import (
    Nuisances,
    State,
    at_frequencies,
    at_rest,
    predicted_pressure,
    wave_model,
    wavenumber_per_m,
)
from roomfit.room.scene import Point, Scene
from simulated_rooms.impedance_box import (
    SURFACES,
    WALLS,
    box_scene,
    exact_pressure,
    noisy,
    rms_by_material,
    true_r0,
)
from simulated_rooms.polyhedral_rooms import room_of, slanted_cells
from simulated_rooms.wall_impedances import miki_layer, r0_of_impedance, resonator
from simulated_rooms.wave_images import bulk_reacting, image_pressure, locally_reacting

F_HZ = np.arange(100.0, 1001.0, 10.0)
TAU_S = 0.015
EXACT = Nuisances(0.0, 0.0)
NOTHING = Observed(F_HZ, TAU_S, np.ones((6, len(F_HZ)), dtype=complex))
NAMES = box_scene().room.materials  # slots, plaster, wool
TRUE = true_r0(NOTHING, NAMES)


def exact() -> ComplexArray:
    walls = {s: TRUE[NAMES.index(WALLS.get(s, "plaster"))] for s in SURFACES}
    return exact_pressure(F_HZ, TAU_S, walls)


FIELD = exact()


def found(answer: ImpedanceResult) -> ComplexArray:
    return np.array([m.r0 for m in answer.materials])


def fit(
    observed: Observed,
    scene: Scene,
    nuisances: Nuisances,
    starts: int = 0,
    *,
    spherical: bool = True,
) -> ImpedanceResult:
    return identify_impedance(
        scene, observed, None, nuisances,
        rng=np.random.default_rng(1), settings=ImpedanceSettings(starts, spherical),
    )  # fmt: skip


def formatted(values: FloatArray, digits: int = 4) -> str:
    return " / ".join(f"{v:.{digits}f}" for v in np.atleast_1d(values))


def errors(answer: ImpedanceResult, true: ComplexArray, f: FloatArray = F_HZ) -> str:
    r0 = found(answer)
    absorbed = rms_by_material(absorption_normal(r0) - absorption_normal(true), f)
    z = impedance_of_r0(true)
    off = np.median(np.abs(impedance_of_r0(r0) / z - 1.0)[:, f >= 200.0], axis=1)
    return (
        f"dR0 {formatted(rms_by_material(r0 - true, f))}, absorption {formatted(absorbed)}, "
        f"Z {formatted(100 * off, 1)} %, {answer.verdict.word}, {answer.seconds:.0f} s"
    )


def a1() -> None:
    scene = box_scene()
    model = wave_model(scene, F_HZ, TAU_S)
    for spherical in (True, False):
        p = predicted_pressure(model, TRUE, at_rest(model), spherical=spherical)
        rms = []
        for low, high in ((100, 200), (200, 400), (400, 700), (700, 1001)):
            own = (low <= F_HZ) & (high > F_HZ)
            square = np.sum(np.abs(p - FIELD)[:, own] ** 2) / np.sum(np.abs(FIELD[:, own]) ** 2)
            rms.append(100 * np.sqrt(square))
        print("A1", "spherical" if spherical else "plane", formatted(np.array(rms), 2), "%")


def a2() -> None:
    observed = Observed(F_HZ, TAU_S, FIELD, np.zeros(FIELD.shape))
    for spherical in (True, False):
        answer = fit(observed, box_scene(), EXACT, spherical=spherical)
        print("A2", "spherical" if spherical else "plane", errors(answer, TRUE))


def inside(answer: ImpedanceResult, true: ComplexArray, f: FloatArray = F_HZ) -> FloatArray:
    """Share of frequencies above 200 Hz whose intervals hold the truth: real, imaginary, alpha."""
    own = f > 200.0
    rows = []
    for m, r0 in zip(answer.materials, true, strict=True):
        alpha = absorption_normal(r0)
        rows.append(
            [
                np.mean((a <= v)[own] & (v <= b)[own])
                for a, v, b in (
                    (m.r0_lower95.real, r0.real, m.r0_upper95.real),
                    (m.r0_lower95.imag, r0.imag, m.r0_upper95.imag),
                    (m.absorption_normal_lower95, alpha, m.absorption_normal_upper95),
                )
            ]
        )
    return np.array(rows)


@cache
def seeds_at(snr_db: float, seed: int) -> ImpedanceResult:
    observed = noisy(F_HZ, TAU_S, FIELD, snr_db, np.random.default_rng(seed))
    return fit(observed, box_scene(), EXACT)


def a3(seeds: int = 10) -> None:
    for snr_db in (40.0, 20.0):
        rows = []
        for seed in range(seeds):
            r0 = found(seeds_at(snr_db, seed))
            absorbed = rms_by_material(absorption_normal(r0) - absorption_normal(TRUE), F_HZ)
            low = rms_by_material(r0 - TRUE, F_HZ, 100.0, 190.0)
            rows.append([rms_by_material(r0 - TRUE, F_HZ), absorbed, low])
        worst = np.max(rows, axis=0)
        print(
            f"A3 {snr_db:g} dB, worst of {seeds} seeds: dR0 {formatted(worst[0])}, absorption "
            f"{formatted(worst[1])}, below 200 Hz {formatted(worst[2], 3)}",
            flush=True,
        )


def a4(seeds: int = 5) -> None:
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        scene = box_scene(move_m=0.01, speed_m_s=343.0 * 1.003, rng=rng)
        observed = noisy(F_HZ, TAU_S, FIELD, 40.0, rng)
        answer = fit(observed, scene, Nuisances())
        speed = next(n for n in answer.nuisances if n.name == "speed of sound").value
        print(f"A4 seed {seed}: {errors(answer, TRUE)}, c off by {100 * (speed / 343 - 1):+.4f} %")
        if seed == 0:
            wrong = fit(observed, scene, EXACT)
            print("A4 not estimated:", wrong.verdict.word, "|", wrong.verdict.cause)


def a5() -> None:
    rng = np.random.default_rng(7)
    scene = box_scene(move_m=0.01, speed_m_s=343.0 * 1.003, rng=rng)
    observed = noisy(F_HZ, TAU_S, FIELD, 40.0, rng)
    problem = wave_problem(scene, observed, None, Nuisances())
    began = time.perf_counter()
    starts = multistart(problem, 20, np.random.default_rng(8))
    each = (time.perf_counter() - began) / len(starts)
    # starts that meet at first sight go on alike
    ends = {id(s): polish(problem, s.x).r0 for s in distinct(starts, 1e-3)}
    by_id = {id(s): s for s in starts}
    best = ends[id(starts[0])]
    same = 0
    for start in starts:
        own = min(ends, key=lambda i: distance(by_id[i].r0, start.r0))
        same += distance(ends[own], best) <= 0.01
    print(f"A5 {same} of {len(starts)} starts in one minimum; {each:.1f} s each to a first look, "
          f"{time.perf_counter() - began:.0f} s in all")  # fmt: skip


def a6() -> None:
    scene = box_scene()
    model = wave_model(scene, F_HZ, TAU_S)
    k = wavenumber_per_m(model, at_rest(model))
    rng = np.random.default_rng(2)
    p = predicted_pressure(model, TRUE, at_rest(model))
    observed = noisy(F_HZ, TAU_S, p, 40.0, rng)
    assert observed.noise is not None, "noisy specifies it"
    for name, pairs, phase in (("one pair", 1, True), ("levels", 6, False)):
        one = Observed(
            F_HZ[40:41], TAU_S,
            observed.pressure[:pairs, 40:41] if phase else np.abs(observed.pressure[:, 40:41]),
            observed.noise[:pairs, 40:41], phase,
        )  # fmt: skip
        answer = fit(one, box_scene(n_pairs=pairs), EXACT)
        print("A6 one frequency,", name, "|", answer.verdict.word, "|", answer.findings[0].code)
    f = complex_frequency_hz(NOTHING)
    z = impedance_of_r0(TRUE)
    for sigma, depth in ((5e3, 0.1), (20e3, 0.04)):
        walls = {m: locally_reacting(own, k) for m, own in zip(NAMES, z, strict=True)}
        walls["wool"] = bulk_reacting(f, sigma, depth, 343.0, k)
        data = noisy(F_HZ, TAU_S, image_pressure(model, walls, at_rest(model)), 40.0, rng)
        answer = fit(data, scene, EXACT)
        print(f"A6 extended reaction {sigma:g} Pa s/m2, {depth} m:", answer.verdict.word,
              f"chi2 {answer.chi2:.2f} |", answer.verdict.cause)  # fmt: skip
    levels = Observed(F_HZ, TAU_S, np.abs(observed.pressure), observed.noise, has_phase=False)
    answer = fit(levels, scene, EXACT, 3)
    print("A6 levels:", errors(answer, TRUE), "weaker" if answer.verdict.weaker else "NOT weaker")


def a8(seeds: int = 40) -> None:
    shares = []
    for seed in range(seeds):
        shares.append(inside(seeds_at(40.0, seed), TRUE))
        if seed % 10 == 9:
            mean = np.mean(shares, axis=0)
            each = "; ".join(
                f"{n} {formatted(100 * row, 0)}" for n, row in zip(NAMES, mean, strict=True)
            )
            print(f"A8 {seed + 1} seeds: {100 * mean.mean():.1f} % within; {each}", flush=True)


def six_walls() -> dict[str, ComplexArray]:
    f = complex_frequency_hz(NOTHING)
    z = {
        "west": resonator(f, 0.3, 0.3, 0.08, 8e3, 343.0),
        "east": 70.0 - 30j * 200.0 / f,
        "south": miki_layer(f, 2e4, 0.025, 0.05, 343.0),
        "north": 20.0 + 5j * f / 500.0,
        "floor": miki_layer(f, 6e4, 0.01, 0.0, 343.0),
        "ceiling": miki_layer(f, 2e4, 0.04, 0.0, 343.0),
    }
    return {s: r0_of_impedance(v) for s, v in z.items()}


def a9(seeds: int = 3) -> None:
    walls = six_walls()
    true = np.array([walls[s] for s in SURFACES])
    p = exact_pressure(F_HZ, TAU_S, walls)
    for seed in range(seeds):
        observed = noisy(F_HZ, TAU_S, p, 40.0, np.random.default_rng(seed))
        answer = fit(observed, box_scene({s: s for s in SURFACES}), EXACT)
        within = 100 * inside(answer, true).mean()
        print(f"A9 seed {seed}: {errors(answer, true)}, {within:.0f} % within")


def other_rooms(seeds: int = 40) -> None:
    """Rooms that no number in the code was chosen by: `_impedance_rooms.random_case`."""
    shares, worst, words = [], [], []
    for seed in range(seeds):
        case = random_case(seed)
        nuisances = replace(
            Nuisances() if case.move_m else EXACT, gain="spectrum" if case.coloured else "known"
        )
        answer = fit(case.observed, case.scene, nuisances, 1)
        f = case.observed.frequency_hz
        within = inside(answer, case.r0, f).mean()
        off = rms_by_material(found(answer) - case.r0, f)
        words.append(answer.verdict.word)
        shares.append(within)
        worst.append(off.max())
        sides = " x ".join(f"{s:.1f}" for s in case.scene.room.shoebox_m or ())
        print(
            f"rooms {seed}: {sides} m, {', '.join(case.kinds)}; {len(case.scene.pairs)} pairs, "
            f"{case.snr_db:g} dB, {1000 * case.move_m:g} mm"
            f"{', coloured' * case.coloured}: dR0 {formatted(off, 3)}, "
            f"{100 * within:.0f} % within, model error {answer.model_error:.3f}, "
            f"{answer.verdict.word} {answer.verdict.cause}, {answer.seconds:.0f} s",
            flush=True,
        )
    sure = np.array(words) == "identified"
    for word in sorted(set(words)):
        print(f"rooms: {words.count(word)} {word}")
    print(
        f"rooms: {100 * np.mean(shares):.1f} % of intervals hold the truth, "
        f"{100 * np.mean(np.array(shares)[sure]):.1f} % where identified, "
        f"{100 * np.min(np.array(shares)[sure]):.0f} % in the worst of those; dR0 where identified "
        f"median {np.median(np.array(worst)[sure]):.4f}, worst {np.max(np.array(worst)[sure]):.4f}"
    )


def six_materials(rooms: int = 10) -> None:
    """Boxes of six materials at 40 dB, six pairs: the worst wall of each kind, 200 to 1000 Hz."""
    off: dict[str, list[float]] = {}
    held: dict[str, list[float]] = {}
    done = 0
    for seed in range(100, 1000):
        case = random_case(seed, 6, 6)
        if case.snr_db != 40.0 or case.coloured:
            continue
        answer = fit(case.observed, case.scene, Nuisances() if case.move_m else EXACT)
        f = case.observed.frequency_hz
        rms = rms_by_material(found(answer) - case.r0, f)
        within = inside(answer, case.r0, f).mean(axis=1)
        for kind, r, w in zip(case.kinds, rms, within, strict=True):
            off.setdefault(kind, []).append(r)
            held.setdefault(kind, []).append(w)
        print(
            f"six {seed}: {1000 * case.move_m:g} mm, {', '.join(case.kinds)}: dR0 "
            f"{formatted(rms)}, model error {answer.model_error:.3f}, {answer.verdict.word}, "
            f"{answer.seconds:.0f} s",
            flush=True,
        )
        done += 1
        if done == rooms:
            break
    for kind, each in sorted(off.items()):
        print(
            f"six: {len(each)} {kind}: dR0 rms {np.sqrt(np.mean(np.square(each))):.4f}, worst "
            f"{max(each):.4f}, {100 * np.mean(held[kind]):.0f} % within"
        )
    every = np.concatenate(list(off.values()))
    print(f"six: {np.count_nonzero(every > 0.03)} of {every.size} walls off by more than 0.03")


def hexahedron(shares: FloatArray) -> Scene:
    room = room_of(slanted_cells())
    two = np.array([0, 0, 0, 0, 0, 1])  # the last wall, of wool
    room = replace(room, materials=("plaster", "wool"), surface_material=two)
    low = room.mesh.vertices_m.min(axis=0)
    size = np.ptp(room.mesh.vertices_m, axis=0)
    at = low + shares * size
    sources = tuple(Point(f"S{i}", p) for i, p in enumerate(at[:2]))
    receivers = tuple(Point(f"R{i}", p) for i, p in enumerate(at[2:]))
    pairs = np.array([(0, 0), (1, 1), (0, 2), (1, 0), (0, 1), (1, 2)])
    return Scene(room, sources, receivers, pairs, Air(speed_of_sound_m_s=343.0, attenuation="none"))


def a10(seeds: int = 2) -> None:
    shares = np.array(
        [[0.35, 0.4, 0.4], [0.6, 0.35, 0.55], [0.6, 0.6, 0.6], [0.4, 0.6, 0.35], [0.5, 0.45, 0.7]]
    )
    f, tau_s = np.arange(200.0, 801.0, 12.5), 0.010
    scene = hexahedron(shares)
    empty = Observed(f, tau_s, np.ones((6, len(f)), dtype=complex))
    true = true_r0(empty, scene.room.materials)
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        size = np.ptp(scene.room.mesh.vertices_m, axis=0)
        moved = hexahedron(shares + 0.01 * rng.normal(size=shares.shape) / size)
        # another order than the fit takes: all paths of twice the length
        model = wave_model(moved, f, tau_s * 1.4)
        model = model._replace(tau_s=tau_s)
        walls = {
            m: locally_reacting(z, wavenumber_per_m(model, at_rest(model)))
            for m, z in zip(scene.room.materials, impedance_of_r0(true), strict=True)
        }
        p = image_pressure(model, walls, State(np.zeros((2, 3)), np.zeros((3, 3)), 0.002))
        answer = fit(noisy(f, tau_s, p, 40.0, rng), scene, Nuisances(), 1)
        print(f"A10 seed {seed}: {errors(answer, true, f)}")


def the_papers_way(seeds: int = 15) -> None:
    """Simplex and annealing over Re Z and Im Z, and least squares over R0: the model's own data.

    One frequency, six pairs, three materials, no noise: as easy as it gets.
    """
    at = 40
    model = at_frequencies(wave_model(box_scene(), F_HZ, TAU_S), np.array([at]))
    true = TRUE[:, [at]]
    scale = np.sum(np.abs(predicted_pressure(model, true, at_rest(model), spherical=False)) ** 2)
    plane = {"spherical": False, "short": True}
    data = predicted_pressure(model, true, at_rest(model), **plane)

    def r0_of(x: FloatArray) -> ComplexArray:
        return r0_of_impedance(200.0 * x[:3] + 1j * (400.0 * x[3:] - 200.0))[:, None]

    def error(x: FloatArray) -> float:
        off = predicted_pressure(model, r0_of(x), at_rest(model), **plane) - data
        return float(np.sum(np.abs(off) ** 2) / scale)

    ways: dict[str, Callable[[np.random.Generator], Fit]] = {
        "simplex": lambda rng: downhill_simplex(
            error, random_simplex(6, rng), max_evaluations=4000
        ),
        "annealing + simplex": lambda rng: anneal(error, 6, rng, levels=40, trials_per_unknown=10),
    }
    for name, way in ways.items():
        right, evaluations, seconds = 0, [], []
        runs = seeds if name == "simplex" else 4
        for seed in range(runs):
            began = time.perf_counter()
            end = way(np.random.default_rng(seed))
            seconds.append(time.perf_counter() - began)
            evaluations.append(end.evaluations)
            right += int(np.abs(r0_of(end.x) - true).max() <= 0.01)
        print(
            f"paper, {name}: {right} of {runs} right, {np.median(evaluations):.0f} evaluations, "
            f"{np.median(seconds):.1f} s a run"
        )
    observed = Observed(F_HZ[[at]], TAU_S, data, np.full(data.shape, 1e-4 * np.sqrt(scale / 6)))
    began = time.perf_counter()
    settings = ImpedanceSettings(spherical=False, model_error=0.0)
    x = wave_problem(box_scene(), observed, None, EXACT, settings)
    x = replace(x, model=model)
    found = continuation(x, start_of(x))
    off = np.abs(r0_matrix(x, found.x) - true).max()
    print(f"paper, least squares over R0: off by {off:.1e}, {found.evaluations} evaluations, "
          f"{time.perf_counter() - began:.2f} s")  # fmt: skip


ALL: dict[str, Callable[[], None]] = {
    "A1": a1, "A2": a2, "A3": a3, "A4": a4, "A5": a5, "A6": a6, "A8": a8, "A9": a9, "A10": a10,
    "rooms": other_rooms, "six": six_materials,
    "paper": the_papers_way
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rows", nargs="*", metavar="ROW", help=f"of {', '.join(ALL)}; or all")
    rows: list[str] = parser.parse_args().rows
    for name in rows:
        if name not in ALL:
            parser.error(f"no row {name!r}: there are {', '.join(ALL)}")
    print("materials in order:", ", ".join(NAMES))
    for name in rows or list(ALL):
        began = time.perf_counter()
        ALL[name]()
        print(f"   {name} took {time.perf_counter() - began:.0f} s", flush=True)


if __name__ == "__main__":
    main()
