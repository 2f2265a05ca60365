"""From a fit to a result: enough data, noise by the residual, misfit and its cause, the verdict."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from roomfit.base.findings import About, Code, Finding
from roomfit.base.typing import ComplexArray, FloatArray
from roomfit.impedance import result
from roomfit.impedance.data import Observed, level_at, model_error, smoothed
from roomfit.impedance.fit import (
    SAME_WITHIN,
    ImpedanceFit,
    Start,
    distance,
    marginal_likelihood_error,
    reduced_chi2,
    robust_covariance,
)
from roomfit.impedance.laws import Spline
from roomfit.impedance.problem import Problem, data_rows, factor_of, source_spectra, state_of
from roomfit.impedance.wave_model import predicted_pressure
from roomfit.room.scene import pair_names

# Frequencies from which a curve couples them, so that phases can be done without.
_COUPLED = 4
# How far the image model's error moves a soft wall's R0, over what the residual shows of it: most
# probable for 26 boxes with walls at random, see docs/impedance.md.
_OFFSET = 2.4

# Of squares over what is expected; the allowance for the model's own error is a generous one, so
# that good fits come to between 0.2 and 1.2.
CHI2_LIMIT = 1.6
OCTAVE_CHI2_LIMIT = 2.5
# Share of frequencies at which a material must be identified.
ENOUGH_FREQUENCIES = 0.8
# Noise estimated from what a fit leaves: above this share of the level it does not fit.
LOUDEST_ESTIMATED_NOISE = 0.15

# Frequencies that are taken together differ by less in their logarithm, and give at least so many
# residuals.
_NEAR = 0.2
_LEAST = 24
# Medians over means of squares of normal numbers: of complex ones, and of real ones.
_COMPLEX_MEDIAN, _REAL_MEDIAN = math.log(2.0), 0.4549364
# Of the error that is allowed to the model: no noise is less.
_FLOOR = 1e-3


def data_findings(problem: Problem) -> tuple[Finding, ...]:
    """Return a serious finding where the data cannot determine the unknowns, whatever they say.

    Two numbers a pair and frequency (levels: one), less the gains that are unknown, must be at
    least the numbers of the walls; and frequency by frequency, where nothing couples them, one pair
    more than materials: with as many there are other exact solutions, see docs/impedance.md.
    """
    observed, curves, gain = problem.observed, problem.curves, problem.layout.gain
    (n_pairs, n_f), n_materials = observed.pressure.shape, len(curves)
    needed = sum(2 * c.basis.shape[1] for c in curves) + gain.stop - gain.start
    data = (2 if observed.has_phase else 1) * n_pairs * n_f
    if problem.nuisances.free_spectra:
        data -= 2 * len(np.unique(problem.model.scene.pairs[:, 0])) * n_f
    evidence = {"pairs": n_pairs, "frequencies": n_f}
    if n_f < _COUPLED and not observed.has_phase:
        sentence = (
            f"Levels without phase at {n_f} frequencies do not distinguish a wall from others that "
            "reflect as much with another phase. Give phases, or levels over a whole band."
        )
    elif n_f < _COUPLED and n_pairs < n_materials + 1:
        sentence = (
            f"{n_pairs} pairs at {n_f} frequencies cannot distinguish {n_materials} materials: "
            f"{n_materials + 1} pairs are needed, or frequencies that a smooth curve couples."
        )
        evidence["materials"] = n_materials
    elif data < needed:
        sentence = (
            f"{data} numbers were measured, besides what the gains take, and {needed} are unknown: "
            "measure more pairs, or specify the gain."
        )
        evidence = {"data": data, "unknowns": needed}
    else:
        return ()
    return (Finding(Code.TOO_FEW_DATA, About(), sentence, evidence),)


def estimated_noise(fit: ImpedanceFit) -> FloatArray:
    """Return the rms noise of every pair and frequency, by the residual of a fit without noise.

    A smooth function of frequency, the same for all pairs: medians of the squared residuals over
    neighbours in frequency and over pairs, so that a few bad pairs or frequencies do not count,
    averaged once more; half of the error that is allowed to the model itself is taken off.
    """
    problem = fit.problem
    n_pairs, n_f = problem.sd.shape
    # each row has the variance of one, of real and imaginary part or of the level
    square = np.reshape(fit.residual**2, (-1, n_pairs, n_f)).mean(axis=0) * problem.sd**2
    free = max(1.0 - fit.effective / len(fit.residual), 1e-2)
    frequency_hz = problem.observed.frequency_hz
    apart = np.abs(np.log(frequency_hz[:, None] / frequency_hz))
    enough = np.sort(apart, axis=1)[:, min(math.ceil(_LEAST / n_pairs), n_f) - 1]
    reach = np.maximum(enough, _NEAR)[:, None]
    usual = _COMPLEX_MEDIAN if problem.observed.has_phase else _REAL_MEDIAN
    middle = np.array([np.median(square[:, own]) for own in apart <= reach]) / (usual * free)
    allowed = np.mean(problem.sd**2, axis=0)
    smooth = smoothed(middle, frequency_hz, reach) - 0.5 * allowed
    noise = np.sqrt(np.maximum(smooth, _FLOOR * allowed))
    return np.tile(noise, (n_pairs, 1))


def judged_result(
    fit: ImpedanceFit,
    starts: tuple[Start, ...],
    rivals: tuple[ImpedanceFit, ...],
    observed: Observed,
) -> result.ImpedanceResult:
    """Return the result of a fit with its verdict."""
    error = marginal_likelihood_error(fit)
    covariance = robust_covariance(fit, error)
    materials = _material_impedances(fit, error, covariance)
    weaker = _weaker_findings(fit.problem, observed)
    verdict, doubts = _verdict(fit, rivals, observed, materials)
    return replace(
        _of_data(fit.problem),
        materials=materials,
        verdict=verdict._replace(weaker=bool(weaker)),
        findings=(*weaker, *doubts),
        nuisances=_found_nuisances(fit, covariance),
        chi2=reduced_chi2(fit),
        model_error=error,
        condition=_wall_condition(fit),
        agreeing_starts=sum(distance(s.r0, starts[0].r0) <= SAME_WITHIN for s in starts),
        n_starts=len(starts),
        predicted=_predicted_pairs(fit),
        ending=fit.ending.advice,
        evaluations=fit.evaluations,
        rounds=fit.rounds,
    )


def result_without_fit(problem: Problem, findings: tuple[Finding, ...]) -> result.ImpedanceResult:
    """Return the result where the data cannot determine the unknowns: nothing but that."""
    names, n_f = problem.model.scene.room.materials, len(problem.observed.frequency_hz)
    nothing, unbounded = np.zeros(n_f, dtype=np.complex128), np.tile(1e6 * np.eye(2), (n_f, 1, 1))
    materials = (result.material_impedance(m, "none", nothing, unbounded) for m in names)
    return replace(_of_data(problem), materials=tuple(materials), findings=findings)


def _of_data(problem: Problem) -> result.ImpedanceResult:
    """Return a result that says nothing yet but what was measured."""
    observed, cause = problem.observed, "too few data"
    return result.ImpedanceResult(
        frequency_hz=observed.frequency_hz,
        tau_s=observed.tau_s,
        materials=(),
        verdict=result.Verdict("not identifiable", cause, f"Not identifiable: {cause}."),
        findings=(),
        pairs=tuple(name[:2] for name in pair_names(problem.model.scene)),
        measured=observed.pressure,
        predicted=np.zeros_like(observed.pressure),
        expected_rms=problem.sd,
    )


def _material_impedances(
    fit: ImpedanceFit, error: float, covariance: FloatArray
) -> tuple[result.MaterialImpedance, ...]:
    """Return every material with its intervals.

    Besides noise, the intervals cover what the image model itself gets wrong. That does not average
    out over frequencies and pairs. A wave front that is not plane strikes as if its angle were
    another by some ``1 / (k r)``, and R changes with the cosine as ``1 - R0**2``: R0 is taken to be
    off by ``|1 - R0**2|`` times 2.4 of the model's own error as it is found in the room, see
    `model_error`.
    """
    problem, scene = fit.problem, fit.problem.model.scene
    share = model_error(scene, problem.observed.frequency_hz, _OFFSET * error)
    found = []
    for i, name in enumerate(scene.room.materials):
        block, curve = problem.layout.curves[i], problem.curves[i]
        slope = curve.values(fit.x[block])[1]
        parts = np.stack([slope.real, slope.imag], axis=1)
        off = share * np.abs(1.0 - fit.r0[i] ** 2)
        own = np.einsum("fai,ij,fbj->fab", parts, covariance[block, block], parts)
        own = own + 0.5 * (off**2)[:, None, None] * np.eye(2)
        found.append(result.material_impedance(name, curve.kind, fit.r0[i], own))
    return tuple(found)


def _found_nuisances(fit: ImpedanceFit, covariance: FloatArray) -> tuple[result.Estimate, ...]:
    """Return every nuisance of a fit with its interval, in the order of the unknowns."""
    problem, layout, x = fit.problem, fit.problem.layout, fit.x
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    scene, nuisances = problem.model.scene, problem.nuisances
    found: list[result.Estimate] = []

    def add(name: str, unit: str, at: int, scale: float, middle: float = 0.0) -> None:
        value, reach = middle + x[at] * scale, result.Z95 * sd[at] * scale
        found.append(result.Estimate(name, unit, value, value - reach, value + reach, scale))

    for moves, points in ((layout.source, scene.sources), (layout.receiver, scene.receivers)):
        for n, (point, axis, scale_m) in enumerate(zip(*moves[:3], strict=True), moves.place.start):
            add(f"{'xyz'[axis]} of {points[point].name}", "m", n, float(scale_m))
    if layout.speed.stop > layout.speed.start:
        speed = problem.model.speed_m_s
        add("speed of sound", "m/s", layout.speed.start, nuisances.speed_sd * speed, speed)
    n_gains = (layout.gain.stop - layout.gain.start) // 2
    for n in range(n_gains):
        add(f"gain {n + 1}", "dB", layout.gain.start + n, 20.0 / np.log(10.0))
        add(f"phase of gain {n + 1}", "rad", layout.gain.start + n_gains + n, 1.0)
    for n in range(layout.delay.stop - layout.delay.start):
        source, receiver = scene.pairs[np.flatnonzero(layout.delay_of_pair == n)[0]]
        name = scene.sources[source].name
        if nuisances.delay == "pair":
            name += f" to {scene.receivers[receiver].name}"
        add(f"delay of {name}", "s", layout.delay.start + n, nuisances.delay_sd_s)
    return tuple(found)


def _predicted_pairs(fit: ImpedanceFit) -> ComplexArray:
    """Return the predicted pressures with gains and delays, (n_pairs, n_frequencies)."""
    problem, state = fit.problem, state_of(fit.problem, fit.x)
    short = predicted_pressure(problem.model, fit.r0, state, spherical=False, short=True)
    predicted = factor_of(problem, fit.x) * (short + fit.correction)
    spectra = source_spectra(problem, predicted) if problem.nuisances.free_spectra else 1.0
    return np.asarray(predicted * spectra)


def _wall_condition(fit: ImpedanceFit) -> float:
    """Return how unequally the data determine the walls: 1 is equally well, infinite not at all.

    Largest over smallest singular value of the weighted Jacobian by the walls' numbers, without
    priors of theirs, after what the other unknowns can explain.
    """
    # by the numbers of a spline of R0: of a density's, some mean frequencies beyond the data
    splines = tuple(Spline(c.kind, c.basis) for c in fit.problem.curves)
    problem = replace(fit.problem, curves=splines)
    n = problem.layout.curves[-1].stop
    found = [
        np.linalg.lstsq(c.basis, r0, rcond=None)[0] for c, r0 in zip(splines, fit.r0, strict=True)
    ]
    walls = [part for x in found for part in (x.real, x.imag)]
    x = np.concatenate((*walls, fit.x[fit.problem.layout.curves[-1].stop :]))
    _, jacobian = data_rows(problem, x, fit.correction)
    own, other = jacobian[:, :n], jacobian[:, n:]
    if other.shape[1]:
        weak: FloatArray = np.eye(other.shape[1])
        own = own - other @ np.linalg.solve(other.T @ other + weak, other.T @ own)
    singular = np.linalg.svd(own, compute_uv=False)
    return float(singular[0] / max(singular[-1], 1e-300))


def _weaker_findings(problem: Problem, observed: Observed) -> list[Finding]:
    """Return what makes a verdict weaker: noise that was estimated, and missing phases."""
    findings = []
    if observed.noise is None and problem.observed.noise is not None:
        share = _noise_over_level(problem.observed)
        sentence = (
            f"The noise was unspecified; what the fit leaves ({share:.1%} of the level) was "
            "taken for it. A model that does not fit cannot be distinguished from noise then."
        )
        evidence = {"noise_over_level": share}
        findings.append(Finding(Code.NOISE_ESTIMATED, About(), sentence, evidence))
    if not observed.has_phase:
        sentence = (
            "Only levels were given. Other walls than those found may explain them; phases would "
            "show which."
        )
        findings.append(Finding(Code.LEVELS_ONLY, About(), sentence))
    return findings


def _noise_over_level(observed: Observed) -> float:
    noise = 0.0 if observed.noise is None else float(observed.noise.mean())
    return noise / float(np.mean(level_at(observed)))


def _verdict(
    fit: ImpedanceFit,
    rivals: tuple[ImpedanceFit, ...],
    observed: Observed,
    materials: tuple[result.MaterialImpedance, ...],
) -> tuple[result.Verdict, list[Finding]]:
    chi2, octaves = reduced_chi2(fit), _chi2_by_octave(fit)
    loud = _noise_over_level(fit.problem.observed) > LOUDEST_ESTIMATED_NOISE
    loud = loud and observed.noise is None
    if loud or chi2 > CHI2_LIMIT or max((c for _, c in octaves), default=0.0) > OCTAVE_CHI2_LIMIT:
        loudest = "what the fit leaves is larger than any noise should be"
        cause = loudest if loud else _likely_cause(octaves)
        sentence = (
            f"The model does not fit: it leaves {chi2:.1f} times the expected squares."
            f" Likely cause: {cause}."
        )
        evidence = {"chi2": chi2, "cause": cause}
        code, advice = Code.IMPEDANCE_DOES_NOT_FIT, " Do not use the walls found."
        finding = Finding(code, About(), sentence + advice, evidence)
        return result.Verdict("does not fit", cause, sentence), [finding]
    unsure = [m.name for m in materials if float(np.mean(m.identified)) < ENOUGH_FREQUENCIES]
    if not (rivals or unsure):
        sentence = f"Identified: the residual is {chi2:.2f} of what noise and model error allow."
        return result.Verdict("identified", "", sentence), []
    cause = f"the data hardly depend on {', '.join(unsure)}"
    cause = "other walls explain the data as well" if rivals else cause
    sentence, code = f"Not identifiable: {cause}.", Code.IMPEDANCE_NOT_IDENTIFIABLE
    advice = " More pairs, or pairs nearer to the walls concerned, would help."
    evidence = {"rivals": len(rivals), "materials": unsure}
    finding = Finding(code, About(materials=unsure), sentence + advice, evidence)
    return result.Verdict("not identifiable", cause, sentence), [finding]


def _chi2_by_octave(fit: ImpedanceFit) -> list[tuple[float, float]]:
    """Return the upper end (Hz) of each octave of the data, and its mean square residual."""
    f = fit.problem.observed.frequency_hz
    n_pairs = len(fit.problem.observed.pressure)
    square = np.reshape(fit.residual**2, (-1, n_pairs, len(f))).mean(axis=(0, 1))
    share = max(1.0 - fit.effective / len(fit.residual), 1e-3)
    found, low = [], float(f[0])
    while low < f[-1]:
        own = (f >= low) & (f <= 2.0 * low)
        if own.any():
            found.append((float(min(2.0 * low, f[-1])), float(square[own].mean()) / share))
        low *= 2.0
    return found


def _likely_cause(octaves: list[tuple[float, float]]) -> str:
    rest = [c for _, c in octaves[1:]]
    if rest and octaves[0][1] > OCTAVE_CHI2_LIMIT and max(rest) <= CHI2_LIMIT:
        return (
            f"low frequency: only below {octaves[0][0]:.0f} Hz, where image sources are a "
            "poor picture of waves"
        )
    return (
        "positions, gains or spectra of sources that are not the specified ones, walls that do not "
        "react locally (thick soft layers), patches, scattering, or another room than was described"
    )
