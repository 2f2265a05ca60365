"""Many rooms: each is identified into a folder of its own, and one table shows them all.

A room's folder carries the digest of all that decides its answer, the version of roomfit included,
and comes into being whole. A run that was stopped goes on where it was, a room that is done twice
does no harm, and one that fails stops no other.
"""

from __future__ import annotations

import glob
import hashlib
import json
import logging
import os
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal, NamedTuple
from urllib.parse import quote

import numba
import numpy as np

from roomfit.base import whole_files
from roomfit.base.door import complete
from roomfit.base.errors import FolderInUseError, InputError, RoomfitError, StoreError
from roomfit.base.kernels import keep_one_blas_thread
from roomfit.base.table import Cell, Column, Table, Value, csv_of, written
from roomfit.base.typing import Progress
from roomfit.batch.cluster import in_processes, on_cluster
from roomfit.cli.identify import identify_to_folder
from roomfit.files.campaign import input_files, read_campaign
from roomfit.files.encoding import input_digests, written_content
from roomfit.files.results import check_disk_room, read_result_content
from roomfit.identify import compile_kernels
from roomfit.report.blocks import Blocks, Sentence
from roomfit.report.html import page
from roomfit.report.tables import mean_decay_times
from roomfit.report.text import text
from roomfit.report.wording import Series, count, in_file_name, mid_mean
from roomfit.result import Compared, ComparedPair

_LOG = logging.getLogger("roomfit")

# "elsewhere": another run is at it, so that this one has left it
Status = Literal["done", "refused", "failed", "waiting", "elsewhere"]
ROOMS, FAILURES = "rooms", "failures"
_ELSEWHERE = "another run is identifying this room"
_COMPARED = ("measured", "predicted", "mean_of_others", "jnd")
_COLUMNS: tuple[str | Column, ...] = (
    *("room", "status", "result", "identifiable", "values"),
    *(Column(f"room_mean_{name}", ".4f") for name in ("absorption", "lower95", "upper95")),
    *("decay_time", Column("T_measured_s", ".3f"), Column("T_predicted_s", ".3f")),
    *(Column("largest_reduced_chi_square", ".2f"), "findings", Column("seconds", ".1f"), "message"),
)


class RoomTask(NamedTuple):
    """A campaign of a batch, and where its answer lies."""

    name: str
    campaign: Path
    address: str  # name of the result's folder; "" where the campaign could not be read
    refusal: str = ""  # why it could not


class RoomRow(NamedTuple):
    """What the table says of a room."""

    name: str
    status: Status
    folder: str = ""  # of the result, relative to that of the batch
    message: str = ""  # why there is no answer
    identifiable: int = 0
    values: int = 0  # materials times bands
    mean: tuple[float, float, float] = (np.nan, np.nan, np.nan)  # of 500 and 1000 Hz, with bounds
    decay: tuple[str, float, float] = ("", np.nan, np.nan)  # there: of which T, measured, predicted
    chi2_reduced: float = np.nan  # the largest
    findings: tuple[str, ...] = ()  # codes above "info"
    seconds: float = np.nan


def campaign_paths(patterns: Sequence[str | Path]) -> tuple[Path, ...]:
    """Return the campaign files that paths and patterns (``*``, ``?``, ``**``) name, each once."""
    found: list[Path] = []
    for pattern in patterns:
        word = str(pattern)
        is_pattern = glob.has_magic(word) and not Path(word).exists()
        matches = sorted(glob.glob(word, recursive=True)) if is_pattern else [word]  # noqa: PTH207 -- may be absolute
        if not matches:
            what = "no campaign file is called so"
            needed = "a pattern that matches a file, relative to this folder"
            hint = 'put the pattern in quotation marks, as "rooms/*/campaign.toml"'
            raise InputError(what, found=repr(word), needed=needed, hint=hint)
        found += [Path(m).absolute() for m in matches]
    return tuple(dict.fromkeys(found))


def room_tasks(campaigns: Sequence[Path], *, quick: bool = False) -> tuple[RoomTask, ...]:
    """Return the tasks of a batch, in the order of the campaigns.

    First answers have addresses of their own: none is taken for a full one. Names are what differs
    between the paths. A campaign that cannot be read has its refusal in
    place of an address.
    """
    paths = [Path(c).absolute() for c in campaigns]
    above = Path(os.path.commonpath([p.parent for p in paths])) if paths else Path()
    same_file = len({p.name for p in paths}) == 1 and len(paths) > 1
    tasks = []
    for path in paths:
        inner = path.parent if same_file else path.with_suffix("")
        name = inner.relative_to(above).as_posix()
        try:
            files = input_files(read_campaign(path))
            kind = "batch, first answers" if quick else "batch"
            decisive = json.dumps([version("roomfit"), kind, input_digests(files)])
            address = hashlib.sha256(decisive.encode()).hexdigest()
        except RoomfitError as error:
            tasks.append(RoomTask(name, path, "", str(error)))
        else:
            tasks.append(RoomTask(name, path, f"{in_file_name(name)}-{address[:12]}"))
    return tuple(tasks)


def shard_of(tasks: Sequence[RoomTask], shard: tuple[int, int]) -> tuple[RoomTask, ...]:
    """Return every n-th task from the i-th on, i and n from 1: the share of one job of an array."""
    i, n = shard
    if not 1 <= i <= n:
        what = "the shard is out of range"
        needed = "i/n with 1 <= i <= n: 3/10 is the third of ten jobs"
        raise InputError(what, found=f"{i}/{n}", needed=needed, hint=f"--shard 1/{max(n, 1)}")
    return tuple(tasks[i - 1 :: n])


def identify_rooms(
    campaigns: Sequence[Path],
    out: Path,
    *,
    carry_out: partial[Iterator[Any]] | None = None,
    shard: tuple[int, int] = (1, 1),
    quick: bool = False,
    progress: Progress | None = None,
) -> tuple[RoomRow, ...]:
    """Identify the rooms of many campaigns and write ``rooms.csv`` and ``rooms.html``.

    Rooms that are done already, with the same files and the same roomfit, are not done again; those
    that failed are. A room that fails stops no other, and one that another run is identifying is
    left to it.

    `out`: A folder, made if needed; it may hold results of this and of other batches. With several
    machines all of them must reach it, and the campaigns, by the same paths. `carry_out`: of
    `roomfit.batch.cluster`; by default one room after the other in this process. `shard`: i and n:
    only every n-th room from the i-th is identified; the table shows all. `quick`: first answers,
    see `Settings.quick`; the next run without it gives the full ones.

    The result is Of all campaigns, in their order.
    """
    out, tasks = Path(out).absolute(), room_tasks(campaigns, quick=quick)
    own = shard_of(tasks, shard)
    missing = [t for t in own if t.address and not (out / ROOMS / t.address).exists()]
    # of one pair at least; the room itself knows of how many
    check_disk_room(out, len(missing), len(missing))
    for name in (ROOMS, FAILURES):
        whole_files.make_folder(out / name)
    jobs = [
        partial(identify_room, t.campaign, out / ROOMS / t.address, quick=quick) for t in missing
    ]
    elsewhere: set[str] = set()
    ends = _ends(jobs, carry_out)
    try:
        for n_done, (number, (status, message)) in enumerate(ends, start=1):
            _LOG.info("%s: %s", missing[number].name, status)
            address = missing[number].address
            record = out / FAILURES / f"{address}.json"
            # why a room has no answer, for the tables of other runs
            if status == "done":
                record.unlink(missing_ok=True)
            elif status == "elsewhere":
                elsewhere.add(address)
            else:
                whole_files.write_json_atomically(record, {"status": status, "message": message})
            if progress is not None:
                progress(n_done / len(jobs))
    except KeyboardInterrupt:
        ends.close()
        for task in missing:
            with suppress(FolderInUseError):
                _clear(out / ROOMS / task.address)
        raise
    finally:
        rows = tuple(
            RoomRow(task.name, "elsewhere", message=_ELSEWHERE)
            if row.status == "waiting" and task.address in elsewhere
            else row
            for task, row in ((task, room_row(out, task)) for task in tasks)
        )
        _write_table(out, rows)
    return rows


@whole_files.sole_writer
def _clear(out: Path) -> None:
    """Remove what a process that was ended has left beside a folder, as every writer does."""


def identify_room(
    campaign: Path, folder: Path, *, quick: bool = False, alone: bool = True
) -> tuple[Status, str]:
    """Identify one room into a folder; return how it ended, and why there is no answer.

    Where the folder has come into being meanwhile, by whomever, it stays as it is. Not `alone`,
    others have the other processors, and linear algebra and kernels keep to one thread. The disk's
    errors are raised: it would be the same for every room.
    """
    if not alone:
        keep_one_blas_thread()
        numba.set_num_threads(1)
    try:
        identify_to_folder(campaign, folder, quick=quick)
    except StoreError:
        raise
    except FolderInUseError:
        return "elsewhere", _ELSEWHERE
    except RoomfitError as error:
        return ("done", "") if folder.exists() else ("refused", str(error))
    except Exception as error:  # noqa: BLE001 -- a fault in one room must not stop the others
        return "failed", f"{type(error).__name__}: {error}"
    return "done", ""


def _ends(
    jobs: Sequence[Callable[..., tuple[Status, str]]], carry_out: partial[Iterator[Any]] | None
) -> Generator[tuple[int, tuple[Status, str]], None, None]:
    """Do all jobs, here or in other processes; yield the number and the end of each."""
    if carry_out is None:
        yield from ((number, job()) for number, job in enumerate(jobs))
        return
    for number, end in carry_out([partial(job, alone=False) for job in jobs]):
        if isinstance(end, StoreError):
            raise end
        own = "" if isinstance(end, RoomfitError) else f"{type(end).__name__}: "
        # workers that died, or could not begin
        yield number, ("failed", f"{own}{end}") if isinstance(end, Exception) else end


def room_row(out: Path, task: RoomTask) -> RoomRow:
    """Return what the files of a batch say of a room."""
    if not task.address:
        return RoomRow(task.name, "refused", message=task.refusal)
    folder = out / ROOMS / task.address
    if folder.exists():
        try:
            return _answered(task.name, folder, f"{ROOMS}/{task.address}")
        except InputError as error:
            return RoomRow(task.name, "failed", message=f"{error}\n  remove the folder {folder}")
    failure = out / FAILURES / f"{task.address}.json"
    if not failure.exists():
        return RoomRow(task.name, "waiting")
    what = "record of a failure"
    try:
        content, _ = written_content(failure, what)
        with complete(what, "status and message, as roomfit writes them"):
            status: Status = "refused" if content["status"] == "refused" else "failed"
            return RoomRow(task.name, status, message=str(content["message"]))
    except InputError as error:
        return RoomRow(task.name, "failed", message=f"{error}\n  run it again, or remove {failure}")


def _answered(name: str, folder: Path, shown: str) -> RoomRow:
    path = folder / "result.json"
    content, _ = read_result_content(path)
    with complete("result", "a result.json as roomfit writes it"):
        centres_hz = np.array(content["bands_hz"], dtype=np.float64)
        sure = np.array([m["identifiable"] for m in content["materials"].values()], dtype=bool)
        means = {c["band_hz"]: c for c in content["combinations"] if c["kind"] == "mean"}
        keys = ("absorption", "lower95", "upper95")
        rows = (np.array([means[f][key] for f in centres_hz.tolist()]) for key in keys)
        nothing = "", *np.full((2, len(centres_hz)), np.nan)
        pairs = [_pair(own) for own in content["pairs"]]
        symbol, measured, predicted = mean_decay_times(pairs) or nothing
        codes = [f["code"] for f in content["findings"] if f["severity"] != "info"]
        return RoomRow(
            name,
            "done",
            shown,
            identifiable=int(sure.sum()),
            values=int(sure.size),
            mean=Series("", *rows).mid_s(centres_hz),
            decay=(symbol, mid_mean(centres_hz, measured), mid_mean(centres_hz, predicted)),
            chi2_reduced=max((x for x in content["fit"]["phi"] if x is not None), default=np.nan),
            findings=tuple(dict.fromkeys(codes)),
            seconds=float(content["fit"]["seconds"]),
        )


def _pair(own: Mapping[str, Any]) -> ComparedPair:
    """Return a pair of a ``result.json``; null becomes NaN."""
    found = {
        name: Compared(*(np.array(p[key], dtype=np.float64) for key in _COMPARED))
        for name, p in own["parameters"].items()
    }
    return ComparedPair(own["source"], own["receiver"], own["use"], found, None)


def _write_table(out: Path, rows: Sequence[RoomRow]) -> None:
    """Write ``rooms.csv`` and ``rooms.html``, whole."""
    records = []
    for row in rows:
        report = f"{row.folder}/report.html" if row.folder else ""
        numbers = (row.identifiable, row.values, *row.mean, *row.decay, row.chi2_reduced)
        findings, message = " ".join(row.findings), " ".join(row.message.split())
        records.append((row.name, row.status, report, *numbers, findings, row.seconds, message))
    whole_files.write_text_atomically(out / "rooms.csv", csv_of(Table("", _COLUMNS, records)))
    whole_files.write_text_atomically(out / "rooms.html", page(described(rows)))


def described(rows: Sequence[RoomRow]) -> Blocks:
    """Return how many rooms are done and how many are not, and a table of all."""
    kinds: tuple[Status, ...] = ("done", "refused", "failed", "waiting", "elsewhere")
    numbers = [(sum(r.status == kind for r in rows), kind) for kind in kinds]
    lead = (
        f"{count(len(rows), 'room')}: " + ", ".join(f"{n} {kind}" for n, kind in numbers if n) + "."
    )
    shown: list[Sequence[Value]] = []
    for row in rows:
        mean, lower, upper = row.mean
        link = quote(f"{row.folder}/report.html") if row.folder else ""
        status = Cell(row.status, tuple(row.message.splitlines()), link=link)
        values = f"{row.identifiable} of {row.values}" if row.values else ""
        bounds = (f"{lower:.2f} to {upper:.2f}",) if np.isfinite(lower) else ()
        symbol, measured, predicted = row.decay
        times = Cell(written(measured, ".2f"), (symbol,) if symbol else ()), predicted
        cells = (status, values, Cell(written(mean, ".2f"), bounds), *times, row.chi2_reduced)
        shown.append((row.name, *cells, Cell("", row.findings)))
    columns = (
        *("Room", "Status", "Identifiable\nvalues"),
        "Mean absorption of the\nroom, mid frequencies",
        *("Decay time there,\nmeasured, s", "predicted, s"),
        *("Largest reduced\nchi-square", "Findings"),
    )
    table = Table("Every room with its key figures", columns, shown, form=".2f")
    return Blocks("Rooms", (Sentence(lead, "lead"), table), ())


def batch_to_folder(
    campaigns: Sequence[str],
    out: Path,
    *,
    workers: int | None,
    scheduler: str | None,
    shard: tuple[int, int],
    quick: bool,
    progress: Progress,
) -> tuple[str, int]:
    """Identify rooms, here or on a cluster; return the table, and 2 where one has no answer."""
    paths = campaign_paths(campaigns)
    carry_out: partial[Iterator[Any]] | None = None
    if scheduler is not None:
        carry_out = partial(on_cluster, scheduler=scheduler, warm=compile_kernels)
    elif workers is not None:
        carry_out = partial(in_processes, n_workers=workers, warm=compile_kernels)
    rows = identify_rooms(
        paths, out, carry_out=carry_out, shard=shard, quick=quick, progress=progress
    )
    return text(described(rows)), 2 * any(row.status in ("refused", "failed") for row in rows)
