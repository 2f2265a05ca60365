"""Impulse responses of a room of convex cells from image sources that add as pressures.

As `pressure_box` for boxes: a road to data that shares nothing with the model that is fitted. The
images come from `polyhedron_images`, which mirrors the room instead of the source.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roomfit.testproblems.polyhedron_cells import Cells
from roomfit.testproblems.polyhedron_images import cell_images
from roomfit.testproblems.pressure_box import pressure_of_images
from roomfit.typing import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PolyhedronTruth:
    """A room whose walls are known.

    Attributes
    ----------
    cells : Cells
    centres_hz : float array, shape (n_bands,)
        Octave centres, rising; absorption holds at a centre and changes smoothly in between.
    absorption : float array, shape (n_materials, n_bands)
        Energy absorption of each of `cells.materials`.
    attenuation_per_m : float array, shape (n_bands,)
        Energy attenuation of the air.
    speed_of_sound_m_s : float
    delays_s : tuple of float
        What each material adds to the travel time at every reflection.
    """

    cells: Cells
    centres_hz: FloatArray
    absorption: FloatArray
    attenuation_per_m: FloatArray
    speed_of_sound_m_s: float
    delays_s: tuple[float, ...]


def pressure_responses(
    truth: PolyhedronTruth,
    source_m: FloatArray,
    receivers_m: FloatArray,
    duration_s: float,
    sampling_rate_hz: float,
    level_db: FloatArray,
) -> list[FloatArray]:
    """Return the sound pressure at each receiver after an impulse at the source at time 0.

    Every image within the duration contributes ``1 / (4 pi r)``, times the root of
    what each wall reflects. Sound beyond edges is not there: no diffraction.

    Parameters
    ----------
    truth : PolyhedronTruth
    source_m : float array, shape (3,)
    receivers_m : float array, shape (n_receivers, 3)
    duration_s, sampling_rate_hz : float
    level_db : float array, shape (n_bands,)
        Level of the loudspeaker at each octave's centre.

    Returns
    -------
    list of float arrays, shape (n_samples,)
        In the unit in which a unit source's direct sound is ``1 / (4 pi r)``, band-limited.
    """
    reach_m = truth.speed_of_sound_m_s * duration_s
    return [
        pressure_of_images(
            (lengths, hits.astype(np.float64)),
            truth,
            duration_s,
            sampling_rate_hz,
            level_db,
        )
        for lengths, hits in cell_images(truth.cells, source_m, receivers_m, reach_m)
    ]
