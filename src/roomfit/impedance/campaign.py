"""From a campaign file to the arguments of `identify_impedance`: scene, spectra, walls, nuisances.

Impulse responses are set to the time of emission, multiplied by an exponential window and
transformed; damped spectra (NumPy archives) are taken as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from roomfit.base.air import relative_speed_sd, speed_of_sound_m_s
from roomfit.base.arguments import check_known, check_range
from roomfit.base.door import check_files, files_read, npz_arrays, read_bytes, reading_noted
from roomfit.base.errors import InputError, located
from roomfit.base.findings import Finding
from roomfit.base.typing import ComplexArray, FloatArray, Progress, part
from roomfit.base.whole_files import check_output_folder, sole_writer
from roomfit.files.campaign import Campaign, input_files, read_campaign, refuse_objects
from roomfit.files.inputs import positions_m, read_file
from roomfit.files.rooms import read_room
from roomfit.files.schema import MeasurementTable
from roomfit.fit.measurements import from_emission
from roomfit.impedance.data import Observed, damped_noise, damped_spectrum
from roomfit.impedance.identify import ImpedanceSettings, identify_impedance
from roomfit.impedance.laws import WallKind
from roomfit.impedance.result import ImpedanceResult, write_impedance
from roomfit.impedance.wave_model import GainMode, Nuisances
from roomfit.room.scene import Room, Scene, distances_m, scene_of
from roomfit.signals.measurement import LATENCY_SD_S
from roomfit.signals.response import check_travel, compare_onset, find_onset

# A loudspeaker is not flat: unless a response is absolute, its source has a spectrum of its own.
_RESPONSE_GAINS: dict[str | None, GainMode] = {
    "per-source": "spectrum",
    "per-file": "pair-spectrum",
    "absolute": "known",
}
_GAINS: dict[str | None, GainMode] = {**_RESPONSE_GAINS, "per-file": "pair", None: "known"}


@sole_writer
@reading_noted()
def impedance_to_folder(
    campaign_file: Path, out: Path, *, overwrite: bool = False, progress: Progress | None = None
) -> ImpedanceResult:
    """Identify impedances and write result.json, impedance.csv into a folder.

    What is marked for validation is not read.
    """
    check_output_folder(out, overwrite=overwrite)
    campaign = read_campaign(campaign_file)
    given, doubts = impedance_arguments(campaign)
    seed, progress = campaign.settings.seed, part(progress, 0.0, 0.95)
    result = identify_impedance(**given, rng=np.random.default_rng(seed), progress=progress)
    result = replace(result, findings=(*doubts, *result.findings), seed=seed)
    write_impedance(out, result, files_read(), overwrite=overwrite)
    return result


def impedance_arguments(campaign: Campaign) -> tuple[dict[str, Any], tuple[Finding, ...]]:
    """Return a campaign's files as arguments of `roomfit.identify_impedance`, and doubts.

    All arguments but the random generator.
    """
    room, room_findings = read_room(campaign.room, positions_m(campaign))
    refuse_objects(campaign, "roomfit impedance")
    walls = _wall_kinds(campaign, room.materials)
    files = [m for m in campaign.measurements if m.use == "fit"]
    spectra = [s for s in campaign.spectra if s.use == "fit"]
    if not files and not spectra:
        what, found = "the campaign holds no pressures", "no response and no spectrum to fit"
        needed = "impulse responses (file) or damped spectra (spectrum)"
        hint = "room parameters do not determine impedances"
        raise InputError(what, where=str(campaign.path), found=found, needed=needed, hint=hint)
    check_files(input_files(campaign.with_rows((*files, *spectra))), str(campaign.path))
    scene = _scene(campaign, room, [*files, *spectra])
    read = [read_spectrum(s.path) for s in spectra]
    frequency_hz, tau_s = _grid(campaign, spectra, read)
    pressure, noise, findings = _damped_responses(scene, files, frequency_hz, tau_s)
    for one in read:
        own = (one.frequency_hz >= frequency_hz[0]) & (one.frequency_hz <= frequency_hz[-1])
        pressure.append(one.pressure[0, own])
        noise.append(None if one.noise is None else one.noise[0, own])
    known = [n for n in noise if n is not None]
    all_known = np.array(known) if len(known) == len(noise) else None
    has_phase = all(one.has_phase for one in read)
    return {
        "scene": scene,
        "observed": Observed(frequency_hz, tau_s, np.array(pressure), all_known, has_phase),
        "walls": walls,
        "nuisances": _nuisances(campaign, files, spectra),
        "settings": ImpedanceSettings(random_starts=campaign.impedance.random_starts),
    }, (*room_findings, *findings)


def _scene(campaign: Campaign, room: Room, measured: list[MeasurementTable]) -> Scene:
    pairs = [(m.source, m.receiver) for m in measured]
    twice = next((pair for pair in pairs if pairs.count(pair) > 1), None)
    if twice is not None:
        what, needed = "a pair stands twice among the pressures", "one measurement a pair"
        hint = 'mark the others with use = "validate"'
        raise InputError(
            what, where=str(campaign.path), found=" to ".join(twice), needed=needed, hint=hint
        )
    sources, receivers = campaign.sources, campaign.receivers
    for name, _ in pairs:
        directivity = campaign.source_tables[name].directivity
        if directivity != "omni":
            raise InputError(
                "impedances need sources that radiate alike in all directions",
                where=f"{campaign.path}, sources.{name}.directivity",
                found=repr(directivity),
                needed='"omni"; a directivity is refused so that no result pretends to obey it',
                hint="leave out directivity, and fit where the source radiates alike",
            )
    if campaign.impedance.positions == "fixed":
        sources, receivers = (
            tuple(replace(p, position_sd_m=0.0) for p in points) for points in (sources, receivers)
        )
    return scene_of(room, sources, receivers, pairs, campaign.air)


def _damped_responses(
    scene: Scene, files: Sequence[MeasurementTable], frequency_hz: FloatArray, tau_s: float
) -> tuple[list[ComplexArray], list[FloatArray | None], list[Finding]]:
    """Return the damped spectrum of each file, (n_frequencies,), its rms noise where it has any.

    The first pairs of the scene are those of the files, in their order.
    """
    speed = speed_of_sound_m_s(scene.air)
    travel_s = [float(d) / speed for d in distances_m(scene)[: len(files)]]
    measured = [read_file(file) for file in files]
    findings = [finding for m in measured for finding in m.findings]
    pressure, noise = [], []
    responses = from_emission(measured, travel_s)
    for m, response, direct_s in zip(measured, responses, travel_s, strict=True):
        check_travel(response, direct_s, m.where)
        if m.time_zero == "emission":
            onset_s = find_onset(response, m.where)
            name = f"{m.source} to {m.receiver} ({m.name})"
            findings += compare_onset(onset_s, direct_s, speed, name, response.sampling_rate_hz)
        with located(m.where):
            pressure.append(damped_spectrum(response, frequency_hz, tau_s, direct_s))
        noise.append(damped_noise(response, frequency_hz, tau_s, direct_s))
    return pressure, noise, findings


def read_spectrum(path: Path) -> Observed:
    """Return the damped spectrum of a pair, pressure of shape (1, n_frequencies).

    The archive holds ``f`` (Hz, rising), ``tau`` (s), ``p`` (complex, ``exp(+j w t)``) and perhaps
    ``noise`` (rms, one number or one a frequency). Where only levels were measured, ``magnitude``
    (``|p|``, not in decibels) stands in place of ``p``.
    """
    arrays = npz_arrays(read_bytes(Path(path), "spectrum"), str(path))
    has_phase = "p" in arrays
    if has_phase == ("magnitude" in arrays) or not {"f", "tau"} <= arrays.keys():
        what, found = "a spectrum lacks an array, or has one too many", ", ".join(sorted(arrays))
        needed = "f (Hz), tau (s), and either p (complex) or magnitude"
        hint = "store them by numpy.savez(file, f=..., tau=..., p=...)"
        raise InputError(what, where=str(path), found=found or "none", needed=needed, hint=hint)
    for name in ("p", "magnitude", "f", "tau", "noise"):
        kind = arrays[name].dtype.kind if name in arrays else ""
        if kind not in ("c" if name == "p" else "iuf"):
            what, found = f"{name} has numbers of another kind", f"type {arrays[name].dtype}"
            needed = "complex numbers" if name == "p" else "real numbers"
            hint = f"store {name}.astype(float); p without phase as magnitude"
            raise InputError(what, where=str(path), found=found, needed=needed, hint=hint)
    if np.size(arrays["tau"]) != 1:
        what, found = "tau is not one number", f"{np.shape(arrays['tau'])}"
        hint = "store one spectrum a file, each with its tau"
        raise InputError(what, where=str(path), found=found, needed="one number (s)", hint=hint)
    pressure = arrays["p" if has_phase else "magnitude"]
    noise = arrays.get("noise")
    if noise is not None:
        noise = np.reshape(noise, (1, -1))
        noise = np.broadcast_to(noise, (1, pressure.size)) if noise.size == 1 else noise
    tau_s = float(np.reshape(arrays["tau"], ()))
    with located(str(path)):
        return Observed(arrays["f"], tau_s, pressure[None], noise, has_phase)


_MOST_FREQUENCIES = 5000


def _grid(
    campaign: Campaign, spectra: list[MeasurementTable], read: list[Observed]
) -> tuple[FloatArray, float]:
    """Return the frequencies and the window: those of the spectra where there are any."""
    table, where = campaign.impedance, f"{campaign.path}, impedance"
    low, high, step = table.from_hz, table.to_hz, table.step_hz
    if not read:
        check_range("from_hz, at most to_hz,", low, 0.0, high, where=where)
        n, what = (high - low) / step, f"the number of frequencies, one every {step:g} Hz,"
        check_range(what, n, 0.0, _MOST_FREQUENCIES, where=f"{where}.step_hz")
        return np.arange(low, high + 0.5 * step, step), table.tau_s
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
                hint="compute them alike, or put them into campaigns of their own",
            )
    f = first.frequency_hz
    own = f[(f >= low) & (f <= high)]
    if len(own) == 0:
        what = "no frequency of the spectra lies between from_hz and to_hz"
        found, needed = f"{f[0]:g} to {f[-1]:g} Hz", f"{low:g} to {high:g} Hz"
        hint = "set from_hz and to_hz to the range of the spectra"
        raise InputError(what, where=where, found=found, needed=needed, hint=hint)
    return own, first.tau_s


def _nuisances(
    campaign: Campaign, files: list[MeasurementTable], spectra: list[MeasurementTable]
) -> Nuisances:
    table, usual, gain = campaign.impedance, Nuisances(), campaign.impedance.gain
    speed_sd = 0.0
    if table.speed_of_sound == "fit":
        sd_c, speed_sd = campaign.settings.temperature_sd_c, usual.speed_sd
        if sd_c is not None:
            speed_sd = min(relative_speed_sd(campaign.air, sd_c), 0.2)
    if gain == "auto":
        modes = {_RESPONSE_GAINS[m.level] for m in files}
        modes |= {_GAINS[s.stated_level] for s in spectra}
        if len(modes) > 1:
            raise InputError(
                "measurements with levels of several kinds",
                where=str(campaign.path),
                found=", ".join(sorted(modes)),
                needed="one kind of level for all pressures",
                hint="specify gain under [impedance]",
            )
        (gain,) = modes
    # an onset that was found in each file errs in each; a clock is one of a source
    own = any(m.response.time_zero == "direct" for m in files)
    delays = [
        LATENCY_SD_S[m.response.time_zero] if m.latency_sd_s is None else m.latency_sd_s
        for m in files
    ]
    # a spectrum for each source and frequency holds any delay of the source
    known = gain in ("spectrum", "pair-spectrum") and not own
    return Nuisances(
        speed_sd=speed_sd,
        gain=gain,
        delay_sd_s=0.0 if known else max(delays, default=0.0),
        delay="pair" if own else "source",
    )


def _wall_kinds(campaign: Campaign, materials: tuple[str, ...]) -> dict[str, WallKind]:
    """Return how R0 depends on frequency, of the materials of which that is specified."""
    what = "the campaign describes a material that the room does not have"
    for name in campaign.materials:
        check_known(what, name, materials, where=f"{campaign.path}, materials.{name}")
    return {name: own.impedance for name, own in campaign.materials.items() if own.impedance}
