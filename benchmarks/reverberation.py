"""How often the 95 % intervals of `roomfit reverberation` contain the true mean absorption.

Decay times come from rays that walls absorb and scatter (Lambert's law) in boxes, followed here
by no part of roomfit: the energy of the whole room, T30 from -5 to -35 dB. At so many
positions they scatter as ISO 3382-2 (annex A) has it for impulse responses.

    python benchmarks/reverberation.py --rooms 100
    python benchmarks/reverberation.py --treat 200
    python benchmarks/reverberation.py --change 400

The second asks `treat` for so much of a panel on one hard wall that T30 meets a target with a
probability of 90 %, and counts in how many of the rooms rays then say that it is met. The third
covers a part of any wall with a panel: how often T30 of the same rays rises where absorption does,
and quantiles of the factor on Eyring's change of its logarithm, in flat rooms on that of
directions, as normal scores of what `DiffuseField.effect` grants, which should be -1.64, -0.99, 0,
0.99 and 1.64. "broad": six or three materials of the broad prior. For flat rooms also, by the wall
that is covered, the ratio of the change to Eyring's, and root mean squares of the change and of the
errors of directions and of formulas.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numba
import numpy as np

from roomfit.base.air import Air
from roomfit.base.bands import bands_between
from roomfit.base.logit import expit, logit
from roomfit.base.typing import FloatArray
from roomfit.materials.priors import MaterialPrior, logit_normal, unknown_material
from roomfit.predict.diffuse import field_times_s, prepare_field
from roomfit.predict.diffuse_field import FORMULAS, DiffuseField, diffuse_absorption
from roomfit.room.scene import Scene, shoebox_room
from roomfit.treat.arrangements import treat
from roomfit.treat.question import Product, Surface, Target

SPEED_M_S, BANDWIDTH_HZ, N_POSITIONS, BIN_S = 343.0, 707.0, 6, 0.5e-3
# of which those along a flat room decide how it ends: with 3,000 its T30 scatters by 15 %
N_RAYS = 100_000
# of logit absorption, where a table of materials says what the walls are
TABLE_SD = 0.5
KINDS = ("alike", "cubic", "uneven", "flat")


def ray_decay_s(
    lengths_m: FloatArray, absorption: FloatArray, scattering: float, rng: np.random.Generator
) -> float:
    """Return T30 of a box: walls x = 0, x = L, y = 0 and so on absorb energy, and scatter it."""
    longest_s = 240.0 * np.log(10.0) * np.prod(lengths_m) / SPEED_M_S  # of 0.1 m2 of absorption
    lost = np.zeros(int(longest_s / BIN_S))
    at, ways = rng.random((N_RAYS, 3)) * lengths_m, rng.standard_normal((N_RAYS, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    _follow(lengths_m, absorption, scattering, at, ways, rng, lost)
    left = lost[::-1].cumsum()[::-1]
    # what is integrated backwards is the energy from each time on
    level_db = 10.0 * np.log10(np.maximum(left[::-1].cumsum()[::-1] / left.sum(), 1e-12))
    used = (level_db <= -5.0) & (level_db >= -35.0)
    slope, _ = np.polyfit(np.arange(np.count_nonzero(used)), level_db[used], 1)
    return -60.0 * BIN_S / float(slope)


@numba.njit
def _follow(lengths, absorption, scattering, starts, ways, rng, lost):  # type: ignore[no-untyped-def]
    """Follow every ray until 70 dB of its energy are lost, and add up when."""
    for r in range(len(starts)):
        at, way, energy, time_s = starts[r], ways[r], 1.0, 0.0
        while energy > 1e-7:
            axis, step = 0, np.inf
            for k in range(3):
                ahead = lengths[k] - at[k] if way[k] > 0.0 else at[k]
                reach = ahead / max(abs(way[k]), 1e-12)
                if reach < step:
                    axis, step = k, reach
            far = way[axis] > 0.0
            time_s += step / SPEED_M_S
            own = energy * absorption[2 * axis + far]
            lost[min(int(time_s / BIN_S), len(lost) - 1)] += own
            energy -= own
            for k in range(3):
                at[k] = min(max(at[k] + step * way[k], 0.0), lengths[k])
            way[axis] = -way[axis]
            if rng.random() < scattering:  # by Lambert's law
                sine, turn = np.sqrt(rng.random()), 2.0 * np.pi * rng.random()
                way[axis] = (-1.0 if far else 1.0) * np.sqrt(1.0 - sine * sine)
                way[(axis + 1) % 3] = sine * np.cos(turn)
                way[(axis + 2) % 3] = sine * np.sin(turn)


def room(kind: str, rng: np.random.Generator) -> tuple[FloatArray, FloatArray, float]:
    """Return lengths, absorption of the six walls, and scattering of a room of a kind.

    alike: all walls one absorption. cubic: near a cube, walls of 0.05 to 0.4. uneven: a usual
    room, hard but for the ceiling or another wall. flat: the same, 3 m high and far wider.
    """
    near = rng.uniform(0.85, 1.18, 3)
    usual = np.array([rng.uniform(1.6, 2.6), rng.uniform(1.2, 1.9), 1.0])
    wide = np.array([rng.uniform(4.0, 7.0), rng.uniform(3.0, 5.0), 1.0])
    shape = {"cubic": near, "alike": usual, "uneven": usual, "flat": wide}[kind]
    volume = np.exp(rng.uniform(np.log(50.0), np.log(500.0)))
    lengths_m = shape * (volume / np.prod(shape)) ** (1.0 / 3.0)
    absorption = expit(rng.normal(float(logit(np.array([0.15]))[0]), 0.7, 6))
    if kind == "alike":
        absorption[:] = absorption[0]
    if kind in ("uneven", "flat"):
        absorption = rng.uniform(0.03, 0.12, 6)
        absorption[5 if kind == "flat" else rng.integers(6)] = rng.uniform(0.5, 0.9)
    return lengths_m, absorption, float(rng.uniform(0.1, 0.5))


def scattered(decay_s: float, rng: np.random.Generator) -> FloatArray:
    """Return what is measured of T30, shape (n_positions, 1); the spread of ISO 3382-2."""
    sd = 0.55 * decay_s * np.sqrt((1.0 + 1.52 / 10.0) / (BANDWIDTH_HZ * decay_s))
    noise: FloatArray = sd * rng.standard_normal((N_POSITIONS, 1))
    return decay_s + noise


def priors_of(
    known: str, absorption: FloatArray, rng: np.random.Generator
) -> tuple[MaterialPrior, ...]:
    """Return what is known of the walls: nothing but the surface, the walls apart, or a table."""
    if known == "surface":
        return (unknown_material("room", 1),)
    if known == "walls":
        return tuple(unknown_material(f"wall {i}", 1) for i in range(6))
    off = logit(absorption) + TABLE_SD * rng.standard_normal(6)
    return tuple(MaterialPrior(f"wall {i}", off[i : i + 1], np.full(1, TABLE_SD)) for i in range(6))


def covered(n_rooms: int, seed: int = 1) -> dict[tuple[str, str], FloatArray]:
    """Return, by kind of room and what is known, shape (n_rooms, n_formulas, 3).

    Whether the interval holds the truth, the error, and the width.
    """
    found: dict[tuple[str, str], list[FloatArray]] = {}
    octave = bands_between("octave", 1000.0, 1000.0)
    for number, kind in enumerate(KINDS):
        rng = np.random.default_rng((seed, number))
        for _ in range(n_rooms):
            lengths_m, absorption, scattering = room(kind, rng)
            areas = np.repeat(np.prod(lengths_m) / lengths_m, 2)
            truth = float(areas @ absorption / areas.sum())
            measured_s = scattered(ray_decay_s(lengths_m, absorption, scattering, rng), rng)
            for known in ("surface", "walls", "table"):
                by_axis = np.zeros((3, 6))
                by_axis[np.repeat(np.arange(3), 2), np.arange(6)] = areas
                if known == "surface":
                    by_axis = np.full((3, 1), areas.sum() / 3.0)
                answer = diffuse_absorption(
                    measured_s,
                    octave,
                    priors_of(known, absorption, rng),
                    by_axis,
                    float(np.prod(lengths_m)),
                    speed_of_sound_m_s=SPEED_M_S,
                    attenuation_per_m=np.zeros(1),
                )
                value, lower, upper = answer.mean[:, :, 0].T
                inside = (lower <= truth) & (truth <= upper)
                row = np.stack([inside, value / truth - 1.0, (upper - lower) / truth], axis=1)
                found.setdefault((kind, known), []).append(row)
    return {key: np.stack(rows) for key, rows in found.items()}


WALLS = ("west", "east", "south", "north", "floor", "ceiling")
PANEL_SD, MARGIN = 0.05, 1.1


def treated_room(
    kind: str, rng: np.random.Generator, probability: float
) -> tuple[float, bool, float] | None:
    """Return the stated probability, whether rays meet the target, and how far off T30 is.

    None where no area of the panel does. A table says what the walls of such a room absorb, and
    they are off it by its spread; target and wall are chosen by what is known, not by the truth.
    """
    lengths_m, table, scattering = room(kind, rng)
    centre = logit(table)
    absorption = expit(centre + TABLE_SD * rng.standard_normal(6))
    areas = np.repeat(np.prod(lengths_m) / lengths_m, 2)
    measured_s = scattered(ray_decay_s(lengths_m, absorption, scattering, rng), rng)
    by_axis = np.zeros((3, 6))
    by_axis[np.repeat(np.arange(3), 2), np.arange(6)] = areas
    spread = np.full(1, TABLE_SD)
    named = tuple(MaterialPrior(n, centre[i : i + 1], spread) for i, n in enumerate(WALLS))
    octave = bands_between("octave", 1000.0, 1000.0)
    field = DiffuseField(
        "Eyring", octave, named, by_axis, float(np.prod(lengths_m)), SPEED_M_S, np.zeros(1),
        measured_s,
    )  # fmt: skip
    walls = shoebox_room(tuple(map(float, lengths_m)), {n: n for n in WALLS})
    prepared = prepare_field(field, Scene(walls, (), (), np.zeros((0, 2), np.int64), Air()))
    known = prepared.absorption.absorption
    hard = int(rng.choice(np.flatnonzero(known[:, 0] <= np.median(known))))
    panel = np.array([rng.uniform(0.5, 0.9)])
    share, covered = float(rng.uniform(0.2, 0.7)), known.copy()
    covered[hard] += share * (panel - known[hard])
    target = Target(
        "T30_s", high=MARGIN * float(field_times_s(prepared, covered)[0]), bands_hz=(1000.0,)
    )
    product = Product("panel", panel, np.full(1, PANEL_SD), 1.0, 0.05)
    found = treat(
        prepared, (Surface(WALLS[hard]),), (product,), (target,), number=1, probability=probability
    )
    first = found.arrangements[0]
    if not found.is_met or not first.hung:
        return None
    # a panel that absorbs as much as its spread permits
    true_panel = float(logit_normal(panel, np.full(1, PANEL_SD), rng.standard_normal(1))[0, 0])
    after, share = absorption.copy(), first.hung[0].area_m2 / areas[hard]
    after[hard] += share * (true_panel - absorption[hard])
    measured = float(scattered(ray_decay_s(lengths_m, after, scattering, rng), rng).mean())
    off = measured / float(first.mean["T30_s"].predicted[0]) - 1.0
    return float(first.probability[0]), measured <= target.high, off


def met(n_rooms: int, seed: int = 1, probability: float = 0.9) -> dict[str, FloatArray]:
    """Return what `treated_room` does for rooms of each kind that have an answer, (n_rooms, 3).

    Of flat rooms fewer, where hardly any area of a panel is likely enough: of 8 n_rooms tried.
    """
    found = {}
    for number, kind in enumerate(KINDS):
        rng, rows = np.random.default_rng((seed, number, 7)), []
        for _ in range(8 * n_rooms):
            row = treated_room(kind, rng, probability)
            rows += [] if row is None else [row]
            if len(rows) == n_rooms:
                break
        found[kind] = np.array(rows, dtype=np.float64).reshape(-1, 3)
    return found


def print_met(n_rooms: int, seed: int) -> None:
    """Print how often targets are met that were to be met with a probability of 90 %."""
    print("room     rooms  stated    met  90 % binomial about the stated   T30 off: mean, sd")
    found = met(-(-n_rooms // len(KINDS)), seed)
    for kind, rows in (*found.items(), ("all", np.concatenate(list(found.values())))):
        if not len(rows):
            continue
        stated, n = rows[:, 0].mean(), len(rows)
        half = 1.645 * np.sqrt(stated * (1.0 - stated) / n)
        print(
            f"{kind:8} {n:5d}  {stated:6.3f} {rows[:, 1].mean():6.3f}  "
            f"{stated - half:5.3f} to {min(stated + half, 1.0):5.3f}"
            f"{100 * rows[:, 2].mean():+20.1f} % {100 * rows[:, 2].std():5.1f} %"
        )


def changed(kind: str, rng: np.random.Generator) -> tuple[float, ...]:
    """Return the change of log T30 by rays, its normal score, its direction, and the wall.

    The score is that of what is granted; NaN where less than 2 % is said. Then the change that is
    said, by directions where the room is flat, and by each of the formulas.
    """
    if kind == "broad":
        shape = np.array([rng.uniform(1.2, 2.8), rng.uniform(1.0, 2.0), 1.0])
        volume = np.exp(rng.uniform(np.log(50.0), np.log(3000.0)))
        lengths_m, scattering = (
            shape * (volume / np.prod(shape)) ** (1.0 / 3.0),
            rng.uniform(0.05, 0.5),
        )
        own = expit(rng.normal(float(logit(np.array([0.12]))[0]), 1.65, 6))
        absorption = own if rng.random() < 0.5 else own[[0, 0, 0, 0, 1, 2]]
    else:
        lengths_m, absorption, scattering = room(kind, rng)
    wall, panel, share = int(rng.integers(6)), rng.uniform(0.5, 0.95), rng.uniform(0.1, 1.0)
    after = absorption.copy()
    after[wall] += share * (panel - absorption[wall])
    seed = int(rng.integers(1 << 31))  # the same rays before and after
    times_s = [
        ray_decay_s(lengths_m, a, scattering, np.random.default_rng(seed))
        for a in (absorption, after)
    ]
    by_axis = np.zeros((3, 6))
    by_axis[np.repeat(np.arange(3), 2), np.arange(6)] = np.repeat(np.prod(lengths_m) / lengths_m, 2)
    field = DiffuseField(
        "Eyring", bands_between("octave", 1000.0, 1000.0), priors_of("walls", absorption, rng),
        by_axis, float(np.prod(lengths_m)), SPEED_M_S, np.zeros(1),
    )  # fmt: skip
    both = np.stack([absorption, after])[:, :, None]
    implied = field.scattering(both[0], np.array(times_s[:1])) if field.is_flat else None
    said = np.diff(np.log(field.times_s(both, implied)), axis=0)[0]
    formulas = [
        float(np.diff(np.log(replace(field, formula=f).times_s(both)), axis=0)[0, 0])
        for f in FORMULAS
    ]
    rest = bool(after[wall] > absorption[wall]), wall, float(said[0]), *formulas
    apart = np.zeros(1) if field.is_flat else field.formula_error(both)[1].max(axis=0)
    found = float(np.log(times_s[1] / times_s[0]))
    if abs(said[0]) < 0.02:
        return found, np.nan, *rest
    factor = float(np.log(np.clip(found / said[0], 0.02, 50.0)))
    unit = np.log(field.effect(said, apart, np.array(np.sign(factor))) / said)[0]
    score = factor / abs(unit) if unit else 0.0
    return found, float(score), *rest


def print_changed(n_rooms: int, seed: int) -> None:
    """Print how often more absorption lengthens a decay, and the scores of what changes do."""
    print("room     rooms  T30 rises by more than 1 %   scores at 5, 16, 50, 84, 95 %")
    for number, kind in enumerate(("broad", "uneven", "flat")):
        rng = np.random.default_rng((seed, number, 9))
        rows = np.array([changed(kind, rng) for _ in range(n_rooms)], dtype=np.float64)
        more = rows[:, 2] == 1.0
        scores = rows[more & np.isfinite(rows[:, 1]), 1]
        cells = " ".join(f"{q:+6.2f}" for q in np.quantile(scores, (0.05, 0.16, 0.5, 0.84, 0.95)))
        rises = np.count_nonzero(rows[more, 0] > np.log(1.01))
        print(f"{kind:8} {more.sum():5d}  {rises:26d}   {cells}")
    print_by_wall(rows)


def print_by_wall(rows: FloatArray) -> None:
    """Print for flat rooms, by the wall that is covered, what `changed` returned."""
    change, wall, said = rows[:, 0], rows[:, 3], rows[:, 4:]
    eyring = said[:, 1 + FORMULAS.index("Eyring")]
    heads = ("change", "directions", *FORMULAS)
    print("covered  rooms  ratio to Eyring's: 16, 50, 84 %   rms: " + ", ".join(heads))
    walls = (("side", wall < 4), ("floor", wall == 4), ("ceiling", wall == 5), ("all", wall >= 0))
    for name, own in walls:
        used = own & (abs(eyring) > 0.02)
        ratio = np.quantile((change / eyring)[used], (0.16, 0.5, 0.84))
        errors = np.column_stack([change, said - change[:, None]])[used]
        rms = np.sqrt(np.mean(errors**2, axis=0))
        cells = " ".join(f"{x:5.2f}" for x in ratio), " ".join(f"{x:6.3f}" for x in rms)
        print(f"{name:8} {np.count_nonzero(used):5d}  {cells[0]:33s} {cells[1]}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rooms", type=int, default=100, help="Of each kind.")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--treat", type=int, help="Rooms, of all kinds together, to be treated.")
    parser.add_argument("--change", type=int, help="Rooms of each kind, of which a wall changes.")
    options = parser.parse_args()
    if options.change is not None:
        print_changed(options.change, options.seed)
        return
    if options.treat is not None:
        print_met(options.treat, options.seed)
        return
    print("room     known     formula         holds   mean error   median width of the interval")
    for (kind, known), rows in covered(options.rooms, options.seed).items():
        for formula, own in zip(FORMULAS, rows.transpose(1, 0, 2), strict=True):
            holds, error, width = own[:, 0].mean(), own[:, 1].mean(), np.median(own[:, 2])
            print(
                f"{kind:<8} {known:<9} {formula:<14} {100 * holds:5.0f} % {100 * error:+9.0f} % "
                f"{100 * width:12.0f} %"
            )


if __name__ == "__main__":
    main()
