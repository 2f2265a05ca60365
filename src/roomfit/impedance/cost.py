"""What a wave model will cost, asked before its paths are looked for."""

from __future__ import annotations

import math

import numpy as np

from roomfit.air import speed_of_sound_m_s
from roomfit.errors import InputError
from roomfit.geometry.measures import mean_free_path_m, volume_m3
from roomfit.scene.scene import Scene
from roomfit.tracing.images_budget import affordable_duration_s, expected_images

# Reflections times frequencies, of all pairs: a fit of so many takes some ten minutes on one core.
MOST_REFLECTIONS = 1e9
# Walls held against beams, of all sources: some twenty seconds.
MOST_WORK = 1e8


def check_cost(scene: Scene, n_frequencies: int, tau_s: float, lengths: float) -> None:
    """Refuse a model whose paths are too many to be weighed, or to be found, within minutes.

    Parameters
    ----------
    scene : Scene
    n_frequencies : int
    tau_s : float
    lengths : float
        Longest path in units of the speed of sound times `tau_s`.

    Raises
    ------
    InputError
        Names the longest time constant that can be afforded.

    Notes
    -----
    Images within a length fill space with one for each volume of the room, whatever its shape, and
    a path is reflected once a mean free path; so the reflections grow with the fourth power of
    `tau_s`. How many walls the search for them meets is counted, not estimated, in a room that is
    no box.
    """
    longest_s = lengths * tau_s
    length_m = longest_s * speed_of_sound_m_s(scene.air)
    mesh = scene.room.mesh
    images = expected_images(abs(volume_m3(mesh)), length_m)
    hits = 1.0 + 0.75 * length_m / abs(mean_free_path_m(mesh))
    reflections = images * hits * len(scene.pairs) * n_frequencies
    if reflections > MOST_REFLECTIONS:
        affordable_s = tau_s * (MOST_REFLECTIONS / reflections) ** 0.25
        raise _too_much(tau_s, affordable_s, f"{images:.3g} images a pair", "fewer frequencies")
    if scene.room.shoebox_m is not None:
        return
    work = MOST_WORK / max(len(np.unique(scene.pairs[:, 0])), 1)
    affordable_s = affordable_duration_s(scene, longest_s, work=work, images=1e6) / lengths
    # what is asked for comes back as it is, up to rounding
    if affordable_s < 0.999 * tau_s:
        found = f"{len(mesh.triangles)} triangles, {images:.3g} images a pair"
        raise _too_much(tau_s, affordable_s, found, "a room of fewer walls")


def _too_much(tau_s: float, affordable_s: float, found: str, else_try: str) -> InputError:
    shortest = math.floor(affordable_s * 1e4) / 10.0
    return InputError(
        "the exponential window lets more reflections through than can be weighed in minutes",
        found=f"tau = {1000.0 * tau_s:g} ms, {found}",
        needed=f"tau of at most {shortest:g} ms here",
        hint=f"choose a shorter window, or {else_try}",
    )
