"""The arguments of every command: a wrong call is an `InputError` that names the nearest word.

Each is one of the function that carries the command out; ``roomfit --help`` loads no numerical
package.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Sequence
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
    for name, (call, about, *arguments) in _COMMANDS.items():
        own = commands.add_parser(
            name, help=about.partition("\n")[0], description=about, allow_abbrev=False
        )
        own.set_defaults(call=call)
        for one in (_HOW_MUCH, *arguments):
            # arguments of which one excludes the others are a list
            target = own.add_mutually_exclusive_group() if isinstance(one, list) else own
            for words, settings in one if isinstance(one, list) else [one]:
                target.add_argument(*words.split(), **settings)
    return parser, dict(commands.choices)


# ---------------------------------------------------------------- values


def _as(kind: Callable[[str], Any], words: str) -> Callable[[str], Any]:
    def read(text: str) -> Any:
        try:
            return kind(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"{text!r} is not {words}") from None

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


# ---------------------------------------------------------------- what several commands take

_Argument = tuple[str, dict[str, Any]]  # its names, and what `argparse` takes


def _value(names: str, text: str, **settings: Any) -> _Argument:
    """Return an argument with a value; `text` gets the default behind it."""
    if settings.get("default") and not isinstance(settings["default"], tuple | list | Path):
        text = f"{text.removesuffix('.')} (default: {settings['default']})."
    return names, {"help": text, **settings}


def _path(names: str, text: str, **settings: Any) -> _Argument:
    return _value(names, text, type=Path, **settings)


def _campaign(text: str) -> _Argument:
    return _path("campaign_file", text, metavar="campaign")


def _flag(names: str, text: str) -> _Argument:
    return names, {"help": text, "action": "store_true"}


def _out(text: str = "Folder for the results; made if needed.", **settings: Any) -> _Argument:
    return _path("--out", text, **{"required": True, **settings})


_HOW_MUCH = [
    _flag("-q --quiet", "On standard error, show errors only."),
    _flag("-v --verbose", "Show the details of stages."),
]
_CAMPAIGN = _campaign("Campaign file (TOML).")
_OUT, _OVERWRITE = _out(), _flag("--overwrite", "Write into a folder that is not empty.")
_PNG = _flag("--png", "Write pictures as PNG, too, beside SVG.")
_EDITED = _flag("--edited", "Read a result that was edited since roomfit wrote it.")
_THREADS = _value(
    "--threads",
    "Cores to use at most; left out: ROOMFIT_THREADS of the environment, or all.",
    type=positive_number,
)
_A_RESULT = "result.json or absorption.csv of a fit."
_FIT_OR_LESS = _path(
    "--absorption",
    f"{_A_RESULT} Left out: by the campaign's decay times, or by its priors alone.",
    dest="absorption_file",
)
_CHANGES = _value(
    "--set",
    "What if: MATERIAL=0.3, 0.3+-0.05, one value per band, x1.5+-0.2, another material of the "
    "room, or a name of the catalogue. May be given several times.",
    dest="changes", metavar="CHANGE", action="append", default=[],
)  # fmt: skip
_STATE = _value(
    "--state", "State of the room among the campaign's [[states]]; left out: as described.",
    default="",
)  # fmt: skip
_DOUBTED = _flag(
    "--doubted", "Predict changes and other states also where the result is seriously doubted."
)
_PAIRS = _value(
    "--pairs",
    "all: every source with every receiver; campaign: the measured ones.",
    default="all",
)


# ---------------------------------------------------------------- the commands

# The function that carries it out, in which module, with the words of its progress and of where its
# files are; what it is for, the first line alone in the list of commands; and its arguments.
_COMMANDS: dict[str, tuple[Any, ...]] = {
    "app": (
        ("app.jobs.serve_folder", "", ""),
        "Work on a project in the browser: room, measurements, absorption, what if, report.\n\n"
        "FOLDER holds campaign.toml, recordings and results, which the other commands read and "
        "write, too. Nothing leaves this machine, and nobody gets in without the address that is "
        "printed.",
        _path("folder", "Of the project; made if needed.", nargs="?", default=Path()),
        _value("--port", "To listen at; 0: any. Left out: 8321, or the next free.", type=whole),
        _value(
            "--host", "Address to listen at; others than this may reach it.", default="127.0.0.1"
        ),
        _flag("--no-browser", "Print the address; open no browser."),
    ),
    "batch": (
        ("batch.rooms.batch_to_folder", "identifying rooms",
         "rooms.html, rooms.csv and a folder of each room are in {out}"),
        "Identify many rooms, each into a folder of its own, and write a table of all.\n\n"
        "Rooms that are done are not done again; one that fails stops no other. They are done one "
        "after the other, or by the workers of a dask cluster, or in shares by a job array.",
        _value("campaigns", "Campaign files (TOML), or patterns as 'rooms/*/campaign.toml'.",
               nargs="+"),
        _out("Folder for the table and a folder of each room; made if needed."),
        _flag("--quick", "First answers, as identify --quick; beside full ones, which another run "
              "gives."),
        [
            _value("--workers", "Processes of this machine.", type=positive_number),
            _value("--scheduler", "Address of a running dask scheduler, as tcp://10.0.0.1:8786 "
                   "(needs the extra cluster). Campaigns and results must have the same paths on "
                   "all its workers.", metavar="ADDRESS"),
            _value("--shard", "Only every N-th room from the I-th on, for job arrays: 3/10 is the "
                   "third of ten.", metavar="I/N", type=_as(_both, "I/N, as 3/10"), default=(1, 1)),
        ],
    ),
    "catalogue": (
        ("report.check.materials_text", "", ""),
        "List common materials, or show one with the spread of its absorption and the sources.",
        _value("words", "Name of a material to show, or words to search for.", nargs="*"),
    ),
    "check": (
        ("cli.check.check", "", ""),
        "Show a room's volume, surface, materials and mean free path, and name each fault.\n\n"
        "For a campaign, positions and recordings are examined, too: what could be wrong is said "
        "before anything is fitted. Exit codes: 0 fine; 1 a finding that voids the answer, or a "
        "recording or a band of no use; 2 bad input.",
        _path("room", "Room file, such as room.obj, or a campaign file (.toml)."),
        _value("--unit", "m, mm, cm, ft or in; needed where the format does not state it."),
        _value("--up", "Axis that points up: z or y.", choices=("z", "y")),
        _value("--bands", "Of a campaign: bands to examine, as 500-2000, in place of from_hz and "
               "to_hz.", type=number_range, dest="between_hz"),
        _out("Of a campaign: folder for a picture of room and positions.", required=False),
        _OVERWRITE, _PNG,
        _value("--remedy", "Of a campaign: write into it what the findings of CODE advise; CODE:2 "
               "the second choice.", metavar="CODE"),
        _path("--result", "With --remedy: of the findings of this answer, a folder."),
        _flag("--undo", "Of a campaign: take the last remedy back."),
    ),
    "compare": (
        ("report.comparison.compare_to_folder", "", "compared.csv is in {out}"),
        "Compare two results, as before and after a renovation: what changed, and how surely.",
        _path("first", _A_RESULT),
        _path("second", "That of another."),
        _out("Folder for the table as compared.csv; made if needed.", required=False),
        _EDITED, _OVERWRITE,
    ),
    "demo": (
        ("cli.demo.demo", "simulating and identifying",
         "The campaign is in {out}/campaign, result and pictures in {out}/result."),
        "Simulate a measured room independently of the fit's own model, and identify it.",
        _path("--out", "Folder for the campaign and its results (default: roomfit-demo).",
              default=Path("roomfit-demo")),
        _value("--seed", "Of the positions, levels and noise drawn.", type=whole, default=1),
        _THREADS, _OVERWRITE, _PNG,
    ),
    "design": (
        ("cli.treat.design_to_folder", "choosing where to measure",
         "design.json, design.csv and pictures are in {out}"),
        "Choose where to measure, so that absorption is found with the narrowest intervals.",
        _campaign("Campaign file (TOML); it need not have a measurement."),
        _OUT,
        _value("--candidates", "Pairs of source and receiver to choose from.", type=whole,
               default=200, dest="n_candidates"),
        _value("--choose", "How many (default: 6, or 1 after a fit).", type=whole,
               dest="number"),
        _value("--sources", "How many different sources at most.", type=whole,
               dest="most_sources"),
        _value("--criterion", "What is to become small: determinant, mean or worst."),
        _path("--result", "result.json of a fit: what to measure next."),
        _THREADS, _EDITED, _OVERWRITE, _PNG,
    ),
    "export": (
        ("cli.export.export", "", ""),
        "Write what was found as materials of another program, or the report as PDF or Word.",
        _path("result", _A_RESULT),
        _value("--format", "catt, odeon, isimpa, pyroomacoustics, csv, excel, budget (of the "
               "uncertainty, CSV), or pdf or word (the report).", required=True),
        _out("File to write."),
        _value("--scattering", "For all materials, where the result does not specify it.",
               type=number),
        _EDITED,
        _flag("--overwrite", "Replace what exists."),
    ),
    "identify": (
        ("cli.identify.run", "",
         "report.html, result.json, absorption.csv and, unless --quick, pictures are in {out}"),
        "Find the absorption of a measured room, per material and band, with intervals.",
        _CAMPAIGN, _OUT,
        _value("--bands", "Bands to fit, as 500-2000, in place of from_hz and to_hz of the "
               "campaign.", type=number_range, dest="between_hz"),
        _flag("--quick", "A first answer: no search for faults of files, positions and chain, no "
              "pictures."),
        _THREADS, _OVERWRITE, _PNG,
    ),
    "impedance": (
        ("impedance.campaign.impedance_to_folder", "identifying impedances",
         "result.json and impedance.csv are in {out}"),
        "Find the acoustic impedance of a measured room's walls over frequency, with intervals.",
        _CAMPAIGN, _OUT, _OVERWRITE,
    ),
    "init": (
        ("cli.init.init", "", ""),
        "Write a first campaign.toml for a folder of recordings.\n\n"
        "Sources, receivers and measurements come from the names of the files, best where the "
        "table of positions has the same names; what is not known is marked FILL IN.",
        _path("folder", "Folder of the campaign to be."),
        _path("--room", "Room (.obj, .ply, .stl, .glb, .geo, .dxf, .dae, .ifc, .skp, .usdz, "
              ".json)."),
        _value("--shoebox", "In place of a room file: lengths along x, y, z in m, or in --unit.",
               nargs=3, type=number, metavar=("X", "Y", "Z")),
        _value("--space", "Which room of a building model (.ifc) or a scan (.json) of several."),
        _value("--recordings", "Names of recordings in FOLDER, as in "
               "'DIR/{source}_{receiver}.wav'. Left out: all."),
        _path("--positions", "Table (CSV, XLSX) of name, x, y, z in m, or as its heading says."),
        _path("--decay-times", "In place of recordings: table (CSV, XLSX) of T30 in s, as from an "
              "older report."),
        _value("--unit", "Of the room: m, cm, mm, in or ft. Left out: guessed, or asked."),
        _value("--up", "Axis that points up in the room file: z or y. Left out: guessed.",
               choices=("z", "y")),
        _flag("--overwrite", "Replace a campaign.toml that is there."),
    ),
    "listen": (
        ("cli.listen.listen_to_folder", "listening", "WAV files and listen.json are in {out}"),
        "Make the measured responses what they would be after a change of materials, as WAV "
        "files.\n\nEvery band is scaled over time by the ratio of the predicted energies after to "
        "before.",
        _campaign("Campaign file (TOML) of the measured room."),
        _path("--absorption", _A_RESULT, required=True, dest="absorption_file"),
        _EDITED, _OUT, _CHANGES, _STATE, _DOUBTED,
        _path("--dry", "A WAV file of one channel, at the responses' rate, to convolve."),
        _OVERWRITE,
    ),
    "measure": (
        ("cli.measure.measure", "", ""),
        "Measure an impulse response: play sweeps, record them, and say whether it is enough.\n\n"
        "The response becomes FOLDER/SOURCE_RECEIVER.wav, of which roomfit init makes a campaign. "
        "Exit codes: 0 it suffices for T20 from 125 Hz to 4 kHz; 1 it is written, and better "
        "measured again; 2 bad input, or nothing of use was recorded.",
        _path("folder", "Of the recordings; made if needed.", nargs="?"),
        _value("--source", "Name of the source, such as S1."),
        _value("--receiver", "Name of the receiver, such as R1."),
        _value("--seconds", "Length of one sweep.", type=number, default=6),
        _value("--silence", "Seconds after each sweep.", type=number, default=3, dest="silence_s"),
        _value("--repetitions", "How many sweeps.", type=positive_number, default=3),
        _value("--rate", "Sampling rate in Hz.", type=number, default=48000,
               dest="sampling_rate_hz"),
        _value("--device", "To record with and play by: its number, or part of its name."),
        _value("--output", "To play by, where that is another device."),
        _flag("--again", "Replace the response of this pair."),
        _flag("--list", "Name the sound devices, and end."),
    ),
    "paper": (
        ("paper.output.run_paper", "repeating the paper",
         "paper.json, table2.csv and pictures are in {out}."),
        "Repeat the paper's figures, Table 2 and searches in its reconstructed room.",
        _out("Folder for paper.json, table2.csv, pictures."),
        _value("--seeds", "Searches of every problem by every method.", type=positive_number,
               default=10),
        _OVERWRITE,
    ),
    "predict": (
        ("cli.predict.predict_to_folder", "predicting",
         "predicted.html, .json, .csv and pictures (maps and grid.csv of a grid) are in {out}"),
        "Predict reverberation and clarity with their intervals, as the room is or changed.",
        _campaign("Campaign file (TOML) of the room to predict."),
        _FIT_OR_LESS, _EDITED, _OUT, _PAIRS, _CHANGES, _STATE, _DOUBTED,
        _value("--grid", "Maps over the room in place of its receivers: HEIGHT,SPACING in m, as "
               "1.2,0.5.", metavar="H,S", type=_grid, dest="grid_m"),
        _THREADS, _OVERWRITE, _PNG,
    ),
    "reverberation": (
        ("cli.predict.reverberation", "",
         "reverberation.html, reverberation.csv and result.json are in {out}"),
        "Find the mean absorption of a room from decay times, where no position is known.\n\n"
        "By Sabine, Eyring, Arau-Puchades and Fitzroy, with intervals, and split over materials by "
        "their priors.",
        _campaign("Campaign file (TOML) with [reverberation]."),
        _out("Folder for a page and a table; made if needed.", required=False),
        _OVERWRITE,
    ),
    "schema": (
        ("treat.campaign.schema_text", "", ""),
        "Print the JSON schema of campaign files, or of treatment files.\n\n"
        "Editors complete and check keys by it: roomfit schema > campaign.schema.json, and write "
        "#:schema ./campaign.schema.json as the first line of the campaign.",
        _value("--of", "campaign, or treatment.", default="campaign"),
    ),
    "treat": (
        ("cli.treat.treat_to_folder", "choosing what to hang",
         "treatment.html, .json, .csv and pictures are in {out}"),
        "Choose what to hang where, so that targets are met, and how likely they then are.",
        _campaign("Campaign file (TOML) of the room."),
        _path("treatment_file", "Surfaces, products and targets (TOML).", metavar="treatment"),
        _FIT_OR_LESS, _EDITED, _OUT, _PAIRS, _STATE, _DOUBTED, _THREADS, _OVERWRITE, _PNG,
    ),
}  # fmt: skip
