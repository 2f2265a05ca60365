"""What functions returned last in a run: numbers that no output shows, as of a check that passed.

Of every function of the numerical packages without an underscore, the sum of the absolute values of
all numbers in what its last call returned, and a sum with other weights, which an exchange changes.
The last call, because how often a search calls depends on rounding and where it ends does not.
"""

from __future__ import annotations

import contextlib
import functools
import importlib
import pkgutil
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from itertools import islice
from types import FunctionType, ModuleType
from typing import Any

import numpy as np

# They change from run to run, or with the last digit of a step.
_NOT_SUMMED = frozenset({"seconds", "median_seconds", "evaluations", "rounds", "iterations"})
# Its columns have either sign.
_EITHER_SIGN = frozenset({"objective.parameters.local_roots"})
# Deeper lies what was handed over, or what other functions returned; nor is all of it summed.
_DEPTH = 4
_MOST_ARRAYS, _MOST_NUMBERS = 2000, 10_000


@contextlib.contextmanager
def returned(packages: tuple[str, ...]) -> Iterator[dict[str, Any]]:
    """Give a mapping that fills with what functions of some packages returned last, by name.

    What roomfit keeps by `functools.cache` is computed anew.
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
        if not name.startswith("_")
        # what stands for several kernels is known to the compiler by itself
        if "only compiled code may call this" not in function.__code__.co_consts
    }
    _exchange(watched)
    try:
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
        last[name.removeprefix("roomfit.")] = value
        return value

    return call


def sums(last: Mapping[str, Any]) -> dict[str, list[float]]:
    """Return both sums, six digits of each, of every value that is more than rounding, by name."""
    found = {}
    for name, value in sorted(last.items()):
        if name in _EITHER_SIGN:
            continue
        parts = islice(_numbers(value, _DEPTH), _MOST_ARRAYS)
        numbers = np.concatenate([np.zeros(0), *parts])
        numbers = numbers[np.isfinite(numbers)]
        size = float(np.abs(numbers).sum())
        if size > 1e-12:
            weighed = float(numbers @ np.cos(np.arange(numbers.size)))
            found[name] = [float(f"{x:.6g}") for x in (size, weighed)]
    return found


def moved(kept: Mapping[str, list[float]], found: Mapping[str, list[float]]) -> list[str]:
    """Return the functions whose sums differ by a thousandth of the first, of those in both.

    A processor without vector instructions moves them by a ten-thousandth at most.
    """
    return [
        name
        for name, (size, weighed) in kept.items()
        if name in found
        and not np.allclose(found[name], (size, weighed), rtol=0.0, atol=1e-3 * size)
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
