"""Everything that was measured on one scene, and what can be said of it without a model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from roomfit._checks import nearest
from roomfit.air import speed_of_sound_m_s
from roomfit.bands import Bands
from roomfit.errors import InputError
from roomfit.findings import About, Code, Finding
from roomfit.geometry.mesh import refuse
from roomfit.inversion.causes import arrival_findings, gain_findings, polarity_findings
from roomfit.inversion.room_outline import outline_findings
from roomfit.measurement import MeasuredPair, Measurement, Use
from roomfit.response.directivity import Directivities
from roomfit.scene import (
    NEAREST_PAIR_M,
    Scene,
    distances_m,
    pair_names,
    position_findings,
)
from roomfit.settings import DECAY_RANGE_DB
from roomfit.signals.decay import (
    DecayCurve,
    ParameterName,
    check_decay_range,
    check_is_response,
    decay_curve,
    in_jnd,
    range_findings,
    room_parameters,
)
from roomfit.signals.filters import check_sampling_rate, filter_pressure
from roomfit.signals.iso3382 import MeasuredValues, joined_values
from roomfit.signals.noise import NoiseEstimate, estimate_noise
from roomfit.signals.response import (
    ImpulseResponse,
    check_travel,
    clipping_findings,
    compare_onset,
    find_onset,
    same_recordings,
    time_zero_from_direct,
)
from roomfit.tracing.paths import Paths
from roomfit.typing import FloatArray

# More than a listener's smallest step by a factor that no repetition at one place explains.
LARGEST_JND = 2.0
LARGEST_LEVEL_DB = 1.5
# A window is fitted down to where the decay stands 4 dB above the noise.
_CLEAR_OF_NOISE = 2.5
_COMPARED: tuple[ParameterName, ...] = ("T20_s", "EDT_s", "C80_dB")


def duplicate_findings(measured: Sequence[MeasuredPair]) -> tuple[Finding, ...]:
    """Return a finding for each pair that was measured twice with results that differ.

    Compared are T20, EDT and C80, by more than 2 just noticeable differences, and the levels of the
    bands where they are said to be alike (measurements of one source that share its gain), by more
    than 1.5 dB. Nothing but the two responses is used: no position, no model.

    Parameters
    ----------
    measured : sequence of MeasuredPair
        In any order; what is kept for validation is compared as well.
    """
    findings = []
    for one, other in combinations(measured, 2):
        if one.pair != other.pair:
            continue
        ways = [*_differing(one, other), *_levels(one, other)]
        if not ways:
            continue
        names = f"{one.measurement.name} and {other.measurement.name}"
        findings.append(
            Finding(
                Code.REPEATED_RESPONSES_DIFFER,
                About(files=[one.measurement.where, other.measurement.where]),
                f"{one.measurement.source} to {one.measurement.receiver} was measured twice "
                f"({names}) with different results: {'; '.join(ways)}. One of them may belong to "
                "another pair, or the room was changed in between.",
                {
                    "source": one.measurement.source,
                    "receiver": one.measurement.receiver,
                    "files": [one.measurement.where, other.measurement.where],
                    "differences": ways,
                },
            )
        )
    return tuple(findings)


def counted_once(
    scene: Scene, measurements: Sequence[Measurement]
) -> tuple[list[Measurement], tuple[Finding, ...]]:
    """Return the measurements without copies of one recording, and what was found of these.

    A copy that stands where the first one does, under whatever name, adds no information and is
    left out, the one to be fitted kept. One that is said to be of other places is wrong there or
    here, and nobody but the user can tell where: it stays, with a finding that voids the answer.
    """
    at_m = {p.name: p.position_m for p in (*scene.sources, *scene.receivers)}
    order = sorted(measurements, key=lambda m: m.use != "fit")
    left_out, findings = set(), []
    for i, j in same_recordings([np.asarray(m.samples) for m in order]):
        one, other = order[i], order[j]
        apart_m = max(
            float(np.linalg.norm(at_m[a] - at_m[b]))
            for a, b in ((one.source, other.source), (one.receiver, other.receiver))
        )
        names = f"{one.source} to {one.receiver} ({one.name})"
        copy = f"{other.source} to {other.receiver} ({other.name})"
        evidence = {"files": [one.where, other.where], "metres_apart": round(apart_m, 4)}
        if apart_m < NEAREST_PAIR_M and one.state == other.state:
            left_out.add(id(other))
            findings.append(
                Finding(
                    Code.RECORDING_COUNTED_ONCE,
                    About(),
                    f"{names} and {copy} are one recording, sample by sample: it was counted once.",
                    evidence,
                )
            )
        else:
            findings.append(
                Finding(
                    Code.RECORDING_OF_TWO_PAIRS,
                    About(),
                    f"{names} and {copy} are one recording, sample by sample, of places that are "
                    f"{apart_m:.2f} m apart or of two states of the room: one of them is wrong. "
                    "No material is called identifiable.",
                    evidence,
                )
            )
    return [m for m in measurements if id(m) not in left_out], tuple(findings)


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


def unreached_findings(paths: Paths, fitted: Sequence[str]) -> tuple[Finding, ...]:
    """Return a finding that names the materials to be fitted which no path strikes.

    Parameters
    ----------
    paths : Paths
    fitted : sequence of str
        Materials whose absorption is not given.
    """
    names = unreached_materials(paths, fitted)
    if not names:
        return ()
    return (
        Finding(
            Code.MATERIAL_NOT_REACHED,
            About(materials=list(names)),
            f"No path between the measured pairs strikes {', '.join(names)}: its absorption "
            "cannot be determined, and its prior is all that is reported.",
            {"materials": list(names)},
        ),
    )


def _differing(one: MeasuredPair, other: MeasuredPair) -> list[str]:
    parts = []
    for name in _COMPARED:
        first, second = one.parameters.of(name), other.parameters.of(name)
        # from their mean, so that the order does not matter
        steps = np.abs(
            in_jnd(name, 0.5 * (first + second), 0.5 * (first + second) + first - second)
        )
        known: FloatArray = np.abs(np.nan_to_num(steps, nan=0.0))
        if known.max() > LARGEST_JND:
            j = int(np.argmax(known))
            symbol, unit = name.split("_")
            parts.append(
                f"{symbol} {first[j]:.2f} and {second[j]:.2f} {unit} "
                f"at {one.curve.bands.centres_hz[j]:g} Hz"
            )
    return parts


def _levels(one: MeasuredPair, other: MeasuredPair) -> list[str]:
    if one.measurement.level != other.measurement.level or one.measurement.level == "per-file":
        return []
    difference = _level_db(one) - _level_db(other)
    known: FloatArray = np.abs(np.nan_to_num(difference, nan=0.0))
    if known.max() <= LARGEST_LEVEL_DB:
        return []
    j = int(np.argmax(known))
    return [f"levels that differ by {known[j]:.1f} dB at {one.curve.bands.centres_hz[j]:g} Hz"]


def _level_db(m: MeasuredPair) -> FloatArray:
    total = m.curve.energy_left[:, 0]
    return 10.0 * np.log10(np.where(total > 0.0, total, np.nan))


@dataclass(frozen=True, slots=True, eq=False)
class Measurements:
    """What was measured, on one scene and in the bands of the fit."""

    scene: Scene  # each measured pair once, however often it was measured
    bands: Bands
    directivities: Directivities
    responses: tuple[MeasuredPair, ...]  # those kept for validation included
    values: tuple[MeasuredValues, ...]  # room parameters to be fitted, one record a pair
    kept_values: tuple[MeasuredValues, ...]  # room parameters to be predicted only
    findings: tuple[Finding, ...]


def collect_measurements(
    scene: Scene,
    measurements: Sequence[Measurement | MeasuredValues],
    bands: Bands,
    directivities: Directivities,
    decay_range_db: float = DECAY_RANGE_DB,
) -> Measurements:
    """Put everything that was measured on one scene, and examine it without any model.

    Parameters
    ----------
    scene : Scene
        Its pairs do not matter: those that were measured are taken.
    measurements : sequence of Measurement or MeasuredValues
    decay_range_db : float
        See `fit_ends_s`.

    Raises
    ------
    InputError
        Nothing was measured, a name is not in the scene, a position is impossible, or a response
        is silent, too short, or sampled at too low a rate; with the one cause, if there is one, as
        what to try.
    """
    responses = [m for m in measurements if isinstance(m, Measurement)]
    tabulated = [m for m in measurements if isinstance(m, MeasuredValues)]
    if not measurements:
        raise InputError(
            "nothing was measured", needed="at least one impulse response or room parameter"
        )
    fitted, doubts = _joined(tabulated, "fit")
    kept, more_doubts = _joined(tabulated, "validate")
    own = measured_scene(scene, [*responses, *fitted, *kept])
    responses, copies = counted_once(own, responses)
    own = measured_scene(own, [*responses, *fitted, *kept])
    causes = arrival_findings(own, responses)
    try:
        pairs, findings = observe(own, responses, bands, decay_range_db)
    except InputError as error:
        if not causes:
            raise
        raise InputError(
            error.what,
            where=error.where,
            found=error.found,
            needed=error.needed,
            hint=" ".join(f.sentence for f in causes),
        ) from error
    observed = [(m.pair, m.response) for m in pairs if m.measurement.use == "fit"]
    if causes:  # which also moves what seem to be echoes of walls
        findings = tuple(f for f in findings if f.code is not Code.TIME_ZERO_MISMATCH)
        observed = []
    return Measurements(
        own,
        bands,
        {s.name: directivities[s.name] for s in own.sources if s.name in directivities},
        pairs,
        fitted,
        kept,
        (
            *causes,
            *gain_findings(pairs),
            *polarity_findings(pairs),
            *doubts,
            *more_doubts,
            *copies,
            *findings,
            *duplicate_findings(pairs),
            *outline_findings(own, observed),
        ),
    )


def measured_scene(scene: Scene, measured: Sequence[Measurement | MeasuredValues]) -> Scene:
    """Return the scene with the sources, receivers and pairs that were measured, each once.

    Raises
    ------
    InputError
        A name is not in the scene; or a source or a receiver stands outside the room, in a wall,
        or upon another.
    """
    states = ["", *(s.name for s in scene.room.states)]
    known_names = ([s.name for s in scene.sources], [r.name for r in scene.receivers], states)
    for m in measured:
        for kind, name, known in zip(
            ("source", "receiver", "state"), m.pair_name, known_names, strict=True
        ):
            if name not in known:
                guess = nearest(name, known)
                raise InputError(
                    f"a measurement names a {kind} that the scene does not have",
                    found=repr(name),
                    needed=f"one of {', '.join(known)}" if known else f"a {kind} in the scene",
                    hint=f"did you mean {guess!r}?" if guess else None,
                )
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
    """Put responses on the clock of emission and examine them in every band, in their order.

    Parameters
    ----------
    decay_range_db : float
        See `fit_ends_s`.

    Raises
    ------
    InputError
        A response is silent or too short, rates differ, or a band reaches above half of the
        sampling rate.
    """
    c = speed_of_sound_m_s(scene.air)
    pair_of = {name: i for i, name in enumerate(pair_names(scene))}
    pairs = [pair_of[m.pair_name] for m in measurements]
    travel_s = [float(d) for d in (distances_m(scene) / c)[pairs]]
    findings: list[Finding] = []
    for m in measurements:
        check_sampling_rate(bands, m.response.sampling_rate_hz, m.where)
        _check_same_rate(m, measurements[0])
        check_is_response(m.response, m.where)
        findings += m.findings
        if not m.findings:  # arrays: no reader has looked at them
            findings += clipping_findings(m.response.pressure, f"{m.source} to {m.receiver}")
    observed = []
    for m, pair, direct_s, response in zip(
        measurements, pairs, travel_s, from_emission(measurements, travel_s), strict=True
    ):
        name = f"{m.source} to {m.receiver} ({m.name})"
        check_travel(response, direct_s, m.where)
        if m.time_zero == "emission":
            onset_s = find_onset(response, m.where)
            findings += compare_onset(onset_s, direct_s, c, name, response.sampling_rate_hz)
        noise = estimate_noise(bands, response, filter_pressure(bands, response), direct_s)
        curve = decay_curve(bands, response, direct_s)
        parameters = room_parameters(curve)
        check_decay_range(curve, m.where)
        findings += range_findings(parameters, name)
        end_s = fit_ends_s(noise, curve, decay_range_db)
        observed.append(MeasuredPair(m, pair, response, direct_s, noise, curve, parameters, end_s))
    return tuple(observed), tuple(findings)


def fit_ends_s(noise: NoiseEstimate, curve: DecayCurve, decay_range_db: float) -> FloatArray:
    """Return when the last window of a fit ends in each band, in s after emission, (n_bands,).

    Where the decay stands 4 dB above the noise; or, if that is earlier, where the decay curve has
    fallen by `decay_range_db`. What comes later carries a ten-thousandth of the energy, is of no
    room parameter, and belongs to the few modes that decay the most slowly.
    """
    clear_s = noise.usable_end_s - np.log(_CLEAR_OF_NOISE) * noise.tail_time_constant_s
    fallen = curve.energy_left <= curve.energy_left[:, :1] * 10.0 ** (-decay_range_db / 10.0)
    fallen_s = np.where(fallen.any(axis=1), curve.time_s[fallen.argmax(axis=1)], np.inf)
    return np.asarray(np.minimum(clear_s, fallen_s))


def _check_same_rate(m: Measurement, first: Measurement) -> None:
    if m.sampling_rate_hz == first.sampling_rate_hz:
        return
    raise InputError(
        "the measurements have different sampling rates",
        where=m.where,
        found=f"{m.sampling_rate_hz:g} Hz, after {first.sampling_rate_hz:g} Hz in those before",
        needed="one sampling rate in a campaign, since one equipment measured it",
        hint="check that no file was saved at a wrong rate; resample those that were not",
    )


def from_emission(
    measurements: Sequence[Measurement], travel_s: Sequence[float]
) -> list[ImpulseResponse]:
    """Return the responses on a clock that counts from emission.

    ``direct``: the response's own onset is the direct sound. ``unknown``: one offset a source and
    state of the room, the median over its responses, so that a single masked onset moves nothing.
    Responses for validation contribute only where a source has no other.
    """
    aligned = [
        m.response
        if m.time_zero == "emission"
        else time_zero_from_direct(m.response, direct_s, m.where)
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
    """Return the longest decay time of any band, and where the last usable window ends, in s.

    What is kept for validation does not contribute, so that it cannot change the answer.
    """
    fitted = [m for m in measurements.responses if m.measurement.use == "fit"]
    longest = 0.0
    names: tuple[ParameterName, ...] = ("T20_s", "EDT_s")
    for m in fitted:
        for name in names:
            known = _known(m.parameters.of(name))
            if known.size:
                longest = max(longest, float(known.max()))
                break
    for v in measurements.values:
        for row in (v.values.get("T30_s"), v.values.get("T20_s"), v.values.get("EDT_s")):
            if row is not None and _known(row).size:
                longest = max(longest, float(_known(row).max()))
    # a decay that nothing could evaluate still ends where it drowns
    latest = max((float(m.fit_end_s.max()) for m in fitted), default=0.0)
    if longest <= 0.0:
        return 0.0, latest if latest > 0.0 else 1.0
    return longest, min(latest, longest)


def median_decay_s(measurements: Measurements, centres_hz: FloatArray) -> FloatArray:
    """Return the median reverberation time over what is fitted, NaN where none is known.

    Of T20, or of EDT in a band where no pair has the range for T20; shape (n_bands,).
    """
    found: FloatArray = np.full(centres_hz.size, np.nan)
    names: tuple[ParameterName, ...] = ("EDT_s", "T30_s", "T20_s")
    for name in names:
        rows = [m.parameters.of(name) for m in measurements.responses if m.measurement.use == "fit"]
        for v in measurements.values:
            if name in v.values:
                rows.append(_at(v.centres_hz, v.values[name], centres_hz))
        for band, values in enumerate(np.array(rows).reshape(-1, centres_hz.size).T):
            if _known(values).size:
                found[band] = np.median(_known(values))
    return found


def _joined(
    tabulated: Sequence[MeasuredValues], use: Use
) -> tuple[tuple[MeasuredValues, ...], tuple[Finding, ...]]:
    """Return the values of one use; a pair that stands in several tables is joined."""
    by_pair: dict[tuple[str, str, str], list[MeasuredValues]] = {}
    findings: list[Finding] = []
    for m in tabulated:
        if m.use == use:
            findings += m.findings
            by_pair.setdefault(m.pair_name, []).append(m)
    joined = []
    for repeated in by_pair.values():
        one, doubts = joined_values(tuple(_same_bands(repeated)))
        findings += doubts
        joined.append(one)
    return tuple(joined), tuple(findings)


def _same_bands(repeated: Sequence[MeasuredValues]) -> list[MeasuredValues]:
    """Return values of one pair on the bands of the first."""
    centres = repeated[0].centres_hz
    return [
        replace(
            m,
            centres_hz=centres,
            values={name: _at(m.centres_hz, row, centres) for name, row in m.values.items()},
            spread={name: _at(m.centres_hz, row, centres) for name, row in m.spread.items()},
        )
        for m in repeated
    ]


def _at(centres_hz: FloatArray, row: FloatArray, wanted_hz: FloatArray) -> FloatArray:
    known = dict(zip(centres_hz.tolist(), row.tolist(), strict=True))
    return np.array([known.get(f, np.nan) for f in wanted_hz.tolist()])


def _known(values: FloatArray) -> FloatArray:
    return np.asarray(values[np.isfinite(values)])
