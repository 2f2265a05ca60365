"""What a campaign file says of materials and of the directivity of sources."""

from __future__ import annotations

import numpy as np

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
from roomfit.materials.catalogue import material_prior
from roomfit.materials.priors import MaterialPrior, complete_priors
from roomfit.response.directivity import Directivity, UnknownDirectivity, aimed
from roomfit.typing import FloatArray


def source_directivities(
    campaign: Campaign, bands: Bands
) -> dict[str, Directivity | UnknownDirectivity]:
    """Return the directivity of every source that is not omnidirectional.

    Raises
    ------
    InputError
        An aim without length, or a file that cannot be read.
    """
    found = {}
    for name, table in campaign.directivities.items():
        with located(f"{campaign.path}, sources.{name}.directivity"):
            directivity = _directivity(campaign, table, bands)
        if directivity is not None:
            found[name] = directivity
    return found


def _directivity(
    campaign: Campaign, table: str | FirstOrderTable | MeasuredTable, bands: Bands
) -> Directivity | UnknownDirectivity | None:
    folder = campaign.path.parent
    if table == "omni":
        return None
    if table == "fit":
        return UnknownDirectivity()
    if isinstance(table, str):
        return read_directivity(folder / table, bands)
    if isinstance(table, FirstOrderTable):
        known = aimed(table.aim, table.b)
        return UnknownDirectivity(known.b, table.b_sd) if table.b_sd > 0.0 else known
    return read_directivity(folder / table.file, bands, table.aim, table.up)


def material_priors(campaign: Campaign, materials: tuple[str, ...]) -> tuple[MaterialPrior, ...]:
    """Return what the campaign says of each of the room's materials, in their order.

    Raises
    ------
    InputError
        The campaign describes a material that the room does not have; or lists that do not have
        one value per fitted band; or a prior outside its bounds.
    """
    with located(str(campaign.path)):
        return complete_priors(
            materials,
            [
                _material_prior(table, name, campaign.bands)
                for name, table in campaign.materials.items()
            ],
            campaign.bands,
        )


def _material_prior(table: MaterialTable, name: str, bands: Bands) -> MaterialPrior:
    prior = table.prior
    scattering = table.scattering
    return material_prior(
        name,
        bands,
        absorption=table.absorption,
        prior=prior if prior is None or isinstance(prior, str) else (prior.mean, prior.sd),
        bounds=table.bounds,
        scattering=(
            _at_bands(scattering, bands, f"materials.{name}.scattering")
            if isinstance(scattering, Spectrum)
            else scattering
        ),
        same_absorption_as=table.same_absorption_as,
        delay_sd_s=None if table.delay_sd_ms is None else 1e-3 * table.delay_sd_ms,
    )


def _at_bands(table: Spectrum, bands: Bands, where: str) -> FloatArray:
    """Return coefficients at the bands, interpolated over the logarithm of the frequency."""
    if len(table.centres_hz) != len(table.values):
        raise InputError(
            "scattering has not as many values as centres",
            where=where,
            found=f"{len(table.values)} values and {len(table.centres_hz)} centres",
        )
    order = np.argsort(table.centres_hz)
    at = np.log(np.array(table.centres_hz)[order])
    return np.asarray(np.interp(np.log(bands.centres_hz), at, np.array(table.values)[order]))
