"""The command line: arguments in, one call into `roomfit`, an exit code out.

Exit codes: 0 done, 1 a fault of roomfit itself, 2 bad input (or an answer that the data do not
hold), 130 interrupted; ``roomfit check`` ends with 1 where recordings are in doubt. A command is a
function, whose module is imported when it is called, and a row of `roomfit.cli.arguments`.
"""

from __future__ import annotations

import argparse
import errno
import gc
import logging
import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from importlib import import_module

from roomfit.base.errors import InputError, RoomfitError, StoreError
from roomfit.cli.arguments import call_error, parsers
from roomfit.cli.terminal import drop_output, say, warn
from roomfit.report.progress import shown_progress

_INTERRUPTED = 130
_INSIST_S = 1.0


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line, by default with the arguments of this process; leave with a code."""
    # searching for objects that refer to each other took a twentieth of the processor's time
    gc.set_threshold(20_000, 20, 50)
    noted, code = list[int](), None
    try:
        with _ended_like_an_interrupt(noted):
            options = _parsed(sys.argv[1:] if arguments is None else list(arguments))
            with _shown(options), _with_threads(options):
                code = _carried_out(options)
            sys.stdout.flush()
        if noted:  # what drew or called back has swallowed it
            raise KeyboardInterrupt
    except BaseException as error:
        if not (noted or isinstance(error, KeyboardInterrupt)):
            if (code := _code_of(error)) is None:
                raise
        else:  # whatever it has become on its way
            warn("interrupted; nothing half-written was left behind")
            # Python ends by a signal after an interrupt that fell into exec (a dataclass that was
            # being made), though it has been caught; the next exec forgets it
            exec("")
            code = 128 + noted[0] if noted else _INTERRUPTED
    if code:
        sys.exit(code)


def _code_of(error: BaseException) -> int | None:
    """Return with which code an error ends the program, which it says; None for a fault."""
    if isinstance(error, RoomfitError):
        warn(error)
        return 2
    if isinstance(error, BrokenPipeError):
        drop_output(sys.stdout)  # the reader of the output (head, less) went first
        return 1
    if not isinstance(error, OSError) or error.errno not in _FULL:
        return None
    drop_output(sys.stdout)
    text = "the disk is full, or the output cannot grow"
    warn(StoreError(text, found=str(error), hint="make room, and run the command again"))
    return 2


def _carried_out(options: argparse.Namespace) -> int:
    """Call the function of a command with its options; say what it returns, and where files are."""
    no = ("call", "quiet", "verbose", "threads", "edited")
    own = {name: value for name, value in vars(options).items() if name not in no}
    place, doing, files = options.call
    if doing:  # else the command itself shows its answer
        own.pop("details", None)
    module, _, name = place.rpartition(".")
    if getattr(options, "edited", False):
        from roomfit.files.encoding import EditedFile  # needs numpy, as `text` does

        read = {"absorption_file", "result", "first", "second"} & own.keys()
        own |= {name: EditedFile(own[name]) for name in read if own[name] is not None}
    if "state" in own:
        from roomfit.files.questions import Wanted

        asked = own.keys() & {"pairs", "state", "grid_m", "doubted", "variants"}
        own["wanted"] = Wanted(**{name: own.pop(name) for name in asked})
    try:
        function = getattr(import_module(f"roomfit.{module}"), name)
        with shown_progress(doing) if doing else nullcontext() as progress:
            found = function(**own, progress=progress) if doing else function(**own)
    except ModuleNotFoundError as error:
        if "app" not in module:
            raise
        what = "the workbench needs packages that are not installed"
        found, hint = f"no module {error.name!r}", "pip install 'roomfit[app]'"
        raise InputError(what, found=found, needed="the extra app", hint=hint) from error
    said, code = found if isinstance(found, tuple) else (found, 0)
    if said is not None:
        from roomfit.report.text import shown_text

        say(shown_text(said, details=getattr(options, "details", True)))
    if files and own["out"] is not None:
        say(f"\n{files.format(**own)}")
    return int(code)


def _with_threads(options: argparse.Namespace) -> AbstractContextManager[None]:
    """Let a call take as many cores as it says, or the environment: all where neither does."""
    wanted = getattr(options, "threads", None)
    if wanted is None and "ROOMFIT_THREADS" not in os.environ:
        return nullcontext()
    from roomfit.base.kernels import at_most_threads  # needs numba, which --help must not wait for

    return at_most_threads(wanted)


@contextmanager
def _shown(options: argparse.Namespace) -> Iterator[None]:
    """Let the logger ``roomfit`` pass as much as a call asks for."""
    logger = logging.getLogger("roomfit")
    before = logger.level
    quiet, verbose = (getattr(options, name, False) for name in ("quiet", "verbose"))
    if quiet or verbose:
        logger.setLevel(logging.ERROR if quiet else logging.DEBUG)
    try:
        yield
    finally:
        logger.setLevel(before)


_FULL = (errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC))


@contextmanager
def _ended_like_an_interrupt(noted: list[int]) -> Iterator[None]:
    """Let requests to end (SIGTERM, SIGHUP) clean up as Ctrl-C does, and none of them get lost.

    Each is noted: what calls back, as matplotlib does, swallows them or makes other errors of them.
    """
    hook = sys.unraisablehook
    main, ended, before = threading.main_thread(), threading.Event(), {}

    def insist(number: int) -> None:
        # Python drops an interrupt that falls into a destructor or into the lock of an import
        while not ended.wait(_INSIST_S):
            if not isinstance(sys._current_exceptions().get(main.ident or 0), KeyboardInterrupt):
                signal.pthread_kill(main.ident or 0, number)

    def end(number: int, _: object) -> None:
        noted.append(number)
        if hasattr(signal, "pthread_kill"):
            threading.Thread(target=insist, args=(number,), daemon=True).start()
        raise KeyboardInterrupt(number)

    if threading.current_thread() is main:
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):
            number = getattr(signal, name, None)
            # nohup lets a hang-up be ignored
            usual = (signal.SIG_DFL, signal.default_int_handler)
            if number is not None and signal.getsignal(number) in usual:
                before[number] = signal.signal(number, end)
    sys.unraisablehook = lambda lost: None if noted else hook(lost)
    try:
        yield
    finally:
        sys.unraisablehook = hook
        ended.set()
        for number, handler in before.items():
            signal.signal(number, handler)


def _parsed(arguments: list[str]) -> argparse.Namespace:
    """Return the options of a command, and what carries it out as `call`."""
    parser, commands = parsers()
    if not arguments:
        sys.stdout.write(parser.format_help())
        sys.exit(2)
    name = arguments[0]
    if name.startswith("-"):
        parser.refuse_unknown_options(arguments)
        return parser.parse_args(arguments)
    if name not in commands:
        raise call_error(parser, "there is no such command", found=name, known=commands)
    commands[name].refuse_unknown_options(arguments[1:])
    return commands[name].parse_args(arguments[1:])
