"""Mean absorption from decay times alone, and what priors make of it for single materials.

Where no position is known, a room is its volume and its areas, and a decay time is one number a
band: it determines one mean absorption, by the formula of a diffuse field that is believed.
`field_posterior` gives it to predictions: the mean known, its split over materials by their priors.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from roomfit.base.bands import Bands
from roomfit.base.errors import InputError
from roomfit.base.findings import Finding
from roomfit.base.logit import Z95, expit, logit
from roomfit.base.typing import FloatArray
from roomfit.materials.priors import MaterialPrior, are_specified, prior_logit_law
from roomfit.predict.anisotropic import anisotropic_times_s, implied_scattering
from roomfit.uncertainty.posterior import (
    AbsorptionPosterior,
    antithetic_normals,
    plain_logit_covariance,
)

Formula = Literal["Sabine", "Eyring", "Arau-Puchades", "Fitzroy"]
FORMULAS: tuple[Formula, ...] = get_args(Formula)
# Of a decay time: a just noticeable difference, which no formula of a diffuse field undercuts.
LEAST_RELATIVE_SD = 0.05
# Of the time of rays in a box beside Eyring's, in units of Fitzroy's distance from it: mean,
# standard deviation (docs/decisions/0052).
ERROR_MEAN, ERROR_SD = 0.5, 0.6
# A change of walls alters the logarithm of a time by the formula's difference times a positive
# factor. The spread of the factor's logarithm falls with the difference and rises with that
# distance, up to 1, and with the share of the surface across one axis, since flat rooms keep a
# field of their own. Below the formula's difference it is larger, by the last of these.
_EFFECT_SD, _EFFECT_SD_APART, _EFFECT_SD_FLAT, _FLAT_FROM = 0.25, 0.3, 2.75, 0.5
_LESS_THAN_SAID = 2.2
# Share of the surface across one axis above which directions are followed: a room of 3 by 3 by 1
# has 0.6, a cube 0.33.
_FLAT = 0.6
_ROUNDS = 50
_DONE = 1e-9
_MEASURES = tuple(f for f in FORMULAS if f != "Sabine")


@dataclass(frozen=True, slots=True, eq=False)
class DiffuseAbsorption:
    """Absorption by four formulas of a diffuse field: the room's mean, and materials by priors."""

    bands: Bands
    materials: tuple[str, ...]
    decay_s: FloatArray  # (n_bands,), mean over positions
    decay_sd_s: FloatArray  # (n_bands,), of that mean
    mean: FloatArray  # (n_formulas, 3, n_bands), of the room: value, lower, upper bound of 95 %
    absorption: FloatArray  # (n_formulas, n_materials, 3, n_bands), the same of each material
    # (n_formulas, n_bands, n_materials, n_materials), of their logits between their bounds
    covariance: FloatArray
    findings: tuple[Finding, ...] = ()


def absorption_area_m2(
    formula: Formula, absorption: FloatArray, areas_m2: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the equivalent absorption area of the walls, and its derivative by each absorption.

    Parameters
    ----------
    formula : {"Sabine", "Eyring", "Arau-Puchades", "Fitzroy"}
    absorption : float array, shape (..., n_materials)
        0 < absorption < 1.
    areas_m2 : float array, shape (3, n_materials)
        Of each material across x, y and z; they sum up to its area.

    Returns
    -------
    area_m2 : float array, shape (...)
    derivative : float array, shape (..., n_materials)

    Notes
    -----
    With S the area, a the mean absorption and a_i that of the walls S_i across one axis: ``S a``
    [1]_, ``-S ln(1 - a)`` [2]_, and S times the geometric [3]_ or the harmonic mean [4]_ of
    ``-ln(1 - a_i)``, weighted by ``S_i / S``.

    References
    ----------
    .. [1] W. C. Sabine, Collected Papers on Acoustics (1922).
    .. [2] C. F. Eyring, J. Acoust. Soc. Am. 1, 217-241 (1930).
    .. [3] H. Arau-Puchades, "An improved reverberation formula", Acustica 65, 163-180 (1988).
    .. [4] D. Fitzroy, "Reverberation formula which seems to be more accurate with nonuniform
           distribution of absorption", J. Acoust. Soc. Am. 31, 893-897 (1959).

    Examples
    --------
    Walls that are all alike have one absorption by all formulas but Sabine's:

    >>> alike = np.array([0.2]), np.array([[20.0], [24.0], [60.0]])
    >>> [round(float(absorption_area_m2(f, *alike)[0]), 6) for f in FORMULAS]
    [20.8, 23.206929, 23.206929, 23.206929]
    """
    own, across = areas_m2.sum(axis=0), areas_m2.sum(axis=1)
    total = float(across.sum())
    if formula == "Sabine":
        return np.asarray(absorption @ own), np.broadcast_to(own, absorption.shape)
    if formula == "Eyring":
        kept = 1.0 - (absorption @ own) / total
        return -total * np.log(kept), own / kept[..., None]
    used = across > 0.0
    kept = 1.0 - (absorption @ areas_m2[used].T) / across[used]
    losses, shares = -np.log(kept), across[used] / total
    if formula == "Fitzroy":
        area = total / np.sum(shares / losses, axis=-1)
        by_axis = (area[..., None] / total / losses) ** 2
    else:
        area = total * np.exp(np.sum(shares * np.log(losses), axis=-1))
        by_axis = area[..., None] / total / losses
    return np.asarray(area), (by_axis / kept) @ areas_m2[used]


def _disagreement(formula: Formula, absorption: FloatArray, areas_m2: FloatArray) -> FloatArray:
    """Return by how much another formula's area is off this one's at most, relatively.

    Sabine's, which holds for small absorption only, is off others but is no measure for them.
    Shapes as of `absorption_area_m2`.
    """
    areas = {f: absorption_area_m2(f, absorption, areas_m2)[0] for f in FORMULAS}
    return np.asarray(
        np.max([abs(np.log(areas[f] / areas[formula])) for f in _MEASURES], axis=0, initial=0.0)
    )


def diffuse_absorption(
    decay_s: FloatArray,
    bands: Bands,
    priors: tuple[MaterialPrior, ...],
    areas_m2: FloatArray,
    volume_m3: float,
    *,
    speed_of_sound_m_s: float,
    attenuation_per_m: FloatArray,
) -> DiffuseAbsorption:
    """Return mean absorption and its split over materials from decay times, position by position.

    The decay time of a band is one datum on the logits of all materials, whose Gaussian priors are
    updated by it. Its standard deviation is that of the mean over positions, 5 % at least, and with
    it that of the formula: by how much the others differ from it at the absorption that was found.
    All agree where walls are alike; they part where priors say that absorption is uneven, and the
    field is the less diffuse. Where priors tell no walls apart, they are taken to be alike.

    Shapes: `decay_s` (n_positions, n_bands), `areas_m2` (3, n_materials), `attenuation_per_m`
    (n_bands,).
    """
    middle_s, spread = mean_decay(decay_s)
    relative = np.hypot(LEAST_RELATIVE_SD, spread)
    whole_m2 = 24.0 * np.log(10.0) * volume_m3 / (speed_of_sound_m_s * middle_s)
    walls_m2 = whole_m2 - 4.0 * volume_m3 * attenuation_per_m
    for centre, area in zip(bands.centres_hz, walls_m2, strict=True):
        if not 0.0 < area < 10.0 * areas_m2.sum():
            raise InputError(
                "no absorption of walls gives this decay time",
                found=f"{area:.3g} m2 of absorption at {centre:g} Hz, on {areas_m2.sum():.1f} m2",
                needed="more than 0 after that of the air, and a room of this volume",
                hint="compare volume, surface and the unit of the decay times (s)",
            )
    mean = np.empty((len(FORMULAS), 3, len(bands)))
    each = np.empty((len(FORMULAS), len(priors), 3, len(bands)))
    covariances = np.empty((len(FORMULAS), len(bands), len(priors), len(priors)))
    for i, formula in enumerate(FORMULAS):
        for band in range(len(bands)):
            law = _law(priors, band)
            datum = float(np.log(walls_m2[band])), relative[band] * whole_m2[band] / walls_m2[band]
            first, _ = _most_likely(formula, datum, law, law.centre, areas_m2)
            apart = float(_disagreement(formula, law.absorption(first), areas_m2))
            datum = datum[0], float(np.hypot(datum[1], apart))
            x, posterior = _most_likely(formula, datum, law, law.centre, areas_m2)
            mean[i, :, band], each[i, :, :, band] = _with_bounds(law, x, posterior, areas_m2)
            covariances[i, band] = posterior
    names = tuple(k.name for k in priors)
    return DiffuseAbsorption(bands, names, middle_s, relative * middle_s, mean, each, covariances)


def mean_decay(decay_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the mean over positions, and the relative standard deviation of that mean.

    Shapes: `decay_s` (n_positions, n_bands).
    """
    n_known = np.sum(np.isfinite(decay_s), axis=0)
    middle_s = np.nanmean(decay_s, axis=0)
    spread = np.nanstd(decay_s, axis=0) * np.sqrt(n_known / np.maximum(n_known - 1, 1))
    return middle_s, spread / np.sqrt(n_known) / middle_s


@dataclass(frozen=True, slots=True, eq=False)
class _Law:
    """The prior of one band: Gaussian in the logit of ``(a - low) / span``."""

    centre: FloatArray  # (n_materials,)
    covariance: FloatArray  # (n_materials, n_materials), zeros where absorption is fixed
    low: FloatArray  # (n_materials,)
    span: FloatArray  # (n_materials,)

    def absorption(self, x: FloatArray) -> FloatArray:
        """Return the absorption at some logits, shape (..., n_materials), within 0 to 1."""
        return np.asarray(np.clip(self.low + self.span * expit(x), 1e-9, 1.0 - 1e-9))


def _law(priors: tuple[MaterialPrior, ...], band: int) -> _Law:
    means, covariances = prior_logit_law(priors)
    centre, covariance = means[:, band].copy(), covariances[band].copy()
    low, high = (np.array([getattr(k, n) for k in priors]) for n in ("lower", "upper"))
    span = high - low
    for j, k in enumerate(priors):
        if k.known is not None:
            low[j], span[j], centre[j] = 0.0, 1.0, float(logit(k.known[band : band + 1], 1e-9)[0])
            covariance[j], covariance[:, j] = 0.0, 0.0
    return _Law(centre, covariance, low, span)


def _most_likely(
    formula: Formula,
    datum: tuple[FloatArray | float, float],
    law: _Law,
    centre: FloatArray,
    areas_m2: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return the most likely logits, shape (..., n_materials), and the last covariance of them."""
    x, (value, sd) = centre.copy(), datum
    for _ in range(_ROUNDS):
        absorption, share = law.absorption(x), expit(x)
        area, by_absorption = absorption_area_m2(formula, absorption, areas_m2)
        slope = by_absorption * law.span * share * (1.0 - share) / area[..., None]
        shared = slope @ law.covariance
        gain = shared / (np.sum(slope * shared, axis=-1, keepdims=True) + sd**2)
        off = value - np.log(area) + np.sum(slope * (x - centre), axis=-1)
        step = np.clip(centre + gain * off[..., None] - x, -2.0, 2.0)
        x = x + step
        if float(np.max(np.abs(step))) < _DONE:
            break
    return x, law.covariance - gain[..., :, None] * shared[..., None, :]


def _with_bounds(
    law: _Law, x: FloatArray, posterior: FloatArray, areas_m2: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return mean and materials with bounds, Gaussian in their logits."""
    sds = np.sqrt(np.maximum(np.diag(posterior), 0.0))
    low, span = law.low, law.span
    materials = np.stack([low + span * expit(x + z * sds) for z in (0.0, -Z95, Z95)], axis=1)
    weights = areas_m2.sum(axis=0) / areas_m2.sum()
    middle = float(weights @ materials[:, 0])
    by_logit = weights * span * expit(x) * (1.0 - expit(x)) / (middle * (1.0 - middle))
    spread = np.sqrt(max(float(by_logit @ posterior @ by_logit), 0.0))
    at = float(logit(np.array([middle]), 1e-9)[0])
    return np.array(
        [float(expit(np.array([at + z * spread]))[0]) for z in (0, -Z95, Z95)]
    ), materials


@dataclass(frozen=True, slots=True, eq=False)
class DiffuseField:
    """A room as a diffuse field: its size, its walls, and what was measured of its decay."""

    formula: Formula
    bands: Bands
    priors: tuple[MaterialPrior, ...]
    areas_m2: FloatArray  # (3, n_materials), see `absorption_area_m2`
    volume_m3: float
    speed_of_sound_m_s: float
    attenuation_per_m: FloatArray  # (n_bands,), of energy by the air and by known objects
    # (n_positions, n_bands), measured reverberation times in s, NaN where unknown; None: none
    decay_s: FloatArray | None = None
    findings: tuple[Finding, ...] = ()  # of what was measured

    def times_s(self, absorption: FloatArray, scattering: FloatArray | None = None) -> FloatArray:
        """Return reverberation times of the walls and the air, shape (..., n_bands).

        Shapes: `absorption` (..., n_materials, n_bands).
        """
        by_band = np.moveaxis(np.clip(absorption, 1e-9, 1.0 - 1e-9), -2, -1)
        if scattering is not None:
            shape = np.broadcast_shapes(by_band.shape[:-1], scattering.shape)
            kept = np.broadcast_to(self._kept(by_band), (*shape, 3)).reshape(-1, 3)
            given = np.broadcast_to(scattering, shape).ravel()
            return anisotropic_times_s(kept, given, *self._rates_per_s(shape)).reshape(shape)
        walls_m2, _ = absorption_area_m2(self.formula, by_band, self.areas_m2)
        whole_m2 = walls_m2 + 4.0 * self.volume_m3 * self.attenuation_per_m
        return np.asarray(24.0 * np.log(10.0) * self.volume_m3 / self.speed_of_sound_m_s / whole_m2)

    def scattering(self, absorption: FloatArray, decay_s: FloatArray) -> FloatArray:
        """Return with which scattering coefficient the room has its decay times, (..., n_bands).

        By `implied_scattering`. `absorption` has the shape (..., n_materials, n_bands), `decay_s`
        (..., n_bands).
        """
        kept = self._kept(np.moveaxis(np.clip(absorption, 1e-9, 1.0 - 1e-9), -2, -1))
        rates = self._rates_per_s(decay_s.shape)
        found = implied_scattering(kept.reshape(-1, 3), decay_s.ravel(), *rates)
        return found.reshape(decay_s.shape)

    def _kept(self, by_band: FloatArray) -> FloatArray:
        """Return what walls across each axis leave of the energy, shape (..., 3).

        `by_band` has the shape (..., n_materials).
        """
        across = np.maximum(self.areas_m2.sum(axis=1), 1e-9)
        return np.asarray(np.exp(np.log1p(-by_band) @ (self.areas_m2 / across[:, None]).T))

    def _rates_per_s(self, shape: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
        """Return hits of sound along each axis, and losses in air of times of a shape, per s."""
        hits = self.speed_of_sound_m_s * self.areas_m2.sum(axis=1) / (2.0 * self.volume_m3)
        air = self.speed_of_sound_m_s * self.attenuation_per_m
        return hits, np.broadcast_to(air, shape).ravel()

    @property
    def is_flat(self) -> bool:
        """Whether so much of the surface lies across one axis that no formula holds."""
        return self.flatness > _FLAT

    @property
    def flatness(self) -> float:
        """Largest share of the surface across one axis: a third for a cube, more for flat rooms."""
        across = self.areas_m2.sum(axis=1)
        return float(across.max() / across.sum())

    def effect(self, difference: FloatArray, apart: FloatArray, normal: FloatArray) -> FloatArray:
        """Return by how much a change of walls may alter the logarithm of the time.

        Shapes that fit each other.
        """
        sd = _EFFECT_SD + _EFFECT_SD_APART * np.minimum(apart, 1.0)
        flat = 0.0 if self.is_flat else _EFFECT_SD_FLAT * max(self.flatness - _FLAT_FROM, 0.0)
        sd = sd * np.exp(-np.abs(difference)) + flat
        return np.asarray(
            difference * np.exp(sd * np.where(normal < 0.0, _LESS_THAN_SAID, 1.0) * normal)
        )

    def formula_error(self, absorption: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return mean and unit of the error of the formula, in logarithms of times.

        Shapes (..., n_bands). The unit is by how much Fitzroy's time is longer than Eyring's: all
        formulas agree where walls are alike, and the field is diffuse.
        """
        eyring, fitzroy, own = (
            np.log(replace(self, formula=f).times_s(absorption))
            for f in ("Eyring", "Fitzroy", self.formula)
        )
        unit = np.maximum(fitzroy - eyring, 0.0)
        return eyring + ERROR_MEAN * unit - own, unit


def field_posterior(
    field: DiffuseField, n_draws: int, rng: np.random.Generator
) -> AbsorptionPosterior:
    """Return absorption by the decay times of a room, or by its priors where there are none.

    The mean is known as well as `diffuse_absorption` says, the split over materials as well as
    their priors have it. Each draw disturbs datum and prior by their own noise and finds the most
    likely logits again (as `roomfit.uncertainty.posterior.rto_draws`), the priors' noise alike in
    all bands: a wall that absorbs more than its table does so at all frequencies.
    """
    priors, bands, areas_m2 = field.priors, field.bands, field.areas_m2
    laws = [_law(priors, band) for band in range(len(bands))]
    z = antithetic_normals(n_draws, len(priors), rng)
    noise = antithetic_normals(n_draws, len(bands), rng)
    index = FORMULAS.index(field.formula)
    values = np.empty((3, len(priors), len(bands)))
    covariance = np.stack([law.covariance for law in laws])
    draws = np.empty((n_draws, len(priors), len(bands)))
    found = None
    if field.decay_s is not None:
        found = diffuse_absorption(
            field.decay_s, bands, priors, areas_m2, field.volume_m3,
            speed_of_sound_m_s=field.speed_of_sound_m_s, attenuation_per_m=field.attenuation_per_m,
        )  # fmt: skip
        values, covariance = found.absorption[index].transpose(1, 0, 2), found.covariance[index]
    if found is not None:
        # formulas disagree at the absorption that was found; each draw's value is that of this one
        mean_error, unit = field.formula_error(values[0])
        between = mean_decay(np.asarray(field.decay_s))[1]
        sd_log = np.sqrt(LEAST_RELATIVE_SD**2 + (ERROR_SD * unit) ** 2 + between**2)
        drawn_s = found.decay_s * np.exp(-mean_error - sd_log * noise)
    for band, law in enumerate(laws):
        size, direction = np.linalg.eigh(law.covariance)
        x = law.centre + z @ (direction * np.sqrt(np.maximum(size, 0.0)) @ direction.T)
        if found is None:
            values[:, :, band] = _with_bounds(law, law.centre, law.covariance, areas_m2)[1].T
        else:
            whole_m2 = (
                24.0 * np.log(10.0) * field.volume_m3 / field.speed_of_sound_m_s / drawn_s[:, band]
            )
            walls_m2 = np.maximum(
                whole_m2 - 4.0 * field.volume_m3 * field.attenuation_per_m[band], 1e-3
            )
            sd = sd_log[band] * np.median(whole_m2 / walls_m2)
            x, _ = _most_likely(field.formula, (np.log(walls_m2), sd), law, x, areas_m2)
        draws[:, :, band] = law.absorption(x)
    fixed = np.array([k.known is not None for k in priors])
    draws[:, fixed] = values[0, fixed]
    mean, before = prior_logit_law(priors)
    low, high = (np.array([getattr(k, n) for k in priors]) for n in ("lower", "upper"))
    a, lower, upper = values
    return AbsorptionPosterior(
        tuple(k.name for k in priors), bands, a, np.fmin(lower, a), np.fmax(upper, a),
        plain_logit_covariance(covariance, a, low, high),
        mean, np.sqrt(np.diagonal(before, axis1=1, axis2=2)).T, before,
        prior_specified=are_specified(priors), draws=draws,
    )  # fmt: skip
