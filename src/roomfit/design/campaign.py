"""A campaign, and the result of a fit, as the arguments of `roomfit.design`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any, TypedDict

from roomfit.base.bands import Bands
from roomfit.base.errors import located
from roomfit.design.candidates import DesignOptions
from roomfit.files.campaign import Campaign
from roomfit.files.inputs import CampaignInputs
from roomfit.materials.priors import MaterialPrior
from roomfit.model.patterns import Directivities
from roomfit.room.scene import Scene, named_pairs
from roomfit.settings import Settings
from roomfit.uncertainty.other_room import common_bands, room_posterior
from roomfit.uncertainty.posterior import AbsorptionPosterior


class DesignArguments(TypedDict):
    """What `roomfit.design` takes."""

    scene: Scene
    materials: tuple[MaterialPrior, ...]
    bands: Bands
    absorption: AbsorptionPosterior | None
    directivities: Directivities
    options: DesignOptions
    settings: Settings


def design_arguments(
    campaign: Campaign,
    result: AbsorptionPosterior | None = None,
    changed: Mapping[str, Any] | None = None,
) -> DesignArguments:
    """Return a campaign as arguments of `roomfit.design`.

    Recordings are not read: which pairs they belong to is all that counts.

    Parameters
    ----------
    campaign : Campaign
        Read with ``to_fit=False``: it need not have a measurement.
    result : AbsorptionPosterior, optional
        A finished fit, from `roomfit.read_result`; materials are matched by name.
    changed : mapping of option to value, optional
        Fields of `DesignOptions` that stand instead of the campaign's.

    Raises
    ------
    InputError
        The room or a table cannot be read, an option is out of range, the result and the campaign
        have no band in common, or the absorption of a material is unspecified.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import roomfit
    >>> text = '''
    ... [room]
    ... shoebox = [6, 5, 3]
    ... [sources.S]
    ... position = [1.5, 1.2, 1.5]
    ... [receivers.R]
    ... position = [4.0, 3.5, 1.2]
    ... [identify]
    ... from_hz = 1000
    ... to_hz = 1000
    ... [design]
    ... criterion = "mean"
    ... '''
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "campaign.toml"
    ...     _ = file.write_text(text)
    ...     campaign = roomfit.read_campaign(file, to_fit=False)
    >>> design_arguments(campaign, changed={"number": 4})["options"].criterion
    'mean'
    """
    inputs = CampaignInputs(campaign)
    room = inputs.room()
    bands, absorption = campaign.bands, None
    priors = inputs.priors(room)
    if result is not None:
        with located(f"{campaign.path}, identify"):
            bands, doubts = common_bands(campaign.bands, result.bands)
        priors = inputs.priors(room, bands)
        with located(str(campaign.path)):
            absorption = replace(room_posterior(result, priors, bands), findings=doubts)
    return {
        "scene": _measured_scene(campaign, inputs.scene(room)),
        "materials": priors,
        "bands": bands,
        "absorption": absorption,
        "directivities": inputs.directivities(bands),
        "options": _options(campaign, changed or {}, after_fit=result is not None),
        "settings": campaign.settings,
    }


def _options(campaign: Campaign, changed: Mapping[str, Any], *, after_fit: bool) -> DesignOptions:
    """Return the options of ``[design]`` with changes; its criterion counts without a fit."""
    table = campaign.design
    same = {f.name for f in fields(DesignOptions)} & type(table).model_fields.keys()
    options: dict[str, Any] = {name: getattr(table, name) for name in same}
    options["criterion"] = None if after_fit else table.criterion
    options |= {"n_draws": table.draws, "position_sd_m": table.position_sd}
    options |= {"sources": tuple(table.sources), "receivers": tuple(table.receivers)}
    return DesignOptions(**{**options, **changed})


def _measured_scene(campaign: Campaign, scene: Scene) -> Scene:
    """Return all sources and receivers of a campaign, and the pairs measured to be fitted."""
    names = {(m.source, m.receiver) for m in campaign.measurements if m.use == "fit"}
    tables = CampaignInputs(replace(campaign, measurements=(), spectra=())).measurements()
    names |= {(v.source, v.receiver) for v in tables if v.use == "fit"}
    return named_pairs(scene, names)
