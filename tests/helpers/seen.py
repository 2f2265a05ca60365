"""Evidence for one check at a time, of nothing but what that check looks at."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from roomfit.diagnostics import (
    fixed_absorption,
    linearity,
    outliers,
    positions,
    source_patterns,
)
from roomfit.findings import Finding
from roomfit.inversion.fits import CoherentTests


def evidence(**parts: Any) -> Any:
    """Return evidence with the given parts; what else a check asks for is not there."""
    return SimpleNamespace(arrivals=(), **parts)


def of_files(files: Any) -> Any:
    """Return evidence of measured pairs alone, all of them to be fitted."""
    return evidence(measured=SimpleNamespace(responses=tuple(files)))


def of_scattering_trial(trial: Any, contradicted: tuple[Any, ...] = ()) -> Any:
    """Return evidence of walls that were tried as scattering, and of sources that are doubted."""
    fits = SimpleNamespace(unknown_sources=None, contradicted=contradicted)
    return evidence(traced=SimpleNamespace(scattering_trial=trial), fits=fits)


def of_answers(answers: Any, bands: Any = None, **parts: Any) -> Any:
    """Return evidence of the answers of bands."""
    fits = SimpleNamespace(answers=tuple(answers))
    return evidence(fits=fits, measured=SimpleNamespace(bands=bands), **parts)


def of_tests(**tests: Any) -> Any:
    """Return evidence of what fits by pressures measured on the way."""
    return evidence(fits=SimpleNamespace(tests=CoherentTests(**tests)))


def of_fit(fit: Any) -> Any:
    """Return evidence of a partly coherent fit."""
    task = fit.state.task
    fits = SimpleNamespace(
        tests=fit.tests,
        geometry=fit.geometry,
        contradicted=fit.contradicted,
        unknown_sources=task.directivity_parameters,
        directivities=() if task.directivity_parameters is None else ("fitted",),
    )
    measured = SimpleNamespace(scene=task.scene, bands=task.bands, responses=task.measured)
    return evidence(fits=fits, measured=measured, priors=task.priors)


def doubts_of_fit(fit: Any) -> list[Finding]:
    """Return what is found of a partly coherent fit by itself."""
    checks = (
        outliers.check,
        positions.check_inflated,
        positions.check_delays,
        positions.check_fixed,
        source_patterns.check,
        positions.check_shifts,
        linearity.check,
        fixed_absorption.check,
    )
    return [finding for check in checks for finding in check(of_fit(fit))]
