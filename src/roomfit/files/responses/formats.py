"""Responses in sound files, MATLAB and NumPy files, and text exported by Room EQ Wizard (REW).

A sound file that was cut off in copying opens without complaint in every reader, and the missing
end looks like a room with less reverberation. So the lengths in the header are checked here.
"""

from __future__ import annotations

import io
import math
import re

import numpy as np
import soundfile

from roomfit.base.arguments import ARCHIVE_DAMAGE, did_you_mean
from roomfit.base.door import decoded, limit, npy_array, quiet, unpacked_limit_bytes
from roomfit.base.errors import InputError, located
from roomfit.base.findings import About, Code, Finding
from roomfit.base.typing import FloatArray
from roomfit.files.responses.recordings import Recording, ResponseSpec, pick
from roomfit.formats.matlab import Variables, mat_variables


def read_mat(spec: ResponseSpec, content: bytes) -> Recording:
    """Return the column of a variable of a MAT file that is asked for."""
    variables = _variables(content)
    responses = _responses(variables, spec)
    channel = pick("response", spec.channel, responses.shape[1], "channel")
    return Recording(responses[:, channel].copy(), _sampling_rate_hz(variables, spec))


_ITA = "ITA_TOOLBOX_AUDIO_OBJECT"


def read_ita(spec: ResponseSpec, content: bytes) -> Recording:
    """Return the channel of an audio object of the ITA-Toolbox [1]_ that is asked for.

    The toolbox writes a structure with samples, their scale and their rate into a MAT file.

    References
    ----------
    .. [1] RWTH Aachen, ITA-Toolbox, ``itaSuper.saveobj`` and ``ita_write_ita`` (2011-2024).
    """
    variables = _variables(content)
    keys = ("domain", "data", "samplingRate", "dataFactor")
    own = {key: variables[f"{_ITA}.{key}"] for key in keys if f"{_ITA}.{key}" in variables}
    domain, data, rate, factor = (own.get(key) for key in keys)
    factor = np.ones(1) if factor is None else factor
    scales = [v for v in (rate, factor) if not isinstance(v, str | None) and v.size == 1]
    if isinstance(data, str | None) or data.ndim != 2 or domain != "text 'time'" or len(scales) < 2:
        raise InputError(
            "this is not an audio object of the ITA-Toolbox that can be read",
            found=_listed(own or variables)[:300],
            needed=f"a structure {_ITA} with data in the domain 'time' and one samplingRate",
            hint="in MATLAB: a = ita_read(FILE); RIR = a.timeData; Fs = a.samplingRate; "
            "save('a.mat', 'RIR', 'Fs', '-v7')",
        )
    columns = _columns(data) * float(scales[1].reshape(-1)[0])
    channel = pick("channel", spec.channel, columns.shape[1], "channel")
    return Recording(columns[:, channel].copy(), float(scales[0].reshape(-1)[0]))


def _variables(content: bytes) -> Variables:
    try:
        return mat_variables(content)
    except ValueError as error:
        what = "this is not a MAT file that can be read"
        needed, hint = "a MATLAB file of version 5 to 7.3", "in MATLAB: save(file, '-v7')"
        raise InputError(what, found=str(error), needed=needed, hint=hint) from error


def _responses(variables: Variables, spec: ResponseSpec) -> FloatArray:
    """Return the named variable as columns of samples."""
    if spec.variable is None:
        raise InputError(
            "which variable of the MAT file holds the responses?",
            found=_listed(variables),
            needed="variable = one of these names",
            hint=f"variable = {next(iter(variables))!r}"
            if variables
            else "save the responses into it",
        )
    if spec.variable not in variables:
        raise InputError(
            "the MAT file has no such variable",
            found=f"variable = {spec.variable!r}",
            needed=f"one of {_listed(variables)}",
            hint=did_you_mean(spec.variable, variables) or "write variable = as the file has it",
        )
    values = variables[spec.variable]
    if isinstance(values, str) or values.ndim != 2 or values.size == 0:
        nested = values in ("a structure", "a cell array") if isinstance(values, str) else False
        what = "the variable of the MAT file holds no responses"
        needed = "an array of real numbers, one response a column"
        hint = "in MATLAB, save what lies in it as a variable of its own" if nested else None
        raise InputError(what, where=spec.variable, found=_kind(values), needed=needed, hint=hint)
    with located(spec.variable):
        return _columns(values)


def _columns(values: FloatArray) -> FloatArray:
    """Return responses as columns; a single one may stand in a row."""
    if values.shape[0] == 1:
        return np.ascontiguousarray(values.T)
    if values.shape[1] > values.shape[0]:
        raise InputError(
            "the responses stand in rows",
            found=f"{values.shape[0]} rows and {values.shape[1]} columns",
            needed="one response a column",
            hint="save the transposed array",
        )
    return values


def _sampling_rate_hz(variables: Variables, spec: ResponseSpec) -> float:
    if spec.sampling_rate_variable is None:
        if spec.sampling_rate_hz is not None:
            return spec.sampling_rate_hz
        single = [name for name, v in variables.items() if not isinstance(v, str) and v.size == 1]
        raise InputError(
            "the sampling rate of the MAT file is missing",
            found="neither of the two",
            needed="sampling_rate_variable (a name) or sampling_rate_hz (a number)",
            hint=f"single numbers in the file: {', '.join(single)}"
            if single
            else "sampling_rate_hz = 48000, say",
        )
    values = variables.get(spec.sampling_rate_variable)
    if values is None or isinstance(values, str) or values.size != 1:
        raise InputError(
            "the MAT file has no such sampling rate",
            found=f"sampling_rate_variable = {spec.sampling_rate_variable!r}",
            needed=f"one number; the file holds {_listed(variables)}",
            hint="give sampling_rate_hz instead, a number in Hz",
        )
    return float(values.reshape(-1)[0])


def _listed(variables: Variables) -> str:
    return ", ".join(f"{name} {_kind(v)}" for name, v in variables.items()) or "nothing"


def _kind(values: FloatArray | str) -> str:
    return f"({values})" if isinstance(values, str) else str(values.shape)


_TITLE = "impulse response data saved by rew"
_REW_NUMBERS = {
    "peak value before normalisation": "peak_value",
    "peak index": "peak_index",
    "response length": "length",
    "sample interval (seconds)": "interval_s",
    "start time (seconds)": "start_s",
}
_NEEDED = {"length": "Response length", "interval_s": "Sample interval", "start_s": "Start time"}
_MOST_HEADER_LINES = 200


def read_rew(spec: ResponseSpec, content: bytes) -> Recording:
    """Return the impulse response of a text file that REW wrote (File, Export, Impulse Response).

    The header gives the sampling rate and the time of the first sample on REW's own clock, mostly
    negative. REW's zero is the time of emission only where it measured with a loopback as timing
    reference; otherwise it lies at (or near) the peak, and `time_zero` must be "direct". A response
    that REW normalised is given its level back.
    """
    if b"\0" in content:
        raise _not_rew("a binary file")
    lines = decoded(content).split("\n")
    numbers, notes, n_header = _header(lines)
    if "ir is the min phase version" in notes:
        raise InputError(
            "a minimum-phase response has lost its arrival times",
            found='"IR is the min phase version" in its header',
            needed="the response as it was measured",
            hint="export the response itself, not its minimum-phase version",
        )
    rate_hz = _rate_hz(numbers["interval_s"])
    pressure = _samples(lines, n_header, numbers["length"])
    name, start_s, findings = spec.path.name, numbers["start_s"], []
    if "ir is normalised" in notes:
        peak = abs(numbers.get("peak_value", 0.0))
        largest = float(np.abs(pressure).max(initial=0.0))
        if peak > 0.0 and largest > 0.0:
            pressure = pressure * (peak / largest)
        else:
            text = (
                f"{name} was normalised by REW and does not say what its peak was: its level "
                "means nothing beside that of other files."
            )
            findings.append(Finding(Code.LEVEL_UNKNOWN, About(files=[name]), text))
    if "ir window has been applied" in notes:
        text = (
            f"{name} was exported with REW's window applied, which bends the late decay and "
            "hides the noise; export it without the window."
        )
        findings.append(Finding(Code.WINDOW_APPLIED, About(files=[name]), text))
    peak_s = int(np.argmax(np.abs(pressure))) / rate_hz + start_s
    if spec.time_zero == "emission" and abs(peak_s) <= 1.5 / rate_hz:
        text = (
            f"REW put the time zero of {name} at the peak, so it does not contain the "
            'time of emission; specify time_zero = "direct", or measure with a loopback as timing '
            "reference."
        )
        findings.append(
            Finding(Code.TIME_ZERO_AT_PEAK, About(files=[name]), text, {"peak_s": peak_s})
        )
    return Recording(pressure, rate_hz, start_s, tuple(findings))


def _header(lines: list[str]) -> tuple[dict[str, float], str, int]:
    """Return the numbers above the samples, other lines in lower case, and how many there are."""
    first = next((line.strip() for line in lines if line.strip()), "")
    if not first.lstrip("* ").lower().startswith(_TITLE):
        raise _not_rew(repr(first[:60]))
    numbers: dict[str, float] = {}
    notes: list[str] = []
    n_lines = len(lines)
    most_letters = limit("header_bytes")
    for index, line in enumerate(lines[:_MOST_HEADER_LINES]):
        text = line.strip()
        most_letters -= len(line)
        if most_letters < 0:
            raise _not_rew(f"a header of more than {limit('header_bytes'):g} letters")
        if text.lstrip("* ").lower() == "data start":
            n_lines = index + 1
            break
        if _is_number(text):  # an older export that does not announce its samples
            n_lines = index
            break
        value, mark, label = text.partition("//")
        key = _REW_NUMBERS.get(label.strip().lower())
        if mark and key:
            numbers[key] = _number(value.lstrip("* "), index + 1)
        else:
            notes.append(text.lstrip("* ").lower())
    for key, label in _NEEDED.items():
        if key not in numbers:
            raise InputError(
                "the header of the REW file is not complete",
                found="a header without it",
                needed=f'a line "... // {label}"',
                hint="the file may be cut off: export it again from REW",
            )
    return numbers, "\n".join(notes), n_lines


def _not_rew(found: str) -> InputError:
    return InputError(
        "this is not an impulse response that REW exported as text",
        found=found,
        needed='a first line "* Impulse Response data saved by REW"',
        hint="in REW: File, Export, Export impulse response as text",
    )


def _is_number(text: str) -> bool:
    return bool(
        re.fullmatch(r"[-+]?(\d+([.,]\d*)?|[.,]\d+)([eE][-+]?\d+)?|[-+]?(?i:nan|inf)", text)
    )


def _number(text: str, line: int) -> float:
    """Return a finite number; some settings of REW write a decimal comma."""
    try:
        value = float(text.strip().replace(",", "."))
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(
            "a number of the REW file is not one",
            where=f"line {line}",
            found=repr(text.strip()[:40]),
            needed="a finite number",
            hint="export the response again from REW, as text",
        )
    return value


def _rate_hz(interval_s: float) -> float:
    if not 1e-6 <= interval_s <= 1e-3:
        what = "the sample interval of the REW file is out of range"
        hint = "export the impulse response from REW again"
        raise InputError(what, found=f"{interval_s:g} s", needed="0.000001 to 0.001 s", hint=hint)
    rate_hz = 1.0 / interval_s
    whole = round(rate_hz)
    return float(whole) if abs(rate_hz - whole) < 1e-6 * rate_hz else rate_hz


def _samples(lines: list[str], n_header: int, needed: float) -> FloatArray:
    lines = lines[n_header:]
    while lines and not lines[-1].strip():
        lines = lines[:-1]
    try:
        samples = np.array([float(line) for line in lines])
    except ValueError:
        samples = np.array([_number(line, n) for n, line in enumerate(lines, n_header + 1)])
    if len(samples) != needed:
        raise InputError(
            "the REW file is cut off" if len(samples) < needed else "the REW file is too long",
            found=f"{len(samples)} samples",
            needed=f"{needed:g}, by its own header",
            hint="export it again from REW",
        )
    return samples


_SUBTYPES = ("PCM_16", "PCM_24", "PCM_32", "FLOAT", "DOUBLE")
# what the library notes where a file is shorter than its header says; it then reads what there is
_SHORT = re.compile(r"^ *(data|SSND|riff|Riff size) *: (\d+) \(should be (\d+)\)", re.MULTILINE)
_UNKNOWN_LENGTH = 0xFFFFFFFF


def read_sound(spec: ResponseSpec, content: bytes) -> Recording:
    """Return the channel of a WAV, FLAC, AIFF or Wave64 file that is asked for.

    Refused are encodings that lose what is needed.
    """
    findings: tuple[Finding, ...] = ()
    try:
        with quiet(), soundfile.SoundFile(io.BytesIO(content)) as file:
            if file.subtype not in _SUBTYPES:
                raise InputError(
                    "this encoding of a sound file is not read",
                    found=file.subtype,
                    needed="PCM of 16, 24 or 32 bits, or floating point",
                    hint="export it as WAV with 24 bits",
                )
            for _, declared, available in _SHORT.findall(file.extra_info):
                if int(declared) == _UNKNOWN_LENGTH:
                    findings = (_without_length(spec.path.name, int(available)),)
                elif int(declared) > int(available):
                    raise _cut_off(
                        f"{available} bytes of samples", f"{declared} bytes, by its own header"
                    )
            if 8 * file.frames * file.channels > unpacked_limit_bytes(len(content)):
                raise ValueError("more numbers than are read from one file, or one of its size")
            channel = pick("channel", spec.channel, file.channels, "channel")
            samples = file.read(dtype="float64", always_2d=True)
            if len(samples) < file.frames:
                raise _cut_off(f"{len(samples)} samples", f"{file.frames}, by its own header")
            return Recording(samples[:, channel].copy(), float(file.samplerate), 0.0, findings)
    except (soundfile.SoundFileError, RuntimeError, ValueError, OverflowError, MemoryError) as why:
        is_sound = content[:4] in (b"RIFF", b"RF64", b"fLaC", b"FORM", b"riff")
        start = f"a file of {len(content)} bytes that begins with {content[:12]!r}"
        raise InputError(
            f"this is not a {_FORMATS.get(spec.path.suffix.lower(), 'WAV')} file that can be read",
            found=str(why) if is_sound else start,
            needed="PCM or floating-point samples under a header of that format",
            hint="export it again, under a name that ends as its format demands",
        ) from why


_FORMATS = dict.fromkeys((".flac", ".aif", ".aiff", ".aifc", ".w64"), "FLAC, AIFF or Wave64")


def _without_length(name: str, n_bytes: int) -> Finding:
    text = (
        f"{name} was written as a stream: its header does not contain its length, so a cut end "
        "would not be noticed. Everything up to the end of the file was read."
    )
    return Finding(
        Code.WAV_LENGTH_UNKNOWN, About(files=[name]), text, {"bytes_of_samples": n_bytes}
    )


def _cut_off(found: str, needed: str) -> InputError:
    what = "the sound file is cut off"
    return InputError(what, found=found, needed=needed, hint="copy or export the file again")


def read_npy(spec: ResponseSpec, content: bytes) -> Recording:
    """Return the response of an NPY file: one array of real numbers, one response a column."""
    if spec.sampling_rate_hz is None:
        raise InputError(
            "the sampling rate of the NPY file is missing",
            found="no rate: an NPY file carries none",
            needed="a number in Hz beside the file",
            hint="add sampling_rate_hz = 48000, or what it was recorded at",
        )
    try:
        values = np.atleast_1d(npy_array(io.BytesIO(content), len(content)))
        if values.dtype.kind not in "fiu" or values.ndim > 2 or not values.size:
            raise ValueError(f"an array of {values.dtype} of shape {values.shape}")
    except ARCHIVE_DAMAGE as error:
        raise InputError(
            "this is not an NPY file that can be read",
            found=" ".join(str(error).split())[:200],
            needed="a file of numpy.save with real numbers, one response a column",
            hint="write it with numpy.save(file, samples), samples of floats",
        ) from error
    columns = _columns(values.astype(np.float64).reshape(len(values), -1))
    channel = pick("response", spec.channel, columns.shape[1], "channel")
    return Recording(columns[:, channel].copy(), spec.sampling_rate_hz)
