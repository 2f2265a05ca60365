"""All paths of a scene: image sources for the early part, rays for the rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from roomfit.base.errors import InputError
from roomfit.base.findings import About, Code, Finding
from roomfit.base.typing import FloatArray, Progress, part
from roomfit.materials.priors import Scattering
from roomfit.room.inside import nearest_triangles
from roomfit.room.scene import Scene, distances_m, object_pairs
from roomfit.tracing.image_sources import thinned_images, trace_images
from roomfit.tracing.paths import Paths, TraceSettings
from roomfit.tracing.rays import Trace, trace_rays
from roomfit.tracing.states import as_one_state, in_every_state

# A sphere so much smaller than the room it has stays clear of the wall in spite of rounding.
_CLEARANCE = 0.999
_SMALLEST_RADIUS_M = 0.005
_SHARE_OF_IMAGES = 0.1


def trace(
    scene: Scene,
    settings: TraceSettings,
    scattering: Scattering,
    progress: Progress | None = None,
    *,
    known_images: Paths | None = None,
) -> Trace:
    """Return the paths of every pair: images up to an order, and rays for what they leave.

    A ray's path with no diffuse hit and at most `settings.image_order` hits that arrives before
    `settings.image_until_s` is left out, because it is a noisy copy of an image path; all others
    have something that images do not: nothing is counted twice and nothing lost. With scattering s
    an image path carries ``(1 - s) ** hits`` of its energy, and the rays bring the rest, later or
    with a diffuse hit. ``image_order=-1`` leaves everything to rays, ``n_rays=0`` to images.

    `known_images` are the image paths of this trace with any scattering, ignored in a room with
    several states. An `InputError` where neither images nor rays are asked for, scattering is that
    of other materials, a receiver stands in a wall or on a source, or paths do not fit into memory.

    Notes
    -----
    An image path holds for the centre of the receiver and a ray for its sphere; the two agree in
    the mean over the sphere. One pair in a furnished room, where edges cut through spheres, may
    differ by some per cent. The sphere of a receiver nearer to a wall or a source than its radius
    is shrunk to fit. Peak memory is less than twice that of the paths.

    Examples
    --------
    Direct sound and the six first reflections of a box:

    >>> from roomfit.materials.priors import uniform_scattering
    >>> from roomfit.room.scene import scene_of, shoebox_room
    >>> room = shoebox_room((6.0, 5.0, 3.0), "plaster")
    >>> scene = scene_of(room, {"LS1": (1.0, 1.0, 1.5)}, {"MP1": (4.0, 3.0, 1.5)})
    >>> settings = TraceSettings(duration_s=0.1, n_rays=0, image_order=1)
    >>> found = trace(scene, settings, uniform_scattering(("plaster",), 0.0))
    >>> found.paths.length_m.round(2).tolist()
    [3.61, 4.69, 4.69, 5.0, 5.39, 6.71, 7.28]
    """
    if settings.image_order < 0 and settings.n_rays == 0:
        what = "nothing to trace"
        needed, hint = "image_order of 0 or more, or rays", "set n_rays = 20000, or image_order = 3"
        raise InputError(what, found="image_order -1 and n_rays 0", needed=needed, hint=hint)
    if scene.room.states:
        single, of_parts = as_one_state(scene, scattering)
        found = trace(single, settings, of_parts, progress)
        return _with_objects(
            replace(found, paths=in_every_state(found.paths, single, scene, scattering)), scene
        )
    share = _SHARE_OF_IMAGES if settings.n_rays else 1.0
    images: list[Paths] = []  # whoever holds them beside the rays' trace doubles its peak
    if settings.image_order >= 0 and known_images is not None:
        images.append(thinned_images(known_images, scattering))
    elif settings.image_order >= 0:
        until_s = settings.duration_s
        if settings.image_until_s is not None:
            until_s = min(settings.image_until_s, until_s)
        of = scene, settings.image_order, until_s, scattering
        done, kept = part(progress, 0.0, share), settings.keep_image_transforms
        images.append(trace_images(*of, with_image_transforms=kept, progress=done))
    radii: FloatArray | None = None
    findings: tuple[Finding, ...] = ()
    if settings.n_rays:
        radii, findings = fitting_radii_m(scene, settings.receiver_radius_m)
    done = part(progress, share, 1.0)
    rays = trace_rays(scene, settings, scattering, done, receiver_radii_m=radii, images=images)
    return _with_objects(replace(rays, findings=(*findings, *rays.findings)), scene)


def _with_objects(found: Trace, scene: Scene) -> Trace:
    if not scene.room.objects:
        return found
    return replace(found, paths=replace(found.paths, objects=object_pairs(scene)))


def fitting_radii_m(scene: Scene, radius_m: float) -> tuple[FloatArray, tuple[Finding, ...]]:
    """Return for each receiver the largest radius up to `radius_m` clear of walls and sources.

    A sphere that a wall cuts or that contains the source does not average ``1 / (4 pi r**2)``.
    """
    centres = np.array([r.position_m for r in scene.receivers]).reshape(-1, 3)
    to_wall = nearest_triangles(scene.room.mesh, centres)[0]
    to_source = np.full(len(centres), np.inf)
    np.minimum.at(to_source, scene.pairs[:, 1], distances_m(scene))
    free = _CLEARANCE * np.minimum(to_wall, to_source)
    free[np.setdiff1d(np.arange(len(centres)), scene.pairs[:, 1])] = np.inf
    radii = np.minimum(free, radius_m)
    findings = []
    for r in np.flatnonzero(radii < radius_m):
        name = scene.receivers[r].name
        near = "the nearest wall" if to_wall[r] <= to_source[r] else "a source"
        if radii[r] < _SMALLEST_RADIUS_M:
            raise InputError(
                f"a receiver stands in {near.replace('the nearest', 'a')}",
                where=name,
                found=f"{min(to_wall[r], to_source[r]):.3g} m away",
                needed=f"more than {_SMALLEST_RADIUS_M:g} m",
                hint="correct its position",
                points_m=[tuple(centres[r].tolist())],
            )
        used_m = float(radii[r])
        fewer = (radius_m / used_m) ** 2
        findings.append(
            Finding(
                Code.RECEIVER_SPHERE_SHRUNK,
                About(points_m=[centres[r].tolist()]),
                f"The sphere of receiver {name} reached beyond {near} and was shrunk from "
                f"{radius_m:.2f} m to {used_m:.2f} m: it catches {fewer:.1f} times fewer rays.",
                {"receiver": name, "asked_m": radius_m, "used_m": used_m},
                graded="info" if fewer < 4.0 else "warning",
            )
        )
    return radii, tuple(findings)
