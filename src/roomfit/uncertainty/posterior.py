"""Absorption after a fit, and random draws of it that stay where the data are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from roomfit.base.arguments import bool_array, float_array, read_only, unique_names
from roomfit.base.bands import Bands
from roomfit.base.errors import InputError
from roomfit.base.findings import Finding
from roomfit.base.logit import Z95, expit, logit
from roomfit.base.typing import VALUE_NAMES, BoolArray, FloatArray, IntArray
from roomfit.materials.priors import DEFAULT_LOGIT_SD, is_default_prior, shared_variance

if TYPE_CHECKING:  # compiled, and no reader of a table needs it
    from roomfit.model.patterns import Directivity

# Logits beyond +-14 mean an absorption within a millionth of 0 or 1.
_SMALLEST = 1e-6


class FittedPair(NamedTuple):
    """A pair that was fitted; values in the order of `VALUE_NAMES`, NaN where unknown."""

    source: str
    receiver: str
    state: str  # of the room; "": as it is described
    distance_m: float
    measured: FloatArray  # (n_names, n_bands)
    predicted: FloatArray  # likewise, by the fitted absorption


@dataclass(frozen=True, slots=True, eq=False)
class AbsorptionPosterior:
    """Absorption of every material in every band with its uncertainty."""

    materials: tuple[str, ...]
    bands: Bands
    absorption: FloatArray  # (n_materials, n_bands), 0 to 1, and so the next two
    lower95: FloatArray
    upper95: FloatArray
    # (n_bands, n_materials, n_materials), of logit absorption; variance 0: absorption is fixed
    logit_covariance: FloatArray
    # (n_materials, n_bands), prior of logit absorption: it gives the data's part of the covariance
    prior_logit_mean: FloatArray | None = None
    prior_logit_sd: FloatArray | None = None
    # (n_bands, n_materials, n_materials), of the same prior; None: materials are independent
    prior_logit_covariance: FloatArray | None = None
    # (n_materials, n_bands), with which absorption was found; a row of NaN where unspecified
    scattering: FloatArray | None = None
    # (n_bands,), where decays of that room follow from pressures of image sources; None: nowhere
    by_pressures: BoolArray | None = None
    # by source, those that are not omnidirectional, in these bands
    directivities: Mapping[str, Directivity] | None = None
    chi2_reduced: FloatArray | None = None  # (n_bands,), of the fit that found the absorption
    # (n_materials,), whether the prior was specified; None: unknown
    prior_specified: BoolArray | None = None
    # (n_draws, n_materials, n_bands), equally likely, drawn with the model itself; None: by
    # `draw_absorption` from the covariance
    draws: FloatArray | None = None
    fitted: tuple[FittedPair, ...] = ()  # the measured pairs from which the absorption was found
    areas_m2: FloatArray | None = None  # (n_materials,), in the room that was fitted
    is_other_room: bool = False  # to be predicted, than the one that was fitted
    findings: tuple[Finding, ...] = ()  # what was doubtful in putting it together
    result_findings: tuple[Finding, ...] = ()  # all those of the fit that found the absorption
    # of what among the materials is an object, the volume of the room: its absorption is
    # `roomfit.materials.priors.object_absorption` of an area there
    objects: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        def checked(name: str, values: object) -> None:
            object.__setattr__(self, name, values)

        checked("materials", unique_names("material", self.materials))
        n, m = len(self.materials), len(self.bands)
        for name, shape, low, high in (
            *((x, (n, m), 0.0, 1.0) for x in ("absorption", "lower95", "upper95")),
            ("prior_logit_mean", (n, m), -50.0, 50.0),
            ("prior_logit_sd", (n, m), 0.0, 50.0),
            ("prior_logit_covariance", (m, n, n), -np.inf, np.inf),
            ("logit_covariance", (m, n, n), -np.inf, np.inf),
            ("chi2_reduced", (m,), 0.0, np.inf),
            ("draws", (None, n, m), 0.0, 1.0),
            ("areas_m2", (n,), 0.0, np.inf),
        ):
            if (value := getattr(self, name)) is not None:
                words = "reduced chi-square" if name == "chi2_reduced" else name
                checked(name, float_array(words, value, shape, low=low, high=high))
        if self.scattering is not None:
            values = np.array(self.scattering, dtype=np.float64)
            # NaN, for unspecified, passes where it fills a row
            unspecified = np.isnan(values).all(axis=-1, keepdims=True)
            known = np.where(unspecified, 0.0, values)
            float_array("scattering", known, (n, m), low=0.0, high=1.0)
            checked("scattering", read_only(values))
        for name, size in (("by_pressures", m), ("prior_specified", n)):
            if (flags := getattr(self, name)) is not None:
                checked(name, bool_array(name, flags, (size,)))
        for pair in self.fitted:
            length_m = np.nan_to_num([pair.distance_m], nan=1.0)  # of an old file
            float_array("distance of a fitted pair", length_m, (1,), low=0.001, high=1e5)
            for values in (pair.measured, pair.predicted):
                known = np.nan_to_num(values)  # what is infinite is refused
                float_array(
                    "values of fitted pairs", known, (len(VALUE_NAMES), m), low=-1e6, high=1e6
                )
        covariance = self.logit_covariance
        largest = np.abs(covariance).max(initial=0.0)
        # numbers that went through text or an inversion are symmetric but for rounding
        lowest = min((float(np.linalg.eigvalsh(c)[0]) for c in covariance), default=0.0)
        if not np.allclose(covariance, covariance.transpose(0, 2, 1), atol=1e-6 * largest) or (
            lowest < -1e-6 * max(largest, 1e-12)
        ):
            raise InputError(
                "the covariance of logit absorption is none",
                found=f"smallest eigenvalue {lowest:.3g}",
                needed="a symmetric matrix per band without negative eigenvalues",
            )
        for name, directivity in (self.directivities or {}).items():
            found = _n_bands(directivity)
            if found not in (None, m):
                raise InputError(
                    f"the directivity of {name} is of other bands than the absorption",
                    found=f"{found} bands",
                    needed=f"{m}",
                )
        checked("directivities", MappingProxyType(dict(self.directivities or {})))

    @property
    def fitted_states(self) -> tuple[str, ...]:
        """Of the room that was fitted, "" as described; none where its pairs are not known."""
        return tuple(dict.fromkeys(p.state for p in self.fitted))

    @property
    def is_unknown(self) -> BoolArray:
        """Of which materials nothing is known before a change, shape (n_materials,)."""
        variance = np.diagonal(self.logit_covariance, axis1=1, axis2=2).T
        return np.asarray(((variance <= 0.0) & (self.lower95 < self.upper95)).any(axis=1))

    def check_materials(self, materials: tuple[str, ...]) -> None:
        """Refuse other materials than those of a room, or another order."""
        if self.materials != materials:
            raise InputError(
                "the absorption is of other materials than the room's",
                found=", ".join(self.materials),
                needed=", ".join(materials) + ", in this order",
                hint="room_posterior of roomfit.core matches materials by name",
            )


def prior_law(posterior: AbsorptionPosterior) -> tuple[FloatArray, FloatArray] | None:
    """Return prior mean and covariance of logit absorption, None where they are not known.

    Shapes: mean (n_bands, n_materials), covariance (n_bands, n_materials, n_materials).
    """
    mean, sd = posterior.prior_logit_mean, posterior.prior_logit_sd
    if mean is None or sd is None:
        return None
    alone = sd.T[:, :, None] ** 2 * np.eye(len(sd))
    together = posterior.prior_logit_covariance
    return mean.T, alone if together is None else together


def _n_bands(directivity: Directivity) -> int | None:
    from roomfit.model.patterns import Pattern

    if isinstance(directivity, Pattern):
        return None if directivity.b.ndim == 1 else len(directivity.b)
    return len(directivity.centres_hz)


def covariance_from_intervals(
    absorption: FloatArray, lower95: FloatArray, upper95: FloatArray
) -> FloatArray:
    """Return a covariance of logit absorption from 95 % intervals alone: independent materials.

    The sides of an interval are averaged in logit; a side at 0 or 1 is open. Where both
    are, the spread of the broad prior, 1.5, stands. Without the correlation between
    materials, which a decay determines together, intervals of predictions come out too wide.

    Shape (n_bands, n_materials, n_materials). Shapes: `absorption, lower95, upper95` (n_materials,
    n_bands).
    """
    middle = logit(absorption)
    sides = np.array([middle - logit(lower95), logit(upper95) - middle]) / Z95
    # five digits in a table: what is written as 0.00000 may have been a small interval's end
    is_bounded = np.array([lower95 > 0.0, upper95 < 1.0])
    count = is_bounded.sum(axis=0)
    mean = np.where(is_bounded, sides, 0.0).sum(axis=0) / np.maximum(count, 1)
    sd = np.where(count > 0, np.maximum(mean, 0.0), DEFAULT_LOGIT_SD)
    sd = np.where(lower95 == upper95, 0.0, sd)
    return np.asarray(np.stack([np.diag(column**2) for column in sd.T]))


def plain_logit_covariance(
    covariance: FloatArray, absorption: FloatArray, lower: FloatArray, upper: FloatArray
) -> FloatArray:
    """Return the covariance of logit absorption from that of a fit's free numbers.

    With bounds a fit's free number is the logit of ``(a - lower) / (upper - lower)``; to first
    order it is turned into that of absorption itself. Without bounds both are the same.

    Shapes: `covariance` (n_bands, n_materials, n_materials), `absorption` (n_materials, n_bands),
    `lower, upper` (n_materials,).
    """
    width = (upper - lower)[:, None]
    share = np.clip((absorption - lower[:, None]) / width, 0.0, 1.0)
    a = np.clip(absorption, _SMALLEST, 1.0 - _SMALLEST)
    plain = ((lower <= 0.0) & (upper >= 1.0))[:, None]
    slope = np.where(plain, 1.0, width * share * (1.0 - share) / (a * (1.0 - a))).T
    return np.asarray(covariance * slope[:, :, None] * slope[:, None, :])


_STEPS = 30
_SETTLED_STEP = 1e-7  # of a logit
_LONGEST_STEP = 2.0


def rto_draws(
    absorption: FloatArray,
    covariance_logit: FloatArray,
    prior_logit_mean: FloatArray,
    prior_logit_covariance: FloatArray,
    n_draws: int,
    rng: np.random.Generator,
    *,
    prior_sd_scale: FloatArray | float = 1.0,
) -> FloatArray:
    """Return draws of absorption from a fit's answer and covariance, shape (n_draws, n_materials).

    A decay determines sums of ``-log(1 - a)`` very well and their parts hardly. Draws that are
    Gaussian in logit absorption leave such a sum as soon as they move far along it: in rooms of
    five materials, observed by one decay within 3 %, their 95 % intervals of the mean absorption
    held the true value in 30 of 100. Here the likelihood is Gaussian in ``-log(1 - a)``, the
    exponents in which a path's energy is linear, and only the prior is Gaussian in the logit: 93 to
    96.

    Shapes: `absorption` (n_materials,), `covariance_logit` (n_materials, n_materials),
    `prior_logit_mean` (n_materials,), `prior_logit_covariance` (n_materials, n_materials),
    `prior_sd_scale` (n_materials,).

    Each draw disturbs data and prior by their own noise and finds the most likely values again
    [1]_: exact where the problem is linear, and close to the posterior elsewhere. The data are
    those of a linear problem with the information and the maximum of the given one. Errors that all
    data share were added to the covariance after the fit and leave less information than has pulled
    the answer from its prior, or none: the rest of the pull moves the centre of the prior, so that
    the draws lie about the answer.

    References
    ----------
    .. [1] J. M. Bardsley, A. Solonen, H. Haario, M. Laine, "Randomize-then-optimize: a method for
           sampling from posterior distributions in nonlinear inverse problems", SIAM J. Sci.
           Comput. 36, A1895-A1910 (2014).
    """
    x, n = logit(absorption), absorption.size
    slope = np.maximum(absorption, 1e-6)  # d(-log(1 - a)) / d(logit a)
    prior = np.linalg.inv(prior_logit_covariance)
    information = (np.linalg.inv(covariance_logit) - prior) / np.outer(slope, slope)
    size, direction = np.linalg.eigh(0.5 * (information + information.T))
    is_determined = size > 1e-9 * max(float(size.max()), 1e-300)
    R = np.sqrt(size[is_determined])[:, None] * direction[:, is_determined].T
    # at the maximum the data pull as much as the prior does, as far as three quarters of the
    # curvature stay: a large pull with little information would make the answer no minimum
    pull = prior @ (x - prior_logit_mean)
    moved = np.linalg.lstsq(R.T, pull / slope, rcond=None)[0]
    white = np.linalg.inv(np.linalg.cholesky((R * slope).T @ (R * slope) + prior))
    bend = white * (slope * (R.T @ moved) * (1.0 - absorption)) @ white.T
    moved *= 0.25 / max(float(np.linalg.eigvalsh(bend)[-1]), 0.25)
    perturbed = R @ _exponent(x) + moved + antithetic_normals(n_draws, len(R), rng)
    middle = prior_logit_mean + prior_logit_covariance @ (pull - slope * (R.T @ moved))
    own = np.diag(np.diag(prior_logit_covariance) - shared_variance(prior_logit_covariance))
    scale = np.broadcast_to(prior_sd_scale, n)
    root = np.linalg.cholesky((prior_logit_covariance - own) * np.outer(scale, scale) + own)
    centres = middle + antithetic_normals(n_draws, n, rng) @ root.T
    return expit(_most_likely(x, R, perturbed, centres, np.linalg.inv(root)))


def antithetic_normals(n_draws: int, n: int, rng: np.random.Generator) -> FloatArray:
    """Return standard normal numbers, shape (n_draws, n), the second half minus the first.

    Antithetic draws take the linear part of their scatter out of every mean over them.
    """
    half = rng.standard_normal(((n_draws + 1) // 2, n))
    return np.concatenate((half, -half))[:n_draws]


def _most_likely(
    start: FloatArray, R: FloatArray, perturbed: FloatArray, centres: FloatArray, weight: FloatArray
) -> FloatArray:
    """Minimise ``|R e(x) - seen|^2 + |W (x - centre)|^2``, W the weight, for all draws at once.

    By Levenberg and Marquardt, e the exponents of absorption; shape (n_draws, n_materials).
    """
    n_draws, n = centres.shape
    answer = np.tile(start, (n_draws, 1))
    moving, diagonal = np.arange(n_draws), np.arange(n)  # draws that are not there yet

    def residuals(x: FloatArray) -> FloatArray:
        return np.concatenate(
            (_exponent(x) @ R.T - perturbed[moving], (x - centres[moving]) @ weight.T), axis=1
        )

    r, damping = residuals(answer), np.full(n_draws, 1e-3)
    for _ in range(_STEPS):
        x = answer[moving]
        below = np.broadcast_to(weight, (moving.size, n, n))
        J = np.concatenate((R[None] * expit(x)[:, None, :], below), axis=1)
        H = np.swapaxes(J, 1, 2) @ J
        gradient = np.einsum("dij,di->dj", J, r)
        H[:, diagonal, diagonal] *= (1.0 + damping)[:, None]
        step = np.linalg.solve(H, gradient[..., None])[..., 0]
        trial = x - np.clip(step, -_LONGEST_STEP, _LONGEST_STEP)
        r_trial = residuals(trial)
        better = np.sum(r_trial**2, axis=1) < np.sum(r**2, axis=1)
        answer[moving[better]], r[better] = trial[better], r_trial[better]
        damping = np.where(better, 0.2 * damping, 5.0 * damping)
        left = np.abs(step).max(axis=1) > _SETTLED_STEP
        if not left.any():
            break
        moving, r, damping = moving[left], r[left], damping[left]
    return answer


def _exponent(x: FloatArray) -> FloatArray:
    """Return ``-log(1 - a)`` of absorption given by its logit."""
    return np.asarray(np.logaddexp(0.0, x))


# An unspecified prior may as well be so many times as wide.
DEFAULT_PRIOR_SD_SCALE = 2.0


def draw_absorption(
    posterior: AbsorptionPosterior, n_draws: int, rng: np.random.Generator
) -> FloatArray:
    """Return draws of absorption, each band by itself, shape (n_draws, n_materials, n_bands).

    Those that the posterior brings along, where it does. Otherwise, where it has its prior,
    draws stay where the data are (`band_draws`), and are Gaussian in logit absorption without;
    these come in mirrored pairs.
    """
    if posterior.draws is not None:
        return np.array(posterior.draws[: max(n_draws, 2)])
    n = 2 * ((max(n_draws, 2) + 1) // 2)
    draws = np.empty((n, *posterior.absorption.shape))
    law = prior_law(posterior)
    for band, covariance in enumerate(posterior.logit_covariance):
        a = posterior.absorption[:, band]
        if law is None:
            size, direction = np.linalg.eigh(covariance)
            step = antithetic_normals(n, size.size, rng) * np.sqrt(np.maximum(size, 0.0))
            share = expit(logit(a) + step @ direction.T)
            draws[:, :, band] = np.where(np.diag(covariance) == 0.0, a, share)
        else:
            own = a, covariance, law[0][band], law[1][band]
            draws[:, :, band] = band_draws(*own, n, rng, specified=posterior.prior_specified)
    return draws


def band_draws(
    absorption: FloatArray,
    covariance_logit: FloatArray,
    prior_logit_mean: FloatArray,
    prior_logit_covariance: FloatArray,
    n_draws: int,
    rng: np.random.Generator,
    *,
    specified: BoolArray | None = None,
) -> FloatArray:
    """Return draws of one band that stay where the data are, shape (n_draws, n_materials).

    The default prior of an unspecified wall is a guess. In a room with many hard walls it pulls
    them all one way, and then their sum lies farther off than its parts. The draws take such a
    prior for up to twice as wide as the answer did: by as much as the data know of the wall.

    Shapes: `absorption, prior_logit_mean, specified` (n_materials,), `covariance_logit,
    prior_logit_covariance` (n_materials, n_materials).
    """
    draws = np.tile(absorption, (n_draws, 1))
    own, twin = _own(absorption, covariance_logit, prior_logit_covariance)
    if own.size:
        mean, prior = prior_logit_mean[own], prior_logit_covariance[np.ix_(own, own)]
        covariance = covariance_logit[np.ix_(own, own)]
        # where the data determine little a wider prior would leave other walls undetermined
        informed = np.clip(1.0 - np.diag(covariance) / np.diag(prior), 0.0, 1.0)
        sd = np.sqrt(shared_variance(prior))
        is_default = is_default_prior(mean, sd) if specified is None else ~specified[own]
        scale = np.where(is_default, 1.0 + (DEFAULT_PRIOR_SD_SCALE - 1.0) * informed, 1.0)
        answer = absorption[own], covariance, mean, prior
        drawn = rto_draws(*answer, n_draws, rng, prior_sd_scale=scale)
        draws[:, np.diag(covariance_logit) > 0.0] = drawn[:, twin]
    return draws


def draw_prior(
    posterior: AbsorptionPosterior, n_draws: int, rng: np.random.Generator
) -> FloatArray | None:
    """Return draws of the absorption before anything was measured, None where that is not known.

    Of the shape (n_draws, n_materials, n_bands), fixed and tied as in `band_draws`.
    """
    law = prior_law(posterior)
    if law is None:
        return None
    bands = zip(posterior.absorption.T, posterior.logit_covariance, *law, strict=True)
    return np.stack([prior_draws(*band, n_draws, rng) for band in bands], axis=2)


def prior_draws(
    absorption: FloatArray,
    covariance_logit: FloatArray,
    prior_logit_mean: FloatArray,
    prior_logit_covariance: FloatArray,
    n_draws: int,
    rng: np.random.Generator,
) -> FloatArray:
    """Return draws of one band from the prior alone, shape (n_draws, n_materials)."""
    draws = np.tile(absorption, (n_draws, 1))
    own, twin = _own(absorption, covariance_logit, prior_logit_covariance)
    if own.size:
        noise = antithetic_normals(n_draws, own.size, rng)
        root = np.linalg.cholesky(prior_logit_covariance[np.ix_(own, own)])
        drawn = expit(prior_logit_mean[own] + noise @ root.T)
        draws[:, np.diag(covariance_logit) > 0.0] = drawn[:, twin]
    return draws


def _own(
    absorption: FloatArray, covariance: FloatArray, prior: FloatArray
) -> tuple[IntArray, IntArray]:
    """Return which materials vary by themselves, and for each that varies which of them it is.

    Errors that are added to each material by itself leave a tie in the prior alone, and a file
    without the prior's covariance holds it in that of the answer alone.
    """
    own, twin = list[int](), list[int]()
    for i in np.flatnonzero(np.diag(covariance) > 0.0).tolist():
        same = [
            k
            for k, j in enumerate(own)
            if absorption[j] == absorption[i]
            and (np.array_equal(prior[j], prior[i]) or np.allclose(covariance[j], covariance[i]))
        ]
        twin.append(same[0] if same else len(own))
        own += [] if same else [i]
    return np.array(own, dtype=np.int64), np.array(twin, dtype=np.int64)
