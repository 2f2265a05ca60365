"""Measured files of a campaign: read, put on the clock of emission, and judged band by band."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from roomfit.air import speed_of_sound_m_s
from roomfit.files.campaign.campaign import Campaign, MeasuredFile
from roomfit.files.responses.read import read_response
from roomfit.findings import Finding
from roomfit.scene.scene import Scene, distances_m
from roomfit.signals.decay import DecayCurve, decay_curve
from roomfit.signals.filters import FilterBank, check_sampling_rate, filter_pressure
from roomfit.signals.impulse_response import ImpulseResponse
from roomfit.signals.noise import NoiseEstimate, estimate_noise
from roomfit.signals.onset import compare_onset, find_onset
from roomfit.signals.room_parameters import RoomParameters, range_findings, room_parameters


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPair:
    """One measured response and what is known from it without any model.

    Attributes
    ----------
    file : MeasuredFile
    pair : int
        Index of the pair in the scene.
    response : ImpulseResponse
        Its `time_zero_s` is the emission, whatever the file's own clock said.
    direct_s : float
        Travel time of the direct sound by the geometry.
    noise : NoiseEstimate
    curve : DecayCurve
    parameters : RoomParameters
    """

    file: MeasuredFile
    pair: int
    response: ImpulseResponse
    direct_s: float
    noise: NoiseEstimate
    curve: DecayCurve
    parameters: RoomParameters


def measure(
    campaign: Campaign, scene: Scene
) -> tuple[tuple[MeasuredPair, ...], tuple[Finding, ...]]:
    """Read and examine every measured file of a campaign, in its order.

    Raises
    ------
    InputError
        A file is missing, broken, silent or too short, or a band reaches above half of its
        sampling rate.
    """
    bank = FilterBank(campaign.bands)
    direct = distances_m(scene) / speed_of_sound_m_s(scene.air)
    pair_of = {
        (scene.sources[s].name, scene.receivers[r].name): i for i, (s, r) in enumerate(scene.pairs)
    }
    findings: list[Finding] = []
    responses: list[ImpulseResponse] = []
    for file in campaign.measurements:
        response, found = read_response(file.response)
        check_sampling_rate(bank, response.sampling_rate_hz, str(file.response.path))
        findings += found
        responses.append(response)
    offsets = _time_offsets(campaign, responses, direct, pair_of)
    measured = []
    for file, raw, offset_s in zip(campaign.measurements, responses, offsets, strict=True):
        pair = pair_of[file.source, file.receiver]
        response = replace(raw, time_zero_s=raw.time_zero_s + offset_s)
        if file.response.time_zero == "emission":
            findings += compare_onset(
                find_onset(response),
                float(direct[pair]),
                speed_of_sound_m_s(scene.air),
                file.response.path.name,
            )
        found_pair = _judged(bank, file, pair, response, float(direct[pair]))
        findings += range_findings(found_pair.parameters, file.response.path.name)
        measured.append(found_pair)
    return tuple(measured), tuple(findings)


def _judged(
    bank: FilterBank, file: MeasuredFile, pair: int, response: ImpulseResponse, direct_s: float
) -> MeasuredPair:
    noise = estimate_noise(bank, response, filter_pressure(bank, response), direct_s)
    curve = decay_curve(bank, response, direct_s)
    return MeasuredPair(file, pair, response, direct_s, noise, curve, room_parameters(curve))


def _time_offsets(
    campaign: Campaign,
    responses: list[ImpulseResponse],
    direct_s: np.ndarray[tuple[int], np.dtype[np.float64]],
    pair_of: Mapping[tuple[str, str], int],
) -> list[float]:
    """Return what must be added to each file's time zero so that sample times count from emission.

    ``direct``: the file's own onset is the direct sound. ``unknown``: one offset a source, the
    median over its files, so that a single masked onset moves nothing.
    """
    late = []
    for file, response in zip(campaign.measurements, responses, strict=True):
        if file.response.time_zero == "emission":
            late.append(0.0)
        else:
            expected = float(direct_s[pair_of[file.source, file.receiver]])
            late.append(find_onset(response) - expected)
    offsets = []
    for file, own in zip(campaign.measurements, late, strict=True):
        if file.response.time_zero == "unknown":
            same = [
                other
                for f, other in zip(campaign.measurements, late, strict=True)
                if f.source == file.source and f.response.time_zero == "unknown"
            ]
            offsets.append(float(np.median(same)))
        else:
            offsets.append(own)
    return offsets
