"""``roomfit measure``: an impulse response, by the sound devices of this machine."""

from __future__ import annotations

import argparse
import shlex
import sys
from pathlib import Path

from roomfit.cli.arguments import Commands, add_command, number, positive_number
from roomfit.cli.terminal import say


def add(commands: Commands) -> None:
    about = (
        "Measure an impulse response: play sweeps, record them, and say whether it is enough.\n\n"
        "The response becomes FOLDER/SOURCE_RECEIVER.wav, of which roomfit init makes a campaign. "
        "Exit codes: 0 it suffices for T20 from 125 Hz to 4 kHz; 1 it is written, and better "
        "measured again; 2 bad input, or nothing of use was recorded."
    )
    parser = add_command(commands, "measure", about, run)
    parser.add_argument("folder", type=Path, nargs="?", help="Of the recordings; made if needed.")
    parser.add_option("--source", "Name of the source, such as S1.")
    parser.add_option("--receiver", "Name of the receiver, such as R1.")
    parser.add_option("--seconds", "Length of one sweep.", type=number, default=6)
    parser.add_option("--silence", "Seconds after each sweep.", type=number, default=3)
    parser.add_option("--repetitions", "How many sweeps.", type=positive_number, default=3)
    parser.add_option("--rate", "Sampling rate in Hz.", type=number, default=48000)
    parser.add_option("--device", "To record with and play by: its number, or part of its name.")
    parser.add_option("--output", "To play by, where that is another device.")
    parser.add_argument("--again", action="store_true", help="Replace the response of this pair.")
    parser.add_argument("--list", action="store_true", help="Name the sound devices, and end.")


def run(options: argparse.Namespace) -> None:
    from roomfit.base.errors import InputError
    from roomfit.cli.commands import measure_to_folder
    from roomfit.files.responses.sweep import SweepPlan
    from roomfit.files.sound_card import SoundCard, devices_text, sounddevice

    if options.list:
        say(devices_text(sounddevice()))
        return
    folder, source, receiver = options.folder, options.source, options.receiver
    if folder is None or source is None or receiver is None:
        raise InputError(
            "a measurement needs a folder and two names",
            found=shlex.join(sys.argv[1:]),
            needed="roomfit measure FOLDER --source S1 --receiver R1",
            hint="roomfit measure --help",
        )
    plan = SweepPlan(options.rate, options.seconds, options.silence, options.repetitions)
    card = SoundCard(sounddevice(), _device(options.device), _device(options.output))
    say(f"playing and recording for {plan.length_s:.0f} s: keep still")
    sys.stdout.flush()
    measured = measure_to_folder(folder, source, receiver, plan, card, again=options.again)
    say(f"{measured}\n\n{source} to {receiver} is in {folder}")
    say(
        'The devices delay each recording by another time: write time_zero = "direct" under '
        "[defaults] of the campaign."
    )
    if measured.again:
        sys.exit(1)


def _device(text: str | None) -> str | int | None:
    return int(text) if text is not None and text.isdecimal() else text
