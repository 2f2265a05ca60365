"""Mean absorption from decay times alone, and what priors make of it for single materials.

Where no position is known, a room is its volume and its areas, and a decay time is one number a
band: it determines one mean absorption, by the formula of a diffuse field that is believed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from roomfit.bands import Bands
from roomfit.errors import InputError
from roomfit.logit import Z95, expit, logit
from roomfit.materials.priors import MaterialPrior, prior_logit_law
from roomfit.typing import FloatArray

Formula = Literal["Sabine", "Eyring", "Arau-Puchades", "Fitzroy"]
FORMULAS: tuple[Formula, ...] = get_args(Formula)
# Of a decay time: a just noticeable difference, which no formula of a diffuse field undercuts.
LEAST_RELATIVE_SD = 0.05
_ROUNDS = 50
_DONE = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class DiffuseAbsorption:
    """Absorption by four formulas of a diffuse field: the room's mean, and materials by priors."""

    bands: Bands
    materials: tuple[str, ...]
    decay_s: FloatArray  # (n_bands,), mean over positions
    decay_sd_s: FloatArray  # (n_bands,), of that mean
    mean: FloatArray  # (n_formulas, 3, n_bands), of the room: value, lower, upper bound of 95 %
    absorption: FloatArray  # (n_formulas, n_materials, 3, n_bands), the same of each material


def absorption_area_m2(
    formula: Formula, absorption: FloatArray, areas_m2: FloatArray
) -> tuple[float, FloatArray]:
    """Return the equivalent absorption area of the walls, and its derivative by each absorption.

    Parameters
    ----------
    formula : {"Sabine", "Eyring", "Arau-Puchades", "Fitzroy"}
    absorption : float array, shape (n_materials,)
        0 < absorption < 1.
    areas_m2 : float array, shape (3, n_materials)
        Of each material across x, y and z; they sum up to its area.

    Returns
    -------
    area_m2 : float
    derivative : float array, shape (n_materials,)

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
    >>> [round(absorption_area_m2(f, *alike)[0], 6) for f in FORMULAS]
    [20.8, 23.206929, 23.206929, 23.206929]
    """
    across = areas_m2.sum(axis=1)
    total, own = float(across.sum()), areas_m2.sum(axis=0)
    if formula == "Sabine":
        return float(own @ absorption), own
    if formula == "Eyring":
        mean = float(own @ absorption) / total
        return -total * float(np.log1p(-mean)), own / (1.0 - mean)
    used = across > 0.0
    means = (areas_m2[used] @ absorption) / across[used]
    losses, shares = -np.log1p(-means), across[used] / total
    if formula == "Fitzroy":
        area = total / float(np.sum(shares / losses))
        by_axis = (area / total) ** 2 / (losses**2 * (1.0 - means))
        return area, by_axis @ areas_m2[used]
    area = total * float(np.exp(np.sum(shares * np.log(losses))))
    by_axis = area / total / (losses * (1.0 - means))
    return area, by_axis @ areas_m2[used]


def _disagreement(formula: Formula, absorption: FloatArray, areas_m2: FloatArray) -> float:
    """Return by how much another formula's area is off this one's at most, relatively.

    Sabine's, which holds for small absorption only, is off others but is no measure for them.
    """
    areas = {f: absorption_area_m2(f, absorption, areas_m2)[0] for f in FORMULAS}
    return max(abs(float(np.log(areas[f] / areas[formula]))) for f in FORMULAS if f != "Sabine")


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

    Parameters
    ----------
    decay_s : float array, shape (n_positions, n_bands)
        Reverberation times, NaN where unknown; some in every band.
    bands : Bands
    priors : tuple of MaterialPrior
        Of every material, in these bands.
    areas_m2 : float array, shape (3, n_materials)
        See `absorption_area_m2`.
    volume_m3, speed_of_sound_m_s : float
    attenuation_per_m : float array, shape (n_bands,)
        Energy attenuation of the air.

    Raises
    ------
    InputError
        A decay is longer than air alone permits, or so short that no wall explains it.
    """
    n_known = np.sum(np.isfinite(decay_s), axis=0)
    middle_s = np.nanmean(decay_s, axis=0)
    spread = np.nanstd(decay_s, axis=0) * np.sqrt(n_known / np.maximum(n_known - 1, 1))
    relative = np.hypot(LEAST_RELATIVE_SD, spread / np.sqrt(n_known) / middle_s)
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
    for i, formula in enumerate(FORMULAS):
        for band in range(len(bands)):
            sd = float(relative[band] * whole_m2[band] / walls_m2[band])
            value = float(np.log(walls_m2[band]))
            first = _updated(formula, (value, sd), priors, areas_m2, band)
            own = np.clip(first[1][:, 0], 1e-9, 1.0 - 1e-9)
            datum = value, float(np.hypot(sd, _disagreement(formula, own, areas_m2)))
            mean[i, :, band], each[i, :, :, band] = _updated(formula, datum, priors, areas_m2, band)
    return DiffuseAbsorption(
        bands, tuple(k.name for k in priors), middle_s, relative * middle_s, mean, each
    )


def _updated(
    formula: Formula,
    datum: tuple[float, float],
    priors: tuple[MaterialPrior, ...],
    areas_m2: FloatArray,
    band: int,
) -> tuple[FloatArray, FloatArray]:
    """Return mean and materials with bounds: the Gaussian posterior at the most likely logits."""
    means, covariances = prior_logit_law(priors)
    centre, covariance = means[:, band].copy(), covariances[band].copy()
    low, span = (np.array([getattr(k, n) for k in priors]) for n in ("lower", "upper"))
    span = span - low
    for j, k in enumerate(priors):
        if k.known is not None:
            low[j], span[j], centre[j] = 0.0, 1.0, float(logit(k.known[band : band + 1], 1e-9)[0])
            covariance[j], covariance[:, j] = 0.0, 0.0
    x, (value, sd) = centre.copy(), datum
    for _ in range(_ROUNDS):
        share = expit(x)
        area, by_absorption = absorption_area_m2(formula, low + span * share, areas_m2)
        slope = by_absorption * span * share * (1.0 - share) / area
        shared = covariance @ slope
        gain = shared / (float(slope @ shared) + sd**2)
        new = centre + gain * (value - np.log(area) + float(slope @ (x - centre)))
        step = np.clip(new - x, -2.0, 2.0)
        x = x + step
        if float(np.max(np.abs(step))) < _DONE:
            break
    posterior = covariance - np.outer(gain, shared)
    sds = np.sqrt(np.maximum(np.diag(posterior), 0.0))
    materials = np.stack([low + span * expit(x + z * sds) for z in (0.0, -Z95, Z95)], axis=1)
    weights = areas_m2.sum(axis=0) / areas_m2.sum()
    middle = float(weights @ materials[:, 0])
    by_logit = weights * span * expit(x) * (1.0 - expit(x)) / (middle * (1.0 - middle))
    spread = np.sqrt(max(float(by_logit @ posterior @ by_logit), 0.0))
    at = float(logit(np.array([middle]), 1e-9)[0])
    return np.array(
        [float(expit(np.array([at + z * spread]))[0]) for z in (0, -Z95, Z95)]
    ), materials
