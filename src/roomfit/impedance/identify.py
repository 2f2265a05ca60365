"""The acoustic impedance of a room's walls from measured pressures: from data to a verdict.

Whether there are enough data, noise by the residual, misfit and its cause.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from roomfit.base.arguments import check_known, check_range, check_shape
from roomfit.base.errors import InputError
from roomfit.base.findings import About, Code, Finding
from roomfit.base.kernels import one_blas_thread
from roomfit.base.typing import ComplexArray, FloatArray, Progress, part
from roomfit.impedance.data import (
    MODEL_ERROR,
    PLANE_MODEL_ERROR,
    Observed,
    complex_frequency_hz,
    deviation,
    level_at,
    model_error,
    smoothed,
)
from roomfit.impedance.fit import (
    SAME_WITHIN,
    ImpedanceFit,
    Problem,
    Start,
    distance,
    distinct,
    factor_of,
    marginal_likelihood_error,
    multistart,
    polish,
    reduced_chi2,
    robust_covariance,
    source_spectra,
    state_of,
)
from roomfit.impedance.laws import WallKind, curve_of
from roomfit.impedance.result import (
    Z95,
    Estimate,
    ImpedanceResult,
    MaterialImpedance,
    Verdict,
    material_impedance,
)
from roomfit.impedance.wave_model import Nuisances, predicted_pressure, wave_model
from roomfit.room.scene import Scene, pair_names

_LOG = logging.getLogger("roomfit")

# Another minimum whose cost at first sight is at most this many times the lowest is followed, too.
_RIVAL = 1.5


@dataclass(frozen=True, slots=True)
class ImpedanceSettings:
    """How impedances are searched for, and with which image model.

    Examples
    --------
    >>> ImpedanceSettings(random_starts=10).spherical
    True
    """

    random_starts: int = 3  # random walls from which the search starts besides the usual ones
    spherical: bool = True  # False takes waves at the walls as plane, which errs 5 times as much
    # rms error of the image model itself, relative to the level, times wavenumber and mean free
    # path; None: 0.16, or 1.3 with plane waves, as measured against exact wave fields. Less only
    # for data that another image model made
    model_error: float | None = None

    def __post_init__(self) -> None:
        check_range("random_starts", self.random_starts, 0.0, np.inf)
        check_range("model_error", self.model_error or 0.0, 0.0, np.inf)


@one_blas_thread
def identify_impedance(
    scene: Scene,
    observed: Observed,
    walls: Mapping[str, WallKind] | None = None,
    nuisances: Nuisances | None = None,
    *,
    rng: np.random.Generator,
    settings: ImpedanceSettings | None = None,
    progress: Progress | None = None,
) -> ImpedanceResult:
    """Return the reflection coefficient, absorption and impedance of every material of a room.

    Pressures of image sources with spherical waves at locally reacting walls are fitted to the
    measured ones by least squares, the reflection coefficient R0 of each material being a smooth
    curve over frequency; positions, speed of sound, gains and clocks are
    estimated with them. The method and its limits are described in docs/impedance.md.

    Parameters
    ----------
    scene : Scene
        Room, positions (m) and air; its pairs in the order of the pressures.
    observed : Observed
        Damped spectra, shape (n_pairs, n_frequencies); frequencies in Hz, pressures in any unit.
    walls : mapping of material to "spline" or "constant", optional
        How R0 is to depend on frequency; materials that are left out are splines.
    nuisances : Nuisances, optional
        What may be wrong about the measurement; left out: positions by 10 mm a coordinate unless
        the scene specifies less, the speed of sound by 1 %, gains known.
    rng : numpy Generator
        Draws starts; the same generator gives the same result.
    settings : ImpedanceSettings, optional
    progress : callable, optional
        Called with the fraction that is done, 0 to 1.

    Returns
    -------
    ImpedanceResult
        Of every material R0, absorption (0 to 1), admittance and impedance (relative to those of
        air), each with its 95 % interval, shape (n_frequencies,), and a  Where the data
        cannot determine the unknowns, nothing is fitted and the verdict says so.

    Raises
    ------
    InputError
        Data, walls and scene do not belong together, or there are more paths than minutes suffice
        for.

    References
    ----------
    The spherical reflection is that of C. F. Chien, W. W. Soroka, J. Sound Vib. 43, 9-20 (1975);
    see `roomfit.impedance.wave_model`.

    Examples
    --------
    A box with one material of R0 = 0.6 at every frequency; pressures by the image model itself.

    >>> from roomfit.impedance.wave_model import at_rest, predicted_pressure, wave_model
    >>> from roomfit.room.scene import scene_of, shoebox_room
    >>> room = shoebox_room((5.0, 4.0, 3.0), "walls")
    >>> receivers = {"R1": (3.7, 2.8, 2.1), "R2": (1.0, 2.9, 0.8)}
    >>> scene = scene_of(room, {"S": (1.2, 1.1, 1.3)}, receivers)
    >>> f = np.arange(200.0, 301.0, 20.0)
    >>> model = wave_model(scene, f, 0.004)
    >>> p = predicted_pressure(model, np.full((1, 6), 0.6 + 0j), at_rest(model))
    >>> observed = Observed(f, 0.004, p, np.full(p.shape, 1e-4))
    >>> walls = {"walls": "constant"}
    >>> known, rng = Nuisances(position_sd_m=0.0, speed_sd=0.0), np.random.default_rng(1)
    >>> result = identify_impedance(scene, observed, walls, known, rng=rng)
    >>> result.verdict.word, bool(abs(result.materials[0].r0[0] - 0.6) < 0.01)
    ('identified', True)
    """
    began = time.perf_counter()
    problem = wave_problem(scene, observed, walls, nuisances, settings)
    findings = data_findings(problem)
    if findings:
        return result_without_fit(problem, findings)
    n_random = (settings or ImpedanceSettings()).random_starts
    _LOG.info("searching starts")
    starts = multistart(problem, n_random, rng, part(progress, 0.0, 0.3))
    _LOG.info("fitting impedances")
    fit = polish(problem, starts[0].x, progress=part(progress, 0.3, 0.6))
    rivals = _rivals(problem, starts, fit)
    if observed.noise is None:
        shown = replace(observed, noise=estimated_noise(fit))
        sd = _deviation(scene, shown, problem.model_error)
        fit = polish(replace(problem, observed=shown, sd=sd), fit.x, fit.roughness_sd)
    if progress is not None:
        progress(0.9)
    result = judged_result(fit, starts, rivals, observed)
    return replace(result, seconds=time.perf_counter() - began)


def wave_problem(
    scene: Scene,
    observed: Observed,
    walls: Mapping[str, WallKind] | None = None,
    nuisances: Nuisances | None = None,
    settings: ImpedanceSettings | None = None,
) -> Problem:
    """Return what `identify_impedance` solves first; arguments and errors as there."""
    settings, nuisances = settings or ImpedanceSettings(), nuisances or Nuisances()
    walls = walls or {}
    check_shape("pressures of the pairs of the scene", observed.pressure, (len(scene.pairs), None))
    if nuisances.free_spectra and not observed.has_phase:
        what = "an unknown spectrum of the source needs pressures with phase"
        needed, hint = "pressures with phase", "take one gain a source instead"
        raise InputError(what, found="levels", needed=needed, hint=hint)
    for name in walls:
        what = "a model is specified for a wall that does not exist"
        check_known(what, name, scene.room.materials)
    factor = MODEL_ERROR if settings.spherical else PLANE_MODEL_ERROR
    factor = factor if settings.model_error is None else settings.model_error
    f = complex_frequency_hz(observed)
    curves = tuple(curve_of(walls.get(name, "spline"), f) for name in scene.room.materials)
    model = wave_model(scene, observed.frequency_hz, observed.tau_s)
    sd = _deviation(scene, observed, factor)
    return Problem(model, observed, sd, curves, nuisances, settings.spherical, factor)


def _deviation(scene: Scene, observed: Observed, factor: float) -> FloatArray:
    # exact data and an exact model: rounding, and images beyond the last
    return np.maximum(deviation(scene, observed, factor), 1e-4 * level_at(observed))


def _rivals(
    problem: Problem, starts: tuple[Start, ...], fit: ImpedanceFit
) -> tuple[ImpedanceFit, ...]:
    """Return fits of other minima that explain the data as well as the lowest does."""
    found = []
    for start in distinct(starts)[1:]:
        if start.cost > _RIVAL * starts[0].cost:
            continue
        other = polish(problem, start.x)
        as_good = reduced_chi2(other) <= max(1.2 * reduced_chi2(fit), 1.0)
        if as_good and distance(other.r0, fit.r0) > 5.0 * SAME_WITHIN:
            found.append(other)
    return tuple(found)


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
    observed, curves = problem.observed, problem.curves
    (n_pairs, n_f), n_materials = observed.pressure.shape, len(curves)
    needed = sum(2 * c.basis.shape[1] for c in curves)
    needed += sum(label.unit in ("dB", "rad") for label in problem.layout.labels)
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
) -> ImpedanceResult:
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
        agreeing_starts=sum(distance(s.r0, starts[0].r0) <= SAME_WITHIN for s in starts),
        n_starts=len(starts),
        predicted=_predicted_pairs(fit),
        ending=fit.ending.advice,
        evaluations=fit.evaluations,
    )


def result_without_fit(problem: Problem, findings: tuple[Finding, ...]) -> ImpedanceResult:
    """Return the result where the data cannot determine the unknowns: nothing but that."""
    names, n_f = problem.model.scene.room.materials, len(problem.observed.frequency_hz)
    nothing, unbounded = np.zeros(n_f, dtype=np.complex128), np.tile(1e6 * np.eye(2), (n_f, 1, 1))
    materials = (material_impedance(m, "none", nothing, unbounded) for m in names)
    return replace(_of_data(problem), materials=tuple(materials), findings=findings)


def _of_data(problem: Problem) -> ImpedanceResult:
    """Return a result that says nothing yet but what was measured."""
    observed, cause = problem.observed, "too few data"
    return ImpedanceResult(
        frequency_hz=observed.frequency_hz,
        tau_s=observed.tau_s,
        materials=(),
        verdict=Verdict("not identifiable", cause, f"Not identifiable: {cause}."),
        findings=(),
        pairs=tuple(name[:2] for name in pair_names(problem.model.scene)),
        measured=observed.pressure,
        predicted=np.zeros_like(observed.pressure),
    )


def _material_impedances(
    fit: ImpedanceFit, error: float, covariance: FloatArray
) -> tuple[MaterialImpedance, ...]:
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
        found.append(material_impedance(name, curve.kind, fit.r0[i], own))
    return tuple(found)


def _found_nuisances(fit: ImpedanceFit, covariance: FloatArray) -> tuple[Estimate, ...]:
    """Return every nuisance of a fit with its interval, in the order of the unknowns."""
    sd, found = np.sqrt(np.maximum(np.diag(covariance), 0.0)), []
    labels = fit.problem.layout.labels
    for at, (name, unit, scale, _) in enumerate(labels, start=len(fit.x) - len(labels)):
        middle = fit.problem.model.speed_m_s if unit == "m/s" else 0.0
        value, reach = middle + fit.x[at] * scale, Z95 * sd[at] * scale
        found.append(Estimate(name, unit, value, value - reach, value + reach, scale))
    return tuple(found)


def _predicted_pairs(fit: ImpedanceFit) -> ComplexArray:
    """Return the predicted pressures with gains and delays, (n_pairs, n_frequencies)."""
    problem, state = fit.problem, state_of(fit.problem, fit.x)
    short = predicted_pressure(problem.model, fit.r0, state, spherical=False, short=True)
    predicted = factor_of(problem, fit.x) * (short + fit.correction)
    spectra = source_spectra(problem, predicted) if problem.nuisances.free_spectra else 1.0
    return np.asarray(predicted * spectra)


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
    materials: tuple[MaterialImpedance, ...],
) -> tuple[Verdict, list[Finding]]:
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
        return Verdict("does not fit", cause, sentence), [finding]
    unsure = [m.name for m in materials if float(np.mean(m.identified)) < ENOUGH_FREQUENCIES]
    if not (rivals or unsure):
        sentence = f"Identified: the residual is {chi2:.2f} of what noise and model error allow."
        return Verdict("identified", "", sentence), []
    cause = f"the data hardly depend on {', '.join(unsure)}"
    cause = "other walls explain the data as well" if rivals else cause
    sentence, code = f"Not identifiable: {cause}.", Code.IMPEDANCE_NOT_IDENTIFIABLE
    advice = " More pairs, or pairs nearer to the walls concerned, would help."
    evidence = {"rivals": len(rivals), "materials": unsure}
    finding = Finding(code, About(materials=unsure), sentence + advice, evidence)
    return Verdict("not identifiable", cause, sentence), [finding]


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
