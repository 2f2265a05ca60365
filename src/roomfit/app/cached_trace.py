"""A trace that a killed run does not lose."""

from __future__ import annotations

from roomfit.files.cache import Cache, Cached, cached
from roomfit.findings import Finding
from roomfit.materials.scattering import Scattering
from roomfit.scene.scene import Scene
from roomfit.tracing.join import Trace, trace
from roomfit.tracing.paths import Paths, Reflections
from roomfit.tracing.ray_statistics import RayStatistics
from roomfit.tracing.settings import TraceSettings
from roomfit.typing import Progress

TRACE_CLASSES = (Trace, Paths, Reflections, RayStatistics, Finding)


def cached_trace(
    scene: Scene,
    settings: TraceSettings,
    scattering: Scattering,
    cache: Cache | None,
    progress: Progress | None = None,
) -> Cached[Trace]:
    """Return `roomfit.tracing.join.trace` of a scene, from the cache where it is there.

    The key holds every number of the scene (mesh, materials, positions, air), the settings with
    their seed, the scattering, and the code. The paths have the same bits either way.

    Raises
    ------
    InputError
        See `roomfit.tracing.join.trace`.
    """
    found = cached(
        cache,
        "trace",
        (scene, settings, scattering),
        lambda: trace(scene, settings, scattering, progress),
        TRACE_CLASSES,
    )
    if found.found and progress is not None:
        progress(1.0)
    return found
