"""Everything that was measured, read and put on one scene.

Doubts that need no fit: a pair measured twice with other results, a material nobody hears.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from roomfit.errors import InputError
from roomfit.findings import Code, Finding
from roomfit.geometry.mesh import refuse
from roomfit.inversion.room_outline import outline_findings
from roomfit.io.campaign import Campaign
from roomfit.io.iso3382 import read_parameters
from roomfit.io.measurements import measure
from roomfit.measurement import MeasuredPair, Use
from roomfit.scene import Room, Scene, position_findings
from roomfit.signals.decay import ParameterName, in_jnd
from roomfit.signals.iso3382 import MeasuredValues, joined_values
from roomfit.tracing.paths import Paths
from roomfit.typing import FloatArray

# More than a listener's smallest step by a factor that no repetition at one place explains.
LARGEST_JND = 2.0
LARGEST_LEVEL_DB = 1.5
_COMPARED: tuple[ParameterName, ...] = ("T20_s", "EDT_s", "C80_dB")


def duplicate_findings(measured: Sequence[MeasuredPair]) -> tuple[Finding, ...]:
    """Return a finding for each pair that was measured twice with results that differ.

    Compared are T20, EDT and C80, by more than 2 just noticeable differences, and the levels of the
    bands where they are said to be alike (measurements of one source that share its gain), by more
    than 1.5 dB. Nothing but the two responses is used: no position, no model.

    Parameters
    ----------
    measured : sequence of MeasuredPair
        In any order; what is kept for validation is compared as well.
    """
    findings = []
    for one, other in combinations(measured, 2):
        if one.pair != other.pair:
            continue
        ways = [*_differing(one, other), *_levels(one, other)]
        if not ways:
            continue
        names = f"{one.file.response.path.name} and {other.file.response.path.name}"
        findings.append(
            Finding(
                Code.REPEATED_RESPONSES_DIFFER,
                f"{one.file.source} to {one.file.receiver} was measured twice ({names}) with "
                f"different results: {'; '.join(ways)}. One of them may belong to another pair, or "
                "the room was changed in between.",
                {
                    "source": one.file.source,
                    "receiver": one.file.receiver,
                    "files": [str(one.file.response.path), str(other.file.response.path)],
                    "differences": ways,
                },
            )
        )
    return tuple(findings)


def unreached_materials(paths: Paths, materials: Sequence[str]) -> tuple[str, ...]:
    """Return the materials that no path strikes: nothing measured can tell of them.

    Parameters
    ----------
    paths : Paths
        Of all pairs that are to be fitted.
    materials : sequence of str
        Those asked about, of the paths' own.
    """
    met = np.asarray(paths.hits_specular.any(axis=0) | paths.hits_diffuse.any(axis=0))
    return tuple(m for m in materials if not met[paths.materials.index(m)])


def unreached_findings(paths: Paths, fitted: Sequence[str]) -> tuple[Finding, ...]:
    """Return a finding that names the materials to be fitted which no path strikes.

    Parameters
    ----------
    paths : Paths
    fitted : sequence of str
        Materials whose absorption is not given.
    """
    names = unreached_materials(paths, fitted)
    if not names:
        return ()
    return (
        Finding(
            Code.MATERIAL_NOT_REACHED,
            f"No path between the measured pairs strikes {', '.join(names)}: its absorption cannot "
            "be told, and what was known beforehand is all that is reported.",
            {"materials": list(names)},
        ),
    )


def _differing(one: MeasuredPair, other: MeasuredPair) -> list[str]:
    parts = []
    for name in _COMPARED:
        first, second = one.parameters.of(name), other.parameters.of(name)
        # from their mean, so that the order does not matter
        steps = np.abs(
            in_jnd(name, 0.5 * (first + second), 0.5 * (first + second) + first - second)
        )
        known: FloatArray = np.abs(np.nan_to_num(steps, nan=0.0))
        if known.max() > LARGEST_JND:
            j = int(np.argmax(known))
            symbol, unit = name.split("_")
            parts.append(
                f"{symbol} {first[j]:.2f} and {second[j]:.2f} {unit} "
                f"at {one.curve.bands.centres_hz[j]:g} Hz"
            )
    return parts


def _levels(one: MeasuredPair, other: MeasuredPair) -> list[str]:
    if one.file.level != other.file.level or one.file.level == "per-file":
        return []
    difference = _level_db(one) - _level_db(other)
    known: FloatArray = np.abs(np.nan_to_num(difference, nan=0.0))
    if known.max() <= LARGEST_LEVEL_DB:
        return []
    j = int(np.argmax(known))
    return [f"levels that differ by {known[j]:.1f} dB at {one.curve.bands.centres_hz[j]:g} Hz"]


def _level_db(m: MeasuredPair) -> FloatArray:
    total = m.curve.energy_left[:, 0]
    return 10.0 * np.log10(np.where(total > 0.0, total, np.nan))


@dataclass(frozen=True, slots=True, eq=False)
class Measurements:
    """What a campaign's files hold.

    Attributes
    ----------
    scene : Scene
        Each measured pair once, however often it was measured.
    responses : tuple of MeasuredPair
        All impulse responses, those kept for validation included.
    values : tuple of MeasuredValues
        Room parameters to be fitted, one a pair.
    kept_values : tuple of MeasuredValues
        Room parameters to be predicted only.
    findings : tuple of Finding
    """

    scene: Scene
    responses: tuple[MeasuredPair, ...]
    values: tuple[MeasuredValues, ...]
    kept_values: tuple[MeasuredValues, ...]
    findings: tuple[Finding, ...]


def collect_measurements(campaign: Campaign, room: Room) -> Measurements:
    """Read and examine every measured file of a campaign.

    Raises
    ------
    InputError
        A file is missing, broken or empty, a position is impossible, or a table names a source or
        a receiver that the campaign does not define.
    """
    _refuse_spectra(campaign)
    fitted, doubts = _values(campaign, "fit")
    kept, more_doubts = _values(campaign, "validate")
    scene = _scene(campaign, room, (*fitted, *kept))
    responses, findings = measure(campaign, scene)
    observed = [(m.pair, m.response) for m in responses if m.file.use == "fit"]
    return Measurements(
        scene,
        responses,
        fitted,
        kept,
        (
            *doubts,
            *more_doubts,
            *findings,
            *duplicate_findings(responses),
            *outline_findings(scene, observed),
        ),
    )


def _refuse_spectra(campaign: Campaign) -> None:
    if campaign.spectra:
        raise InputError(
            "damped spectra tell impedances, not absorption in bands",
            where=str(campaign.path),
            found=str(campaign.spectra[0].path.name),
            needed="impulse responses (file) or room parameters",
            hint="roomfit impedance reads this campaign",
        )


def campaign_scene(campaign: Campaign, room: Room) -> Scene:
    """Return the scene of all measured pairs, each once.

    Raises
    ------
    InputError
        A source or a receiver stands outside the room, in a wall, or upon another; or a table of
        room parameters cannot be read.
    """
    tabulated = (*_values(campaign, "fit")[0], *_values(campaign, "validate")[0])
    return _scene(campaign, room, tabulated)


def _scene(campaign: Campaign, room: Room, tabulated: Sequence[MeasuredValues]) -> Scene:
    pairs = [(m.source, m.receiver) for m in campaign.measurements]
    pairs += [(v.source, v.receiver) for v in tabulated]
    pairs += [(s.source, s.receiver) for s in campaign.spectra]
    wanted = list(dict.fromkeys(pairs))
    used_sources, used_receivers = ({pair[i] for pair in wanted} for i in (0, 1))
    sources = tuple(s for s in campaign.sources if s.name in used_sources)
    receivers = tuple(r for r in campaign.receivers if r.name in used_receivers)
    refuse(position_findings(room, sources, receivers))
    source_at = {s.name: i for i, s in enumerate(sources)}
    receiver_at = {r.name: i for i, r in enumerate(receivers)}
    indices = np.array([(source_at[s], receiver_at[r]) for s, r in wanted])
    return Scene(room, sources, receivers, indices, campaign.air)


def time_scales(measurements: Measurements) -> tuple[float, float]:
    """Return the longest decay time of any band, and where the last usable window ends, in s.

    What is kept for validation has no say, so that it cannot change the answer.
    """
    fitted = [m for m in measurements.responses if m.file.use == "fit"]
    longest = 0.0
    names: tuple[ParameterName, ...] = ("T20_s", "EDT_s")
    for m in fitted:
        for name in names:
            known = _known(m.parameters.of(name))
            if known.size:
                longest = max(longest, float(known.max()))
                break
    for v in measurements.values:
        for row in (v.values.get("T30_s"), v.values.get("T20_s"), v.values.get("EDT_s")):
            if row is not None and _known(row).size:
                longest = max(longest, float(_known(row).max()))
    # a decay that nothing could evaluate still ends where it drowns
    latest = max((float(m.noise.usable_end_s.max()) for m in fitted), default=0.0)
    if longest <= 0.0:
        return 0.0, latest if latest > 0.0 else 1.0
    return longest, min(latest, longest)


def median_decay_s(measurements: Measurements, centres_hz: FloatArray) -> FloatArray:
    """Return the median reverberation time over what is fitted, NaN where none is known.

    Of T20, or of EDT in a band where no pair has the range for T20; shape (n_bands,).
    """
    found: FloatArray = np.full(centres_hz.size, np.nan)
    names: tuple[ParameterName, ...] = ("EDT_s", "T30_s", "T20_s")
    for name in names:
        rows = [m.parameters.of(name) for m in measurements.responses if m.file.use == "fit"]
        for v in measurements.values:
            if name in v.values:
                rows.append(_at(v.centres_hz, v.values[name], centres_hz))
        for band, values in enumerate(np.array(rows).reshape(-1, centres_hz.size).T):
            if _known(values).size:
                found[band] = np.median(_known(values))
    return found


def _values(campaign: Campaign, use: Use) -> tuple[tuple[MeasuredValues, ...], tuple[Finding, ...]]:
    """Read the tables of one use; a pair that stands in several of them is joined."""
    by_pair: dict[tuple[str, str], list[MeasuredValues]] = {}
    findings: list[Finding] = []
    for table in campaign.tables:
        if table.use != use:
            continue
        read, doubts = read_parameters(table.path, table.source, table.receiver)
        findings += doubts
        for found in read:
            _check_names(campaign, found, str(table.path))
            by_pair.setdefault((found.source, found.receiver), []).append(found)
    joined = []
    for repeated in by_pair.values():
        one, doubts = joined_values(tuple(_same_bands(repeated)))
        findings += doubts
        joined.append(one)
    return tuple(joined), tuple(findings)


def _check_names(campaign: Campaign, found: MeasuredValues, where: str) -> None:
    for kind, name, known in (
        ("source", found.source, [s.name for s in campaign.sources]),
        ("receiver", found.receiver, [r.name for r in campaign.receivers]),
    ):
        if name not in known:
            raise InputError(
                f"a table of room parameters names a {kind} that the campaign does not define",
                where=where,
                found=repr(name),
                needed=f"one of {', '.join(known)}",
                hint=f"add [{kind}s.{name}], or choose rows with source and receiver",
            )


def _same_bands(repeated: Sequence[MeasuredValues]) -> list[MeasuredValues]:
    """Return values of one pair on the bands of the first."""
    centres = repeated[0].centres_hz
    return [
        MeasuredValues(
            m.source,
            m.receiver,
            centres,
            {name: _at(m.centres_hz, row, centres) for name, row in m.values.items()},
            {name: _at(m.centres_hz, row, centres) for name, row in m.spread.items()},
        )
        for m in repeated
    ]


def _at(centres_hz: FloatArray, row: FloatArray, wanted_hz: FloatArray) -> FloatArray:
    known = dict(zip(centres_hz.tolist(), row.tolist(), strict=True))
    return np.array([known.get(f, np.nan) for f in wanted_hz.tolist()])


def _known(values: FloatArray) -> FloatArray:
    return np.asarray(values[np.isfinite(values)])
