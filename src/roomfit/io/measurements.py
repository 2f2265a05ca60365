""" """

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from roomfit.air import speed_of_sound_m_s
from roomfit.errors import InputError
from roomfit.findings import Finding
from roomfit.io.campaign import Campaign
from roomfit.io.responses import read_response
from roomfit.measurement import MeasuredFile, MeasuredPair
from roomfit.scene import Scene, distances_m
from roomfit.signals.decay import (
    check_decay_range,
    check_is_response,
    decay_curve,
    range_findings,
    room_parameters,
)
from roomfit.signals.filters import FilterBank, check_sampling_rate, filter_pressure
from roomfit.signals.noise import estimate_noise
from roomfit.signals.response import (
    ImpulseResponse,
    check_travel,
    compare_onset,
    find_onset,
    time_zero_from_direct,
)


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
    c = speed_of_sound_m_s(scene.air)
    pair_of = {
        (scene.sources[s].name, scene.receivers[r].name): i for i, (s, r) in enumerate(scene.pairs)
    }
    pairs = [pair_of[file.source, file.receiver] for file in campaign.measurements]
    travel_s = [float(d) for d in (distances_m(scene) / c)[pairs]]
    raw, findings = _read_all(campaign, bank)
    measured = []
    for file, pair, direct_s, response in zip(
        campaign.measurements,
        pairs,
        travel_s,
        from_emission(campaign.measurements, raw, travel_s),
        strict=True,
    ):
        where, name = str(file.response.path), _name(file)
        check_travel(response, direct_s, where)
        if file.response.time_zero == "emission":
            onset_s = find_onset(response, where)
            findings += compare_onset(onset_s, direct_s, c, name, response.sampling_rate_hz)
        found = _judged(bank, file, pair, response, direct_s)
        check_decay_range(found.curve, where)
        findings += range_findings(found.parameters, name)
        measured.append(found)
    return tuple(measured), tuple(findings)


def _read_all(campaign: Campaign, bank: FilterBank) -> tuple[list[ImpulseResponse], list[Finding]]:
    findings: list[Finding] = []
    responses: list[ImpulseResponse] = []
    for file in campaign.measurements:
        where = str(file.response.path)
        response, found = read_response(file.response)
        check_sampling_rate(bank, response.sampling_rate_hz, where)
        if responses and response.sampling_rate_hz != responses[0].sampling_rate_hz:
            raise InputError(
                "the measurements have different sampling rates",
                where=where,
                found=f"{response.sampling_rate_hz:g} Hz, after {responses[0].sampling_rate_hz:g} "
                "Hz in the files before",
                needed="one sampling rate in a campaign, since one equipment measured it",
                hint="check that no file was saved at a wrong rate; resample those that were not",
            )
        check_is_response(response, where)
        findings += found
        responses.append(response)
    return responses, findings


def _name(file: MeasuredFile) -> str:
    return f"{file.source} to {file.receiver} ({file.response.path.name})"


def _judged(
    bank: FilterBank, file: MeasuredFile, pair: int, response: ImpulseResponse, direct_s: float
) -> MeasuredPair:
    noise = estimate_noise(bank, response, filter_pressure(bank, response), direct_s)
    curve = decay_curve(bank, response, direct_s)
    return MeasuredPair(file, pair, response, direct_s, noise, curve, room_parameters(curve))


def from_emission(
    files: Sequence[MeasuredFile], raw: Sequence[ImpulseResponse], travel_s: Sequence[float]
) -> list[ImpulseResponse]:
    """Return the responses on a clock that counts from emission.

    ``direct``: the file's own onset is the direct sound. ``unknown``: one offset a source, the
    median over its files, so that a single masked onset moves nothing. Files for validation have
    a say only where a source has no other.
    """
    aligned = [
        response
        if file.response.time_zero == "emission"
        else time_zero_from_direct(response, direct_s, str(file.response.path))
        for file, response, direct_s in zip(files, raw, travel_s, strict=True)
    ]
    offsets: dict[tuple[str, str], list[float]] = {}
    for file, own in zip(files, aligned, strict=True):
        if file.response.time_zero == "unknown":
            offsets.setdefault((file.source, file.use), []).append(own.time_zero_s)
    return [
        replace(own, time_zero_s=_offset_s(offsets, file.source))
        if file.response.time_zero == "unknown"
        else own
        for file, own in zip(files, aligned, strict=True)
    ]


def _offset_s(offsets: dict[tuple[str, str], list[float]], source: str) -> float:
    fitted = offsets.get((source, "fit"))
    return float(np.median(fitted if fitted else offsets[source, "validate"]))
