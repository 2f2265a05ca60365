"""Where to measure, so that the intervals of the absorption become as narrow as they can."""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from roomfit.base.air import speed_of_sound_m_s
from roomfit.base.bands import Bands, bands_between
from roomfit.base.errors import InputError
from roomfit.base.findings import About, Code, Finding
from roomfit.base.kernels import one_blas_thread
from roomfit.base.table import Shown
from roomfit.base.typing import BoolArray, FloatArray, IntArray, Progress, part
from roomfit.design.candidates import DesignOptions, design_candidates
from roomfit.design.choose import (
    Choice,
    Criterion,
    choose,
    information_of,
    material_widths,
    possible_design,
    random_design,
)
from roomfit.design.expected import information_of_candidates
from roomfit.design.prior import PriorInformation, information_from_fit, information_from_priors
from roomfit.fit.symmetry import mirror_planes
from roomfit.fit.traced_room import scene_decay_s
from roomfit.materials.priors import MaterialPrior, complete_priors, object_area_m2
from roomfit.model.patterns import Directivities
from roomfit.result import result_doubts
from roomfit.room.mesh import volume_m3
from roomfit.room.scene import Scene, select_pairs, wall_materials
from roomfit.settings import Settings
from roomfit.uncertainty.posterior import AbsorptionPosterior

_LOG = logging.getLogger("roomfit")
_NUMBER, _NUMBER_AFTER_FIT = 6, 1  # pairs that are chosen where nothing else is asked for


@dataclass(frozen=True, slots=True, eq=False)
class Design(Shown):
    """Where to measure."""

    described_in: ClassVar[str] = "designed"
    drawn: ClassVar[str] = "design_map"
    scene: Scene  # measured pairs, then candidates
    n_fixed: int  # how many of its pairs have been measured and count
    chosen: IntArray  # (n_chosen,), pairs to measure, the most informative first
    bands: Bands
    materials: tuple[str, ...]
    to_find: BoolArray  # (n_materials,), False where the absorption is known
    # (n_chosen + 1, n_materials, n_bands), expected width of the 95 % interval of every absorption
    # before, and after each of the chosen pairs; 0 where it is known. The mean over draws of the
    # absorption. Of an object, which stands behind the walls, of its absorption area in m2.
    widths: FloatArray
    # (n_random, n_chosen + 1), mean width of random designs under the same rules, over what is
    # compared; NaN where one ended early
    random_means: FloatArray
    criterion: Criterion
    absorption: FloatArray  # (n_materials, n_bands), the middle of the prior; of an object in m2
    n_draws: int
    after_fit: bool  # whether the widths before are those of a finished fit
    source_distance_m: float  # this and the next two: the rules that were obeyed
    receiver_distance_m: float
    wall_distance_m: float
    findings: tuple[Finding, ...]
    seed: int
    seconds: float

    @property
    def compared(self) -> BoolArray:
        """Which materials mean widths are of: unknown walls, or objects where no wall is unknown.

        Shape (n_materials,).
        """
        return _compared(self.scene, self.to_find)

    def to_dataframe(self) -> Any:
        """Return a pandas data frame of one row a chosen pair, as design.csv.

        Without pandas, on which roomfit does not depend, an `InputError` says what to install.
        """
        from roomfit.base.table import data_frame
        from roomfit.design.output import design_records

        return data_frame(design_records(self), "design.csv")


@one_blas_thread
def design(
    scene: Scene,
    materials: Sequence[MaterialPrior] = (),
    bands: Bands | None = None,
    *,
    absorption: AbsorptionPosterior | None = None,
    directivities: Directivities | None = None,
    options: DesignOptions | None = None,
    settings: Settings | None = None,
    progress: Progress | None = None,
) -> Design:
    """Choose the pairs of source and receiver with most information on the absorption.

    The room is traced once for all candidates. Their Fisher information comes from energies and
    the noise model of the fit, at several draws of the absorption; gains are unknown as they are
    in a fit. Measured pairs count, by the same model; or the covariance of a finished fit does.

    Parameters
    ----------
    scene : Scene
        Room and air, sources and receivers that exist, and the pairs that have been measured and
        are fitted; there need be none.
    materials : sequence of MaterialPrior, optional
        In these bands; the broad prior for those that are left out.
    bands : Bands, optional
        To be fitted. Left out: those of `absorption`, or octaves from 125 Hz to 4 kHz.
    absorption : AbsorptionPosterior, optional
        A finished fit, of exactly the room's materials in their order and of these bands. Where
        its reduced chi-square is above 1, new measurements inform less by that factor.
    directivities : mapping from source to directivity, optional
    options : DesignOptions, optional
    settings : Settings, optional
        Of the fit to come.

    Raises
    ------
    InputError
        The rules leave no candidate or too few, a listed position is in a wall or outside, or
        materials or bands disagree.

    Notes
    -----
    Distances from walls, sources and each other follow ISO 3382-2:2008, 4.3.3 where nothing else is
    asked for; the choice is that of V. V. Fedorov, see `roomfit.design.choose`.

    Examples
    --------
    In a room of which nothing is known:

    >>> import roomfit
    >>> room = roomfit.shoebox_room((6.0, 5.0, 3.0), "plaster")
    >>> scene = roomfit.scene_of(room, {"S": (1.5, 1.2, 1.5)}, {"R": (4.0, 3.5, 1.2)})
    >>> octave, few = roomfit.bands_between("octave", 1000, 1000), roomfit.Settings(n_rays=500)
    >>> options = roomfit.DesignOptions(number=2, n_candidates=10, n_draws=1)
    >>> plan = roomfit.design(scene, bands=octave, options=options, settings=few)
    >>> len(plan.chosen)
    2

    ``roomfit.design(**roomfit.design_arguments(campaign))`` is what the command line does.
    """
    began = time.perf_counter()
    options = DesignOptions() if options is None else options
    settings = Settings() if settings is None else settings
    after_fit = absorption is not None
    known, of_fit = _prior_information(scene, materials, bands, absorption, options, settings)
    distance_m = _source_distance_m(scene, options, known)
    candidates, rules, few = design_candidates(
        scene, options, distance_m, settings.seed, count_measured=not after_fit
    )
    n = options.number or (_NUMBER_AFTER_FIT if after_fit else _NUMBER)
    possible_design(rules, n)  # before all is computed
    _LOG.info("evaluating %d candidates", len(candidates.pairs) - len(rules.fixed))
    pairs, doubts = information_of_candidates(
        candidates, known, options, settings, directivities or {}, part(progress, 0.0, 0.95)
    )
    if absorption is not None and absorption.chi2_reduced is not None:
        inflation = np.maximum(absorption.chi2_reduced, 1.0)[:, None, None]
        pairs = pairs._replace(matrices=pairs.matrices / inflation)
    criterion = options.criterion or ("worst" if after_fit else "determinant")
    _LOG.info("choosing")
    rng = np.random.default_rng(settings.seed)
    choice = Choice(known.unknowns, pairs, rules, criterion)
    chosen = choose(choice, n, rng=rng)
    # after a fit one more pair stands beside others, whose positions are not known here
    used = np.array([] if after_fit else [*rules.fixed, *chosen], dtype=np.int64)
    doubts = (*doubts, *plane_findings(select_pairs(candidates, used)))
    areas_m2, middle = _in_m2(scene, known.typical), known.typical
    return Design(
        scene=candidates,
        n_fixed=len(rules.fixed),
        chosen=np.array(chosen),
        bands=known.bands,
        materials=scene.room.materials,
        to_find=known.unknowns.number >= 0,
        widths=_widths(scene, known, choice, chosen),
        random_means=_random_means(scene, known, choice, n, options.n_random, settings.seed),
        criterion=criterion,
        absorption=np.vstack((middle[: len(middle) - len(areas_m2)], areas_m2)),
        n_draws=len(known.draws),
        after_fit=after_fit,
        source_distance_m=distance_m,
        receiver_distance_m=options.receiver_distance_m,
        wall_distance_m=options.wall_distance_m,
        findings=(*scene.room.findings, *of_fit, *few, *doubts),
        seed=settings.seed,
        seconds=time.perf_counter() - began,
    )


def _prior_information(
    scene: Scene,
    materials: Sequence[MaterialPrior],
    bands: Bands | None,
    absorption: AbsorptionPosterior | None,
    options: DesignOptions,
    settings: Settings,
) -> tuple[PriorInformation, tuple[Finding, ...]]:
    """Return what is known before the measurements to be chosen, and what is doubtful of it."""
    names = scene.room.materials
    if absorption is None:
        bands = bands_between("octave", 125.0, 4000.0) if bands is None else bands
        priors = complete_priors(names, materials, bands)
        rng = np.random.default_rng(settings.seed)
        return information_from_priors(priors, bands, options.n_draws, rng), ()
    absorption.check_materials(names)
    own = absorption.bands
    if bands is not None and not np.array_equal(bands.centres_hz, own.centres_hz):
        what, hint = "the absorption is of other bands", "use a result of these bands"
        found, needed = (str(of.centres_hz.tolist()) for of in (own, bands))
        raise InputError(what, found=found, needed=needed, hint=hint)
    doubts = result_doubts(absorption, scene.room.findings, "design") + absorption.findings
    return information_from_fit(complete_priors(names, materials, own), absorption), doubts


def _source_distance_m(scene: Scene, options: DesignOptions, known: PriorInformation) -> float:
    """Return the least distance of a receiver from its source, where unspecified 2 sqrt(V / (c T)).

    ISO 3382-1:2009, 4.3.2 and ISO 3382-2:2008, 4.3.3: nearer, direct sound is too strong.
    """
    if options.source_distance_m is not None:
        return options.source_distance_m
    decay_s = float(np.median(scene_decay_s(scene, known.bands, known.typical)))
    volume, speed = volume_m3(scene.room.mesh), speed_of_sound_m_s(scene.air)
    return float(2.0 * np.sqrt(volume / (speed * decay_s)))


def _compared(scene: Scene, to_find: BoolArray) -> BoolArray:
    """Return of which materials widths are averaged: of walls in absorption, objects are in m2."""
    walls = to_find & (np.arange(to_find.size) < len(wall_materials(scene.room)))
    return walls if walls.any() else to_find


def _in_m2(scene: Scene, shares: FloatArray) -> FloatArray:
    """Return the absorption areas of objects in m2, (n_objects, n_bands), of the shares of all.

    A fit knows an object by the share of energy that it takes from sound on a short way.
    """
    objects = shares[len(wall_materials(scene.room)) :]
    return np.asarray(object_area_m2(objects, volume_m3(scene.room.mesh)))


def _widths(
    scene: Scene, known: PriorInformation, choice: Choice, chosen: tuple[int, ...]
) -> FloatArray:
    """Return the widths before and after each of the chosen, (n + 1, n_materials, n_bands).

    Of objects those of their areas in m2.
    """
    middle, found = known.typical, []
    for i in range(len(chosen) + 1):
        made = [*choice.rules.fixed, *chosen[:i]]
        widths = material_widths(known.unknowns, information_of(known.unknowns, choice.pairs, made))
        half = 0.5 * np.minimum(widths, 2.0 * (1.0 - middle) - 1e-9)
        areas_m2 = _in_m2(scene, middle + half) - _in_m2(scene, middle - half)
        found.append(np.vstack((widths[: len(widths) - len(areas_m2)], areas_m2)))
    return np.stack(found)


def _random_means(
    scene: Scene, known: PriorInformation, choice: Choice, n: int, n_random: int, seed: int
) -> FloatArray:
    """Return mean widths of random designs, (n_random, n + 1), NaN where one ends early."""
    rng, out = np.random.default_rng(seed), np.full((n_random, n + 1), np.nan)
    compared = _compared(scene, known.unknowns.number >= 0)
    for row in out:
        drawn = random_design(choice.rules, n, rng)
        widths = _widths(scene, known, choice, drawn)
        row[: len(drawn) + 1] = widths[:, compared].mean(axis=(1, 2))
    return out


def plane_findings(scene: Scene) -> tuple[Finding, ...]:
    """Return a finding for each plane of symmetry on which all pairs of a scene stand.

    Of planes that exchange different materials; whose absorption is then hardly determined.
    """
    findings = []
    for symmetry, normal in mirror_planes(scene):
        walls = np.flatnonzero(symmetry.exchange != np.arange(symmetry.exchange.size))
        exchanged = [scene.room.materials[i] for i in walls]
        offset_m = float(normal @ symmetry.centre_m)
        parts = zip(normal, "xyz", strict=True)
        axis = " ".join(x if c > 0.999 else f"{c:+.2f} {x}" for c, x in parts if abs(c) > 0.01)
        used = [
            sorted({points[i].name for i in np.unique(column)})
            for points, column in zip((scene.sources, scene.receivers), scene.pairs.T, strict=True)
        ]
        names = used[0] if len(used[0]) < len(used[1]) else used[1]
        findings.append(
            Finding(
                Code.ON_SYMMETRY_PLANE,
                About(materials=exchanged),
                f"Every pair of source and receiver stands on the plane of symmetry "
                f"{axis} = {offset_m:.2f} m: reflections off {' and '.join(exchanged)} arrive "
                f"together there, and hardly tell them apart. Move {', '.join(names)} off the "
                "plane, the farther the better.",
                {"normal": normal.tolist(), "offset_m": offset_m, "move": names},
            )
        )
    return tuple(findings)
