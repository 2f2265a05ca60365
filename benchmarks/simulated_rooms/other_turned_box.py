"""Responses of a box with door and window by another program, pyroomacoustics.

It enumerates the images of the plain box, delays, filters and adds them. It knows one material a
wall: what a path strikes is found by a ball that is sent along it through the room with door and
window. Speed of sound and air of ISO 9613-1 are imposed; it begins 40 samples late, which is taken
off.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from roomfit.base.air import Air, attenuation_per_m
from roomfit.base.bands import bands_between
from roomfit.base.typing import FloatArray
from simulated_rooms.polyhedra import SyntheticPolyhedron, _balls, cell_arrays
from simulated_rooms.polyhedral_rooms import TURNED_AT_M, TURNED_BY, TURNED_M

LATE_SAMPLES = 40


def other_responses(
    synthetic: SyntheticPolyhedron,
    source_m: FloatArray,
    receivers_m: FloatArray,
    duration_s: float,
    sampling_rate_hz: float,
) -> list[FloatArray]:
    """Return the sound pressure at each receiver after an impulse at the source at time 0.

    `synthetic` is of `turned_cells` and octaves from 63 Hz.
    """
    import pyroomacoustics as pra
    from pyroomacoustics.simulation.ism import compute_ism_rir

    c, lengths = synthetic.speed_of_sound_m_s, np.array(TURNED_M)
    own = [(p - TURNED_AT_M) @ TURNED_BY for p in (source_m, *receivers_m)]
    order = int(np.ceil(c * duration_s * np.sqrt(np.sum(lengths**-2.0)))) + 2
    room = pra.ShoeBox(lengths, fs=int(sampling_rate_hz), max_order=order)
    room.add_source(own[0])
    room.add_microphone_array(np.array(own[1:]).T)
    room.image_source_model()
    # exact again, from its single precision
    index = np.array(room.sources[0].orders_xyz, dtype=np.int64).T
    images = index * lengths + np.where(index % 2 == 0, own[0], lengths - own[0])
    np.testing.assert_allclose(images, room.sources[0].images.T, atol=1e-3)
    octaves = bands_between("octave", 125, 125.0 * 2.0 ** (room.octave_bands.n_bands - 1))
    column = np.minimum(np.arange(len(octaves)) + 1, synthetic.absorption.shape[1] - 1)
    root = 0.5 * np.log1p(-synthetic.absorption[:, column])
    arrays, found = cell_arrays(synthetic.cells), []
    for receiver_m, at in zip(receivers_m, own[1:], strict=True):
        near = np.linalg.norm(images - at, axis=1) < c * duration_s
        hits = np.zeros((near.sum(), len(root)), dtype=np.int64)
        steps = (images[near] - at) @ TURNED_BY.T
        if not _balls(arrays, receiver_m, 0, steps, source_m, hits).all():
            raise RuntimeError("a ball has not arrived")
        source = SimpleNamespace(
            images=images[near].T, damping=np.exp(hits @ root).T, directivity=None
        )
        pressure = compute_ism_rir(
            source,
            at,
            None,
            None,
            np.ones(len(hits), dtype=bool),
            pra.constants.get("frac_delay_length"),
            c,
            int(sampling_rate_hz),
            room.octave_bands,
            min_phase=False,
            air_abs_coeffs=attenuation_per_m(Air(), octaves),
        )
        n = round(duration_s * sampling_rate_hz)
        found.append(np.asarray(pressure, dtype=np.float64)[LATE_SAMPLES : LATE_SAMPLES + n])
    return found
