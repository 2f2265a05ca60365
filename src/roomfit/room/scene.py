"""A room whose every surface has a material, with sources, receivers and air.

That is all that a simulation needs but the absorption. Rooms and positions are checked here: what a
room is like, whether it can be traced, and whether sources and receivers stand in the air.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from roomfit.base.air import Air
from roomfit.base.arguments import (
    check_known,
    check_name,
    did_you_mean,
    float_array,
    int_array,
    unique_names,
)
from roomfit.base.errors import InputError, located
from roomfit.base.findings import Code, Finding
from roomfit.base.polygon import Surface, place
from roomfit.base.typing import BoolArray, FloatArray, IntArray
from roomfit.room.build import axis_findings, examine
from roomfit.room.inside import is_inside, nearest_triangles
from roomfit.room.mesh import (
    SHOEBOX_SURFACES,
    Mesh,
    corners_m,
    fault,
    is_double_sided,
    mean_free_path_m,
    refuse,
    shoebox_mesh,
    surface_area_m2,
    triangle_areas_m2,
    volume_m3,
)


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Another state of a room: the same surfaces, some of other materials."""

    name: str
    surface_material: IntArray  #: int32 (n_surfaces,), index into the room's materials


@dataclass(frozen=True, slots=True)
class RoomObject:
    """What absorbs as an area in the volume: see `roomfit.materials.priors.object_prior`."""

    name: str
    #: States of the room in which it is there, "" for the room as it is described; None: in all
    states: tuple[str, ...] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Room:
    """A closed mesh and the material of each of its surfaces.

    A material is a set of faces that share one absorption; its value is no property of the room.
    An object stands among the materials, without a face.
    """

    mesh: Mesh
    materials: tuple[str, ...]  #: In the order of every array with a material axis
    surface_material: IntArray  #: int32 (n_surfaces,), index into `materials`
    #: Lengths in x, y, z of the box of `shoebox_room`, so that image sources can use the lattice;
    #: `mesh.surfaces` are then west (x = 0), east, south (y = 0), north, floor and ceiling
    shoebox_m: tuple[float, float, float] | None = None
    findings: tuple[Finding, ...] = ()  # what was repaired or doubtful in making it
    #: Further states in which it was measured, from `with_states`; their materials are among
    #: `materials`
    states: tuple[State, ...] = ()
    #: Standard deviations of a box's lengths in m, which then are fitted; 0: exact
    lengths_sd_m: tuple[float, float, float] | None = None
    objects: tuple[RoomObject, ...] = ()  #: From `with_objects`; the last of `materials`

    def __post_init__(self) -> None:
        if self.lengths_sd_m is not None:
            if self.shoebox_m is None:
                what = "only a box has lengths whose standard deviation can be specified"
                hint = "leave it out; a wall that stands elsewhere is looked for all the same"
                found, needed, where = "another room", "[room] shoebox", "[room] lengths_sd"
                raise InputError(what, where=where, found=found, needed=needed, hint=hint)
            float_array("lengths_sd", self.lengths_sd_m, (3,), low=0.0, high=1.0, unit="m")
        object.__setattr__(self, "materials", unique_names("material", self.materials))
        if not self.materials:
            needed, hint = "at least one material", "give every surface a material"
            raise InputError("a room without materials", found="none", needed=needed, hint=hint)
        n_surfaces, last = len(self.mesh.surfaces), len(wall_materials(self)) - 1

        def checked(owner: IntArray) -> IntArray:
            return int_array("material of each surface", owner, (n_surfaces,), low=0, high=last)

        object.__setattr__(self, "surface_material", checked(self.surface_material))
        states = tuple(
            replace(s, surface_material=checked(s.surface_material)) for s in self.states
        )
        object.__setattr__(self, "states", states)

    def __repr__(self) -> str:
        """Return volume, area, and the area of each material."""
        size = f"{volume_m3(self.mesh):.2f} m3 and {surface_area_m2(self.mesh):.2f} m2"
        areas = zip(self.materials, material_areas_m2(self), strict=True)
        return f"Room of {size}: {', '.join(f'{name} {area:.2f} m2' for name, area in areas)}"


def wall_materials(room: Room) -> tuple[str, ...]:
    """Return the materials of surfaces, objects left out: they stand before these."""
    return room.materials[: len(room.materials) - len(room.objects)]


def triangle_material(room: Room) -> IntArray:
    """Return the material index of every triangle, shape (n_triangles,)."""
    return np.asarray(room.surface_material[room.mesh.triangle_surface])


def materials_of_surfaces(room: Room) -> IntArray:
    """Return the material of every surface in every state, shape (1 + n_states, n_surfaces)."""
    return np.stack([room.surface_material, *(s.surface_material for s in room.states)])


def material_areas_m2(room: Room, state: int = 0) -> FloatArray:
    """Return the area of each material that sound can strike, shape (n_materials,).

    Both sides of a double-sided sheet count. Materials of other states only have none.

    `state` 0 is the room as it is described, i its i-th further state.
    """
    areas = triangle_areas_m2(room.mesh) * np.where(is_double_sided(room.mesh), 2.0, 1.0)
    owner = materials_of_surfaces(room)[state, room.mesh.triangle_surface]
    return np.asarray(np.bincount(owner, areas, len(room.materials)), dtype=np.float64)


def with_states(room: Room, states: Mapping[str, Mapping[str, str]]) -> Room:
    """Return a room with further states, in which some of its surfaces have other materials.

    A material that several states share has one absorption in all of them.

    Parameters
    ----------
    states : mapping from name to mapping from str to str
        In each state, from the name of a surface, a group or a file's material to a material, as
        of `room_from_mesh`; surfaces that are not named stay as they are.

    Raises
    ------
    InputError
        A key matches no surface, or a state has no name.

    Examples
    --------
    >>> room = shoebox_room((6, 5, 3), {"walls": "plaster", "floor": "carpet"})
    >>> two = with_states(room, {"curtains closed": {"north": "curtain"}})
    >>> two.materials
    ('plaster', 'carpet', 'ceiling', 'curtain')
    >>> material_areas_m2(two, 1).tolist()
    [48.0, 30.0, 30.0, 18.0]
    """
    unique_names("state", states)
    if room.objects:
        what, needed = "states are given after objects", "with_objects as the last step"
        n_objects = f"{len(room.objects)} objects"
        raise InputError(what, found=n_objects, needed=needed, hint="call with_states first")
    names, found = list(room.materials), []
    for state, materials in states.items():
        with located(f"states.{state}"):
            _check_keys(room.mesh.surfaces, materials, "materials")
        own = []
        for s, before in zip(room.mesh.surfaces, room.surface_material, strict=True):
            keys = [k for k in (s.name, s.group, s.file_material) if k is not None]
            material = next((materials[k] for k in keys if k in materials), names[before])
            if material not in names:
                names.append(material)
            own.append(names.index(material))
        found.append(State(state, np.array(own)))
    return replace(room, materials=tuple(names), states=(*room.states, *found))


def with_objects(room: Room, objects: Mapping[str, Sequence[str] | None]) -> Room:
    """Return a room in which objects stand: what absorbs in its volume, wherever it stands.

    Parameters
    ----------
    room : Room, with all of its states
    objects : mapping from name to sequence of str or None
        States in which each is there, "" for the room as it is described; None: in all.

    Raises
    ------
    InputError
        An object has the name of a material, or of a state that the room does not have.

    Examples
    --------
    >>> room = with_objects(shoebox_room((6, 5, 3), "plaster"), {"people": None})
    >>> room.materials, material_areas_m2(room).tolist()
    (('plaster', 'people'), [126.0, 0.0])
    """
    names = ["", *(s.name for s in room.states)]
    what = "an object stands in a state that the room does not have"
    needed = 'a table [[states]], or "" for the room as described'
    for name, states in objects.items():
        for state in states or ():
            where = f"objects.{name}.states"
            check_known(what, state, names, where=where, else_needed=needed)
    found = [RoomObject(k, None if v is None else tuple(v)) for k, v in objects.items()]
    return replace(room, materials=(*room.materials, *objects), objects=(*room.objects, *found))


_SHOWN = 12


def shoebox_room(lengths_m: ArrayLike, materials: str | Mapping[str, str]) -> Room:
    """Return a box with one corner at the origin and its materials.

    Parameters
    ----------
    lengths_m : array_like, shape (3,)
        Lengths along x, y and z, each 1 mm to 10 km.
    materials : str or mapping from str to str
        One material for all surfaces, or that of each: ``west`` (x = 0), ``east``, ``south``
        (y = 0), ``north``, ``floor`` and ``ceiling``; ``walls`` stands for the four upright ones
        that are not named. A surface that is not named is a material of its own, with its name.

    Returns
    -------
    Room
        Materials in the order of their first surface.

    Raises
    ------
    InputError
        A length is out of range, or a key names no surface.

    Examples
    --------
    >>> shoebox_room((6.0, 5.0, 3.0), "concrete").materials
    ('concrete',)
    >>> room = shoebox_room((6, 5, 3), {"walls": "plaster", "floor": "carpet", "ceiling": "tiles"})
    >>> dict(zip(room.materials, material_areas_m2(room).tolist()))
    {'plaster': 66.0, 'carpet': 30.0, 'tiles': 30.0}
    """
    mesh = shoebox_mesh(lengths_m)
    if isinstance(materials, str):
        materials = dict.fromkeys(SHOEBOX_SURFACES, materials)
    x, y, z = mesh.vertices_m.max(axis=0).tolist()
    return room_from_mesh(mesh, materials, (x, y, z))


def room_from_mesh(
    mesh: Mesh, materials: Mapping[str, str], shoebox_m: tuple[float, float, float] | None = None
) -> Room:
    """Give every surface its material.

    Parameters
    ----------
    materials : mapping from str to str
        From the name of a surface, a group or a file's material, in that precedence, to a
        material. What is not named keeps the file's material name.
    shoebox_m : tuple of three floats, optional
        Lengths, where the mesh is that of `shoebox_mesh`.

    Returns
    -------
    Room
        Materials in the order of their first surface.

    Raises
    ------
    InputError
        A key matches nothing, or a surface has no material.
    """
    refuse(material_findings(mesh, materials))
    used, owner = np.unique(mesh.triangle_surface, return_inverse=True)
    if len(used) < len(mesh.surfaces):  # others were drawn, which bound no air
        surfaces = tuple(mesh.surfaces[s] for s in used)
        mesh = replace(mesh, triangle_surface=owner, surfaces=surfaces)
    names = [str(name) for name in surface_materials(mesh.surfaces, materials)]
    order = tuple(dict.fromkeys(names))
    return Room(mesh, order, np.array([order.index(n) for n in names]), shoebox_m)


def surface_materials(
    surfaces: Iterable[Surface], materials: Mapping[str, str]
) -> tuple[str | None, ...]:
    """Return the material of every surface, None where neither the mapping nor the file has one."""
    keys = ((s.file_material, (s.name, s.group, s.file_material)) for s in surfaces)
    return tuple(
        next((materials[k] for k in names if k is not None and k in materials), default)
        for default, names in keys
    )


def material_findings(mesh: Mesh, materials: Mapping[str, str]) -> tuple[Finding, ...]:
    """Return a fault for surfaces without a material.

    Raises
    ------
    InputError
        A key matches no surface, group or material of the file; the names are listed.
    """
    _check_keys(mesh.surfaces, materials)
    owners = [name or None for name in surface_materials(mesh.surfaces, materials)]
    bare = np.array([name is None for name in owners])[mesh.triangle_surface]
    if not bare.any():
        return ()
    first = int(np.flatnonzero(bare)[0])
    name = mesh.surfaces[mesh.triangle_surface[first]].name
    area = float(triangle_areas_m2(mesh)[bare].sum())
    found = fault(
        Code.NO_MATERIAL,
        "surfaces without a material",
        where=f"{name!r} near {place(corners_m(mesh)[first].mean(axis=0))}",
        found=f"{len(np.unique(mesh.triangle_surface[bare]))} surfaces, {area:.2f} m2",
        needed="a material for every face",
        hint=f'name it in [room.materials], as in "{name}" = "plaster"',
        points_m=corners_m(mesh)[bare].mean(axis=1),
    )
    return (found,)


def material_areas(mesh: Mesh, materials: Mapping[str, str]) -> dict[str | None, float]:
    """Return the area in m2 of each material that sound can strike, largest first.

    The key None stands for surfaces without a material. Both sides of a sheet count.
    """
    areas = triangle_areas_m2(mesh) * np.where(is_double_sided(mesh), 2.0, 1.0)
    per_surface = np.bincount(mesh.triangle_surface, areas, len(mesh.surfaces))
    total: dict[str | None, float] = {}
    for name, area in zip(surface_materials(mesh.surfaces, materials), per_surface, strict=True):
        if area > 0.0:
            total[name] = total.get(name, 0.0) + float(area)
    return dict(sorted(total.items(), key=lambda item: -item[1]))


def _check_keys(
    surfaces: Iterable[Surface], materials: Mapping[str, str], where: str = "[room.materials]"
) -> None:
    names = [n for s in surfaces for n in (s.name, s.group, s.file_material) if n]
    known = list(dict.fromkeys(names))
    for key, material in materials.items():
        check_name("material", material, f"{where} {key!r}")
        what = "a material is given to a surface that does not exist"
        check_known(what, key, known, where=where)


@dataclass(frozen=True, slots=True)
class RoomCheck:
    """What a room is like."""

    volume_m3: float  # Approximate where the mesh is not closed
    surface_m2: float  # Area that sound can strike; both sides of a sheet in the air count
    mean_free_path_m: float  # 4 V / S
    size_m: tuple[float, float, float]  # of the bounding box along x, y and z
    n_triangles: int
    n_surfaces: int
    leak: float  # Share of flights from its surfaces that are lost through openings
    material_areas_m2: tuple[tuple[str | None, float], ...]  # Largest first; None: no material
    findings: tuple[Finding, ...]  # Repairs, doubts, and faults, which are the serious ones

    @property
    def traceable(self) -> bool:
        """Whether no fault forbids tracing the room."""
        return all(finding.severity != "serious" for finding in self.findings)


def check_mesh(
    mesh: Mesh, materials: Mapping[str, str], earlier: Iterable[Finding] = ()
) -> RoomCheck:
    """Examine a mesh and its materials.

    Parameters
    ----------
    mesh : Mesh
        Normals out of the air, see `roomfit.tracing.enclosure.reached`.
    materials : mapping from str to str
        As of `room_from_mesh`.
    earlier : iterable of Finding
        Those of reading and building the mesh; they come first in the result.

    Raises
    ------
    InputError
        A key of `materials` matches nothing.

    Examples
    --------
    >>> check = check_mesh(shoebox_mesh((6.0, 5.0, 3.0)), {"walls": "plaster"})
    >>> check.traceable, round(check.volume_m3, 9)
    (True, 90.0)
    >>> check.material_areas_m2
    (('plaster', 66.0), ('floor', 30.0), ('ceiling', 30.0))
    """
    doubts = *material_findings(mesh, materials), *axis_findings(mesh), *examine(mesh)
    earlier = tuple(earlier)
    leaks = [f.evidence["share"] for f in earlier if f.code in (Code.LEAK, Code.SMALL_LEAK)]
    x, y, z = np.ptp(mesh.vertices_m, axis=0).tolist()
    return RoomCheck(
        volume_m3=volume_m3(mesh),
        surface_m2=surface_area_m2(mesh),
        mean_free_path_m=mean_free_path_m(mesh),
        size_m=(x, y, z),
        n_triangles=len(mesh.triangles),
        n_surfaces=len(mesh.surfaces),
        leak=sum(leaks),
        material_areas_m2=tuple(material_areas(mesh, materials).items()),
        findings=(*earlier, *doubts),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Point:
    """A named position of a source or a receiver."""

    name: str
    position_m: FloatArray  #: (3,)
    position_sd_m: float | None = None  #: Of each coordinate; None where it is not specified

    def __post_init__(self) -> None:
        position = float_array(
            f"position of {self.name}", self.position_m, (3,), low=-1e6, high=1e6, unit="m"
        )
        object.__setattr__(self, "position_m", position)


@dataclass(frozen=True, slots=True, eq=False)
class PointGroup:
    """Positions that are off by one common offset, as those of an array that stands elsewhere."""

    name: str
    members: tuple[str, ...]  #: Names of sources and receivers; * and ? stand for any text
    sd_m: float | tuple[float, float, float]  #: Of the offset, of each axis alike or one by one

    def __post_init__(self) -> None:
        shape = (3,) if np.ndim(self.sd_m) else ()
        where = f"groups.{self.name}.sd"
        float_array(where, self.sd_m, shape, low=0.0, high=1.0, unit="m")
        if not self.members:
            where, hint = f"groups.{self.name}.members", "name sources or receivers"
            what, needed = "a group without members", "at least one name"
            raise InputError(what, where=where, found="none", needed=needed, hint=hint)


def check_groups(members: Mapping[str, Sequence[str]], names: Sequence[str]) -> None:
    """Refuse a group one of whose members or patterns is no name of a source or a receiver.

    Raises
    ------
    InputError
        With the names that there are.
    """
    for group, patterns in members.items():
        for pattern in patterns:
            if not any(fnmatchcase(name, pattern) for name in names):
                what = "a group names neither a source nor a receiver"
                where, found = f"groups.{group}.members", repr(pattern)
                needed = f"a name or pattern of {', '.join(names[:_SHOWN])}"
                hint = did_you_mean(pattern, names)
                raise InputError(what, where=where, found=found, needed=needed, hint=hint)


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Everything that directs the sound, and nothing that absorbs it at walls; see `scene_of`."""

    room: Room
    sources: tuple[Point, ...]  #: Omnidirectional with unit sound power
    receivers: tuple[Point, ...]
    pairs: IntArray  #: int32 (n_pairs, 2), index of source and of receiver of each wanted response
    air: Air
    #: int32 (n_pairs,), state of the room in each wanted response: 0 as it is described, i its i-th
    #: further state; left out: 0
    pair_state: IntArray | None = None
    groups: tuple[PointGroup, ...] = ()  #: Whose common offsets are fitted

    def __post_init__(self) -> None:
        unique_names("source", (s.name for s in self.sources))
        unique_names("receiver", (r.name for r in self.receivers))
        pairs = int_array("pairs", self.pairs, (None, 2), low=0)
        limits = (len(self.sources), len(self.receivers))
        for column, high in enumerate(limits):
            int_array("pair", pairs[:, column], (len(pairs),), low=0, high=high - 1)
        if self.pair_state is not None:
            n, last = len(pairs), len(self.room.states)
            state = int_array("state of each pair", self.pair_state, (n,), low=0, high=last)
            object.__setattr__(self, "pair_state", state)
        object.__setattr__(self, "sources", tuple(self.sources))
        object.__setattr__(self, "receivers", tuple(self.receivers))
        object.__setattr__(self, "pairs", pairs)
        unique_names("group", (g.name for g in self.groups))


PairName = tuple[str, str, str]
"""Names of source, receiver and state; the room as it is described has the name ""."""


def pair_names(scene: Scene) -> list[PairName]:
    """Return source, receiver and state of every pair of a scene, in their order."""
    states = ("", *(s.name for s in scene.room.states))
    return [
        (scene.sources[s].name, scene.receivers[r].name, states[k])
        for (s, r), k in zip(scene.pairs, pair_states(scene), strict=True)
    ]


def pair_states(scene: Scene) -> IntArray:
    """Return the state of each pair, shape (n_pairs,): 0 as described, i the i-th further state."""
    return np.zeros(len(scene.pairs), np.int32) if scene.pair_state is None else scene.pair_state


def object_pairs(scene: Scene) -> BoolArray | None:
    """Return which materials are objects in each pair's state, (n_pairs, n_materials), or None."""
    room = scene.room
    if not room.objects:
        return None
    names = np.array(["", *(s.name for s in room.states)])[pair_states(scene)]
    stands = np.zeros((len(scene.pairs), len(room.materials)), dtype=np.bool_)
    for column, one in enumerate(room.objects, start=len(wall_materials(room))):
        stands[:, column] = True if one.states is None else np.isin(names, one.states)
    return stands


def select_pairs(scene: Scene, kept: BoolArray | IntArray | slice) -> Scene:
    """Return a scene with the chosen ones of its pairs."""
    state = None if scene.pair_state is None else scene.pair_state[kept]
    return replace(scene, pairs=scene.pairs[kept], pair_state=state)


def named_pairs(scene: Scene, names: Container[tuple[str, str]]) -> Scene:
    """Return a scene with those of its pairs whose source and receiver are named."""
    chosen = [(scene.sources[s].name, scene.receivers[r].name) in names for s, r in scene.pairs]
    return select_pairs(scene, np.array(chosen, dtype=np.bool_))


def scene_of(
    room: Room,
    sources: Mapping[str, ArrayLike] | Sequence[Point],
    receivers: Mapping[str, ArrayLike] | Sequence[Point],
    pairs: Iterable[tuple[str, str]] | None = None,
    air: Air | None = None,
) -> Scene:
    """Return a scene from the names of sources and receivers.

    Parameters
    ----------
    room : Room
    sources, receivers : mapping from name to position, or sequence of Point
        Positions in metres, shape (3,), in the room's coordinates.
    pairs : iterable of (source, receiver) names, optional
        Whose responses are wanted; left out: every source with every receiver, receivers fastest.
    air : Air, optional
        Left out: 20 degrees Celsius, 50 % and 101.325 kPa.

    Raises
    ------
    InputError
        A position is not three finite numbers or not in the air of the room, a source stands at a
        receiver, a name occurs twice, or a pair names no source or receiver.

    Examples
    --------
    >>> room = shoebox_room((6.0, 5.0, 3.0), "plaster")
    >>> scene = scene_of(room, {"LS1": (1, 1, 1.5)}, {"MP1": (4, 3, 1.2), "MP2": (2, 4, 1.2)})
    >>> scene.pairs.tolist()
    [[0, 0], [0, 1]]
    >>> scene_of(room, scene.sources, scene.receivers, [("LS1", "MP2")]).pairs.tolist()
    [[0, 1]]
    """
    emitters, listeners = _points(sources), _points(receivers)
    named = unique_names("source", (p.name for p in emitters))
    received = unique_names("receiver", (p.name for p in listeners))
    refuse(position_findings(room, emitters, listeners))
    if pairs is None:
        pairs = [(s, r) for s in named for r in received]
    indices = []
    for source, receiver in pairs:
        for kind, name, known in (("source", source, named), ("receiver", receiver, received)):
            what = f"a pair names a {kind} that the scene does not have"
            check_known(what, name, known, where="pairs")
        indices.append((named.index(source), received.index(receiver)))
    if not indices:
        needed, hint = "a source and a receiver", "give scene_of one of each"
        raise InputError("a scene without pairs", found="none", needed=needed, hint=hint)
    return Scene(room, emitters, listeners, np.array(indices), Air() if air is None else air)


def _points(given: Mapping[str, ArrayLike] | Sequence[Point]) -> tuple[Point, ...]:
    if isinstance(given, Mapping):
        return tuple(Point(name, np.asarray(position)) for name, position in given.items())
    return tuple(given)


def distances_m(scene: Scene) -> FloatArray:
    """Return the straight distance of every pair, shape (n_pairs,)."""
    sources = np.array([s.position_m for s in scene.sources])
    receivers = np.array([r.position_m for r in scene.receivers])
    steps = receivers[scene.pairs[:, 1]] - sources[scene.pairs[:, 0]]
    return np.asarray(np.linalg.norm(steps, axis=1))


def check_apart(scene: Scene) -> None:
    """Refuse a source that stands where a receiver of one of its pairs is."""
    distances = distances_m(scene)
    if distances.size and distances.min() < 1e-6:
        source, receiver = scene.pairs[int(np.argmin(distances))]
        where = f"{scene.sources[source].name} and {scene.receivers[receiver].name}"
        what, found = "a source stands where a receiver is", "less than a micrometre apart"
        hint = "correct one of the two positions"
        raise InputError(what, where=where, found=found, needed="two places", hint=hint)


# A point nearer to a wall than 1 cm counts as inside it; positions are seldom known better.
NEAREST_WALL_M = 0.01
NEAREST_PAIR_M = 0.01


def position_findings(
    room: Room, sources: Sequence[Point], receivers: Sequence[Point]
) -> tuple[Finding, ...]:
    """Return a fault for each point outside the room or in a wall, and each pair at one position.

    `roomfit.room.mesh.refuse` raises the first one.
    """
    named = [*(("source", p) for p in sources), *(("receiver", p) for p in receivers)]
    if not named:
        return ()
    points = np.array([p.position_m for _, p in named])
    inside = is_inside(room.mesh, points)
    distance, triangle = nearest_triangles(room.mesh, points)
    low, high = room.mesh.vertices_m.min(axis=0), room.mesh.vertices_m.max(axis=0)
    found: list[Finding] = []

    def wrong(code: Code, what: str, at: FloatArray, measured: str, needed: str, hint: str) -> None:
        where = place(at)
        found.append(
            fault(code, what, where=where, found=measured, needed=needed, hint=hint, points_m=[at])
        )

    for i, (kind, point) in enumerate(named):
        who = f"{kind} {point.name!r}"
        wall = room.mesh.surfaces[room.mesh.triangle_surface[triangle[i]]].name
        if distance[i] < NEAREST_WALL_M:
            measured = f"{1e3 * distance[i]:.1f} mm from surface {wall!r}"
            needed = f"at least {1e3 * NEAREST_WALL_M:.0f} mm"
            what, hint = "stands in a wall", "correct its position: it stood in front of the wall"
            wrong(Code.POSITION_IN_WALL, f"{who} {what}", point.position_m, measured, needed, hint)
        elif not inside[i]:
            measured = f"{distance[i]:.3g} m from the nearest surface, {wall!r}"
            reach = f"the room reaches from {place(low)} to {place(high)}"
            needed, what = f"a position in the air of the room; {reach}", "stands outside the room"
            hint = "check unit, up axis and origin of the room file against the positions"
            if np.all((point.position_m > low) & (point.position_m < high)):
                what = "stands within a body or behind a wall, where no sound of the room comes"
            wrong(Code.POSITION_OUTSIDE, f"{who} {what}", point.position_m, measured, needed, hint)
    for source, receiver in product(sources, receivers):
        apart_m = float(np.linalg.norm(source.position_m - receiver.position_m))
        if apart_m < NEAREST_PAIR_M:
            what = f"source {source.name!r} stands where receiver {receiver.name!r} is"
            measured, needed = f"{1e3 * apart_m:.1f} mm", f"at least {1e3 * NEAREST_PAIR_M:.0f} mm"
            at, hint = source.position_m, "check the two positions"
            wrong(Code.SOURCE_AT_RECEIVER, what, at, f"{measured} apart", needed, hint)
    return (*misread(room.mesh, points), *found)


def is_clear_of_walls(room: Room, positions_m: FloatArray, distance_m: float) -> BoolArray:
    """Return which positions, (n, 3), are inside and so far from all walls, shape (n,)."""
    clear = is_inside(room.mesh, positions_m)
    clear[clear] = nearest_triangles(room.mesh, positions_m[clear])[0] >= distance_m - 1e-9
    return np.asarray(clear)


_READINGS: tuple[tuple[str, FloatArray], ...] = (
    ("as feet", 0.3048 * np.eye(3)),
    ("as inches", 0.0254 * np.eye(3)),
    ("as centimetres", 0.01 * np.eye(3)),
    ("as millimetres", 0.001 * np.eye(3)),
    ("with y up, as x, -z, y", np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])),
    ("as x, z, y", np.eye(3)[[0, 2, 1]]),
    ("as y, x, z", np.eye(3)[[1, 0, 2]]),
)


def misread(mesh: Mesh, points_m: FloatArray) -> list[Finding]:
    """Return a fault where points, (n, 3), are all inside in another unit, or with other axes."""
    outside = ~is_inside(mesh, points_m)
    if np.count_nonzero(outside) < max(2, len(points_m) / 2):
        return []
    for what, matrix in _READINGS:
        if np.all(is_inside(mesh, points_m @ matrix.T)):
            return [
                fault(
                    Code.POSITIONS_MISREAD,
                    "room and positions are in different units or axes",
                    found=f"{np.count_nonzero(outside)} of {len(points_m)} positions outside of "
                    f"the room, and all of them inside if they are taken {what}",
                    needed="metres, z up, in the frame of the room",
                    hint="check unit and up of the room, or give the table of positions a heading "
                    "with its unit, as name,x [cm],y [cm],z [cm]",
                    points_m=points_m[outside],
                )
            ]
    return []


def plan_in_words(scene: Scene) -> tuple[str, ...]:
    """Return where every source and receiver stands, a sentence each.

    No recording tells a plan from its mirror image: only who knows the room sees that a sentence
    is wrong. In a box the distances from the nearer one of two opposite walls and from the floor;
    in any other room those from the nearest surface and from its lowest point.

    Examples
    --------
    >>> room = shoebox_room((6.0, 5.0, 3.0), {"west": "curtain", "north": "glass"})
    >>> plan_in_words(scene_of(room, {"LS1": (1.2, 4.0, 0.9)}, {"MP1": (4.0, 2.0, 1.2)}))[0]
    'LS1 stands 1.20 m from west (curtain), 1.00 m from north (glass), 0.90 m from floor.'
    """
    room, points = scene.room, (*scene.sources, *scene.receivers)
    names = [
        surface.name + ("" if surface.name == material else f" ({material})")
        for surface, material in zip(
            room.mesh.surfaces, (room.materials[m] for m in room.surface_material), strict=True
        )
    ]
    at_m = np.array([p.position_m for p in points])
    if room.shoebox_m is None:
        distance_m, triangle = nearest_triangles(room.mesh, at_m)
        height_m = at_m[:, 2] - room.mesh.vertices_m[:, 2].min()
        return tuple(
            f"{p.name} stands {d:.2f} m from {names[room.mesh.triangle_surface[t]]}, the nearest "
            f"surface, and {h:.2f} m above the lowest point of the room."
            for p, d, t, h in zip(points, distance_m, triangle, height_m, strict=True)
        )
    sentences = []
    for p, own_m in zip(points, at_m, strict=True):
        far_m = np.array(room.shoebox_m) - own_m
        is_far = (far_m < own_m) & np.array([True, True, False])
        each = (
            f"{min(d, f) if axis < 2 else d:.2f} m from {names[2 * axis + int(is_far[axis])]}"
            for axis, (d, f) in enumerate(zip(own_m, far_m, strict=True))
        )
        sentences.append(f"{p.name} stands {', '.join(each)}.")
    return tuple(sentences)
