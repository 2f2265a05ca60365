"""A room in several states is traced once and answers for each of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roomfit.base.errors import InputError
from roomfit.materials.priors import Scattering, uniform_scattering
from roomfit.room.mesh import shoebox_mesh
from roomfit.room.scene import (
    Room,
    Scene,
    pair_names,
    room_from_mesh,
    scene_of,
    shoebox_room,
    with_states,
)
from roomfit.tracing.image_sources import trace_images
from roomfit.tracing.paths import Paths, TraceSettings
from roomfit.tracing.trace import trace

LENGTHS_M = (6.0, 5.0, 3.0)
SIX = {name: name for name in ("west", "east", "south", "north", "floor", "ceiling")}
CLOSED = {"south": "curtain", "west": "curtain"}
SETTINGS = TraceSettings(duration_s=0.15, n_rays=3000, image_order=2, n_batches=4)


def any_room(materials: dict[str, str], is_box: bool) -> Room:
    """The box, or the same with a ceiling that rises to the east."""
    if is_box:
        return shoebox_room(LENGTHS_M, materials)
    mesh = shoebox_mesh(LENGTHS_M)
    east_and_up = np.all(mesh.vertices_m[:, [0, 2]] > 0.0, axis=1)
    raised = mesh.vertices_m + np.outer(east_and_up, [0.0, 0.0, 0.8])
    return room_from_mesh(replace(mesh, vertices_m=raised), materials)


def two_states(is_box: bool = True) -> Scene:
    """A room with two sources and two receivers, measured as described and with curtains."""
    room = with_states(any_room(SIX, is_box), {"closed": CLOSED})
    points = {"A": (1.0, 1.2, 1.5), "B": (2.0, 3.9, 1.1)}, {"M": (4.6, 3.1, 1.4), "N": (4, 1, 2)}
    scene = scene_of(room, *points, [("A", "M"), ("B", "M"), ("B", "N"), ("A", "M")])
    return replace(scene, pair_state=np.array([0, 1, 0, 1]))


def described(materials: dict[str, str], is_box: bool) -> Scene:
    """The same room and pairs, in one state that is described by itself."""
    room = any_room(materials, is_box)
    both = two_states(is_box)
    return scene_of(
        room, both.sources, both.receivers, [n[:2] for n in dict.fromkeys(pair_names(both))][:3]
    )


def hits_by_name(paths: Paths, pair: int) -> dict[str, np.ndarray]:
    own = paths.pair == pair
    order = np.lexsort((paths.length_m[own], paths.weight_per_m2[own]))
    total = (paths.hits_specular + paths.hits_diffuse)[own][order]
    found = {n: total[:, i] for i, n in enumerate(paths.materials) if total[:, i].any()}
    return found | {"length": paths.length_m[own][order]}


@pytest.mark.parametrize("is_box", [True, False])
@pytest.mark.parametrize("scattering", [0.0, 0.2])
def test_each_state_has_the_paths_of_a_room_that_is_described_so(is_box, scattering):
    both = two_states(is_box)
    found = trace(both, SETTINGS, uniform_scattering(both.room.materials, scattering)).paths
    assert found.materials == (*SIX, "curtain")
    for state, materials in enumerate((SIX, SIX | CLOSED)):
        own = described(materials, is_box)
        alone = trace(own, SETTINGS, uniform_scattering(own.room.materials, scattering)).paths
        names = [(s, r) for s, r, _ in pair_names(own)]
        for pair, (source, receiver, name) in enumerate(pair_names(both)):
            if name != ("", "closed")[state]:
                continue
            expected = hits_by_name(alone, names.index((source, receiver)))
            for key, values in hits_by_name(found, pair).items():
                np.testing.assert_array_equal(values, expected[key], err_msg=key)


def test_image_sources_alone_know_the_states():
    both = two_states()
    found = trace_images(both, 1, 0.1, uniform_scattering(both.room.materials, 0.0))
    south = found.materials.index("south"), found.materials.index("curtain")
    struck = [found.hits_specular[found.pair == pair].sum(axis=0)[list(south)] for pair in (0, 3)]
    assert [s.tolist() for s in struck] == [[1, 0], [0, 2]]


def test_materials_that_replace_each_other_must_scatter_alike():
    both = two_states()
    coefficients = np.where(np.array(both.room.materials) == "curtain", 0.5, 0.1)
    with pytest.raises(InputError, match="replace each other") as error:
        trace(both, SETTINGS, Scattering(both.room.materials, coefficients))
    assert "curtain" in str(error.value)


@pytest.mark.parametrize(
    ("states", "message"),
    [
        ({"closed": {"sooth": "curtain"}}, "does not exist"),
        ({"": {"south": "curtain"}}, "without a name"),
    ],
)
def test_a_state_that_cannot_be_is_refused(states, message):
    with pytest.raises(InputError, match=message):
        with_states(shoebox_room(LENGTHS_M, SIX), states)
