"""A room, recordings and materials before any fit, as blocks."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from roomfit.base.logit import Z95, expit
from roomfit.base.table import Cell, Column, Table, Value, text_of
from roomfit.materials.catalogue import OCTAVES_HZ, CatalogueEntry, catalogue, find_material
from roomfit.report.blocks import Block, Blocks, Findings, Sentence, Terms
from roomfit.report.wording import count, short_hertz

if TYPE_CHECKING:
    from roomfit.checks.usable import CheckedRecordings
    from roomfit.files.remedies import Advice
    from roomfit.room.scene import RoomCheck


def room_blocks(title: str, check: RoomCheck, advice: Advice | None = None) -> Blocks:
    """Return the room's size, its materials, and what is wrong with it."""
    x, y, z = check.size_m
    leak = f"{1e2 * check.leak:.3g} % of flights lost" if check.leak else "closed, no ray lost"
    terms = (
        ("size", f"{x:.2f} x {y:.2f} x {z:.2f} m"),
        ("volume V", f"{check.volume_m3:.2f} m3"),
        ("surface S", f"{check.surface_m2:.2f} m2"),
        ("mean free path", f"{check.mean_free_path_m:.3f} m  (4 V / S)"),
        ("mesh", f"{check.n_triangles} triangles, {check.n_surfaces} surfaces, {leak}"),
    )
    rows = [
        (name or "(no material)", area, f"{1e2 * area / (check.surface_m2 or np.inf):.1f} %")
        for name, area in check.material_areas_m2
    ]
    materials = Table("", ("material", "area in m2", "share"), rows, form=".2f")
    faults = sum(f.severity == "serious" for f in check.findings)
    last = f"Faults forbid tracing: {faults}." if faults else "The room can be traced."
    findings = Findings(check.findings, advice or {})
    return Blocks(title, (Sentence(title), Terms(terms), materials, Sentence(last)), (findings,))


def describe(checked: CheckedRecordings, advice: Advice | None = None) -> Blocks:
    """Return recordings by band before a fit, what is wrong with them, and what is advised."""
    rows: list[Sequence[Value]] = []
    for i, m in enumerate(checked.measurements):
        ranges = [
            Cell(f"{range_db:.0f}{' ' if has_t20 else '<'}" if usable else "- ")
            for range_db, usable, has_t20 in zip(
                checked.decay_range_db[i], checked.usable[i], checked.has_t20[i], strict=True
            )
        ]
        times = (f"{1e3 * float(x[i]):.2f}" for x in (checked.onset_s, checked.travel_s))
        noise_db = float(np.max(checked.peak_to_noise_db[i], initial=-np.inf))
        numbers = [text.replace("nan", "-") for text in times]
        numbers.append(f"{noise_db:.0f}" if np.isfinite(noise_db) else "-")
        rows.append((f"{m.source} to {m.receiver} ({m.name})", *numbers, *ranges))
    if np.any(np.isfinite(checked.decay_s)):
        known = np.isfinite(checked.decay_s)
        for title, values, digits in (
            ("reverberation time, s", checked.decay_s, 2),
            ("Schroeder frequency, Hz", checked.schroeder_hz, 0),
        ):
            cells = [f"{v:.{digits}f}" if k else "-" for v, k in zip(values, known, strict=True)]
            rows.append((title, "", "", "", *cells))
    heads = ("", "direct", "geometry", "S/N", *(f"{f:g}" for f in checked.bands.centres_hz))
    caption = (
        "Recordings: direct sound in ms after emission, and by the geometry; peak over noise,\n"
        "and decay range by band, in dB; < = too little for T20, - = not to be used"
    )
    shown: tuple[Block, ...] = (Table(caption, heads, rows),) if rows else ()
    findings = Findings(checked.findings, advice or {})
    return Blocks("Recordings", shown, (findings,), file="")


_OCTAVES = tuple(Column(short_hertz(f), ".2f") for f in OCTAVES_HZ)


def materials_text(words: Sequence[str]) -> str:
    """Return the entry of this name in full, or by group a line for each with all these words."""
    entries, name = catalogue().entries, "-".join(words)
    said = [f"{e.name} {e.group} {e.description}".lower() for e in entries]
    found = [e for e, t in zip(entries, said, strict=True) if all(w.lower() in t for w in words)]
    if words and (not found or name.lower() in (e.name for e in found)):
        return entry_text(find_material(name))
    rows: list[Sequence[Value]] = []
    for group, own in groupby(found, key=lambda entry: entry.group):
        rows += [[""], [group], *([f"  {e.name}", *e.absorption] for e in own)]
    number = count(len(found), "material")
    notes = ("", f"{number}. roomfit catalogue NAME shows one with its spread and sources.")
    return text_of(Table("", ("absorption at", *_OCTAVES), rows, notes))


def entry_text(entry: CatalogueEntry) -> str:
    """Return one entry in full: middle, spread, and every reading with its source."""
    low, high = (expit(entry.logit_mean + z * entry.logit_sd) for z in (-Z95, Z95))
    a = entry.absorption
    rows: list[Sequence[Value]] = [
        ("absorption", *a),
        ("standard deviation", *(entry.logit_sd * a * (1.0 - a))),
        ("95 % from", *low),
        ("95 % to", *high),
        ("",),
        ("readings",),
    ]
    for reading in entry.readings:
        rows += [("", *reading.absorption), (f"  {reading.row}",), (f"    {reading.source}",)]
    caption = f"{entry.name}\n{entry.description} ({entry.group})\n"
    notes = (
        "",
        f"Deviations correlate by {entry.octave_correlation:.2f} an octave apart. 63 Hz and 8 kHz,",
        "where no reading has them, are extrapolated from their neighbours, with a wider spread.",
        f'As a prior in a campaign: prior = "{entry.name}"',
    )
    return text_of(Table(caption, ("octave, Hz", *_OCTAVES), rows, notes))
