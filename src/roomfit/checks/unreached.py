"""Whether every material that is fitted is struck by sound."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from roomfit.base.findings import About, Code, Finding
from roomfit.checks.evidence import Evidence, Law
from roomfit.tracing.paths import Paths

LAWS = {
    Code.MATERIAL_NOT_REACHED: Law(
        "every material is struck by a path between measured pairs", "number of such paths"
    )
}


def check(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding that names the materials to be fitted which no path strikes."""
    priors = [k for k in evidence.priors if k.object_volume_m3 is None]
    fitted = [k.name for k in priors if k.known is None]
    names = unreached_materials(evidence.traced.paths, fitted)
    if names:
        yield Finding(
            Code.MATERIAL_NOT_REACHED,
            About(materials=names),
            f"No path between the measured pairs strikes {', '.join(names)}: its absorption "
            "cannot be determined, and its prior is all that is reported.",
            {"materials": list(names)},
        )


def unreached_materials(paths: Paths, materials: Sequence[str]) -> tuple[str, ...]:
    """Return the materials that no path strikes: nothing measured can tell of them.

    Parameters
    ----------
    paths : Paths
        Of all pairs that are to be fitted.
    materials : sequence of str
        Those asked about, of the paths' own.
    """
    met = np.asarray(paths.hits_specular.any(axis=0) | paths.hits_diffuse.any(axis=0))
    return tuple(m for m in materials if not met[paths.materials.index(m)])
