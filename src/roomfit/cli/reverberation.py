"""``roomfit reverberation``: mean absorption from decay times alone."""

from __future__ import annotations

import argparse
from pathlib import Path

from roomfit.base.door import files_read, reading_noted
from roomfit.base.errors import InputError
from roomfit.base.table import csv_of
from roomfit.base.whole_files import (
    check_output_folder,
    whole_output_folder,
    write_json_atomically,
    write_text_atomically,
)
from roomfit.cli.terminal import say
from roomfit.files.campaign import read_campaign
from roomfit.files.reverberation import diffuse_field, diffuse_result_content
from roomfit.predict.diffuse_field import DiffuseAbsorption, diffuse_absorption
from roomfit.report.diffuse import describe, diffuse_records
from roomfit.report.html import page
from roomfit.report.text import text


def run(options: argparse.Namespace) -> None:
    found = reverberation_to_folder(options.campaign, options.out, overwrite=options.overwrite)
    say(text(describe(found)))
    if options.out is not None:
        say(f"\nreverberation.html, reverberation.csv and result.json are in {options.out}")


@reading_noted()
def reverberation_to_folder(
    campaign_file: Path, out: Path | None = None, *, overwrite: bool = False
) -> DiffuseAbsorption:
    """Find mean absorption from decay times; write result.json, a table and a page into a folder.

    `InputError` as of `diffuse_field` and `diffuse_absorption`; or the folder is not empty.
    """
    if out is not None:
        check_output_folder(out, overwrite=overwrite)
    campaign = read_campaign(campaign_file, to_fit=False, decay_times=True)
    field, _ = diffuse_field(campaign)
    if field.decay_s is None:
        what, where = "a campaign without decay times", str(campaign_file)
        needed = "a table [reverberation]"
        hint = "add it, or predict from a result: --absorption result.json"
        raise InputError(what, where=where, found="no such table", needed=needed, hint=hint)
    found = diffuse_absorption(
        field.decay_s, field.bands, field.priors, field.areas_m2, field.volume_m3,
        speed_of_sound_m_s=field.speed_of_sound_m_s, attenuation_per_m=field.attenuation_per_m,
    )  # fmt: skip
    if out is not None:
        with whole_output_folder(out, overwrite=overwrite) as folder:
            content = diffuse_result_content(field, found, campaign.settings.seed, files_read())
            write_json_atomically(folder / "result.json", content)
            write_text_atomically(folder / "reverberation.csv", csv_of(diffuse_records(found)))
            write_text_atomically(folder / "reverberation.html", page(describe(found)))
    return found
