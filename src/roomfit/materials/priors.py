"""What is known of a material before anything is measured: priors of absorption, scattering."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from roomfit.base.arguments import check_known, check_range, check_shape, float_array, unique_names
from roomfit.base.bands import Bands
from roomfit.base.errors import InputError
from roomfit.base.logit import expit, logit
from roomfit.base.typing import BoolArray, FloatArray, IntArray

# A broad prior of absorption: 95 % of it from 0.01 to 0.77.
DEFAULT_MEAN = 0.15
DEFAULT_LOGIT_SD = 1.5

# How far, in logit, absorptions of walls of one product lie from what they have in common: by about
# a quarter of a small absorption, by 0.075 of one of a half. Mounting, edges and air behind panels.
PRODUCT_SD = 0.3
PRODUCT_SDS = (1e-3, 5.0)

# Sound meets what stands in a room once in so many metres, whatever its path. A path's loss is
# rounded to whole steps: by 0.3 % of its energy at most for 12 m2 in 250 m3.
OBJECT_STEP_M = 0.5
# An unknown area lies below its prior mean and so many standard deviations.
_OBJECT_REACH_SD = 8.0


@dataclass(frozen=True, slots=True, eq=False)
class MaterialPrior:
    """What is known of one material in every fitted band before anything is measured."""

    name: str
    prior_logit_mean: FloatArray  # (n_bands,), of the Gaussian prior of logit absorption
    prior_logit_sd: FloatArray  # (n_bands,)
    scattering: FloatArray | None = None  # (n_bands,), coefficient 0 to 1; None: unspecified
    known: FloatArray | None = None  # (n_bands,), absorption that is fixed
    lower: float = 0.0  # absorption lies strictly between lower and upper
    upper: float = 1.0
    # scattering is a parameter of the fit; `scattering`, where specified, is where it starts
    fit_scattering: bool = False
    tied_to: str | None = None  # another material whose absorption this one shares in every band
    # prior sd of the delay that the material adds at each reflection, about zero; None where the
    # fit decides whether and how widely it looks
    wall_delay_sd_s: float | None = None
    specified: bool = True  # whether a prior or bounds were given, rather than the broad default
    # what it is made of: materials of one product share a logit absorption with the prior above,
    # from which each lies off by `product_sd` (standard deviation, in logit); None: by itself
    product: str | None = None
    product_sd: float = PRODUCT_SD
    # of an object, not a wall: the volume of its room, where "absorption" is the share of energy
    # that is lost in `OBJECT_STEP_M`, see `object_prior`
    object_volume_m3: float | None = None

    def __post_init__(self) -> None:
        where = f"materials.{self.name}"
        if not 0.0 <= self.lower < self.upper <= 1.0:
            raise InputError(
                "lower bound is not below the upper one",
                where=f"{where}.bounds",
                found=f"{self.lower:g} and {self.upper:g}",
                needed="0 <= lower < upper <= 1",
                hint=f"write bounds = [0.0, 1.0] under [{where}], or leave them out",
            )
        n = len(self.prior_logit_mean)
        for name in ("prior_logit_mean", "prior_logit_sd"):
            values = float_array(f"{where} {name}", getattr(self, name), (n,))
            object.__setattr__(self, name, values)
        for name, key in (("known", "absorption"), ("scattering", "scattering")):
            value = getattr(self, name)
            if value is not None:
                values = float_array(f"{where}.{key}", value, (n,), low=0.0, high=1.0)
                object.__setattr__(self, name, values)
        check_range("spread of the walls of a product", self.product_sd, *PRODUCT_SDS, where=where)
        if self.wall_delay_sd_s is not None:
            check_range("spread of a wall's delay", self.wall_delay_sd_s, 0.0, 0.1, "s", where)
        if self.tied_to is None:
            return
        tied, or_other = f"tied to {self.tied_to!r}", "the other"
        needed, what = "another material's name", "a material is tied to itself"
        if self.product is not None:
            what, or_other = "a tied material is of a product", "product"
            tied += f", product {self.product!r}"
            needed = "either: equal to one wall, or like all walls of a product"
        elif self.tied_to != self.name and self.known is not None:
            what, tied = "a tied material has a value of its own", f"{tied} and absorption given"
            needed = "either a tie or a given absorption"
        elif self.tied_to != self.name:
            return
        hint = f"leave out same_absorption_as, or {or_other}"
        raise InputError(what, where=where, found=tied, needed=needed, hint=hint)


def object_volumes_m3(priors: Sequence[MaterialPrior]) -> dict[str, float]:
    """Return the volume of the room of every object among some priors, by its name."""
    return {k.name: v for k in priors if (v := k.object_volume_m3) is not None}


def sampling_scattering(prior: MaterialPrior) -> float | None:
    """Return the one coefficient to trace with, the mean over the bands; None if unspecified.

    Paths traced with it are weighed for the coefficients of each band afterwards.
    """
    given = prior.scattering
    if given is None:
        return None
    # the mean of equal numbers is not always that number, to the last bit
    return float(given[0] if np.all(given == given[0]) else np.mean(given))


def in_bands(priors: tuple[MaterialPrior, ...], chosen: IntArray) -> tuple[MaterialPrior, ...]:
    """Return the priors of some of the bands only.

    `chosen`: indices among the bands of `priors`.
    """
    rows = ("prior_logit_mean", "prior_logit_sd", "scattering", "known")
    own = [{r: x[chosen] for r in rows if (x := getattr(k, r)) is not None} for k in priors]
    return tuple(replace(k, **changed) for k, changed in zip(priors, own, strict=True))


def logit_prior(mean: FloatArray, sd: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean and standard deviation of logit absorption from those of absorption.

    To first order: ``sd_logit = sd / (mean (1 - mean))``.

    `mean`: 0 < mean < 1. `sd`: above 0, dimensionless.
    """
    return logit(mean, 0.0), sd / (mean * (1.0 - mean))


def logit_normal(mean: FloatArray, sd: FloatArray, z: FloatArray) -> FloatArray:
    """Return draws between 0 and 1 about a mean; where the spread is 0 the mean itself.

    `mean, sd`, shape (n_bands,): of absorption coefficients; the mean is taken as 0.0001 to 0.9999.
    `z`, shape (n_draws,) or (n_draws, n_bands): standard normal numbers, for all bands or each.
    """
    middle, width = logit_prior(np.clip(mean, 1e-4, 1.0 - 1e-4), sd)
    drawn = expit(middle + width * z.reshape(len(z), -1))
    return np.asarray(np.where(sd > 0.0, drawn, mean))


def prior_logit_law(priors: tuple[MaterialPrior, ...]) -> tuple[FloatArray, FloatArray]:
    """Return the mean and the covariance of logit absorption before anything is measured.

    This is the one law that every use of priors goes by. A tied material has its leader's numbers.
    Materials of one product have the covariance ``s^2 + d^2`` with themselves and ``s^2`` with each
    other, s the prior standard deviation and d that of the product: what they share is integrated
    out. Where the absorption of some of them is known, the law of the others is the one given that;
    the known ones keep theirs, and are correlated with none.

    `mean` has the shape (n_materials, n_bands). `covariance` has the shape (n_bands, n_materials,
    n_materials): singular where materials are tied to each other, positive definite among all
    others.
    """
    names = [k.name for k in priors]
    leader = np.array([names.index(k.tied_to or k.name) for k in priors])
    mean = np.array([k.prior_logit_mean for k in priors])
    variance = np.array([k.prior_logit_sd for k in priors]).T ** 2
    covariance = variance[:, :, None] * np.eye(len(priors))
    for members in _products(priors).values():
        known = np.array([priors[i].known is not None for i in members])
        fixed, free = np.array(members)[known], np.array(members)[~known]
        own = priors[members[0]].product_sd ** 2 * np.eye(len(members))
        of = [(p.known, p.lower, p.upper) for p in (priors[i] for i in members)]
        at = [logit((x - a) / (b - a), 1e-9) for x, a, b in of if x is not None]
        for band, common in enumerate(variance[:, members[0]]):
            whole = common + own
            gain = whole[np.ix_(~known, known)] @ np.linalg.inv(whole[np.ix_(known, known)])
            off = np.array([a[band] for a in at]) - mean[fixed, band]
            mean[free, band] += gain @ off
            left = whole[np.ix_(~known, ~known)] - gain @ whole[np.ix_(known, ~known)]
            covariance[band][np.ix_(free, free)] = 0.5 * (left + left.T)
    return mean[leader], covariance[:, leader][:, :, leader]


def plain_logit_law(priors: tuple[MaterialPrior, ...]) -> tuple[FloatArray, FloatArray]:
    """Return `prior_logit_law` with objects by the logit of their absorption, whatever its bound.

    To first order; an object's area is far below its bound.
    """
    mean, covariance = prior_logit_law(priors)
    for i, k in enumerate(priors):
        if k.object_volume_m3 is not None:
            share = expit(mean[i])
            slope = (1.0 - share) / (1.0 - k.upper * share)
            mean[i] = logit(k.upper * share, 0.0)
            covariance[:, i] *= slope[:, None]
            covariance[:, :, i] *= slope[:, None]
    return mean, covariance


def prior_logits(priors: tuple[MaterialPrior, ...]) -> FloatArray:
    """Return prior mean and standard deviation of logit absorption, each material by itself.

    Those of `prior_logit_law`, side by side.

    The result has the shape (2, n_materials, n_bands).
    """
    mean, covariance = prior_logit_law(priors)
    return np.array([mean, np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)).T])


def shared_variance(covariance: FloatArray) -> FloatArray:
    """Return what of each variance is shared with others, all of it where nothing is, (n,).

    `covariance`, shape (n, n): of one band of `prior_logit_law`, none of them tied.
    """
    others = np.max(np.where(np.eye(len(covariance)), 0.0, covariance), axis=1, initial=0.0)
    return np.where(others > 0.0, others, np.diag(covariance))


def symmetric_root(covariance: FloatArray) -> FloatArray:
    """Return W with ``W @ covariance @ W.T`` the identity, nearest to a scaling of each, (n, n).

    The symmetric inverse root of the correlation, over the standard deviations.
    """
    sd = np.sqrt(np.diag(covariance))
    size, direction = np.linalg.eigh(covariance / np.outer(sd, sd))
    return np.asarray((direction / np.sqrt(size)) @ direction.T / sd)


def _products(priors: Sequence[MaterialPrior]) -> dict[str, list[int]]:
    """Return which materials are of each product that any names."""
    found: dict[str, list[int]] = {}
    for i, k in enumerate(priors):
        if k.product is not None:
            found.setdefault(k.product, []).append(i)
    return found


def object_absorption(area_m2: FloatArray, volume_m3: float) -> FloatArray:
    """Return the share of energy that objects absorb while sound travels `OBJECT_STEP_M`.

    ``1 - exp(-A step / (4 V))``: rays cross a volume V evenly in a diffuse field, and those that
    would meet an area A of full absorption are lost (ISO 354, where A is that of objects).

    `area_m2`: equivalent absorption area A, 0 or more. `volume_m3`: of the room.
    """
    return np.asarray(-np.expm1(-area_m2 * OBJECT_STEP_M / (4.0 * volume_m3)))


def object_area_m2(absorption: FloatArray, volume_m3: float) -> FloatArray:
    """Return the equivalent absorption area of objects: the inverse of `object_absorption`."""
    return np.asarray(-np.log1p(-absorption) * 4.0 * volume_m3 / OBJECT_STEP_M)


def object_prior(
    name: str,
    bands: Bands,
    volume_m3: float,
    *,
    absorption_area_m2: ArrayLike | None = None,
    prior_m2: tuple[ArrayLike, ArrayLike] | None = None,
) -> MaterialPrior:
    """Return what is known of the equivalent absorption area of an object, in a room's volume.

    To be given to `roomfit.identify` among the materials; the room has the object by
    `roomfit.room.scene.with_objects`.

    `volume_m3`: of the room, above 0. `absorption_area_m2`, shape () or (n_bands,): known area of
    all its pieces together, 0 or more, in m2. `prior_m2`: of an unknown one, each above 0 and of
    shape () or (n_bands,): a logit-normal law of this mean and standard deviation, to first order,
    between 0 and 8 standard deviations more.
    """
    where, n = f"objects.{name}", len(bands)
    if (absorption_area_m2 is None) == (prior_m2 is None):
        raise InputError(
            "an object needs a known absorption area or a prior of it",
            where=where,
            found=("none of the two" if prior_m2 is None else "both"),
            needed="either absorption_area_m2 or prior",
            hint="keep the one of the two that is known",
        )

    def per_band(key: str, values: ArrayLike, low: float) -> FloatArray:
        given = np.asarray(values, dtype=np.float64)
        whole = np.full(n, float(given)) if given.ndim == 0 else given
        return float_array(f"{where}.{key}", whole, (n,), low=low, high=1e6, unit="m2")

    ones = np.ones(n)
    plain = MaterialPrior(
        name, 0.0 * ones, ones, 0.0 * ones, wall_delay_sd_s=0.0, object_volume_m3=volume_m3
    )
    if prior_m2 is None:
        area_m2 = per_band("absorption_area_m2", cast("ArrayLike", absorption_area_m2), 0.0)
        return replace(plain, known=object_absorption(area_m2, volume_m3))
    mean, sd = per_band("prior.mean", prior_m2[0], 1e-6), per_band("prior.sd", prior_m2[1], 1e-6)
    most = float(object_absorption(mean + _OBJECT_REACH_SD * sd, volume_m3).max())
    # that of the logarithm of a log-normal law with this mean and standard deviation
    spread = np.sqrt(np.log1p((sd / mean) ** 2))
    middle = object_absorption(mean, volume_m3) / most * np.exp(-0.5 * spread**2)
    prior_sd = spread / (1.0 - middle)
    return replace(plain, prior_logit_mean=logit(middle, 0.0), prior_logit_sd=prior_sd, upper=most)


def unknown_material(name: str, n_bands: int) -> MaterialPrior:
    """Return the broad default prior, of a material of which nothing is specified."""
    mean, _ = logit_prior(np.full(n_bands, DEFAULT_MEAN), np.ones(n_bands))
    return MaterialPrior(name, mean, np.full(n_bands, DEFAULT_LOGIT_SD), specified=False)


def are_specified(priors: tuple[MaterialPrior, ...]) -> BoolArray:
    """Return whose prior was specified, its leader's where a material is tied, (n_materials,).

    A known absorption specifies that of all walls of its product.
    """
    by_name = {k.name: k for k in priors}
    known = {k.product for k in priors if k.known is not None} - {None}
    leaders = [by_name[k.tied_to or k.name] for k in priors]
    return np.array([k.specified or k.product in known for k in leaders])


def complete_priors(
    materials: Sequence[str], priors: Sequence[MaterialPrior], bands: Bands
) -> tuple[MaterialPrior, ...]:
    """Return a prior for each material of a room, in their order: by default the broad one.

    `materials`: of the room. `priors`: in any order, in these bands.
    """
    unique_names("prior", [k.name for k in priors])
    by_name = {k.name: k for k in priors}
    for k in priors:
        what, where = "a prior of a material that the room does not have", f"materials.{k.name}"
        check_known(what, k.name, materials, where=where, else_try="see [room.materials]")
        check_shape(f"the prior of {where}", k.prior_logit_mean, (len(bands),))
    found = tuple(by_name.get(m, unknown_material(m, len(bands))) for m in materials)
    _check_ties(found)
    products = _products(found)
    for name, members in products.items():
        _check_product(name, [found[i] for i in members])
    # one material of a product shares nothing: what is known of the product is known of it
    alone = {members[0] for members in products.values() if len(members) == 1}
    return tuple(replace(k, product=None) if i in alone else k for i, k in enumerate(found))


def _check_product(name: str, members: list[MaterialPrior]) -> None:
    first = members[0]
    stated = [
        (*k.prior_logit_mean, *k.prior_logit_sd, k.lower, k.upper, k.product_sd, k.specified)
        for k in members
    ]
    for k, own in zip(members, stated, strict=True):
        if own != stated[0]:
            raise InputError(
                "materials of one product have different priors",
                where=f"materials.{k.name}",
                found=f"not what materials.{first.name} states of {name!r}",
                needed="one prior, one pair of bounds and one product_sd for all of a product",
                hint=f"state them once, in [products.{name}]",
            )
        if k.known is not None and not np.all((k.known > k.lower) & (k.known < k.upper)):
            what = "an absorption at its bound says nothing of other walls of a product"
            found, needed = f"{k.known}", f"{k.lower:g} < absorption < {k.upper:g}"
            hint = "leave out its product"
            raise InputError(
                what, where=f"materials.{k.name}.absorption", found=found, needed=needed, hint=hint
            )


def _check_ties(found: tuple[MaterialPrior, ...]) -> None:
    tied_to = {k.name: k.tied_to for k in found}
    for name, leader in tied_to.items():
        if leader is None:
            continue
        where = f"materials.{name}.same_absorption_as"
        what = "a material is tied to one that the room does not have"
        check_known(what, leader, tied_to, where=where)
        if tied_to[leader] is not None:
            raise InputError(
                "a material is tied to one that is tied itself",
                where=where,
                found=f"{leader!r}, tied to {tied_to[leader]!r}",
                needed="a material with an absorption of its own",
                hint=f"write same_absorption_as = {tied_to[leader]!r}",
            )


def is_default_prior(prior_logit_mean: FloatArray, prior_logit_sd: FloatArray) -> BoolArray:
    """Return which priors equal the broad default, where a file does not say what was specified."""
    mean, _ = logit_prior(np.array(DEFAULT_MEAN), np.array(1.0))
    # numbers that went through a file
    same = np.isclose(prior_logit_mean, mean, rtol=1e-4)
    return np.asarray(same & np.isclose(prior_logit_sd, DEFAULT_LOGIT_SD, rtol=1e-4))


@dataclass(frozen=True, slots=True, eq=False)
class Scattering:
    """Sampling scattering coefficient of every material.

    A ray that strikes a material leaves it in a direction drawn from Lambert's law with
    probability s and specularly otherwise. Nothing is lost: after n hits a ray has the energy
    ``(1 - a) ** n`` for every s.

    Coefficients of several groups of bands stand in rows: a trace divides its rays equally among
    them, and its paths are drawn from the mixture.
    """

    materials: tuple[str, ...]
    # (n_materials,) or (n_groups, n_materials), 0 <= s <= 1 (ISO 17497-1: share of reflected energy
    # that is not specular)
    coefficients: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "materials", unique_names("material", self.materials))
        groups = (None,) if np.ndim(self.coefficients) == 2 else ()
        shape = (*groups, len(self.materials))
        s = float_array("scattering coefficient", self.coefficients, shape, low=0.0, high=1.0)
        object.__setattr__(self, "coefficients", s)


def uniform_scattering(materials: tuple[str, ...], coefficient: float) -> Scattering:
    """Return the same scattering coefficient for every material.

    Examples
    --------
    >>> uniform_scattering(("floor", "walls"), 0.2).coefficients
    array([0.2, 0.2])
    """
    return Scattering(materials, [coefficient] * len(materials))  # type: ignore[arg-type]


def coefficients_in_order(scattering: Scattering, materials: tuple[str, ...]) -> FloatArray:
    """Return a copy of the coefficients in the order of a room's materials, their last axis."""
    if set(scattering.materials) != set(materials):
        what = "scattering and room name different materials"
        hint = "give the scattering of each material of the room, in any order"
        raise InputError(
            what, found=", ".join(scattering.materials), needed=", ".join(materials), hint=hint
        )
    order = [scattering.materials.index(m) for m in materials]
    return np.array(scattering.coefficients[..., order])
