"""How finely to trace, as fine as the result needs and memory allows; and a trace that is kept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from roomfit.air import speed_of_sound_m_s
from roomfit.cache import Cache, Cached, cached
from roomfit.findings import Code, Finding
from roomfit.geometry.mesh import volume_m3
from roomfit.materials.priors import MaterialPrior, Scattering, sampling_scattering
from roomfit.measurement import MeasuredPair
from roomfit.scene import Scene
from roomfit.settings import LEAST_SQUARES_METHODS, Settings
from roomfit.tracing.image_sources import affordable_duration_s, affordable_order
from roomfit.tracing.paths import Paths, TraceSettings
from roomfit.tracing.rays import RayStatistics, Trace
from roomfit.tracing.trace import trace
from roomfit.typing import Progress

TRACE_CLASSES = (Trace, Paths, RayStatistics, Finding, Code)


def cached_trace(
    scene: Scene,
    settings: TraceSettings,
    scattering: Scattering,
    cache: Cache | None,
    progress: Progress | None = None,
) -> Cached[Trace]:
    """Return `roomfit.tracing.trace.trace` of a scene, from the cache where it is there.

    The key holds every number of the scene (mesh, materials, positions, air), the settings with
    their seed, the scattering, and the code. The paths have the same bits either way.

    Raises
    ------
    InputError
        See `roomfit.tracing.trace.trace`.
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


_IMAGE_ORDER, _ANY_ORDER = 3, 1000
# A partly coherent fit asks for image sources as far as its windows go, if they can be had; in a
# box, where they cost little, as far as energies are compared.
_COHERENT_UNTIL_S = 0.22
_LEAST_COHERENT_S = 0.03


@dataclass(frozen=True, slots=True, eq=False)
class TracePlan:
    """Settings, scattering, and what was assumed in choosing them."""

    settings: TraceSettings
    scattering: Scattering
    findings: tuple[Finding, ...]
    # whether image sources of every order reach far enough to be added as pressures
    far_images: bool = False
    fit_until_s: float = np.inf  # no window of a partly coherent fit ends later


def plan_trace(
    scene: Scene,
    priors: tuple[MaterialPrior, ...],
    longest_decay_s: float,
    latest_window_s: float,
    settings: Settings,
    *,
    coherent: bool = False,
    images_until_s: float | None = None,
) -> TracePlan:
    """Choose how to trace.

    A box whose walls do not scatter is done by image sources alone, which are exact; every other
    room by image sources for the first orders and rays for the rest. For a partly coherent fit
    there are image sources of every order for as long as they can be enumerated. Sound is followed
    until the slowest band has fallen by 45 dB, so that T30 can be predicted.

    Parameters
    ----------
    scene : Scene
    priors : tuple of MaterialPrior, in the order of the room's materials
    longest_decay_s : float
        Longest measured reverberation time of any band.
    latest_window_s : float
        Where the last usable window of any measurement ends.
    settings : Settings
    coherent : bool
        Whether early reflections are to be added as pressures.
    images_until_s : float, optional
        How long image sources of every order can be enumerated, known from another plan.
    """
    findings = []
    unspecified = [k.name for k in priors if k.scattering is None]
    if unspecified:
        findings.append(
            Finding(
                Code.SCATTERING_ASSUMED,
                f"The scattering of {', '.join(unspecified)} is unspecified; "
                f"{settings.default_scattering:g} was assumed.",
                {"materials": unspecified, "scattering": settings.default_scattering},
            )
        )
    specified = [sampling_scattering(k) for k in priors]
    s = [settings.default_scattering if t is None else t for t in specified]
    scattering = Scattering(scene.room.materials, np.array(s))
    duration_s = max(0.75 * longest_decay_s, latest_window_s) + 0.01
    reach_m = speed_of_sound_m_s(scene.air) * duration_s
    n_images = 4.0 / 3.0 * np.pi * reach_m**3 / volume_m3(scene.room.mesh)
    images_alone = (
        scene.room.shoebox_m is not None
        and not np.any(scattering.coefficients)
        and n_images <= settings.most_images
    )
    fineness = TraceSettings(
        duration_s=duration_s,
        n_rays=0 if images_alone else settings.n_rays,
        image_order=_ANY_ORDER if images_alone else _IMAGE_ORDER,
        receiver_radius_m=settings.receiver_radius_m,
        seed=settings.seed,
        keep_image_transforms=coherent,
    )
    until_s = 0.0
    if coherent and not images_alone:
        until_s = images_until_s or _images_until_s(scene, duration_s, settings)
    if until_s > 0.0:
        fineness = replace(
            fineness,
            image_order=_ANY_ORDER,
            image_until_s=until_s,
            n_rays=(
                settings.n_rays
                if np.any(scattering.coefficients)
                else settings.n_rays_beside_images
            ),
        )
    elif coherent and not images_alone:
        findings.append(_few_images())
    if until_s == 0.0 and scene.room.shoebox_m is None:
        order = affordable_order(scene, _IMAGE_ORDER, duration_s)
        fineness = replace(fineness, image_order=order)
    far_images = images_alone or until_s > 0.0
    smooth_box = scene.room.shoebox_m is not None and not np.any(scattering.coefficients)
    # what is left in a smooth box travels between two hard walls along paths that few rays find
    fit_until_s = until_s if smooth_box and until_s > 0.0 else np.inf
    return TracePlan(fineness, scattering, tuple(findings), far_images, fit_until_s)


def _few_images() -> Finding:
    return Finding(
        Code.FEW_IMAGE_SOURCES,
        "The room has too many walls to follow image sources of every order for "
        f"{1000 * _LEAST_COHERENT_S:g} ms: energies are compared, unless the campaign asks for "
        "pressures.",
    )


def _images_until_s(scene: Scene, duration_s: float, settings: Settings) -> float:
    """Return how long image sources of every order can be had; 0 where it is not worth while."""
    c = speed_of_sound_m_s(scene.air)
    volume = volume_m3(scene.room.mesh)
    affordable_s = (settings.most_coherent_images * volume * 0.75 / np.pi) ** (1.0 / 3.0) / c
    longest_s = min(duration_s, float(affordable_s))
    if scene.room.shoebox_m is None:
        if len(scene.room.mesh.triangles) > settings.most_triangles_for_images:
            return 0.0
        longest_s = affordable_duration_s(scene, min(longest_s, _COHERENT_UNTIL_S))
    return longest_s if longest_s >= _LEAST_COHERENT_S else 0.0


def is_coherent(measured: Sequence[MeasuredPair], settings: Settings) -> bool:
    """Whether responses are to be fitted with image sources as coherent as their times are known.

    The paper's searches cannot follow the many unknown positions; they compare energies.
    """
    return any(m.measurement.use == "fit" for m in measured) and fits_pressures(settings)


def fits_pressures(settings: Settings) -> bool:
    """Whether model and method let pressures be added, if there are responses."""
    return settings.model != "energy" and settings.method in LEAST_SQUARES_METHODS
