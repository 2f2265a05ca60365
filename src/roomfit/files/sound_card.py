"""Playing and recording at once, by the package sounddevice."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from roomfit.base.errors import InputError
from roomfit.base.typing import FloatArray


def sounddevice() -> Any:
    """Return the module sounddevice, which loads PortAudio; wheels for Linux do not bring it."""
    try:
        return importlib.import_module("sounddevice")
    except (ModuleNotFoundError, OSError) as error:
        package = isinstance(error, ModuleNotFoundError)
        get = "pip install 'roomfit[measure]'" if package else "apt install libportaudio2"
        raise InputError(
            f"measuring needs a {'package' if package else 'library'} that is not installed",
            found=str(error),
            needed="the extra measure" if package else "PortAudio",
            hint=f"{get} (or what your system has), or measure in the browser: roomfit app",
        ) from error


@dataclass(frozen=True, slots=True)
class SoundCard:
    """One channel out and one in; called, it plays and returns what it recorded meanwhile."""

    backend: Any  # the module sounddevice
    device: str | int | None = None  # to record with; a number, or part of a name
    output: str | int | None = None  # to play with; None: `device`, or the default of the system

    def __call__(self, played: FloatArray, rate_hz: float) -> tuple[FloatArray, tuple[str, ...]]:
        """Return the recording, shape (n_samples,), full scale 1, and faults that were reported."""
        both = (self.device, self.device if self.output is None else self.output)
        how: dict[str, Any] = {"samplerate": rate_hz, "channels": 1, "dtype": "float32"}
        try:
            samples = played.astype(np.float32)[:, None]
            recorded = self.backend.playrec(samples, device=both, blocking=True, **how)
            status = self.backend.get_status()
        except (self.backend.PortAudioError, ValueError) as error:
            raise InputError(
                "the sound device cannot be used",
                where=", ".join("default" if one is None else str(one) for one in both),
                found=str(error),
                needed=f"a device that plays and records at {rate_hz:g} Hz",
                hint="roomfit measure --list names them; --rate sets another sampling rate",
            ) from error
        faults = (f"the sound device reports {status}: close other programs",) if status else ()
        return np.asarray(recorded, dtype=np.float64).reshape(-1), faults
