"""Parsers of arguments: a wrong call is an `InputError` that names the nearest known word."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TypeAlias

from roomfit.base.errors import InputError

if TYPE_CHECKING:
    from roomfit.files.encoding import ResultFile


class Parser(argparse.ArgumentParser):
    """A parser that raises where `argparse` would exit."""

    def error(self, message: str) -> NoReturn:
        """Raise what `argparse` finds wrong.

        Raises
        ------
        InputError
            Always.
        """
        raise call_error(self, message.removeprefix("argument "))

    def refuse_unknown_options(self, arguments: Sequence[str]) -> None:
        """Refuse an unknown option before `argparse` takes its value for another argument.

        Raises
        ------
        InputError
            One of the arguments is an option that this parser does not have.
        """
        known = self._option_string_actions
        for argument in arguments:
            name = argument.partition("=")[0]
            if name == "--":
                return
            if name.startswith("--") and name not in known:
                raise call_error(self, "there is no such option", found=name, known=known)

    def add_option(self, name: str, text: str, *, default: object = None, **settings: Any) -> None:
        """Add an option with a value; `text` gets the default behind it."""
        if default is not None:
            text = f"{text.removesuffix('.')} (default: {default})."
        self.add_argument(name, default=default, help=text, **settings)

    def add_fit(self, *, required: bool = True) -> None:
        """Add ``--absorption``, the fit; not required where decay times or priors do as well."""
        text = "result.json or absorption.csv of a fit."
        if not required:
            text += " Left out: by the campaign's decay times, or by its priors alone."
        self.add_option("--absorption", text, type=Path, required=required)
        self.add_edited()

    def add_edited(self) -> None:
        """Add ``--edited``, of which `result_file` makes use."""
        text = "Read a result that was edited since roomfit wrote it."
        self.add_argument("--edited", action="store_true", help=text)

    def add_state(self) -> None:
        """Add ``--state``."""
        self.add_option(
            "--state", "State of the room among the campaign's [[states]]; left out: as described."
        )

    def add_pairs(self) -> None:
        """Add ``--pairs``, which `roomfit.predict.campaign.pair_choice` reads."""
        self.add_option(
            "--pairs",
            "all: every source with every receiver; campaign: the measured ones.",
            default="all",
        )

    def add_doubted(self) -> None:
        """Add ``--doubted``, see `roomfit.predict.campaign.predict_arguments`."""
        text = "Predict changes and other states also where the result is seriously doubted."
        self.add_argument("--doubted", action="store_true", help=text)

    def add_out(self, text: str = "Folder for the results; made if needed.") -> None:
        """Add ``--out``, a path that must be given."""
        self.add_argument("--out", type=Path, required=True, help=text)

    def add_threads(self) -> None:
        """Add ``--threads``."""
        text = "Cores to use at most; left out: ROOMFIT_THREADS of the environment, or all."
        self.add_option("--threads", text, type=positive_number)

    def add_overwrite(self, text: str = "Write into a folder that is not empty.") -> None:
        """Add ``--overwrite``."""
        self.add_argument("--overwrite", action="store_true", help=text)


def result_file(options: argparse.Namespace, path: Path) -> ResultFile:
    """Return a result to read, as ``--edited`` has it."""
    from roomfit.files.encoding import EditedFile  # needs numpy, which --help must not wait for

    return EditedFile(path) if options.edited else path


Commands: TypeAlias = "argparse._SubParsersAction[Parser]"


def add_command(
    commands: Commands, name: str, about: str, run: Callable[[argparse.Namespace], None]
) -> Parser:
    """Add a command and return its parser; the first line of `about` is shown in the list."""
    parser = commands.add_parser(
        name, help=about.partition("\n")[0], description=about, allow_abbrev=False
    )
    parser.set_defaults(run=run)
    much = parser.add_mutually_exclusive_group()
    much.add_argument(
        "-q", "--quiet", action="store_true", help="On standard error, show errors only."
    )
    much.add_argument("-v", "--verbose", action="store_true", help="Show the details of stages.")
    return parser


def number(text: str) -> float:
    """Return a number."""
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None


def whole_number(text: str) -> int:
    """Return a whole number."""
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None


def number_range(text: str) -> tuple[float, float]:
    """Return two numbers that are written as in 500-2000; one alone is both."""
    low, _, high = text.partition("-")
    return number(low), number(high or low)


def positive_number(text: str) -> int:
    """Return a whole number of at least 1."""
    value = whole_number(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{value} is less than 1")
    return value


def call_error(
    parser: argparse.ArgumentParser,
    what: str,
    *,
    found: str | None = None,
    known: Iterable[str] = (),
) -> InputError:
    """Return what is wrong with a call of the command line.

    Parameters
    ----------
    parser : ArgumentParser
        Of the command; its usage is what was needed.
    what : str
        One short sentence.
    found : str, optional
        The word that was not understood.
    known : iterable of str
        Words that could have been meant by `found`.
    """
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
