"""``roomfit measure``: an impulse response, by the sound devices of this machine."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from roomfit.base.errors import InputError
from roomfit.base.typing import FloatArray
from roomfit.base.whole_files import make_folder, write_bytes_atomically
from roomfit.cli.terminal import say
from roomfit.files.responses import sweep
from roomfit.files.sound_card import SoundCard, sounddevice


def measure(
    *,
    folder: Path | None,
    source: str | None,
    receiver: str | None,
    device: str | None,
    output: str | None,
    again: bool,
    list: bool,  # noqa: A002 - the option's name
    **planned: Any,
) -> tuple[str, int]:
    """Measure a pair by the sound devices of this machine, or name these; see `SweepPlan`."""
    if list:
        return str(sounddevice().query_devices()) or "there is no sound device", 0
    if folder is None or source is None or receiver is None:
        what, found = "a measurement needs a folder and two names", shlex.join(sys.argv[1:])
        needed = "roomfit measure FOLDER --source S1 --receiver R1"
        raise InputError(what, found=found, needed=needed, hint="roomfit measure --help")
    plan = sweep.SweepPlan(**planned)
    own = (int(x) if x is not None and x.isdecimal() else x for x in (device, output))
    card = SoundCard(sounddevice(), *own)
    say(f"playing and recording for {plan.length_s:.0f} s: keep still")
    sys.stdout.flush()
    measured = measure_to_folder(folder, source, receiver, plan, card, again=again)
    said = (
        f"{measured}\n\n{source} to {receiver} is in {folder}\n"
        'The devices delay each recording by another time: write time_zero = "direct" under '
        "[defaults] of the campaign."
    )
    return said, 1 if measured.again else 0


def measure_to_folder(
    folder: Path,
    source: str,
    receiver: str,
    plan: sweep.SweepPlan,
    play_and_record: Callable[[FloatArray, float], tuple[FloatArray, tuple[str, ...]]],
    *,
    again: bool = False,
) -> sweep.SweepResponse:
    """Measure a pair and write its impulse response as ``SOURCE_RECEIVER.wav``, 32-bit float.

    `play_and_record`, as a `SoundCard`, takes what is played, shape (n_samples,), and its sampling
    rate in Hz; it returns what was recorded meanwhile, and what the devices report of faults.
    `again` replaces the response of this pair. `InputError`, and nothing written, where a name or
    the recording is of no use, or the pair was measured already.
    """
    path = folder / sweep.response_name(source, receiver)
    sweep.check_not_measured(path, again=again)
    recorded, reported = play_and_record(sweep.excitation(plan), plan.sampling_rate_hz)
    measured = sweep.response_from_recording(plan, recorded, reported)
    make_folder(folder)
    write_bytes_atomically(path, sweep.wav_bytes(measured.response))
    return measured
