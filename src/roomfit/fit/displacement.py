"""Whether positions and the lengths of a box are where they are specified, by early reflections.

A group of positions that move together, and each length of a box, is displaced; the image sources
of low orders are found anew; and the energies in windows are compared under a few steps of
absorption, gains and directivity. What is specified with a standard deviation of its own is found
within it; what is not is only suspected, and found out where it is farther off than specified.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import NamedTuple, TypeAlias

import numpy as np

from roomfit.base.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.base.forks import in_forks
from roomfit.base.logit import logit
from roomfit.base.typing import FloatArray
from roomfit.fit.choice import choose
from roomfit.fit.fits import BandFits, Displacement, FittedGeometry
from roomfit.fit.measurements import Measurements
from roomfit.fit.paths import TracedPaths, trim_memory
from roomfit.fit.scattering import band_factors
from roomfit.materials.priors import MaterialPrior, Scattering
from roomfit.model.binned import once
from roomfit.model.directivity import directed_band, row_bases, with_directivities
from roomfit.model.early import DisplacedTerm, FixedPaths, displaced_term, fixed_paths
from roomfit.model.observation import DEFAULT_POSITION_SD_M, energy_terms, fitted_in_band
from roomfit.model.parameters import (
    Parameters,
    absorption_of,
    physical_values,
    prior_residuals,
    start_vector,
)
from roomfit.model.problem import Objective
from roomfit.model.weighing import taken_rows
from roomfit.room.mesh import box_of, mean_free_path_m, shoebox_mesh
from roomfit.room.scene import (
    NEAREST_PAIR_M,
    NEAREST_WALL_M,
    Point,
    Room,
    Scene,
    distances_m,
    position_findings,
)
from roomfit.signals.filters import spreading_kernel
from roomfit.signals.measurement import MeasuredPair
from roomfit.solver import score_band
from roomfit.tracing.image_sources import trace_images
from roomfit.tracing.paths import TraceSettings

# Below it a window is longer than what a displacement does to a reflection.
_LEAST_HZ = 400.0
# Images of this order and within so many mean free paths of the direct sound move.
_ORDER, _MEAN_FREE_PATHS = 3, 8.0
# Windows half as long as those of the fit: 18 cm of a path.
_PERIODS, _FINE_S = 0.75, 0.05
# A tree of beams for every geometry takes milliseconds only where walls are few.
_MOST_TRIANGLES = 60
# Of a box's lengths, where no standard deviation is specified.
LENGTH_SD_M = 0.03
LARGEST_SHIFT_SD = 3.5
# A wall reflects from so far off the plane that a tape finds, panels and furniture being what they
# are: joined to every standard deviation. Chosen on one measured room, decision 0035.
_WALL_SD_M = 0.035
# Log-likelihood that a displacement beyond what is specified must gain: decision 0035.
LEAST_GAIN = 10.0
# Lower bands regained at most 5 of what higher ones lost: decision 0040.
_RULED_OUT = 50.0
_GRID_M = np.outer([-1.0, 1.0], [0.1, 0.2, 0.3, 0.4, 0.5, 0.65, 0.8, 1.0, 1.2]).ravel()
# A stated offset is sought at least so far about the best of the grid, to within 2 mm.
_LEAST_REACH_M, _NEAR_M = 0.06, 2e-3
_STEP_M = 0.04
_REACH_M = 0.1  # of one step of a sweep
_WITHIN_SD = (-3.0, -2.0, -1.0, 1.0, 2.0, 3.0)
WORTH_TELLING_M = 0.3
_APART_M = 0.06  # of second differences, smooth over what single windows do
AXES = "xyz"


@dataclass(frozen=True, slots=True)
class Offset:
    """One number, in m, that displaces a group of positions along an axis or lengthens a box."""

    group: str  # "" for a length
    axis: int
    sd_m: float
    is_stated: bool  # fitted within its standard deviation; otherwise only suspected
    sources: frozenset[str] = frozenset()
    receivers: frozenset[str] = frozenset()

    @property
    def label(self) -> str:
        """Its name in results."""
        return f"{self.group or 'length'} {AXES[self.axis]}"

    @property
    def tolerance_m(self) -> float:
        """Its standard deviation, with how far a wall reflects from off its plane."""
        return float(np.hypot(self.sd_m, _WALL_SD_M))

    @property
    def plausible_m(self) -> float:
        """How far off is plausible."""
        return LARGEST_SHIFT_SD * self.tolerance_m

    def log_prior(self, by_m: float) -> float:
        """Return the logarithm of its prior over that of none.

        Student's t with four degrees of freedom: a likelihood of one model that is maximised over a
        hundred places gains 20 somewhere.
        """
        return -2.5 * float(np.log1p(0.25 * (by_m / self.tolerance_m) ** 2))


def offsets_of(scene: Scene) -> tuple[Offset, ...]:
    """Return what may be displaced: stated groups or all positions, and the lengths of a box."""
    found = []
    every = [frozenset(p.name for p in points) for points in (scene.sources, scene.receivers)]
    for group in scene.groups:
        own = [
            frozenset(n for n in k if any(fnmatchcase(n, p) for p in group.members)) for k in every
        ]
        stated_m = np.broadcast_to(np.asarray(group.sd_m), 3)
        if any(own):
            found += [Offset(group.name, a, float(stated_m[a]), True, *own) for a in range(3)]
    if not any([o.sources, o.receivers] == every for o in found):
        sds_m = [p.position_sd_m for p in (*scene.sources, *scene.receivers)]
        known_m = [DEFAULT_POSITION_SD_M if s is None else s for s in sds_m]
        sd_m = max(float(np.sqrt(np.mean(np.square(known_m)))), 1e-3)
        found += [Offset("all positions", a, sd_m, False, *every) for a in range(3)]
    if scene.room.shoebox_m is not None:
        stated = scene.room.lengths_sd_m
        found += [
            Offset("", a, LENGTH_SD_M if stated is None else stated[a], stated is not None)
            for a in range(3)
        ]
    return tuple(o for o in found if o.sd_m > 0.0)


def displaced(scene: Scene, offsets: Sequence[Offset], shift_m: FloatArray) -> Scene:
    """Return the scene with its offsets at the given values, (n_offsets,)."""
    moves, longer_m = list(zip(offsets, shift_m, strict=True)), np.zeros(3)
    for offset, by_m in moves:
        longer_m[offset.axis] += 0.0 if offset.group else by_m

    def moved(points: tuple[Point, ...], kind: str) -> tuple[Point, ...]:
        steps_m = np.zeros((len(points), 3))
        for offset, by_m in moves:
            steps_m[[p.name in getattr(offset, kind) for p in points], offset.axis] += by_m
        each = zip(points, steps_m, strict=True)
        return tuple(replace(p, position_m=p.position_m + step) for p, step in each)

    room = scene.room
    if np.any(longer_m):
        x, y, z = (np.array(room.shoebox_m) + longer_m).tolist()
        mesh = replace(room.mesh, vertices_m=shoebox_mesh((x, y, z)).vertices_m)
        room = replace(room, mesh=mesh, shoebox_m=(x, y, z))
    sources, receivers = moved(scene.sources, "sources"), moved(scene.receivers, "receivers")
    return replace(scene, room=room, sources=sources, receivers=receivers)


class _Band(NamedTuple):
    """One band: what stays, where its fit starts, and the recording of each observation."""

    band: int
    kept: FixedPaths
    parameters: Parameters
    start: FloatArray  # (n_free,)
    files: tuple[MeasuredPair, ...]


class _EarlyWindows:
    """The log-likelihood of offsets with absorption, gains and directivity near the best.

    Minus infinity where a point leaves the room; roughly also where high bands rule it out, so that
    the others need not be asked. Windows follow a normal law whose scale is fitted in each band, so
    that a model that misses some of them alike at every place neither gains nor loses; neighbours
    count as for absorption.
    """

    def __init__(
        self,
        measured: Measurements,
        traced: TracedPaths,
        offsets: tuple[Offset, ...],
        moved_m: FloatArray,
        bands: Sequence[_Band],
    ) -> None:
        self.measured, self.traced, self.offsets, self.bands = measured, traced, offsets, bands
        self.moved_m = moved_m  # (n_offsets,), where the scene already differs from the specified
        self.kernel, self.unit = spreading_kernel(measured.bands), np.eye(len(offsets))
        self.known: dict[bytes, float] = {}
        self.vectors, self.least = [b.start for b in bands], [-np.inf] * len(bands)
        none = np.zeros(len(offsets))
        self.known[_rounded(none)] = self.evaluated(none, False, 12)

    def __call__(self, shift_m: FloatArray, roughly: bool = False) -> float:
        key = _rounded(shift_m)
        known = self.known.get(key)
        if known is None or not (roughly or known > -np.inf):
            known = self.known[key] = self.evaluated(shift_m, roughly, 2)
        return known

    def foresee(self, shifts_m: Sequence[FloatArray]) -> None:
        """Evaluate roughly at many vectors together, so that each is known when it is asked for."""
        asked = {_rounded(s): s for s in reversed(shifts_m) if _rounded(s) not in self.known}
        values = in_forks(lambda s: self.evaluated(s, True, 2), list(asked.values()))
        self.known |= dict(zip(asked, values, strict=True))

    def is_possible(self, shift_m: FloatArray) -> bool:
        """Whether all positions stay in the air of the room."""
        scene = displaced(self.measured.scene, self.offsets, shift_m)
        box_m = scene.room.shoebox_m
        if box_m is None:
            return not position_findings(scene.room, scene.sources, scene.receivers)
        points_m = np.array([p.position_m for p in (*scene.sources, *scene.receivers)])
        inside = (points_m > NEAREST_WALL_M) & (points_m < np.array(box_m) - NEAREST_WALL_M)
        return bool(inside.all() and distances_m(scene).min() > NEAREST_PAIR_M)

    def evaluated(self, shift_m: FloatArray, roughly: bool, max_rounds: int) -> float:
        if not self.is_possible(shift_m):
            return -np.inf
        total = 0.0
        for i, term in enumerate(self.terms(shift_m)):
            objective = Objective(self.bands[i].parameters, (term,))
            fit = score_band(objective, self.vectors[i], max_rounds=max_rounds)
            prior, _ = prior_residuals(objective.parameters, fit.vector)
            n = float(np.sum(1.0 / objective.correlation_length()))
            squares = (fit.measured - fit.expected) ** 2 / fit.variance
            spread = float(np.mean(np.log(fit.variance)) + np.log(np.mean(squares)))
            total += -0.5 * n * spread - 0.5 * float(prior @ prior)
            if max_rounds > 2:
                self.vectors[i], self.least[i] = fit.vector, total - _RULED_OUT
            elif roughly and total < self.least[i]:
                return -np.inf
        return total

    def terms(self, shift_m: FloatArray) -> Iterator[DisplacedTerm]:
        """Return the windows of every band with the offsets moved on by so much, one by one."""
        before, traced, bands = self.measured.scene, self.traced, self.measured.bands
        scene = displaced(before, self.offsets, shift_m)
        c, air_per_m = speed_of_sound_m_s(scene.air), attenuation_per_m(scene.air, bands)
        thinned = Scattering(traced.paths.materials, traced.paths.sampling_scattering)
        images = trace_images(scene, *_order_and_end_s(before, traced.settings), thinned)
        directivities = self.measured.directivities
        factors, _ = band_factors(directivities, scene, bands, images, traced.scattering)
        farther_m = distances_m(scene) - distances_m(before)
        for own in self.bands:
            weight = images.weight_per_m2 * np.exp(-float(air_per_m[own.band]) * images.length_m)
            if factors is not None:
                weight *= factors[own.band]
            # a response whose emission is not known stands with its direct sound where that was put
            is_timed = np.array([m.measurement.time_zero == "emission" for m in own.files])
            late_m = np.where(is_timed, 0.0, farther_m[[m.pair for m in own.files]])
            times_s = (images.length_m - late_m[:, None]) / c
            yield displaced_term(own.kept, images, times_s, weight, (self.kernel, own.band))


LogL: TypeAlias = Callable[..., float]
"""Log-likelihood of a vector of offsets in m, roughly where the second argument says so."""


def _rounded(shift_m: FloatArray) -> bytes:
    return np.round(shift_m, 4).tobytes()


def _order_and_end_s(scene: Scene, settings: TraceSettings) -> tuple[int, float]:
    """Return up to which order and until when image sources move."""
    reach_m = float(distances_m(scene).max()) + _MEAN_FREE_PATHS * mean_free_path_m(scene.room.mesh)
    limits_s = (s for s in (settings.duration_s, settings.image_until_s) if s is not None)
    return min(_ORDER, settings.image_order), min(
        reach_m / speed_of_sound_m_s(scene.air), *limits_s
    )


def _early_windows(
    measured: Measurements, priors: tuple[MaterialPrior, ...], traced: TracedPaths, fits: BandFits
) -> list[_Band]:
    """Return the bands in which early images can be distinguished, the highest first.

    None where responses or early images are too few, or walls too many to look images up on.
    """
    scene, bands, paths, mesh = (
        measured.scene,
        measured.bands,
        traced.paths,
        measured.scene.room.mesh,
    )
    has_few_walls = len(mesh.triangles) <= _MOST_TRIANGLES or box_of(mesh) is not None
    n_fitted = sum(m.measurement.use == "fit" for m in measured.responses)
    order, end_s = _order_and_end_s(scene, traced.settings)
    if n_fitted < 4 or not has_few_walls or order < 1:
        return []
    moves = (paths.batch < 0) & (paths.length_m <= speed_of_sound_m_s(scene.air) * end_s)
    met = paths.hits_specular[moves] + paths.hits_diffuse[moves]
    moves[moves] = met.sum(axis=1) <= order
    # levels differ by what is no displacement, files that were normalised singly or a loudspeaker
    # that radiates less one way: each response gets a gain of its own
    responses = tuple(
        replace(m, measurement=replace(m.measurement, level="per-file"))
        if m.measurement.level == "per-source"
        else m
        for m in measured.responses
    )
    answers, unknown = fits.answers, fits.unknown_sources
    start = np.array([float(np.mean(a.absorption)) for a in answers])
    finer = {"periods": _PERIODS, "fine_s": _FINE_S}
    made = energy_terms(scene, bands, priors, responses, traced.binned, start, **finer)
    bases = None if unknown is None else row_bases(unknown, scene, paths, traced.binned, ~moves)
    out: list[_Band] = []
    for band, own in enumerate(made):
        if own is None or bands.centres_hz[band] < _LEAST_HZ or answers[band].model == "prior":
            continue
        (term, parameters), files = own, fitted_in_band(responses, band)
        ends = scene.pairs[[m.pair for m in files]]
        kept = (taken_rows(r, np.flatnonzero(~moves[r.path])) for r in term.rows)
        term = replace(term, rows=once(ends, kept))
        directivity, b = None, np.zeros((0, 3))
        if unknown is not None and bases is not None:
            directivity = directed_band(unknown, scene, bases, term, files)
            b = np.stack([d.b[band] for d in fits.directivities])
            parameters = with_directivities(parameters, directivity.unknown)
        parameters = _starting_at(parameters, answers[band].absorption)
        vector = start_vector(parameters)
        if directivity is not None:
            free = b.ravel() - directivity.unknown.mean
            vector[-b.size :] = np.linalg.solve(directivity.unknown.root, free)
        values, _ = physical_values(parameters, vector)
        fixed = fixed_paths(term, directivity, values["absorption"], b)
        out.append(_Band(band, fixed, parameters, vector, files))
        del own, term, directivity  # as large as the paths, before the next band has its own
        trim_memory()
    return out[::-1]


def _starting_at(parameters: Parameters, absorption: FloatArray) -> Parameters:
    block = absorption_of(parameters)
    margin = 1e-3 * (block.upper - block.lower)
    inside = np.clip(absorption, block.lower + margin, block.upper - margin)
    own = replace(block, start=np.where(block.fitted, inside, block.start))
    return Parameters(tuple(own if b.name == "absorption" else b for b in parameters.blocks))


class Located(NamedTuple):
    """The most likely offsets."""

    windows: _EarlyWindows
    shift_m: FloatArray  # (n_offsets,), from the specified scene
    sd_m: FloatArray  # (n_offsets,), the prior's where it was not asked for
    beyond: Displacement | None  # what is displaced farther than specified


def located(
    measured: Measurements,
    priors: tuple[MaterialPrior, ...],
    traced: TracedPaths,
    fits: BandFits,
    offsets: tuple[Offset, ...],
    moved_m: FloatArray,
) -> Located | None:
    """Return the most likely offsets of a fitted room, and what is farther off than specified.

    None where there is too little to go by. Shapes: `moved_m` (n_offsets,), by which the scene
    already differs from the specified one.
    """
    bands = _early_windows(measured, priors, traced, fits) if offsets else []
    if not bands:
        return None
    logl = _EarlyWindows(measured, traced, offsets, moved_m, bands)
    stated = [k for k, o in enumerate(offsets) if o.is_stated]
    sd_m = np.array([o.sd_m if o.is_stated else o.tolerance_m for o in offsets])

    def posterior(shift_m: FloatArray, roughly: bool = False) -> float:
        return logl(shift_m, roughly) - 0.5 * float(np.sum(((moved_m + shift_m) / sd_m) ** 2))

    at = np.zeros(len(offsets))
    for _ in range(1 + (len(offsets) if stated else 0)):
        logl.foresee(_about(at, sd_m))
        shift_m = _swept(posterior, at, sd_m)
        at = _stated_step(offsets, posterior, shift_m)
        if at is shift_m:
            break
    found_sd_m = np.array([o.sd_m for o in offsets])
    for k in (*stated, *stated):
        shift_m = _highest(posterior, shift_m, k, max(float(sd_m[k]), _LEAST_REACH_M))
    if stated:
        covariance = _covariance(posterior, shift_m, logl.unit[stated], sd_m[stated])
        found_sd_m[stated] = np.sqrt(np.diag(covariance))
    beyond = _implausible(logl, shift_m)
    if beyond is None:
        far_m = _farthest(logl, shift_m)
        beyond = None if far_m is None else _named(logl, shift_m, far_m)
    return Located(logl, moved_m + shift_m, found_sd_m, beyond)


def with_offsets(fits: BandFits, found: Located) -> BandFits:
    """Return fits with what is displaced, and with the offsets that were fitted in the geometry.

    With the covariance of what is left open of these offsets.
    """
    windows, offsets = found.windows, found.windows.offsets
    own = np.flatnonzero([o.is_stated for o in offsets])
    fits = replace(fits, displacement=found.beyond)
    if not own.size:
        return fits
    none = np.zeros(0)
    speed = speed_of_sound_m_s(windows.measured.scene.air)
    before = fits.geometry or FittedGeometry((), none, none, none, speed)
    geometry = replace(
        before,
        labels=(*before.labels, *(offsets[k].label for k in own)),
        change=np.concatenate((before.change, windows.moved_m[own])),
        sd=np.concatenate((before.sd, found.sd_m[own])),
        prior_sd=np.concatenate((before.prior_sd, [offsets[k].sd_m for k in own])),
        n_offsets=own.size,
    )
    added = {band: s @ s.T for band, s in _offset_steps(windows, np.diag(found.sd_m)[own]).items()}
    return replace(fits, geometry=geometry, added=added)


def _offset_steps(windows: _EarlyWindows, ways_m: FloatArray) -> dict[int, FloatArray]:
    """Return how far the logit absorption of a band moves by each way, (n_materials, n_ways).

    Half the difference of fits of the early windows moved to either side.
    """
    n = len(windows.measured.scene.room.materials)
    found = {own.band: np.zeros((n, len(ways_m))) for own in windows.bands}
    for number, way_m in enumerate(ways_m):
        is_possible = all(windows.is_possible(sign * way_m) for sign in (-1.0, 1.0))
        for sign in (-1.0, 1.0) if is_possible else ():
            for own, term in zip(windows.bands, windows.terms(sign * way_m), strict=True):
                fit = score_band(Objective(own.parameters, (term,)), own.start, max_rounds=12)
                values, _ = physical_values(own.parameters, fit.vector)
                found[own.band][:, number] += 0.5 * sign * logit(values["absorption"], 1e-9)
    return found


def _about(shift_m: FloatArray, sd_m: FloatArray) -> list[FloatArray]:
    """Return where a sweep looks first, one offset after the other."""
    each = zip(np.eye(shift_m.size), sd_m, strict=True)
    return [shift_m + t * min(s, _REACH_M) * w for w, s in each for t in _WITHIN_SD]


def _swept(logl: LogL, shift_m: FloatArray, sd_m: FloatArray) -> FloatArray:
    """Maximise the likelihood over one offset at a time, in order of decreasing gain.

    On a grid within its standard deviations, then along a parabola.
    """
    ways = np.eye(shift_m.size)
    first = [logl(s, True) for s in _about(shift_m, sd_m)]
    gains = np.reshape(first, (-1, len(_WITHIN_SD))).max(axis=1)
    at, best = np.array(shift_m), logl(shift_m)
    for k in [i for i in np.argsort(gains)[::-1] if gains[i] > best]:
        for trial in [at + t * min(sd_m[k], _REACH_M) * ways[k] for t in _WITHIN_SD]:
            if (found := logl(trial, True)) > best:
                at, best = trial, found
        trial = at + _parabola(logl, at, ways[k], best) * ways[k]
        at, best = (trial, value) if (value := logl(trial)) > best else (at, best)
    return at


def _highest(logl: LogL, shift_m: FloatArray, entry: int, reach_m: float) -> FloatArray:
    """Return offsets with one of them at its best within a reach; the top is sharp."""
    from scipy.optimize import minimize_scalar  # heavy, and rarely needed

    way = np.eye(shift_m.size)[entry]
    found = minimize_scalar(
        lambda d: -logl(shift_m + d * way),
        bounds=(-reach_m, reach_m),
        method="bounded",
        options={"xatol": _NEAR_M, "maxiter": 20},
    )
    at = shift_m + float(found.x) * way
    return at if logl(at) > logl(shift_m) else shift_m


def _parabola(logl: LogL, at: FloatArray, way: FloatArray, here: float) -> float:
    """Return how far the top of the parabola through three values lies along a way, in m."""
    ahead, behind = logl(at + _STEP_M * way), logl(at - _STEP_M * way)
    if not np.isfinite(ahead + behind):
        return 0.0
    curvature = 2.0 * here - ahead - behind
    slope = 0.5 * (ahead - behind)
    if curvature <= 0.0 or abs(slope) > curvature * _REACH_M / _STEP_M:
        return float(np.sign(slope) * _REACH_M)
    return float(_STEP_M * slope / curvature)


def _stated_step(offsets: Sequence[Offset], posterior: LogL, shift_m: FloatArray) -> FloatArray:
    """Return offsets with one that is stated a step of the grid away, where that is likelier."""
    trials = [
        shift_m + d * way
        for way, offset in zip(np.eye(shift_m.size), offsets, strict=True)
        for d in _GRID_M
        if offset.is_stated and abs(d) < 2.0 * LARGEST_SHIFT_SD * offset.sd_m
    ]
    values = [posterior(t, True) for t in trials]
    alternatives = [shift_m, *trials]
    likelier, _ = choose(alternatives, [posterior(shift_m), *values], 0.0, least_gain=0.5)
    return np.asarray(likelier)


def _farthest(logl: _EarlyWindows, shift_m: FloatArray) -> FloatArray | None:
    """Return where one offset is beyond what is specified and gains most, None where none gains.

    Over its axis as specified; less likely than what is within the specified, it is nowhere. What
    was to stay within the specified may have gone beyond it step by step: then that is far.
    """
    offsets, inside, best, at = logl.offsets, logl(shift_m), LEAST_GAIN, None
    axes = np.array([o.axis for o in offsets])
    starts_m = np.where(axes[:, None] == axes, -logl.moved_m, shift_m)
    trials = [
        (offset, start_m, d, start_m + d * way)
        for offset, start_m, way in zip(offsets, starts_m, logl.unit, strict=True)
        for d in _GRID_M
        if abs(d) > offset.plausible_m
    ]
    logl.foresee([trial for *_, trial in trials])
    for offset, start_m, d, trial in trials:
        found = logl(trial, True)
        gain = found - logl(start_m) + offset.log_prior(d)
        if found > inside and gain > best:
            best, at = gain, trial
    went = np.abs(logl.moved_m + shift_m) > [o.plausible_m for o in offsets]
    is_free = [not o.is_stated for o in offsets]
    return shift_m if at is None and np.any(went & is_free) else at


def _named(logl: _EarlyWindows, inside_m: FloatArray, far_m: FloatArray) -> Displacement | None:
    """Return the significant displacement after refinement, or None.

    All positions that move, a box that is longer, and a wall at the origin that stands elsewhere
    differ by which of two opposite walls is nearer or farther: the likeliest of them is named, its
    axis otherwise as specified.
    """
    offsets, scene = logl.offsets, logl.measured.scene
    axis = offsets[int(np.argmax(np.abs(far_m + logl.moved_m)))].axis
    along = [k for k, o in enumerate(offsets) if o.axis == axis]
    every = tuple(frozenset(p.name for p in points) for points in (scene.sources, scene.receivers))
    whole = [k for k in along if (offsets[k].sources, offsets[k].receivers) == every]
    lengths = [k for k in along if not offsets[k].group]
    start_m = np.array(inside_m)
    start_m[along] = -logl.moved_m[along]
    pair = [whole[0], lengths[0]] if whole and lengths else []
    ways = [(k, logl.unit[k]) for k in along]
    if pair:
        ways.append((-1, logl.unit[pair[0]] + logl.unit[pair[1]]))
    trials = [(logl(start_m + d * w, True), k, d, w) for k, w in ways for d in _GRID_M]
    value, k, size_m, way = max(trials, key=lambda t: t[0])
    if not np.isfinite(value):  # no single displacement keeps the high bands
        return None
    for _ in range(5):  # the top is narrower than the grid
        step_m = _parabola(logl, start_m + size_m * way, way, value)
        finer = logl(start_m + (size_m + step_m) * way)
        if finer <= value:
            break
        value, size_m = finer, size_m + step_m
    shift_m, gain = start_m + size_m * way, value - logl(start_m)
    offset = offsets[lengths[0] if k < 0 else k]
    is_far = abs(size_m) > offset.plausible_m
    if not is_far or gain + offset.log_prior(size_m) <= LEAST_GAIN:
        return None
    found = _displacement(logl, k, shift_m, way, float(size_m), gain, axis)
    if not pair:
        return found
    covariance = _covariance(logl, shift_m, logl.unit[pair], np.full(2, 10.0))
    ends = np.array([[1.0, 0.0], [-1.0, 1.0]])
    ends_m = ends @ (logl.moved_m + shift_m)[pair]
    deviations_m = np.sqrt(np.diag(ends @ covariance @ ends.T))
    each = zip(found.walls, ends_m.tolist(), deviations_m.tolist(), strict=True)
    farther_m = {w: (round(x, 3), round(s, 3)) for w, x, s in each if s < WORTH_TELLING_M}
    return replace(found, farther_m=farther_m)


def _implausible(logl: _EarlyWindows, shift_m: FloatArray) -> Displacement | None:
    """Return the stated offset that had to move farthest beyond what is plausible."""
    total_m = logl.moved_m + shift_m
    limits_m = [o.plausible_m if o.is_stated else np.inf for o in logl.offsets]
    k = int(np.argmax(np.abs(total_m) / limits_m))
    way, size_m = logl.unit[k], float(total_m[k])
    if abs(size_m) <= limits_m[k]:
        return None
    gain = logl(shift_m) - logl(shift_m - size_m * way)
    if gain <= LEAST_GAIN:
        return None
    return _displacement(logl, k, shift_m, way, size_m, gain, logl.offsets[k].axis)


def _displacement(
    logl: _EarlyWindows,
    k: int,
    at: FloatArray,
    way: FloatArray,
    size_m: float,
    gain: float,
    axis: int,
) -> Displacement:
    """Return what stands elsewhere: an offset by its index, or the wall at the origin, -1."""
    sd_m = float(np.sqrt(_covariance(logl, at, way[None], np.full(1, 10.0))[0, 0]))
    walls = _walls(logl.measured.scene.room, axis)
    if k < 0:
        none = frozenset[str]()
        return Displacement("wall", none, axis, size_m, sd_m, LENGTH_SD_M, gain, walls, None)
    own = logl.offsets[k]
    kind, points = own.group or "length", own.sources | own.receivers
    return Displacement(kind, points, axis, size_m, sd_m, own.sd_m, gain, walls, None)


def _walls(room: Room, axis: int) -> tuple[str, ...]:
    """Return the names of a box's walls at both ends of an axis; none of another room."""
    names = []
    for i in (2 * axis, 2 * axis + 1) if room.shoebox_m is not None else ():
        surface, material = room.mesh.surfaces[i].name, room.surface_material[i]
        is_alone = np.count_nonzero(room.surface_material == material) == 1
        known = room.materials[material]
        names.append(f"{surface} ({known})" if is_alone and known != surface else surface)
    return tuple(names)


def _covariance(logl: LogL, at: FloatArray, ways: FloatArray, prior_sd_m: FloatArray) -> FloatArray:
    """Return the covariance along some ways, all else fixed, by second differences."""
    h, n = _APART_M, len(ways)
    ways = h * ways
    here = logl(at)
    ahead, behind = [logl(at + w) for w in ways], [logl(at - w) for w in ways]
    hessian = np.zeros((n, n))
    for i in range(n):
        hessian[i, i] = (2.0 * here - ahead[i] - behind[i]) / h**2
        for j in range(i):
            cross = logl(at + ways[i] + ways[j]) - ahead[i] - ahead[j] + here
            hessian[i, j] = hessian[j, i] = -cross / h**2
    hessian = np.where(np.isfinite(hessian), hessian, 0.0)
    # rough as it is, a likelihood cannot know less than the prior
    scale = np.outer(prior_sd_m, prior_sd_m)
    values, vectors = np.linalg.eigh(hessian * scale)
    return np.asarray(scale * ((vectors / np.maximum(values, 1.0)) @ vectors.T))
