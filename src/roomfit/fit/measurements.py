"""Everything that was measured on one scene, on the clock of emission and reduced to bands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from roomfit.base.air import speed_of_sound_m_s
from roomfit.base.arguments import check_known
from roomfit.base.bands import Bands
from roomfit.base.errors import InputError
from roomfit.base.findings import Finding
from roomfit.base.typing import FloatArray
from roomfit.model.patterns import Directivities
from roomfit.room.inside import is_in_sight
from roomfit.room.mesh import refuse
from roomfit.room.scene import NEAREST_PAIR_M, Scene, distances_m, pair_names, position_findings
from roomfit.settings import DECAY_RANGE_DB
from roomfit.signals import decay
from roomfit.signals import response as signal
from roomfit.signals.filters import check_sampling_rate, filter_pressure
from roomfit.signals.iso3382 import MeasuredValues, joined_values
from roomfit.signals.measurement import MeasuredPair, Measurement, Use
from roomfit.signals.noise import NoiseEstimate, estimate_noise

# A window is fitted down to where the decay stands 4 dB above the noise.
_CLEAR_OF_NOISE = 2.5


@dataclass(frozen=True, slots=True, eq=False)
class Copy:
    """One recording that stands for two pairs, sample by sample."""

    one: Measurement
    other: Measurement
    apart_m: float  # of the two pairs' sources or receivers, the larger
    is_left_out: bool  # whether the second adds no information, and is not fitted


def counted_once(
    scene: Scene, measurements: Sequence[Measurement]
) -> tuple[list[Measurement], tuple[Copy, ...]]:
    """Return the measurements without copies of one recording, and all copies.

    One that stands where the first does adds no information: the one to be fitted is kept. One that
    is said to be of other positions is wrong there or here, and only the user can tell: it stays.
    """
    at_m = {p.name: p.position_m for p in (*scene.sources, *scene.receivers)}
    order = sorted(measurements, key=lambda m: m.use != "fit")
    copies = []
    for i, j in signal.same_recordings([np.asarray(m.samples) for m in order]):
        one, other = order[i], order[j]
        apart_m = max(
            float(np.linalg.norm(at_m[a] - at_m[b]))
            for a, b in ((one.source, other.source), (one.receiver, other.receiver))
        )
        is_same = apart_m < NEAREST_PAIR_M and one.state == other.state
        copies.append(Copy(one, other, apart_m, is_same))
    left_out = {id(c.other) for c in copies if c.is_left_out}
    return [m for m in measurements if id(m) not in left_out], tuple(copies)


@dataclass(frozen=True, slots=True, eq=False)
class Measurements:
    """What was measured, on one scene and in the bands of the fit."""

    scene: Scene  # each measured pair once, however often it was measured
    bands: Bands
    directivities: Directivities
    responses: tuple[MeasuredPair, ...]  # those kept for validation included
    values: tuple[MeasuredValues, ...]  # room parameters to be fitted, one record a pair
    kept_values: tuple[MeasuredValues, ...]  # room parameters to be predicted only
    findings: tuple[Finding, ...] = ()  # of tables of room parameters, by reading and joining them
    copies: tuple[Copy, ...] = ()  # of one recording


def collect_measurements(
    scene: Scene,
    measurements: Sequence[Measurement | MeasuredValues],
    bands: Bands,
    directivities: Directivities,
    decay_range_db: float = DECAY_RANGE_DB,
) -> Measurements:
    """Put everything that was measured on one scene."""
    responses = [m for m in measurements if isinstance(m, Measurement)]
    tabulated = [m for m in measurements if isinstance(m, MeasuredValues)]
    if not measurements:
        needed = "at least one impulse response or room parameter"
        hint = "give a Measurement, or MeasuredValues of a table"
        raise InputError("nothing was measured", found="no measurement", needed=needed, hint=hint)
    fitted, doubts = _joined(tabulated, "fit")
    kept, more_doubts = _joined(tabulated, "validate")
    own = measured_scene(scene, [*responses, *fitted, *kept])
    responses, copies = counted_once(own, responses)
    own = measured_scene(own, [*responses, *fitted, *kept])
    return Measurements(
        own,
        bands,
        {s.name: directivities[s.name] for s in own.sources if s.name in directivities},
        on_one_clock(own, responses, bands, decay_range_db),
        fitted,
        kept,
        (*doubts, *more_doubts),
        copies,
    )


def measured_scene(scene: Scene, measured: Sequence[Measurement | MeasuredValues]) -> Scene:
    """Return the scene with the sources, receivers and pairs that were measured, each once."""
    states = ["", *(s.name for s in scene.room.states)]
    known_names = ([s.name for s in scene.sources], [r.name for r in scene.receivers], states)
    for m in measured:
        for kind, name, known in zip(
            ("source", "receiver", "state"), m.pair_name, known_names, strict=True
        ):
            what = f"a measurement names a {kind} that the scene does not have"
            check_known(what, name, known, else_needed=f"a {kind} in the scene")
    wanted = list(dict.fromkeys(m.pair_name for m in measured))
    used_sources, used_receivers = ({pair[i] for pair in wanted} for i in (0, 1))
    sources = tuple(s for s in scene.sources if s.name in used_sources)
    receivers = tuple(r for r in scene.receivers if r.name in used_receivers)
    refuse(position_findings(scene.room, sources, receivers))
    source_at = {s.name: i for i, s in enumerate(sources)}
    receiver_at = {r.name: i for i, r in enumerate(receivers)}
    indices = np.array([(source_at[s], receiver_at[r]) for s, r, _ in wanted])
    state = np.array([states.index(k) for _, _, k in wanted]) if scene.room.states else None
    return Scene(scene.room, sources, receivers, indices, scene.air, state, scene.groups)


def observe(
    scene: Scene,
    measurements: Sequence[Measurement],
    bands: Bands,
    decay_range_db: float = DECAY_RANGE_DB,
) -> tuple[tuple[MeasuredPair, ...], tuple[Finding, ...]]:
    """Return responses as `on_one_clock` does, and what is doubtful of each by itself."""
    measured = on_one_clock(scene, measurements, bands, decay_range_db)
    return measured, recording_findings(scene, measured)


def recording_findings(scene: Scene, measured: Sequence[MeasuredPair]) -> tuple[Finding, ...]:
    """Return what is doubtful of each recording by itself: as read, its onset, its decay range."""
    speed_m_s, ends = speed_of_sound_m_s(scene.air), (scene.sources, scene.receivers)
    at_m = [{p.name: p.position_m for p in points} for points in ends]
    read: list[Finding] = []
    evaluated: list[Finding] = []
    for p in measured:
        m, rate_hz = p.measurement, p.response.sampling_rate_hz
        name, pairs = f"{m.source} to {m.receiver} ({m.name})", [(m.source, m.receiver)]
        own = list(m.findings)
        if not own:  # arrays: no reader has looked at them
            own += signal.clipping_findings(m.response.pressure, f"{m.source} to {m.receiver}")
        read += own
        own = [*decay.range_findings(p.parameters, name)]
        if m.time_zero != "direct":
            onset_s, stated = signal.find_onset(p.response, m.where), m.time_zero == "emission"
            ends_m = at_m[0][m.source], at_m[1][m.receiver]
            # round a corner the first sound comes late, as it should
            if onset_s <= p.direct_s or is_in_sight(scene.room.mesh, *ends_m):
                about = onset_s, p.direct_s, speed_m_s, name, rate_hz
                own = [*signal.compare_onset(*about, is_stated=stated), *own]
        evaluated += [replace(f, about=replace(f.about, files=[m.where], pairs=pairs)) for f in own]
    return (*read, *evaluated)


def on_one_clock(
    scene: Scene,
    measurements: Sequence[Measurement],
    bands: Bands,
    decay_range_db: float = DECAY_RANGE_DB,
) -> tuple[MeasuredPair, ...]:
    """Return responses on the clock of emission, reduced in every band, in their order."""
    c = speed_of_sound_m_s(scene.air)
    pair_of = {name: i for i, name in enumerate(pair_names(scene))}
    pairs = [pair_of[m.pair_name] for m in measurements]
    travel_s = [float(d) for d in (distances_m(scene) / c)[pairs]]
    for m in measurements:
        check_sampling_rate(bands, m.response.sampling_rate_hz, m.where)
        if m.sampling_rate_hz != measurements[0].sampling_rate_hz:
            first_hz = measurements[0].sampling_rate_hz
            raise InputError(
                "the measurements have different sampling rates",
                where=m.where,
                found=f"{m.sampling_rate_hz:g} Hz, after {first_hz:g} Hz in those before",
                needed="one sampling rate in a campaign, since one equipment measured it",
                hint="check that no file was saved at a wrong rate; resample those that were not",
            )
        decay.check_is_response(m.response, m.where)
    measured = []
    for m, pair, direct_s, response in zip(
        measurements, pairs, travel_s, from_emission(measurements, travel_s), strict=True
    ):
        signal.check_travel(response, direct_s, m.where)
        onset_s = signal.find_onset(response, m.where)
        # the decay of a file with a wrong clock is what it is
        start_s = onset_s if abs(onset_s - direct_s) * c > signal.SERIOUS_M else direct_s
        noise = estimate_noise(bands, response, filter_pressure(bands, response), start_s)
        curve = decay.decay_curve(bands, response, start_s)
        parameters = decay.room_parameters(curve)
        decay.check_decay_range(curve, m.where)
        end_s = fit_ends_s(noise, curve, decay_range_db)
        measured.append(MeasuredPair(m, pair, response, direct_s, noise, curve, parameters, end_s))
    return tuple(measured)


def fit_ends_s(noise: NoiseEstimate, curve: decay.DecayCurve, decay_range_db: float) -> FloatArray:
    """Return when the last window of a fit ends in each band, in s after emission, (n_bands,).

    Where the decay stands 4 dB above the noise, or has fallen by `decay_range_db`: what comes later
    is of no room parameter, and belongs to the few modes that decay the most slowly.
    """
    clear_s = noise.usable_end_s - np.log(_CLEAR_OF_NOISE) * noise.tail_time_constant_s
    fallen = curve.energy_left <= curve.energy_left[:, :1] * 10.0 ** (-decay_range_db / 10.0)
    fallen_s = np.where(fallen.any(axis=1), curve.time_s[fallen.argmax(axis=1)], np.inf)
    return np.asarray(np.minimum(clear_s, fallen_s))


def from_emission(
    measurements: Sequence[Measurement], travel_s: Sequence[float]
) -> list[signal.ImpulseResponse]:
    """Return the responses on a clock that counts from emission.

    ``direct``: the response's own onset is the direct sound. ``unknown``: one offset a source and
    state, the median over its responses; those for validation count only where there is no other.
    """
    aligned = [
        m.response
        if m.time_zero == "emission"
        else signal.time_zero_from_direct(m.response, direct_s, m.where)
        for m, direct_s in zip(measurements, travel_s, strict=True)
    ]
    offsets: dict[tuple[str, str, str], list[float]] = {}
    for m, own in zip(measurements, aligned, strict=True):
        if m.time_zero == "unknown":
            offsets.setdefault((m.source, m.state, m.use), []).append(own.time_zero_s)

    def offset_s(m: Measurement) -> float:
        fitted = offsets.get((m.source, m.state, "fit"))
        return float(np.median(fitted if fitted else offsets[m.source, m.state, "validate"]))

    return [
        replace(own, time_zero_s=offset_s(m)) if m.time_zero == "unknown" else own
        for m, own in zip(measurements, aligned, strict=True)
    ]


def time_scales(measurements: Measurements) -> tuple[float, float]:
    """Return the longest decay time that is fitted, and where the last usable window ends, in s."""
    fitted = [m for m in measurements.responses if m.measurement.use == "fit"]
    times_s = [0.0]
    for m in fitted:
        of_response = (known(m.parameters.of(name)) for name in _SHORTER)
        times_s += next((row for row in of_response if row), [])
    for v in measurements.values:
        for name in ("T30_s", *_SHORTER):
            times_s += known(v.values.get(name, np.zeros(0)))
    # a decay that nothing could evaluate still ends where it drowns
    longest, latest = max(times_s), max((float(m.fit_end_s.max()) for m in fitted), default=0.0)
    if longest <= 0.0:
        return 0.0, latest if latest > 0.0 else 1.0
    return longest, min(latest, longest)


_SHORTER: tuple[decay.ParameterName, ...] = ("T20_s", "EDT_s")


def known(row: FloatArray) -> list[float]:
    """Return the numbers of a row that are finite."""
    return [float(x) for x in row if np.isfinite(x)]


def median_decay_s(measurements: Measurements, centres_hz: FloatArray) -> FloatArray:
    """Return the median T20 over what is fitted, NaN where none is known, (n_bands,).

    Or EDT in a band where no pair has the range for T20.
    """
    found: FloatArray = np.full(centres_hz.size, np.nan)
    names: tuple[decay.ParameterName, ...] = ("EDT_s", "T30_s", "T20_s")
    for name in names:
        rows = [m.parameters.of(name) for m in measurements.responses if m.measurement.use == "fit"]
        rows += [v.at(name, centres_hz) for v in measurements.values if name in v.values]
        for band, values in enumerate(np.array(rows).reshape(-1, centres_hz.size).T):
            if finite := known(values):
                found[band] = np.median(finite)
    return found


def _joined(
    tabulated: Sequence[MeasuredValues], use: Use
) -> tuple[tuple[MeasuredValues, ...], tuple[Finding, ...]]:
    """Return the values of one use; a pair that stands in several tables is joined."""
    by_pair: dict[tuple[str, str, str], list[MeasuredValues]] = {}
    findings, joined = list[Finding](), []
    for m in tabulated:
        if m.use == use:
            findings += m.findings
            same = by_pair.setdefault(m.pair_name, [])
            if same:
                at = same[0].centres_hz
                values = {name: m.at(name, at) for name in m.values}
                spread = {name: m.spread_at(name, at) for name in m.spread}
                m = replace(m, centres_hz=at, values=values, spread=spread)
            same.append(m)
    for repeated in by_pair.values():
        one, doubts = joined_values(tuple(repeated))
        findings += doubts
        joined.append(one)
    return tuple(joined), tuple(findings)
