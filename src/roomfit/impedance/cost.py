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
# Walls held against beams, of all sources: some ten seconds.
MOST_WORK = 3e7
# Of a fixed point that each step brings at least four times as near.
_STEPS = 6
# In rooms of so few triangles the search is never what costs.
_FEW_TRIANGLES = 60


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
    `tau_s`. How many walls the search for them meets is counted, not estimated, in a room of many
    walls.
    """
    reflections = reflections_to_weigh(scene, n_frequencies, lengths * tau_s)
    if reflections > MOST_REFLECTIONS:
        affordable_s = tau_s
        for _ in range(_STEPS):
            count = reflections_to_weigh(scene, n_frequencies, lengths * affordable_s)
            affordable_s *= (MOST_REFLECTIONS / count) ** 0.25
        found = f"{reflections:.2g} reflections times frequencies"
        raise _too_much(tau_s, affordable_s, found, "fewer frequencies")
    mesh = scene.room.mesh
    if len(mesh.triangles) <= _FEW_TRIANGLES:
        return
    work = MOST_WORK / max(len(np.unique(scene.pairs[:, 0])), 1)
    affordable_s = affordable_duration_s(scene, lengths * tau_s, work=work, images=1e6) / lengths
    # what is asked for comes back as it is, up to rounding
    if affordable_s < 0.999 * tau_s:
        found = f"a room of {len(mesh.triangles)} triangles"
        raise _too_much(tau_s, affordable_s, found, "a room of fewer walls")


def reflections_to_weigh(scene: Scene, n_frequencies: int, longest_s: float) -> float:
    """Return about how many reflections all pairs have up to a duration, times frequencies."""
    mesh = scene.room.mesh
    length_m = longest_s * speed_of_sound_m_s(scene.air)
    images = expected_images(abs(volume_m3(mesh)), length_m)
    # paths that long, and three quarters of it on average
    hits = 1.0 + 0.75 * length_m / abs(mean_free_path_m(mesh))
    return images * hits * len(scene.pairs) * n_frequencies


def _too_much(tau_s: float, affordable_s: float, found: str, else_try: str) -> InputError:
    longest_ms = math.floor(affordable_s * 1e4) / 10.0
    return InputError(
        "the exponential window lets more reflections through than can be weighed in minutes",
        found=f"tau = {1000.0 * tau_s:g} ms, {found}",
        needed=f"tau of at most {longest_ms:g} ms here",
        hint=f"choose a shorter window, or {else_try}",
    )
