"""What a fit of all bands begins with: loudspeakers' colour taken out, images at the right places.

Both ask for a first answer. Energies give one that suffices for the colour of all but the lowest
frequencies; pressures of the lowest bands give a better one, and tell where everything stands.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from roomfit.app.binning import BinnedPaths
from roomfit.app.coherent.bands import CoherentBand, upwards
from roomfit.app.coherent.loudspeaker import MODAL, without_loudspeakers
from roomfit.app.coherent.prepared import (
    CoherentTask,
    absorption_so_far,
    first_absorption,
    prepared_bands,
)
from roomfit.app.coherent.problems import cut_at, moved_scene
from roomfit.app.measuring import MeasuredPair
from roomfit.findings import Finding
from roomfit.identification.coherence_rounds import CoherentBandFit
from roomfit.scene.scene import Scene
from roomfit.tracing.paths import Paths
from roomfit.typing import FloatArray

# Bands up to here tell positions to a few millimetres, in spite of images that are not seen.
_RETRACE_BELOW_HZ = 1000.0
# Bands up to here are those of which a loudspeaker's colour is not told by a first guess of walls.
_MODAL_BELOW_HZ = 250.0

Retrace = Callable[[Scene], tuple[Paths, FloatArray | None, BinnedPaths]]
"""Traces a scene whose positions have moved: paths, their factors in each band, the same binned."""


@dataclass(frozen=True, slots=True, eq=False)
class Beginning:
    """A task, its paths, and its bands made ready.

    Attributes
    ----------
    task : CoherentTask
        With the measurements as loudspeakers without colour would have given them.
    paths : Paths
    weights : float array, shape (n_bands, n_paths), or None
    binned : BinnedPaths
    origin : float array or None
        Free numbers of the geometry for which the paths were traced; None for what was told.
    bands : tuple of CoherentBand or None, one a band
    findings : tuple of Finding
    """

    task: CoherentTask
    paths: Paths
    weights: FloatArray | None
    binned: BinnedPaths
    origin: FloatArray | None
    bands: tuple[CoherentBand | None, ...]
    findings: tuple[Finding, ...]


def begun(
    task: CoherentTask,
    paths: Paths,
    weights: FloatArray | None,
    binned: BinnedPaths,
    retrace: Retrace | None,
) -> Beginning:
    """Return the bands ready to be fitted.

    Parameters
    ----------
    paths, weights, binned
        As for `fit_coherent`.
    retrace : callable or None
        Traces a scene with other positions.
    """
    state = renewed(Beginning(task, paths, weights, binned, None, (), ()))
    settings, told = task.settings, task.measured
    if settings.model == "energy":
        return state
    coloured = False
    if task.directing is None:
        even = _even(state, told, first_absorption(task, state.bands), MODAL)
        coloured = any(new is not old for new, old in zip(even, told, strict=True))
        if coloured:
            state = renewed(replace(state, task=replace(task, measured=even)))
    moves = retrace is not None and settings.positions == "fit"
    if not (moves or coloured):
        return state
    fits = _first_fits(state, _RETRACE_BELOW_HZ if moves else _MODAL_BELOW_HZ)
    guess = absorption_so_far(first_absorption(state.task, state.bands), fits)
    if retrace is not None and moves:
        state = _moved(state, fits, retrace)
    if coloured:
        even = _even(state, told, guess, 0.0)
        state = replace(state, task=replace(state.task, measured=even))
    return renewed(state)


def renewed(state: Beginning) -> Beginning:
    """Return the same task and paths with bands made anew."""
    bands, findings = prepared_bands(
        state.task, state.paths, state.weights, state.binned, state.origin
    )
    return replace(state, bands=bands, findings=findings)


def _even(
    state: Beginning, told: tuple[MeasuredPair, ...], absorption: FloatArray, modal: float
) -> tuple[MeasuredPair, ...]:
    task = state.task
    return without_loudspeakers(task.scene, task.bands, told, state.paths, absorption, modal=modal)


def _first_fits(state: Beginning, highest_hz: float) -> list[CoherentBandFit | None]:
    """Return fits of the bands up to a frequency, None for the others."""
    low = tuple(
        band if f <= highest_hz else None
        for band, f in zip(state.bands, state.task.bands.centres_hz, strict=True)
    )
    return upwards(low, state.task.settings, None)[0]


def _moved(state: Beginning, fits: Sequence[CoherentBandFit | None], retrace: Retrace) -> Beginning:
    """Return paths traced at the positions that the lower bands tell."""
    known = [f.found for f in fits if f is not None and f.found is not None]
    geometry = next((b.problem.geometry for b in state.bands if b is not None), None)
    if not known or geometry is None:
        return state
    place, origin = moved_scene(state.task.scene, geometry, known[-1].mean)
    paths, weights, binned = retrace(place)
    binned = cut_at(binned, state.task.settings.late_end_s)
    return replace(state, paths=paths, weights=weights, binned=binned, origin=origin)
