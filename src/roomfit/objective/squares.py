"""The error function of Suh (2001), equation (1): squared differences of window energies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from roomfit.checks import float_array
from roomfit.errors import InputError
from roomfit.response.energy import weigh
from roomfit.response.rows import EnergyRows, merge_equal_rows
from roomfit.typing import FloatArray, IntArray

_NO_AIR = np.zeros(1)


@dataclass(frozen=True, slots=True, eq=False)
class SquaresProblem:
    """One band, no air, no noise: find the absorption whose window energies are the measured ones.

    Rows, hits and windows stand open, for methods that need more than a function to call.

    Attributes
    ----------
    rows : EnergyRows
        The windows of all pairs end to end.
    measured : float array, shape (n_windows,)
        M of equation (1), in the unit of the rows' weights.
    """

    rows: EnergyRows
    measured: FloatArray

    def __post_init__(self) -> None:
        measured = float_array("measured energy", self.measured, (self.rows.n_windows,), low=0.0)
        object.__setattr__(self, "measured", measured)


def squares_problem(rows: EnergyRows, measured: FloatArray) -> SquaresProblem:
    """Return the problem with equal rows merged, which without air changes no energy."""
    return SquaresProblem(merge_equal_rows(rows), measured)


def window_energies(rows: EnergyRows, absorption: FloatArray) -> FloatArray:
    """Return R of equation (1) for absorption of shape (n_materials,), shape (n_windows,)."""
    response = weigh(rows, absorption[:, None], _NO_AIR, derivative=False)
    return np.asarray(response.energy[0])


def error(problem: SquaresProblem, absorption: FloatArray) -> float:
    """Return equation (1): the sum of ``(M - R)**2`` over windows.

    Parameters
    ----------
    problem : SquaresProblem
    absorption : float array, shape (n_materials,)
        0 to 1.
    """
    difference = window_energies(problem.rows, absorption) - problem.measured
    return float(difference @ difference)


def residuals(problem: SquaresProblem, absorption: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return ``R - M``, shape (n_windows,), and its derivative, shape (n_windows, n_materials)."""
    response = weigh(problem.rows, absorption[:, None], _NO_AIR)
    if response.derivative is None:
        raise ValueError("weigh left the derivative out although it was asked for")
    return response.energy[0] - problem.measured, response.derivative[:, 0, :].T


def joined_rows(parts: Sequence[EnergyRows]) -> EnergyRows:
    """Return the rows of several pairs as one, their windows end to end.

    Raises
    ------
    InputError
        The parts have different materials.
    """
    first = parts[0]
    if any(part.materials != first.materials for part in parts):
        raise InputError("rows of different materials cannot be joined")
    starts = np.cumsum([0, *(len(part) for part in parts)])
    offsets = [part.offsets[:-1] + start for part, start in zip(parts, starts, strict=False)]
    return EnergyRows(
        first.materials,
        sum(part.n_windows for part in parts),
        np.concatenate([*offsets, starts[-1:]]),
        np.concatenate([part.weight_per_m2 for part in parts]),
        np.concatenate([part.hits for part in parts]),
        np.concatenate([part.length_m for part in parts]),
        np.concatenate([part.batch for part in parts]),
        first.n_batches,
    )


def grouped_rows(rows: EnergyRows, materials: tuple[str, ...], group: IntArray) -> EnergyRows:
    """Return the same rows for a coarser division of the walls: hits of a group are summed.

    Absorption does not bend rays, so that one trace serves every division into materials.

    Parameters
    ----------
    rows : EnergyRows
    materials : tuple of str
        Names of the groups.
    group : int array, shape (len(rows.materials),)
        Index into `materials` for each material of the rows.
    """
    membership = np.asarray(group)[:, None] == np.arange(len(materials))
    return EnergyRows(
        materials,
        rows.n_windows,
        rows.offsets,
        rows.weight_per_m2,
        rows.hits.astype(np.int64) @ membership,
        rows.length_m,
        rows.batch,
        rows.n_batches,
    )


def in_unit(rows: EnergyRows, unit_per_m2: float) -> EnergyRows:
    """Return the same rows with energies counted in another unit.

    Parameters
    ----------
    unit_per_m2 : float
        How many of the new unit make 1/m2.
    """
    return EnergyRows(
        rows.materials,
        rows.n_windows,
        rows.offsets,
        rows.weight_per_m2 * unit_per_m2,
        rows.hits,
        rows.length_m,
        rows.batch,
        rows.n_batches,
    )
