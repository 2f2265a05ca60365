"""Everything told of a wall, with 95 % intervals, from the covariance of a fit.

What an identification of impedances comes to.

Are there data enough? Asked before anything is computed.

From a fit to an answer: what it found, what is doubtful, and the verdict.

The noise of a measurement that does not tell it, by what a fit leaves.

What a fit found besides the walls, and what it predicts.

Whether the walls were identified, cannot be, or are not what the model takes them for.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from roomfit._checks import read_only
from roomfit.findings import Code, Finding
from roomfit.geometry.mesh import mean_free_path_m
from roomfit.impedance.data import Observed, level_at, model_error
from roomfit.impedance.fit import ImpedanceFit, Start, WallModel, reduced_chi2, share_in_best
from roomfit.impedance.laws import (
    LAWS,
    LawCurve,
    absorption_normal,
    absorption_random,
    impedance_of_r0,
)
from roomfit.impedance.problem import Problem, data_rows, factor_of, layout_of, source_spectra
from roomfit.impedance.wave_model import Nuisances, gradients, has_free_spectra
from roomfit.scene import Scene
from roomfit.typing import BoolArray, ComplexArray, FloatArray

# Frequencies from which a curve couples them, so that phases can be done without.
_COUPLED = 4


def data_findings(problem: Problem, walls: dict[str, WallModel]) -> tuple[Finding, ...]:
    """Return a serious finding where the data cannot hold the unknowns, whatever they say.

    Two numbers a pair and frequency (levels: one), less the gains that are unknown, must be at
    least the numbers of the walls; and frequency by frequency, where nothing couples them, one pair
    more than materials [1]_: with as many there are other exact solutions.

    References
    ----------
    .. [1] docs/impedance.md
    """
    observed = problem.observed
    n_pairs, n_f = observed.pressure.shape
    n_materials = len(problem.curves)
    if n_f < _COUPLED and not observed.has_phase:
        return (
            Finding(
                Code.TOO_FEW_DATA,
                f"Levels without phase at {_frequencies(n_f)} do not tell a wall from others that "
                "reflect as much with another phase. Give phases, or levels over a whole band.",
                {"pairs": n_pairs, "frequencies": n_f},
            ),
        )
    if n_f < _COUPLED and n_pairs < n_materials + 1:
        return (
            Finding(
                Code.TOO_FEW_DATA,
                f"{n_pairs} pair{'s' * (n_pairs != 1)} at {_frequencies(n_f)} cannot tell "
                f"{n_materials} materials apart: {n_materials + 1} pairs are needed, or "
                "frequencies that a smooth curve couples.",
                {"pairs": n_pairs, "materials": n_materials, "frequencies": n_f},
            ),
        )
    needed = sum(_numbers(problem, i, w) for i, w in enumerate(walls.values()))
    n_sources = len(np.unique(problem.model.scene.pairs[:, 0]))
    data = (2 if observed.has_phase else 1) * n_pairs * n_f
    if has_free_spectra(problem.nuisances):
        data -= 2 * n_sources * n_f
    layout = layout_of(problem)
    needed += layout.gain.stop - layout.gain.start
    if data >= needed:
        return ()
    return (
        Finding(
            Code.TOO_FEW_DATA,
            f"{data} numbers were measured, besides what the gains take, and {needed} are unknown: "
            "measure more pairs, or tell the gain or the laws of some walls.",
            {"data": data, "unknowns": needed},
        ),
    )


def _numbers(problem: Problem, material: int, wall: WallModel) -> int:
    if wall.kind in LAWS:
        return len(LAWS[wall.kind][1])
    return len(problem.curves[material].start)


def _frequencies(n: int) -> str:
    return "one frequency" if n == 1 else f"{n} frequencies"


_REACH = 1.959964
# R0 counts as identified where its interval is no wider, Z is shown where its is, relative.
WIDEST_R0 = 0.2
WIDEST_Z = 0.2
_STEP = 1e-6
# How far the image model's error moves a soft wall's R0, over what the residual shows of it: most
# probable for 26 boxes with walls at random, see docs/impedance.md.
_OFFSET = 2.4


@dataclass(frozen=True, slots=True, eq=False)
class MaterialAnswer:
    """What was found of one material, over frequency.

    Every pair of `_lower95` and `_upper95` is a 95 % interval of real numbers.

    Attributes
    ----------
    name, kind : str
        `kind` is the curve that was fitted: spline, miki, resonator, panel or constant.
    r0 : complex array, shape (n_frequencies,)
    r0_lower95, r0_upper95 : complex arrays
        Real and imaginary parts hold the limits of those of `r0`.
    absorption_normal, absorption_random : float arrays, shape (n_frequencies,)
        And their `_lower95` and `_upper95`.
    admittance, admittance_lower95, admittance_upper95 : complex arrays
    impedance, impedance_lower95, impedance_upper95 : complex arrays
        nan where `impedance_shown` is false.
    impedance_shown : bool array
        Where the interval of Z is no wider than a fifth of its size.
    identified : bool array
        Where the intervals of real and imaginary part of R0 are no wider than 0.2.
    parameters : tuple of (name, unit, value, lower95, upper95)
        Of a physical law; empty for a spline.
    """

    name: str
    kind: str
    r0: ComplexArray
    r0_lower95: ComplexArray
    r0_upper95: ComplexArray
    absorption_normal: FloatArray
    absorption_normal_lower95: FloatArray
    absorption_normal_upper95: FloatArray
    absorption_random: FloatArray
    absorption_random_lower95: FloatArray
    absorption_random_upper95: FloatArray
    admittance: ComplexArray
    admittance_lower95: ComplexArray
    admittance_upper95: ComplexArray
    impedance: ComplexArray
    impedance_lower95: ComplexArray
    impedance_upper95: ComplexArray
    impedance_shown: BoolArray
    identified: BoolArray
    parameters: tuple[tuple[str, str, float, float, float], ...] = ()

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            if isinstance(value, np.ndarray):
                read_only(value)


def material_answers(fit: ImpedanceFit) -> tuple[MaterialAnswer, ...]:
    """Return what a fit tells of every material.

    Besides noise, the intervals hold what the image model itself gets wrong. That does not average
    out over frequencies and pairs. A wave front that is not plane strikes as if its angle were
    another by some ``1 / (k r)``, and R changes with the cosine as ``1 - R0**2``: R0 is taken to be
    off by ``|1 - R0**2|`` times 2.4 of the model's own error as it is found in the room, see
    `model_error`.
    """
    share = _model_share(fit)
    answers = []
    for i, name in enumerate(fit.problem.model.scene.room.materials):
        place, curve = fit.layout.curves[i], fit.problem.curves[i]
        own = fit.covariance[place, place]
        slope = curve.slope(fit.x[place])
        parts = np.stack([slope.real, slope.imag], axis=1)
        off = share * np.abs(1.0 - fit.r0[i] ** 2)
        spread = np.einsum("fai,ij,fbj->fab", parts, own, parts)
        spread = spread + 0.5 * (off**2)[:, None, None] * np.eye(2)
        parameters: tuple[tuple[str, str, float, float, float], ...] = ()
        if isinstance(curve, LawCurve):
            own = own + _off_law(parts, off, fit.problem.observed.frequency_hz)
            parameters = _law_parameters(curve, fit.x[place], own)
        answers.append(material_answer(name, curve.kind, fit.r0[i], spread, parameters))
    return tuple(answers)


def _model_share(fit: ImpedanceFit) -> FloatArray:
    problem = fit.problem
    model = problem.model
    return model_error(
        problem.observed.frequency_hz,
        mean_free_path_m(model.scene.room.mesh),
        model.speed_m_s,
        _OFFSET * fit.model_error,
    )


def _off_law(parts: FloatArray, off: FloatArray, frequency_hz: FloatArray) -> FloatArray:
    """Return the covariance of a law's numbers from errors of R0 that are alike over an octave."""
    n_f = len(frequency_hz)
    octaves = max(float(np.log2(frequency_hz[-1] / frequency_hz[0])), 1.0)
    inverse = np.linalg.pinv(parts.reshape(2 * n_f, -1))
    scaled = inverse * np.repeat(off, 2) * np.sqrt(0.5 * max(n_f / octaves, 1.0))
    return np.asarray(scaled @ scaled.T)


def material_answer(
    name: str,
    kind: str,
    r0: ComplexArray,
    spread: FloatArray,
    parameters: tuple[tuple[str, str, float, float, float], ...] = (),
) -> MaterialAnswer:
    """Return all quantities of a material with their intervals.

    Parameters
    ----------
    r0 : complex array, shape (n_frequencies,)
        Passive.
    spread : float array, shape (n_frequencies, 2, 2)
        Covariance of real and imaginary part of R0.
    """
    reach = _reach(spread, np.ones(len(r0), dtype=np.complex128))
    normal = absorption_normal(r0)
    dn, below_normal = _normal_reach(spread, r0)
    random = absorption_random(r0)
    # inside the disc, so that the steps meet walls that absorb
    inner = r0 * (1.0 - 2.0 * _STEP)
    at = absorption_random(inner)
    by = [(absorption_random(inner + d) - at) / _STEP for d in (_STEP, 1j * _STEP)]
    dr = _real_reach(spread, np.stack(by, axis=1))
    below = np.where(np.abs(1.0 + r0) < 1e-9, 1e-9, 1.0 + r0)
    admittance = (1.0 - r0) / below
    da = _reach(spread, np.asarray(-2.0 / below**2))
    above = np.where(np.abs(1.0 - r0) < 1e-9, 1e-9, 1.0 - r0)
    dz = _reach(spread, np.asarray(2.0 / above**2))
    z = impedance_of_r0(r0)
    shown = 2.0 * np.maximum(dz.real, dz.imag) <= WIDEST_Z * np.abs(z)
    unknown = complex(np.nan, np.nan)
    return MaterialAnswer(
        name=name,
        kind=kind,
        r0=r0,
        r0_lower95=_box(r0 - reach, -1.0, 1.0),
        r0_upper95=_box(r0 + reach, -1.0, 1.0),
        absorption_normal=normal,
        absorption_normal_lower95=np.clip(normal - dn - below_normal, 0.0, 1.0),
        absorption_normal_upper95=np.clip(normal + dn, 0.0, 1.0),
        absorption_random=random,
        absorption_random_lower95=np.clip(random - dr, 0.0, 1.0),
        absorption_random_upper95=np.clip(random + dr, 0.0, 1.0),
        admittance=admittance,
        admittance_lower95=admittance - da,
        admittance_upper95=admittance + da,
        impedance=np.where(shown, z, unknown),
        impedance_lower95=np.where(shown, z - dz, unknown),
        impedance_upper95=np.where(shown, z + dz, unknown),
        impedance_shown=shown,
        identified=2.0 * np.maximum(reach.real, reach.imag) <= WIDEST_R0,
        parameters=parameters,
    )


def unknown_answer(name: str, kind: str, n_frequencies: int) -> MaterialAnswer:
    """Return the answer for a material of which nothing is known."""
    nothing = np.zeros(n_frequencies, dtype=np.complex128)
    return material_answer(name, kind, nothing, np.tile(1e6 * np.eye(2), (n_frequencies, 1, 1)))


def _reach(spread: FloatArray, by_r0: ComplexArray) -> ComplexArray:
    """Return half the interval of real and imaginary part of what changes by `by_r0` dR0."""
    real = np.stack([by_r0.real, -by_r0.imag], axis=1)
    imaginary = np.stack([by_r0.imag, by_r0.real], axis=1)
    return np.asarray(_real_reach(spread, real) + 1j * _real_reach(spread, imaginary))


def _real_reach(spread: FloatArray, by: FloatArray) -> FloatArray:
    variance = np.einsum("fa,fab,fb->f", by, spread, by)
    return np.asarray(_REACH * np.sqrt(np.maximum(variance, 0.0)))


def _normal_reach(spread: FloatArray, r0: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Return half the interval of ``1 - |R0|**2``, and how far its mean lies below the value.

    With the second order, without which a wall that is matched, R0 = 0, would be known exactly: of
    a normal R0 with mean r and covariance S the square has the variance
    ``4 r S r + 2 trace(S S)`` and a mean that is larger by ``trace(S)``.
    """
    parts = np.stack([r0.real, r0.imag], axis=1)
    first = np.einsum("fa,fab,fb->f", parts, spread, parts)
    second = np.einsum("fab,fba->f", spread, spread)
    reach = _REACH * np.sqrt(np.maximum(4.0 * first + 2.0 * second, 0.0))
    return np.asarray(reach), np.asarray(np.trace(spread, axis1=1, axis2=2))


def _box(value: ComplexArray, low: float, high: float) -> ComplexArray:
    return np.asarray(np.clip(value.real, low, high) + 1j * np.clip(value.imag, low, high))


def _law_parameters(
    curve: LawCurve, x: FloatArray, covariance: FloatArray
) -> tuple[tuple[str, str, float, float, float], ...]:
    reach = _REACH * np.sqrt(np.maximum(np.diag(covariance), 0.0))
    value, lower, upper = (curve.values(at) for at in (x, x - reach, x + reach))
    return tuple(
        (p.name, p.unit, float(value[i]), float(lower[i]), float(upper[i]))
        for i, p in enumerate(curve.parameters)
    )


# Frequencies that are taken together differ by less in their logarithm, and tell at least so many
# residuals.
_NEAR = 0.2
_LEAST = 24
# Medians over means of squares of normal numbers: of complex ones, and of real ones.
_COMPLEX_MEDIAN, _REAL_MEDIAN = math.log(2.0), 0.4549364
# Of the error that is allowed to the model: no noise is less.
_FLOOR = 1e-3


def estimated_noise(fit: ImpedanceFit) -> FloatArray:
    """Return the rms noise of every pair and frequency, by the residual of a fit without noise.

    A smooth function of frequency, the same for all pairs: medians of the squared residuals over
    neighbours in frequency and over pairs, so that a few bad pairs or frequencies do not count,
    averaged once more; half of the error that is allowed to the model itself is taken off.

    Returns
    -------
    float array, shape (n_pairs, n_frequencies)
        In the unit of the pressure.
    """
    problem = fit.problem
    n_pairs, n_f = problem.sd.shape
    # each row has the variance of one, of real and imaginary part or of the level
    square = np.reshape(fit.residual**2, (-1, n_pairs, n_f)).mean(axis=0) * problem.sd**2
    free = max(1.0 - fit.effective / len(fit.residual), 1e-2)
    near = _neighbours(problem.observed.frequency_hz, n_pairs)
    usual = _COMPLEX_MEDIAN if problem.observed.has_phase else _REAL_MEDIAN
    middle = np.array([np.median(square[:, own]) for own in near]) / (usual * free)
    smooth = (near @ middle) / near.sum(axis=1)
    allowed = np.mean(problem.sd**2, axis=0)
    noise = np.sqrt(np.maximum(smooth - 0.5 * allowed, _FLOOR * allowed))
    return np.tile(noise, (n_pairs, 1))


def _neighbours(frequency_hz: FloatArray, n_pairs: int) -> BoolArray:
    """Return which frequencies are taken together with each, (n_frequencies, n_frequencies)."""
    apart = np.abs(np.log(frequency_hz[:, None] / frequency_hz))
    least = min(math.ceil(_LEAST / n_pairs), len(frequency_hz))
    enough = np.sort(apart, axis=1)[:, least - 1]
    return np.asarray(apart <= np.maximum(enough, _NEAR)[:, None])


Word = Literal["identified", "not identifiable", "does not fit"]

# Of squares over what is expected; the allowance for the model's own error is a generous one, so
# that good fits come to between 0.2 and 1.2.
CHI2_LIMIT = 1.6
OCTAVE_CHI2_LIMIT = 2.5
# Share of frequencies at which a material must be identified.
ENOUGH_FREQUENCIES = 0.8
# A cause that frees very many numbers must lower the squares to this share of them.
_FAR_BETTER = 0.2
# Noise estimated from what a fit leaves: above this share of the level it does not fit.
LOUDEST_ESTIMATED_NOISE = 0.15


@dataclass(frozen=True, slots=True)
class Verdict:
    """How a fit is to be taken.

    Attributes
    ----------
    word : {"identified", "not identifiable", "does not fit"}
    cause : str
        "" where identified.
    sentence : str
    weaker : bool
        Whether noise was estimated from the residual, or phases were missing.
    """

    word: Word
    cause: str
    sentence: str
    weaker: bool


def chi2_by_octave(fit: ImpedanceFit) -> tuple[tuple[float, float, float], ...]:
    """Return lower and upper end (Hz) of each octave of the data, and its mean square residual."""
    f = fit.problem.observed.frequency_hz
    n_pairs = len(fit.problem.observed.pressure)
    square = np.reshape(fit.residual**2, (-1, n_pairs, len(f))).mean(axis=(0, 1))
    share = max(1.0 - fit.effective / len(fit.residual), 1e-3)
    edges = [float(f[0])]
    while edges[-1] < f[-1]:
        edges.append(2.0 * edges[-1])
    found = []
    for low, high in pairwise(edges):
        own = (f >= low) & (f <= high)
        if own.any():
            top = float(min(high, f[-1]))
            found.append((low, top, float(square[own].mean()) / share))
    return tuple(found)


def fits(fit: ImpedanceFit) -> bool:
    """Return whether a fit leaves no more than noise and the model's own error."""
    worst = max((c for _, _, c in chi2_by_octave(fit)), default=0.0)
    return reduced_chi2(fit) <= CHI2_LIMIT and worst <= OCTAVE_CHI2_LIMIT


def likely_cause(fit: ImpedanceFit, again: Callable[[Problem], ImpedanceFit]) -> str:
    """Return why a model does not fit, by what makes it fit.

    Parameters
    ----------
    fit : ImpedanceFit
    again : callable
        Fits a changed problem from its start.
    """
    octaves = chi2_by_octave(fit)
    if len(octaves) > 1 and octaves[0][2] > OCTAVE_CHI2_LIMIT:
        rest = [c for _, _, c in octaves[1:]]
        if max(rest) <= CHI2_LIMIT:
            return (
                f"low frequency: only below {octaves[0][1]:.0f} Hz, where image sources are a "
                "poor picture of waves"
            )
    nuisances = fit.problem.nuisances
    before = reduced_chi2(fit)
    for cause, freed in (
        ("positions or the speed of sound", _free_geometry(nuisances)),
        ("the gain", _free_gain(nuisances)),
        ("positions and the gain", _free_gain(_free_geometry(nuisances))),
    ):
        if freed == nuisances:
            continue
        other = again(replace(fit.problem, nuisances=freed))
        after = reduced_chi2(other)
        if fits(other) or after < 0.1 * before:
            return f"{cause}: the residual falls from {before:.1f} to {after:.1f} with them free"
    if not has_free_spectra(nuisances) and _spectra_are_identifiable(fit.problem):
        spectra = replace(
            _free_geometry(nuisances),
            gain="pair-spectrum" if nuisances.gain == "pair" else "spectrum",
        )
        after = reduced_chi2(again(replace(fit.problem, nuisances=spectra)))
        # so many free numbers make any fit better
        if after < _FAR_BETTER * before:
            return (
                "sources whose spectra are not flat or not the ones told: the residual falls from "
                f"{before:.1f} to {after:.1f} with them free"
            )
    return (
        "walls that do not react locally (thick soft layers), patches, scattering, a loudspeaker "
        "that does not radiate alike in all directions, or another room than was described: "
        "neither positions nor gains explain it"
    )


def _spectra_are_identifiable(problem: Problem) -> bool:
    """Whether each source has been heard at two places and more, phases and all."""
    counts = np.unique(problem.model.scene.pairs[:, 0], return_counts=True)[1]
    return problem.observed.has_phase and bool(counts.min() >= 2)


def _free_geometry(nuisances: Nuisances) -> Nuisances:
    return replace(
        nuisances,
        position_sd_m=max(nuisances.position_sd_m, 0.02),
        least_position_sd_m=max(nuisances.least_position_sd_m, 0.02),
        speed_sd=max(nuisances.speed_sd, 0.01),
    )


def _free_gain(nuisances: Nuisances) -> Nuisances:
    return replace(nuisances, gain="source") if nuisances.gain in ("known", "common") else nuisances


def enough_identified(materials: tuple[MaterialAnswer, ...]) -> FloatArray:
    """Return the share of frequencies at which each material is identified."""
    return np.array([float(np.mean(m.identified)) for m in materials])


@dataclass(frozen=True, slots=True)
class FoundNuisance:
    """Something about the measurement that was found together with the walls.

    Attributes
    ----------
    name : str
        Such as "x of LS1" or "speed of sound".
    unit : str
    value, lower95, upper95 : float
        With its 95 % interval; moves are from the told position.
    prior_sd : float
        What was allowed beforehand, in the same unit.
    """

    name: str
    unit: str
    value: float
    lower95: float
    upper95: float
    prior_sd: float


@dataclass(frozen=True, slots=True, eq=False)
class ImpedanceAnswer:
    """The walls of a room, and how far to trust what is said of them.

    Attributes
    ----------
    frequency_hz : float array, shape (n_frequencies,)
    tau_s : float
    materials : tuple of MaterialAnswer
    verdict : Verdict
    findings : tuple of Finding
    nuisances : tuple of FoundNuisance
    chi2 : float
        Sum of squared residuals over what noise and model error explain; 1 and less is good. nan
        where nothing was fitted.
    model_error : float
        rms error of the image model in this room by the residual, relative to the level, times
        wavenumber and mean free path. nan where nothing was fitted.
    condition : float
        Of the walls' unknowns: largest over smallest singular value of the weighted Jacobian, what
        nuisances explain taken out. nan where nothing was fitted.
    agreeing_starts, n_starts : int
        How many starts led to the lowest minimum, of how many.
    pairs : tuple of (source, receiver)
    measured, predicted : complex arrays, shape (n_pairs, n_frequencies)
        Gains and delays are in the prediction.
    expected_rms : float array, shape (n_pairs, n_frequencies)
        rms by which a perfect fit still misses: noise and the model's own error.
    ending : str
    evaluations, rounds : int
    seconds : float
    seed : int or None
    """

    frequency_hz: FloatArray
    tau_s: float
    materials: tuple[MaterialAnswer, ...]
    verdict: Verdict
    findings: tuple[Finding, ...]
    nuisances: tuple[FoundNuisance, ...]
    chi2: float
    model_error: float
    condition: float
    agreeing_starts: int
    n_starts: int
    pairs: tuple[tuple[str, str], ...]
    measured: ComplexArray
    predicted: ComplexArray
    expected_rms: FloatArray
    ending: str
    evaluations: int
    rounds: int
    seconds: float
    seed: int | None = None


_AXES = "xyz"
_DB = 20.0 / np.log(10.0)


def found_nuisances(fit: ImpedanceFit) -> tuple[FoundNuisance, ...]:
    """Return every nuisance of a fit with its interval, in the order of the unknowns."""
    problem, layout, x = fit.problem, fit.layout, fit.x
    sd = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    scene, nuisances = problem.model.scene, problem.nuisances
    found: list[FoundNuisance] = []

    def add(name: str, unit: str, at: int, scale: float, middle: float = 0.0) -> None:
        value, reach = middle + x[at] * scale, _REACH * sd[at] * scale
        found.append(FoundNuisance(name, unit, value, value - reach, value + reach, scale))

    for moves, axes, sds, points in (
        (layout.moves_source, layout.source, layout.source_sd_m, scene.sources),
        (layout.moves_receiver, layout.receiver, layout.receiver_sd_m, scene.receivers),
    ):
        for n, (point, axis) in enumerate(axes):
            add(f"{_AXES[axis]} of {points[point].name}", "m", moves.start + n, float(sds[n]))
    if layout.speed.stop > layout.speed.start:
        speed = problem.model.speed_m_s
        add("speed of sound", "m/s", layout.speed.start, nuisances.speed_sd * speed, speed)
    n_gains = (layout.gain.stop - layout.gain.start) // 2
    for n in range(n_gains):
        add(f"gain {n + 1}", "dB", layout.gain.start + n, _DB)
        add(f"phase of gain {n + 1}", "rad", layout.gain.start + n_gains + n, 1.0)
    for n in range(layout.delay.stop - layout.delay.start):
        source, receiver = scene.pairs[np.flatnonzero(layout.delay_of_pair == n)[0]]
        name = scene.sources[source].name
        if nuisances.delay == "pair":
            name += f" to {scene.receivers[receiver].name}"
        add(f"delay of {name}", "s", layout.delay.start + n, nuisances.delay_sd_s)
    return tuple(found)


def predicted_pairs(fit: ImpedanceFit) -> ComplexArray:
    """Return the predicted pressures with gains and delays, (n_pairs, n_frequencies)."""
    problem = fit.problem
    short = gradients(problem.model, fit.r0, fit.state, with_geometry=False).pressure
    predicted = factor_of(problem, fit.layout, fit.x) * (short + fit.correction)
    if has_free_spectra(problem.nuisances):
        return np.asarray(predicted * source_spectra(problem, predicted))
    return np.asarray(predicted)


def wall_condition(fit: ImpedanceFit) -> float:
    """Return how unequally the data determine the walls: 1 is equally well, infinite not at all.

    Largest over smallest singular value of the weighted Jacobian by the walls' numbers, without
    priors of theirs, after what the other unknowns can explain.
    """
    jacobian = data_rows(fit.problem, fit.layout, fit.x, fit.correction).jacobian
    n = fit.layout.curves[-1].stop
    own, other = jacobian[:, :n], jacobian[:, n:]
    if other.shape[1]:
        weak: FloatArray = np.eye(other.shape[1])
        explained = np.linalg.solve(other.T @ other + weak, other.T @ own)
        own = own - other @ explained
    singular = np.linalg.svd(own, compute_uv=False)
    return float(singular[0] / max(singular[-1], 1e-300))


Again = Callable[[Problem], ImpedanceFit]
"""Fits a changed problem from the start of its curves."""


def judged_answer(
    fit: ImpedanceFit,
    starts: tuple[Start, ...],
    rivals: tuple[ImpedanceFit, ...],
    observed: Observed,
    seconds: float,
    again: Again,
) -> ImpedanceAnswer:
    """Return the answer of a fit.

    Parameters
    ----------
    fit : ImpedanceFit
    starts : tuple of Start
    rivals : tuple of ImpedanceFit
        Other minima that explain the data as well.
    observed : Observed
        As it was told; `fit` may hold an estimate of the noise.
    seconds : float
    again : callable
        To look for the cause where the model does not fit.
    """
    problem = fit.problem
    materials = material_answers(fit)
    findings: list[Finding] = []
    weaker = _weaker_findings(problem, observed)
    findings += weaker
    identified = enough_identified(materials)
    verdict, doubts = _verdict(fit, rivals, observed, identified, bool(weaker), again)
    findings += doubts
    return ImpedanceAnswer(
        problem.observed.frequency_hz,
        problem.observed.tau_s,
        materials,
        verdict,
        tuple(findings),
        found_nuisances(fit),
        reduced_chi2(fit),
        fit.model_error,
        wall_condition(fit),
        round(share_in_best(starts) * len(starts)),
        len(starts),
        _pair_names(problem.model.scene),
        problem.observed.pressure,
        predicted_pairs(fit),
        problem.sd,
        fit.ending.advice,
        fit.evaluations,
        fit.rounds,
        seconds,
    )


def _weaker_findings(problem: Problem, observed: Observed) -> list[Finding]:
    findings = []
    if observed.noise is None and problem.observed.noise is not None:
        level = float(np.mean(level_at(problem.observed)))
        share = float(problem.observed.noise.mean()) / level
        findings.append(
            Finding(
                Code.NOISE_ESTIMATED,
                f"The noise was not told; what the fit leaves ({share:.1%} of the level) was taken "
                "for it. A model that does not fit cannot be told from noise then.",
                {"noise_over_level": share},
            )
        )
    if not observed.has_phase:
        findings.append(
            Finding(
                Code.LEVELS_ONLY,
                "Only levels were given. Other walls than those found may explain them; phases "
                "would tell.",
                {},
            )
        )
    return findings


def _verdict(
    fit: ImpedanceFit,
    rivals: tuple[ImpedanceFit, ...],
    observed: Observed,
    identified: FloatArray,
    weaker: bool,
    again: Again,
) -> tuple[Verdict, list[Finding]]:
    noise = fit.problem.observed.noise
    level = float(np.mean(level_at(fit.problem.observed)))
    estimated = observed.noise is None and noise is not None
    loud = (
        estimated
        and noise is not None
        and (float(np.mean(noise)) > LOUDEST_ESTIMATED_NOISE * level)
    )
    if loud or not fits(fit):
        cause = (
            "what the fit leaves is larger than any noise should be"
            if loud
            else likely_cause(fit, again)
        )
        sentence = (
            f"The model does not fit: it leaves {reduced_chi2(fit):.1f} times the expected squares."
            f" Likely cause: {cause}."
        )
        finding = Finding(
            Code.IMPEDANCE_DOES_NOT_FIT,
            sentence + " Do not use the walls found.",
            {"chi2": reduced_chi2(fit), "cause": cause},
        )
        return Verdict("does not fit", cause, sentence, weaker), [finding]
    names = fit.problem.model.scene.room.materials
    unsure = [n for n, share in zip(names, identified, strict=True) if share < ENOUGH_FREQUENCIES]
    if rivals or unsure:
        cause = (
            "other walls explain the data as well"
            if rivals
            else f"the data hardly depend on {', '.join(unsure)}"
        )
        sentence = f"Not identifiable: {cause}."
        finding = Finding(
            Code.IMPEDANCE_NOT_IDENTIFIABLE,
            sentence + " More pairs, or pairs nearer to the walls concerned, would tell.",
            {"rivals": len(rivals), "materials": unsure},
        )
        return Verdict("not identifiable", cause, sentence, weaker), [finding]
    sentence = (
        f"Identified: the residual is {reduced_chi2(fit):.2f} of what noise and model error allow."
    )
    return Verdict("identified", "", sentence, weaker), []


def _pair_names(scene: Scene) -> tuple[tuple[str, str], ...]:
    return tuple((scene.sources[s].name, scene.receivers[r].name) for s, r in scene.pairs)


def answer_without_fit(
    problem: Problem, findings: tuple[Finding, ...], seconds: float
) -> ImpedanceAnswer:
    """Return the answer where the data cannot hold the unknowns: nothing but that."""
    observed = problem.observed
    names = problem.model.scene.room.materials
    cause = "too few data"
    return ImpedanceAnswer(
        observed.frequency_hz,
        observed.tau_s,
        tuple(unknown_answer(name, "none", len(observed.frequency_hz)) for name in names),
        Verdict("not identifiable", cause, f"Not identifiable: {cause}.", False),
        findings,
        (),
        math.nan,
        math.nan,
        math.nan,
        0,
        0,
        _pair_names(problem.model.scene),
        observed.pressure,
        np.zeros_like(observed.pressure),
        problem.sd,
        "nothing was fitted",
        0,
        0,
        seconds,
    )
