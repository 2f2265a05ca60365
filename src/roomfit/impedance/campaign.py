"""Measured pressures of a campaign behind one exponential window, pair by pair.

Use case: the impedances of a measured room's walls.

Impulse responses of a campaign on the clock of emission, and their damped spectra.

What a campaign file says of the impedance of walls.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from roomfit._checks import nearest
from roomfit.air import speed_of_sound_m_s
from roomfit.cache import check_output_folder, whole_output_folder, write_bytes_atomically
from roomfit.errors import InputError, located
from roomfit.findings import Finding
from roomfit.geometry.mesh import refuse
from roomfit.impedance.data import (
    DampedSpectrum,
    Observed,
    damped_noise,
    damped_spectrum,
    read_spectrum,
)
from roomfit.impedance.fit import WallModel
from roomfit.impedance.identify import identify_impedance
from roomfit.impedance.laws import LAWS, Parameter
from roomfit.impedance.output import write_impedance
from roomfit.impedance.result import ImpedanceAnswer
from roomfit.impedance.wave_model import GainMode, Nuisances
from roomfit.io.campaign import (
    Campaign,
    MaterialTable,
    MeasuredFile,
    MeasuredSpectrum,
    input_files,
    read_campaign,
)
from roomfit.io.measurements import from_emission
from roomfit.io.responses import read_response
from roomfit.io.rooms import read_room
from roomfit.measurement import LATENCY_SD_S
from roomfit.scene import Room, Scene, distances_m, position_findings
from roomfit.signals.response import check_travel, compare_onset, find_onset
from roomfit.typing import ComplexArray, FloatArray, Progress, part


class DampedResponses(NamedTuple):
    """Spectra of impulse responses behind an exponential window.

    Attributes
    ----------
    pressure : tuple of complex arrays, shape (n_frequencies,)
        One a file.
    noise : tuple of float arrays or None
        rms by the silent end of each file; None where a file has none.
    findings : tuple of Finding
    """

    pressure: tuple[ComplexArray, ...]
    noise: tuple[FloatArray | None, ...]
    findings: tuple[Finding, ...]


def damped_responses(
    scene: Scene, files: Sequence[MeasuredFile], frequency_hz: FloatArray, tau_s: float
) -> DampedResponses:
    """Read responses, put them on the clock of emission, and return their damped spectra.

    Parameters
    ----------
    scene : Scene
        Its first pairs are those of the files, in their order.
    files : sequence of MeasuredFile
    frequency_hz : float array, shape (n_frequencies,)
    tau_s : float

    Raises
    ------
    InputError
        A file cannot be read, holds no direct sound, or ends before the window does.
    """
    speed = speed_of_sound_m_s(scene.air)
    travel_s = [float(d) / speed for d in distances_m(scene)[: len(files)]]
    findings: list[Finding] = []
    raw = []
    for file in files:
        response, doubts = read_response(file.response)
        raw.append(response)
        findings += doubts
    pressure, noise = [], []
    for file, response, direct_s in zip(
        files, from_emission(files, raw, travel_s), travel_s, strict=True
    ):
        where = str(file.response.path)
        check_travel(response, direct_s, where)
        if file.response.time_zero == "emission":
            onset_s = find_onset(response, where)
            name = f"{file.source} to {file.receiver} ({file.response.path.name})"
            rate_hz = response.sampling_rate_hz
            findings += compare_onset(onset_s, direct_s, speed, name, rate_hz)
        with located(where):
            pressure.append(damped_spectrum(response, frequency_hz, tau_s, direct_s))
        noise.append(damped_noise(response, frequency_hz, tau_s, direct_s))
    return DampedResponses(tuple(pressure), tuple(noise), tuple(findings))


DEFAULT_IMPEDANCE_POSITION_SD_M = 0.01
DEFAULT_SPEED_SD = 0.01
_KELVIN = 293.15

# A loudspeaker is not flat: unless a response is absolute, its source has a spectrum of its own.
_RESPONSE_GAINS: dict[str, GainMode] = {
    "per-source": "spectrum",
    "per-file": "pair-spectrum",
    "absolute": "known",
}
_GAINS: dict[str | None, GainMode] = {
    "per-source": "spectrum",
    "per-file": "pair",
    "absolute": "known",
    None: "known",
}


@dataclass(frozen=True, slots=True, eq=False)
class CampaignPressures:
    """The pairs of a campaign that are fitted, their pressures, and what may be wrong with them."""

    scene: Scene
    observed: Observed
    nuisances: Nuisances
    findings: tuple[Finding, ...]


def campaign_pressures(campaign: Campaign, room: Room) -> CampaignPressures:
    """Read everything that is to be fitted.

    Raises
    ------
    InputError
        Nothing that tells of phases or levels, positions that cannot be, files that cannot be read
        or do not belong together, or a pair that was measured twice.
    """
    files = [m for m in campaign.measurements if m.use == "fit"]
    spectra = [s for s in campaign.spectra if s.use == "fit"]
    if not files and not spectra:
        raise InputError(
            "the campaign holds no pressures",
            where=str(campaign.path),
            needed="impulse responses (file) or damped spectra (spectrum)",
            hint="room parameters tell no impedance",
        )
    scene = _scene(campaign, room, [*files, *spectra])
    _refuse_directivity(campaign, scene)
    read = [read_spectrum(s.path) for s in spectra]
    frequency_hz, tau_s = _grid(campaign, spectra, read)
    damped = damped_responses(scene, files, frequency_hz, tau_s)
    pressure, noise = list(damped.pressure), list(damped.noise)
    for one in read:
        own = (one.frequency_hz >= frequency_hz[0]) & (one.frequency_hz <= frequency_hz[-1])
        pressure.append(one.pressure[own])
        noise.append(None if one.noise is None else one.noise[own])
    known = [n for n in noise if n is not None]
    observed = Observed(
        frequency_hz,
        tau_s,
        np.array(pressure),
        np.array(known) if len(known) == len(noise) else None,
        all(one.has_phase for one in read),
    )
    return CampaignPressures(scene, observed, _nuisances(campaign, files, spectra), damped.findings)


def _scene(
    campaign: Campaign, room: Room, measured: list[MeasuredFile | MeasuredSpectrum]
) -> Scene:
    pairs = [(m.source, m.receiver) for m in measured]
    for pair in pairs:
        if pairs.count(pair) > 1:
            raise InputError(
                "a pair stands twice among the pressures",
                where=str(campaign.path),
                found=" to ".join(pair),
                needed="one measurement a pair",
                hint='mark the others with use = "validate"',
            )
    sources = tuple(s for s in campaign.sources if s.name in {p[0] for p in pairs})
    receivers = tuple(r for r in campaign.receivers if r.name in {p[1] for p in pairs})
    refuse(position_findings(room, sources, receivers))
    if campaign.impedance.positions == "fixed":
        sources, receivers = (
            tuple(type(p)(p.name, p.position_m, 0.0) for p in points)
            for points in (sources, receivers)
        )
    source_at = {s.name: i for i, s in enumerate(sources)}
    receiver_at = {r.name: i for i, r in enumerate(receivers)}
    indices = np.array([(source_at[s], receiver_at[r]) for s, r in pairs])
    return Scene(room, sources, receivers, indices, campaign.air)


def _refuse_directivity(campaign: Campaign, scene: Scene) -> None:
    for source in scene.sources:
        directivity = campaign.directivities.get(source.name, "omni")
        if directivity != "omni":
            raise InputError(
                "impedances need sources that radiate alike in all directions",
                where=f"{campaign.path}, sources.{source.name}.directivity",
                found=repr(directivity),
                needed='"omni"; a directivity is refused so that no answer pretends to obey it',
            )


def _grid(
    campaign: Campaign, spectra: list[MeasuredSpectrum], read: list[DampedSpectrum]
) -> tuple[FloatArray, float]:
    """Return the frequencies and the window: those of the spectra where there are any."""
    table = campaign.impedance
    where = f"{campaign.path}, impedance"
    if table.from_hz >= table.to_hz and not read:
        raise InputError(
            "the lowest frequency lies above the highest",
            where=where,
            found=f"from_hz = {table.from_hz:g}, to_hz = {table.to_hz:g}",
        )
    if not read:
        return np.arange(
            table.from_hz, table.to_hz + 0.5 * table.step_hz, table.step_hz
        ), table.tau_s
    first = read[0]
    for file, other in zip(spectra[1:], read[1:], strict=True):
        same = np.array_equal(other.frequency_hz, first.frequency_hz)
        if not same or other.tau_s != first.tau_s or other.has_phase != first.has_phase:
            raise InputError(
                "spectra of one campaign differ in f, tau or kind",
                where=str(file.path),
                found=f"{len(other.frequency_hz)} frequencies, tau {other.tau_s:g} s",
                needed=f"as in {spectra[0].path.name}: {len(first.frequency_hz)} frequencies, "
                f"tau {first.tau_s:g} s",
            )
    f = first.frequency_hz
    own = f[(f >= table.from_hz) & (f <= table.to_hz)]
    if len(own) == 0:
        raise InputError(
            "no frequency of the spectra lies between from_hz and to_hz",
            where=where,
            found=f"{f[0]:g} to {f[-1]:g} Hz",
            needed=f"{table.from_hz:g} to {table.to_hz:g} Hz",
        )
    return own, first.tau_s


def _nuisances(
    campaign: Campaign, files: list[MeasuredFile], spectra: list[MeasuredSpectrum]
) -> Nuisances:
    table = campaign.impedance
    speed_sd = 0.0
    if table.speed_of_sound == "fit":
        kelvin = campaign.temperature_sd_c
        # c grows as the root of the absolute temperature
        speed_sd = DEFAULT_SPEED_SD if kelvin is None else min(0.5 * kelvin / _KELVIN, 0.2)
    gain = _gain(campaign, files, spectra)
    # an onset that was found in each file is off in each; a clock is one of a source
    own = any(m.response.time_zero == "direct" for m in files)
    delays = [_latency_sd_s(m) for m in files]
    # a spectrum for each source and frequency holds any delay of the source
    known = gain in ("spectrum", "pair-spectrum") and not own
    return Nuisances(
        position_sd_m=0.0 if table.positions == "fixed" else DEFAULT_IMPEDANCE_POSITION_SD_M,
        speed_sd=speed_sd,
        gain=gain,
        delay_sd_s=0.0 if known else max(delays, default=0.0),
        delay="pair" if own else "source",
    )


def _latency_sd_s(file: MeasuredFile) -> float:
    if file.latency_sd_s is not None:
        return file.latency_sd_s
    return LATENCY_SD_S[file.response.time_zero]


def _gain(
    campaign: Campaign, files: list[MeasuredFile], spectra: list[MeasuredSpectrum]
) -> GainMode:
    if campaign.impedance.gain != "auto":
        return campaign.impedance.gain
    modes = {_RESPONSE_GAINS[m.level] for m in files} | {_GAINS[s.level] for s in spectra}
    if len(modes) > 1:
        raise InputError(
            "measurements with levels of several kinds",
            where=str(campaign.path),
            found=", ".join(sorted(modes)),
            needed="one kind of level for all pressures",
            hint="say gain under [impedance]",
        )
    return modes.pop()


def wall_models(campaign: Campaign, materials: tuple[str, ...]) -> dict[str, WallModel]:
    """Return how each material's R0 is to run over frequency; what is not told is a spline.

    Raises
    ------
    InputError
        A material that the room does not have, a start that is not passive, an unknown number of a
        law, or bounds out of order.
    """
    found = {name: WallModel() for name in materials}
    for name, table in campaign.materials.items():
        where = f"{campaign.path}, materials.{name}"
        if name not in found:
            guess = nearest(name, materials)
            raise InputError(
                "the campaign describes a material that the room does not have",
                where=where,
                needed=f"one of {', '.join(materials)}",
                hint=f"did you mean {guess!r}?" if guess else None,
            )
        with located(where):
            found[name] = _wall_model(table)
    return found


def _wall_model(table: MaterialTable) -> WallModel:
    kind = table.impedance or "spline"
    specified = dict(table.impedance_start or {})
    if kind in LAWS:
        known = {p.name: p for p in LAWS[kind][1]}
        return WallModel(
            kind,
            parameters={name: _parameter(known, kind, name, v) for name, v in specified.items()},
        )
    start: complex = 0.8
    for name, value in specified.items():
        if name != "r0":
            raise InputError(
                "unknown key of impedance_start",
                found=repr(name),
                needed=f'r0 for impedance = "{kind}": a number, or [real, imaginary]',
            )
        start = _start_r0(value)
    return WallModel(kind, start)


def _start_r0(value: float | list[float]) -> complex:
    parts = [float(v) for v in value] if isinstance(value, list) else [float(value), 0.0]
    if len(parts) != 2:
        raise InputError(
            "r0 of impedance_start is not a complex number",
            found=repr(value),
            needed="a number, or [real, imaginary]",
        )
    return complex(*parts)


def _parameter(
    known: dict[str, Parameter], kind: str, name: str, value: float | list[float]
) -> Parameter:
    if name not in known:
        guess = nearest(name, known)
        raise InputError(
            "unknown key of impedance_start",
            found=repr(name),
            needed=f'one of {", ".join(known)} for impedance = "{kind}"',
            hint=f"did you mean {guess!r}?" if guess else None,
        )
    usual = known[name]
    numbers = [float(v) for v in value] if isinstance(value, list) else [float(value)]
    if len(numbers) == 1:
        numbers += [min(usual.low, numbers[0] / 10.0), max(usual.high, numbers[0] * 10.0)]
    if len(numbers) != 3 or not 0.0 < numbers[1] <= numbers[0] <= numbers[2]:
        raise InputError(
            f"start and bounds of {name} are out of order",
            found=repr(value),
            needed=f"a number above 0 ({usual.unit}), or [start, lowest, highest]",
        )
    if numbers[1] == numbers[2]:
        raise InputError(
            f"bounds of {name} leave nothing to find",
            found=repr(value),
            needed="a lowest below the highest",
        )
    return Parameter(name, usual.unit, *numbers)


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
    from roomfit.impedance.output import spectra_figure, wall_figure
    from roomfit.report.figures import png

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
