"""How much the walls of a campaign scatter: as told, as the data prefer, or other than told."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from roomfit.app.gathering import Gathered
from roomfit.app.planning import DEFAULT_SCATTERING
from roomfit.app.retracing import energy_fits, log_likelihoods, scene_retracer
from roomfit.app.scattering import ScatteringFit, choose_scattering, suspected_scattering
from roomfit.bands import Bands
from roomfit.errors import InputError
from roomfit.files.campaign.campaign import Campaign
from roomfit.findings import Finding
from roomfit.materials.knowledge import MaterialKnowledge, in_bands
from roomfit.signals.noise import NoiseEstimate
from roomfit.tracing.settings import TraceSettings
from roomfit.typing import FloatArray, Progress

# Enough to tell coefficients apart that differ by a factor of two, and quick to trace again.
_N_RAYS = 20_000
_LONGEST_S = 0.3
# Beyond so many unknown coefficients they get one value in common.
_MOST_APART = 3
_TRIAL = (0.15,)
_ASSUMED = (0.05, 0.2, 0.4)
_TRIAL_BANDS = 2
# The higher a band, the less its energies scatter by interference, and the better they tell whether
# anything arrives between the image sources; higher still, sources are directional.
_DOUBT_BANDS = 3
_HIGHEST_DOUBT_HZ = 4500.0
_TRIAL_RAYS, _TRIAL_S = 8_000, 0.2


def chosen_scattering(
    campaign: Campaign,
    gathered: Gathered,
    knowledge: tuple[MaterialKnowledge, ...],
    settings: TraceSettings,
    start: FloatArray,
    progress: Progress | None,
) -> tuple[tuple[MaterialKnowledge, ...], tuple[Finding, ...]]:
    """Return the knowledge with the likeliest value where ``scattering = "fit"`` stands.

    Energies alone are compared, in paths that are weighed anew for every trial.

    Parameters
    ----------
    settings : TraceSettings
        As planned for the campaign; fewer rays are used here.
    start : float array, shape (n_bands,)

    Raises
    ------
    InputError
        The campaign has no response to fit.
    """
    fitted = np.array([k.fit_scattering for k in knowledge])
    if not fitted.any():
        return knowledge, ()
    heard = tuple(m for m in gathered.responses if m.file.use == "fit")
    if not heard:
        raise InputError(
            "scattering cannot be fitted without responses",
            where=f"{campaign.path}, materials",
            found='scattering = "fit" and room parameters only',
            needed="impulse responses, or scattering as a number",
        )
    scene, bands = gathered.scene, campaign.bands
    retracer = scene_retracer(scene, bands, _quick(settings))
    told = np.stack(
        [
            np.full(len(bands), DEFAULT_SCATTERING) if k.scattering is None else k.scattering
            for k in knowledge
        ]
    )

    def fit(coefficients: FloatArray) -> FloatArray:
        return log_likelihoods(
            energy_fits(scene, bands, knowledge, heard, retracer, start, coefficients)
        )

    common = int(np.count_nonzero(fitted)) > _MOST_APART
    choice = choose_scattering(fit, told, fitted, common=common, progress=progress)
    chosen = tuple(
        replace(k, scattering=row) if k.fit_scattering else k
        for k, row in zip(knowledge, choice.coefficients, strict=True)
    )
    names = [k.name for k in knowledge if k.fit_scattering]
    ranges = ", ".join(
        f"{k.name} {choice.coefficients[i, 0]:g} ({choice.lower[i, 0]:g} to {choice.upper[i, 0]:g})"
        for i, k in enumerate(knowledge)
        if k.fit_scattering
    )
    sentence = f"Scattering that explains the data best, among eight values: {ranges}."
    return chosen, (Finding("scattering-fitted", "info", sentence, {"materials": names}),)


def _quick(settings: TraceSettings) -> TraceSettings:
    until_s = min(settings.duration_s, _LONGEST_S)
    return replace(settings, n_rays=_N_RAYS, duration_s=until_s, keep_unfolding=False)


def _noise_in(noise: NoiseEstimate, chosen: slice) -> NoiseEstimate:
    return NoiseEstimate(*(getattr(noise, f.name)[chosen] for f in fields(NoiseEstimate)))


def assumed_scattering(
    gathered: Gathered,
    bands: Bands,
    knowledge: tuple[MaterialKnowledge, ...],
    settings: TraceSettings,
    start: FloatArray,
) -> tuple[tuple[MaterialKnowledge, ...], tuple[Finding, ...]]:
    """Return the knowledge with a scattering for the walls of which none is told.

    One coefficient for all of them: the likeliest of five where there are responses; 0.1 where
    there are none, or where it explains them as well.

    Parameters
    ----------
    start : float array, shape (n_bands,)
    """
    untold = np.array([k.scattering is None and not k.fit_scattering for k in knowledge])
    if not untold.any():
        return knowledge, ()
    names = ", ".join(k.name for k in knowledge if k.scattering is None)
    sentence = f"No scattering is told for {names}; {DEFAULT_SCATTERING:g} was assumed."
    value = DEFAULT_SCATTERING
    first = max((len(bands) - _TRIAL_BANDS) // 2, 0)
    middle = slice(first, min(first + _TRIAL_BANDS, len(bands)))
    trial = _trial(gathered, bands, knowledge, settings, start, middle)
    if trial is not None:
        fit, told = trial
        grid = (0.0, *sorted({*_ASSUMED, DEFAULT_SCATTERING}))
        choice = choose_scattering(fit, told, untold, grid=grid)
        value = float(choice.coefficients[untold][0, 0])
        low, high = (float(x[untold][0, 0]) for x in (choice.lower, choice.upper))
        value = DEFAULT_SCATTERING if low <= DEFAULT_SCATTERING <= high else value
        others = f"{low:g} to {high:g} do as well" if low < high else "others do worse"
        sentence = (
            f"No scattering is told for {names}; {value:g} was assumed, which explains the "
            f"responses well ({others})."
        )
    known = tuple(
        replace(k, scattering=np.full(len(bands), value)) if missing else k
        for k, missing in zip(knowledge, untold, strict=True)
    )
    evidence = {"materials": names.split(", "), "scattering": value}
    return known, (Finding("scattering-assumed", "info", sentence, evidence),)


def scattering_doubts(
    gathered: Gathered,
    bands: Bands,
    knowledge: tuple[MaterialKnowledge, ...],
    settings: TraceSettings,
    start: FloatArray,
) -> tuple[Finding, ...]:
    """Return a finding where walls that were told to be smooth had better scatter.

    Tried in the three highest bands up to 4 kHz with one coefficient for all of them. Of walls that
    are smooth, a model that is otherwise right raises the doubt in fewer than one room in a
    hundred: a likelihood ratio has the mean 1 under the model in its denominator, so that it
    exceeds e^5 with a probability below e^-5 (A. Wald, Sequential Analysis, 1947, section 3.2).

    Parameters
    ----------
    start : float array, shape (n_bands,)
    """
    smooth = [k.scattering is not None and not np.any(k.scattering > 0.0) for k in knowledge]
    if not any(smooth):
        return ()
    last = max(int(np.searchsorted(bands.centres_hz, _HIGHEST_DOUBT_HZ)), 1)
    chosen = slice(max(last - _DOUBT_BANDS, 0), last)
    trial = _trial(gathered, bands, knowledge, settings, start, chosen, n_rays=_N_RAYS)
    if trial is None:
        return ()
    fit, told = trial
    return suspected_scattering(fit, gathered.scene.room.materials, told, fit(told), trials=_TRIAL)


def _trial(
    gathered: Gathered,
    bands: Bands,
    knowledge: tuple[MaterialKnowledge, ...],
    settings: TraceSettings,
    start: FloatArray,
    chosen: slice,
    *,
    n_rays: int = _TRIAL_RAYS,
) -> tuple[ScatteringFit, FloatArray] | None:
    """Return a quick fit of the energies in some bands, and what is told for these.

    None where there are no responses to fit.
    """
    heard = tuple(m for m in gathered.responses if m.file.use == "fit")
    if not heard:
        return None
    own = Bands(bands.kind, bands.centres_hz[chosen])
    known = in_bands(knowledge, np.arange(chosen.start, chosen.stop))
    responses = tuple(replace(m, noise=_noise_in(m.noise, chosen)) for m in heard)
    scene = gathered.scene
    few = replace(_quick(settings), n_rays=n_rays)
    few = replace(few, duration_s=min(few.duration_s, _TRIAL_S))
    retracer = scene_retracer(scene, own, few)
    told = np.stack(
        [
            np.full(len(own), DEFAULT_SCATTERING) if k.scattering is None else k.scattering
            for k in known
        ]
    )

    def fit(coefficients: FloatArray) -> FloatArray:
        return log_likelihoods(
            energy_fits(scene, own, known, responses, retracer, start[chosen], coefficients)
        )

    return fit, told
