"""Which structure finds the next wall: chosen once per room, compiled into the trace."""

# ruff: noqa: ARG001, ARG005 -- numba matches overloads by the names of all their arguments

from __future__ import annotations

from typing import Any, TypeAlias

from numba.extending import overload

from roomfit.scene.room import Room
from roomfit.tracing.bounce import Vector
from roomfit.tracing.facets import facets_of
from roomfit.tracing.planes import Planes, convex_planes, material_in_plane, nearest_plane
from roomfit.tracing.tree import Tree, nearest_in_tree, tree_of

Walls: TypeAlias = Planes | Tree


def walls_of(room: Room) -> Walls:
    """Return the structure that suits a room: planes where it is convex with few of them.

    A tree is quicker than trying every facet even where there are only eight.
    """
    planes = convex_planes(room)
    if planes is not None:
        return planes
    return tree_of(*facets_of(room))


def next_wall(walls: Walls, o: Vector, d: Vector, last: int) -> tuple[float, int]:
    """Return distance and number of the wall that a ray from `o` meets first.

    Only for use in kernels, where the type of `walls` picks the method. Infinity and -1 come back
    where the ray meets nothing: it has left through a leak.

    Parameters
    ----------
    last : int
        The wall on which the ray starts, -1 for none.
    """
    raise TypeError("only compiled code may call this")


def wall_material(walls: Walls, wall: int, p: Vector) -> int:
    """Return the material of a wall at one of its points; only for use in kernels."""
    raise TypeError("only compiled code may call this")


def _kind(walls: Any) -> Any:
    return getattr(walls, "instance_class", None)


@overload(next_wall, strict=False)
def _next_wall(walls: Any, o: Any, d: Any, last: Any) -> Any:
    if _kind(walls) is Planes:
        return lambda walls, o, d, last: nearest_plane(walls, o, d)
    if _kind(walls) is Tree:
        return lambda walls, o, d, last: nearest_in_tree(walls, o, d, last)
    return None


@overload(wall_material, strict=False)
def _wall_material(walls: Any, wall: Any, p: Any) -> Any:
    if _kind(walls) is Planes:
        return lambda walls, wall, p: material_in_plane(walls, wall, p)
    if _kind(walls) is Tree:
        return lambda walls, wall, p: walls.material[wall]
    return None
