"""Use case: the impedances of a measured room's walls."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from roomfit.app.impedance.observing import campaign_pressures
from roomfit.app.progress import part
from roomfit.files.campaign.campaign import Campaign, input_files, read_campaign
from roomfit.files.campaign.impedance import wall_models
from roomfit.files.impedance_results import write_impedance
from roomfit.files.rooms.read import read_room
from roomfit.files.store import check_output_folder, whole_output_folder, write_bytes_atomically
from roomfit.impedance.answer import ImpedanceAnswer
from roomfit.impedance.identify import identify_impedance
from roomfit.typing import Progress

# What the command writes, and so may remove when it writes over an earlier result.
OWN_FILES = ("result.json", "impedance.csv", "impedance_*.png", "spectra_[0-9]*.png")
_PAIRS_A_PICTURE = 6
_MOST_PICTURES = 6


def identify_campaign_impedance(
    campaign: Campaign, *, progress: Progress | None = None
) -> ImpedanceAnswer:
    """Return the impedance of every material of a campaign's room.

    Impulse responses are multiplied by an exponential window and transformed; damped spectra are
    taken as they are. What is marked for validation is not read.

    Raises
    ------
    InputError
        Something in the campaign, the room or a file is not as needed.
    """
    room, room_findings = read_room(campaign.room)
    walls = wall_models(campaign, room.materials)
    pressures = campaign_pressures(campaign, room)
    answer = identify_impedance(
        pressures.scene,
        pressures.observed,
        walls,
        pressures.nuisances,
        rng=np.random.default_rng(campaign.seed),
        n_random_starts=campaign.impedance.random_starts,
        progress=progress,
    )
    findings = (*room_findings, *pressures.findings, *answer.findings)
    return replace(answer, findings=findings, seed=campaign.seed)


def impedance_to_folder(
    campaign_file: Path,
    out: Path,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> ImpedanceAnswer:
    """Identify impedances and write result.json, impedance.csv and pictures into a folder.

    Nothing is written before everything is known, and then all of it or nothing.

    Raises
    ------
    InputError
        Something in the campaign, the room, a file or the output folder is not as needed.
    StoreError
        The disk refuses.
    """
    from roomfit.report.impedance_pictures import spectra_figure, wall_figure
    from roomfit.report.pictures import png

    check_output_folder(out, overwrite=overwrite)
    campaign = read_campaign(campaign_file)
    answer = identify_campaign_impedance(campaign, progress=part(progress, 0.0, 0.95))
    with whole_output_folder(out, overwrite=overwrite, own=OWN_FILES) as folder:
        write_impedance(folder, answer, input_files(campaign))
        for material in answer.materials:
            name = f"impedance_{_safe(material.name)}.png"
            write_bytes_atomically(folder / name, png(wall_figure(answer, material)))
        if answer.evaluations:
            for number in range(min(-(-len(answer.pairs) // _PAIRS_A_PICTURE), _MOST_PICTURES)):
                own = range(len(answer.pairs))[number * _PAIRS_A_PICTURE :][:_PAIRS_A_PICTURE]
                picture = png(spectra_figure(answer, own))
                write_bytes_atomically(folder / f"spectra_{number + 1}.png", picture)
    return answer


def _safe(name: str) -> str:
    """Return a name without what a path gives a meaning to."""
    return "".join(c if c.isalnum() or c in "-_." else "_" for c in name)[:60]
