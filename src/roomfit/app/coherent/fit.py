"""Every band of a campaign fitted with partly coherent image sources, the geometry along with it.

Bands go from low to high: a low band is coherent in spite of centimetres of error and tells where
everything stands, so that the next one may be coherent, too. Then every band is fitted once more
under what all the others have found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from roomfit.app.binning import BinnedPaths
from roomfit.app.certainty.certifying import affordable_certificate
from roomfit.app.coherent.answers import (
    widened_by_neighbours,
    with_both_intervals,
)
from roomfit.app.coherent.bands import (
    CoherentBand,
    CoherentOptions,
    PartFactory,
    band_likelihoods,
    once_more,
    upwards,
)
from roomfit.app.coherent.beginning import Beginning, Retrace, begun, renewed
from roomfit.app.coherent.findings import geometry_findings
from roomfit.app.coherent.held import findings_of_what_is_held
from roomfit.app.coherent.looser import looser_places, places_findings, places_stretch
from roomfit.app.coherent.prepared import (
    CoherentTask,
    energy_answers,
    files_of_band,
    sources_of_band,
)
from roomfit.app.coherent.problems import (
    cut_at,
    fitted_geometry,
)
from roomfit.app.coherent.shared_errors import air_error, shared_steps
from roomfit.app.coherent.spoiled import LEAST_BY_PRESSURES, Heard, spoiled_files
from roomfit.app.coherent.tracing_noise import with_tracing_noise
from roomfit.app.directing.doubts import directivity_doubt, source_findings
from roomfit.app.directing.unknown import Directed, Directing, directed_band
from roomfit.app.fitting import BandAnswer, Refine, band_answer
from roomfit.app.measuring import MeasuredPair
from roomfit.app.problems import band_problems
from roomfit.app.progress import part
from roomfit.bands import Bands
from roomfit.findings import Finding
from roomfit.identification.coherence_rounds import (
    CoherentBandFit,
)
from roomfit.materials.knowledge import MaterialKnowledge
from roomfit.scene.room import material_areas_m2
from roomfit.scene.scene import Scene
from roomfit.tracing.paths import Paths
from roomfit.typing import FloatArray, Progress
from roomfit.uncertainty.answer import FittedGeometry
from roomfit.uncertainty.shared_errors import allowing_for

__all__ = ["CoherentFit", "CoherentOptions", "Retrace", "fit_coherent"]

# Log-likelihoods nearer than this do not decide between two models.
_UNDECIDED = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class CoherentFit:
    """The answer of every band.

    Attributes
    ----------
    answers : tuple of BandAnswer or None, one a band
        None where too few windows rise above the noise.
    log_likelihoods : float array, shape (n_bands, 2)
        Of the energy model and of the partly coherent one; NaN where not tried.
    geometry : FittedGeometry or None
        None where no band was coherent.
    findings : tuple of Finding
    directed : tuple of Directed or None, one a band
        What the free numbers of an answer's directivity mean; None where there are none.
    """

    answers: tuple[BandAnswer | None, ...]
    log_likelihoods: FloatArray
    geometry: FittedGeometry | None
    findings: tuple[Finding, ...]
    directed: tuple[Directed | None, ...] = ()


def fit_coherent(
    scene: Scene,
    bands: Bands,
    knowledge: tuple[MaterialKnowledge, ...],
    measured: tuple[MeasuredPair, ...],
    paths: Paths,
    binned: BinnedPaths,
    start: FloatArray,
    *,
    options: CoherentOptions | None = None,
    extra_parts: Sequence[tuple[PartFactory, ...]] = (),
    weights: FloatArray | None = None,
    retrace: Retrace | None = None,
    directing: Directing | None = None,
    suspects: Directing | None = None,
    refine: Refine | None = None,
    progress: Progress | None = None,
) -> CoherentFit:
    """Fit every band with image sources as coherent as their times are known.

    Parameters
    ----------
    paths : Paths
        Of all pairs: image sources, the further the better, and rays for what they leave.
    binned : BinnedPaths
        The same paths in bins (`bin_paths`).
    start : float array, shape (n_bands,)
        Uniform absorption to start from.
    options : CoherentOptions, optional
    extra_parts : sequence of tuples, one a band; optional
        Other kinds of data of each band, made from the unknowns that all kinds share.
    weights : float array, shape (n_bands, n_paths), optional
        Factor of every path's weight in each band, as in `binned`.
    retrace : callable, optional
        Traces a scene with other positions, as `paths` were. Which images a receiver sees
        depends on where it stands, except in a box: there the bands up to 1 kHz are fitted first,
        images are found anew at the positions they tell, and everything is fitted again from what
        was told.
    directing : Directing, optional
        Sources whose directivity is fitted.
    suspects : Directing, optional
        Sources taken for omnidirectional, of which to ask whether the data agree.
    refine : callable, optional
        Makes better intervals of each band's last fit.
    """
    settings = CoherentOptions() if options is None else options
    parts = tuple(extra_parts) or ((),) * len(bands)
    task = CoherentTask(
        *(scene, bands, knowledge, measured, start, settings, parts, directing, suspects),
        refine=refine,
    )
    state = begun(task, paths, weights, cut_at(binned, settings.late_end_s), retrace)
    fits, chosen_noise = upwards(state.bands, settings, part(progress, 0.0, 0.8))
    spoiled = spoiled_files(_heard(state, fits), LEAST_BY_PRESSURES)
    if spoiled:
        state = renewed(replace(state, task=replace(state.task, spoiled=spoiled)))
        fits, chosen_noise = upwards(state.bands, settings, part(progress, 0.8, 1.0))
    stretch = places_stretch(state.task.scene, state.bands, fits)
    if stretch > 1.0:
        place, origin = looser_places(state.task.scene, state.origin, stretch)
        state = renewed(replace(state, task=replace(state.task, scene=place), origin=origin))
        fits, chosen_noise = upwards(state.bands, settings, part(progress, 0.8, 1.0))
    findings = (*state.findings, *places_findings(stretch))
    findings = (*findings, *findings_of_what_is_held(state, fits))
    fits, final = once_more(state.bands, fits, chosen_noise, settings)
    likelihoods = band_likelihoods(state.bands, fits)
    answers = _answers(state, fits, likelihoods, part(progress, 0.8, 1.0))
    findings = (*findings, *_source_findings(state))
    geometry = next((b.problem.geometry for b in state.bands if b is not None), None)
    told = None if geometry is None or final is None else fitted_geometry(geometry, final)
    findings = (*findings, *geometry_findings(told))
    directed = tuple(None if b is None else b.directed for b in state.bands)
    return CoherentFit(answers, likelihoods, told, findings, directed)


def _heard(state: Beginning, fits: Sequence[CoherentBandFit | None]) -> list[Heard]:
    """Return what pressures explain, band by band, for the search of spoiled files."""
    return [
        Heard(band.energies, fit.fit, files_of_band(state.task, i), band.factor)
        for i, (band, fit) in enumerate(zip(state.bands, fits, strict=True))
        if band is not None and fit is not None
    ]


def _source_findings(state: Beginning) -> tuple[Finding, ...]:
    """Return a finding where a source taken for omnidirectional is none."""
    task, doubts = state.task, {}
    for i, band in enumerate(state.bands):
        if band is not None and task.suspects is not None:
            heard = files_of_band(task, i)
            how = directed_band(task.suspects, task.scene, state.paths, band.energies, heard)
            doubts[i] = directivity_doubt(band.energies, band.energy_fit, how, band.factor)
    return source_findings(task.suspects, doubts)


def _answers(
    state: Beginning,
    fits: Sequence[CoherentBandFit | None],
    likelihoods: FloatArray,
    progress: Progress | None,
) -> tuple[BandAnswer | None, ...]:
    """Return each band's answer by the model that explains it better."""
    task = state.task
    areas = material_areas_m2(task.scene.room)
    coherent: tuple[BandAnswer | None, ...] = tuple(
        _coherent_answer(task, i, *each, part(progress, i / len(fits), (i + 1) / len(fits)))
        for i, each in enumerate(zip(state.bands, fits, likelihoods, strict=True))
    )
    coherent = widened_by_neighbours(coherent, areas)
    energy: Sequence[BandAnswer | None] = (None,) * len(task.bands)
    asked = [_asks_energies(f, x, task.settings) for f, x in zip(fits, likelihoods, strict=True)]
    if any(asked):
        coarse = band_problems(
            *(task.scene, task.bands, task.knowledge, task.measured, state.binned, task.start)
        )
        wanted = (p if wants else None for p, wants in zip(coarse, asked, strict=True))
        energy = energy_answers(task, state.paths, wanted, state.bands, areas)
    decided = [
        _decided(*each, task.settings) for each in zip(energy, coherent, likelihoods, strict=True)
    ]
    if task.settings.model != "auto":
        return tuple(decided)
    return tuple(_certified(*each) for each in zip(decided, state.bands, strict=True))


def _certified(answer: BandAnswer | None, band: CoherentBand | None) -> BandAnswer | None:
    """Return an answer with what is proven of its energies alone, where that is affordable."""
    # a proof would be of other costs where data are softened, or joined by other kinds
    if answer is None or band is None or band.parts or np.any(band.factor != 1.0):
        return answer
    proof = affordable_certificate(band.energies, band.energy_fit.vector)
    return replace(answer, certificate=proof)


def _coherent_answer(
    task: CoherentTask,
    number: int,
    band: CoherentBand | None,
    found: CoherentBandFit | None,
    likelihoods: FloatArray,
    progress: Progress | None,
) -> BandAnswer | None:
    """Return what pressures say; with better intervals where that may be the answer."""
    if band is None or found is None:
        return None
    noisy = with_tracing_noise(
        found.problem, band.energies, sources_of_band(task, number), found.fit
    )
    air = air_error(task.scene.air, task.bands, number, band.energies)
    steps = shared_steps(found.problem, found.fit, band.energies, air, band)
    noisy = allowing_for(noisy, steps)
    answer = band_answer(found.parameters, noisy, material_areas_m2(task.scene.room), "coherent")
    beaten = task.settings.model != "coherent" and likelihoods[0] - likelihoods[1] >= _UNDECIDED
    if task.refine is None or beaten:
        return answer
    return task.refine(found.problem, found.fit, answer, progress)


def _asks_energies(
    fit: CoherentBandFit | None, likelihoods: FloatArray, settings: CoherentOptions
) -> bool:
    """Whether the energy model's answer of a band may be needed."""
    if fit is None:
        return True
    return settings.model != "coherent" and bool(likelihoods[1] - likelihoods[0] < _UNDECIDED)


def _decided(
    energy: BandAnswer | None,
    coherent: BandAnswer | None,
    likelihoods: FloatArray,
    settings: CoherentOptions,
) -> BandAnswer | None:
    """Return the likelier answer; with both intervals where the likelihood cannot decide."""
    if coherent is None:
        return energy
    if energy is None or settings.model == "coherent":
        return coherent
    better = likelihoods[1] - likelihoods[0]
    best, other = (coherent, energy) if better > 0.0 else (energy, coherent)
    return best if abs(better) >= _UNDECIDED else with_both_intervals(best, other)
