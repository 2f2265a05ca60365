"""How the sources of a campaign radiate."""

from __future__ import annotations

from roomfit.bands import Bands
from roomfit.errors import located
from roomfit.files.campaign.campaign import Campaign
from roomfit.files.campaign.schema import Directivity as FirstOrderTable
from roomfit.files.campaign.schema import MeasuredDirectivity as MeasuredTable
from roomfit.files.directivity import read_directivity
from roomfit.response.directivity import Directivity, aimed
from roomfit.scene.scene import Scene


def campaign_directivities(
    campaign: Campaign, scene: Scene, bands: Bands
) -> tuple[Directivity | None, ...]:
    """Return the directivity of every source of a scene; None is omnidirectional.

    Raises
    ------
    InputError
        An aim without length, or a file that cannot be read.
    """
    return tuple(_directivity(campaign, s.name, bands) for s in scene.sources)


def _directivity(campaign: Campaign, name: str, bands: Bands) -> Directivity | None:
    told = campaign.directivities.get(name, "omni")
    if told == "omni":
        return None
    folder = campaign.path.parent
    with located(f"{campaign.path}, sources.{name}.directivity"):
        if isinstance(told, str):
            return read_directivity(folder / told, bands)
        if isinstance(told, FirstOrderTable):
            return aimed(told.aim, told.b)
        table: MeasuredTable = told
        return read_directivity(folder / table.file, bands, table.aim, table.up)
