"""Octave and third-octave bands by IEC 61260-1."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from roomfit.base.arguments import check_known, float_array, read_only
from roomfit.base.errors import InputError
from roomfit.base.typing import FloatArray

BandKind = Literal["octave", "third-octave"]

OCTAVES_HZ = (31.5, 63.0, 125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0, 8000.0, 16000.0)
THIRD_OCTAVES_HZ = (
    *(25.0, 31.5, 40.0, 50.0, 63.0, 80.0, 100.0, 125.0, 160.0, 200.0, 250.0, 315.0, 400.0, 500.0),
    *(630.0, 800.0, 1000.0, 1250.0, 1600.0, 2000.0, 2500.0, 3150.0, 4000.0, 5000.0, 6300.0),
    *(8000.0, 10000.0, 12500.0, 16000.0, 20000.0),
)
_STEPS_PER_OCTAVE = {"octave": 1, "third-octave": 3}


@dataclass(frozen=True, slots=True, eq=False)
class Bands:
    """Frequency bands, low to high."""

    kind: BandKind
    centres_hz: FloatArray  #: (n_bands,), nominal (125, 250, ...), strictly rising
    #: (n_bands,), exact base-ten centres of IEC 61260-1 nearest to the nominal ones
    exact_centres_hz: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        check_known("unknown kind of band", self.kind, _STEPS_PER_OCTAVE)
        centres = float_array("band centre", self.centres_hz, (None,), low=1.0, high=1e5, unit="Hz")
        if centres.size == 0 or np.any(np.diff(centres) <= 0.0):
            what = "band centres must rise and there must be at least one"
            needed = "one or more, each above the one before"
            hint = "sort them, each once, as in 125, 250, 500"
            raise InputError(what, found=str(centres.tolist()), needed=needed, hint=hint)
        object.__setattr__(self, "centres_hz", centres)
        # raises where one is no centre of that kind
        exact = read_only(exact_centres_hz(self.kind, centres))
        object.__setattr__(self, "exact_centres_hz", exact)

    def __len__(self) -> int:
        return int(self.centres_hz.size)

    @property
    def lower_hz(self) -> FloatArray:
        """Lower band edges, shape (n_bands,)."""
        return np.asarray(self.exact_centres_hz / 10.0 ** (0.15 / _STEPS_PER_OCTAVE[self.kind]))

    @property
    def upper_hz(self) -> FloatArray:
        """Upper band edges, shape (n_bands,)."""
        return np.asarray(self.exact_centres_hz * 10.0 ** (0.15 / _STEPS_PER_OCTAVE[self.kind]))


def bands_between(kind: BandKind, from_hz: float, to_hz: float) -> Bands:
    """Return the standard bands whose nominal centres lie within the two frequencies, inclusive.

    Raises
    ------
    InputError
        No band of that kind lies there.

    Examples
    --------
    >>> bands_between("octave", 125, 1000).centres_hz.tolist()
    [125.0, 250.0, 500.0, 1000.0]
    """
    table = OCTAVES_HZ if kind == "octave" else THIRD_OCTAVES_HZ
    chosen = [f for f in table if from_hz <= f <= to_hz]
    if not chosen:
        what, found = "no standard band lies in the requested range", f"{from_hz:g} to {to_hz:g} Hz"
        needed = f"a range that contains one of {', '.join(f'{f:g}' for f in table)} Hz"
        raise InputError(what, found=found, needed=needed, hint="widen it")
    return Bands(kind, np.array(chosen))


def bands_of(centres_hz: ArrayLike) -> Bands:
    """Return bands of nominal centres in Hz: octaves where all are those of octaves."""
    centres = np.asarray(centres_hz, dtype=np.float64)
    return Bands("octave" if set(centres.tolist()) <= set(OCTAVES_HZ) else "third-octave", centres)


def exact_centres_hz(kind: BandKind, nominal_hz: ArrayLike) -> FloatArray:
    """Return the exact centres ``1000 * 10**(3 k / (10 b))`` nearest to nominal ones."""
    nominal = np.asarray(nominal_hz, dtype=np.float64)
    step = 0.3 / _STEPS_PER_OCTAVE[kind]
    exact = 1000.0 * 10.0 ** (step * np.round(np.log10(nominal / 1000.0) / step))
    off = np.abs(nominal / exact - 1.0)
    if np.any(off > 0.03):
        what = f"not a centre frequency of {kind} bands"
        found = f"{nominal[int(np.argmax(off))]:g} Hz"
        needed = "nominal centres of IEC 61260-1 (125, 250, 500, ... for octaves)"
        hint = "use the nominal centre, as 63 Hz and not 60 Hz"
        raise InputError(what, found=found, needed=needed, hint=hint)
    return np.asarray(exact)


def one_per_band(values: ArrayLike, bands: Bands, where: str | None = None) -> FloatArray:
    """Return one value a band, shape (n_bands,), of one for all or of as many; refuse others."""
    found = np.atleast_1d(np.array(values, dtype=np.float64))
    if found.size not in (1, len(bands)):
        what = "a list has not one value per band"
        hint = "write one for all; in a file {centres_hz = [...], values = [...]} fits any bands"
        needed = f"{len(bands)} values, or one, for {bands_in_words(bands, range(len(bands)))}"
        raise InputError(what, where=where, found=f"{found.size} values", needed=needed, hint=hint)
    return np.broadcast_to(found, len(bands)).copy()


def bands_in_words(bands: Bands, chosen: Iterable[int], notes: Sequence[str] = ()) -> str:
    """Return bands by their numbers for a sentence, each with a note in brackets if there are any.

    Examples
    --------
    >>> bands_in_words(bands_between("octave", 125, 500), [0, 2], ["3 %", "8 %"])
    '125 Hz (3 %), 500 Hz (8 %)'
    """
    names = [f"{bands.centres_hz[j]:g} Hz" for j in chosen]
    if notes:
        names = [f"{name} ({note})" for name, note in zip(names, notes, strict=True)]
    return ", ".join(names)


def steps_per_octave(kind: BandKind) -> int:
    """Return how many bands of a kind make an octave."""
    return _STEPS_PER_OCTAVE[kind]
