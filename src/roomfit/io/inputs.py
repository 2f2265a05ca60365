"""A campaign file as the arguments of the functions that answer questions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TypedDict

import numpy as np

from roomfit.bands import Bands
from roomfit.io.campaign import Campaign, read_campaign
from roomfit.io.materials import material_priors, source_directivities
from roomfit.io.measurements import read_measurements
from roomfit.io.rooms import read_room
from roomfit.materials.priors import MaterialPrior
from roomfit.measurement import Measurement
from roomfit.response.directivity import Directivity, UnknownDirectivity
from roomfit.scene import Room, Scene
from roomfit.settings import Settings
from roomfit.signals.iso3382 import MeasuredValues


class IdentifyArguments(TypedDict):
    """What `roomfit.identify` takes."""

    scene: Scene
    measurements: tuple[Measurement | MeasuredValues, ...]
    materials: tuple[MaterialPrior, ...]
    bands: Bands
    settings: Settings
    directivities: dict[str, Directivity | UnknownDirectivity]


def load_campaign(path: Path | str) -> IdentifyArguments:
    """Read a campaign file and every file that it names, as arguments of `roomfit.identify`.

    Raises
    ------
    InputError
        The campaign, the room, or a measured file is not as needed.
    StoreError
        The disk refuses.

    Examples
    --------
    ``roomfit.identify(**roomfit.load_campaign("campaign.toml"))`` is what the command line does.
    """
    return identify_arguments(read_campaign(Path(path)))


def identify_arguments(campaign: Campaign) -> IdentifyArguments:
    """Return a campaign that was read as arguments of `roomfit.identify`, see `load_campaign`."""
    room = campaign_room(campaign)
    return {
        "scene": campaign_scene(campaign, room),
        "measurements": read_measurements(campaign),
        "materials": material_priors(campaign, room.materials),
        "bands": campaign.bands,
        "settings": campaign.settings,
        "directivities": source_directivities(campaign, campaign.bands),
    }


def campaign_room(campaign: Campaign) -> Room:
    """Return the room of a campaign with what was found in reading it."""
    room, findings = read_room(campaign.room)
    return replace(room, findings=findings)


def campaign_scene(campaign: Campaign, room: Room) -> Scene:
    """Return every source with every receiver that a campaign defines."""
    n_sources, n_receivers = len(campaign.sources), len(campaign.receivers)
    pairs = np.stack(np.meshgrid(range(n_sources), range(n_receivers), indexing="ij"), axis=-1)
    return Scene(
        room,
        campaign.sources,
        campaign.receivers,
        pairs.reshape(-1, 2).astype(np.int64),
        campaign.air,
    )
