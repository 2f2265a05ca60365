"""What a finding advises, as changes of the campaign file.

A remedy is derived from a finding's code, from what it is about and from its evidence, never from
its sentence; each change is one key of one table.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from roomfit.base.arguments import in_short
from roomfit.base.door import read_bytes
from roomfit.base.errors import InputError
from roomfit.base.findings import About, Code, Finding
from roomfit.files.campaign import Campaign, read_toml
from roomfit.files.edits import Edit, lines_of, stated, value_text
from roomfit.materials.catalogue import find_material
from roomfit.model.observation import DEFAULT_POSITION_SD_M
from roomfit.room.scene import Point


@dataclass(frozen=True, slots=True)
class Remedy:
    """What somebody who follows a finding writes into the campaign file."""

    words: str  # after "Set" or as a button, such as 'directivity = "fit" for LS1'
    edits: tuple[Edit, ...]
    # whether it counts from what the campaign said when the finding was raised: it is no remedy of
    # a campaign that was changed since
    once: bool = False


def remedies(finding: Finding, campaign: Campaign) -> tuple[Remedy, ...]:
    """Return the changes of a campaign that a finding advises, the first one first.

    Several where somebody who has seen the room must choose; none where nothing that can be
    written helps, as where a position is to be measured again, or where it stands there already.

    Parameters
    ----------
    finding : Finding
        Of this campaign; names in it that the campaign does not have are passed over.
    campaign : Campaign
        As `roomfit.read_campaign` returns it; its file is read again, for it alone says in which
        table a value stands.

    Raises
    ------
    InputError
        The campaign file cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> import roomfit
    >>> from roomfit.base.findings import About, Code
    >>> text = '''
    ... [room]
    ... shoebox = [6, 5, 3]
    ... [sources.S]
    ... position = [1.5, 1.2, 1.5]
    ... '''
    >>> doubt = Finding(Code.SOURCE_NOT_OMNIDIRECTIONAL, About(), "...", {"source": "S"})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "campaign.toml"
    ...     _ = file.write_text(text)
    ...     found = remedies(doubt, roomfit.read_campaign(file, to_fit=False))
    >>> found[0].words, found[0].edits
    ('directivity = "fit" for S', (Edit(table=('sources', 'S'), key='directivity', value='fit'),))
    """
    make = _REMEDIES.get(finding.code)
    if make is None:
        return ()
    content = read_toml(campaign.path)
    found = []
    for one in make(finding, campaign, content):
        left = tuple(e for e in one.edits if stated(content, e) != _plain(e.value))
        if left:
            found.append(replace(one, edits=left))
    return tuple(found)


def together(findings: Sequence[Finding]) -> Finding | None:
    """Return findings of one code that say one thing of several recordings as one finding.

    None of less than two, and of codes whose remedy is another for each.
    """
    if (
        len(findings) < 2
        or {f.code for f in findings} - _OF_FILES
        or not all(f.about.files and f.code is findings[0].code for f in findings)
    ):
        return None
    files = [name for f in findings for name in f.about.files]
    pairs = [pair for f in findings for pair in f.about.pairs]
    about = About(files=tuple(dict.fromkeys(files)), pairs=tuple(dict.fromkeys(pairs)))
    return replace(findings[0], about=about, sentence="", evidence={})


Advice: TypeAlias = Mapping[Code, Sequence[str]]
"""By code, the lines that findings advise to write into a campaign, as a reader may copy them."""
_MOST_LINES, _MOST_OPTIONS = 8, 12  # shown; all are written


def advised(
    findings: Sequence[Finding], campaign: Campaign, *, changed: bool = False
) -> dict[Code, tuple[Remedy, ...]]:
    """Return what findings advise to write into a campaign, those of one code together.

    Parameters
    ----------
    changed : bool
        Whether the campaign was changed since the findings were raised, so that what counts from
        its values is none of it any more.

    Raises
    ------
    InputError
        The campaign file cannot be read.
    """
    found = {}
    for code in dict.fromkeys(f.code for f in findings):
        own = [f for f in findings if f.code is code]
        whole = together(own)
        first = [] if whole is None else [whole]
        every = [r for f in first + own for r in remedies(f, campaign)]
        options = {r.words: r for r in every if not (changed and r.once)}
        if options:
            found[code] = tuple(options.values())
    return found


def advice(findings: Sequence[Finding], campaign: Campaign) -> Advice:
    """Return the lines of what findings advise, as text and report show them.

    Where there is a choice, each begins with its number and its words. Nothing where the campaign
    cannot be read any more: an answer that took minutes is not lost for that.
    """
    shown: dict[Code, list[str]] = {}
    try:
        found = advised(findings, campaign)
    except InputError:
        return shown
    for code, options in found.items():
        written = lines_of(options[0].edits)
        lines = written[:_MOST_LINES]
        if len(written) > _MOST_LINES:
            lines.append(f"# and {len(written) - _MOST_LINES} lines more")
        if options[1:]:
            lines.insert(0, f"# {code}:1, {options[0].words}")
            others = [f"# or {code}:{n}, {o.words}" for n, o in enumerate(options, start=1)]
            lines += others[1:_MOST_OPTIONS]
        if len(options) > _MOST_OPTIONS:
            lines.append(f"# and {len(options) - _MOST_OPTIONS} others")
        shown[code] = lines
    return shown


def changed_since(content: Mapping[str, Any], file: Path) -> bool:
    """Return whether the campaign of a ``result.json`` was changed since, or cannot be read."""
    inputs = content.get("provenance", {}).get("inputs_sha256", {})
    digests = [d for name, d in inputs.items() if Path(name).name == file.name]
    try:
        now = sha256(read_bytes(file, "campaign")).hexdigest()
    except InputError:
        return True
    return bool(digests) and now not in digests


def chosen(options: Mapping[Code, Sequence[Remedy]], wanted: str) -> Remedy:
    """Return the remedy that is named by a code, or by a code and its number as in ``CODE:2``.

    Raises
    ------
    InputError
        No finding advises it.
    """
    name, _, number = wanted.partition(":")
    own = {code.value: found for code, found in options.items()}.get(name, ())
    n = int(number or 1) if (number or "1").isdecimal() else 0
    if not 0 < n <= len(own):
        known = [f"{c}:1 to {c}:{len(o)}" if o[1:] else str(c) for c, o in options.items()]
        raise InputError(
            "no finding advises this",
            where="--remedy",
            found=wanted,
            needed=", ".join(known) or "a finding that names what to write; there is none",
            hint="roomfit check CAMPAIGN shows them; for those of an answer add --result FOLDER",
        )
    return own[n - 1]


_Content: TypeAlias = Mapping[str, Any]


def _plain(value: object) -> object:
    return list(value) if isinstance(value, tuple) else value


# Recordings and positions.


def _points(campaign: Campaign) -> list[tuple[str, Point]]:
    both = (("sources", campaign.sources), ("receivers", campaign.receivers))
    return [(kind, point) for kind, points in both for point in points]


def _concerned(finding: Finding, campaign: Campaign) -> list[int]:
    """Return which measurements of a campaign a finding names, by file and by pair."""
    about, own = finding.about, campaign.measurements
    found = [i for i, m in enumerate(own) if m.response.where in about.files]
    if not found:  # written on another machine, or by the name alone
        found = [
            i
            for i, m in enumerate(own)
            if any(is_file(name, str(m.response.path)) for name in about.files)
        ]
    pairs = [i for i in found if (own[i].source, own[i].receiver) in about.pairs]
    return pairs if about.pairs else found


def is_file(named: str, file: str) -> bool:
    """Whether a name, perhaps without folders, or with more, or with a part in brackets, fits.

    Examples
    --------
    >>> is_file("S_R.wav[1]", "recordings/S_R.wav"), is_file("x/S_R.wav", "recordings/S_R.wav")
    (True, False)
    """
    own = Path(file).parts
    for text in (named, named.rpartition("[")[0]):
        parts = Path(text).parts
        n = min(len(own), len(parts))
        if n and own[-n:] == parts[-n:]:
            return True
    return False


def _of_recordings(
    campaign: Campaign, content: _Content, values: Mapping[int, Mapping[str, Any]]
) -> tuple[Edit, ...]:
    """Return what says something of some measurements, by their place in the campaign.

    One key under [defaults] where it holds of all, with the rows that state it themselves; else a
    row of each, a new one where its file was found by its name.
    """
    rows = content.get("measurements", [])
    stated = [n for n, row in enumerate(rows, start=1) if "file" in row]
    first = next(iter(values.values()), {})
    alike = all(own == first for own in values.values())
    if alike and len(values) == len(campaign.measurements) > 1:
        common = [Edit(("defaults",), key, value) for key, value in first.items()]
        own = [
            Edit(("measurements", n), key, value)
            for n in stated
            for key, value in first.items()
            if key in rows[n - 1]
        ]
        return (*common, *own)
    edits, n_new = [], 0
    for i, own_values in values.items():
        if i < len(stated):
            row, said = stated[i], dict(own_values)
        else:
            n_new += 1
            m = campaign.measurements[i]
            row = len(rows) + n_new
            said = {"source": m.source, "receiver": m.receiver}
            said |= {"file": _beside(campaign, m.response.path), **own_values}
        edits += [Edit(("measurements", row), key, value) for key, value in said.items()]
    return tuple(edits)


def _beside(campaign: Campaign, path: Path) -> str:
    """Return a path as the campaign file says it, relative to its folder where it lies below."""
    folder = campaign.path.parent
    return path.relative_to(folder).as_posix() if folder in path.parents else str(path)


def _names(campaign: Campaign, chosen: Sequence[int]) -> str:
    """Return recordings in words: all of them, or their files."""
    n = len(campaign.measurements)
    if len(chosen) == n > 1:
        return f"all {n} recordings"
    return in_short([campaign.measurements[i].response.path.name for i in chosen])


def _one_key(
    finding: Finding, campaign: Campaign, content: _Content, key: str, value: str
) -> Iterable[Remedy]:
    """Yield one key of those recordings that a finding names and that do not differ by it yet."""
    chosen = []
    for i in _concerned(finding, campaign):
        own = campaign.measurements[i]
        shared = own.level != "per-file" if key == "level" else own.response.time_zero == "emission"
        chosen += [i] if shared else []
    if chosen:
        edits = _of_recordings(campaign, content, {i: {key: value} for i in chosen})
        yield Remedy(f"{key} = {value_text(value)} for {_names(campaign, chosen)}", edits)


def _own_levels(finding: Finding, campaign: Campaign, content: _Content) -> Iterable[Remedy]:
    yield from _one_key(finding, campaign, content, "level", "per-file")


def _own_clock(finding: Finding, campaign: Campaign, content: _Content) -> Iterable[Remedy]:
    yield from _one_key(finding, campaign, content, "time_zero", "direct")


def _late(finding: Finding, campaign: Campaign, content: _Content) -> Iterable[Remedy]:
    """Yield the latency by which recordings are late, or that their clocks say nothing."""
    late_s = finding.evidence.get("late_s")
    chosen = _concerned(finding, campaign)
    if isinstance(late_s, float) and chosen:
        # counted from the file's key: a format may have a delay of its own beside it
        values = {
            i: round(campaign.measurements[i].response.latency_s + late_s, 5)  # 3 mm
            for i in chosen
        }
        edits = _of_recordings(campaign, content, {i: {"latency_s": v} for i, v in values.items()})
        common = f" = {values[chosen[0]]:.7g}" if len(set(values.values())) == 1 else ""
        yield Remedy(f"latency_s{common} for {_names(campaign, chosen)}", edits, once=True)
        yield from _one_key(finding, campaign, content, "time_zero", "unknown")
    else:
        yield from _own_clock(finding, campaign, content)


def _exchange(finding: Finding, campaign: Campaign, content: _Content) -> Iterable[Remedy]:
    """Yield two files that change their pairs, or two points that change their positions."""
    if "files" in finding.evidence:
        chosen = _concerned(finding, campaign)
        if len(chosen) == 2:
            one, other = (campaign.measurements[i] for i in chosen)
            values = {
                i: {"source": to.source, "receiver": to.receiver}
                for i, to in zip(chosen, (other, one), strict=True)
            }
            words = f"exchange {one.response.path.name} and {other.response.path.name}"
            yield Remedy(words, _of_recordings(campaign, content, values), once=True)
        return
    ends = [(k, p) for k, p in _points(campaign) if p.name in finding.evidence.get(k, ())]
    if len(ends) == 2:
        words = f"exchange the positions of {ends[0][1].name} and {ends[1][1].name}"
        edits = [
            Edit((kind, point.name), "position", tuple(map(float, other.position_m)))
            for (kind, point), (_, other) in zip(ends, reversed(ends), strict=True)
        ]
        yield Remedy(words, tuple(edits), once=True)


# The model.


def _pattern(finding: Finding, campaign: Campaign, _: _Content) -> Iterable[Remedy]:
    name = str(finding.evidence.get("source"))
    if campaign.directivities.get(name) == "omni":
        edit = Edit(("sources", name), "directivity", "fit")
        yield Remedy(f'directivity = "fit" for {name}', (edit,))


def _catalogue(finding: Finding, campaign: Campaign, _: _Content) -> Iterable[Remedy]:
    """Yield entries that fit the names of materials of which nothing is stated."""
    for name, entries in finding.evidence.get("entries", {}).items():
        own = campaign.materials.get(name)
        product = None if own is None else own.product
        stated = campaign.products[product] if product else own
        if stated is not None and stated.prior is not None:
            continue
        if own is not None and (own.absorption is not None or own.same_absorption_as is not None):
            continue
        table = ("products", product) if product else ("materials", str(name))
        for entry in entries:
            try:
                edit = Edit(table, "prior", find_material(str(entry)).name)
            except InputError:  # of another version's catalogue
                continue
            yield Remedy(f"prior = {value_text(edit.value)} for {table[1]}", (edit,))


def _scattering(finding: Finding, campaign: Campaign, _: _Content) -> Iterable[Remedy]:
    """Yield that scattering is fitted, or the value that the data prefer, where none is stated."""
    tables = campaign.materials
    names = [
        str(name)
        for name in finding.evidence.get("materials", ())
        if name not in tables or tables[name].scattering in (None, 0.0)
    ]
    choices: list[str | float] = ["fit"]
    value = finding.evidence.get("scattering")
    choices += [float(value)] if isinstance(value, int | float) else []
    for choice in choices if names else ():
        edits = tuple(Edit(("materials", name), "scattering", choice) for name in names)
        yield Remedy(f"scattering = {value_text(choice)} for {in_short(names)}", edits)


def _position_sds(finding: Finding, campaign: Campaign, _: _Content) -> Iterable[Remedy]:
    """Yield how well positions are known, of which only the surveyor can tell."""
    named = finding.evidence.get("points", ())
    own = [(k, p.name) for k, p in _points(campaign) if p.name in named and p.position_sd_m is None]
    # by laser, by tape, what is assumed, by steps
    for sd_m in (0.005, 0.01, 0.02, 0.05) if own else ():
        edits = tuple(Edit(end, "position_sd", sd_m) for end in own)
        yield Remedy(f"position_sd = {sd_m:g} for {in_short([n for _, n in own])}", edits)


def _larger_position_sds(finding: Finding, campaign: Campaign, _: _Content) -> Iterable[Remedy]:
    """Yield standard deviations that are larger by the scale by which they were inflated."""
    scale = finding.evidence.get("stretch")
    if isinstance(scale, float) and scale > 1.0:
        edits = tuple(
            Edit((kind, p.name), "position_sd", min(round(scale * sd_m, 4), 1.0))
            for kind, p in _points(campaign)
            if (sd_m := DEFAULT_POSITION_SD_M if p.position_sd_m is None else p.position_sd_m) > 0.0
        )
        yield Remedy(f"position_sd {scale:.1f} times as large for all positions", edits, once=True)


def _displaced(finding: Finding, campaign: Campaign, _: _Content) -> Iterable[Remedy]:
    """Yield receivers moved by the vector that was found, or what is open within its size.

    Where one point stands, its direct sounds alone do not say, but how far off it is at least.
    """
    evidence = finding.evidence
    if "shift_m" in evidence:
        shift_m = [float(x) for x in evidence["shift_m"]]
        own = [p for p in campaign.receivers if p.name in evidence["receivers"]]
        moved = _moved("receivers", own, lambda x, axis: x + shift_m[axis])
        by = ", ".join(f"{x:+.2f}" for x in shift_m)
        if own:
            yield Remedy(f"{in_short([p.name for p in own])} moved by ({by}) m", moved, once=True)
        return
    if not isinstance(evidence.get("metres"), float):
        return
    size_m = round(float(np.hypot(evidence["metres"], evidence.get("sd_m", 0.0))), 2)
    ends = [(k, p.name) for k, p in _points(campaign) if p.name == evidence.get(k.rstrip("s"))]
    if size_m > 1.0:  # to be measured again: no standard deviation may be larger
        return
    if ends:
        edits = tuple(Edit(end, "position_sd", size_m) for end in ends)
        yield Remedy(f"position_sd = {size_m:g} for {ends[0][1]}", edits)
    elif "axis" in evidence:
        axis = "xyz".index(evidence["axis"])
        yield from _open_along(str(evidence["what"]), axis, size_m, campaign)


def _open_along(what: str, axis: int, size_m: float, campaign: Campaign) -> Iterable[Remedy]:
    """Yield the offset of positions, the length of a box, or both, fitted within a size."""

    def wider(sd_m: object) -> tuple[float, ...]:
        sds_m = np.broadcast_to(np.asarray(0.0 if sd_m is None else sd_m), 3).tolist()
        return (*sds_m[:axis], size_m, *sds_m[axis + 1 :])

    own, edits = {g.name: g.sd_m for g in campaign.groups}, []
    if what != "length":
        table = ("groups", what if what in own else "everything")
        if table[1] not in own:
            edits.append(Edit(table, "members", ("*",)))
        edits.append(Edit(table, "sd", wider(own.get(table[1]))))
    if what in ("length", "wall"):
        edits.append(Edit(("room",), "lengths_sd", wider(campaign.room.lengths_sd)))
    named = {"length": "the length", "wall": "all positions and the length"}.get(what, what)
    yield Remedy(f"{named} along {'xyz'[axis]} fitted within {size_m:g} m", tuple(edits))


def _other_unit(finding: Finding, campaign: Campaign, _: _Content) -> Iterable[Remedy]:
    """Yield positions, with the room or by themselves, in the unit in which they were measured.

    Positions of a campaign are in metres, whatever the unit of its room.
    """
    unit, factor = finding.evidence.get("unit"), finding.evidence.get("factor")
    if unit is None or not isinstance(factor, float):  # a sampling rate, or the temperature
        return
    points = _points(campaign)
    edits = tuple(e for kind, p in points for e in _moved(kind, [p], lambda x, _: factor * x))
    room = campaign.room
    read_in = room.unit or ("m" if room.file is None else "")
    if read_in == ("ft" if unit == "m" else "m"):
        both = (Edit(("room",), "unit", str(unit)), *edits)
        yield Remedy(f"room in {unit}, positions times {factor:.4g}", both, once=True)
    yield Remedy(f"positions times {factor:.4g}, the room as it is", edits, once=True)


def _moved(
    kind: str, points: Sequence[Point], how: Callable[[float, int], float]
) -> tuple[Edit, ...]:
    """Return points of a kind at other places, to a tenth of a millimetre."""
    moved_m = {
        p.name: [round(how(float(x), i), 4) for i, x in enumerate(p.position_m)] for p in points
    }
    return tuple(Edit((kind, name), "position", tuple(x)) for name, x in moved_m.items())


def _free_positions(*_: object) -> Iterable[Remedy]:
    yield Remedy('positions = "fit"', (Edit(("identify",), "positions", "fit"),))


def _wall_delays(*_: object) -> Iterable[Remedy]:
    yield Remedy("wall_delays = true", (Edit(("identify",), "wall_delays", True),))


_REMEDIES: dict[Code, Callable[[Finding, Campaign, _Content], Iterable[Remedy]]] = {
    Code.LEVELS_APART: _own_levels,
    Code.LEVEL_UNKNOWN: _own_levels,
    Code.TIME_ZERO_MISMATCH: _own_clock,
    Code.TIME_ZERO_AT_PEAK: _own_clock,
    Code.RECORDINGS_LATE: _late,
    Code.EXCHANGED: _exchange,
    Code.SOURCE_NOT_OMNIDIRECTIONAL: _pattern,
    Code.BROAD_PRIOR_ASSUMED: _catalogue,
    Code.SCATTERING_ASSUMED: _scattering,
    Code.SCATTERING_UNDERESTIMATED: _scattering,
    Code.POSITION_UNCERTAINTY_ASSUMED: _position_sds,
    Code.POSITION_UNCERTAINTY_INFLATED: _larger_position_sds,
    Code.POSITION_INCONSISTENT: _free_positions,
    Code.REFLECTION_DELAY_DETECTED: _wall_delays,
    Code.DISPLACEMENT_DETECTED: _displaced,
    Code.COORDINATES_SCALED: _other_unit,
}
_OF_FILES = frozenset(code for code, make in _REMEDIES.items() if make in (_own_levels, _own_clock))
