"""What functions returned in a run, and drew: numbers that no output shows, as of a passed check.

Of every function of the numerical packages, the sum of the absolute values of all numbers in what
its first and its last call returned, and a sum with other weights, which an exchange changes. Those
calls, because how often a search calls depends on rounding, and where it begins and ends does not.
Of every function of roomfit that draws, the same of the numbers and of the words that it handed to
axes, whatever matplotlib makes of them.
"""

from __future__ import annotations

import contextlib
import functools
import importlib
import pkgutil
import re
import sys
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from itertools import islice
from types import FunctionType, ModuleType
from typing import Any

import numpy as np

# They change from run to run, or with the last digit of a step.
_NOT_SUMMED = frozenset({"seconds", "median_seconds", "evaluations", "rounds", "iterations"})
# Columns of either sign, arrays that are written in part, a size that is nearly that of rounding.
_NOT_KEPT = frozenset(
    {"objective.parameters.local_roots", "tracing.rays._new_caught", "tracing.rays._trace_block"}
    | {"uncertainty.posterior._exponent"}
)
_FIRST = ", first"
_LEAST = 1e-9  # of the mean of an array: smaller ones are of rounding
# Deeper lies what was handed over, or what other functions returned; nor is all of it summed.
_DEPTH = 4
_MOST_ARRAYS, _MOST_NUMBERS = 2000, 10_000
# What hands numbers or words to a picture; how they look is left out.
_DRAWING = (
    *("annotate", "axhline", "axhspan", "axvline", "axvspan", "bar", "barh", "contour"),
    *("contourf", "hist", "set_xticklabels", "set_yticklabels"),
    *("errorbar", "fill_between", "hlines", "imshow", "legend", "pcolormesh", "plot", "scatter"),
    *("semilogx", "semilogy", "set_title", "set_xlabel", "set_xlim", "set_xscale", "set_xticks"),
    *("set_ylabel", "set_ylim", "set_yscale", "set_yticks", "step", "text", "vlines"),
)
_LOOKS = frozenset(
    {"alpha", "color", "colors", "fontsize", "linewidth", "lw", "rotation", "zorder"}
)


@contextlib.contextmanager
def returned(packages: tuple[str, ...]) -> Iterator[dict[str, Any]]:
    """Give a mapping that fills with what functions of some packages returned and drew, by name.

    First and last. What roomfit keeps by `functools.cache` is computed anew.
    """
    last: dict[str, Any] = {}
    for package in packages:
        module = importlib.import_module(f"roomfit.{package}")
        for found in pkgutil.walk_packages(getattr(module, "__path__", ()), f"{module.__name__}."):
            importlib.import_module(found.name)
    for module in _modules():
        for value in vars(module).values():
            if hasattr(value, "cache_clear"):
                value.cache_clear()
    watched = {
        function: _watched(function, f"{module.__name__}.{name}", last)
        for module in _modules()
        if module.__name__.partition(".")[2].split(".")[0] in packages
        for name, function in vars(module).items()
        if isinstance(function, FunctionType) and function.__module__ == module.__name__
        # what stands for several kernels is known to the compiler by itself, or called by it alone
        if "only compiled code may call this" not in function.__code__.co_consts
        if not (name.startswith("_") and module.__name__ == "roomfit.tracing.bvh")
    }
    _exchange(watched)
    try:
        with _drawn(last):
            yield last
    finally:
        # also in modules that were imported meanwhile
        _exchange({call: function for function, call in watched.items()})


def _modules() -> list[ModuleType]:
    return [m for n, m in list(sys.modules.items()) if n.split(".")[0] == "roomfit"]


def _exchange(new: Mapping[Any, Callable[..., Any]]) -> None:
    """Put functions in the place of others, under every name that modules have for them."""
    for module in _modules():
        for name, value in list(vars(module).items()):
            if isinstance(value, FunctionType) and value in new:
                setattr(module, name, new[value])


def _watched(function: Callable[..., Any], name: str, last: dict[str, Any]) -> Callable[..., Any]:
    @functools.wraps(function)
    def call(*arguments: Any, **named: Any) -> Any:
        value = function(*arguments, **named)
        short = name.removeprefix("roomfit.")
        last.setdefault(short + _FIRST, value)
        last[short] = value
        return value

    return call


@contextlib.contextmanager
def _drawn(found: dict[str, Any]) -> Iterator[None]:
    """Fill a mapping with what functions of roomfit hand to axes."""
    from matplotlib.axes import Axes

    def watched(method: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(method)
        def call(*arguments: Any, **named: Any) -> Any:
            caller = sys._getframe(1)
            module = str(caller.f_globals.get("__name__"))
            if module.startswith("roomfit."):  # and not matplotlib itself
                name = f"{module.removeprefix('roomfit.')}.{caller.f_code.co_name}, drawn"
                shown = [value for key, value in named.items() if key not in _LOOKS]
                found.setdefault(name, []).append([*arguments[1:], *shown])
                words = [float(zlib.crc32(w.encode()) % 997) for w in _words([*arguments, *shown])]
                found.setdefault(f"{name} words", []).extend(words)
            return method(*arguments, **named)

        return call

    with contextlib.ExitStack() as stack:
        for name in _DRAWING:
            method = getattr(Axes, name)
            stack.callback(setattr, Axes, name, method)
            setattr(Axes, name, watched(method))
        yield


def _words(value: Any) -> Iterator[str]:
    """Yield the texts in a list, numbers in them left out."""
    if isinstance(value, str):
        yield re.sub(r"[\d.]+", "", value)
    elif isinstance(value, tuple | list):
        for item in value:
            yield from _words(item)


def sums(last: Mapping[str, Any]) -> dict[str, list[float]]:
    """Return both sums of every value by name, of arrays of each size apart, small ones first.

    Sizes are hundreds: hertz beside absorption would hide it. Three numbers each: the size, and
    five digits of the sums. What is no more than rounding is left out, and what the first call
    returned where the last returned the same.
    """
    found: dict[str, list[float]] = {}
    for name, value in sorted(last.items()):
        if name.removesuffix(_FIRST) in _NOT_KEPT:
            continue
        parts: dict[int, list[np.ndarray[Any, Any]]] = {}
        for part in islice(_numbers(value, _DEPTH), _MOST_ARRAYS):
            numbers = part[np.isfinite(part)]
            mean = float(np.abs(numbers).mean()) if numbers.size else 0.0
            if mean > _LEAST:
                # at 3.7 and so on, for round numbers are frequent
                parts.setdefault(int(np.floor(0.5 * np.log10(mean / 3.7))), []).append(numbers)
        found[name] = []
        for size, own in sorted(parts.items()):
            numbers = np.concatenate(own)
            weighed = float(numbers @ np.cos(np.arange(numbers.size)))
            both = (float(np.abs(numbers).sum()), weighed)
            found[name] += [size, *(float(f"{x:.5g}") for x in both)]
    alike = [n for n in found if n.endswith(_FIRST) and found[n] == found[n.removesuffix(_FIRST)]]
    return {name: own for name, own in found.items() if name not in alike}


def _differ(kept: list[float], found: list[float]) -> bool:
    """Return whether there are other sizes, or sums that differ by a thousandth of the first."""
    if kept[::3] != found[::3]:
        return True
    return any(
        abs(found[i + k] - kept[i + k]) > 1e-3 * kept[i + 1]
        for i in range(0, len(kept), 3)
        for k in (1, 2)
    )


def moved(kept: Mapping[str, list[float]], found: Mapping[str, list[float]]) -> list[str]:
    """Return the functions whose sums differ by a thousandth of the first, or that ran no more.

    A processor without vector instructions moves them by a ten-thousandth at most. A function that
    is new, or has gone from its module, is no difference.
    """

    def still_there(name: str) -> bool:
        module, _, function = name.split(",")[0].rpartition(".")
        return hasattr(importlib.import_module(f"roomfit.{module}"), function)

    def now(name: str) -> list[float] | None:
        return found.get(name, found.get(name.removesuffix(_FIRST)))

    return [
        name
        for name, own in kept.items()
        if (still_there(name) if (other := now(name)) is None else _differ(own, other))
    ]


def _numbers(value: Any, depth: int) -> Iterator[np.ndarray[Any, Any]]:
    """Yield the numbers in a value as arrays of one axis."""
    if isinstance(value, bool | int | float | complex | np.number | np.bool_):
        value = np.array(value)
    if isinstance(value, np.ndarray):
        flat = value.reshape(-1)[:: value.size // _MOST_NUMBERS + 1]
        if value.dtype.kind in "biufc":
            yield flat.real.astype(float)
        if value.dtype.kind == "c":
            yield flat.imag.astype(float)
    elif depth and isinstance(value, Mapping):
        for key, item in value.items():
            if key not in _NOT_SUMMED:
                yield from _numbers(item, depth - 1)
    elif depth and isinstance(value, tuple | list):
        names = getattr(value, "_fields", ("",) * len(value))
        for name, item in zip(names, value, strict=True):
            if name not in _NOT_SUMMED:
                yield from _numbers(item, depth - 1)
    elif depth and is_dataclass(value) and not isinstance(value, type):
        for field in (f for f in fields(value) if f.name not in _NOT_SUMMED):
            yield from _numbers(getattr(value, field.name, None), depth - 1)
