"""What it costs that sources and receivers stand on a plane of symmetry, and where to move them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from roomfit.base.bands import Bands
from roomfit.base.findings import About, Code, Finding
from roomfit.base.typing import FloatArray, IntArray
from roomfit.design.candidates import DesignOptions, information_of_candidates
from roomfit.design.information import (
    PairInformation,
    information_of,
    interval_widths,
    material_widths,
)
from roomfit.design.prior import PriorInformation, information_from_priors
from roomfit.fit.symmetry import mirror_planes
from roomfit.materials.priors import MaterialPrior
from roomfit.room.scene import Point, Scene, is_clear_of_walls, select_pairs
from roomfit.settings import Settings

# Half widths are expected with so many pairs and rays: it is their ratio that counts.
_MOST_PAIRS, _N_RAYS, _N_RAYS_BESIDE_IMAGES = 6, 3_000, 1_000
# From the plane to the farthest wall: what lies farther hardly gains more in a box 2.8 m high.
_SHARE_OF_THE_WAY = 0.4
_WORTH_MOVING = 0.9  # half widths there over those here
_WALL_DISTANCE_M = 0.2


def plane_findings(
    scene: Scene, materials: Sequence[MaterialPrior], bands: Bands, settings: Settings
) -> tuple[Finding, ...]:
    """Return a finding for each plane of symmetry on which all pairs stand, see `planes_of`.

    Parameters
    ----------
    scene : Scene
        With the pairs that are fitted.
    materials : sequence of MaterialPrior
        Of all materials of the room, in its order and in these bands.
    """
    rng = np.random.default_rng(settings.seed)
    return planes_of(scene, information_from_priors(tuple(materials), bands, 2, rng), settings)


def planes_of(scene: Scene, known: PriorInformation, settings: Settings) -> tuple[Finding, ...]:
    """Return a finding for each plane of symmetry that every pair shares, at a cost.

    The cost is the mean half width of the 95 % intervals of the walls that the plane exchanges, by
    the Fisher information of a design; and the same with the receivers, or the sources where there
    are fewer of them, off the plane. No finding where that is not narrower by a tenth.
    """
    findings = []
    for symmetry, normal in mirror_planes(scene):
        moved = _moved_off(scene, symmetry.centre_m, normal)
        if moved is None:
            continue
        there, names, step_m = moved
        walls = np.flatnonzero(symmetry.exchange != np.arange(symmetry.exchange.size))
        here_width, there_width = (_half_width(s, known, walls, settings) for s in (scene, there))
        if there_width > _WORTH_MOVING * here_width:
            continue
        exchanged = [scene.room.materials[i] for i in walls]
        offset_m = float(normal @ symmetry.centre_m)
        parts = zip(normal, "xyz", strict=True)
        axis = " ".join(x if c > 0.999 else f"{c:+.2f} {x}" for c, x in parts if abs(c) > 0.01)
        findings.append(
            Finding(
                Code.ON_SYMMETRY_PLANE,
                About(materials=exchanged),
                f"Every pair of source and receiver stands on the plane of symmetry "
                f"{axis} = {offset_m:.2f} m: "
                f"reflections off {' and '.join(exchanged)} arrive together there, and hardly "
                f"tell them apart. Expected half widths of their 95 % intervals: {here_width:.3f}, "
                f"and {there_width:.3f} with {', '.join(names)} {step_m:.2f} m off the plane.",
                {
                    "normal": normal.tolist(),
                    "offset_m": offset_m,
                    "half_width": here_width,
                    "half_width_moved": there_width,
                    "move": names,
                    "by_m": step_m,
                },
            )
        )
    return tuple(findings)


def _moved_off(
    scene: Scene, centre_m: FloatArray, normal: FloatArray
) -> tuple[Scene, list[str], float] | None:
    """Return the scene with few of its points off a plane, their names, and how far in m.

    None where there is no room to either side.
    """
    way_m = float(np.abs((scene.room.mesh.vertices_m - centre_m) @ normal).max())
    used = [
        {points[i].name for i in np.unique(column)}
        for points, column in zip((scene.sources, scene.receivers), scene.pairs.T, strict=True)
    ]
    names = used[0] if len(used[0]) < len(used[1]) else used[1]

    def moved(points: tuple[Point, ...], step: FloatArray) -> tuple[Point, ...]:
        return tuple(
            replace(p, position_m=p.position_m + step) if p.name in names else p for p in points
        )

    for side in (1.0, -1.0):
        step = side * _SHARE_OF_THE_WAY * way_m * normal
        sources, receivers = scene.sources, scene.receivers
        if names is used[0]:
            sources = moved(sources, step)
        else:
            receivers = moved(receivers, step)
        at = np.array([p.position_m for p in (*sources, *receivers) if p.name in names])
        if np.all(is_clear_of_walls(scene.room, at, _WALL_DISTANCE_M)):
            found = replace(scene, sources=sources, receivers=receivers)
            return found, sorted(names), _SHARE_OF_THE_WAY * way_m
    return None


def _half_width(
    scene: Scene, known: PriorInformation, walls: IntArray, settings: Settings
) -> float:
    """Return the expected half width of some walls' intervals, mean over walls and bands."""
    n = len(scene.pairs)
    few = np.unique(np.linspace(0, n - 1, min(n, _MOST_PAIRS)).astype(np.int64))
    quick = replace(settings, n_rays=_N_RAYS, n_rays_beside_images=_N_RAYS_BESIDE_IMAGES)
    pairs = select_pairs(scene, few)
    matrices = information_of_candidates(pairs, known, few.size, DesignOptions(), quick, {}, None)[
        0
    ]
    information = PairInformation(matrices, pairs.pairs[:, 0])
    found = information_of(known.unknowns, information, list(range(few.size)))
    widths = material_widths(known.unknowns, interval_widths(known.unknowns, found))
    return 0.5 * float(widths[walls].mean())
