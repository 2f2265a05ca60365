"""Doubts that need no fit: a pair measured twice with other results, a material nobody hears."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from roomfit.app.measuring import MeasuredPair
from roomfit.findings import Finding
from roomfit.signals.jnd import in_jnd
from roomfit.signals.room_parameters import ParameterName
from roomfit.tracing.paths import Paths
from roomfit.typing import FloatArray

# More than a listener's smallest step by a factor that no repetition at one place explains.
LARGEST_JND = 2.0
LARGEST_LEVEL_DB = 1.5
_COMPARED: tuple[ParameterName, ...] = ("T20_s", "EDT_s", "C80_dB")


def duplicate_findings(measured: Sequence[MeasuredPair]) -> tuple[Finding, ...]:
    """Return a finding for each pair that was measured twice with results that differ.

    Compared are T20, EDT and C80, by more than 2 just noticeable differences, and the levels of the
    bands where they are said to be alike (measurements of one source that share its gain), by more
    than 1.5 dB. Nothing but the two responses is used: no position, no model.

    Parameters
    ----------
    measured : sequence of MeasuredPair
        In any order; what is kept for validation is compared as well.
    """
    findings = []
    for one, other in combinations(measured, 2):
        if one.pair != other.pair:
            continue
        told = [*_differing(one, other), *_levels(one, other)]
        if not told:
            continue
        names = f"{one.file.response.path.name} and {other.file.response.path.name}"
        findings.append(
            Finding(
                "pair-measured-twice-differs",
                "warning",
                f"{one.file.source} to {one.file.receiver} was measured twice ({names}) with "
                f"different results: {'; '.join(told)}. One of them may belong to another pair, or "
                "the room was changed in between.",
                {
                    "source": one.file.source,
                    "receiver": one.file.receiver,
                    "files": [str(one.file.response.path), str(other.file.response.path)],
                    "differences": told,
                },
            )
        )
    return tuple(findings)


def unmet_materials(paths: Paths, materials: Sequence[str]) -> tuple[str, ...]:
    """Return the materials that no path strikes: nothing measured can tell of them.

    Parameters
    ----------
    paths : Paths
        Of all pairs that are to be fitted.
    materials : sequence of str
        Those asked about, of the paths' own.
    """
    met = np.asarray(paths.hits_specular.any(axis=0) | paths.hits_diffuse.any(axis=0))
    return tuple(m for m in materials if not met[paths.materials.index(m)])


def unmet_findings(paths: Paths, fitted: Sequence[str]) -> tuple[Finding, ...]:
    """Return a finding that names the materials to be fitted which no path strikes.

    Parameters
    ----------
    paths : Paths
    fitted : sequence of str
        Materials whose absorption is not given.
    """
    unmet = unmet_materials(paths, fitted)
    if not unmet:
        return ()
    return (
        Finding(
            "material-not-met",
            "warning",
            f"No path between the measured pairs strikes {', '.join(unmet)}: its absorption cannot "
            "be told, and what was known beforehand is all that is reported.",
            {"materials": list(unmet)},
        ),
    )


def _differing(one: MeasuredPair, other: MeasuredPair) -> list[str]:
    told = []
    for name in _COMPARED:
        first, second = one.parameters.of(name), other.parameters.of(name)
        # from their mean, so that the order does not matter
        steps = np.abs(
            in_jnd(name, 0.5 * (first + second), 0.5 * (first + second) + first - second)
        )
        known: FloatArray = np.abs(np.nan_to_num(steps, nan=0.0))
        if known.max() > LARGEST_JND:
            j = int(np.argmax(known))
            symbol, unit = name.split("_")
            told.append(
                f"{symbol} {first[j]:.2f} and {second[j]:.2f} {unit} "
                f"at {one.curve.bands.centres_hz[j]:g} Hz"
            )
    return told


def _levels(one: MeasuredPair, other: MeasuredPair) -> list[str]:
    if one.file.level != other.file.level or one.file.level == "per-file":
        return []
    difference = _level_db(one) - _level_db(other)
    known: FloatArray = np.abs(np.nan_to_num(difference, nan=0.0))
    if known.max() <= LARGEST_LEVEL_DB:
        return []
    j = int(np.argmax(known))
    return [f"levels that differ by {known[j]:.1f} dB at {one.curve.bands.centres_hz[j]:g} Hz"]


def _level_db(m: MeasuredPair) -> FloatArray:
    total = m.curve.energy_left[:, 0]
    return 10.0 * np.log10(np.where(total > 0.0, total, np.nan))
