"""Whether the chain was linear and left the decay alone, and whether what is fixed can be true.

Each is one more unknown that the fit does not have: the exponent of a compressor or an expander,
the saturation of a limiter or of clipping, the decay rate of a window that was left in the files,
the absorption of a material that the campaign fixes. How far the data ask for it follows from the
fit as it is, by the score test [1]_.

References
----------
.. [1] C. R. Rao, "Large sample tests of statistical hypotheses concerning several parameters",
       Proc. Cambridge Philos. Soc. 44, 50-57 (1948).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import fft
from scipy.special import chdtri

from roomfit.bands import Bands, bands_in_words
from roomfit.findings import About, Code, Finding
from roomfit.logit import expit, logit
from roomfit.materials.priors import MaterialPrior
from roomfit.measurement import MeasuredPair
from roomfit.objective.energy import EnergyTerm
from roomfit.objective.parameters import Parameters, prior_residuals
from roomfit.objective.problem import Prediction
from roomfit.signals.filters import filter_pressure
from roomfit.signals.response import times_s
from roomfit.solvers.least_squares import BandFit
from roomfit.typing import FloatArray

# In standard deviations; a right room exceeds 4 by chance once in 16,000, and clean rooms of
# another program and measured ones less than 3: docs/how-far-to-trust.md.
_FEWEST_SDS = 4.0
# An exponent nearer to 1, a smaller loss at the peak, and a decay rate that is a smaller share of
# the room's own, do less to absorption than intervals allow for.
_LEAST_EXPONENT, _LEAST_LOSS, _LEAST_RATE = 0.04, 0.05, 0.05
_FEWEST_BANDS = 2  # one value that all share
# Noise is sought in the last two fifths of a file and until 3 ms before the direct sound, above
# 500 Hz; rates of its parts are alike within a quarter.
_TAIL_SHARE, _TAIL_BLOCKS, _TAIL_HZ, _RINGING_S = 0.4, 8, 500.0, 0.05
_EDGE_S, _BEFORE_S, _ALIKE, _FEWEST_FILES = 0.5e-3, 3e-3, 0.25, 3
# Stretches of equal samples of a gate last so long at least; between them sound is louder than so
# many of the smallest steps.
_GAP_S, _GAP_STEPS, _FEWEST_GAPS = 2e-3, 8.0, 3
# Log-likelihood that one more unknown must gain in some band, and the chance of all bands together.
_LEAST_GAIN, _CHANCE = 2.0, 1e-3


class FittedWindows(NamedTuple):
    """One band whose windows were fitted as pressures."""

    band: int
    parameters: Parameters
    there: Prediction  # of the fit, windows first
    by_wall: FloatArray  # (n_data, n_materials), by all absorptions; no rows where none is fixed
    neighbours: FloatArray  # (n_data,), how many share the information of each
    fit: BandFit
    energies: EnergyTerm  # the windows, for their edges and noise
    files: tuple[MeasuredPair, ...]  # one an observation
    shared: Mapping[str, FloatArray]  # (n_windows, n) each, errors of all windows, one sd a column
    decay_rate_per_s: float  # of energy, as measured


class Score(NamedTuple):
    """What the data ask of one more unknown, to first order."""

    value: float
    sd: float


def scored(windows: FittedWindows, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the score of further unknowns at 0, and their information, all others fitted along.

    Parameters
    ----------
    columns : float array, shape (n, n_more)
        Derivative of the first n expected data by each of them.

    Returns
    -------
    score : float array, shape (n_more,)
    information : float array, shape (n_more, n_more)
        Its covariance where the model is right: the value of one unknown by itself is
        score / information, with the standard deviation information**-0.5.
    """
    fit, own = windows.fit, windows.there.jacobian
    # a misfit widens intervals, and makes further unknowns less certain by as much
    misfit = max(fit.chi2_reduced, 1.0)
    weight = 1.0 / (misfit * windows.neighbours * fit.variance)
    residual = fit.measured - fit.expected
    every = np.concatenate(list(windows.shared.values()), axis=1)
    shared, more = (np.zeros((residual.size, x.shape[1])) for x in (every, columns))
    shared[: len(every)] = every
    more[: len(columns)] = columns
    jacobian = np.concatenate((own, shared), axis=1)
    prior, rows = prior_residuals(windows.parameters, fit.vector)
    hessian = jacobian.T @ (weight[:, None] * jacobian)
    n = own.shape[1]
    hessian[:n, :n] += rows.T @ rows
    hessian[n:, n:] += np.eye(shared.shape[1])
    # what is left of the gradient: the last step is not taken to its end, nor for shared errors
    gradient = jacobian.T @ (weight * residual)
    gradient[:n] -= rows.T @ prior
    across = jacobian.T @ (weight[:, None] * more)
    solved = np.linalg.solve(hessian, np.column_stack((across, gradient)))
    score = more.T @ (weight * residual) - across.T @ solved[:, -1]
    information = more.T @ (weight[:, None] * more) - across.T @ solved[:, :-1]
    return np.asarray(score), np.asarray(information)


def chain_slopes(
    bands: Bands, m: MeasuredPair, edges_s: Sequence[FloatArray], peak: float
) -> list[FloatArray]:
    """Return how a chain changes the logarithm of each window's energy, a band after the other.

    By the exponent p of sign(x) abs(x / peak)**p at p = 1, where the derivative of the samples is
    x ln abs(x / peak); by the loss c at the peak of x (1 - c (x / peak)**2), the first term of any
    saturation; and by the rate of exp(-rate t) on the energy, where it is -t.

    Parameters
    ----------
    bands : Bands
        Of the edges.
    edges_s : sequence of float arrays, shape (n_windows + 1,)
    peak : float
        Of all files of a campaign.

    Returns
    -------
    list of float array, shape (n_windows, 3)
    """
    size = np.abs(m.response.pressure)
    logs = np.log(np.where(size > 0.0, size / peak, 1.0))
    changes = [
        filter_pressure(bands, replace(m.response, pressure=m.response.pressure * factor))
        for factor in (logs, -((size / peak) ** 2))
    ]
    rate_hz = m.response.sampling_rate_hz
    boundaries_s = np.append(times_s(m.response), times_s(m.response)[-1] + 1.0 / rate_hz)
    boundaries_s -= 0.5 / rate_hz
    out = []
    for pressure, by_power, by_loss, own_s in zip(
        filter_pressure(bands, m.response), *changes, edges_s, strict=True
    ):
        whole, *parts = (
            np.diff(np.interp(own_s, boundaries_s, np.append(0.0, np.cumsum(x))))
            for x in (pressure**2, 2.0 * pressure * by_power, 2.0 * pressure * by_loss)
        )
        relative = np.divide(parts, whole, out=np.zeros_like(parts), where=whole > 0.0)
        out.append(np.stack((*relative, -0.5 * (own_s[1:] + own_s[:-1])), axis=1))
    return out


def common(scores: FloatArray, information: FloatArray) -> Score:
    """Return the value that all bands have in common, with its standard deviation.

    Where bands scatter about it by more than they should, its standard deviation grows by as much
    [1]_: an error of the model differs from band to band, a chain does not.

    Parameters
    ----------
    scores, information : float arrays, shape (n_bands,)

    References
    ----------
    .. [1] R. T. Birge, "The calculation of errors by the method of least squares", Phys. Rev. 40,
           207-227 (1932).
    """
    value = float(scores.sum() / information.sum())
    scatter = float(np.sum(information * (scores / information - value) ** 2))
    ratio = max(scatter / max(len(scores) - 1, 1), 1.0)
    return Score(value, float(np.sqrt(ratio / information.sum())))


def _asked(fitted: Sequence[FittedWindows], relative: Sequence[FloatArray]) -> Score:
    """Return what all bands ask of one unknown, given its relative derivatives, (n_windows, 1)."""
    scores = []
    for w, own in zip(fitted, relative, strict=True):
        signal = w.there.signal[: len(own), None]
        scores.append([float(x.item()) for x in scored(w, signal * own)])
    return common(*np.array(scores).T)


def chain_findings(
    bands: Bands, fitted: Sequence[FittedWindows], *, is_directed: bool
) -> tuple[Finding, ...]:
    """Return a finding where levels were bent by a power or saturated, or the decay by a window.

    They look alike in a decay, but not over the distances of direct sound and reflections; the
    one that is clearest is named. One value is common to all bands.

    Parameters
    ----------
    fitted : sequence of FittedWindows
        Bands in which pressures explain the data better than energies: where energies add, how
        far smooth walls' late sound lies below their sum is not known well enough.
    is_directed : bool
        Whether directivities were fitted: what is left of those that are not of first order bends
        levels as a chain does (of one measured room by the power 1.22), and none is asked for.
    """
    if len(fitted) < _FEWEST_BANDS:
        return ()
    peak = max(float(np.abs(m.response.pressure).max()) for w in fitted for m in w.files)
    slopes: dict[tuple[int, int], FloatArray] = {}
    for m in dict.fromkeys(m for w in fitted for m in w.files):
        reached = [w for w in fitted if m in w.files]
        chosen = Bands(bands.kind, bands.centres_hz[[w.band for w in reached]])
        edges_s = [w.energies.observations[w.files.index(m)].edges_s for w in reached]
        for w, own in zip(reached, chain_slopes(chosen, m, edges_s, peak), strict=True):
            slopes[w.band, w.files.index(m)] = own
    relative = [np.concatenate([slopes[w.band, i] for i in range(len(w.files))]) for w in fitted]
    power, loss, window = (_asked(fitted, [r[:, k : k + 1] for r in relative]) for k in range(3))
    rate_per_s = float(np.median([w.decay_rate_per_s for w in fitted]))
    sizes = [abs(s.value) / s.sd for s in (power, loss, window)]
    least = (_LEAST_EXPONENT, _LEAST_LOSS, _LEAST_RATE * rate_per_s)
    clear = [
        size > _FEWEST_SDS and abs(s.value) > smallest
        for s, size, smallest in zip((power, loss, window), sizes, least, strict=True)
    ]
    # nothing saturates by a gain
    clear[1] &= loss.value > 0.0
    clear[:2] = [c and not is_directed for c in clear[:2]]
    evidence = {
        "exponent": round(1.0 + power.value, 4),
        "exponent_sd": round(power.sd, 4),
        "loss_at_peak": round(loss.value, 4),
        "loss_at_peak_sd": round(loss.sd, 4),
        "rate_per_s": round(window.value, 3),
        "rate_sd_per_s": round(window.sd, 3),
        "bands_hz": bands.centres_hz[[w.band for w in fitted]].tolist(),
    }
    clearest = int(np.argmax(np.where(clear, sizes, 0.0)))
    if not clear[clearest]:
        return ()
    if clearest < 2:
        kind = "compressor or limiter" if power.value < 0.0 else "expander or gate"
        said = f"as by the power {1.0 + power.value:.2f} +- {power.sd:.2f} of the pressure"
        if clearest == 1:
            kind = "limiter or an overdriven input"
            said = f"where they are loud, by {loss.value:.2f} +- {loss.sd:.2f} at the peak"
        return (
            Finding(
                Code.LEVELS_NOT_LINEAR,
                About(),
                f"Levels are bent {said}, in all bands and over all distances alike: a {kind} is "
                "in the chain, the files were processed, or a source that was taken for "
                "omnidirectional is none. Measure again without it; no material is called "
                "identifiable.",
                evidence,
            ),
        )
    way = "fast" if window.value > 0.0 else "slowly"
    return (
        Finding(
            Code.DECAY_BENT,
            About(),
            f"The sound decays too {way} for its early reflections, by "
            f"{window.value:.1f} +- {window.sd:.1f} of energy per second alike in all bands "
            f"(the room's own: {rate_per_s:.0f}): an exponential window was left in the files, "
            "or something absorbs that is not described. No material is called identifiable.",
            evidence,
        ),
    )


def fixed_absorption_findings(
    bands: Bands, priors: tuple[MaterialPrior, ...], fitted: Sequence[FittedWindows]
) -> tuple[Finding, ...]:
    """Return a finding for each material whose fixed absorption the data contradict.

    It is freed once, to first order: where the log-likelihood of some band gains 2 and more, and
    that of all bands together more than happens by chance once in a thousand materials.
    """
    findings = []
    for i, prior in enumerate(priors):
        known, gains, freed, n = prior.known, {}, {}, 0
        if known is None:
            continue
        for w in fitted:
            own = float(np.clip(known[w.band], 1e-3, 1.0 - 1e-3))
            more, information = scored(w, own * (1.0 - own) * w.by_wall[:, [i]])
            if information[0, 0] <= 0.0:
                continue
            n += 1
            gains[w.band] = 0.5 * float(more[0] ** 2 / information[0, 0])
            step = float(np.clip(more[0] / information[0, 0], -3.0, 3.0))
            freed[w.band] = float(expit(logit(np.array([own])) + step)[0])
        clear = [b for b, gain in gains.items() if gain >= _LEAST_GAIN]
        if not clear or 2.0 * sum(gains.values()) <= float(chdtri(n, _CHANCE)):
            continue
        notes = [f"{known[b]:.2f} fixed, about {freed[b]:.2f} likelier" for b in clear]
        findings.append(
            Finding(
                Code.FIXED_ABSORPTION_CONTRADICTED,
                About(materials=[prior.name], bands_hz=bands.centres_hz[clear].tolist()),
                f"The data contradict the absorption that the campaign fixes for {prior.name}: "
                f"{bands_in_words(bands, clear, notes)}; freed, the log-likelihood rises by "
                f"{sum(gains.values()):.0f}. All others compensate for it: none is called "
                "identifiable. State a prior in its place.",
                {
                    "material": prior.name,
                    "bands_hz": bands.centres_hz[clear].tolist(),
                    "log_likelihood_gain": [round(gains[b], 2) for b in clear],
                    "about": [round(freed[b], 3) for b in clear],
                },
            )
        )
    return tuple(findings)


def tail_findings(measured: Sequence[MeasuredPair]) -> tuple[Finding, ...]:
    """Return a finding where the background noise falls, as in files under an exponential window.

    Noise is stationary, unless a window was applied after it was recorded. Above 500 Hz its rate is
    taken twice: within the last two fifths of the files, and from before the direct sound to there.
    A room that still rings makes the first larger and the second smaller, sound before the direct
    sound (deconvolution leaves some) the second larger: only a window makes both the same, and the
    halves of the end as well.

    Parameters
    ----------
    measured : sequence of MeasuredPair
        Three of them at least must begin 4 ms before the direct sound.
    """
    rates = np.array([r for m in measured if (r := _noise_rates(m)) is not None])
    if len(rates) < _FEWEST_FILES:
        return ()
    within, first, second, across = rates.mean(axis=0)
    sds = rates.std(axis=0, ddof=1) / np.sqrt(len(rates))
    rings = [1.0 / t for m in measured for t in m.noise.tail_time_constant_s if t > 0.0]
    alike = abs(within - across) < max(_ALIKE * within, 3.0 * float(np.hypot(sds[0], sds[3])))
    straight = abs(first - second) < max(_ALIKE * within, 3.0 * float(np.hypot(sds[1], sds[2])))
    clear = min(within / sds[0], across / sds[3]) > _FEWEST_SDS
    if not (alike and straight and clear and rings and within > 0.01 * float(np.median(rings))):
        return ()
    return (
        Finding(
            Code.DECAY_BENT,
            About(),
            f"The background noise falls by {10.0 * within / np.log(10.0):.0f} dB per second "
            "within the files, and as fast from before the direct sound to their end: an "
            f"exponential window of {2.0 / within:.2g} s (pressure) was left in them, by which "
            "every decay is too fast. No material is called identifiable; undo it, or export the "
            "files without.",
            {
                "rate_per_s": round(float(within), 3),
                "rate_sd_per_s": round(float(sds[0]), 3),
                "rate_from_before_per_s": round(float(across), 3),
                "files": len(rates),
            },
        ),
    )


def gate_findings(measured: Sequence[MeasuredPair]) -> tuple[Finding, ...]:
    """Return a finding where sound goes on after stretches without any, as behind a noise gate.

    A gate, and a noise reduction, leave equal samples wherever the sound falls below a threshold,
    and let it rise out of them again. A file that is padded with zeros has them once; where the
    steps of a converter are coarser than the noise, it never is louder than a few of them between.
    """
    gaps = {
        f"{m.measurement.source} to {m.measurement.receiver} ({m.measurement.name})": n
        for m in measured
        if (n := _gaps(m)) >= _FEWEST_GAPS
    }
    if not gaps:
        return ()
    names = ", ".join(list(gaps)[:3]) + (f" and {len(gaps) - 3} more" if len(gaps) > 3 else "")
    return (
        Finding(
            Code.NOISE_GATED,
            About(),
            f"Sound goes on after stretches without any in {names}: a noise gate or a noise "
            "reduction was left in. It shortens the late decay and hides the noise; no material "
            "is called identifiable. Export the files without.",
            {"gaps": gaps},
        ),
    )


def _gaps(m: MeasuredPair) -> int:
    """Return how many stretches of equal samples after the peak sound goes on after."""
    x = m.response.pressure
    steps = np.abs(np.diff(x))
    ends = np.flatnonzero(np.diff(np.concatenate(([0], (steps == 0.0).astype(np.int8), [0]))))
    first, last = ends[::2], ends[1::2]
    long = last - first >= _GAP_S * m.response.sampling_rate_hz
    long &= first > int(np.argmax(np.abs(x)))
    first, last = first[long], last[long]
    coarse = _GAP_STEPS * float(steps[steps > 0.0].min(initial=np.inf))
    return sum(
        float(np.abs(x[a : b + 1] - x[a]).max()) > coarse
        for a, b in zip(last[:-1], first[1:], strict=True)
    )


def high_passed(x: FloatArray, from_hz: float, rate_hz: float) -> FloatArray:
    """Return a signal through a causal digital Butterworth filter of order 4, which rings after."""
    n = fft.next_fast_len(x.size + round(_RINGING_S * rate_hz), real=True)
    s = 1j * np.tan(np.pi * fft.rfftfreq(n)) / np.tan(np.pi * from_hz / rate_hz)
    poles = np.exp(0.125j * np.pi * np.arange(5, 13, 2))[:, None]
    gain = s**4 / np.prod(1.0 - poles * s, axis=0)
    return np.asarray(fft.irfft(fft.rfft(x, n) * gain, n)[: x.size])


def _noise_rates(m: MeasuredPair) -> tuple[float, float, float, float] | None:
    """Return rates of one file in 1/s: of its end, of this end's halves, and from before the sound.

    None where too little comes before the direct sound, or the file is too short.
    """
    x, rate_hz = m.response.pressure, m.response.sampling_rate_hz
    sounding = np.flatnonzero(x)
    begin, end = int(sounding[0]) + round(_EDGE_S * rate_hz), int(sounding[-1]) + 1
    direct = round((m.direct_s + m.response.time_zero_s) * rate_hz)
    before = slice(begin, direct - round(_BEFORE_S * rate_hz))
    size = round(_TAIL_SHARE * (end - direct)) // _TAIL_BLOCKS
    if before.stop - begin < 1e-3 * rate_hz or size < 2 or rate_hz < 2.5 * _TAIL_HZ:
        return None
    energy = high_passed(x, _TAIL_HZ, rate_hz) ** 2
    blocks = energy[end - _TAIL_BLOCKS * size : end].reshape(_TAIL_BLOCKS, size).mean(axis=1)
    early = float(energy[before].mean())
    if not (early > 0.0 and np.all(blocks > 0.0)):
        return None
    level, half = np.log(blocks), _TAIL_BLOCKS // 2
    time_s = size / rate_hz * np.arange(_TAIL_BLOCKS)
    within, first, second = (
        -float(np.polyfit(time_s[part], level[part], 1)[0])
        for part in (slice(None), slice(half), slice(half, None))
    )
    middle = end - 0.5 * _TAIL_BLOCKS * size - 0.5 * (begin + before.stop)
    return within, first, second, float(np.log(early) - level.mean()) * rate_hz / middle
