"""Errors, and who can mend what went wrong.

A message answers five questions: what is wrong, where, what was found, what was needed, and what
to try. The class says who must act: the caller (`InputError`), who measures
(`InsufficientDataError`), or who owns the disk (`StoreError`).
"""

from __future__ import annotations

import lzma
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

# What reading damaged bytes, here or by a library of others, may raise.
DAMAGE = (
    *(ArithmeticError, AssertionError, AttributeError, EOFError, ImportError, LookupError),
    *(MemoryError, OSError, RuntimeError, SyntaxError, TypeError, ValueError),
    *(lzma.LZMAError, struct.error, tokenize.TokenError, zipfile.BadZipFile, zlib.error),
)


class RoomfitError(Exception):
    """Something that a user can act on; the command line shows its text and no traceback.

    Parameters
    ----------
    what : str
        One short sentence without a full stop.
    where, found, needed, hint : str, optional
        The file, line or name concerned; what stood there; what should; what to try.
    points_m : sequence of x, y, z, optional
        Places in the room, for whoever draws it.
    """

    def __init__(
        self,
        what: str,
        *,
        where: str | None = None,
        found: str | None = None,
        needed: str | None = None,
        hint: str | None = None,
        points_m: Sequence[tuple[float, float, float]] = (),
    ) -> None:
        self.what, self.where, self.found = what, where, found
        self.needed, self.hint, self.points_m = needed, hint, tuple(points_m)
        rows = (("where", where), ("found", found), ("needed", needed), ("try", hint))
        lines = [f"  {key:<7} {_shown(text)}" for key, text in rows if text]
        super().__init__("\n".join([what, *lines]))


def _shown(text: str) -> str:
    """Return a text, its middle left out where it is endless: files hold words of any length."""
    return text if len(text) <= 1000 else f"{text[:700]} ... {text[-200:]}"


class InputError(RoomfitError):
    """A file, a table or an argument is not what it must be."""


class FolderInUseError(InputError):
    """Another run is writing into the same output folder."""


class InsufficientDataError(RoomfitError):
    """The measurements do not determine the answer that was asked for."""


class StoreError(RoomfitError):
    """A file cannot be read, written or renamed."""


@contextmanager
def located(place: str = "", *, hint: str | None = None) -> Iterator[None]:
    """Put a place before the `where` of an error raised within the block.

    For checks that know a key but not the file in which it stands. `hint` is what to try where the
    error itself does not say it.
    """
    try:
        yield
    except RoomfitError as error:
        parts = {k: getattr(error, k) for k in ("found", "needed", "points_m")}
        where = ", ".join(part for part in (place, error.where) if part) or None
        raise type(error)(error.what, where=where, hint=error.hint or hint, **parts) from error
