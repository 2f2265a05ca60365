"""Pressures of image sources with walls of any kind, summed in plain numpy."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from scipy.special import wofz

from roomfit.base.typing import ComplexArray, FloatArray
from roomfit.impedance.wave_model import State, WaveModel, moved_vectors_m, wavenumber_per_m
from simulated_rooms.wall_impedances import miki_material

Reflection = Callable[[FloatArray, FloatArray], ComplexArray]
"""Takes cosines of incidence (n,) and lengths of whole paths in m (n,); returns (n, n_f)."""


def image_pressure(model: WaveModel, walls: Mapping[str, Reflection], state: State) -> ComplexArray:
    """Return damped pressures of all pairs, shape (n_pairs, n_frequencies).

    Parameters
    ----------
    model : WaveModel
        Its paths are taken, and nothing else of how the fit predicts.
    """
    paths = model.paths
    vector = moved_vectors_m(model, state)
    length = np.linalg.norm(vector, axis=1)
    k = wavenumber_per_m(model, state)
    value = np.exp(-1j * length[:, None] * k) / (4.0 * np.pi * length[:, None])
    owner = np.repeat(np.arange(len(length)), np.diff(paths.bounce_first))
    cosine = np.abs(np.sum(vector[owner] * paths.normal, axis=1)) / length[owner]
    logarithm = np.zeros(value.shape, dtype=np.complex128)
    for i, name in enumerate(model.scene.room.materials):
        own = np.flatnonzero(paths.material == i)
        each = np.log(walls[name](cosine[own], length[owner[own]])) * paths.hits[own, None]
        np.add.at(logarithm, owner[own], each)
    return np.asarray(np.add.reduceat(value * np.exp(logarithm), paths.pair_first[:-1], axis=0))


def locally_reacting(
    impedance: ComplexArray, wavenumber_per_m: ComplexArray | None = None
) -> Reflection:
    """Return the reflection of walls of an impedance, Z of shape (n_frequencies,).

    ``(Z cos - 1) / (Z cos + 1)`` for plane waves; where the wavenumber is given, for spherical
    ones, see `spherical_wave`.
    """

    def reflection(cosine: FloatArray, length_m: FloatArray) -> ComplexArray:
        z = np.broadcast_to(impedance, (len(cosine), len(impedance)))
        return spherical_wave(z, cosine, length_m, wavenumber_per_m)

    return reflection


def bulk_reacting(
    frequency_hz: ComplexArray,
    flow_resistivity: float,
    thickness_m: float,
    speed_m_s: float,
    wavenumber_per_m: ComplexArray | None = None,
) -> Reflection:
    """Return the reflection of a porous layer in which sound runs along the wall as well.

    Miki's material before a rigid wall; waves are refracted into it [1]_. A wall that is not
    locally reacting, which no impedance describes. Spherical waves are taken to see the impedance
    at the angle at which they strike.

    References
    ----------
    .. [1] J.-F. Allard, N. Atalla, "Propagation of Sound in Porous Media" (2009), section 3.
    """
    k = 2.0 * np.pi * frequency_hz / speed_m_s
    own, wave = miki_material(frequency_hz / flow_resistivity)

    def reflection(cosine: FloatArray, length_m: FloatArray) -> ComplexArray:
        sine2 = 1.0 - cosine[:, None] ** 2
        normal = np.sqrt((wave * k) ** 2 - k**2 * sine2)
        z = -1j * own * wave * k / normal / np.tan(normal * thickness_m)
        return spherical_wave(z, cosine, length_m, wavenumber_per_m)

    return reflection


def spherical_wave(
    impedance: ComplexArray,
    cosine: FloatArray,
    length_m: FloatArray,
    wavenumber_per_m: ComplexArray | None,
) -> ComplexArray:
    """Return ``R + (1 - R) F(w)`` by the error function of scipy, or R without a wavenumber.

    Written for ``exp(-j w t)``, hence the conjugates; see
    `roomfit.impedance.wave_model`.
    """
    turned = impedance * cosine[:, None]
    plane = (turned - 1.0) / (turned + 1.0)
    if wavenumber_per_m is None:
        return np.asarray(plane)
    beta = np.conj(1.0 / impedance)
    w = np.sqrt(0.5j * np.conj(wavenumber_per_m) * length_m[:, None]) * (beta + cosine[:, None])
    loss = np.conj(1.0 + 1j * np.sqrt(np.pi) * w * wofz(w))
    return np.asarray(plane + (1.0 - plane) * loss)
