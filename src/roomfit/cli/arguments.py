"""Parsers of arguments: a wrong call is an `InputError` that names the nearest known word.

Every command's arguments are declared here, and its module, which imports what it needs, carries it
out: ``roomfit --help`` loads no numerical package.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TypeAlias

import roomfit
from roomfit.base.errors import InputError

if TYPE_CHECKING:
    from roomfit.files.encoding import ResultFile


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

    def option(self, name: str, text: str, *, default: object = None, **settings: Any) -> None:
        """Add an option with a value; `text` gets the default behind it."""
        if default is not None:
            text = f"{text.removesuffix('.')} (default: {default})."
        self.add_argument(name, default=default, help=text, **settings)

    def flag(self, name: str, text: str) -> None:
        """Add an option without a value."""
        self.add_argument(name, action="store_true", help=text)

    def campaign(self, text: str = "Campaign file (TOML).") -> None:
        """Add the campaign."""
        self.add_argument("campaign", type=Path, help=text)

    def fit(self, *, required: bool = True) -> None:
        """Add ``--absorption``, the fit; not required where decay times or priors do as well."""
        text = "result.json or absorption.csv of a fit."
        if not required:
            text += " Left out: by the campaign's decay times, or by its priors alone."
        self.option("--absorption", text, type=Path, required=required)
        self.edited()

    def edited(self) -> None:
        """Add ``--edited``, of which `result_file` makes use."""
        self.flag("--edited", "Read a result that was edited since roomfit wrote it.")

    def what_if(self, *, with_changes: bool = True) -> None:
        """Add pairs, state and doubts of a prediction, and its changes."""
        if with_changes:
            text = (
                "What if: MATERIAL=0.3, 0.3+-0.05, one value per band, x1.5+-0.2, another material "
                "of the room, or a name of the catalogue. May be given several times."
            )
            self.option("--set", text, dest="changes", metavar="CHANGE", action="append")
        text = "State of the room among the campaign's [[states]]; left out: as described."
        self.option("--state", text)
        text = "Predict changes and other states also where the result is seriously doubted."
        self.flag("--doubted", text)

    def pairs(self) -> None:
        """Add ``--pairs``, which `roomfit.files.questions.question_of` reads."""
        text = "all: every source with every receiver; campaign: the measured ones."
        self.option("--pairs", text, default="all")

    def out(
        self, text: str = "Folder for the results; made if needed.", *, required: bool = True
    ) -> None:
        """Add ``--out``."""
        self.add_argument("--out", type=Path, required=required, help=text)

    def overwrite(self, text: str = "Write into a folder that is not empty.") -> None:
        """Add ``--overwrite``."""
        self.flag("--overwrite", text)

    def threads(self) -> None:
        """Add ``--threads``."""
        text = "Cores to use at most; left out: ROOMFIT_THREADS of the environment, or all."
        self.option("--threads", text, type=positive_number)

    def png(self) -> None:
        """Add ``--png``."""
        self.flag("--png", "Write pictures as PNG, too, beside SVG.")


Commands: TypeAlias = "argparse._SubParsersAction[Parser]"


def command_parsers() -> dict[str, Parser]:
    """Return the parser of every command by the command's name."""
    return parsers()[1]


def parsers() -> tuple[Parser, dict[str, Parser]]:
    """Return the parser of the program, and those of its commands by their names."""
    parser = Parser(
        prog="roomfit",
        description="Absorption of a real room's walls from impulse responses measured in it.",
        allow_abbrev=False,
    )
    version = f"roomfit {roomfit.__version__}"
    parser.add_argument("--version", action="version", version=version, help="Show the version.")
    commands: Commands = parser.add_subparsers(title="commands", metavar="COMMAND")
    for name, about in _ABOUT.items():
        own = commands.add_parser(
            name, help=about.partition("\n")[0], description=about, allow_abbrev=False
        )
        own.set_defaults(command=name)
        much = own.add_mutually_exclusive_group()
        text = "On standard error, show errors only."
        much.add_argument("-q", "--quiet", action="store_true", help=text)
        text = "Show the details of stages."
        much.add_argument("-v", "--verbose", action="store_true", help=text)
        _DECLARE[name](own)
    return parser, dict(commands.choices)


def _app(own: Parser) -> None:
    text = "Of the project; made if needed."
    own.add_argument("folder", type=Path, nargs="?", default=Path(), help=text)
    own.option("--port", "To listen at; 0: any. Left out: 8321, or the next free.", type=whole)
    own.option(
        "--host", "Address to listen at; others than this may reach it.", default="127.0.0.1"
    )
    own.flag("--no-browser", "Print the address; open no browser.")


def _batch(own: Parser) -> None:
    text = "Campaign files (TOML), or patterns as 'rooms/*/campaign.toml'."
    own.add_argument("campaigns", nargs="+", help=text)
    own.out("Folder for the table and a folder of each room; made if needed.")
    own.flag(
        "--quick", "First answers, as identify --quick; beside full ones, which another run gives."
    )
    where = own.add_mutually_exclusive_group()
    text = "Processes of a cluster on this machine (needs the extra cluster)."
    where.add_argument("--workers", type=positive_number, help=text)
    text = (
        "Address of a running dask scheduler, as tcp://10.0.0.1:8786 (needs the extra cluster). "
        "Campaigns and results must have the same paths on all its workers."
    )
    where.add_argument("--scheduler", metavar="ADDRESS", help=text)
    text = "Only every N-th room from the I-th on, for job arrays: 3/10 is the third of ten."
    where.add_argument("--shard", metavar="I/N", type=_shard, default=(1, 1), help=text)


def _catalogue(own: Parser) -> None:
    text = "Name of a material to show, or words to search for."
    own.add_argument("words", nargs="*", help=text)


def _check(own: Parser) -> None:
    text = "Room file, such as room.obj, or a campaign file (.toml)."
    own.add_argument("room", type=Path, help=text)
    own.option("--unit", "m, mm, cm, ft or in; needed where the format does not state it.")
    own.option("--up", "Axis that points up: z or y.")
    own.option(
        "--bands",
        "Of a campaign: bands to examine, as 500-2000, in place of from_hz and to_hz.",
        type=number_range,
    )
    own.out("Of a campaign: folder for a picture of room and positions.", required=False)
    own.overwrite()
    own.png()
    own.option(
        "--remedy",
        "Of a campaign: write into it what the findings of CODE advise; CODE:2 the second choice.",
        metavar="CODE",
    )
    own.option("--result", "With --remedy: of the findings of this answer, a folder.", type=Path)
    own.flag("--undo", "Of a campaign: take the last remedy back.")


def _compare(own: Parser) -> None:
    own.add_argument("first", type=Path, help="result.json or absorption.csv of a fit.")
    own.add_argument("second", type=Path, help="That of another.")
    own.out("Folder for the table as compared.csv; made if needed.", required=False)
    own.edited()
    own.overwrite()


def _demo(own: Parser) -> None:
    text = "Folder for the campaign and its results."
    own.option("--out", text, type=Path, default=Path("roomfit-demo"))
    own.option("--seed", "Of the positions, levels and noise drawn.", type=whole, default=1)
    own.threads()
    own.overwrite()
    own.png()


def _design(own: Parser) -> None:
    own.campaign("Campaign file (TOML); it need not have a measurement.")
    own.out()
    text = "Pairs of source and receiver to choose from."
    own.option("--candidates", text, type=whole, default=200)
    own.option("--choose", "How many (default: 6, or 1 after a fit).", type=whole)
    own.option("--sources", "How many different sources at most.", type=whole)
    own.option("--criterion", "What is to become small: determinant, mean or worst.")
    own.option("--result", "result.json of a fit: what to measure next.", type=Path)
    own.threads()
    own.edited()
    own.overwrite()
    own.png()


def _export(own: Parser) -> None:
    own.add_argument("result", type=Path, help="result.json or absorption.csv of a fit.")
    text = (
        "catt, odeon, isimpa, pyroomacoustics, csv, excel, budget (of the uncertainty, CSV), or "
        "pdf or word (the report)."
    )
    own.option("--format", text, required=True)
    own.out("File to write.")
    text = "For all materials, where the result does not specify it."
    own.option("--scattering", text, type=number)
    own.edited()
    own.overwrite("Replace what exists.")


def _identify(own: Parser) -> None:
    own.campaign()
    own.out()
    text = "Bands to fit, as 500-2000, in place of from_hz and to_hz of the campaign."
    own.option("--bands", text, type=number_range)
    text = "A first answer: no search for faults of files, positions and chain, no pictures."
    own.flag("--quick", text)
    own.threads()
    own.overwrite()
    own.png()


def _impedance(own: Parser) -> None:
    own.campaign()
    own.out()
    own.overwrite()


def _init(own: Parser) -> None:
    own.add_argument("folder", type=Path, help="Folder of the campaign to be.")
    text = "Room (.obj, .ply, .stl, .glb, .geo, .dxf, .dae, .ifc, .skp, .usdz, .json)."
    own.option("--room", text, type=Path)
    text = "In place of a room file: lengths along x, y, z in m, or in --unit."
    own.option("--shoebox", text, nargs=3, type=number, metavar=("X", "Y", "Z"))
    own.option("--space", "Which room of a building model (.ifc) or a scan (.json) of several.")
    text = "Names of recordings in FOLDER, as in 'DIR/{source}_{receiver}.wav'. Left out: all."
    own.option("--recordings", text)
    text = "Table (CSV, XLSX) of name, x, y, z in m, or as its heading says."
    own.option("--positions", text, type=Path)
    text = "In place of recordings: table (CSV, XLSX) of T30 in s, as from an older report."
    own.option("--decay-times", text, type=Path)
    own.option("--unit", "Of the room: m, cm, mm, in or ft. Left out: guessed, or asked.")
    own.option("--up", "Axis that points up in the room file: z or y. Left out: guessed.")
    own.overwrite("Replace a campaign.toml that is there.")


def _listen(own: Parser) -> None:
    own.campaign("Campaign file (TOML) of the measured room.")
    own.fit()
    own.out()
    own.what_if()
    text = "A WAV file of one channel, at the responses' rate, to convolve."
    own.option("--dry", text, type=Path)
    own.overwrite()


def _measure(own: Parser) -> None:
    own.add_argument("folder", type=Path, nargs="?", help="Of the recordings; made if needed.")
    own.option("--source", "Name of the source, such as S1.")
    own.option("--receiver", "Name of the receiver, such as R1.")
    own.option("--seconds", "Length of one sweep.", type=number, default=6)
    own.option("--silence", "Seconds after each sweep.", type=number, default=3)
    own.option("--repetitions", "How many sweeps.", type=positive_number, default=3)
    own.option("--rate", "Sampling rate in Hz.", type=number, default=48000)
    own.option("--device", "To record with and play by: its number, or part of its name.")
    own.option("--output", "To play by, where that is another device.")
    own.flag("--again", "Replace the response of this pair.")
    own.flag("--list", "Name the sound devices, and end.")


def _paper(own: Parser) -> None:
    own.out("Folder for paper.json, table2.csv, pictures.")
    text = "Searches of every problem by every method."
    own.option("--seeds", text, type=positive_number, default=10)
    own.overwrite()


def _predict(own: Parser) -> None:
    own.campaign("Campaign file (TOML) of the room to predict.")
    own.fit(required=False)
    own.out()
    own.pairs()
    own.what_if()
    text = "Maps over the room in place of its receivers: HEIGHT,SPACING in m, as 1.2,0.5."
    own.option("--grid", text, metavar="H,S", type=_grid)
    own.threads()
    own.overwrite()
    own.png()


def _reverberation(own: Parser) -> None:
    own.campaign("Campaign file (TOML) with [reverberation].")
    own.out("Folder for a page and a table; made if needed.", required=False)
    own.overwrite()


def _schema(own: Parser) -> None:
    own.option("--of", "campaign, or treatment.", default="campaign")


def _treat(own: Parser) -> None:
    own.campaign("Campaign file (TOML) of the room.")
    own.add_argument("treatment", type=Path, help="Surfaces, products and targets (TOML).")
    own.fit(required=False)
    own.out()
    own.pairs()
    own.what_if(with_changes=False)
    own.threads()
    own.overwrite()
    own.png()


def result_file(options: argparse.Namespace, path: Path) -> ResultFile:
    """Return a result to read, as ``--edited`` has it."""
    from roomfit.files.encoding import EditedFile  # needs numpy, which --help must not wait for

    return EditedFile(path) if options.edited else path


def number(text: str) -> float:
    """Return a number."""
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None


def whole(text: str) -> int:
    """Return a whole number."""
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None


def positive_number(text: str) -> int:
    """Return a whole number of at least 1."""
    value = whole(text)
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


def _shard(text: str) -> tuple[int, int]:
    i, _, n = text.partition("/")
    try:
        return int(i), int(n)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not I/N, as 3/10") from None


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


_ABOUT = {
    "app": "Work on a project in the browser: room, measurements, absorption, what if, report.\n\n"
    "FOLDER holds campaign.toml, recordings and results, which the other commands read and write, "
    "too. Nothing leaves this machine, and nobody gets in without the address that is printed.",
    "batch": "Identify many rooms, each into a folder of its own, and write a table of all.\n\n"
    "Rooms that are done are not done again; one that fails stops no other. They are done one "
    "after the other, or by the workers of a dask cluster, or in shares by a job array.",
    "catalogue": "List common materials, or show one with the spread of its absorption and the "
    "sources.",
    "check": "Show a room's volume, surface, materials and mean free path, and name each fault.\n\n"
    "For a campaign, positions and recordings are examined, too: what could be wrong is said "
    "before anything is fitted. Exit codes: 0 fine; 1 a finding that voids the answer, or a "
    "recording or a band of no use; 2 bad input.",
    "compare": "Compare two results, as before and after a renovation: what changed, and how "
    "surely.",
    "demo": "Simulate a measured room independently of the fit's own model, and identify it.",
    "design": "Choose where to measure, so that absorption is found with the narrowest intervals.",
    "export": "Write what was found as materials of another program, or the report as PDF or Word.",
    "identify": "Find the absorption of a measured room, per material and band, with intervals.",
    "impedance": "Find the acoustic impedance of a measured room's walls over frequency, with "
    "intervals.",
    "init": "Write a first campaign.toml for a folder of recordings.\n\n"
    "Sources, receivers and measurements come from the names of the files, best where the table "
    "of positions has the same names; what is not known is marked FILL IN.",
    "listen": "Make the measured responses what they would be after a change of materials, as WAV "
    "files.\n\nEvery band is scaled over time by the ratio of the predicted energies after to "
    "before.",
    "measure": "Measure an impulse response: play sweeps, record them, and say whether it is "
    "enough.\n\nThe response becomes FOLDER/SOURCE_RECEIVER.wav, of which roomfit init makes a "
    "campaign. Exit codes: 0 it suffices for T20 from 125 Hz to 4 kHz; 1 it is written, and better "
    "measured again; 2 bad input, or nothing of use was recorded.",
    "paper": "Repeat the paper's figures, Table 2 and searches in its reconstructed room.",
    "predict": "Predict reverberation and clarity with their intervals, as the room is or changed.",
    "reverberation": "Find the mean absorption of a room from decay times, where no position is "
    "known.\n\nBy Sabine, Eyring, Arau-Puchades and Fitzroy, with intervals, and split over "
    "materials by their priors.",
    "schema": "Print the JSON schema of campaign files, or of treatment files.\n\n"
    "Editors complete and check keys by it: roomfit schema > campaign.schema.json, and write "
    "#:schema ./campaign.schema.json as the first line of the campaign.",
    "treat": "Choose what to hang where, so that targets are met, and how likely they then are.",
}

_DECLARE: dict[str, Callable[[Parser], None]] = {
    "app": _app,
    "batch": _batch,
    "catalogue": _catalogue,
    "check": _check,
    "compare": _compare,
    "demo": _demo,
    "design": _design,
    "export": _export,
    "identify": _identify,
    "impedance": _impedance,
    "init": _init,
    "listen": _listen,
    "measure": _measure,
    "paper": _paper,
    "predict": _predict,
    "reverberation": _reverberation,
    "schema": _schema,
    "treat": _treat,
}
