"""The absorption of a measured room: the whole way from measurements to a result."""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from roomfit._numba import one_blas_thread
from roomfit.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.bands import Bands, bands_between
from roomfit.cache import Cache
from roomfit.eyring import eyring_absorption
from roomfit.findings import About, Code, Finding
from roomfit.geometry.mesh import surface_area_m2, volume_m3
from roomfit.inversion.bands import starts_findings
from roomfit.inversion.chain import gate_findings, tail_findings
from roomfit.inversion.coherent import fit_coherent
from roomfit.inversion.compare import compare_all
from roomfit.inversion.directivity import directivity_parameters
from roomfit.inversion.displacement import (
    Offset,
    Outline,
    displaced,
    located,
    offsets_of,
    outline_of,
    with_offsets,
)
from roomfit.inversion.measurements import Measurements, collect_measurements, median_decay_s
from roomfit.inversion.model_checks import (
    certain_misses,
    check_certifiable,
    decay_findings,
    decay_misses,
    decays_by_scattering,
    description_findings,
    fit_findings,
    interval_words,
    method_chosen,
    prior_findings,
    prior_intervals,
    reasons,
    sampling_findings,
    schroeder_findings,
)
from roomfit.inversion.paths import TracedPaths, redirected, traced_paths, traced_with, trim_memory
from roomfit.inversion.reflections import (
    isolated_reflections,
    reflection_findings,
    wall_returns,
)
from roomfit.inversion.solve import (
    BandFits,
    coherent_answers,
    coherent_task,
    estimate_energies,
)
from roomfit.inversion.symmetry import mirror_findings, mirror_symmetries
from roomfit.inversion.trace_plan import is_coherent
from roomfit.materials.catalogue import broad_prior_findings, product_findings
from roomfit.materials.priors import (
    MaterialPrior,
    are_specified,
    complete_priors,
    prior_logit_law,
    prior_logits,
)
from roomfit.measurement import Measurement
from roomfit.objective.observation import (
    left_out_findings,
    prior_only_band_findings,
    unspecified_position_findings,
)
from roomfit.objective.problem import counted_evaluations
from roomfit.response.directivity import Directivities
from roomfit.results import Result
from roomfit.scene import (
    Scene,
    check_groups,
    material_areas_m2,
    plan_in_words,
    scene_of,
    shoebox_room,
)
from roomfit.settings import LEAST_SQUARES_METHODS, Settings
from roomfit.signals.iso3382 import MeasuredValues
from roomfit.solvers.certificate import certificate_findings
from roomfit.typing import FloatArray, Progress, part
from roomfit.uncertainty.combinations import Combination, determined, inseparable_findings
from roomfit.uncertainty.gaussian import BandEstimate, prior_absorptions
from roomfit.uncertainty.intervals import Refinement
from roomfit.uncertainty.posterior import band_draws, plain_logit_covariance
from roomfit.uncertainty.sampling import check_sampler
from roomfit.uncertainty.smoothing import smoothed

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
    cache: Cache | None = None,
    progress: Progress | None = None,
) -> Result:
    """Return the absorption of every material of a measured room in every band.

    Traces the room once, fits every band, finds 95 % confidence intervals, and predicts every
    measured pair.

    Parameters
    ----------
    scene : Scene
        Room, sources, receivers and air; which of its pairs were measured, the measurements say.
    measurements : sequence of Measurement or MeasuredValues
        Impulse responses, ISO 3382-1 values, or both.
    materials : sequence of MaterialPrior, optional
        What is known of materials before the measurement, in these bands; a material of the room
        that is not among them has the broad prior (`roomfit.material_prior`).
    bands : Bands, optional
        Octaves from 125 Hz to 4 kHz where left out.
    settings : Settings, optional
    directivities : mapping from source to directivity, optional
        Of sources that are not omnidirectional; an `UnknownDirectivity` is fitted.
    cache : Cache, optional
        Where a trace is kept, and found again by a run that was stopped.
    progress : callable, optional
        Called with the share of the work that is done, 0 to 1.

    Raises
    ------
    InputError
        A name, a position, a response or a prior is not as needed, or the method does not go with
        the data.
    CannotTell
        The data cannot be fitted at all.

    Notes
    -----
    The model is that of docs/how-it-works.md; its references stand with each part.

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
    began = time.perf_counter()
    bands = bands_between("octave", 125.0, 4000.0) if bands is None else bands
    settings = Settings() if settings is None else settings
    names = [p.name for p in (*scene.sources, *scene.receivers)]
    check_groups({g.name: g.members for g in scene.groups}, names)
    _LOG.info("evaluating the measurements")
    measured = collect_measurements(
        scene, measurements, bands, directivities or {}, settings.decay_range_db
    )
    _warn_first(measured.findings)
    if settings.method == "posterior":
        check_sampler()
    priors = complete_priors(scene.room.materials, materials, bands)
    check_certifiable(measured, settings, priors)
    offsets = offsets_of(measured.scene)
    is_stated = np.array([o.is_stated for o in offsets], dtype=np.bool_)
    moved_m = np.zeros(len(offsets))
    # where offsets are stated, the room is traced and fitted again at the most likely ones
    rounds = 2 if is_stated.any() and not settings.quick else 1
    with counted_evaluations() as made:
        for number in range(rounds):
            done = part(progress, number / rounds, (number + 1) / rounds)
            start = _eyring_start(measured)
            traced = traced_paths(measured, priors, settings, start, cache, part(done, 0.02, 0.45))
            pressures = is_coherent(measured.responses, settings) and (
                traced.far_images or settings.model == "coherent"
            )
            refine = _refinement(measured, priors, settings)
            _LOG.info("fitting %s", "pressures and energies" if pressures else "energies")
            if pressures:
                task = coherent_task(measured, priors, traced, start, settings)
                coherent = fit_coherent(task, traced, part(done, 0.45, 0.85))
                _LOG.info("finding confidence intervals")
                fits = coherent_answers(coherent, settings, refine, part(done, 0.85, 0.98))
                del task, coherent  # with all bands, the most that is in memory
                trim_memory()
            else:
                late = part(done, 0.45, 0.98)
                fits = estimate_energies(measured, priors, traced, start, settings, refine, late)
            _LOG.info("examining positions and lengths")
            outline = _outline(measured, priors, (traced, fits), settings, offsets, moved_m)
            if outline is None:
                break
            if number + 1 < rounds:
                moved_m = np.where(is_stated, located(outline).shift_m, 0.0)
                moved = displaced(measured.scene, offsets, moved_m)
                measured = collect_measurements(
                    moved, measurements, bands, directivities or {}, settings.decay_range_db
                )
            else:
                fits = with_offsets(fits, outline, located(outline))
    if fits.directivities:
        traced = redirected(measured, traced, fits.directivities)
    estimates = fits.answers
    if settings.smoothness_per_octave is not None:
        areas_m2 = material_areas_m2(scene.room)
        estimates = smoothed(
            estimates, priors, bands, settings.smoothness_per_octave, areas_m2=areas_m2
        )
    fits = replace(fits, answers=estimates)
    _LOG.info("predicting the measured pairs")
    trim_memory()
    findings = (*_quick_findings(settings), *_findings(measured, priors, traced, fits))
    result = combine(measured, priors, traced, fits, findings, settings)
    return replace(result, evaluations=made[0], seconds=time.perf_counter() - began)


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


def _outline(
    measured: Measurements,
    priors: tuple[MaterialPrior, ...],
    fitted: tuple[TracedPaths, BandFits],
    settings: Settings,
    offsets: tuple[Offset, ...],
    moved_m: FloatArray,
) -> Outline | None:
    """Return the fitted room to be displaced; the paper's searches take positions as specified."""
    traced, fits = fitted
    if settings.quick or settings.method not in LEAST_SQUARES_METHODS:
        return None
    sources = directivity_parameters(measured, settings), fits.directivities
    return outline_of(measured, priors, traced, fits.answers, sources, offsets, moved_m)


def _quick_findings(settings: Settings) -> tuple[Finding, ...]:
    if not settings.quick:
        return ()
    text = (
        "A first answer: intervals are Gaussian, and neither misplaced positions nor a fault of "
        "the chain, nor another scattering than specified, was looked for. Identify without quick "
        "before relying on it."
    )
    return (Finding(Code.FIRST_ANSWER, About(), text),)


def _findings(
    measured: Measurements,
    priors: tuple[MaterialPrior, ...],
    traced: TracedPaths,
    fits: BandFits,
) -> tuple[Finding, ...]:
    """Return all that is doubtful before the bands are seen together."""
    scene, bands, estimates = measured.scene, measured.bands, fits.answers
    decay_s = median_decay_s(measured, bands.centres_hz)
    fitted = [m for m in measured.responses if m.measurement.use == "fit"]
    return (
        *scene.room.findings,
        *measured.findings,
        *left_out_findings(bands, measured.responses),
        *traced.findings,
        *unspecified_position_findings(scene),
        *prior_only_band_findings(bands, [e.model != "prior" for e in estimates]),
        *fits.findings,
        *tail_findings(fitted),
        *gate_findings(fitted),
        *fit_findings(bands, estimates),
        *description_findings(estimates),
        *certificate_findings(bands, [e.certificate for e in estimates]),
        *starts_findings(bands, scene.room.materials, [e.starts for e in estimates]),
        *sampling_findings(bands, estimates),
        *prior_findings(bands, priors, estimates),
        *broad_prior_findings(priors),
        *product_findings(priors),
        *schroeder_findings(bands, decay_s, volume_m3(scene.room.mesh)),
    )


def combine(
    measured: Measurements,
    priors: tuple[MaterialPrior, ...],
    traced: TracedPaths,
    fits: BandFits,
    findings: tuple[Finding, ...],
    settings: Settings,
) -> Result:
    """Return the result of all bands together, with every pair predicted.

    Parameters
    ----------
    findings : tuple of Finding
        All that is doubtful before the bands are seen together.
    """
    scene, bands, found = measured.scene, measured.bands, fits.answers
    absorption = np.stack([b.absorption for b in found], axis=1)
    identifiable = np.stack([b.identifiable for b in found], axis=1)
    lower, upper = (
        np.stack([getattr(b, n) for b in found], axis=1) for n in ("lower95", "upper95")
    )
    areas = material_areas_m2(scene.room)
    pairs = compare_all(measured, traced.binned, absorption)
    covariance = _logit_covariance(found, absorption, priors)
    by_pressures = [b.window_decays_s if b.model == "coherent" else {} for b in found]
    misses = decay_misses(bands, pairs, [b.model != "prior" for b in found], by_pressures)
    misses = certain_misses(measured, traced, misses, absorption, covariance, settings)
    missed = np.zeros_like(identifiable)
    missed[:, [m.band for m in misses]] = True
    returns = wall_returns(
        isolated_reflections(measured, traced, absorption), measured, traced.scattering
    )
    disagree, doubted = reflection_findings(returns, bands, priors, (absorption, lower, upper))
    findings = (
        *findings,
        *decay_findings(
            measured,
            priors,
            misses,
            areas @ absorption / areas.sum(),
            _eyring_start(measured),
            decays_by_scattering(
                measured, traced, absorption, settings, () if settings.quick else misses
            ),
        ),
        *disagree,
    )
    fixed = np.array([[k.known is not None] for k in priors])
    identifiable &= fixed | ~(missed | doubted)
    misspecified = any(f.code.voids_identifiability for f in findings)
    if misspecified:
        identifiable &= fixed
    for f in findings:
        if f.code is Code.FIXED_ABSORPTION_CONTRADICTED:
            identifiable[scene.room.materials.index(f.evidence["material"])] = False
    ambiguous, mirrors = mirror_findings(
        measured, priors, absorption, lower, upper, [b.mirrors for b in found]
    )
    identifiable &= ~ambiguous
    prior = prior_logit_law(priors)
    shared = any(k.product is not None or k.tied_to is not None for k in priors)
    combinations, sentences, shares = determined(
        scene.room.materials,
        absorption,
        covariance,
        prior,
        areas,
        settings.seed,
        [b.samples for b in found],
        are_specified(priors),
    )
    state_means = {
        state.name: determined(
            scene.room.materials,
            absorption,
            covariance,
            prior,
            material_areas_m2(scene.room, number),
            settings.seed,
            [b.samples for b in found],
            are_specified(priors),
        )[0]
        for number, state in enumerate(scene.room.states, start=1)
    }
    models = tuple(b.model for b in found)
    inseparable = (
        ()
        if misspecified
        else inseparable_findings(
            scene.room.materials,
            bands.centres_hz,
            identifiable,
            combinations,
        )
    )
    return Result(
        bands=bands,
        materials=scene.room.materials,
        areas_m2=areas,
        absorption=absorption,
        lower95=lower,
        upper95=upper,
        identifiable=identifiable,
        mean_absorption=_room_means(combinations),
        chi2_reduced=np.array([b.chi2_reduced for b in found]),
        cost=float(sum(b.cost for b in found)),
        evaluations=sum(b.evaluations for b in found),  # until all are counted
        converged=np.array([b.converged for b in found]),
        pairs=pairs,
        findings=(*findings, *mirrors, *inseparable),
        method=method_chosen(settings.method),
        model=next((m for m in ("coherent", "energy", "values") if m in models), "prior"),
        interval_kind=interval_words(found),
        speed_of_sound_m_s=speed_of_sound_m_s(scene.air),
        seed=settings.seed,
        seconds=0.0,
        logit_covariance=covariance,
        logit_prior=prior_logits(priors),
        logit_prior_covariance=prior[1] if shared else None,
        prior_specified=are_specified(priors),
        draws=_draws(found, priors, settings, absorption, covariance),
        combinations=combinations,
        sentences=sentences,
        shares=shares,
        interval_kinds=tuple(b.kinds for b in found),
        profiles=tuple(b.profiles for b in found),
        samples=tuple(b.samples for b in found),
        sampling=tuple(b.sampling for b in found),
        prior=prior_intervals(priors),
        reasons=reasons(settings.method, bands, found),
        plan=plan_in_words(scene),
        models=models,
        scattering=traced.scattering,
        geometry=fits.geometry,
        directivities=fits.directivities,
        certificates=tuple(b.certificate for b in found),
        costs=tuple(b.costs for b in found),
        eyring_absorption=_eyring_start(measured),
        settings=settings,
        trace=traced_with(traced),
        state_means={name: _room_means(own) for name, own in state_means.items()},
    )


def _room_means(found: Sequence[Sequence[Combination]]) -> FloatArray:
    """Return the mean over the whole room, the first combination of a band, with its bounds."""
    return np.array([(c[0].value, c[0].lower95, c[0].upper95) for c in found]).T


def _logit_covariance(
    found: tuple[BandEstimate, ...], absorption: FloatArray, priors: tuple[MaterialPrior, ...]
) -> FloatArray:
    """Return the covariance of logit absorption in every band, whatever the bounds of the fit."""
    names = [k.name for k in priors]
    leaders = [names.index(k.tied_to or k.name) for k in priors]
    return plain_logit_covariance(
        np.stack([b.logit_covariance for b in found]),
        absorption,
        np.array([k.lower for k in priors])[leaders],
        np.array([k.upper for k in priors])[leaders],
    )


def _draws(
    found: tuple[BandEstimate, ...],
    priors: tuple[MaterialPrior, ...],
    settings: Settings,
    absorption: FloatArray,
    covariance: FloatArray,
) -> FloatArray | None:
    """Return draws of absorption, shape (n_draws, n_materials, n_bands), bands independent.

    None where no band was drawn from with the model itself: predictions draw from the covariance
    then, as is done here for bands by responses beside others by room parameters alone.
    """
    if all(answer.draws is None for answer in found):
        return None
    drawn, (mean, prior) = [], prior_logit_law(priors)
    for band, answer in enumerate(found):
        rng = np.random.default_rng((settings.seed, band))
        own = answer.draws
        if answer.model == "prior":
            own = prior_absorptions(priors, band, settings.n_draws, rng)
        if own is None:
            law = absorption[:, band], covariance[band], mean[:, band], prior[band]
            own = band_draws(*law, settings.n_draws, rng, specified=are_specified(priors))
        drawn.append(rng.permutation(own))
    return np.stack(drawn, axis=2)


def _refinement(
    measured: Measurements, priors: tuple[MaterialPrior, ...], settings: Settings
) -> Refinement:
    """Return what is done to every band after its fit; the paper's searches end where they end."""
    intervals: Literal["gaussian", "profile", "posterior"] = "profile"
    if settings.quick or settings.method in ("simplex", "annealing"):
        intervals = "gaussian"
    elif settings.method == "posterior":
        intervals = "posterior"
    return Refinement(
        intervals,
        material_areas_m2(measured.scene.room),
        settings.seed,
        tuple(s.exchange for s in mirror_symmetries(measured, priors)),
        settings.n_draws if settings.posterior_draws is not False else 0,
        settings.posterior_draws is None,
    )


def _eyring_start(measured: Measurements) -> FloatArray:
    """Return one absorption for all walls in every band, from the measured decays."""
    scene, bands = measured.scene, measured.bands
    mesh = scene.room.mesh
    attenuation = attenuation_per_m(scene.air, bands)
    decay_s = median_decay_s(measured, bands.centres_hz)
    starts = [
        eyring_absorption(
            6.0 * np.log(10.0) / t if np.isfinite(t) else 0.0,
            volume_m3(mesh),
            surface_area_m2(mesh),
            speed_of_sound_m_s(scene.air),
            float(m),
        )
        for t, m in zip(decay_s, attenuation, strict=True)
    ]
    return np.array(starts)


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
