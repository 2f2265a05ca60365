"""What a certified search minimises: misfits of sums of products of powers, and priors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from roomfit.checks import bool_array, float_array
from roomfit.errors import InputError
from roomfit.typing import BoolArray, FloatArray, IntArray

Misfit: TypeAlias = Literal["squares", "logarithms", "gamma"]
KINDS: dict[Misfit, int] = {"squares": 0, "logarithms": 1, "gamma": 2}

Arrays: TypeAlias = tuple[
    IntArray, FloatArray, IntArray, FloatArray, FloatArray, FloatArray, BoolArray
]
"""offsets, weight, exponents, measured, precision, prior, is_absorption: what kernels take."""


@dataclass(frozen=True, slots=True, eq=False)
class Question:
    """One band's misfit as a function of log factors g, to be minimised over a box.

    Window i is expected to have the energy ``R_i = sum over its rows of w prod exp(n_m g_m)``. The
    first coordinates are materials, g = log(1 - absorption); others are log gains.

    Attributes
    ----------
    coordinates : tuple of str
    is_absorption : bool array, shape (n,)
    misfit : {"squares", "logarithms", "gamma"}
        ``c (R - M)**2``, ``c (log R - log M)**2``, or the Gamma deviance
        ``2 c (M / R - 1 - log(M / R))``, summed over windows.
    offsets : int64 array, shape (n_windows + 1,)
        Window i owns the rows ``offsets[i]:offsets[i + 1]``.
    weight : float array, shape (n_rows,)
        0 or more.
    exponents : uint16 array, shape (n_rows, n)
    measured : float array, shape (n_windows,)
        M; 0 or more, above 0 unless the misfit is "squares".
    precision : float array, shape (n_windows,)
        c; 0 or more.
    least, most : float arrays, shape (n,)
        Bounds of g. `least` may be minus infinity, an absorption of 1.
    prior : float array, shape (n, 4)
        Adds ``p (logit - mean)**2`` for each material, with the logit of its absorption between
        bounds: columns p, mean, 1 - lower bound, 1 - upper bound. p = 0 adds nothing.
    """

    coordinates: tuple[str, ...]
    is_absorption: BoolArray
    misfit: Misfit
    offsets: IntArray
    weight: FloatArray
    exponents: IntArray
    measured: FloatArray
    precision: FloatArray
    least: FloatArray
    most: FloatArray
    prior: FloatArray

    def __post_init__(self) -> None:
        n, rows, windows = len(self.coordinates), len(self.weight), len(self.measured)
        if not n or not windows:
            raise InputError(
                "nothing to certify",
                found=f"{n} unknowns and {windows} windows",
                needed="at least one of each",
            )
        for name, shape in (
            ("weight", (rows,)),
            ("measured", (windows,)),
            ("precision", (windows,)),
        ):
            object.__setattr__(self, name, float_array(name, getattr(self, name), shape, low=0.0))
        object.__setattr__(self, "prior", float_array("prior", self.prior, (n, 4)))
        shapes: dict[str, tuple[type, tuple[int, ...]]] = {
            "offsets": (np.int64, (windows + 1,)),
            "exponents": (np.uint16, (rows, n)),
            "least": (np.float64, (n,)),
            "most": (np.float64, (n,)),
        }
        for name, (dtype, size) in shapes.items():
            array: IntArray | FloatArray = np.array(getattr(self, name), dtype=dtype, order="C")
            if array.shape != size:
                raise InputError(f"{name} has the wrong shape", found=str(array.shape))
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        flags = bool_array("kind of coordinate", self.is_absorption, (n,))
        object.__setattr__(self, "is_absorption", flags)
        _check_bounds(self)


def arrays(question: Question) -> Arrays:
    """Return what the kernels take, writable copies of one contiguous form."""
    return (
        np.array(question.offsets),
        np.array(question.weight),
        np.array(question.exponents),
        np.array(question.measured),
        np.array(question.precision),
        np.array(question.prior),
        np.array(question.is_absorption),
    )


def to_absorption(question: Question, g: FloatArray) -> FloatArray:
    """Return what log factors mean: absorption for materials, the gain itself for gains."""
    factor = np.exp(g)
    return np.where(question.is_absorption, -np.expm1(g), factor)


def _check_bounds(question: Question) -> None:
    if not np.all(question.least < question.most) or not np.all(np.isfinite(question.most)):
        raise InputError("bounds of a certified search must rise and end finitely")
    if np.any(~np.isfinite(question.least) & ~question.is_absorption):
        raise InputError("a gain needs a finite lower bound for a certificate")
    if question.misfit != "squares":
        empty = np.flatnonzero(question.measured <= 0.0)
        if empty.size:
            raise InputError(
                "a window without energy has no logarithm",
                where=f"window {int(empty[0])}",
                hint="leave it out, or use least squares",
            )
        starts, ends = question.offsets[:-1], question.offsets[1:]
        if np.any(starts == ends):
            raise InputError("a window that no path reaches has no logarithm")
