"""Measured pressures of a campaign behind one exponential window, pair by pair."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roomfit.app.impedance.responses import damped_responses
from roomfit.app.measuring import LATENCY_SD_S
from roomfit.errors import InputError
from roomfit.files.campaign.campaign import Campaign, MeasuredFile, MeasuredSpectrum
from roomfit.files.spectra import DampedSpectrum, read_spectrum
from roomfit.findings import Finding
from roomfit.geometry.faults import refuse
from roomfit.impedance.model import GainMode, Nuisances
from roomfit.impedance.observed import Observed
from roomfit.scene.positions import position_findings
from roomfit.scene.room import Room
from roomfit.scene.scene import Scene
from roomfit.typing import FloatArray

UNTOLD_SD_M = 0.01
UNTOLD_SPEED_SD = 0.01
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
        told = campaign.directivities.get(source.name, "omni")
        if told != "omni":
            raise InputError(
                "impedances need sources that radiate alike in all directions",
                where=f"{campaign.path}, sources.{source.name}.directivity",
                found=repr(told),
                needed='"omni"; a directivity is refused so that no answer pretends to obey it',
            )


def _grid(
    campaign: Campaign, spectra: list[MeasuredSpectrum], read: list[DampedSpectrum]
) -> tuple[FloatArray, float]:
    """Return the frequencies and the window: those of the spectra where there are any."""
    told = campaign.impedance
    where = f"{campaign.path}, impedance"
    if told.from_hz >= told.to_hz and not read:
        raise InputError(
            "the lowest frequency lies above the highest",
            where=where,
            found=f"from_hz = {told.from_hz:g}, to_hz = {told.to_hz:g}",
        )
    if not read:
        return np.arange(told.from_hz, told.to_hz + 0.5 * told.step_hz, told.step_hz), told.tau_s
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
    own = f[(f >= told.from_hz) & (f <= told.to_hz)]
    if len(own) == 0:
        raise InputError(
            "no frequency of the spectra lies between from_hz and to_hz",
            where=where,
            found=f"{f[0]:g} to {f[-1]:g} Hz",
            needed=f"{told.from_hz:g} to {told.to_hz:g} Hz",
        )
    return own, first.tau_s


def _nuisances(
    campaign: Campaign, files: list[MeasuredFile], spectra: list[MeasuredSpectrum]
) -> Nuisances:
    told = campaign.impedance
    speed_sd = 0.0
    if told.speed_of_sound == "fit":
        kelvin = campaign.temperature_sd_c
        # c grows as the root of the absolute temperature
        speed_sd = UNTOLD_SPEED_SD if kelvin is None else min(0.5 * kelvin / _KELVIN, 0.2)
    gain = _gain(campaign, files, spectra)
    # an onset that was found in each file is off in each; a clock is one of a source
    own = any(m.response.time_zero == "direct" for m in files)
    delays = [_latency_sd_s(m) for m in files]
    # a spectrum for each source and frequency holds any delay of the source
    known = gain in ("spectrum", "pair-spectrum") and not own
    return Nuisances(
        position_sd_m=0.0 if told.positions == "fixed" else UNTOLD_SD_M,
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
