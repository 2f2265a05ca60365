"""Checks of arguments: arrays are copied, made read-only, or refused with a clear message."""

from __future__ import annotations

import difflib
import unicodedata
from collections.abc import Iterable, Sequence
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from roomfit.base.errors import InputError
from roomfit.base.typing import BoolArray, FloatArray, IntArray


def read_only(array: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return the same array, set read-only."""
    array.setflags(write=False)
    return array


def float_array(
    name: str,
    values: ArrayLike,
    shape: tuple[int | None, ...],
    *,
    low: float = -np.inf,
    high: float = np.inf,
    unit: str = "",
) -> FloatArray:
    """Copy `values` into a read-only float64 array after checking shape, range and finiteness.

    `name` stands in messages, with its unit where it has one; None in `shape` for any length; `low`
    and `high` are a closed range, and `unit` is shown behind it. `InputError` where they are no
    numbers, of another shape, not finite, or out of range.
    """
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        what = f"{name} is not an array of numbers"
        hint = "give rows of equal length, with numbers alone"
        raise InputError(what, found=str(error), needed="finite numbers", hint=hint) from error
    check_shape(name, array, shape)
    bad = np.argwhere(~(np.isfinite(array) & (array >= low) & (array <= high)))
    # not `size`: a single number has no axis, so no index
    if len(bad):
        index = tuple(int(i) for i in bad[0])
        place = f"index {list(index)}" if index else None
        raise _out_of_range(name, float(array[index]), low, high, unit, place)
    return read_only(array)


def int_array(
    name: str,
    values: ArrayLike,
    shape: tuple[int | None, ...],
    dtype: type[np.integer[Any]] = np.int32,
    *,
    low: int | None = None,
    high: int | None = None,
) -> IntArray:
    """Copy `values` into a read-only integer array after checking shape and range."""
    source = np.asarray(values)
    if source.size and not np.issubdtype(source.dtype, np.integer):
        what = f"{name} must be whole numbers"
        needed, hint = "an array of integers", "round them, and convert them with .astype(int)"
        raise InputError(what, found=f"values of type {source.dtype}", needed=needed, hint=hint)
    info = np.iinfo(dtype)
    ends = (info.min if low is None else low, info.max if high is None else high)
    float_array(name, source, shape, low=float(ends[0]), high=float(ends[1]))
    return read_only(np.array(source, dtype=dtype))


def bool_array(name: str, values: ArrayLike, shape: tuple[int | None, ...]) -> BoolArray:
    """Copy `values` into a read-only boolean array after checking shape and kind."""
    array = np.array(values, dtype=object)  # a number is no truth value
    check_shape(name, array, shape)
    other = [v for v in array.flat if not isinstance(v, bool | np.bool_)]
    if other:
        what, hint = f"{name} is not true or false", "write true or false in its place"
        raise InputError(what, found=repr(other[0]), needed="true or false everywhere", hint=hint)
    return read_only(array.astype(np.bool_))


def check_shape(name: str, array: np.ndarray[Any, Any], shape: tuple[int | None, ...]) -> None:
    """Refuse an array of another shape; None stands for any length."""
    fits = array.ndim == len(shape) and all(
        wanted is None or wanted == got for wanted, got in zip(shape, array.shape, strict=True)
    )
    if not fits:
        wanted = ", ".join("any" if n is None else str(n) for n in shape)
        what = f"{name} has the wrong shape"
        hint = "transpose it, or " if array.ndim > 1 else ""
        hint += "give as many values along each axis as are needed"
        raise InputError(what, found=f"{array.shape}", needed=f"({wanted})", hint=hint)


def check_range(
    name: str, value: float, low: float, high: float, unit: str = "", where: str | None = None
) -> None:
    """Refuse a number outside of a closed range, or NaN."""
    if not low <= value <= high:
        raise _out_of_range(name, value, low, high, unit, where)


def _out_of_range(
    name: str, value: float, low: float, high: float, unit: str = "", where: str | None = None
) -> InputError:
    """Return the error of a number outside of a closed range, with what may have been meant."""
    upper = f"to {high:g}" if high < np.inf else "or more"
    needed = "a finite number" if np.isinf([low, high]).all() else f"{low:g} {upper} {unit}"
    hint = f"is another unit than {unit} meant?" if unit else "compare its digits with the source"
    if not np.isfinite(value):
        hint = "replace it by a finite number"
    elif low <= -value <= high:
        hint = f"is {-value:g} meant, without the sign?"
    elif high == 1.0 < value <= 100.0:
        hint = "if this is a percentage, divide by 100"
    what = f"{name} is out of range"
    return InputError(
        what, where=where, found=f"{value:g} {unit}".rstrip(), needed=needed.rstrip(), hint=hint
    )


def unique_names(kind: str, names: Iterable[str]) -> tuple[str, ...]:
    """Return the names as a tuple; refuse an empty, a repeated or an unprintable one."""
    names = tuple(names)
    for i, name in enumerate(names):
        check_name(kind, name, None if name else f"number {i + 1}")
        if name in names[:i]:
            what = f"two {kind}s have the same name"
            needed, hint = f"every {kind} under its own name", "rename one of them, or leave it out"
            raise InputError(what, found=repr(name), needed=needed, hint=hint)
    return names


_STEERING = {"Cc", "Cs", "Zl", "Zp"}  # of Unicode: controls, surrogates, ends of lines
_TURNING = "\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069"  # the direction of writing


def check_name(kind: str, name: str, where: str | None = None) -> None:
    """Refuse no name, and letters that steer terminals, end lines or turn the way of writing."""
    if not name:
        what, hint = f"a {kind} without a name", "name it after what is seen there"
        needed = "one letter or more"
        raise InputError(what, where=where, found=repr(name), needed=needed, hint=hint)
    bad = next((c for c in name if unicodedata.category(c) in _STEERING or c in _TURNING), None)
    if bad is not None:
        what = f"the name of a {kind} has a control character"
        needed = "letters that can be printed in one line"
        hint = "type the name anew, without what was pasted with it"
        raise InputError(what, found=f"U+{ord(bad):04X} in {name!a}", needed=needed, hint=hint)


def nearest(word: str, known: Iterable[str]) -> str | None:
    """Return the known word most like `word`, or None where nothing comes near.

    Of a file with thousands of names, or with names of thousands of letters, the first only.
    """
    short = [name for name in islice(known, 1000) if len(name) <= 100]
    found = difflib.get_close_matches(word[:100], short, n=1, cutoff=0.6)
    return found[0] if found else None


def did_you_mean(word: str, known: Iterable[str]) -> str | None:
    """Return a hint at the known word most like `word`, None where nothing comes near."""
    like = nearest(word, known)
    return f"did you mean {like!r}?" if like else None


def check_known(
    what: str,
    name: str,
    known: Iterable[str],
    *,
    where: str | None = None,
    else_needed: str = "",
    else_try: str | None = None,
) -> None:
    """Refuse a name that is none of the known ones, and offer the one most like it.

    `else_needed` is said where no name is known at all, `else_try` where none comes near.
    """
    known = tuple(known)
    if name not in known:
        needed = f"one of {', '.join(known)}" if known else else_needed
        hint = did_you_mean(str(name), known) or else_try or "write it as it is listed there"
        raise InputError(what, where=where, found=repr(name), needed=needed, hint=hint)


_NAMED = 6


def in_short(names: Sequence[str]) -> str:
    """Return a list of names in words, of many the first six.

    Examples
    --------
    >>> in_short(["a", "b"]), in_short(list("abcdefgh"))
    ('a, b', 'a, b, c, d, e, f and 2 more')
    """
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return ", ".join(names[:_NAMED]) + more
