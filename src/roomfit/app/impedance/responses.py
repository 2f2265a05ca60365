"""Impulse responses of a campaign on the clock of emission, and their damped spectra."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from roomfit.air import speed_of_sound_m_s
from roomfit.app.measuring import from_emission
from roomfit.errors import located
from roomfit.files.campaign.campaign import MeasuredFile
from roomfit.files.responses.read import read_response
from roomfit.findings import Finding
from roomfit.scene.scene import Scene, distances_m
from roomfit.signals.damped import damped_noise, damped_spectrum
from roomfit.signals.onset import check_travel, compare_onset, find_onset
from roomfit.typing import ComplexArray, FloatArray


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
