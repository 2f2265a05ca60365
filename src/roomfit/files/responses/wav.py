"""WAV files: PCM of 16, 24, 32 bits and floating point, with the header held against the file.

A file that was cut off in copying opens without complaint in every reader, and the missing end
looks like a room with less reverberation. So the lengths in the header are checked here.
"""

from __future__ import annotations

import io
import struct
from dataclasses import dataclass
from pathlib import Path

import soundfile

from roomfit.errors import InputError
from roomfit.files.responses.recording import Recording, pick
from roomfit.files.responses.spec import ResponseSpec
from roomfit.findings import Finding

_SUBTYPES = ("PCM_16", "PCM_24", "PCM_32", "FLOAT", "DOUBLE")
_UNKNOWN_LENGTHS = (0, 0xFFFFFFFF)


@dataclass(frozen=True, slots=True)
class _DataChunk:
    """Where the samples lie and how long the header says that they are."""

    size_offset: int
    start: int
    declared: int


def read_wav(spec: ResponseSpec, content: bytes) -> Recording:
    """Return one channel of a WAV file.

    Parameters
    ----------
    spec : ResponseSpec
        Names the file in messages and chooses the channel.
    content : bytes
        The whole file.

    Raises
    ------
    InputError
        Not a WAV file, cut off, an encoding that loses what is needed, or no such channel.
    """
    chunk = _data_chunk(content, str(spec.path))
    available = len(content) - chunk.start
    findings: tuple[Finding, ...] = ()
    if chunk.declared in _UNKNOWN_LENGTHS and available > 0:
        findings = (_streamed(spec.path, available),)
        content = _with_lengths(content, chunk, available)
    elif chunk.declared > available:
        raise InputError(
            "the WAV file is cut off",
            where=str(spec.path),
            found=f"{available} bytes of samples",
            needed=f"{chunk.declared} bytes, by its own header",
            hint="copy or export the file again",
        )
    try:
        with soundfile.SoundFile(io.BytesIO(content)) as file:
            if file.subtype not in _SUBTYPES:
                raise InputError(
                    "this encoding of a WAV file is not read",
                    where=str(spec.path),
                    found=file.subtype,
                    needed="PCM of 16, 24 or 32 bits, or floating point",
                )
            channel = pick("channel", spec.channel, file.channels, "channel", str(spec.path))
            samples = file.read(dtype="float64", always_2d=True)
            return Recording(samples[:, channel].copy(), float(file.samplerate), 0.0, findings)
    except (
        soundfile.SoundFileError,
        RuntimeError,
        ValueError,
        OverflowError,
        MemoryError,
    ) as error:
        raise _not_wav(str(spec.path), str(error)) from error


def _data_chunk(content: bytes, where: str) -> _DataChunk:
    """Walk the chunks of the file to its samples."""
    form = content[:4]
    if form not in (b"RIFF", b"RF64", b"BW64") or content[8:12] != b"WAVE":
        raise _not_wav(where, f"a file of {len(content)} bytes that begins with {content[:12]!r}")
    position, long_size, format_seen = 12, None, False
    while position + 8 <= len(content):
        name, size = struct.unpack_from("<4sI", content, position)
        if name == b"ds64" and position + 24 <= len(content):
            long_size = struct.unpack_from("<Q", content, position + 16)[0]
        format_seen = format_seen or name == b"fmt "
        if name == b"data":
            if not format_seen:
                raise _not_wav(where, "samples without a format before them")
            if form != b"RIFF" and size == 0xFFFFFFFF and long_size is not None:
                size = long_size
            return _DataChunk(position + 4, position + 8, size)
        position += 8 + size + size % 2  # chunks are padded to even lengths
    raise InputError(
        "the WAV file holds no samples",
        where=where,
        found=f"{len(content)} bytes without a data chunk",
        hint="the file may be cut off: copy or export it again",
    )


def _with_lengths(content: bytes, chunk: _DataChunk, available: int) -> bytes:
    """Return the file with the lengths that a streaming writer left open filled in."""
    patched = bytearray(content)
    struct.pack_into("<I", patched, 4, min(len(content) - 8, 0xFFFFFFFF))
    struct.pack_into("<I", patched, chunk.size_offset, min(available, 0xFFFFFFFF))
    return bytes(patched)


def _streamed(path: Path, available: int) -> Finding:
    return Finding(
        "wav-length-unknown",
        "warning",
        f"{path.name} was written as a stream: its header does not tell its length, so a cut end "
        "would not be noticed. Everything up to the end of the file was read.",
        {"bytes_of_samples": available},
    )


def _not_wav(where: str, found: str) -> InputError:
    return InputError(
        "this is not a WAV file that can be read",
        where=where,
        found=found,
        needed="RIFF WAVE with PCM or floating-point samples",
    )
