"""What a changed room would sound like: a measured response, scaled by what a change does.

Nothing is synthesised. The measured response stays, with the colour of its room and chain; each
band is scaled over time by the ratio of the predicted energies after to before.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import fft

from roomfit.base.errors import InputError
from roomfit.base.findings import Finding
from roomfit.base.kernels import one_blas_thread
from roomfit.base.typing import FloatArray, Progress
from roomfit.fit.measurements import observe
from roomfit.fit.traced_room import TracedRoom, trace_room
from roomfit.predict.changes import changed_draws
from roomfit.predict.question import Question
from roomfit.result import result_doubts
from roomfit.signals.decay import scaled_response
from roomfit.signals.measurement import MeasuredPair, Measurement

# Ratios are means over a tenth of the time since the direct sound, and over 10 ms at most: of
# decays of .3 and .6 s the mean over 20 ms is off by 0.1 dB.
_MEAN_SHARE, _LONGEST_MEAN_S = 0.1, 0.01
# What is predicted is relied on so far down either decay; below it the ratio goes on as it fell.
_RELIED_ON_DB = 40.0
_LEAST_SHARE = 1e-12  # of the energy: less is rounding


class ChangedResponse(NamedTuple):
    """A measured response as it would be after a change."""

    measurement: Measurement
    samples: FloatArray  # (n_samples,), in the unit, at the rate and on the clock of the file
    # (n_bands,), s after emission, from which the measured noise carries the predicted tail; NaN
    # where the file ends before its noise
    noise_from_s: FloatArray


def energy_ratio(
    before: FloatArray, after: FloatArray, edges_s: FloatArray, direct_s: float
) -> FloatArray:
    """Return the ratio of predicted energies over time, after over before, shape (n_bands, n_bins).

    Early reflections keep their own: means are over a tenth of the time since the direct sound.
    Until this the ratio is 1. Where one of the decays has fallen by 40 dB, the logarithm of the
    ratio goes on as it fell over the later half of the time before.

    Shapes: `edges_s` (n_bins + 1,).
    """
    middle = 0.5 * (edges_s[1:] + edges_s[:-1])
    half_s = np.clip(_MEAN_SHARE * (middle - direct_s), 0.0, _LONGEST_MEAN_S)
    half_s = np.maximum(half_s, 0.5 * (edges_s[1] - edges_s[0]))
    found = np.ones_like(before)
    for band, rows in enumerate(zip(before, after, strict=True)):
        if np.array_equal(*rows):
            continue
        sums = [np.concatenate(([0.0], np.cumsum(row))) for row in rows]
        old, new = (
            np.interp(middle + half_s, edges_s, s) - np.interp(middle - half_s, edges_s, s)
            for s in sums
        )
        known = old > _LEAST_SHARE * sums[0][-1]
        found[band, known] = new[known] / old[known]
        deep = np.stack([s[-1] - s[1:] < 10.0 ** (-0.1 * _RELIED_ON_DB) * s[-1] for s in sums])
        ends = [int(np.argmax(d)) for d in deep]
        end = min(e for e in (*ends, before.shape[1] - 1) if e > 0)
        used = np.flatnonzero(middle[:end] > 0.5 * (direct_s + middle[end]))
        if used.size > 1:
            level = np.log(np.maximum(found[band, used], 1e-30))
            slope, height = np.polyfit(middle[used] - middle[end], level, 1)
            found[band, end:] = np.exp(height + slope * (middle[end:] - middle[end]))
    found[:, middle < direct_s] = 1.0
    return found


@one_blas_thread
def listen(
    question: Question, *, progress: Progress | None = None
) -> tuple[tuple[ChangedResponse, ...], tuple[Finding, ...]]:
    """Return measured responses as they would be after a change of materials.

    At the most likely absorption before and after; what is not known of it is said by
    `roomfit.predict`, not here. Level and clock are those of the files; without changes the samples
    come back as they are.
    """
    scene, absorption, settings = question.scene, question.known, question.settings
    changes = question.changes
    absorption.check_materials(scene.room.materials)
    measurements = [m for m in question.measurements if isinstance(m, Measurement)]
    if not measurements:
        needed, hint = "[[measurements]] with a file", "roomfit predict needs no recordings"
        raise InputError("no measured response to change", found="none", needed=needed, hint=hint)
    old = absorption.absorption
    new, _, findings = changed_draws(absorption, old[None], changes, settings.seed)
    materials = scene.room.materials
    unknown = [c.material for c in changes if absorption.is_unknown[materials.index(c.material)]]
    if unknown:
        raise InputError(
            "the absorption before the change is not known",
            found=", ".join(unknown),
            needed="a material of the result: there is no ratio of after to before",
            hint="change a material that the result determines",
        )
    observed, doubts = observe(scene, measurements, absorption.bands)
    times = [m.parameters.of("T30_s") for m in observed]
    longest_s = max((float(np.nanmax(row)) for row in times if np.isfinite(row).any()), default=0.0)
    room = trace_room(scene, absorption, np.stack((old, new)), longest_s, settings, progress)
    found = tuple(_changed_response(room, m, old, new) for m in observed)
    rests_on = result_doubts(absorption)
    return found, (*rests_on, *absorption.findings, *findings, *doubts, *room.findings)


def _changed_response(
    room: TracedRoom, m: MeasuredPair, old: FloatArray, new: FloatArray
) -> ChangedResponse:
    """Return a response scaled by what is predicted under one absorption over that under another.

    Shapes: `old, new` (n_materials, n_bands).
    """
    edges, bin_s = room.edges_s, float(room.edges_s[1] - room.edges_s[0])
    # nothing is predicted between the end of the trace and that of the file
    silent = max(0, int(np.ceil((m.response.last_s - edges[-1]) / bin_s)))
    edges_s = np.append(edges, edges[-1] + bin_s * np.arange(1, silent + 1))
    before, after = (np.pad(room.echogram(m.pair, a), ((0, 0), (0, silent))) for a in (old, new))
    ratio = energy_ratio(before, after, edges_s, m.direct_s)
    middle = 0.5 * (edges_s[1:] + edges_s[:-1])
    samples = scaled_response(m.response, room.bands, middle, ratio, m.noise)
    from_s = np.where(m.noise.reached, m.noise.usable_end_s, np.nan)
    return ChangedResponse(m.measurement, samples, from_s)


def convolved(dry: FloatArray, response: FloatArray) -> FloatArray:
    """Return a recording as it sounds through a response, shape (n_dry + n_response - 1,)."""
    n = len(dry) + len(response) - 1
    length = fft.next_fast_len(n, real=True)
    return np.asarray(fft.irfft(fft.rfft(dry, length) * fft.rfft(response, length), length)[:n])


def with_dry_recording(
    sounds: Sequence[dict[str, FloatArray]], dry: FloatArray
) -> tuple[list[dict[str, FloatArray]], float]:
    """Return responses with what a dry recording becomes in each, and the factor of all of these.

    The loudest then has a peak of half.
    """
    wet = [{f"dry_{k}": convolved(dry, x) for k, x in s.items()} for s in sounds]
    factor = 0.5 / max(float(np.abs(x).max()) for s in wet for x in s.values())
    scaled = [{k: factor * x for k, x in s.items()} for s in wet]
    return [s | w for s, w in zip(sounds, scaled, strict=True)], factor
