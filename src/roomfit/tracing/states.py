"""A room in several states traced once: its surfaces stay, and with them every path.

The trace tells apart the surfaces that differ in some state; afterwards each state's pairs count
the hits of the same paths by the materials of that state.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from roomfit.base.errors import InputError
from roomfit.base.typing import IntArray
from roomfit.materials.priors import Scattering, coefficients_in_order
from roomfit.room.scene import Room, Scene, materials_of_surfaces, pair_states, select_pairs
from roomfit.tracing.paths import Paths, paths_of_pairs


def parts_of(room: Room) -> tuple[Room, IntArray]:
    """Return a room with a material for each set of surfaces that are alike in every state."""
    owners = materials_of_surfaces(room)
    of_part, part_of_surface = np.unique(owners, axis=1, return_inverse=True)
    names = [" / ".join(room.materials[m] for m in column) for column in of_part.T]
    alone = replace(
        room,
        materials=tuple(names),
        surface_material=part_of_surface.reshape(-1),
        states=(),
        objects=(),
    )
    return alone, np.asarray(of_part)


def as_one_state(scene: Scene, scattering: Scattering) -> tuple[Scene, Scattering]:
    """Return what has to be traced: every source and receiver once, and the scattering of parts."""
    room, of_part = parts_of(scene.room)
    coefficients = coefficients_in_order(scattering, scene.room.materials)[..., of_part]
    differs = np.any(coefficients != coefficients[..., :1, :], axis=-2).reshape(
        -1, of_part.shape[1]
    )
    if differs.any():
        part = int(np.flatnonzero(differs.any(axis=0))[0])
        one, *others = dict.fromkeys(scene.room.materials[m] for m in of_part[:, part])
        raise InputError(
            "materials that replace each other between states scatter differently",
            found=", ".join((one, *others)),
            needed="one scattering coefficient for all of them, since the room is traced once",
            hint=f"give {', '.join(others)} the scattering of {one}",
        )
    first = np.unique(scene.pairs, axis=0, return_index=True)[1]
    single = select_pairs(scene, np.sort(first))
    return replace(single, room=room, pair_state=None), Scattering(
        room.materials, coefficients[..., 0, :]
    )


def in_every_state(paths: Paths, single: Scene, scene: Scene, scattering: Scattering) -> Paths:
    """Return the paths of every pair of a scene from those of its sources and receivers."""
    _, of_part = parts_of(scene.room)
    n_materials = len(scene.room.materials)
    number = {tuple(pair): i for i, pair in enumerate(single.pairs.tolist())}
    of_pair = paths_of_pairs(paths)
    rows = [of_pair[number[tuple(ends)]] for ends in scene.pairs.tolist()]
    last = np.cumsum([own.size for own in rows])
    # each array is there once: all states together may be all that memory holds
    specular, diffuse = (np.empty((last[-1], n_materials), dtype=np.uint16) for _ in range(2))
    for own, end, state in zip(rows, last, pair_states(scene), strict=True):
        by_material = np.zeros((len(of_part[state]), n_materials), dtype=np.uint16)
        by_material[np.arange(len(of_part[state])), of_part[state]] = 1
        here = slice(end - own.size, end)
        np.matmul(paths.hits_specular[own], by_material, out=specular[here])
        np.matmul(paths.hits_diffuse[own], by_material, out=diffuse[here])
    pair = np.repeat(np.arange(len(rows), dtype=np.int32), [own.size for own in rows])
    chosen, transform = np.concatenate(rows), paths.image_transform
    return replace(
        paths,
        n_pairs=len(scene.pairs),
        materials=scene.room.materials,
        pair=pair,
        hits_specular=specular,
        hits_diffuse=diffuse,
        length_m=paths.length_m[chosen],
        weight_per_m2=paths.weight_per_m2[chosen],
        departure=paths.departure[chosen],
        arrival=paths.arrival[chosen],
        batch=paths.batch[chosen],
        image_transform=None if transform is None else transform[chosen],
        sampling_scattering=np.atleast_2d(coefficients_in_order(scattering, scene.room.materials)),
    )
