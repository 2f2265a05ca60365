"""What a calibration is asked to do."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from roomfit.errors import InputError


@dataclass(frozen=True, slots=True)
class CalibrationSettings:
    """How many replicates, drawn from what, and which of them now.

    Attributes
    ----------
    replicates : int
        Of the whole calibration, 1 to 100,000.
    first : int
        The first replicate of this run, from 0.
    only : int or None
        How many this run makes at most; None for all that follow.
    result : Path or None
        ``result.json`` whose posterior absorption is drawn from; None for the priors.
    snr_db : float or None
        Loudest 10 ms over noise in every band, 20 to 90 dB; None for what the files have.
    seed : int
        Of the draws; replicate n of one seed is the same in any slice.
    workers : int
        Processes.
    """

    replicates: int = 200
    first: int = 0
    only: int | None = None
    result: Path | None = None
    snr_db: float | None = None
    seed: int = 1
    workers: int = 1

    def __post_init__(self) -> None:
        only = self.replicates if self.only is None else self.only
        limits: tuple[tuple[str, float, float, float], ...] = (
            ("replicates", self.replicates, 1, 100_000),
            ("first", self.first, 0, self.replicates - 1),
            ("only", only, 1, self.replicates),
            ("seed", self.seed, 0, 2**63 - 1),
            ("workers", self.workers, 1, 1024),
        )
        if self.snr_db is not None:
            limits = (*limits, ("snr-db", self.snr_db, 20.0, 90.0))
        for name, value, low, high in limits:
            if not low <= value <= high:
                raise InputError(
                    "a setting of the calibration is out of range",
                    where=name,
                    found=f"{value:g}",
                    needed=f"{low:g} to {high:g}",
                )

    @property
    def numbers(self) -> range:
        """Replicates of this run."""
        stop = self.replicates if self.only is None else self.first + self.only
        return range(self.first, min(stop, self.replicates))
