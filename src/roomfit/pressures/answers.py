"""Each band's estimate by pressures or by energies, with the errors that its windows share."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from roomfit.base.forks import in_forks
from roomfit.base.typing import FloatArray, Progress, part
from roomfit.fit import systematics
from roomfit.fit.bands import fitted_band
from roomfit.fit.directivity import band_directivities
from roomfit.fit.fits import BandFits
from roomfit.fit.outliers import variance_inflation
from roomfit.model.directivity import directed, directed_band, energy_objective, row_bases
from roomfit.model.energy import EnergyTerm
from roomfit.model.observation import energy_term, fitted_in_band
from roomfit.model.parameters import physical_values
from roomfit.model.problem import Objective
from roomfit.model.room_parameters import without_responses
from roomfit.model.windows import WINDOW_DECAYS, windows_decay_s
from roomfit.pressures.data_term import fully_coherent
from roomfit.pressures.fit import CoherentFit
from roomfit.pressures.sequential import UNDECIDED, CoherentBand
from roomfit.pressures.state import State
from roomfit.room.scene import material_areas_m2
from roomfit.settings import Settings
from roomfit.solver import BandFit, fit_band
from roomfit.uncertainty import gaussian
from roomfit.uncertainty.intervals import with_both_intervals


def coherent_answers(
    fit: CoherentFit, settings: Settings, refine: gaussian.Refine, progress: Progress | None
) -> BandFits:
    """Return each band's estimate by partly coherent image sources where they explain it."""
    state, n = fit.state, len(fit.fits)
    by_energies = energy_estimates(fit)

    def answers(b: int) -> tuple[gaussian.BandEstimate | None, gaussian.BandEstimate | None]:
        pressures, energies = coherent_estimate(fit, b), by_energies(b)
        return (
            None if pressures is None else refine(pressures),
            None if energies is None else refine(energies),
        )

    coherent, energy = zip(*in_forks(answers, range(n)), strict=True)
    chosen = decided(fit, energy, systematics.inflated_by_adjacent_bands(coherent, state.priors))

    # where no response has data, room parameters or the prior
    def rest(b: int) -> gaussian.BandEstimate:
        alone = without_responses(state.others[b], state.priors, b, state.start)
        done = part(progress, 0.8 + 0.2 * b / n, 0.8 + 0.2 * (b + 1) / n)
        return refine(fitted_band(b, alone, state.priors, settings, done))

    missing = [b for b, e in enumerate(chosen) if e is None]
    others = dict(zip(missing, in_forks(rest, missing), strict=True))
    each = [others[b] if e is None else e for b, e in enumerate(chosen)]
    estimates = tuple(each)
    directivities = tuple(None if b is None else b.directivity for b in state.each)
    found = band_directivities(state.scene, state.directivity_parameters, directivities, estimates)
    unknown = state.directivity_parameters
    return BandFits(estimates, fit.geometry, found, unknown, fit.contradicted, fit.tests)


def decided(
    fit: CoherentFit,
    energy: Sequence[gaussian.BandEstimate | None],
    coherent: Sequence[gaussian.BandEstimate | None],
) -> tuple[gaussian.BandEstimate | None, ...]:
    """Return each band's estimate by the model of larger evidence, None without data.

    With both intervals where evidence cannot decide.
    """
    chosen: list[gaussian.BandEstimate | None] = []
    for plain, added, (a, b) in zip(energy, coherent, fit.log_evidences, strict=True):
        if added is None or plain is None or fit.state.settings.model == "coherent":
            chosen.append(plain if added is None else added)
            continue
        best, other = (added, plain) if b > a else (plain, added)
        chosen.append(best if abs(b - a) >= UNDECIDED else with_both_intervals(best, other))
    return tuple(chosen)


def coherent_estimate(fit: CoherentFit, b: int) -> gaussian.FittedBand | None:
    """Return a band's coherent estimate, common-mode errors included in the covariance.

    Without fit and problem where energies explain the band better: its intervals are of no use.
    """
    state, band, found = fit.state, fit.state.each[b], fit.fits[b]
    if band is None or found is None:
        return None
    objective, energies = found.objective(band), band.coherent.energies
    noise = np.concatenate([o.noise for o in energies.observations])
    lost = (found.fit.expected[: noise.size] - noise) * lost_coherence(band, found.fit)
    effect = _effect(state, b, objective, found.fit, energies, {"lost coherence": lost[:, None]})
    own = gaussian.band_estimate(objective.parameters, found.fit, "coherent", effect)
    own = replace(own, window_decays_s=_window_decays_s(energies, found.fit))
    ahead = float(fit.log_evidences[b, 0] - fit.log_evidences[b, 1])
    beaten = state.settings.model != "coherent" and ahead >= UNDECIDED
    return (
        gaussian.FittedBand(own)
        if beaten
        else gaussian.FittedBand(own, objective, found.fit, effect.steps)
    )


def energy_estimates(fit: CoherentFit) -> Callable[[int], gaussian.FittedBand | None]:
    """Return what says of a band by energies alone, in the windows whose noise is known to suit.

    None where the partly coherent model decides, or where there are no data.
    """
    state = fit.state
    may_decide = state.settings.model != "coherent"
    wanted = [
        f is None or (may_decide and bool(x[1] - x[0] < UNDECIDED))
        for f, x in zip(fit.fits, fit.log_evidences, strict=True)
    ]
    unknown, bases = state.directivity_parameters, None
    if unknown is not None and any(wanted):
        bases = row_bases(unknown, state.scene, state.paths, state.binned)

    def estimate(number: int) -> gaussian.FittedBand | None:
        if not wanted[number]:
            return None
        made = energy_term(
            state.scene, state.bands, state.priors, state.files, state.binned, state.start, number
        )
        if made is None:
            return None
        (windows, parameters), band = made, state.each[number]
        files = fitted_in_band(state.files, number)
        directivity = None if band is None else band.directivity
        if directivity is not None and unknown is not None and bases is not None:
            # other windows may hear other rows
            rows = directed_band(unknown, state.scene, bases, windows, files)
            directivity = replace(rows, unknown=directivity.unknown)
        objective = energy_objective(windows, parameters, directivity, state.others[number])
        if band is not None and band.energies.inflation is not None:
            # as for the finer windows: one factor an observation
            fine = [o.energy.size for o in band.coherent.energies.observations]
            factors = band.energies.inflation[np.cumsum([0, *fine[:-1]])]
            outliers = dict(zip(files, factors.tolist(), strict=True))
            n_data = objective.measured().size
            factor = variance_inflation(windows, files, outliers, n_data)
            objective = replace(objective, inflation=factor)
        own_fit = fit_band(objective, max_rounds=state.settings.max_rounds)
        effect = _effect(state, number, objective, own_fit, windows, {})
        answer = gaussian.band_estimate(objective.parameters, own_fit, "energy", effect)
        return gaussian.FittedBand(answer, objective, own_fit, effect.steps)

    return estimate


def _window_decays_s(windows: EnergyTerm, fit: BandFit) -> dict[str, FloatArray]:
    """Return decays of each file from its windows, measured and as fitted, shape (2, n_files)."""
    ends = np.cumsum([o.energy.size for o in windows.observations])[:-1]
    fitted = np.split(fit.expected[: windows.measured().size], ends)
    return {
        name: np.array(
            [
                [windows_decay_s(o.edges_s, e - o.noise, name) for e in (o.energy, expected)]
                for o, expected in zip(windows.observations, fitted, strict=True)
            ]
        ).T
        for name in WINDOW_DECAYS
    }


def _effect(
    state: State,
    b: int,
    objective: Objective,
    fit: BandFit,
    windows: EnergyTerm,
    more: Mapping[str, FloatArray],
) -> gaussian.SharedErrors:
    """Return what errors that the windows of a band share do to its answer."""
    absorption = physical_values(objective.parameters, fit.vector)[0]["absorption"]
    of = state.scene.air, state.bands, windows, state.paths, absorption, state.scattering
    sources = [int(state.scene.pairs[m.pair][0]) for m in fitted_in_band(state.files, b)]
    shared = {
        **systematics.shared_errors(objective, fit, sources, systematics.relative_errors(*of)),
        **more,
    }
    return systematics.effect_on_answer(objective, fit, shared, material_areas_m2(state.scene.room))


def lost_coherence(band: CoherentBand, fit: BandFit) -> FloatArray:
    """Return the relative change of the expected energy if all images were coherent.

    Images that are not known to be coherent are taken to add as energies. Between smooth, parallel
    walls they do not: images on a lattice keep their order, and in boxes the late energy of an
    octave is 10 to 25 % below the sum of their energies. Small errors of time at every reflection
    change the phase of single paths, but hardly this mean over all responses, so that images at
    their assumed positions give it. It is taken over slots of 40 ms; after the last window in which
    pressures add, the value of the last slot is kept.

    Shape (n_windows,).
    """
    energies = band.coherent.energies
    noise = np.concatenate([o.noise for o in energies.observations])
    windows = directed(fully_coherent(band.coherent), band.directivity)
    whole = Objective(band.parameters, (windows,))
    expected = fit.expected[: noise.size]
    more, signal = whole.expected(fit.vector) - expected, expected - noise
    weight = signal / fit.variance[: noise.size]
    early = np.isin(np.arange(noise.size), band.coherent.early_windows())
    slot = np.floor(systematics.middles_s(energies) / systematics.SLOT_S).astype(np.int64)
    weight = np.where(early, weight, 0.0)
    top = np.bincount(slot, weight * more, slot.max() + 1)
    bottom = np.bincount(slot, weight * signal, slot.max() + 1)
    change = np.divide(top, bottom, out=np.zeros(top.size), where=bottom > 0.0)
    informative = np.flatnonzero(bottom > 0.0)
    return np.asarray(change[np.minimum(slot, informative[-1])])
