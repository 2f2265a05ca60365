"""What the data say of places and delays that the campaign holds: fitted for comparison."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from roomfit.app.coherent.bands import CoherentOptions, upwards
from roomfit.app.coherent.beginning import Beginning, renewed
from roomfit.app.coherent.findings import delay_findings, place_findings
from roomfit.findings import Finding
from roomfit.identification.coherence_rounds import CoherentBandFit


def findings_of_what_is_held(
    state: Beginning, fits: Sequence[CoherentBandFit | None]
) -> tuple[Finding, ...]:
    """Return findings where the data are far likelier with what the campaign holds set free.

    Parameters
    ----------
    state : Beginning
    fits : sequence of CoherentBandFit or None, one a band
        Of its bands, with nothing set free.
    """
    settings = state.task.settings
    if settings.model == "energy":
        return ()
    findings: tuple[Finding, ...] = ()
    if not settings.delays:
        freed, _ = _freed(state, replace(settings, delays=True))
        findings = delay_findings(_gain(fits, freed))
    if settings.positions == "fixed":
        freed, freer = _freed(state, replace(settings, positions="fit"))
        n = _n_unknowns(freer) - _n_unknowns(state)
        n_windows = sum(f.fit.expected.size for f in fits if f is not None)
        findings = (*findings, *place_findings(_gain(fits, freed), n, n_windows))
    return findings


def _freed(
    state: Beginning, settings: CoherentOptions
) -> tuple[Sequence[CoherentBandFit | None], Beginning]:
    """Return the fits of all bands with more unknowns, and the bands that were fitted."""
    freer = renewed(replace(state, task=replace(state.task, settings=settings)))
    return upwards(freer.bands, settings, None)[0], freer


def _gain(held: Sequence[CoherentBandFit | None], freed: Sequence[CoherentBandFit | None]) -> float:
    """Return by how much the data are likelier, over all bands."""
    pairs = zip(held, freed, strict=True)
    return sum(b.log_likelihood - a.log_likelihood for a, b in pairs if a and b)


def _n_unknowns(state: Beginning) -> int:
    """Return how many places, times and delays are fitted."""
    geometry = next((b.problem.geometry for b in state.bands if b is not None), None)
    if geometry is None:
        return 0
    return int(np.count_nonzero(geometry.fitted & (geometry.sd > 0.0)))
