"""The arguments of every command: a wrong call is an `InputError` that names the nearest word.

Each is one of the function that carries the command out; ``roomfit --help`` loads no numerical
package.
"""

from __future__ import annotations

import argparse
import re
import tomllib
from collections.abc import Callable, Iterable, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, NoReturn

import roomfit
from roomfit.base.errors import InputError


class Parser(argparse.ArgumentParser):
    """A parser that raises where `argparse` would exit."""

    def error(self, message: str) -> NoReturn:
        """Raise what `argparse` finds wrong."""
        raise call_error(self, message.removeprefix("argument "))

    def refuse_unknown_options(self, arguments: Sequence[str]) -> None:
        """Refuse an unknown option before `argparse` takes its value for another argument."""
        known = self._option_string_actions
        for argument in arguments:
            name = argument.partition("=")[0]
            if name == "--":
                return
            if name.startswith("--") and name not in known:
                raise call_error(self, "there is no such option", found=name, known=known)


def call_error(
    parser: argparse.ArgumentParser,
    what: str,
    *,
    found: str | None = None,
    known: Iterable[str] = (),
) -> InputError:
    """Return what is wrong with a call: `found` was not understood, `known` could be meant."""
    near = None
    if found is not None:
        from roomfit.base.arguments import nearest  # needs numpy, which --help must not wait for

        near = nearest(found, known)
    usage = " ".join(parser.format_usage().split()).removeprefix("usage: ")
    return InputError(
        what,
        found=None if found is None else repr(found),
        needed=usage,
        hint=f"{parser.prog} --help" if near is None else f"did you mean {near!r}?",
    )


def parsers() -> tuple[Parser, dict[str, Parser]]:
    """Return the parser of the program, and those of its commands by their names."""
    parser = Parser(
        prog="roomfit",
        description="Absorption of a real room's walls from impulse responses measured in it.",
        allow_abbrev=False,
    )
    version = f"roomfit {roomfit.__version__}"
    parser.add_argument("--version", action="version", version=version, help="Show the version.")
    commands: Any = parser.add_subparsers(title="commands", metavar="COMMAND")
    text = files("roomfit.cli").joinpath("commands.toml").read_text(encoding="utf-8")
    known = tomllib.loads(text)
    for name, command in known["commands"].items():
        about = command["about"]
        own = commands.add_parser(
            name, help=about.partition("\n")[0], description=about, allow_abbrev=False
        )
        own.set_defaults(call=command["call"])
        for one in ("how_much", *command["arguments"]):
            found = known["shared"][one] if isinstance(one, str) else one
            target = own.add_mutually_exclusive_group() if isinstance(found, list) else own
            for argument in found if isinstance(found, list) else [found]:
                _add(target, **argument)
    return parser, dict(commands.choices)


def _add(target: Any, names: str, help: str, type: str = "", **settings: Any) -> None:  # noqa: A002
    """Add one argument as ``commands.toml`` describes it, its default behind its help."""
    default = settings.get("default")
    if default and type != "path" and not isinstance(default, list):
        help = f"{help.removesuffix('.')} (default: {default})."  # noqa: A001
    if isinstance(settings.get("metavar"), list):
        settings["metavar"] = tuple(settings["metavar"])
    settings |= {"action": "store_true"} if type == "flag" else {}
    settings |= {"type": _TYPES[type]} if type in _TYPES else {}
    target.add_argument(*names.split(), help=help, **settings)


def _as(kind: Callable[[str], Any], words: str) -> Callable[[str], Any]:
    def read(text: str) -> Any:
        try:
            return kind(text)
        except ValueError:
            is_comma = re.fullmatch(r"-?\d*,\d+", text)
            cure = f": write a point, {text.replace(',', '.')}" if is_comma else ""
            raise argparse.ArgumentTypeError(f"{text!r} is not {words}{cure}") from None

    return read


number, whole = _as(float, "a number"), _as(int, "a whole number")


def positive_number(text: str) -> int:
    """Return a whole number of at least 1."""
    value: int = whole(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{value} is less than 1")
    return value


def number_range(text: str) -> tuple[float, float]:
    """Return two numbers that are written as in 500-2000; one alone is both."""
    low, _, high = text.partition("-")
    return number(low), number(high or low)


def _grid(text: str) -> tuple[float, float]:
    height, _, spacing = text.partition(",")
    return number(height), number(spacing)


def _both(text: str) -> tuple[int, int]:
    i, n = text.split("/")
    return int(i), int(n)


_TYPES: dict[str, Callable[[str], Any]] = {
    "path": Path,
    "number": number,
    "whole": whole,
    "positive": positive_number,
    "range": number_range,
    "grid": _grid,
    "share": _as(_both, "I/N, as 3/10"),
}
