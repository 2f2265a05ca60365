"""Sources and receivers on a plane of symmetry, where reflections off two walls arrive together."""

from __future__ import annotations

import numpy as np

from roomfit.base.findings import About, Code, Finding
from roomfit.fit.symmetry import mirror_planes
from roomfit.room.scene import Scene


def plane_findings(scene: Scene) -> tuple[Finding, ...]:
    """Return a finding for each plane of symmetry on which all pairs of a scene stand.

    Of planes that exchange different materials; whose absorption is then hardly determined.
    """
    findings = []
    for symmetry, normal in mirror_planes(scene):
        walls = np.flatnonzero(symmetry.exchange != np.arange(symmetry.exchange.size))
        exchanged = [scene.room.materials[i] for i in walls]
        offset_m = float(normal @ symmetry.centre_m)
        parts = zip(normal, "xyz", strict=True)
        axis = " ".join(x if c > 0.999 else f"{c:+.2f} {x}" for c, x in parts if abs(c) > 0.01)
        used = [
            sorted({points[i].name for i in np.unique(column)})
            for points, column in zip((scene.sources, scene.receivers), scene.pairs.T, strict=True)
        ]
        names = used[0] if len(used[0]) < len(used[1]) else used[1]
        findings.append(
            Finding(
                Code.ON_SYMMETRY_PLANE,
                About(materials=exchanged),
                f"Every pair of source and receiver stands on the plane of symmetry "
                f"{axis} = {offset_m:.2f} m: reflections off {' and '.join(exchanged)} arrive "
                f"together there, and hardly tell them apart. Move {', '.join(names)} off the "
                "plane, the farther the better.",
                {"normal": normal.tolist(), "offset_m": offset_m, "move": names},
            )
        )
    return tuple(findings)
