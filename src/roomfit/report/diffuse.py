"""Mean absorption from decay times alone, as blocks and as a table."""

from __future__ import annotations

import numpy as np

from roomfit.base.table import Cell, Column, Table
from roomfit.predict.diffuse_field import FORMULAS, DiffuseAbsorption
from roomfit.report.blocks import Blocks, Sentence
from roomfit.report.tables import coefficient_cells
from roomfit.report.wording import band_tables, hertz, number

_WORDS = (
    "Decay times determine the mean alone, as far as the field is diffuse; the formulas "
    "differ by what that means, and intervals allow for it where priors tell walls apart; "
    "elsewhere walls are taken to be alike. What stands for single materials is their priors, "
    "moved together until they give this mean: nothing more is known of any of them. Where "
    "walls are much alike Eyring was nearest in trials, in flat rooms with one soft surface "
    "Fitzroy. Impulse "
    "responses and positions would separate them (roomfit identify)."
)


def describe(found: DiffuseAbsorption) -> Blocks:
    """Return the mean by Eyring, decay times, and mean and materials by each formula."""
    centres = found.bands.centres_hz
    measured = zip(found.decay_s.tolist(), found.decay_sd_s.tolist(), strict=True)
    times = [Cell(number(t, 2), (f"± {number(sd, 2)}",)) for t, sd in measured]
    tables = list(
        band_tables(
            "Decay time in s, with its standard deviation", "", centres,
            [("mean over positions", *times)],
        )
    )  # fmt: skip
    for formula, mean, absorption in zip(FORMULAS, found.mean, found.absorption, strict=True):
        named = zip(found.materials, absorption, strict=True)
        rows = [(name, *coefficient_cells(values)) for name, values in named]
        rows.append((Cell("mean of the room", style="total"), *coefficient_cells(mean)))
        caption = f"Absorption by {formula}, 95 % interval; materials are their priors, moved"
        tables += band_tables(caption, "material", centres, rows)
    middle = int(np.argmin(np.abs(np.log(centres / 500.0))))
    value, low, high = (number(x, 2) for x in found.mean[FORMULAS.index("Eyring"), :, middle])
    lead = (
        f"By Eyring the mean absorption of the room at {hertz(centres[middle])} is {value} "
        f"({low} to {high})."
    )
    head = (Sentence(lead, "lead"), Sentence(_WORDS))
    return Blocks("Mean absorption from decay times", head, tuple(tables))


def diffuse_records(found: DiffuseAbsorption) -> Table:
    """Return the content of reverberation.csv; material "" is the mean of the room."""
    rows = []
    for i, formula in enumerate(FORMULAS):
        named = (("", found.mean[i]), *zip(found.materials, found.absorption[i], strict=True))
        for name, values in named:
            for centre, column in zip(found.bands.centres_hz, values.T, strict=True):
                rows.append((formula, name, centre, *column))
    names = ("absorption", "lower95", "upper95")
    return Table("", ("formula", "material", Column("band_hz"), *names), rows, form=".5f")
