"""A room, recordings and materials before any fit, as blocks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby, product
from typing import TYPE_CHECKING

import numpy as np

from roomfit.base.logit import Z95, expit
from roomfit.base.table import Cell, Column, Table, Value, csv_of, text_of
from roomfit.base.typing import FloatArray
from roomfit.materials.catalogue import OCTAVES_HZ, CatalogueEntry, catalogue, find_material
from roomfit.report.blocks import Block, Blocks, Drawing, Findings, Part, Sentence, Terms
from roomfit.report.wording import (
    DASH,
    band_ranges,
    band_tables,
    count,
    in_file_name,
    number,
    parameter,
    short_hertz,
)
from roomfit.signals.decay import PARAMETER_NAMES

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
    of_bands = checked.decay_range_db, checked.usable, checked.has_t20
    arrivals_s = np.stack([checked.onset_s, checked.travel_s], axis=1)
    loudest_db = checked.peak_to_noise_db.max(axis=1, initial=-np.inf)
    for i, m in enumerate(checked.measurements):
        ranges = [
            Cell(f"{range_db:.0f}{' ' if has_t20 else '<'}" if usable else "- ")
            for range_db, usable, has_t20 in zip(*(x[i] for x in of_bands), strict=True)
        ]
        times = (f"{1e3 * x:.2f}" for x in arrivals_s[i])
        noise_db = float(loudest_db[i])
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
    notes = (
        "Direct sound in ms after emission, and by the geometry; peak over noise and decay range",
        "in dB, < = too little for T20, - = not to be used",
    )
    shown = (Table("Noise and range of the decays", heads, rows, notes),) if rows else ()
    findings = Findings(checked.findings, advice or {})
    measured = tuple(_measured(checked)) if any(checked.pairs) else ()
    return Blocks("Recordings", shown, (*measured, findings), file="")


# ISO 3382-2:2008, table 1: pairs, sources and receivers at least; B.2 and B.3
_GRADES = (("precision", 12, 2, 3), ("engineering", 6, 2, 2), ("survey", 2, 1, 2))


def _measured(checked: CheckedRecordings) -> Iterator[Block]:
    """Yield means over recordings and how straight decays are; then each recording, for a page."""
    centres_hz, states = checked.bands.centres_hz, [m.state for m in checked.measurements]
    rows: list[Sequence[Value]] = []
    each: list[Block] = []
    for name, state in product(PARAMETER_NAMES, dict.fromkeys(states)):
        how, own = parameter(name), [i for i, s in enumerate(states) if s == state]
        values = np.ma.masked_invalid(checked.parameter(name)[own])
        both = values.mean(axis=0), values.std(axis=0, ddof=1)
        cells = [[number(v, how.decimals) for v in row.filled(np.nan)] for row in (*values, *both)]
        head = f"{how.symbol}, {how.unit}{f', {state}' if state else ''}"
        rows.append((head, *map(lambda m, sd: Cell(m, () if sd == DASH else (sd,)), *cells[-2:])))
        heads = [checked.measurements[i].name for i in own] + ["mean", "standard deviation"]
        shown = [(h, *row) for h, row in zip(heads, cells, strict=True)]
        each += band_tables(head, "recording", centres_hz, shown)
    bent = {"C, %": checked.curvature_percent, "ξ, ‰": checked.nonlinearity_permille}
    for head, all_of in bent.items():
        largest = np.ma.masked_invalid(all_of).max(axis=0).filled(np.nan)
        rows.append((f"{head}, the largest", *(number(v, 0) for v in largest)))
    caption = "Mean over the recordings (standard deviation); how bent the decays are by ISO 3382-2"
    yield from band_tables(caption, "", centres_hz, rows)
    yield Sentence(" ".join(_conditions(checked, bent)))
    pairs = [m for m, p in zip(checked.measurements, checked.pairs, strict=True) if p is not None]
    names = tuple(f"{m.source} to {m.receiver} ({m.name})" for m in pairs)
    files = tuple(
        in_file_name(f"recording_{i:02d}", *filter(None, m.pair_name))
        for i, m in enumerate(pairs[:12], start=1)  # the page has all
    )
    title = "Energy-time and decay curves of recordings by band"
    words = (
        "Grey: energy-time curve. Black: decay curve, noise subtracted. Thick: the line of T30, of "
        "T20 where noise hides the range of T30. Dashed: arrival by the positions."
    )
    picture = Drawing("recordings", title, words, "recording_figure", (checked,), names, files)
    tables = Part("Room parameters of each recording", tuple(each), folded=True)
    yield Part("Each recording", (picture, tables), "recordings", in_text=False)


def _conditions(checked: CheckedRecordings, bent: Mapping[str, FloatArray]) -> Iterator[str]:
    """Yield how many positions there are, and where decays are bent, by ISO 3382-2."""
    has_t20 = np.any(checked.has_t20, axis=1)
    for state in dict.fromkeys(m.state for m in checked.measurements):
        known = zip(checked.measurements, has_t20, strict=True)
        names = {m.pair_name[:2] for m, has in known if has and m.state == state}
        n = len(names), *(len({pair[i] for pair in names}) for i in range(2))
        word = next((w for w, *least in _GRADES if np.all(np.array(n) >= least)), "")
        enough = f"as many as ISO 3382-2 asks for the {word} method" if word else ""
        enough = enough or "fewer than ISO 3382-2 asks for its survey method"
        words = f"{count(n[0], 'pair')} of {count(n[1], 'source')} and {count(n[2], 'receiver')}"
        yield f"{f'{state}: ' if state else ''}T20 of {words}: {enough}."
    far = [np.flatnonzero((x > 10.0).any(axis=0)) for x in bent.values()]
    if at := sorted(set(np.concatenate(far).tolist())):
        bands = band_ranges(checked.bands.centres_hz, np.isin(np.arange(len(checked.bands)), at))
        yield f"At {bands} decays are bent: C above 10 % or ξ above 10 ‰."


def parameters_csv(checked: CheckedRecordings) -> str:
    """Return the room parameters of recordings as the table that `read_parameters` takes."""
    heads = (*(f"{f:g}" for f in checked.bands.centres_hz),)
    rows = [
        (m.source, m.receiver, name.split("_")[0], *row)
        for name in PARAMETER_NAMES
        for m, row in zip(checked.measurements, checked.parameter(name), strict=True)
        if np.isfinite(row).any()
    ]
    return csv_of(Table("", ("source", "receiver", "parameter", *heads), rows, form=".4g"))


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
