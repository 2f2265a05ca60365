"""The answer of a design: where to measure, and what to expect of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from roomfit.bands import Bands
from roomfit.findings import Finding
from roomfit.placement.choose import Criterion
from roomfit.scene.scene import Scene
from roomfit.typing import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Design:
    """Where to measure.

    Attributes
    ----------
    scene : Scene
        Measured pairs, then candidates.
    n_held : int
        How many of its pairs have been measured and count as held.
    chosen : int array, shape (n_chosen,)
        Pairs to measure, those that tell most first.
    bands : Bands
    materials : tuple of str
    to_find : bool array, shape (n_materials,)
        False where the absorption is known.
    widths : float array, shape (n_chosen + 1, n_materials, n_bands)
        Expected width of the 95 % interval of every absorption before, and after each of the
        chosen pairs; 0 where it is known. The mean over draws of the absorption.
    random_means : float array, shape (n_random, n_chosen + 1)
        Mean width of random designs under the same rules; NaN where one ended early.
    criterion : {"determinant", "mean", "worst"}
    model : {"energy", "coherent"}
        What the fit is expected to compare.
    absorption : float array, shape (n_materials, n_bands)
        Middle of what is known beforehand.
    n_draws : int
    after_fit : bool
        Whether the widths before are those of a finished fit.
    source_distance_m, receiver_distance_m, wall_distance_m : float
        The rules that were obeyed.
    findings : tuple of Finding
    seed : int
    seconds : float
    """

    scene: Scene
    n_held: int
    chosen: IntArray
    bands: Bands
    materials: tuple[str, ...]
    to_find: BoolArray
    widths: FloatArray
    random_means: FloatArray
    criterion: Criterion
    model: Literal["energy", "coherent"]
    absorption: FloatArray
    n_draws: int
    after_fit: bool
    source_distance_m: float
    receiver_distance_m: float
    wall_distance_m: float
    findings: tuple[Finding, ...]
    seed: int
    seconds: float


def mean_widths(design: Design) -> FloatArray:
    """Return the mean width over all bands and materials to be found, shape (n_chosen + 1,)."""
    return np.asarray(design.widths[:, design.to_find].mean(axis=(1, 2)))


def widest(design: Design, step: int = 0) -> tuple[int, int]:
    """Return material and band of the widest interval after so many of the chosen pairs."""
    widths = design.widths[step]
    material, band = np.unravel_index(int(np.argmax(widths)), widths.shape)
    return int(material), int(band)
