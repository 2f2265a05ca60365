"""Responses of a room of flat walls by another program, pyroomacoustics.

Its image sources to an order, which it finds by mirroring in every wall after every other, and its
rays beyond, whose energies it fills with noise. Speed of sound and air of ISO 9613-1 are imposed on
it, because its own differ; its responses begin 40 samples late, which is taken off.
"""

from __future__ import annotations

import numpy as np

from roomfit.air import Air, attenuation_per_m
from roomfit.bands import bands_between
from roomfit.synthetic.polyhedra import SyntheticPolyhedron
from roomfit.typing import FloatArray

LATE_SAMPLES = 40
N_RAYS = 50_000


def other_responses(
    synthetic: SyntheticPolyhedron,
    source_m: FloatArray,
    receivers_m: FloatArray,
    duration_s: float,
    sampling_rate_hz: float,
    order: int,
) -> list[FloatArray]:
    """Return the sound pressure at each receiver after an impulse at the source at time 0.

    Parameters
    ----------
    synthetic : SyntheticPolyhedron
        One cell; octaves from 63 Hz.
    order : int
        Of image sources.
    """
    import pyroomacoustics as pra

    pra.random.seed(1)
    cells = synthetic.cells
    heard = np.minimum(np.arange(1, 9), synthetic.absorption.shape[1] - 1)
    walls = [
        pra.wall_factory(
            cells.vertices_m[list(face.corners)].T,
            synthetic.absorption[face.material, heard],
            np.zeros(heard.size),
            f"face {i}",
        )
        for i, face in enumerate(cells.faces)
    ]
    room = pra.Room(
        walls, fs=int(sampling_rate_hz), max_order=order, air_absorption=True, ray_tracing=True
    )
    room.set_sound_speed(synthetic.speed_of_sound_m_s)
    room.set_ray_tracing(n_rays=N_RAYS, receiver_radius=0.5, time_thres=1.5 * duration_s)
    octaves = bands_between("octave", 125, 125.0 * 2.0 ** (room.octave_bands.n_bands - 1))
    room.air_absorption = attenuation_per_m(Air(), octaves)
    room.add_source(source_m)
    room.add_microphone_array(receivers_m.T)
    room.compute_rir()
    n = round(duration_s * sampling_rate_hz)
    return [
        np.asarray(own[0], dtype=np.float64)[LATE_SAMPLES : LATE_SAMPLES + n] for own in room.rir
    ]
