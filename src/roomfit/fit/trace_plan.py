"""How finely to trace, as fine as the result needs and memory allows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from roomfit.base.air import speed_of_sound_m_s
from roomfit.base.findings import About, Code, Edit, Finding, Remedy
from roomfit.fit.scattering import specified_scattering
from roomfit.materials.priors import MaterialPrior, Scattering, sampling_scattering
from roomfit.model.scattering import effective_fractions, sampling_groups
from roomfit.room.mesh import box_of, surface_area_m2, volume_m3
from roomfit.room.scene import Room, Scene, material_areas_m2
from roomfit.settings import Settings
from roomfit.tracing.image_sources import affordable_duration_s, affordable_order
from roomfit.tracing.paths import TraceSettings
from roomfit.tracing.rays import expected_paths, path_bytes
from roomfit.tracing.trace import fitting_radii_m

_IMAGE_ORDER, _ANY_ORDER = 3, 1000
# In a room where they suffice rays are so many, and fewer beside image sources of every order where
# no wall scatters: there they bring only what is late, where interference does more to a window
# than a Monte-Carlo error of 5 to 8 %.
LEAST_RAYS, _BESIDE_IMAGES = 60_000, 1.0 / 3.0
LEAST_RADIUS_M, _RADIUS_PER_FREE_PATH = 0.5, 0.09
# The window that decides is 10 dB down, of the 45 that are followed, and a tenth of that time
# wide. Its data err by 20 % and the fluctuation of the octave of 4 kHz (least of all bands), and
# rays by a third of that; the energies of crossings vary, so that five count as one.
_DECIDING_DB, _FOLLOWED_DB, _WINDOW_PER_TIME = 10.0, 45.0, 0.1
_MODEL_ERROR, _BANDWIDTH_HZ = 0.2, 2828.0
_OF_THE_DATA, _CROSSINGS_AS_ONE = 1.0 / 3.0, 5.0
# Rays that err by a third of a window's data err by as much of T30 at 4 kHz and by half as much of
# all other values and bands; they are part of a value's variance in the fit, as of no window's.
_OF_VALUES = 1.0 / 2.0
# A trace takes about twice the memory of its paths. In a prediction of many pairs, as on a map,
# each has fewer rays, whose error is in its interval.
_MOST_PATH_BYTES, MOST_PREDICTED_BYTES = 480e6, 1.5e9
# A fit asks for image sources of every order as far as its windows go, if they can be had; in a
# box, where they cost little, as far as energies are compared.
_FAR_UNTIL_S, _LEAST_FAR_S = 0.22, 0.03
# Of all pairs together: 1 GB. Of 200 pairs each has 20,000, .2 s of 70 m3.
_MOST_FAR_IMAGES = 4e6
# Image sources of all pairs together, where there is nothing else.
_MOST_IMAGES_OF_ALL = 10e6


@dataclass(frozen=True, slots=True, eq=False)
class TracePlan:
    """Settings, scattering, and what was assumed in choosing them."""

    settings: TraceSettings
    scattering: Scattering
    findings: tuple[Finding, ...]


def plan_trace(
    scene: Scene,
    priors: tuple[MaterialPrior, ...],
    longest_decay_s: float,
    latest_window_s: float,
    settings: Settings,
    *,
    images_until_s: float | None = None,
    by_values: bool = False,
) -> TracePlan:
    """Choose how to trace.

    A box whose walls do not scatter is done by image sources alone, which are exact; every other
    room by image sources for the first orders and rays for the rest, until the slowest band has
    fallen by 45 dB, so that T30 can be predicted. With `images_until_s` image sources of every
    order reach so far, where 0 is none, and can be moved.

    Rays and the radius of their spheres, where the settings leave them open, follow the room:
    windows 10 dB down are to have a Monte-Carlo error of a third of the data's own (of a half where
    only values are fitted, `by_values`). N rays and spheres of radius a in a volume V cross ``N pi
    a**2 c / V`` times a second. Where 60,000 rays and 0.5 m bring less, the radius is 0.09 of the
    mean free path: it smears arrivals by less than half of the shortest window that rays fill. The
    number of rays follows, up to what fits into 1 GB, with a finding where that is less.
    """
    specified = [sampling_scattering(k) for k in priors]
    single = np.array([settings.default_scattering if s is None else s for s in specified])
    duration_s = traced_s(longest_decay_s, latest_window_s)
    reach_m, volume = speed_of_sound_m_s(scene.air) * duration_s, volume_m3(scene.room.mesh)
    # the least fraction of rays that any band has 10 dB down
    by_band = specified_scattering(priors, single, priors[0].prior_logit_mean.size)
    hits = material_areas_m2(scene.room) * reach_m / (4.0 * volume)
    rng = np.random.default_rng(settings.seed)
    groups = sampling_groups(by_band, single, hits, rng)
    fractions = effective_fractions(groups, by_band, _DECIDING_DB / _FOLLOWED_DB * hits, rng)
    scattering = Scattering(scene.room.materials, groups[0] if len(groups) == 1 else groups)
    n_images = 4.0 / 3.0 * np.pi * reach_m**3 / volume
    most_images = min(settings.most_images, _MOST_IMAGES_OF_ALL / len(scene.pairs))
    is_box, smooth = in_lattice(scene.room, settings), not np.any(scattering.coefficients)
    images_alone = is_box and smooth and n_images <= most_images
    until_s = 0.0 if images_alone or images_until_s is None else images_until_s
    fineness = TraceSettings(
        duration_s=duration_s,
        n_rays=0,
        image_order=_ANY_ORDER if images_alone or until_s > 0.0 else _IMAGE_ORDER,
        seed=settings.seed,
        # what images need to be moved follows from their directions in a box along the axes
        keep_image_transforms=images_until_s is not None and scene.room.shoebox_m is None,
    )
    if until_s > 0.0:
        fineness = replace(fineness, image_until_s=until_s)
    elif not is_box:
        order = affordable_order(scene, _IMAGE_ORDER, duration_s)
        fineness = replace(fineness, image_order=order)
    findings: tuple[Finding, ...] = ()
    if names := [k.name for k in priors if k.scattering is None]:
        findings = (scattering_assumed(names, settings.default_scattering),)
    if not images_alone:
        share = _OF_VALUES if by_values else _OF_THE_DATA
        fraction, beside = float(fractions.min()), until_s > 0.0 and smooth
        fineness, few = _with_rays(scene, fineness, fraction, settings, share, beside_images=beside)
        findings += few
    return TracePlan(fineness, scattering, findings)


def traced_s(longest_decay_s: float, latest_window_s: float) -> float:
    """Return how long sound is followed."""
    return max(0.75 * longest_decay_s, latest_window_s) + 0.01


def in_lattice(room: Room, settings: Settings) -> bool:
    """Whether image sources form a lattice, and few triangles have to be looked up on a wall."""
    few = len(room.mesh.triangles) <= settings.most_triangles_for_images
    return room.shoebox_m is not None or (few and box_of(room.mesh) is not None)


def images_until_s(scene: Scene, duration_s: float, settings: Settings) -> float:
    """Return how long image sources of every order can be had; 0 where it is not worth while."""
    c = speed_of_sound_m_s(scene.air)
    volume = volume_m3(scene.room.mesh)
    n_images = min(settings.most_coherent_images, _MOST_FAR_IMAGES / len(scene.pairs))
    affordable_s = (n_images * volume * 0.75 / np.pi) ** (1.0 / 3.0) / c
    longest_s = min(duration_s, float(affordable_s))
    if not in_lattice(scene.room, settings):
        if len(scene.room.mesh.triangles) > settings.most_triangles_for_images:
            return 0.0
        longest_s = affordable_duration_s(scene, min(longest_s, _FAR_UNTIL_S))
    return longest_s if longest_s >= _LEAST_FAR_S else 0.0


def has_every_order(settings: TraceSettings) -> bool:
    """Return whether image sources of every order reach far enough to be added as pressures."""
    return settings.image_order >= _ANY_ORDER


def _with_rays(
    scene: Scene,
    fineness: TraceSettings,
    fraction: float,
    settings: Settings,
    of_the_data: float,
    *,
    beside_images: bool,
) -> tuple[TraceSettings, tuple[Finding, ...]]:
    """Return the settings with rays and radius: as specified, or as the room needs them."""
    volume = volume_m3(scene.room.mesh)
    window_s = _WINDOW_PER_TIME * _DECIDING_DB / _FOLLOWED_DB * fineness.duration_s
    own_variance = _MODEL_ERROR**2 + 1.0 / (_BANDWIDTH_HZ * window_s)
    crossings_per_s = _CROSSINGS_AS_ONE / (of_the_data**2 * own_variance * window_s)
    # rays times the square of the radius
    needed_m2 = crossings_per_s * volume / (np.pi * speed_of_sound_m_s(scene.air) * fraction)
    radius_m = settings.receiver_radius_m
    if radius_m is None:
        radius_m = LEAST_RADIUS_M
        if needed_m2 > LEAST_RAYS * radius_m**2:
            wide_m = _RADIUS_PER_FREE_PATH * 4.0 * volume / surface_area_m2(scene.room.mesh)
            fitting_m, _ = fitting_radii_m(scene, max(wide_m, radius_m))
            radius_m = max(radius_m, float(fitting_m.min()))
    fineness = replace(fineness, receiver_radius_m=radius_m)
    stated = settings.n_rays_beside_images if beside_images else settings.n_rays
    if stated is not None:
        return replace(fineness, n_rays=stated), ()
    share = _BESIDE_IMAGES if beside_images else 1.0
    needed = needed_m2 / radius_m**2 * share
    fineness = replace(fineness, n_rays=max(round(LEAST_RAYS * share), math.ceil(needed)))
    fineness = with_affordable_rays(scene, fineness, _MOST_PATH_BYTES)
    affordable = fineness.n_rays
    if affordable >= needed:
        return fineness, ()
    larger, words = math.sqrt(needed / affordable), "half" if of_the_data > 0.4 else "a third"
    text = (
        f"{math.ceil(needed):,} rays a source are needed for a Monte-Carlo error of {words} of "
        f"the data's own; 1 GB holds the paths of {affordable:,}, whose error is {larger:.1f} "
        "times that."
    )
    numbers = {"needed": math.ceil(needed), "n_rays": affordable, "times_wanted_error": larger}
    return fineness, (Finding(Code.FEW_RAYS, About(), text, numbers),)


def with_affordable_rays(scene: Scene, fineness: TraceSettings, most_bytes: float) -> TraceSettings:
    """Return the settings with no more rays than those whose paths fit into so many bytes."""
    n_bytes = expected_paths(scene, fineness) * path_bytes(scene)
    if n_bytes <= most_bytes:
        return fineness
    return replace(fineness, n_rays=max(int(fineness.n_rays * most_bytes / n_bytes), 1))


def scattering_assumed(names: Sequence[str], value: float, reason: str = "") -> Finding:
    """Return that the scattering of some materials is unspecified, and what was assumed."""
    text = f"The scattering of {', '.join(names)} is unspecified; {value:g} was assumed{reason}."
    evidence = {"materials": list(names), "scattering": value}
    remedies = scattering_remedies(names, value)
    return Finding(
        Code.SCATTERING_ASSUMED, About(materials=names), text, evidence, remedies=remedies
    )


def scattering_remedies(materials: Sequence[str], value: float) -> tuple[Remedy, ...]:
    """Return that scattering is fitted, or stated as what was taken, where none is stated."""
    return tuple(
        Remedy([Edit(("materials", m), "scattering", said, now=[None, 0.0]) for m in materials])
        for said in ("fit", float(value))
    )
