"""What can go wrong, and whose turn it then is.

A message answers five questions: what is wrong, where, what was found, what was needed, and what
to try. The class says whose turn it is: the caller's (`InputError`), the data's (`CannotTell`),
the method's (`NotConverged`) or the disk's (`StoreError`).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


class RoomfitError(Exception):
    """Something that a user can act on; the command line shows its text and no traceback.

    Parameters
    ----------
    what : str
        One short sentence without a full stop.
    where, found, needed, hint : str, optional
        The file, line or name concerned; what stood there; what should; what to try.
    """

    def __init__(
        self,
        what: str,
        *,
        where: str | None = None,
        found: str | None = None,
        needed: str | None = None,
        hint: str | None = None,
    ) -> None:
        self.what = what
        self.where = where
        self.found = found
        self.needed = needed
        self.hint = hint
        rows = (("where", where), ("found", found), ("needed", needed), ("try", hint))
        lines = [f"  {key:<7} {text}" for key, text in rows if text]
        super().__init__("\n".join([what, *lines]))


class InputError(RoomfitError):
    """The caller's turn: a file, a table or an argument is not what it must be."""


class CannotTell(RoomfitError):  # noqa: N818 -- a verdict about the data, not a fault in them
    """The data's turn: what was measured does not hold the answer that was asked for."""


class NotConverged(RoomfitError):  # noqa: N818 -- reads as the sentence it says
    """The method's turn: it stopped before its own test was met."""


class StoreError(RoomfitError):
    """The disk's turn: a file cannot be read, written or renamed."""


@contextmanager
def located(place: str) -> Iterator[None]:
    """Put a place before what an error within the block says of where it is.

    For checks that know a key but not the file it stands in.
    """
    try:
        yield
    except RoomfitError as error:
        raise type(error)(
            error.what,
            where=f"{place}, {error.where}" if error.where else place,
            found=error.found,
            needed=error.needed,
            hint=error.hint,
        ) from error
