"""What a campaign file says of each material beforehand.

How the sources of a campaign radiate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roomfit._checks import nearest
from roomfit.bands import Bands
from roomfit.errors import InputError, located
from roomfit.io.campaign import (
    Campaign,
    MaterialTable,
    Spectrum,
)
from roomfit.io.campaign import (
    Directivity as FirstOrderTable,
)
from roomfit.io.campaign import (
    MeasuredDirectivity as MeasuredTable,
)
from roomfit.io.directivity import read_directivity
from roomfit.materials.catalogue import catalogue_prior
from roomfit.materials.priors import DEFAULT_MEAN, MaterialPrior, logit_prior, unknown_material
from roomfit.response.directivity import Directivity, FirstOrderBands, aimed
from roomfit.scene import Scene
from roomfit.typing import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class UnknownDirectivity:
    """What a campaign says of a first-order directivity that is to be fitted.

    Attributes
    ----------
    mean : float array, shape (3,), or None
        Of b; None where nothing is told.
    sd : float or None
        Of each component of b; None where nothing is told.
    """

    mean: FloatArray | None = None
    sd: float | None = None


def unknown_directivity(campaign: Campaign, name: str) -> UnknownDirectivity | None:
    """Return what is said of a source whose directivity is to be fitted; None where it is known.

    Raises
    ------
    InputError
        An aim without length.
    """
    specified = campaign.directivities.get(name, "omni")
    if specified == "fit":
        return UnknownDirectivity()
    if isinstance(specified, FirstOrderTable) and specified.b_sd > 0.0:
        with located(f"{campaign.path}, sources.{name}.directivity"):
            return UnknownDirectivity(aimed(specified.aim, specified.b).b, specified.b_sd)
    return None


def campaign_directivities(
    campaign: Campaign, scene: Scene, bands: Bands
) -> tuple[Directivity | None, ...]:
    """Return the known directivity of every source of a scene.

    None is omnidirectional, or to be fitted (`unknown_directivity`).

    Raises
    ------
    InputError
        An aim without length, or a file that cannot be read.
    """
    return tuple(_directivity(campaign, s.name, bands) for s in scene.sources)


def _directivity(campaign: Campaign, name: str, bands: Bands) -> Directivity | None:
    specified = campaign.directivities.get(name, "omni")
    if specified == "omni" or unknown_directivity(campaign, name) is not None:
        return None
    if isinstance(specified, FirstOrderBands):
        return specified
    folder = campaign.path.parent
    with located(f"{campaign.path}, sources.{name}.directivity"):
        if isinstance(specified, str):
            return read_directivity(folder / specified, bands)
        if isinstance(specified, FirstOrderTable):
            return aimed(specified.aim, specified.b)
        table: MeasuredTable = specified
        return read_directivity(folder / table.file, bands, table.aim, table.up)


def material_priors(campaign: Campaign, materials: tuple[str, ...]) -> tuple[MaterialPrior, ...]:
    """Return what the campaign says of each of the room's materials, in their order.

    Raises
    ------
    InputError
        The campaign describes a material that the room does not have; or lists that do not have
        one value per fitted band; or a prior outside its bounds.
    """
    for name in campaign.materials:
        if name not in materials:
            guess = nearest(name, materials)
            raise InputError(
                "the campaign describes a material that the room does not have",
                where=f"{campaign.path}, materials.{name}",
                needed=f"one of {', '.join(materials)}",
                hint=f"did you mean {guess!r}?" if guess else "see [room.materials]",
            )
    with located(str(campaign.path)):
        found = tuple(_material_prior(campaign, name) for name in materials)
    _check_ties(campaign, found)
    return found


def _check_ties(campaign: Campaign, found: tuple[MaterialPrior, ...]) -> None:
    tied_to = {k.name: k.tied_to for k in found}
    for name, leader in tied_to.items():
        if leader is None:
            continue
        where = f"{campaign.path}, materials.{name}.same_absorption_as"
        if leader not in tied_to:
            guess = nearest(leader, tuple(tied_to))
            raise InputError(
                "a material is tied to one that the room does not have",
                where=where,
                found=repr(leader),
                needed=f"one of {', '.join(tied_to)}",
                hint=f"did you mean {guess!r}?" if guess else None,
            )
        if tied_to[leader] is not None:
            raise InputError(
                "a material is tied to one that is tied itself",
                where=where,
                found=f"{leader!r}, tied to {tied_to[leader]!r}",
                needed="a material with an absorption of its own",
                hint=f"write same_absorption_as = {tied_to[leader]!r}",
            )


def _material_prior(campaign: Campaign, name: str) -> MaterialPrior:
    n = len(campaign.bands)
    plain = unknown_material(name, n)
    table = campaign.materials.get(name)
    if table is None:
        return plain
    where = f"materials.{name}"
    mean, sd = plain.prior_logit_mean, plain.prior_logit_sd
    lower, upper = table.bounds if table.bounds is not None else (0.0, 1.0)
    if table.bounds is not None:
        # the broad prior's middle where it lies well between the bounds, else theirs
        share = (DEFAULT_MEAN - lower) / (upper - lower)
        share = share if 0.1 <= share <= 0.9 else 0.5
        mean, _ = logit_prior(np.full(n, share), np.ones(n))
    prior = _specified_prior(campaign, table, where)
    if prior is not None:
        alpha, alpha_sd = prior
        inside = (alpha > max(lower, 0.0)) & (alpha < min(upper, 1.0)) & (alpha_sd > 0.0)
        if not np.all(inside):
            band = int(np.argmin(inside))
            raise InputError(
                "a prior lies outside of its bounds or has no spread",
                where=f"{where}.prior",
                found=f"mean {alpha[band]:g}, sd {alpha_sd[band]:g} "
                f"at {campaign.bands.centres_hz[band]:g} Hz",
                needed=f"{lower:g} < mean < {upper:g} and sd > 0",
                hint="to hold an absorption fixed, write absorption = [...] instead",
            )
        between = (alpha - lower) / (upper - lower)
        mean, sd = logit_prior(between, alpha_sd / (upper - lower))
    known = None
    if table.absorption is not None:
        known = _per_band(table.absorption, n, f"{where}.absorption")
        _check_within(known, lower, upper, f"{where}.absorption")
    return MaterialPrior(
        name,
        mean,
        sd,
        scattering=_scattering(table, campaign.bands, where),
        known=known,
        lower=lower,
        upper=upper,
        fit_scattering=table.scattering == "fit",
        tied_to=table.same_absorption_as,
        wall_delay_sd_s=None if table.delay_sd_ms is None else 1e-3 * table.delay_sd_ms,
        specified=prior is not None or table.bounds is not None,
    )


def _specified_prior(
    campaign: Campaign, table: MaterialTable, where: str
) -> tuple[FloatArray, FloatArray] | None:
    """Mean and standard deviation of absorption in every band, from the file or the catalogue."""
    if table.prior is None:
        return None
    if isinstance(table.prior, str):
        with located(f"{where}.prior"):
            return catalogue_prior(table.prior, campaign.bands)
    n = len(campaign.bands)
    return (
        _per_band(table.prior.mean, n, f"{where}.prior.mean"),
        _per_band(table.prior.sd, n, f"{where}.prior.sd"),
    )


def _check_within(values: FloatArray, lower: float, upper: float, where: str) -> None:
    bad = np.flatnonzero((values < lower) | (values > upper))
    if bad.size:
        raise InputError(
            "a given absorption lies outside of its own bounds",
            where=where,
            found=f"{values[bad[0]]:g}",
            needed=f"{lower:g} to {upper:g}",
            hint="remove bounds: an absorption that is given is held fixed",
        )


def _scattering(table: MaterialTable, bands: Bands, where: str) -> FloatArray | None:
    """The told coefficient of every fitted band, shape (n_bands,)."""
    specified = table.scattering
    if specified is None or isinstance(specified, str):
        return None
    if isinstance(specified, Spectrum):
        if len(specified.centres_hz) != len(specified.values):
            raise InputError(
                "scattering has not as many values as centres",
                where=f"{where}.scattering",
                found=f"{len(specified.values)} values and {len(specified.centres_hz)} centres",
            )
        order = np.argsort(specified.centres_hz)
        at = np.log(np.array(specified.centres_hz)[order])
        at_bands = np.interp(np.log(bands.centres_hz), at, np.array(specified.values)[order])
        return np.asarray(at_bands, dtype=np.float64)
    return _per_band(specified, len(bands), f"{where}.scattering")


def _per_band(values: float | list[float], n: int, where: str) -> FloatArray:
    array = np.atleast_1d(np.array(values, dtype=np.float64))
    if array.size == 1:
        return np.full(n, array[0])
    if array.size != n:
        raise InputError(
            "a list has not one value per fitted band",
            where=where,
            found=f"{array.size} values",
            needed=f"{n} values, or a single number for all bands",
        )
    return array
