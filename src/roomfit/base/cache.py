"""Files that are whole or absent, and a cache of intermediate results.

Every file and every output folder is written under another name and renamed when it is complete,
so that an interrupted run leaves no half of one. Intermediate results are records (dataclasses of
arrays, numbers, text and other records) in NumPy archives, named by the digest of all that they
depend on, so that a run that was interrupted continues where it stopped.
"""

from __future__ import annotations

import ctypes
import errno
import hashlib
import json
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from functools import cache, partial, wraps
from glob import escape
from importlib.metadata import version
from inspect import signature
from pathlib import Path
from typing import Any, Generic, ParamSpec, TypeVar

import numpy as np
from platformdirs import user_cache_dir

from roomfit.base.arguments import ARCHIVE_DAMAGE
from roomfit.base.errors import FolderInUseError, InputError, RoomfitError, StoreError
from roomfit.base.findings import About, Code, Finding

if sys.platform != "win32":
    import fcntl

_LIBRARIES = ("numpy", "scipy", "numba")


def digest(*parts: object) -> str:
    """Return the SHA-256 of values, in hexadecimal: the same for equal values, and only for those.

    `*parts`: what `save_record` takes. Kinds count: 1, 1.0 and True differ, as do shapes and types
    of arrays.

    Raises
    ------
    TypeError
        A value of another kind: a fault of the calling code.
    """
    outline = json.dumps(_outlined(parts, _array_digest), sort_keys=True)
    return hashlib.sha256(outline.encode()).hexdigest()


def _array_digest(array: np.ndarray[Any, Any]) -> str:
    # zeros of either sign weigh the same but are other bytes: a needless second run, no error
    content = hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest()
    return f"{array.dtype.str} {array.shape} {content}"


@cache
def code_digest() -> str:
    """Return the SHA-256 of roomfit's own code and of the versions that it computes with.

    Any change of the code may alter any number, so that all of it counts. Read once a process:
    about 20 ms.
    """
    folder = Path(__file__).parent
    files = sorted(p for p in folder.rglob("*.py") if "__pycache__" not in p.parts)
    contents = {p.relative_to(folder).as_posix(): p.read_bytes() for p in files}
    return digest(contents, {name: version(name) for name in _LIBRARIES})


_OUTLINE, CONTENT_DIGEST = "outline", "content_sha256"


class BrokenRecordError(ValueError):
    """A file that does not hold the record it should; caught by `cached`."""


def save_record(path: Path, value: object) -> None:
    """Write a record as a NumPy archive: arrays as they are, all else as one text in JSON.

    A record is None, truth values, numbers, text, bytes, arrays, members of enumerations of text,
    and dataclasses, tuples, lists and mappings (with text as keys) of these. Lists come back as
    tuples. The file is written directly, not under another name first.

    Raises
    ------
    TypeError
        A value of another kind: a fault of the calling code.
    """
    arrays: dict[str, np.ndarray[Any, Any]] = {}

    def keep(array: np.ndarray[Any, Any]) -> str:
        name = f"a{len(arrays)}"
        arrays[name] = array
        return name

    arrays[_OUTLINE] = np.array(json.dumps(_outlined(value, keep)))
    with path.open("wb") as stream:
        np.savez(stream, allow_pickle=False, **arrays, **{CONTENT_DIGEST: np.array(digest(arrays))})


def load_record(path: Path, classes: Iterable[type]) -> Any:
    """Return the record of a file, made of no other classes than those given.

    Arrays are read-only. The archive holds the digest of its content: a file that was cut short or
    altered is found out.

    Raises
    ------
    BrokenRecordError
        The file is no such record, or damaged, or of another class.
    """
    known = {c.__qualname__: c for c in classes}
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        if str(arrays.pop(CONTENT_DIGEST)) != digest(arrays):
            raise ValueError("its content is not that of its digest")
        return _rebuilt(json.loads(str(arrays[_OUTLINE])), arrays, known)
    except FileNotFoundError:
        raise
    except (RoomfitError, *ARCHIVE_DAMAGE) as error:
        raise BrokenRecordError(f"{path}: {error}") from error


def size_bytes(value: object) -> int:
    """Return the size of a record's arrays: about what its file will take."""
    sizes: list[int] = []

    def keep(array: np.ndarray[Any, Any]) -> str:
        sizes.append(array.nbytes)
        return ""

    _outlined(value, keep)
    return sum(sizes)


def _outlined(value: object, keep: Callable[[np.ndarray[Any, Any]], str]) -> Any:
    """Return what JSON can hold of a value; of its arrays what `keep` returns."""
    if isinstance(value, np.ndarray):
        if value.dtype.hasobject:
            raise TypeError("an array of objects cannot be kept")
        return {"array": keep(value)}
    if isinstance(value, bytes):
        return {"bytes": keep(np.frombuffer(value, dtype=np.uint8))}
    if isinstance(value, np.generic):
        return _outlined(value.item(), keep)
    # before text: a member of an enumeration may be one, and must come back as a member
    if isinstance(value, Enum) and isinstance(value.value, str):
        return {"member": type(value).__qualname__, "value": value.value}
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if is_dataclass(value) and not isinstance(value, type):
        entries = {f.name: getattr(value, f.name) for f in fields(value) if f.init}
        return {
            "record": type(value).__qualname__,
            "fields": {name: _outlined(item, keep) for name, item in entries.items()},
        }
    if isinstance(value, Mapping):
        if not all(isinstance(key, str) for key in value):
            raise TypeError("a mapping is kept only with text as keys")
        return {"mapping": {key: _outlined(item, keep) for key, item in value.items()}}
    if isinstance(value, list | tuple):
        return [_outlined(item, keep) for item in value]
    raise TypeError(f"{type(value).__name__} cannot be kept")


def _rebuilt(
    outline: Any, arrays: Mapping[str, np.ndarray[Any, Any]], known: Mapping[str, type]
) -> Any:
    if isinstance(outline, list):
        return tuple(_rebuilt(item, arrays, known) for item in outline)
    if not isinstance(outline, dict):
        return outline
    if "array" in outline:
        array = arrays[outline["array"]]
        array.setflags(write=False)
        return array
    if "bytes" in outline:
        return arrays[outline["bytes"]].tobytes()
    if "member" in outline:
        return known[outline["member"]](outline["value"])
    if "mapping" in outline:
        return {key: _rebuilt(item, arrays, known) for key, item in outline["mapping"].items()}
    entries = {name: _rebuilt(item, arrays, known) for name, item in outline["fields"].items()}
    return known[outline["record"]](**entries)


# Of what the C library exchanges two names with: Linux and macOS.
_AT_CWD, _RENAME_EXCHANGE, _RENAME_SWAP = -100, 2, 2
# Within an output folder: the names of the result's own files.
_LIST = ".roomfit-files"
# Within an output folder of an earlier roomfit: its intermediate results, which are ignored.
CACHE_FOLDER = ".roomfit-cache"


def check_output_folder(path: Path, *, overwrite: bool = False) -> None:
    """Refuse a folder that results cannot go into, before the work and without making it.

    Raises
    ------
    InputError
        The folder exists and holds something other than the cache of an unfinished run, and
        `overwrite` is false; or a file is in its place.
    StoreError
        Nothing can be written there.
    """
    path = Path(path)
    nearest = _nearest_folder(path)
    try:
        filled = path.is_dir() and any(p.name != CACHE_FOLDER for p in path.iterdir())
    except OSError as error:
        raise _cannot_be_made(path, error) from error
    if filled and not overwrite:
        what = "the output folder exists and is not empty"
        needed = "a new or an empty folder, so that no earlier result is lost"
        hint = "choose another folder, or add --overwrite"
        raise InputError(what, where=str(path), found="files in it", needed=needed, hint=hint)
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise StoreError(
            "the output folder cannot be written to",
            where=str(path),
            found=f"no permission to write in {nearest}",
            hint="choose another folder",
        )


def _nearest_folder(path: Path) -> Path:
    try:
        nearest = nearest_existing(path)
    except OSError as error:
        raise _cannot_be_made(path, error) from error
    if not nearest.is_dir():
        raise InputError(
            "the output folder is a file" if nearest == path else "the output folder is in a file",
            where=str(path),
            found=f"{nearest} is a file",
            needed="a folder, or a name that is free",
            hint="choose another name",
        )
    return nearest


def make_folder(path: Path) -> None:
    """Make a folder where there is none; errors as of `check_output_folder`."""
    _nearest_folder(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _cannot_be_made(path, error) from error


@contextmanager
def whole_output_folder(path: Path, *, overwrite: bool = False) -> Iterator[Path]:
    """Give a folder to fill, which takes its final name when the block ends without an error.

    Until then it has a hidden name on the same disk. An error or an interruption within the block
    leaves nothing: neither the folder nor a changed file of an earlier one. With `overwrite`, the
    new folder and an earlier one change places in one step, so that either the old result is there
    or the new one, whole. The new one has a list of its files, ``.roomfit-files``; files that the
    earlier list names and this run did not write are gone, and all others stay.

    Where the system cannot exchange folders (Windows, some network disks), the old one is renamed
    first: a run that is killed between the two leaves it under a hidden name, and the next run puts
    it back. The current folder of the process, and a disk of its own, cannot be renamed: there
    files are replaced one by one.

    Raises
    ------
    InputError, StoreError
        See `check_output_folder`.
    """
    check_output_folder(path, overwrite=overwrite)
    path = Path(path).resolve()
    parent = nearest_existing(path.parent)
    with hidden_folder(parent, f".{path.name}.making-") as aside:
        yield aside
        try:
            written = sorted(p.relative_to(aside).as_posix() for p in aside.rglob("*"))
            (aside / _LIST).write_text(json.dumps(written), encoding="utf-8")
            _put_in_place(aside, path)
        except OSError as error:
            raise StoreError(
                "the results cannot be put into the output folder",
                where=str(path),
                found=str(error),
            ) from error


P = ParamSpec("P")
T = TypeVar("T")


def sole_writer(command: Callable[P, T]) -> Callable[P, T]:
    """Let a command run only while no other run writes into the folder that is its argument `out`.

    What killed runs have left behind is removed.

    Raises
    ------
    FolderInUseError
        Another run has this folder.
    """
    wanted = signature(command)
    place = "out" if "out" in wanted.parameters else "folder"

    @wraps(command)
    def alone(*args: P.args, **kwargs: P.kwargs) -> T:
        path = Path(wanted.bind(*args, **kwargs).arguments[place]).resolve()
        parent = nearest_existing(path.parent)
        if not (parent.is_dir() and os.access(parent, os.W_OK | os.X_OK)):
            return command(*args, **kwargs)  # which refuses
        with locked(path):
            _recover(path, parent)
            return command(*args, **kwargs)

    return alone


def _lock_file(path: Path, parent: Path, kind: str) -> Path:
    mark = hashlib.sha256(os.fsencode(path)).hexdigest()[:16]
    return parent / f".roomfit-{mark}.{kind}"


@contextmanager
def shared_folder(path: Path, *, alone: bool) -> Iterator[bool]:
    """Wait until a folder into which several runs write at once is free; tell whether it is locked.

    Those who add files hold it together (`alone` false). Who puts a new folder into its place holds
    it alone, so that no file is lost between; what killed runs have left behind is removed then.
    A disk without locks keeps nobody waiting.
    """
    path = Path(path).resolve()
    parent = nearest_existing(path.parent)
    if sys.platform == "win32":
        yield False
        return
    lock = _lock_file(path, parent, "shared")

    def wait(descriptor: int) -> bool:
        with suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX if alone else fcntl.LOCK_SH)
            return True
        return False

    try:
        descriptor, locked = _opened(lock, wait)
        if alone and locked:
            _recover(path, parent)
    except OSError as error:
        raise _cannot_be_made(path, error) from error
    try:
        yield locked
    finally:
        if _try_lock(descriptor):  # the last of them
            _remove(lock)
        os.close(descriptor)


@contextmanager
def locked(path: Path, wait_s: float = 1.0) -> Iterator[None]:
    """Hold a file, or a folder that may still be to be made, by a lock in a hidden file beside it.

    The system frees it when its process ends, however that comes about. `FolderInUseError` where
    another run has held it all the time that this one waited.
    """
    lock = _lock_file(path, nearest_existing(path.parent), "lock")
    try:
        descriptor, taken = _opened(lock, partial(_try_lock, wait_s=wait_s))
    except OSError as error:
        raise _cannot_be_made(path, error) from error
    if not taken:
        os.close(descriptor)
        what, found = "another run is writing to this place", f"a run that holds {lock.name}"
        hint = "wait for it, end it, or choose another place"
        raise FolderInUseError(what, where=str(path), found=found, needed="one run", hint=hint)
    try:
        yield
    finally:
        # while it is held: whoever waits with the old file open looks again, and what has its name
        # after that may be the lock of another; Windows removes no open file
        steps = [partial(_remove, lock), partial(os.close, descriptor)]
        for step in reversed(steps) if sys.platform == "win32" else steps:
            step()


def _opened(lock: Path, take: Callable[[int], bool]) -> tuple[int, bool]:
    """Open a lock file and take it, by `take`; return its descriptor, and whether it is taken."""
    while True:
        descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666)
        locked = take(descriptor)
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(descriptor), lock.stat()):
                return descriptor, locked
        os.close(descriptor)  # its last owner has just removed it


def _try_lock(descriptor: int, wait_s: float = 0.0) -> bool:
    """Return whether an open file, or on POSIX a folder, could be locked; True without locks."""
    until_s = time.monotonic() + wait_s
    while True:
        try:
            if sys.platform != "win32":
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            else:
                import msvcrt

                msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
            return True
        except OSError as error:
            is_free = error.errno not in (errno.EWOULDBLOCK, errno.EACCES, errno.EDEADLK)
            if is_free or time.monotonic() >= until_s:
                return is_free
            time.sleep(0.002)  # copies of a killed run hold its locks until they have died


@contextmanager
def hidden_folder(parent: Path, prefix: str) -> Iterator[Path]:
    """Give a new folder, which is removed at the end if it is still there.

    It is locked as long as this process lives, by which `remove_leftovers` knows dead ones.
    """
    try:
        folder = Path(tempfile.mkdtemp(prefix=prefix, dir=parent))
    except OSError as error:
        raise _cannot_be_made(parent, error) from error
    descriptor = -1 if sys.platform == "win32" else os.open(folder, os.O_RDONLY)
    try:
        if descriptor >= 0:
            _try_lock(descriptor)
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        if descriptor >= 0:
            os.close(descriptor)


def remove_leftovers(parent: Path, prefix: str) -> None:
    """Remove the hidden folders of runs that were killed; those of living ones are locked."""
    # Windows locks no folders
    for folder in () if sys.platform == "win32" else parent.glob(f"{escape(prefix)}????????"):
        with suppress(OSError):
            descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            if _try_lock(descriptor, wait_s=1.0):
                shutil.rmtree(folder, ignore_errors=True)
            os.close(descriptor)


def _recover(path: Path, parent: Path) -> None:
    """Put back what a killed run had moved away, and remove what it left."""
    for old in parent.glob(f".{escape(path.name)}.old-????????"):
        if path.exists():
            shutil.rmtree(old, ignore_errors=True)
        else:
            old.rename(path)
    remove_leftovers(parent, f".{path.name}.making-")


def _put_in_place(aside: Path, path: Path) -> None:
    """Give a folder its final name; where one of that name exists, the two change places."""
    path.parent.mkdir(parents=True, exist_ok=True)
    _give_usual_permissions(aside, 0o777)
    if not path.exists():
        aside.rename(path)
        return
    if Path.cwd().is_relative_to(path) or path.is_mount():
        _replace_one_by_one(aside, path)
        return
    _carry_over(path, aside)
    shutil.copymode(path, aside)
    if not _exchange(aside, path):
        old = Path(tempfile.mkdtemp(prefix=f".{path.name}.old-", dir=path.parent))
        old.rmdir()
        path.rename(old)
        try:
            aside.rename(path)
        except OSError:
            old.rename(path)
            raise
        old.rename(aside)  # which is removed


def _earlier(path: Path) -> set[str]:
    """Return the files and folders that an earlier result names as its own."""
    try:
        return set(json.loads((path / _LIST).read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError, RecursionError):
        return set()  # of another version, or no result at all: nothing is removed


def _foreign(path: Path, aside: Path) -> Iterator[Path]:
    """Yield what of a folder neither an earlier result's list nor the new result names."""
    earlier = _earlier(path) | {_LIST}
    for here, folders, files in os.walk(path):
        if CACHE_FOLDER in folders:
            folders.remove(CACHE_FOLDER)
        for name in (*folders, *files):
            own = Path(here, name).relative_to(path)
            if own.as_posix() in earlier:
                continue
            if not (aside / own).exists():
                yield own
            elif name in folders and not (aside / own).is_dir():
                raise FileExistsError(errno.EEXIST, "a folder is in the place of a file", str(own))


def _carry_over(path: Path, aside: Path) -> None:
    """Enter into the new folder what is not the result's, as further names of the same files."""
    for own in _foreign(path, aside):
        source, place = path / own, aside / own
        place.parent.mkdir(parents=True, exist_ok=True)
        if source.is_dir() and not source.is_symlink():
            place.mkdir()
            shutil.copystat(source, place)
            continue
        try:
            os.link(source, place, follow_symlinks=False)
        except (OSError, NotImplementedError):  # a disk without links
            shutil.copy2(source, place, follow_symlinks=False)


def _replace_one_by_one(aside: Path, path: Path) -> None:
    """Move every file into a folder, and remove what only the earlier list names."""
    written = {p.relative_to(aside) for p in aside.rglob("*") if p.is_file()}
    names = {Path(name) for name in _earlier(path)} - written
    stale = [p for p in path.rglob("*") if p.relative_to(path) in names and p.is_file()]
    for own in sorted(written):
        (path / own).parent.mkdir(parents=True, exist_ok=True)
        (aside / own).replace(path / own)
    for file in stale:
        file.unlink()


def _exchange(one: Path, other: Path) -> bool:
    """Let two folders change names in one step; return False where the system cannot."""
    names = (os.fsencode(one), os.fsencode(other))
    try:
        library = ctypes.CDLL(None, use_errno=True)
        if sys.platform == "darwin":
            return bool(library.renamex_np(*names, _RENAME_SWAP) == 0)
        return bool(library.renameat2(_AT_CWD, names[0], _AT_CWD, names[1], _RENAME_EXCHANGE) == 0)
    except (AttributeError, OSError, TypeError):
        return False


def write_bytes_atomically(path: Path, content: bytes) -> Path:
    """Write a file under another name and rename it: readers find the old file or the new one.

    Raises
    ------
    StoreError
        The disk refuses.
    """
    path = Path(path)
    try:
        with _whole_file(path) as aside:
            aside.write_bytes(content)
            _give_usual_permissions(aside, 0o666)
    except OSError as error:
        raise StoreError("a file cannot be written", where=str(path), found=str(error)) from error
    return path


@contextmanager
def _whole_file(path: Path) -> Iterator[Path]:
    """Give a hidden file beside a path, which takes its name when the block ends well."""
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    os.close(handle)
    aside = Path(name)
    try:
        yield aside
        with aside.open("r+b") as stream:
            os.fsync(stream.fileno())
        aside.replace(path)
    finally:
        _remove(aside)


def write_text_atomically(path: Path, text: str) -> Path:
    """Write UTF-8, ? for bytes of names that are none; see `write_bytes_atomically`."""
    return write_bytes_atomically(path, text.encode(errors="replace"))


def write_json_atomically(path: Path, content: Mapping[str, Any]) -> Path:
    """Write `json_text` to a file, with `content_digest`; see `write_bytes_atomically`."""
    whole = {**content, CONTENT_DIGEST: content_digest(content)}
    return write_text_atomically(path, json_text(whole))


def content_digest(content: Mapping[str, Any]) -> str:
    """Return the SHA-256 of the JSON text, without spaces, of all but the digest itself."""
    rest = {key: value for key, value in content.items() if key != CONTENT_DIGEST}
    text = json.dumps(rest, separators=(",", ":"), default=_listed)
    return hashlib.sha256(text.encode()).hexdigest()


def json_text(content: Any) -> str:
    """Return JSON that any parser reads: an unknown value must be None, never NaN.

    `content`: anything that JSON holds, and NumPy arrays and numbers, which become lists and
    numbers.

    Raises
    ------
    ValueError
        The content holds NaN or infinity: a fault of the caller's code, not of a user.
    """
    return json.dumps(content, indent=1, allow_nan=False, default=_listed) + "\n"


def _listed(value: object) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no form in JSON")


def nearest_existing(path: Path) -> Path:
    """Return the path itself, or the nearest folder above it that exists."""
    return next((p for p in (path, *path.absolute().parents) if p.exists()), Path.cwd())


def _cannot_be_made(path: Path, error: OSError) -> StoreError:
    return StoreError(
        "the output folder cannot be made",
        where=str(path),
        found=error.strerror or str(error),
        needed="a folder in which files may be written",
        hint="choose another place, or change who may write there",
    )


def _give_usual_permissions(path: Path, most: int) -> None:
    """Give the permissions of any new file; temporary ones are readable by their owner only."""
    umask = os.umask(0)
    os.umask(umask)
    path.chmod(most & ~umask)


DEFAULT_LIMIT_BYTES = 2 * 2**30
_SUFFIX, _LIMIT = ".npz", "limit-bytes"
# An incomplete file that was not touched for so long is that of a run that was killed.
_ABANDONED_S = 3600.0


@dataclass(frozen=True, slots=True)
class Cache:
    """A folder for intermediate results; it is made when there is something to put in."""

    folder: Path
    # The least recently used files go when all together take more. A result that alone is
    # larger is not kept.
    limit_bytes: int = DEFAULT_LIMIT_BYTES


@dataclass(frozen=True, slots=True, eq=False)
class Cached(Generic[T]):
    """A value, whether it was found rather than computed, and what happened to the cache."""

    value: T
    found: bool
    findings: tuple[Finding, ...] = ()


def user_cache() -> Cache | None:
    """Return this user's cache, or None where there is to be none.

    The variable ``ROOMFIT_CACHE`` of the environment names another folder, or is ``off``. Without
    it the folder is that which the system has for such files; a user without a home has none.
    """
    chosen = os.environ.get("ROOMFIT_CACHE", "")
    if chosen.lower() == "off":
        return None
    folder = Path(os.path.expanduser(chosen) if chosen else user_cache_dir("roomfit", False))  # noqa: PTH111 -- does not raise
    if not chosen and not folder.is_absolute():
        return None
    try:
        limit_bytes = int((folder / _LIMIT).read_text(encoding="ascii"))
    except (OSError, ValueError):
        limit_bytes = DEFAULT_LIMIT_BYTES
    return Cache(folder.absolute(), limit_bytes)


def cache_files(cache: Cache) -> list[tuple[Path, os.stat_result]]:
    """Return the files of a cache, the least recently used first."""
    found = []
    for path in cache.folder.glob(f"[!.]*{_SUFFIX}"):
        with suppress(OSError):  # another run has just removed it
            found.append((path, path.stat()))
    return sorted(found, key=lambda each: (each[1].st_mtime_ns, each[0]))


def limited(cache: Cache, limit_bytes: int) -> Cache:
    """Keep the limit of a cache for all later runs, and remove what exceeds it.

    Raises
    ------
    StoreError
        The disk refuses.
    """
    make_folder(cache.folder)
    write_text_atomically(cache.folder / _LIMIT, str(limit_bytes))
    cache = Cache(cache.folder, limit_bytes)
    make_room(cache, 0)
    return cache


def cached(
    cache: Cache | None,
    kind: str,
    key_parts: Sequence[object],
    compute: Callable[[], T],
    classes: Iterable[type],
) -> Cached[T]:
    """Return a value from the cache, or compute it and keep it.

    A cache only saves time: a damaged file is removed and its value computed again, and a disk that
    is full or forbids writing does not affect the value. Both are reported as findings.

    Parameters
    ----------
    cache : Cache or None
        None computes.
    kind : str
        What it is, in a word that can stand in a file name: "trace".
    key_parts : sequence
        All that determines the value, as `digest` takes it; the code of roomfit is added.
    compute : callable
        Returns a record, see `save_record`; the same key must give the same bits.
    classes : iterable of type
        Dataclasses that the record is made of.
    """
    if cache is None:
        return Cached(compute(), found=False)
    path = cache.folder / f"{kind}-{digest(code_digest(), kind, *key_parts)[:40]}{_SUFFIX}"
    findings: tuple[Finding, ...] = ()
    try:
        value = load_record(path, classes)
    except FileNotFoundError:
        pass
    except BrokenRecordError:
        text = f"An intermediate result ({kind}, {path.name}) was damaged; it was computed again."
        evidence = {"kind": kind, "file": path.name}
        findings = (Finding(Code.CACHE_FILE_DAMAGED, About(), text, evidence),)
        _remove(path)
    else:
        with suppress(OSError):
            os.utime(path)
        return Cached(value, found=True)
    value = compute()
    return Cached(value, found=False, findings=(*findings, *_keep(cache, kind, path, value)))


def _keep(cache: Cache, kind: str, path: Path, value: object) -> tuple[Finding, ...]:
    """Write a value and make room for it; return a finding where the disk refuses."""
    if size_bytes(value) > cache.limit_bytes:
        return ()
    try:
        cache.folder.mkdir(parents=True, exist_ok=True)
        with _whole_file(path) as aside:
            save_record(aside, value)
            make_room(cache, aside.stat().st_size)
    except OSError as error:
        text = (
            f"An intermediate result ({kind}) could not be kept: {error}. The answer is not "
            "affected; an interrupted run would begin this step again."
        )
        return (Finding(Code.CACHE_NOT_WRITTEN, About(), text, {"kind": kind}),)
    return ()


def make_room(cache: Cache, n_bytes: int) -> None:
    """Remove what was not used for longest until so many bytes more are within the limit.

    Incomplete files go when their run was killed; those of living ones are left alone.
    """
    for aside in cache.folder.glob(f".*{_SUFFIX}.????????"):
        with suppress(OSError):
            if time.time() - aside.stat().st_mtime > _ABANDONED_S:
                _remove(aside)
    files = cache_files(cache)
    total = n_bytes + sum(status.st_size for _, status in files)
    for path, status in files:
        if total <= cache.limit_bytes:
            break
        _remove(path)
        total -= status.st_size


def _remove(path: Path) -> None:
    with suppress(OSError):  # on a disk that is read-only: it is not used in any case
        path.unlink(missing_ok=True)
