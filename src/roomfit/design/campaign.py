"""A campaign, and the result of a fit, as the arguments of `roomfit.design`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from roomfit.base.errors import located
from roomfit.design.candidates import DesignOptions
from roomfit.files import inputs
from roomfit.files.campaign import Campaign
from roomfit.room.scene import Scene, named_pairs
from roomfit.uncertainty.other_room import common_bands, room_posterior
from roomfit.uncertainty.posterior import AbsorptionPosterior


def design_arguments(
    campaign: Campaign,
    result: AbsorptionPosterior | None = None,
    changed: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return a campaign, read with ``to_fit=False``, as arguments of `roomfit.design`.

    Recordings are not read: which pairs they belong to is all that counts.

    Parameters
    ----------
    campaign : Campaign
    result : AbsorptionPosterior, optional
        A finished fit, from `roomfit.read_result`; materials are matched by name.
    changed : mapping of option to value, optional
        Fields of `DesignOptions` that stand instead of the campaign's.
    """
    room, bands, absorption = inputs.campaign_room(campaign), campaign.bands, None
    options = campaign.design.model_dump()
    options |= {"n_draws": options.pop("draws"), "position_sd_m": options.pop("position_sd")}
    if result is not None:
        # its criterion counts without a fit
        options["criterion"] = None
        with located(f"{campaign.path}, identify"):
            bands, doubts = common_bands(campaign.bands, result.bands)
    priors = inputs.room_priors(campaign, room, bands)
    if result is not None:
        with located(str(campaign.path)):
            absorption = replace(room_posterior(result, priors, bands), findings=doubts)
    return {
        "scene": _measured_scene(campaign, inputs.campaign_scene(campaign, room)),
        "materials": priors,
        "bands": bands,
        "absorption": absorption,
        "directivities": inputs.source_directivities(campaign, bands),
        "options": DesignOptions(**{**options, **(changed or {})}),
        "settings": campaign.settings,
    }


def _measured_scene(campaign: Campaign, scene: Scene) -> Scene:
    """Return all sources and receivers of a campaign, and the pairs measured to be fitted."""
    names = {(m.source, m.receiver) for m in campaign.measurements if m.use == "fit"}
    tables = inputs.read_measurements(campaign.with_rows(campaign.tables))
    names |= {(v.source, v.receiver) for v in tables if v.use == "fit"}
    return named_pairs(scene, names)
