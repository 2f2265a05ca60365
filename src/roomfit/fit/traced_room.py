"""A room traced once, whose energies, decays and room parameters follow from any absorption."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np

from roomfit.base.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.base.bands import Bands
from roomfit.base.errors import InputError
from roomfit.base.findings import About, Code, Finding
from roomfit.base.typing import BoolArray, FloatArray, IntArray, Progress
from roomfit.fit import trace_plan
from roomfit.fit.compare import curve_of, predicted_curve
from roomfit.fit.paths import traced_by
from roomfit.materials.priors import unknown_material
from roomfit.model.binned import BinnedPaths, pair_energies, rows_at
from roomfit.model.eyring import eyring_time_s
from roomfit.model.observation import spread_over_time
from roomfit.model.reduced_rows import (
    BINS_TOGETHER,
    ROWS_OF_A_CASE,
    ROWS_OF_A_DRAW,
    ReducedRows,
    reduced,
)
from roomfit.model.room_parameters import ValuesTerm, scatter_parts, strengths_db, value_terms
from roomfit.model.weighing import regrouped_rows, rows_in_air
from roomfit.room.mesh import refuse, surface_area_m2, volume_m3
from roomfit.room.scene import (
    Scene,
    distances_m,
    material_areas_m2,
    pair_names,
    pair_states,
    position_findings,
    select_pairs,
)
from roomfit.settings import Settings
from roomfit.signals.decay import DecayCurve, room_parameters
from roomfit.signals.iso3382 import VALUE_NAMES, MeasuredValues, ValueName, value_gradients
from roomfit.signals.speech import modulation_gradients
from roomfit.uncertainty.posterior import AbsorptionPosterior

# T30 is read from 5 to 35 dB below the start of the decay.
_NEEDED_DB = 36.0
_ATTEMPTS = 4
# Enough to see how far the decay falls; the rays that follow are six times as many, or more.
_PILOT_RAYS, _PILOT_PAIRS = 10_000, 8
_LONGER = 1.5
_LONGEST_S = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class TracedRoom:
    """Paths of every pair of a scene, to be weighed by any absorption.

    Absorption has the shape (n_materials, n_bands), materials in the order of the room, 0 to 1.
    """

    scene: Scene
    bands: Bands
    binned: BinnedPaths
    findings: tuple[Finding, ...]
    by_pressures: BoolArray  # (n_bands,), where decays add the pressures of image sources

    @property
    def edges_s(self) -> FloatArray:
        """Edges of the bins of `energies`, s after emission, shape (n_bins + 1,)."""
        return self.binned.edges_s

    @property
    def direct_s(self) -> FloatArray:
        """Travel time of the direct sound of every pair, shape (n_pairs,)."""
        return distances_m(self.scene) / speed_of_sound_m_s(self.scene.air)

    @property
    def areas_m2(self) -> FloatArray:
        """Area of every material in the room's state, shape (n_materials,)."""
        return material_areas_m2(self.scene.room, int(pair_states(self.scene)[0]))

    def of_pair(self, pair: int) -> TracedRoom:
        """Return the same room with one pair alone."""
        bands_of = {f: (rows[pair],) for f, rows in self.binned.by_band.items()}
        own = BinnedPaths(self.binned.edges_s, (self.binned.rows[pair],), bands_of)
        return replace(self, scene=select_pairs(self.scene, slice(pair, pair + 1)), binned=own)

    def in_bands(self, at: IntArray) -> TracedRoom:
        """Return the same room in some bands, given by their indices."""
        own = Bands(self.bands.kind, self.bands.centres_hz[at])
        return replace(self, bands=own, by_pressures=self.by_pressures[at])

    def energies(self, absorption: FloatArray) -> FloatArray:
        """Return the energies of every pair in bins of 0.1 ms, shape (n_pairs, n_bands, n_bins).

        In 1/m2: that of the direct sound at a distance r is ``1 / (4 pi r^2)``.
        """
        pairs = range(len(self.scene.pairs))
        return np.stack([self.energies_of(pair, absorption) for pair in pairs])

    def energies_of(self, pair: int, absorption: FloatArray) -> FloatArray:
        """Return those of one pair, shape (n_bands, n_bins)."""
        air = attenuation_per_m(self.scene.air, self.bands)
        return pair_energies(self.binned, self.bands, pair, absorption, air)

    def predict(
        self, absorption: FloatArray, names: Sequence[ValueName] = VALUE_NAMES
    ) -> tuple[FloatArray, FloatArray]:
        """Return ISO 3382 values and their derivatives by the absorption.

        Returns
        -------
        values : float array, shape (n_pairs, n_names, n_bands)
            In the units of their names.
        derivatives : float array, shape (n_pairs, n_names, n_bands, n_materials)
            By the absorption of the same band.
        """
        shape = (len(self.scene.pairs), len(names), len(self.bands))
        values, slopes = np.empty(shape), np.empty((*shape, len(absorption)))
        for band in range(len(self.bands)):
            term = _band_term(self, band, names)
            found, _, by = term.predict({"absorption": absorption[:, band]})
            values[:, :, band] = found.reshape(shape[:2])
            slopes[:, :, band] = by["absorption"].reshape(*shape[:2], -1)
        return values, slopes

    def decay(self, pair: int, absorption: FloatArray) -> tuple[DecayCurve, FloatArray]:
        """Return a pair's decay curves and room parameters, the latter (n_names, n_bands).

        NaN where the paths do not follow the decay far enough, names in the order of `VALUE_NAMES`.
        """
        energy = self.energies_of(pair, absorption)
        own = self.scene, self.bands, self.binned, pair, absorption, energy
        curve = curve_of(*own, self.by_pressures)
        strength = strengths_db(self.bands, self.edges_s, energy, curve.onset_s)
        for band in np.flatnonzero(self.by_pressures).tolist():
            strength[0, band] = value_gradients(curve, band, ("G_dB",), derivative=False)[0][0]
        return curve, np.vstack([room_parameters(curve).values, strength])

    def echogram(self, pair: int, absorption: FloatArray) -> FloatArray:
        """Return a pair's energies spread over time as by the filters, shape (n_bands, n_bins)."""
        return spread_over_time(self.bands, self.energies_of(pair, absorption))

    def scatter(
        self, pair: int, absorption: FloatArray, weights: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return by how much measured values scatter though the absorption is known.

        Shape (n_names + 1, n_bands). Shapes: `weights` (n_bands, 14 + 1).
        """
        own = self.of_pair(pair)
        sd = np.zeros((len(VALUE_NAMES) + 1, len(self.bands)))
        common = np.zeros_like(sd)
        for band in range(len(self.bands)):
            term = _band_term(own, band, VALUE_NAMES)
            read = partial(_read, None if weights is None else weights[band])
            parts = scatter_parts(term, 0, absorption[:, band], read)
            values, interference, added, tracing = parts
            if not np.isfinite(values[: len(VALUE_NAMES)]).all():
                sd[:, band] = np.nan
                continue
            steady = added**2 + np.diag(tracing)
            sd[: added.size, band] = np.sqrt(np.diag(interference) + steady)
            common[: added.size, band] = steady
        return sd, common

    def reduced(self, pair: int, absorption: FloatArray, most: int | None = None) -> ReducedRows:
        """Return a reduced set of rows of one pair, for absorptions near and far from one."""
        if most is None:
            most = max(ROWS_OF_A_DRAW, ROWS_OF_A_CASE * (len(absorption) + 2))
        edges = self.binned.edges_s
        first = np.arange(0, edges.size - 1, BINS_TOGETHER)
        air = attenuation_per_m(self.scene.air, self.bands)
        rows = []
        for band, f in enumerate(self.bands.centres_hz):
            coarse = regrouped_rows(rows_at(self.binned, f)[pair], first)
            rows.append(reduced(rows_in_air(coarse, float(air[band])), absorption[:, band], most))
        edges_s = np.append(edges[:-1][::BINS_TOGETHER], edges[-1])
        return ReducedRows(self.bands, edges_s, float(self.direct_s[pair]), tuple(rows))


def _band_term(room: TracedRoom, band: int, names: Sequence[ValueName]) -> ValuesTerm:
    """Return what predicts the values of all pairs in one band; nothing measured is read of it."""
    one = Bands(room.bands.kind, room.bands.centres_hz[band : band + 1])
    anything = dict.fromkeys(names, np.ones(1))
    as_measured = tuple(
        MeasuredValues(source, receiver, one.centres_hz, anything, state=state)
        for source, receiver, state in pair_names(room.scene)
    )
    (term,) = value_terms(room.scene, one, as_measured, room.binned, names=names)
    if term is None:
        needed, hint = f"one or more of {', '.join(VALUE_NAMES)}", f"{VALUE_NAMES[0]}, for example"
        raise InputError("no name of a room parameter", found="none", needed=needed, hint=hint)
    return term


def _read(
    weights: FloatArray | None, curve: DecayCurve, *, derivative: bool = True
) -> tuple[FloatArray, FloatArray]:
    """Return the values of a band and their derivatives; below them the weighted sum, if any."""
    values, gradients = value_gradients(curve, 0, VALUE_NAMES, derivative=derivative)
    if weights is None:
        return values, gradients
    transfer, by_energy = modulation_gradients(curve, 0)
    together = float(weights[:-1] @ transfer + weights[-1] * values[-1])
    if derivative:
        row = weights[:-1] @ by_energy + weights[-1] * gradients[-1]
        gradients = np.vstack([gradients, row])
    return np.append(values, together), gradients


def check_scene(scene: Scene) -> None:
    """Refuse a scene without pairs, of several states, or with a position in a wall or outside."""
    if not len(scene.pairs):
        what = "the scene has no pair to predict"
        hint = "give scene_of a source and a receiver"
        raise InputError(what, found="no pair", needed="a source and a receiver", hint=hint)
    refuse(position_findings(scene.room, scene.sources, scene.receivers))
    if np.unique(pair_states(scene)).size > 1:
        raise InputError(
            "a prediction is of one state of the room",
            found="pairs in several states",
            needed="a scene whose pair_state is the same everywhere",
            hint="predict each state with a scene of its own",
        )


def trace_room(
    scene: Scene,
    known: AbsorptionPosterior,
    absorption: FloatArray | None = None,
    measured_decay_s: float = 0.0,
    settings: Settings | None = None,
    progress: Progress | None = None,
) -> TracedRoom:
    """Trace until every band of every pair has fallen by 36 dB, or for 30 s.

    With the absorption that is known, or with each of several, (..., n_materials, n_bands): of two
    walls the one that absorbs less may bend a decay less, which then is followed sooner.

    How long is estimated from Eyring's formula and the measured decay; where walls differ much,
    sound between the hard ones lasts longer still, which few rays find out before.
    """
    settings = Settings() if settings is None else settings
    bands, directivities = known.bands, known.directivities or {}
    absorption = known.absorption if absorption is None else absorption
    each = absorption.reshape(-1, *known.absorption.shape)
    rows = np.full((len(known.materials), len(bands)), np.nan)
    rows = rows if known.scattering is None else known.scattering
    priors = tuple(  # nothing but the scattering, which the plan of a trace reads
        replace(unknown_material(name, len(bands)), scattering=None if np.isnan(row).any() else row)
        for name, row in zip(known.materials, rows, strict=True)
    )
    added = known.by_pressures
    added = np.zeros(len(bands), dtype=np.bool_) if added is None else added
    longest_s = max(measured_decay_s, *(float(scene_decay_s(scene, bands, a).max()) for a in each))

    beside_images = settings
    if settings.n_rays_beside_images is None:
        # so many as without images: a fit ends before what is late, a decay does not
        n_rays = trace_plan.LEAST_RAYS if settings.n_rays is None else settings.n_rays
        beside_images = replace(settings, n_rays_beside_images=n_rays)

    def planned() -> trace_plan.TracePlan:
        own = scene, priors, min(longest_s, _LONGEST_S), 0.0
        if added.any():
            far_s = trace_plan.images_until_s(scene, trace_plan.traced_s(*own[2:]), settings)
            plan = trace_plan.plan_trace(*own, beside_images, images_until_s=far_s)
            if trace_plan.has_every_order(plan.settings):
                few = trace_plan.with_affordable_rays(
                    scene, plan.settings, trace_plan.MOST_PREDICTED_BYTES
                )
                return plan if settings.n_rays else replace(plan, settings=few)
        return trace_plan.plan_trace(*own, settings)

    def traced(of: Scene, n_rays: int, progress: Progress | None) -> TracedRoom:
        plan = planned()
        fineness = replace(plan.settings, n_rays=min(plan.settings.n_rays, n_rays))
        own = replace(plan, settings=fineness)
        found = traced_by(own, of, bands, priors, directivities, progress)
        every_order = fineness.image_until_s is not None or not fineness.n_rays
        return TracedRoom(of, bands, found.binned, found.findings, added & every_order)

    some = select_pairs(scene, slice(None, None, -(-len(scene.pairs) // _PILOT_PAIRS)))
    n_pilots = 2 * _ATTEMPTS if planned().settings.n_rays > _PILOT_RAYS else 0
    for _ in range(n_pilots):
        if longest_s >= _LONGEST_S or not _short_bands(traced(some, _PILOT_RAYS, None), each):
            break
        longest_s *= _LONGER
    for _ in range(2 if n_pilots else _ATTEMPTS):
        room = traced(scene, sys.maxsize, progress)
        short = _short_bands(room, each)
        if not short or longest_s >= _LONGEST_S:
            break
        longest_s *= _LONGER
    if not short:
        return room
    bands_hz = bands.centres_hz[short].tolist()
    text = (
        "The trace does not follow the decay over 35 dB at "
        f"{', '.join(f'{f:g}' for f in bands_hz)} Hz: T30 is not predicted there. Some walls "
        "absorb next to nothing."
    )
    about = About(bands_hz=bands_hz)
    finding = Finding(Code.DECAY_NOT_FOLLOWED, about, text, {"bands_hz": bands_hz})
    return replace(room, findings=(*room.findings, finding))


def scene_decay_s(scene: Scene, bands: Bands, absorption: FloatArray) -> FloatArray:
    """Return the reverberation time of a scene by Eyring's formula in every band, (n_bands,)."""
    mesh = scene.room.mesh
    state = int(pair_states(scene)[0]) if len(scene.pairs) else 0
    areas = material_areas_m2(scene.room, state)
    mean = np.maximum(areas @ absorption / areas.sum(), 1e-4)
    room = (volume_m3(mesh), surface_area_m2(mesh), speed_of_sound_m_s(scene.air))
    return eyring_time_s(mean, *room, attenuation_per_m(scene.air, bands))


def _short_bands(room: TracedRoom, absorptions: FloatArray) -> list[int]:
    """Return the bands in which the decay of some pair is not followed far enough with some."""
    known = room.scene, room.bands, room.binned
    each = product(range(len(room.scene.pairs)), absorptions)
    usable_db = np.array([predicted_curve(*known, *case).usable_db for case in each])
    return np.flatnonzero(usable_db.min(axis=0) < _NEEDED_DB).tolist()
