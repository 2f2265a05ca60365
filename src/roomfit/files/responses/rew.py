"""Impulse responses that Room EQ Wizard (REW) exported as text."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from roomfit.errors import InputError
from roomfit.files.responses.recording import Recording
from roomfit.files.responses.spec import ResponseSpec
from roomfit.findings import Finding
from roomfit.typing import FloatArray

_TITLE = "impulse response data saved by rew"
_NUMBERS = {
    "peak value before normalisation": "peak_value",
    "peak index": "peak_index",
    "response length": "length",
    "sample interval (seconds)": "interval_s",
    "start time (seconds)": "start_s",
}
_NEEDED = {"length": "Response length", "interval_s": "Sample interval", "start_s": "Start time"}
_MOST_HEADER_LINES = 200


@dataclass(frozen=True, slots=True)
class _Header:
    """What stands above the samples.

    Attributes
    ----------
    numbers : mapping from short name to float
    notes : str
        All other lines, in lower case.
    n_lines : int
        Lines before the first sample.
    """

    numbers: Mapping[str, float]
    notes: str
    n_lines: int


def read_rew(spec: ResponseSpec, content: bytes) -> Recording:
    """Return the impulse response of a text file that REW wrote (File, Export, Impulse Response).

    The header gives the sampling rate and the time of the first sample on REW's own clock, mostly
    negative. REW's zero is the time of emission only where it measured with a loopback as timing
    reference; otherwise it lies at (or near) the peak, and `time_zero` must be "direct". A response
    that REW normalised is given its level back.

    Parameters
    ----------
    spec : ResponseSpec
        Names the file in messages; its `time_zero` is held against the file.
    content : bytes
        The whole file.

    Raises
    ------
    InputError
        Not such a file, cut off, a number that is none, or a minimum-phase version, which has lost
        all arrival times.
    """
    where = str(spec.path)
    lines = _text(content, where).split("\n")
    header = _header(lines, where)
    if "ir is the min phase version" in header.notes:
        raise InputError(
            "a minimum-phase response has lost its arrival times",
            where=where,
            hint="export the response itself, not its minimum-phase version",
        )
    rate_hz = _rate_hz(header.numbers["interval_s"], where)
    pressure = _samples(lines[header.n_lines :], header, where)
    findings: list[Finding] = []
    if "ir is normalised" in header.notes:
        pressure, told = _with_its_level(pressure, header, spec)
        findings += told
    findings += _window_findings(header, spec)
    findings += _clock_findings(pressure, rate_hz, header, spec)
    return Recording(pressure, rate_hz, header.numbers["start_s"], tuple(findings))


def _text(content: bytes, where: str) -> str:
    if b"\0" in content:
        raise _not_rew(where, "a binary file")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _header(lines: list[str], where: str) -> _Header:
    first = next((line.strip() for line in lines if line.strip()), "")
    if not first.lstrip("* ").lower().startswith(_TITLE):
        raise _not_rew(where, repr(first[:60]))
    numbers: dict[str, float] = {}
    notes: list[str] = []
    n_lines = len(lines)
    for index, line in enumerate(lines[:_MOST_HEADER_LINES]):
        text = line.strip()
        if text.lstrip("* ").lower() == "data start":
            n_lines = index + 1
            break
        if _is_number(text):  # an older export that does not announce its samples
            n_lines = index
            break
        value, mark, label = text.partition("//")
        key = _NUMBERS.get(label.strip().lower())
        if mark and key:
            numbers[key] = _number(value.lstrip("* "), f"{where}, line {index + 1}")
        else:
            notes.append(text.lstrip("* ").lower())
    for key, label in _NEEDED.items():
        if key not in numbers:
            raise InputError(
                "the header of the REW file is not complete",
                where=where,
                needed=f'a line "... // {label}"',
                hint="the file may be cut off: export it again from REW",
            )
    return _Header(numbers, "\n".join(notes), n_lines)


def _not_rew(where: str, found: str) -> InputError:
    return InputError(
        "this is not an impulse response that REW exported as text",
        where=where,
        found=found,
        needed='a first line "* Impulse Response data saved by REW"',
        hint="in REW: File, Export, Export impulse response as text",
    )


def _is_number(text: str) -> bool:
    return bool(re.fullmatch(r"[-+]?(\d+[.,]?\d*|[.,]\d+)([eE][-+]?\d+)?|[-+]?(?i:nan|inf)", text))


def _number(text: str, where: str) -> float:
    """Return a finite number; some settings of REW write a decimal comma."""
    try:
        value = float(text.strip().replace(",", "."))
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(
            "a number of the REW file is not one", where=where, found=repr(text.strip()[:40])
        )
    return value


def _rate_hz(interval_s: float, where: str) -> float:
    if not 1e-6 <= interval_s <= 1e-3:
        raise InputError(
            "the sample interval of the REW file is out of range",
            where=where,
            found=f"{interval_s:g} s",
            needed="0.000001 to 0.001 s",
        )
    rate_hz = 1.0 / interval_s
    whole = round(rate_hz)
    return float(whole) if abs(rate_hz - whole) < 1e-6 * rate_hz else rate_hz


def _samples(lines: list[str], header: _Header, where: str) -> FloatArray:
    while lines and not lines[-1].strip():
        lines = lines[:-1]
    try:
        samples = np.array([float(line) for line in lines])
    except ValueError:
        samples = np.array(
            [
                _number(line, f"{where}, line {header.n_lines + k + 1}")
                for k, line in enumerate(lines)
            ]
        )
    needed = header.numbers["length"]
    if len(samples) != needed:
        raise InputError(
            "the REW file is cut off" if len(samples) < needed else "the REW file is too long",
            where=where,
            found=f"{len(samples)} samples",
            needed=f"{needed:g}, by its own header",
            hint="export it again from REW",
        )
    return samples


def _with_its_level(
    pressure: FloatArray, header: _Header, spec: ResponseSpec
) -> tuple[FloatArray, list[Finding]]:
    """Undo REW's division by the peak."""
    peak = abs(header.numbers.get("peak_value", 0.0))
    largest = float(np.abs(pressure).max(initial=0.0))
    if peak > 0.0 and largest > 0.0:
        return pressure * (peak / largest), []
    text = (
        f"{spec.path.name} was normalised by REW and does not say what its peak was: its level "
        "means nothing beside that of other files."
    )
    return pressure, [Finding("level-lost", "warning", text, {})]


def _window_findings(header: _Header, spec: ResponseSpec) -> list[Finding]:
    if "ir window has been applied" not in header.notes:
        return []
    text = (
        f"{spec.path.name} was exported with REW's window applied, which bends the late decay and "
        "hides the noise; export it without the window."
    )
    return [Finding("window-applied", "warning", text, {})]


def _clock_findings(
    pressure: FloatArray, rate_hz: float, header: _Header, spec: ResponseSpec
) -> list[Finding]:
    """Tell where REW's zero lies at the peak and is taken for the time of emission."""
    peak_s = int(np.argmax(np.abs(pressure))) / rate_hz + header.numbers["start_s"]
    if spec.time_zero != "emission" or not abs(peak_s) <= 1.5 / rate_hz:
        return []
    text = (
        f"REW put the time zero of {spec.path.name} at the peak, so it does not tell when the "
        'sound left; say time_zero = "direct", or measure with a loopback as timing reference.'
    )
    return [Finding("time-zero-at-peak", "warning", text, {"peak_s": peak_s})]
