"""``roomfit cache``: intermediate results that are kept for later runs."""

from __future__ import annotations

import argparse
from pathlib import Path

from roomfit.cli.arguments import Commands, add_command, number
from roomfit.cli.terminal import say

_GB = 1e9


def add(commands: Commands) -> None:
    about = (
        "Show where intermediate results are kept, how large they are and of what kind.\n\n"
        "ROOMFIT_CACHE=FOLDER in the environment moves them, ROOMFIT_CACHE=off keeps none."
    )
    parser = add_command(commands, "cache", about, run)
    parser.add_argument("--clear", action="store_true", help="Remove all of them.")
    parser.add_option(
        "--limit", "The most GB that they may take, from now on; the oldest go.", type=number
    )


def run(options: argparse.Namespace) -> None:
    from roomfit.base.arguments import check_range
    from roomfit.base.cache import Cache, cache_files, limited, make_room, user_cache

    if options.limit is not None:
        check_range("the limit", options.limit, 0.0, 1e6, "GB", "--limit")
    cache = user_cache()
    if cache is None:
        say("no cache: ROOMFIT_CACHE is off, or this user has no home")
        return
    if options.limit is not None:
        cache = limited(cache, round(options.limit * _GB))
    if options.clear:
        make_room(Cache(cache.folder, 0), 0)
    sizes: dict[str, list[int]] = {}
    for path, status in cache_files(cache):
        sizes.setdefault(path.name.rpartition("-")[0], []).append(status.st_size)
    total = sum(map(sum, sizes.values()))
    say(f"{_folder(cache.folder)}: {_size(total)} of at most {_size(cache.limit_bytes)}")
    for kind, own in sorted(sizes.items()):
        say(f"  {kind:<8} {len(own):>5}  {_size(sum(own))}")


def _folder(folder: Path) -> str:
    return str(folder) if folder.exists() else f"{folder} (made when there is something to keep)"


def _size(n_bytes: int) -> str:
    return f"{n_bytes / _GB:.2f} GB" if n_bytes >= _GB else f"{n_bytes / 1e6:.1f} MB"
