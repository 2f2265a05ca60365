"""All checks, in the order in which their findings are reported, and what each may look at.

A new check is a function of the evidence in the module of its idea, its law in `laws.toml`, and a
line here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import fields
from typing import TypeVar

import numpy as np

from roomfit.base.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.base.bands import Bands
from roomfit.base.errors import InputError, RoomfitError
from roomfit.base.findings import Finding
from roomfit.base.forks import in_forks
from roomfit.base.typing import FloatArray
from roomfit.checks import (
    arrivals,
    decay,
    fit,
    levels,
    noise,
    positions,
    recordings,
    reflections,
    room,
    walls,
)
from roomfit.checks.evidence import Evidence, Recorded
from roomfit.fit.compare import compare_all
from roomfit.fit.fits import BandFits
from roomfit.fit.measurements import (
    Measurements,
    collect_measurements,
    counted_once,
    measured_scene,
    median_decay_s,
)
from roomfit.fit.paths import TracedPaths
from roomfit.materials.priors import MaterialPrior
from roomfit.model.eyring import eyring_absorption
from roomfit.model.patterns import Directivities
from roomfit.room.mesh import surface_area_m2, volume_m3
from roomfit.room.scene import Scene
from roomfit.settings import DECAY_RANGE_DB, Settings
from roomfit.signals.iso3382 import MeasuredValues
from roomfit.signals.measurement import Measurement
from roomfit.uncertainty.posterior import plain_logit_covariance

Observed = TypeVar("Observed", Recorded, Evidence)

BEFORE_THE_FIT: tuple[Callable[[Recorded], Iterable[Finding]], ...] = (
    arrivals.check,
    levels.check_levels,
    levels.check_polarity,
    recordings.check_copies,
    recordings.check_single,
    recordings.check_repeats,
    walls.check,
)
AFTER_THE_FIT: tuple[Callable[[Evidence], Iterable[Finding]], ...] = (
    recordings.check_below_noise,
    room.check_reached,
    room.check_chosen_scattering,
    noise.check_window,
    room.check_scattering,
    positions.check_specified,
    fit.check_data,
    recordings.check_outliers,
    positions.check_freed,
    room.check_sources,
    positions.check_shifts,
    positions.check_displacement,
    noise.check_gate,
    fit.check_bands,
    fit.check_convergence,
    fit.check_misfit,
    fit.check_starts,
    fit.check_priors,
    room.check_schroeder,
    decay.check,
    reflections.check,
    fit.check_mirrors,
)


def examine(
    checks: Sequence[Callable[[Observed], Iterable[Finding]]], evidence: Observed
) -> tuple[Finding, ...]:
    """Return what checks find in the evidence, in their order."""
    found = in_forks(lambda check: tuple(check(evidence)), checks)
    return tuple(finding for findings in found for finding in findings)


def recorded(
    scene: Scene,
    measurements: Sequence[Measurement | MeasuredValues],
    bands: Bands,
    directivities: Directivities,
    decay_range_db: float = DECAY_RANGE_DB,
) -> Recorded:
    """Return everything that was measured, as checks before a fit look at it.

    As `roomfit.fit.measurements.collect_measurements`; where a response cannot be used, an
    `InputError` with the one cause of its arrival, if there is one, as what to try.
    """
    try:
        measured = collect_measurements(scene, measurements, bands, directivities, decay_range_db)
    except InputError as error:
        responses = [m for m in measurements if isinstance(m, Measurement)]
        if error.where not in {m.where for m in responses}:
            raise
        own = measured_scene(scene, measurements)
        causes = arrivals.arrival_findings(own, counted_once(own, responses)[0])
        raise with_causes(error, causes) from error
    responses = [m.measurement for m in measured.responses]
    return Recorded(measured, arrivals.arrival_findings(measured.scene, responses))


def with_causes(error: RoomfitError, causes: Iterable[Finding]) -> RoomfitError:
    """Return an error with the causes that are known, if there are any, as what to try."""
    parts = {k: getattr(error, k) for k in ("where", "found", "needed", "points_m")}
    hint = " ".join(cause.sentence for cause in causes) or error.hint
    return type(error)(error.what, hint=hint, **parts)


def fitted_evidence(
    recorded: Recorded,
    priors: tuple[MaterialPrior, ...],
    traced: TracedPaths,
    fits: BandFits,
    settings: Settings,
) -> Evidence:
    """Return what checks after a fit may look at, every measured pair predicted."""
    measured, answers = recorded.measured, fits.answers
    absorption, lower95, upper95 = (
        np.stack([getattr(b, name) for b in answers], axis=1)
        for name in ("absorption", "lower95", "upper95")
    )
    names = [k.name for k in priors]
    leaders = [names.index(k.tied_to or k.name) for k in priors]
    covariance = plain_logit_covariance(  # whatever the bounds of the fit
        np.stack([b.logit_covariance for b in answers]),
        absorption,
        np.array([k.lower for k in priors])[leaders],
        np.array([k.upper for k in priors])[leaders],
    )
    coherent = np.array([b.model == "coherent" for b in answers], dtype=np.bool_)
    pairs, by_pressures = compare_all(measured, traced.binned, absorption, coherent)
    return Evidence(
        **{f.name: getattr(recorded, f.name) for f in fields(recorded)},
        settings=settings,
        priors=priors,
        traced=traced,
        fits=fits,
        pairs=pairs,
        by_pressures=by_pressures,
        absorption=absorption,
        lower95=lower95,
        upper95=upper95,
        logit_covariance=covariance,
        eyring=eyring_start(measured),
    )


def eyring_start(measured: Measurements) -> FloatArray:
    """Return one absorption for all walls in every band, from the measured decays."""
    scene, bands = measured.scene, measured.bands
    volume, area = volume_m3(scene.room.mesh), surface_area_m2(scene.room.mesh)
    speed, attenuation = speed_of_sound_m_s(scene.air), attenuation_per_m(scene.air, bands)
    decay_s = median_decay_s(measured, bands.centres_hz)
    rates = np.where(np.isfinite(decay_s), 6.0 * np.log(10.0) / decay_s, 0.0)
    each = zip(rates.tolist(), attenuation.tolist(), strict=True)
    return np.array([eyring_absorption(rate, volume, area, speed, m) for rate, m in each])
