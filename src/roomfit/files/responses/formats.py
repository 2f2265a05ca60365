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

from roomfit.base.arguments import did_you_mean
from roomfit.base.door import decoded, limit, npy_array, quiet, unpacked_limit_bytes
from roomfit.base.errors import DAMAGE, InputError, located
from roomfit.base.findings import About, Code, Edit, Finding, Remedy
from roomfit.base.typing import FloatArray
from roomfit.files.responses.recordings import Recording, pick
from roomfit.files.schema import ResponseSpec
from roomfit.formats.hdf5 import Variables, mat_variables

_ITA = "ITA_TOOLBOX_AUDIO_OBJECT"
_REW_TITLE = "impulse response data saved by rew"
_REW_NEEDED = ("sample interval (seconds)", "response length", "start time (seconds)")
_REW_NUMBERS = (*_REW_NEEDED, "peak value before normalisation", "peak index")
_MOST_HEADER_LINES = 200
_NUMBER = re.compile(r"[-+]?(\d+([.,]\d*)?|[.,]\d+)([eE][-+]?\d+)?|[-+]?(?i:nan|inf)")
_SUBTYPES = ("PCM_16", "PCM_24", "PCM_32", "FLOAT", "DOUBLE")
# what the library notes where a file is shorter than its header says; it then reads what there is
_SHORT = re.compile(r"^ *(data|SSND|riff|Riff size) *: (\d+) \(should be (\d+)\)", re.MULTILINE)
_UNKNOWN_LENGTH = 0xFFFFFFFF


def read_mat(spec: ResponseSpec, content: bytes) -> Recording:
    """Return the column of a variable of a MAT file that is asked for."""
    variables = _variables(content)
    values = _array(variables, "variable", spec.variable)
    name = spec.sampling_rate_variable
    if name is None and spec.sampling_rate_hz is None:
        single = [n for n, v in variables.items() if not isinstance(v, str) and v.size == 1]
        raise InputError(
            "the sampling rate of the MAT file is missing",
            found="neither of the two",
            needed="sampling_rate_variable (a name) or sampling_rate_hz (a number)",
            hint=f"single numbers in the file: {', '.join(single) or 'none'}",
        )
    rate = None if name is None else _array(variables, "sampling_rate_variable", name)
    if rate is not None and rate.size != 1:
        what, found = "the MAT file has no such sampling rate", f"{name} {_kind(rate)}"
        hint = "give sampling_rate_hz instead, a number in Hz"
        raise InputError(what, found=found, needed="one number", hint=hint)
    rate_hz = spec.sampling_rate_hz if rate is None else float(rate.reshape(-1)[0])
    with located(spec.variable or ""):
        return _column(values, spec, float(rate_hz or 0.0), "response")


def _array(variables: Variables, key: str, name: str | None) -> FloatArray:
    """Return the variable of a MAT file that a key names."""
    values, listed = variables.get(name or ""), _listed(variables)
    if values is not None and not isinstance(values, str) and values.ndim > 1 and values.size:
        return values
    if values is not None:
        what = "the variable of the MAT file holds no array of real numbers"
        hint = "in MATLAB, save what lies in it as a variable of its own, one response a column"
        raise InputError(what, where=name, found=_kind(values), needed="numbers", hint=hint)
    what = "the MAT file has no such variable" if name else "which variable of the MAT file is it?"
    hint = did_you_mean(name or "", variables) or f"write {key} = a name, as the file has it"
    found = f"{key} = {name!r}" if name else f"no {key}"
    raise InputError(what, found=found, needed=f"one of {listed}", hint=hint)


def read_ita(spec: ResponseSpec, content: bytes) -> Recording:
    """Return the channel of an audio object of the ITA-Toolbox [1]_ that is asked for.

    The toolbox writes a structure with samples, their scale and their rate into a MAT file.

    References
    ----------
    .. [1] RWTH Aachen, ITA-Toolbox, ``itaSuper.saveobj`` and ``ita_write_ita`` (2011-2024).
    """
    variables = _variables(content)
    own: Variables = {k.removeprefix(f"{_ITA}."): v for k, v in variables.items() if _ITA in k}
    sizes = own.get("data"), own.get("samplingRate"), own.get("dataFactor", np.ones(1))
    numbers = [v for v in sizes if isinstance(v, np.ndarray)]
    if len(numbers) < len(sizes) or own.get("domain") != "text 'time'":
        raise InputError(
            "this is not an audio object of the ITA-Toolbox that can be read",
            found=_listed(own or variables)[:300],
            needed=f"a structure {_ITA} with data in the domain 'time' and one samplingRate",
            hint="in MATLAB: a = ita_read(FILE); RIR = a.timeData; Fs = a.samplingRate; "
            "save('a.mat', 'RIR', 'Fs', '-v7')",
        )
    data, rate, factor = numbers
    return _column(data * factor.reshape(-1)[0], spec, float(rate.reshape(-1)[0]), "channel")


def _variables(content: bytes) -> Variables:
    try:
        return mat_variables(content)
    except ValueError as error:
        what = "this is not a MAT file that can be read"
        needed, hint = "a MATLAB file of version 5 to 7.3", "in MATLAB: save(file, '-v7')"
        raise InputError(what, found=str(error), needed=needed, hint=hint) from error


def _column(values: FloatArray, spec: ResponseSpec, rate_hz: float, kind: str) -> Recording:
    """Return the response that is asked for of responses as columns; a single one may be a row."""
    if values.ndim > 2:
        what, found = f"the responses have {values.ndim} axes", str(values.shape)
        hint = "where time is the last: in NumPy a.reshape(-1, a.shape[-1]).T, the first axis "
        hint += "slowest; in MATLAB reshape(a, [], size(a, ndims(a))).', the first axis fastest"
        raise InputError(what, found=found, needed="two axes, one response a column", hint=hint)
    n_rows, n_columns = values.shape
    if n_columns > n_rows > 1:
        what, found = "the responses stand in rows", f"{n_rows} rows and {n_columns} columns"
        hint = "save the transposed array"
        raise InputError(what, found=found, needed="one response a column", hint=hint)
    columns = values.T if n_rows == 1 else values
    channel = pick(kind, spec.channel, columns.shape[1], "channel")
    return Recording(columns[:, channel].copy(), rate_hz)


def _listed(variables: Variables) -> str:
    return ", ".join(f"{name} {_kind(v)}" for name, v in variables.items()) or "nothing"


def _kind(values: FloatArray | str) -> str:
    return f"({values})" if isinstance(values, str) else str(values.shape)


def read_rew(spec: ResponseSpec, content: bytes) -> Recording:
    """Return the impulse response of a text file that REW wrote (File, Export, Impulse Response).

    The header gives the sampling rate and the time of the first sample on REW's own clock, mostly
    negative. REW's zero is the time of emission only where it measured with a loopback as timing
    reference; otherwise it lies at (or near) the peak, and `time_zero` must be "direct". A response
    that REW normalised is given its level back.
    """
    lines = decoded(content).split("\n")
    numbers, notes, n_header = _rew_header(lines, b"\0" in content)
    interval_s, length, start_s = (numbers[key] for key in _REW_NEEDED)
    while len(lines) > n_header and not lines[-1].strip():
        lines.pop()
    pressure = np.array([_number(text, n) for n, text in enumerate(lines[n_header:], n_header + 1)])
    what = ""
    if "ir is the min phase version" in notes:
        what = "a minimum-phase response has lost its arrival times"
        found, needed = '"IR is the min phase version" in its header', "the response as measured"
    elif not 1e-6 <= interval_s <= 1e-3:
        what, found = "the sample interval of the REW file is out of range", f"{interval_s:g} s"
        needed = "0.000001 to 0.001 s"
    elif len(pressure) != length:
        what = f"the REW file is {'cut off' if len(pressure) < length else 'too long'}"
        found, needed = f"{len(pressure)} samples", f"{length:g}, by its own header"
    if what:
        hint = "export the impulse response again from REW"
        raise InputError(what, found=found, needed=needed, hint=hint)
    whole = round(1.0 / interval_s)
    rate_hz = float(whole) if abs(1.0 - whole * interval_s) < 1e-6 else 1.0 / interval_s
    name, findings = spec.path.name, list[Finding]()
    about = About(files=[name])
    peak = abs(numbers.get("peak value before normalisation", 0.0))
    largest = float(np.abs(pressure).max(initial=0.0))
    if "ir is normalised" in notes and peak > 0.0 and largest > 0.0:
        pressure = pressure * (peak / largest)
    elif "ir is normalised" in notes:
        text = (
            f"{name} was normalised by REW and does not say what its peak was: its level "
            "means nothing beside that of other files."
        )
        advised = Remedy([Edit(("measurements", name), "level", "per-file")])
        findings.append(Finding(Code.LEVEL_UNKNOWN, about, text, remedies=[advised]))
    if "ir window has been applied" in notes:
        text = (
            f"{name} was exported with REW's window applied, which bends the late decay and "
            "hides the noise; export it without the window."
        )
        findings.append(Finding(Code.WINDOW_APPLIED, about, text))
    peak_s = int(np.argmax(np.abs(pressure))) / rate_hz + start_s
    if spec.time_zero == "emission" and abs(peak_s) <= 1.5 / rate_hz:
        text = (
            f"REW put the time zero of {name} at the peak, so it does not contain the "
            'time of emission; specify time_zero = "direct", or measure with a loopback as timing '
            "reference."
        )
        advised = Remedy([Edit(("measurements", name), "time_zero", "direct", now=["emission"])])
        evidence = {"peak_s": peak_s}
        findings.append(Finding(Code.TIME_ZERO_AT_PEAK, about, text, evidence, remedies=[advised]))
    return Recording(pressure, rate_hz, start_s, tuple(findings))


def _rew_header(lines: list[str], is_binary: bool) -> tuple[dict[str, float], str, int]:
    """Return the numbers above the samples by label, other lines, and how many lines these are.

    Labels and lines are in lower case. An older export does not announce its samples.
    """
    numbers: dict[str, float] = {}
    notes: list[str] = []
    first = next((line.strip() for line in lines if line.strip()), "")
    found = "a binary file" if is_binary else repr(first[:60])
    n_lines, most_letters = len(lines), limit("header_bytes")
    is_rew = not is_binary and first.lstrip("* ").lower().startswith(_REW_TITLE)
    for index, line in enumerate(lines[:_MOST_HEADER_LINES] if is_rew else ()):
        text = line.strip().lstrip("* ").lower()
        most_letters -= len(line)
        if most_letters < 0:
            is_rew, found = False, f"a header of more than {limit('header_bytes'):g} letters"
            break
        if text == "data start" or _NUMBER.fullmatch(line.strip()):
            n_lines = index + (text == "data start")
            break
        value, mark, label = text.partition("//")
        if mark and label.strip() in _REW_NUMBERS:
            numbers[label.strip()] = _number(value, index + 1)
        else:
            notes.append(text)
    missing = [label for label in _REW_NEEDED if label not in numbers]
    if missing:
        raise InputError(
            "the header of the REW file is not complete"
            if is_rew
            else "this is not an impulse response that REW exported as text",
            found=f"no line ... // {missing[0]}" if is_rew else found,
            needed='a first line "* Impulse Response data saved by REW", and all that follows it',
            hint="in REW: File, Export, Export impulse response as text",
        )
    return numbers, "\n".join(notes), n_lines


def _number(text: str, line: int) -> float:
    """Return a finite number; some settings of REW write a decimal comma."""
    try:
        value = float(text.strip().replace(",", "."))
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        what, found = "a number of the REW file is not one", repr(text.strip()[:40])
        hint = "export the response again from REW, as text"
        where = f"line {line}"
        raise InputError(what, where=where, found=found, needed="a finite number", hint=hint)
    return value


def read_sound(spec: ResponseSpec, content: bytes) -> Recording:
    """Return the channel of a WAV, FLAC, AIFF or Wave64 file that is asked for.

    Refused are encodings that lose what is needed.
    """
    name, findings = spec.path.name, list[Finding]()
    if content.startswith(b"BW64"):  # of ITU-R BS.2088: RF64 but for its name
        content = (b"RF64" if content[12:16] == b"ds64" else b"RIFF") + content[4:]
    try:
        with quiet(), soundfile.SoundFile(io.BytesIO(content)) as file:
            if file.subtype not in _SUBTYPES:
                what, hint = "this encoding of a sound file is not read", "export it as 24-bit WAV"
                needed = "PCM of 16, 24 or 32 bits, or floating point"
                raise InputError(what, found=file.subtype, needed=needed, hint=hint)
            declared, available, unit = file.frames, file.frames, "samples"
            for _, stated, there in _SHORT.findall(file.extra_info):
                if int(stated) == _UNKNOWN_LENGTH:
                    text = (
                        f"{name} was written as a stream: its header does not contain its length, "
                        "so a cut end would not be noticed. Everything up to the end of the file "
                        "was read."
                    )
                    evidence = {"bytes_of_samples": int(there)}
                    code, about = Code.WAV_LENGTH_UNKNOWN, About(files=[name])
                    findings = [Finding(code, about, text, evidence)]
                elif int(stated) > int(there):
                    declared, available, unit = int(stated), int(there), "bytes of samples"
            if 8 * file.frames * file.channels > unpacked_limit_bytes(len(content)):
                raise ValueError("more numbers than are read from one file, or one of its size")
            samples = file.read(dtype="float64", always_2d=True)
            if unit == "samples":
                available = len(samples)
            if available < declared:
                what, hint = "the sound file is cut off", "copy or export the file again"
                found, needed = f"{available} {unit}", f"{declared}, by its own header"
                raise InputError(what, found=found, needed=needed, hint=hint)
            rate_hz = float(file.samplerate)
            channel = pick("channel", spec.channel, file.channels, "channel")
            return Recording(samples[:, channel].copy(), rate_hz, 0.0, tuple(findings))
    except (soundfile.SoundFileError, RuntimeError, ValueError, OverflowError, MemoryError) as why:
        kind = "WAV" if spec.path.suffix.lower().startswith(".wav") else "FLAC, AIFF or Wave64"
        raise InputError(
            f"this is not a {kind} file that can be read",
            found=f"a file of {len(content)} bytes that begins with {content[:12]!r}",
            needed="PCM or floating-point samples under a header of that format",
            hint="export it again, under a name that ends as its format demands",
        ) from why


def read_npy(spec: ResponseSpec, content: bytes) -> Recording:
    """Return the response of an NPY file: one array of real numbers, one response a column."""
    if spec.sampling_rate_hz is None:
        what, found = "the sampling rate of the NPY file is missing", "a file that carries none"
        hint = "add sampling_rate_hz = 48000, or what it was recorded at"
        raise InputError(what, found=found, needed="a number in Hz beside the file", hint=hint)
    try:
        values = np.atleast_1d(npy_array(io.BytesIO(content), len(content)))
        if values.dtype.kind not in "fiu" or not values.size:
            raise ValueError(f"an array of {values.dtype} of shape {values.shape}")
    except DAMAGE as error:
        raise InputError(
            "this is not an NPY file that can be read",
            found=" ".join(str(error).split())[:200],
            needed="a file of numpy.save with real numbers, one response a column",
            hint="save floats as (n_samples, n_responses), and say with channel which is whose",
        ) from error
    columns = values.astype(np.float64)
    columns = columns[:, None] if columns.ndim == 1 else columns
    return _column(columns, spec, spec.sampling_rate_hz, "response")
