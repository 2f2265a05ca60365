"""How the sources of a campaign radiate."""

from __future__ import annotations

from dataclasses import dataclass

from roomfit.bands import Bands
from roomfit.errors import located
from roomfit.files.campaign.campaign import Campaign
from roomfit.files.campaign.schema import Directivity as FirstOrderTable
from roomfit.files.campaign.schema import MeasuredDirectivity as MeasuredTable
from roomfit.files.directivity import read_directivity
from roomfit.response.directivity import Directivity, FirstOrderBands, aimed
from roomfit.scene.scene import Scene
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
    told = campaign.directivities.get(name, "omni")
    if told == "fit":
        return UnknownDirectivity()
    if isinstance(told, FirstOrderTable) and told.b_sd > 0.0:
        with located(f"{campaign.path}, sources.{name}.directivity"):
            return UnknownDirectivity(aimed(told.aim, told.b).b, told.b_sd)
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
    told = campaign.directivities.get(name, "omni")
    if told == "omni" or unknown_directivity(campaign, name) is not None:
        return None
    if isinstance(told, FirstOrderBands):
        return told
    folder = campaign.path.parent
    with located(f"{campaign.path}, sources.{name}.directivity"):
        if isinstance(told, str):
            return read_directivity(folder / told, bands)
        if isinstance(told, FirstOrderTable):
            return aimed(told.aim, told.b)
        table: MeasuredTable = told
        return read_directivity(folder / table.file, bands, table.aim, table.up)
