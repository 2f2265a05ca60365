"""Reading measured impulse responses: the ending of the name selects the reader."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from roomfit.base.arguments import check_range
from roomfit.base.door import read_bytes
from roomfit.base.errors import InputError, located
from roomfit.base.findings import Finding
from roomfit.files.responses.formats import read_ita, read_mat, read_npy, read_rew, read_sound
from roomfit.files.responses.recordings import Recording, checked, deconvolved
from roomfit.files.responses.sofa import read_sofa
from roomfit.files.schema import ResponseSpec
from roomfit.signals.response import ImpulseResponse

SOUND_SUFFIXES = (".wav", ".wave", ".flac", ".aif", ".aiff", ".aifc", ".w64")
# By ending: the reader, and the keys that choose a part of the file.
_READERS = {
    **dict.fromkeys(SOUND_SUFFIXES, (read_sound, ("channel",))),
    ".ita": (read_ita, ("channel",)),
    ".mat": (read_mat, ("channel", "variable", "sampling_rate_variable")),
    ".npy": (read_npy, ("channel",)),
    ".sofa": (read_sofa, ("measurement", "receiver_index", "emitter_index")),
    ".txt": (read_rew, ()),
}
RESPONSE_SUFFIXES = tuple(_READERS)
_CHOICES = (
    *("channel", "variable", "sampling_rate_variable"),
    *("measurement", "receiver_index", "emitter_index"),
)


def read_response(spec: ResponseSpec) -> tuple[ImpulseResponse, tuple[Finding, ...]]:
    """Return one impulse response, checked, with what is doubtful about it.

    Where `spec.time_zero` is "emission", sample 0 lies `spec.latency_s` before emission. Where it
    is "direct" or "unknown" the file does not contain the time of emission: the same is assumed,
    and `roomfit.signals.response.time_zero_from_direct` corrects it by the geometry.

    Where `spec.excitation` is given, the file is a recording and is deconvolved first.

    Raises
    ------
    InputError
        The file is missing, of an unknown kind, not what its name says, cut off, silent, too short,
        not finite; a choice is missing or does not exist; a key does not belong to this kind.
    StoreError
        The disk refuses to read the file.

    Examples
    --------
    >>> import tempfile
    >>> import soundfile
    >>> decay = np.exp(-np.arange(4800) / 480.0) * np.cos(np.arange(4800))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "S1_R1.wav"
    ...     soundfile.write(file, decay, 48000, subtype="DOUBLE")
    ...     response, findings = read_response(ResponseSpec(file))
    >>> response.sampling_rate_hz, bool(np.all(response.pressure == decay)), findings
    (48000.0, True, ())
    """
    path = Path(spec.path)
    kind = path.suffix.lower()
    if kind not in _READERS:
        what, hint = "unknown kind of response file", "export the response as WAV, 32-bit float"
        needed = f"a name that ends in one of {', '.join(_READERS)} (REW)"
        found = f"ending {path.suffix!r}"
        raise InputError(what, where=str(path), found=found, needed=needed, hint=hint)
    read, keys = _READERS[kind]
    with located(str(path)):
        _refuse_foreign_keys(spec, kind, keys)
    most = "text_bytes" if kind == ".txt" else "file_bytes"
    content = read_bytes(path, "response file", most=most)
    with located(str(path)):
        recording = read(spec, content)
        _check_clock(recording, spec)
    if spec.excitation is not None:
        is_recording = "channel" in keys
        recording = deconvolved(recording, _excitation(spec, is_recording), path, spec.excitation)
    with located(str(path)):
        pressure, findings = checked(recording, path.name)
    time_zero_s = spec.latency_s - recording.delay_s
    return ImpulseResponse(pressure, recording.sampling_rate_hz, time_zero_s), findings


def _excitation(spec: ResponseSpec, is_recording: bool) -> Recording:
    path = Path(spec.excitation or "")
    if not is_recording or path.suffix.lower() not in SOUND_SUFFIXES:
        what, where = "an excitation goes with a recording", str(spec.path)
        found = f"{spec.path.name} with the excitation {path.name}"
        needed = "a recording as sound file, MAT, ITA or NPY, and an excitation as sound file"
        hint = "leave excitation out where the file is a response already"
        raise InputError(what, where=where, found=found, needed=needed, hint=hint)
    content = read_bytes(path, "response file")
    with located(str(path)):
        return read_sound(ResponseSpec(path, channel=spec.excitation_channel), content)


def _refuse_foreign_keys(spec: ResponseSpec, kind: str, keys: tuple[str, ...]) -> None:
    """A key that this kind of file cannot obey would be silently lost."""
    if spec.excitation is None and spec.excitation_channel is not None:
        what = "a channel of an excitation without the excitation"
        found, needed = "excitation_channel alone", "excitation = a WAV file"
        hint = "name the sweep as it was played, or leave the channel out"
        raise InputError(what, found=found, needed=needed, hint=hint)
    for key in _CHOICES:
        if getattr(spec, key) is not None and key not in keys:
            what, found = "a key does not belong to this kind of file", f"{key} for a {kind} file"
            needed = f"only {', '.join(keys) or 'the path'}"
            hint = "leave it out, or rename the file"
            raise InputError(what, found=found, needed=needed, hint=hint)


def _check_clock(recording: Recording, spec: ResponseSpec) -> None:
    rate_hz = recording.sampling_rate_hz
    check_range("the sampling rate", rate_hz, 1000.0, 1e6, "Hz")
    if spec.sampling_rate_hz is not None and abs(spec.sampling_rate_hz / rate_hz - 1.0) > 1e-6:
        found = f"{rate_hz:g} Hz in the file, sampling_rate_hz = {spec.sampling_rate_hz:g}"
        what, needed = "two sampling rates for one file", "the same, or no sampling_rate_hz"
        hint = "leave sampling_rate_hz out: it is for files that carry none"
        raise InputError(what, found=found, needed=needed, hint=hint)
    if not np.isfinite(recording.delay_s):
        what, found = "the delay of the response is not finite", f"{recording.delay_s:g} s"
        raise InputError(what, found=found, needed="seconds", hint="export the response again")
