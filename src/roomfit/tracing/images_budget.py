"""How far image sources pay: their number beforehand, and the time that a budget of work buys."""

from __future__ import annotations

import math

import numpy as np

from roomfit.air import speed_of_sound_m_s
from roomfit.scene.scene import Scene
from roomfit.tracing.beam_found import DONE
from roomfit.tracing.beam_tree import beam_tree
from roomfit.tracing.images_polyhedron import distances_to_m, limits_of
from roomfit.tracing.images_walls import mirrors_of

# Steps in which a duration is tried; a step costs some 1.1**5 = 1.6 times the one before.
_STEP = 1.1


def expected_images(volume_m3: float, length_m: float) -> float:
    """Return how many images a receiver sees within a distance, on average over a closed room.

    Whatever its shape, the images seen fill space with one for each volume of the room:
    ``4/3 pi length**3 / volume``.
    """
    return 4.0 / 3.0 * math.pi * length_m**3 / volume_m3


def affordable_duration_s(
    scene: Scene,
    longest_s: float,
    *,
    order: int = 1000,
    work: float = 1e7,
    images: float = 2e5,
) -> float:
    """Return the duration up to which the images of any one source of a scene cost so much.

    Counted, not timed, so that the same scene gives the same answer on any machine.

    Parameters
    ----------
    scene : Scene
    longest_s : float
        No more is tried.
    order : int
        Most hits of a path.
    work : float
        Walls held against beams for one source; ten million take about 2 s on one core.
    images : float
        Images kept for one source, all receivers together.

    Returns
    -------
    float
        `longest_s`, or less by a power of 1.1; at least the hundredth part of it, even where that
        costs more.
    """
    walls, blockers = mirrors_of(scene.room)
    speed = speed_of_sound_m_s(scene.air)
    affordable_s = longest_s
    for source in np.unique(scene.pairs[:, 0]):
        own = scene.pairs[scene.pairs[:, 0] == source, 1]
        receivers = np.array([scene.receivers[r].position_m for r in own])
        to_receiver_m = distances_to_m(walls, receivers)
        start = np.array(scene.sources[source].position_m)
        duration_s = longest_s / 100.0
        while duration_s < affordable_s:
            next_s = min(duration_s * _STEP, affordable_s)
            # images count for their hits in the tree: a generous bound keeps it from growing
            limits = limits_of(order, next_s * speed, work, 100.0 * images)
            found = beam_tree(walls, blockers, start, receivers, to_receiver_m, limits)
            if found.ending != DONE or len(found.receiver) > images:
                break
            duration_s = next_s
        affordable_s = duration_s
    return affordable_s


def affordable_order(
    scene: Scene,
    most: int,
    duration_s: float,
    *,
    work: float = 1e7,
    images: float = 2e5,
) -> int:
    """Return the order up to which the images of any one source of a scene cost so much.

    For rooms of thousands of walls, where each order costs a hundred times the one before it.
    Counted, not timed, so that the same scene gives the same answer on any machine.

    Parameters
    ----------
    scene : Scene
    most : int
        No more is tried; 0 or more.
    duration_s : float
        Of the trace.
    work, images : float
        As of `affordable_duration_s`.

    Returns
    -------
    int
        At least 0: the direct sound costs nothing.
    """
    walls, blockers = mirrors_of(scene.room)
    length_m = duration_s * speed_of_sound_m_s(scene.air)
    affordable = most
    for source in np.unique(scene.pairs[:, 0]):
        own = scene.pairs[scene.pairs[:, 0] == source, 1]
        receivers = np.array([scene.receivers[r].position_m for r in own])
        to_receiver_m = distances_to_m(walls, receivers)
        start = np.array(scene.sources[source].position_m)
        order = 0
        while order < affordable:
            limits = limits_of(order + 1, length_m, work, 100.0 * images)
            found = beam_tree(walls, blockers, start, receivers, to_receiver_m, limits)
            if found.ending != DONE or len(found.receiver) > images:
                break
            order += 1
        affordable = order
    return affordable
