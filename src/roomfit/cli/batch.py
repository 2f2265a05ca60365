"""``roomfit batch``: many rooms, one table."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from roomfit.cli.arguments import Commands, add_command, positive_number
from roomfit.cli.terminal import say
from roomfit.report.progress import shown_progress


def add(commands: Commands) -> None:
    about = (
        "Identify many rooms, each into a folder of its own, and write a table of all.\n\n"
        "Rooms that are done are not done again; one that fails stops no other. They are done one "
        "after the other, or by the workers of a dask cluster, or in shares by a job array."
    )
    parser = add_command(commands, "batch", about, run)
    parser.add_argument(
        "campaigns",
        nargs="+",
        help="Campaign files (TOML), or patterns as 'rooms/*/campaign.toml'.",
    )
    parser.add_out("Folder for the table and a folder of each room; made if needed.")
    parser.add_argument(
        "--quick",
        action="store_true",
        help="First answers, as identify --quick; beside full ones, which another run gives.",
    )
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--workers",
        type=positive_number,
        help="Processes of a cluster on this machine (needs the extra cluster).",
    )
    where.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="Address of a running dask scheduler, as tcp://10.0.0.1:8786 (needs the extra "
        "cluster). Campaigns and results must have the same paths on all its workers.",
    )
    where.add_argument(
        "--shard",
        metavar="I/N",
        type=_shard,
        default=(1, 1),
        help="Only every N-th room from the I-th on, for job arrays: 3/10 is the third of ten.",
    )


def _shard(text: str) -> tuple[int, int]:
    i, _, n = text.partition("/")
    try:
        return int(i), int(n)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not I/N, as 3/10") from None


def run(options: argparse.Namespace) -> None:
    from roomfit.base.workers import cluster_pool
    from roomfit.batch.rooms import campaign_paths, identify_rooms, rooms_text
    from roomfit.identify import compile_kernels

    paths, out = campaign_paths(options.campaigns), Path(options.out)
    with shown_progress("identifying rooms") as progress:
        if options.workers is None and options.scheduler is None:
            rows = identify_rooms(
                paths, out, shard=options.shard, quick=options.quick, progress=progress
            )
        else:
            with cluster_pool(
                scheduler=options.scheduler,
                n_workers=options.workers or 1,
                warm=compile_kernels,
            ) as pool:
                rows = identify_rooms(paths, out, pool=pool, quick=options.quick, progress=progress)
    say(rooms_text(rows))
    say(f"\nrooms.html, rooms.csv and a folder of each room are in {out}")
    if any(row.status in ("refused", "failed") for row in rows):
        sys.exit(2)
