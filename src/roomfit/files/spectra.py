"""Damped spectra of one pair from a NumPy archive."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from roomfit.checks import float_array, read_only
from roomfit.errors import InputError, StoreError
from roomfit.impedance.observed import first_fall
from roomfit.typing import ComplexArray, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class DampedSpectrum:
    """What a file ``spectrum = "pair.npz"`` holds.

    Attributes
    ----------
    frequency_hz : float array, shape (n_frequencies,)
    tau_s : float
        Time constant of the exponential window.
    pressure : complex array, shape (n_frequencies,)
    noise : float array, shape (n_frequencies,), or None
        rms, in the unit of the pressure.
    has_phase : bool
        False where the file holds levels.
    """

    frequency_hz: FloatArray
    tau_s: float
    pressure: ComplexArray
    noise: FloatArray | None
    has_phase: bool


def read_spectrum(path: Path) -> DampedSpectrum:
    """Return the damped spectrum of a pair.

    The archive holds ``f`` (Hz, rising), ``tau`` (s), ``p`` (complex, ``exp(+j w t)``) and perhaps
    ``noise`` (rms, one number or one a frequency). Where only levels were measured, ``magnitude``
    (``|p|``, not in decibels) stands in place of ``p``.

    Raises
    ------
    InputError
        No such file, no NumPy archive, arrays missing, of unlike shape, out of order or not finite.
    StoreError
        The disk refuses.
    """
    path = Path(path)
    arrays = _arrays(path)
    where = str(path)
    if ("p" in arrays) == ("magnitude" in arrays):
        raise InputError(
            "a spectrum needs pressures or magnitudes",
            where=where,
            found=", ".join(sorted(arrays)) or "nothing",
            needed="p (complex), or magnitude",
        )
    for name in ("f", "tau"):
        if name not in arrays:
            raise InputError(
                "a spectrum lacks an array",
                where=where,
                found=", ".join(sorted(arrays)),
                needed={"f": "f (Hz)", "tau": "tau (s), the window's time constant"}[name],
            )
    f = float_array(f"f of {path.name}", arrays["f"], (None,), low=1.0, high=1e5, unit="Hz")
    if len(f) == 0 or (np.diff(f) <= 0.0).any():
        raise InputError(
            "frequencies are out of order",
            where=where,
            found=first_fall(f) if len(f) else "none of them",
            needed="each above the one before, at least one",
        )
    if np.size(arrays["tau"]) != 1:
        raise InputError("tau is not one number", where=where, found=f"{np.shape(arrays['tau'])}")
    tau = float_array("tau", np.reshape(arrays["tau"], ()), (), low=1e-4, high=10.0, unit="s")
    return DampedSpectrum(
        f,
        float(tau),
        _pressure(arrays, len(f), where),
        _noise(arrays, len(f), where),
        "p" in arrays,
    )


def _arrays(path: Path) -> dict[str, Any]:
    try:
        with np.load(path, allow_pickle=False) as file:
            if not isinstance(file, np.lib.npyio.NpzFile):
                raise ValueError("a single array")
            return {name: file[name] for name in file.files}
    except FileNotFoundError:
        raise InputError(
            "the spectrum does not exist",
            where=str(path),
            hint="paths in a campaign are relative to the campaign file",
        ) from None
    except (ValueError, EOFError, zipfile.BadZipFile, KeyError) as error:
        raise InputError(
            "the spectrum is not a NumPy archive of arrays",
            where=str(path),
            found=str(error),
            needed="a file of numpy.savez with f, tau and p",
        ) from error
    except OSError as error:
        raise StoreError(
            "the spectrum cannot be read", where=str(path), found=str(error)
        ) from error


def _pressure(arrays: dict[str, Any], n: int, where: str) -> ComplexArray:
    name = "p" if "p" in arrays else "magnitude"
    values = np.asarray(arrays[name])
    if not np.issubdtype(values.dtype, np.number):
        raise InputError(f"{name} holds no numbers", where=where, found=str(values.dtype))
    if name == "p" and not np.issubdtype(values.dtype, np.complexfloating):
        raise InputError(
            "pressures without phase",
            where=where,
            found=f"p of type {values.dtype}",
            needed="complex numbers, or magnitude in place of p",
        )
    if values.shape != (n,):
        raise InputError(
            f"{name} and f disagree",
            where=where,
            found=f"{name} of shape {values.shape}, f of shape ({n},)",
            needed="one number a frequency",
        )
    if not np.isfinite(values).all():
        at = int(np.flatnonzero(~np.isfinite(values))[0])
        raise InputError(
            f"{name} is not finite everywhere", where=where, found=f"{values[at]} at index {at}"
        )
    if not values.any():
        raise InputError(
            f"{name} is 0 everywhere", where=where, needed="what was measured, not silence"
        )
    return read_only(np.array(values, dtype=np.complex128))


def _noise(arrays: dict[str, Any], n: int, where: str) -> FloatArray | None:
    if "noise" not in arrays:
        return None
    noise = np.asarray(arrays["noise"], dtype=np.float64)
    if noise.shape not in ((), (n,)):
        raise InputError(
            "noise and f disagree",
            where=where,
            found=f"noise of shape {noise.shape}, f of shape ({n},)",
            needed="one number, or one a frequency",
        )
    return float_array("noise (rms)", np.broadcast_to(noise, (n,)), (n,), low=0.0)
