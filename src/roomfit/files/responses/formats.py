"""Responses in MATLAB files, text exported by Room EQ Wizard (REW), WAV and other sound files.

MATLAB files of versions 5 to 7.2 [1]_ have an own reader, since scipy's ends the whole process on
some damaged files (a segmentation fault within seconds of fuzzing, scipy 1.17), which no caller can
turn into a message. It reads full arrays of real numbers, those of a structure too, and ignores
everything else. Version 7.3 is HDF5. Audio objects of the ITA-Toolbox are such structures.

A sound file that was cut off in copying opens without complaint in every reader, and the missing
end looks like a room with less reverberation. So the lengths in the header are checked here.

References
----------
.. [1] The MathWorks, "MAT-File Format", R2023b, chapter 1: level 5 MAT-files.
"""

from __future__ import annotations

import io
import math
import re
import struct
import zlib
from collections.abc import Iterator, Mapping
from itertools import islice

import numpy as np
import soundfile

from roomfit.base.arguments import ARCHIVE_DAMAGE, did_you_mean
from roomfit.base.errors import InputError, located
from roomfit.base.findings import About, Code, Finding
from roomfit.base.typing import FloatArray
from roomfit.files.door import decoded, limit, npy_array, quiet, unpacked_limit_bytes
from roomfit.files.responses.hdf5 import is_mat73, mat73_arrays
from roomfit.files.responses.recordings import Recording, ResponseSpec, pick

Variables = Mapping[str, FloatArray | str]  # what it is instead, where it is no real numbers


def read_mat(spec: ResponseSpec, content: bytes) -> Recording:
    """Return the column of a variable of a MAT file that is asked for.

    Raises
    ------
    InputError
        Not a MAT file, version 4, no such variable or column, or no sampling rate.
    """
    variables = _variables(content)
    responses = _responses(variables, spec)
    channel = pick("response", spec.channel, responses.shape[1], "channel")
    return Recording(responses[:, channel].copy(), _sampling_rate_hz(variables, spec))


_ITA = "ITA_TOOLBOX_AUDIO_OBJECT"


def read_ita(spec: ResponseSpec, content: bytes) -> Recording:
    """Return the channel of an audio object of the ITA-Toolbox [1]_ that is asked for.

    The toolbox writes a structure with samples, their scale and their rate into a MAT file.

    Raises
    ------
    InputError
        Not such a file, several objects, a spectrum, or no such channel.

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
        if is_mat73(content):
            return mat73_arrays(content)
        return mat5_arrays(content)
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


_HEADER_BYTES = 128
_MAT5_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8"}
_MAT5_NUMBERS[13] = "u8"
_INT32, _UINT32, _INT8, _MATRIX, _COMPRESSED = 5, 6, 1, 14, 15
_NUMERIC_CLASSES = range(6, 16)  # double, single and the integers
_KINDS = {1: "a cell array", 2: "a structure", 3: "an object", 5: "a sparse array"}
_STRUCTURE, _TEXT, _OPAQUE = 2, 4, 17
_TEXTS = {1: "latin-1", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16"}
_MOST_LETTERS, _MOST_FIELDS = 40, 10_000
_COMPLEX_FLAG = 0x800
_TOO_MUCH = "more numbers than are read from one file, or from one of its size"


def mat5_arrays(content: bytes) -> dict[str, FloatArray | str]:
    """Return every variable of a MAT file of level 5 by name.

    Float64 arrays of the shape they have in the file; what it is instead for text, arrays of
    structures, cells, objects, sparse and complex arrays. The fields of a single structure are
    named STRUCTURE.FIELD.

    Raises
    ------
    ValueError
        The bytes are not such a file, or are damaged; says where.
    """
    order = {b"IM": "<", b"MI": ">"}.get(content[126:_HEADER_BYTES])
    if order is None:
        raise ValueError("no header of a MAT file of version 5 to 7.2")
    variables: dict[str, FloatArray | str] = {}
    left_bytes = int(unpacked_limit_bytes(len(content)))
    for kind, data in _elements(content[_HEADER_BYTES:], order):
        if kind == _COMPRESSED:
            data = _decompressed(data, left_bytes)
            kind, data = next(_elements(data, order), (kind, data))
        if kind == _MATRIX:
            for name, array in _named(data, order, left_bytes):
                variables[name] = array
                left_bytes -= _MOST_LETTERS if isinstance(array, str) else array.nbytes
    # what objects refer to has no name
    return {name: array for name, array in variables.items() if name}


def _elements(data: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Yield kind and data of the elements in their order."""
    position = 0
    while position + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, position)
        if kind >> 16:  # a small element: size, kind and up to four bytes of data in eight
            kind, size, start, following = kind & 0xFFFF, kind >> 16, position + 4, position + 8
        else:
            start = position + 8
            following = start + size
            if kind != _COMPRESSED:
                following += -size % 8
        if start + size > len(data) or (following == position + 8 and size > 4):
            raise ValueError(
                f"an element of {size} bytes where {max(0, len(data) - start)} are left"
            )
        yield kind, data[start : start + size]
        position = following


def _decompressed(data: bytes, most_bytes: int) -> bytes:
    unpacker = zlib.decompressobj()
    try:
        unpacked = unpacker.decompress(data, max(most_bytes, 1))
    except zlib.error as error:
        raise ValueError(f"damaged compression: {error}") from error
    if unpacker.unconsumed_tail:
        raise ValueError(_TOO_MUCH)
    if not unpacker.eof:
        raise ValueError("compressed data that does not end")
    return unpacked


def _named(
    data: bytes, order: str, most_bytes: int, *, whole: bool = False
) -> Iterator[tuple[str, FloatArray | str]]:
    """Yield name and values of one array, or of the fields of one structure.

    A structure within a structure comes as a `whole`, which is none of these.
    """
    parts = _elements(data, order)
    head = list(islice(parts, 3))
    if len(head) < 3:
        raise ValueError("an array without flags, size or name")
    (flags_kind, flags), (shape_kind, shape), (_, name) = head
    if flags_kind != _UINT32 or len(flags) < 4:
        raise ValueError("an array with foreign flags")
    (word,) = struct.unpack_from(f"{order}I", flags)
    if word & 0xFF == _OPAQUE:  # without a size, and its class follows
        of_class = next(parts, (0, b""))[1][:_MOST_LETTERS].decode("latin-1")
        yield shape.decode("utf-8", errors="replace"), f"an object of class {of_class}"
        return
    if shape_kind != _INT32:
        raise ValueError("an array with a foreign size")
    text = name.decode("utf-8", errors="replace")
    lengths = np.frombuffer(shape, f"{order}i4").tolist()
    if word & 0xFF != _STRUCTURE or whole or lengths != [1, 1]:
        yield text, _values(word, lengths, text, next(parts, (0, b"")), order, most_bytes)
        return
    (_, length), (_, names) = next(parts, (0, b"")), next(parts, (0, b""))
    each = int.from_bytes(length, "little" if order == "<" else "big")
    if not len(names) <= _MOST_FIELDS * each:
        raise ValueError(f"structure {text!r} of {len(names)} letters and {each} a field")
    for start, (_, content) in zip(range(0, len(names), max(each, 1)), parts, strict=False):
        field = names[start : start + each].split(b"\0")[0].decode("utf-8", errors="replace")
        for _, values in _named(content, order, most_bytes, whole=True) if content else ():
            yield f"{text}.{field}", values
            most_bytes -= _MOST_LETTERS if isinstance(values, str) else values.nbytes


def _values(
    word: int,
    lengths: list[int],
    text: str,
    content: tuple[int, bytes],
    order: str,
    most_bytes: int,
) -> FloatArray | str:
    """Return the numbers of one array, or what it is instead."""
    kind, values = content
    if word & 0xFF == _TEXT and kind in _TEXTS:
        code = _TEXTS[kind] + (("-le" if order == "<" else "-be") if kind in (4, 17) else "")
        letters = values[: 2 * _MOST_LETTERS].decode(code, errors="replace")
        return f"text {letters[:_MOST_LETTERS]!r}"
    if word & 0xFF not in _NUMERIC_CLASSES:
        return _KINDS.get(word & 0xFF, "of a class of its own")
    if word & _COMPLEX_FLAG:
        return "complex numbers"
    if kind not in _MAT5_NUMBERS:
        raise ValueError(f"array {text!r} without numbers")
    packed = np.frombuffer(values, order + _MAT5_NUMBERS[kind])
    if 8 * packed.size > most_bytes:
        raise ValueError(_TOO_MUCH)
    numbers = packed.astype(np.float64)
    if min(lengths, default=-1) < 0 or math.prod(lengths) != numbers.size:
        raise ValueError(f"array {text!r} of {numbers.size} numbers with the size {lengths}")
    return numbers.reshape(lengths, order="F")


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

    Parameters
    ----------
    spec : ResponseSpec
        Its `time_zero` is compared with the file.
    content : bytes

    Raises
    ------
    InputError
        Not such a file, cut off, a number that is none, or a minimum-phase version, which has lost
        all arrival times.
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
_UNKNOWN_LENGTHS = (0, 0xFFFFFFFF)
_WAVE64 = bytes.fromhex("726966662e91cf11a5d628db04c10000")  # the GUID that such a file begins with
_SOUNDS = "FLAC, AIFF or Wave64"


def read_wav(spec: ResponseSpec, content: bytes) -> Recording:
    """Return the channel of a WAV file that is asked for.

    Raises
    ------
    InputError
        Not a WAV file, cut off, an encoding that loses what is needed, or no such channel.
    """
    start, declared = _data_chunk(content)
    available = len(content) - start
    findings: tuple[Finding, ...] = ()
    if declared in _UNKNOWN_LENGTHS and available > 0:
        text = (
            f"{spec.path.name} was written as a stream: its header does not contain its length, so "
            "a cut end would not be noticed. Everything up to the end of the file was read."
        )
        findings = (
            Finding(
                Code.WAV_LENGTH_UNKNOWN,
                About(files=[spec.path.name]),
                text,
                {"bytes_of_samples": available},
            ),
        )
        patched = bytearray(content)
        struct.pack_into("<I", patched, 4, min(len(content) - 8, 0xFFFFFFFF))
        struct.pack_into("<I", patched, start - 4, min(available, 0xFFFFFFFF))
        content = bytes(patched)
    elif declared > available:
        raise _cut_off(f"{available} bytes of samples", f"{declared} bytes, by its own header")
    samples, rate_hz = _decoded(spec, content, "WAV")
    return Recording(samples, rate_hz, 0.0, findings)


def read_sound(spec: ResponseSpec, content: bytes) -> Recording:
    """Return the channel of a FLAC, AIFF or Wave64 file that is asked for.

    Raises
    ------
    InputError
        Not such a file, cut off, an encoding that loses what is needed, or no such channel.
    """
    declared = len(content)
    if content[:4] == b"FORM" and content[8:12] in (b"AIFF", b"AIFC") and len(content) >= 12:
        declared = 8 + int(struct.unpack_from(">I", content, 4)[0])
    elif content[:16] == _WAVE64 and len(content) >= 24:
        declared = int(struct.unpack_from("<Q", content, 16)[0])
    elif content[:4] != b"fLaC":
        raise _not_readable(
            _SOUNDS, f"a file of {len(content)} bytes that begins with {content[:12]!r}"
        )
    if declared > len(content):
        raise _cut_off(f"{len(content)} bytes", f"{declared} bytes, by its own header")
    return Recording(*_decoded(spec, content, _SOUNDS))


def _decoded(spec: ResponseSpec, content: bytes, kind: str) -> tuple[FloatArray, float]:
    """Return the samples of the channel that is asked for, and their rate in Hz."""
    try:
        with quiet(), soundfile.SoundFile(io.BytesIO(content)) as file:
            if file.subtype not in _SUBTYPES:
                raise InputError(
                    "this encoding of a sound file is not read",
                    found=file.subtype,
                    needed="PCM of 16, 24 or 32 bits, or floating point",
                    hint="export it as WAV with 24 bits",
                )
            channel = pick("channel", spec.channel, file.channels, "channel")
            if 8 * file.frames * file.channels > unpacked_limit_bytes(len(content)):
                raise ValueError(_TOO_MUCH)
            samples = file.read(dtype="float64", always_2d=True)
            if len(samples) < file.frames:
                raise _cut_off(f"{len(samples)} samples", f"{file.frames}, by its own header")
            return samples[:, channel].copy(), float(file.samplerate)
    except (
        soundfile.SoundFileError,
        RuntimeError,
        ValueError,
        OverflowError,
        MemoryError,
    ) as error:
        raise _not_readable(kind, str(error)) from error


def read_npy(spec: ResponseSpec, content: bytes) -> Recording:
    """Return the response of an NPY file: one array of real numbers, one response a column.

    Raises
    ------
    InputError
        Not such a file, cut off, another kind of array, no such column, or no sampling rate.
    """
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


def _data_chunk(content: bytes) -> tuple[int, int]:
    """Return where the samples begin, and how many bytes of them the header declares."""
    form = content[:4]
    if form not in (b"RIFF", b"RF64", b"BW64") or content[8:12] != b"WAVE":
        raise _not_readable(
            "WAV", f"a file of {len(content)} bytes that begins with {content[:12]!r}"
        )
    position, long_size, format_found = 12, None, False
    while position + 8 <= len(content):
        name, size = struct.unpack_from("<4sI", content, position)
        if name == b"ds64" and position + 24 <= len(content):
            long_size = struct.unpack_from("<Q", content, position + 16)[0]
        format_found = format_found or name == b"fmt "
        if name == b"data":
            if not format_found:
                raise _not_readable("WAV", "samples without a format before them")
            if form != b"RIFF" and size == 0xFFFFFFFF and long_size is not None:
                size = long_size
            return position + 8, size
        position += 8 + size + size % 2  # chunks are padded to even lengths
    raise InputError(
        "the WAV file holds no samples",
        found=f"{len(content)} bytes without a data chunk",
        needed='a chunk "data" with the samples',
        hint="the file may be cut off: copy or export it again",
    )


def _cut_off(found: str, needed: str) -> InputError:
    what = "the sound file is cut off"
    return InputError(what, found=found, needed=needed, hint="copy or export the file again")


def _not_readable(kind: str, found: str) -> InputError:
    return InputError(
        f"this is not a {kind} file that can be read",
        found=found,
        needed="PCM or floating-point samples under a header of that format",
        hint="export it again, under a name that ends as its format demands",
    )
