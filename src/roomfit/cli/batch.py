"""``roomfit batch``: many rooms, one table."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from roomfit.batch.cluster import cluster_client
from roomfit.batch.rooms import campaign_paths, identify_rooms, rooms_text
from roomfit.cli.terminal import say
from roomfit.identify import compile_kernels
from roomfit.report.progress import shown_progress


def run(options: argparse.Namespace) -> None:
    paths, out = campaign_paths(options.campaigns), Path(options.out)
    with shown_progress("identifying rooms") as progress:
        if options.workers is None and options.scheduler is None:
            rows = identify_rooms(
                paths, out, shard=options.shard, quick=options.quick, progress=progress
            )
        else:
            with cluster_client(
                scheduler=options.scheduler,
                n_workers=options.workers or 1,
                warm=compile_kernels,
            ) as client:
                rows = identify_rooms(
                    paths, out, client=client, quick=options.quick, progress=progress
                )
    say(rooms_text(rows))
    say(f"\nrooms.html, rooms.csv and a folder of each room are in {out}")
    if any(row.status in ("refused", "failed") for row in rows):
        sys.exit(2)
