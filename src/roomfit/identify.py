"""The absorption of a measured room: the whole way from measurements to a result."""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from roomfit.base.bands import Bands, bands_between
from roomfit.base.errors import InputError, InsufficientDataError
from roomfit.base.findings import About, Code, Finding
from roomfit.base.forks import counted_evaluations, in_this_process
from roomfit.base.kernels import one_blas_thread
from roomfit.base.typing import Progress, part
from roomfit.checks.evidence import Evidence, Recorded
from roomfit.checks.examine import (
    AFTER_THE_FIT,
    BEFORE_THE_FIT,
    examine,
    eyring_start,
    fitted_evidence,
    recorded,
    with_causes,
)
from roomfit.checks.verdict import judge
from roomfit.fit.bands import estimate_energies
from roomfit.fit.displacement import displaced, located, offsets_of, with_offsets
from roomfit.fit.fits import BandFits
from roomfit.fit.measurements import Measurements
from roomfit.fit.paths import TracedPaths, redirected, traced_paths, traced_with, trim_memory
from roomfit.fit.symmetry import mirror_symmetries
from roomfit.materials.priors import (
    MaterialPrior,
    are_specified,
    complete_priors,
    object_volumes_m3,
    prior_logit_law,
)
from roomfit.model.patterns import Directivities
from roomfit.result import Result, object_areas, room_means
from roomfit.room.mesh import volume_m3
from roomfit.room.scene import (
    Scene,
    check_groups,
    material_areas_m2,
    scene_of,
    shoebox_room,
    wall_materials,
)
from roomfit.settings import LEAST_SQUARES_METHODS, Settings
from roomfit.signals.iso3382 import MeasuredValues
from roomfit.signals.measurement import Measurement
from roomfit.uncertainty import intervals
from roomfit.uncertainty.combinations import Determined, determined, inseparable_findings

_LOG = logging.getLogger("roomfit")


@one_blas_thread
def identify(
    scene: Scene,
    measurements: Sequence[Measurement | MeasuredValues],
    materials: Sequence[MaterialPrior] = (),
    bands: Bands | None = None,
    *,
    settings: Settings | None = None,
    directivities: Directivities | None = None,
    progress: Progress | None = None,
) -> Result:
    """Return the absorption of every material of a measured room (docs/how-it-works.md).

    Parameters
    ----------
    scene : Scene
        Room, sources, receivers and air; which of its pairs were measured, the measurements say.
    measurements : sequence of Measurement or MeasuredValues
        Impulse responses, ISO 3382-1 values, or both.
    materials : sequence of MaterialPrior, optional
        What is known before, in these bands; others have the broad `roomfit.material_prior`.
    bands : Bands, optional
        Octaves from 125 Hz to 4 kHz where left out.
    settings : Settings, optional
    directivities : mapping from source to directivity, optional
        Of sources that are not omnidirectional; an `UnknownDirectivity` is fitted.
    progress : callable, optional
        Called with the share of the work that is done, 0 to 1.

    Raises
    ------
    InputError
        A name, position, response or prior is not as needed, or does not go with the method.
    InsufficientDataError
        The data cannot be fitted at all.

    Examples
    --------
    A plastered box whose reverberation time was measured, and nothing else.

    >>> import roomfit
    >>> room = roomfit.shoebox_room((6.0, 5.0, 3.0), "plaster")
    >>> scene = roomfit.scene_of(room, {"S": (1.5, 1.2, 1.5)}, {"R": (4.0, 3.5, 1.2)})
    >>> measured = roomfit.MeasuredValues("S", "R", [1000.0], {"T20_s": [0.8]})
    >>> octave, few = roomfit.bands_between("octave", 1000, 1000), roomfit.Settings(n_rays=2000)
    >>> result = roomfit.identify(scene, [measured], bands=octave, settings=few)
    >>> bool(0.1 < result.absorption[0, 0] < 0.25)
    True
    """
    began, progress = time.perf_counter(), in_this_process(progress)
    bands = bands_between("octave", 125.0, 4000.0) if bands is None else bands
    settings = Settings() if settings is None else settings
    names = [p.name for p in (*scene.sources, *scene.receivers)]
    check_groups({g.name: g.members for g in scene.groups}, names)
    _LOG.info("evaluating the measurements")
    given = recorded(scene, measurements, bands, directivities or {}, settings.decay_range_db)
    before = examine(BEFORE_THE_FIT, given)
    _warn_first(before)
    priors = complete_priors(scene.room.materials, materials, bands)
    _check_objects(scene, priors)
    with counted_evaluations() as made:
        try:
            observed, traced, fits = _fitted_where_it_stands(
                given, measurements, priors, settings, progress
            )
        except InsufficientDataError as error:
            raise with_causes(error, (f for f in before if f.severity == "serious")) from error
    if observed is not given:  # fitted at other positions than specified
        before = examine(BEFORE_THE_FIT, observed)
    if all(answer.model == "prior" for answer in fits.answers):
        raise InsufficientDataError(
            "no band has enough windows above the noise",
            needed="in some band, more windows than unknown absorptions and gains",
            hint="choose other bands with from_hz and to_hz, or measure with less noise",
        )
    _LOG.info("predicting the measured pairs")
    trim_memory()
    evidence = fitted_evidence(observed, priors, traced, fits, settings)
    after = examine(AFTER_THE_FIT, evidence)
    doubts = (*_first_answer(settings), *scene.room.findings, *before, *after)
    result = combine(evidence, doubts)
    return replace(result, evaluations=made[0], seconds=time.perf_counter() - began)


def _check_objects(scene: Scene, priors: tuple[MaterialPrior, ...]) -> None:
    """Refuse objects of which nothing is stated, or for a room of another volume."""
    volumes, volume = object_volumes_m3(priors), volume_m3(scene.room.mesh)
    for name in (k.name for k in priors):
        is_object = name in scene.room.materials[len(wall_materials(scene.room)) :]
        stated = volumes.get(name, np.nan)
        if is_object != (name in volumes) or (is_object and abs(stated / volume - 1.0) > 1e-6):
            raise InputError(
                "an object of the room and its absorption area do not belong together",
                where=f"objects.{name}",
                found=f"stated for {stated:g} m3" if name in volumes else "no area of it",
                needed=f"an area for {volume:g} m3 and the object in the room",
                hint="pass object_prior of materials.priors, and with_objects of the room",
            )


def _fitted(
    measured: Measurements,
    priors: tuple[MaterialPrior, ...],
    settings: Settings,
    progress: Progress | None,
) -> tuple[TracedPaths, BandFits]:
    """Return the room traced and the fits of all bands, by pressures where these explain more."""
    start, refine = eyring_start(measured), _refinement(measured, priors, settings)
    if settings.model != "energy":
        from roomfit.pressures.choice import fit_by_pressures  # kernels of its own

        found = fit_by_pressures(measured, priors, start, settings, refine, progress)
        if found is not None:
            return found
    traced = traced_paths(measured, priors, settings, start, part(progress, 0.0, 0.45))
    _LOG.info("fitting energies")
    late = part(progress, 0.45, 1.0)
    return traced, estimate_energies(measured, priors, traced, start, settings, refine, late)


def _fitted_where_it_stands(
    given: Recorded,
    measurements: Sequence[Measurement | MeasuredValues],
    priors: tuple[MaterialPrior, ...],
    settings: Settings,
    progress: Progress | None,
) -> tuple[Recorded, TracedPaths, BandFits]:
    """Return the room as it was fitted, with what is displaced in it and errors of all bands.

    Where offsets are stated, the room is traced and fitted again at the most likely ones.
    """
    observed, measured = given, given.measured
    middle = 0.49 if measured.scene.groups else 0.98
    traced, fits = _fitted(measured, priors, settings, part(progress, 0.02, middle))
    # the paper's searches take positions as specified
    if not settings.quick and settings.method in LEAST_SQUARES_METHODS:
        _LOG.info("examining positions and lengths")
        trim_memory()
        offsets = offsets_of(measured.scene)
        is_stated = np.array([o.is_stated for o in offsets], dtype=np.bool_)
        found = located(measured, priors, traced, fits, offsets, np.zeros(len(offsets)))
        if is_stated.any() and found is not None:
            moved_m = np.where(is_stated, found.shift_m, 0.0)
            scene = displaced(measured.scene, offsets, moved_m)
            range_db, patterns = settings.decay_range_db, measured.directivities
            observed = recorded(scene, measurements, measured.bands, patterns, range_db)
            measured = observed.measured
            traced, fits = _fitted(measured, priors, settings, part(progress, middle, 0.98))
            found = located(measured, priors, traced, fits, offsets, moved_m)
        fits = fits if found is None else with_offsets(fits, found)
    trim_memory()
    if fits.directivities:
        traced = redirected(measured, traced, fits.directivities)
    answers = intervals.with_errors_of_all_bands(
        fits.answers, material_areas_m2(given.measured.scene.room), fits.added
    )
    return observed, traced, replace(fits, answers=answers)


def _warn_first(findings: Sequence[Finding]) -> None:
    """Log what voids the answer already, before the minutes that a fit may last."""
    serious = [f for f in findings if f.code.voids_identifiability]
    for finding in serious:
        _LOG.warning("%s: %s", finding.severity, finding.sentence)
    if serious:
        _LOG.warning(
            "the fit goes on, but will call no material identifiable: to set this right first, "
            "stop it with Ctrl-C"
        )


def _first_answer(settings: Settings) -> tuple[Finding, ...]:
    if not settings.quick:
        return ()
    text = (
        "A first answer: intervals are Gaussian, and neither misplaced positions nor a fault of "
        "the chain, nor another scattering than specified, was looked for. Identify without quick "
        "before relying on it."
    )
    return (Finding(Code.FIRST_ANSWER, About(), text),)


def combine(evidence: Evidence, doubts: Sequence[Finding]) -> Result:
    """Return the result of all bands together."""
    measured, priors, fits = evidence.measured, evidence.priors, evidence.fits
    scene, settings, covariance = measured.scene, evidence.settings, evidence.logit_covariance
    walls = wall_materials(scene.room)
    n, specified, (mean, law) = len(walls), are_specified(priors), prior_logit_law(priors)

    def of_groups(state: int) -> tuple[Determined, ...]:
        """Return what the data determine of groups of walls in a state of the room."""
        areas_m2, prior = material_areas_m2(scene.room, state)[:n], (mean[:n], law[:, :n, :n])
        own = evidence.absorption[:n], covariance[:, :n, :n], prior, areas_m2
        chi2 = np.array([a.chi2_reduced for a in fits.answers])
        return determined(walls, *own, settings.seed, specified[:n], chi2)

    by_rule = intervals.identifiable_by_rule(fits.answers, priors)
    identifiable, groups = judge(by_rule, doubts, priors, measured.bands), of_groups(0)
    if not any(f.code.voids_identifiability for f in doubts):
        known = identifiable[:n], [d.combinations for d in groups]
        doubts = (*doubts, *inseparable_findings(walls, measured.bands.centres_hz, *known))
    states = enumerate(scene.room.states, start=1)
    return Result(
        scene=scene,
        bands=measured.bands,
        priors=priors,
        estimates=intervals.with_draws(
            fits.answers, priors, covariance, settings.n_draws, settings.seed
        ),
        determined=groups,
        identifiable=identifiable[:n],
        identifiable_by_rule=by_rule[:n],
        pairs=evidence.pairs,
        findings=tuple(doubts),
        settings=settings,
        objects=object_areas(priors, fits.answers, identifiable),
        by_pressures=evidence.by_pressures,
        scattering=evidence.traced.scattering,
        geometry=fits.geometry,
        directivities=fits.directivities,
        trace=traced_with(evidence.traced),
        state_means={state.name: room_means(of_groups(i)) for i, state in states},
        eyring_absorption=eyring_start(measured),
    )


def _refinement(
    measured: Measurements, priors: tuple[MaterialPrior, ...], settings: Settings
) -> intervals.Refinement:
    """Return what is done to every band after its fit; the paper's searches end where they end."""
    return intervals.Refinement(
        not settings.quick and settings.method in LEAST_SQUARES_METHODS,
        settings.seed,
        tuple(s.exchange for s in mirror_symmetries(measured, priors)),
        settings.n_draws,
    )


def compile_kernels() -> None:
    """Identify a small box, so that the compiled kernels lie on this machine's disk."""
    rng, rate_hz = np.random.default_rng(1), 16000.0
    pressure = rng.standard_normal(12000) * np.exp(-np.arange(12000) / 2000.0)
    pressure[:200] = 0.0
    scene = scene_of(
        shoebox_room((6.0, 5.0, 3.0), "walls"), {"S": (1.5, 1.2, 1.5)}, {"R": (4.0, 3.5, 1.2)}
    )
    identify(
        scene,
        [Measurement("S", "R", pressure, rate_hz)],
        bands=bands_between("octave", 1000, 1000),
        settings=Settings(n_rays=2000),
    )
