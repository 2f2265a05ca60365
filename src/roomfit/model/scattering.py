"""Traced paths reweighed for another scattering coefficient, band by band."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from roomfit.base.errors import InputError
from roomfit.base.kernels import in_threads, kernel
from roomfit.base.typing import FloatArray, IntArray
from roomfit.materials.priors import Scattering
from roomfit.model.weighing import EnergyRows, reweighed_rows
from roomfit.tracing.paths import Paths

# What groups of bands are traced for; a trace of one group is kept where it has this much.
WANTED_EFFECTIVE_FRACTION = 0.2
# Below it a few paths carry all the weight, and the trace is to be made again.
LEAST_EFFECTIVE_FRACTION = 0.1


def scattering_weights(paths: Paths, scattering: Scattering) -> FloatArray:
    """Return the factor on each path's weight that turns the sampled scattering into another.

    A path with d diffuse and n specular hits on a material was drawn with probability ``s0**d (1 -
    s0)**n`` and would be with ``s**d (1 - s)**n``, multiplied over materials; the factor is their
    ratio. Of paths drawn with several s0 by turns the former is the mean over groups, whichever
    group drew a path (the balance heuristic, E. Veach and L. J. Guibas, SIGGRAPH 1995).
    """
    traced, wanted = paths.sampling_scattering, scattering.coefficients
    undrawn = (traced != wanted) & ((traced == 0.0) | (traced == 1.0))
    missing = np.flatnonzero(undrawn[np.argmin(undrawn.sum(axis=1))])
    if missing.size:
        m = missing[0]
        raise InputError(
            "scattering cannot be changed after the trace",
            where=f"material {paths.materials[m]!r}",
            found=f"traced with {traced[0, m]:g}, wanted {wanted[m]:g}",
            needed="a sampling coefficient between 0 and 1",
            hint="trace again with the coefficient that is wanted",
        )
    factor, hits = np.empty(len(paths)), (paths.hits_diffuse, paths.hits_specular)
    in_threads(_mixture_ratios, len(paths), _log_changes(traced, wanted), *hits, factor)
    return factor


@kernel(allocates=False)
def _mixture_ratios(
    first: int,
    last: int,
    changes: FloatArray,
    diffuse: IntArray,
    specular: IntArray,
    factor: FloatArray,
) -> None:
    """Fill the wanted probability of each path over the mean of the traced ones."""
    n_groups, _, n_materials = changes.shape
    for i in range(first, last):
        mean = 0.0
        for g in range(n_groups):
            log_ratio = 0.0
            for m in range(n_materials):
                log_ratio += diffuse[i, m] * changes[g, 0, m] + specular[i, m] * changes[g, 1, m]
            mean += math.exp(min(log_ratio, 700.0)) / n_groups
        factor[i] = 1.0 / mean


def _log_changes(traced: FloatArray, wanted: FloatArray) -> FloatArray:
    """Return log(s0 / s) and log((1 - s0) / (1 - s)), shape (n_groups, 2, n_materials)."""
    never = 1e-300  # a logarithm that is finite: times no hits it must give 0
    kinds = [(traced, wanted), (1.0 - traced, 1.0 - wanted)]
    logs = [np.log(np.maximum(a, never)) - np.log(np.maximum(b, never)) for a, b in kinds]
    return np.stack(logs, axis=1)


def effective_sample_size(factors: FloatArray) -> float:
    """Return how many paths of equal weight tell as much (Kish, Survey Sampling, 1965)."""
    square = float(np.sum(np.square(factors)))
    return float(np.sum(factors)) ** 2 / square if square > 0.0 else 0.0


def rows_for_band(
    rows: Sequence[EnergyRows], paths: Paths, scattering: Scattering
) -> tuple[tuple[EnergyRows, ...], float]:
    """Return rows with the weights that another scattering gives them, and what they are worth.

    The least `effective_sample_fraction` of the pairs; image paths stay exact.
    """
    if np.array_equal(scattering.coefficients[None], paths.sampling_scattering):
        return tuple(rows), 1.0
    factors = scattering_weights(paths, scattering)
    weighed = tuple(reweighed_rows(r, factors) for r in rows)
    share = min(
        (effective_sample_fraction(r, w) for r, w in zip(rows, weighed, strict=True)), default=1.0
    )
    return weighed, share


def effective_sample_fraction(rows: EnergyRows, weighed: EnergyRows) -> float:
    """Return the effective sample size of a pair's rays after reweighing, as a share of before.

    In eighths of the rays by time, the least of them: weights degenerate with every hit, so that
    the late part suffers first.
    """
    rays = np.flatnonzero(rows.batch >= 0)
    n_slices = int(np.clip(len(rays) // 32, 1, 8))
    shares = [
        effective_sample_size(weighed.weight_per_m2[part])
        / max(effective_sample_size(rows.weight_per_m2[part]), 1e-300)
        for part in np.array_split(rays, n_slices)
        if part.size
    ]
    return float(min((1.0, *shares)))


def sampling_groups(
    wanted: FloatArray, single: FloatArray, hits: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Return the coefficients to trace with, so that no band loses too many rays to its weights.

    As few groups of neighbouring bands as give every band an effective sample fraction of 0.2, each
    traced with the mean of its bands, (n_groups, n_materials). They divide the bands by equal
    shares of the distance ``2 asin(sqrt(s))`` from band to band: of paths with h hits, drawn with
    s0 and weighed for s at the distance d, the fraction is near ``exp(-h d**2)``.

    Shapes: `wanted` (n_materials, n_bands), `single` and `hits` (n_materials,).
    """
    groups = single[None]
    best, largest = groups, 0.0
    steps = np.diff(2.0 * np.arcsin(np.sqrt(wanted)), axis=1)
    moved = np.cumsum(np.append(0.0, np.sqrt(hits @ np.square(steps))))
    n_steps = int(np.count_nonzero(np.diff(moved)))
    for n_groups in range(1, n_steps + 2):
        if n_groups > 1:
            share = np.round(moved / moved[-1] * (n_groups - 1)).astype(np.int64)
            if n_groups == n_steps + 1:
                share = np.cumsum(np.append(False, np.diff(moved) > 0.0))
            rows = [wanted[:, share == number] for number in np.unique(share)]
            # to the last bit where all of a row are equal
            means = [np.where(np.ptp(r, axis=1) == 0.0, r[:, 0], r.mean(axis=1)) for r in rows]
            groups = np.stack(means)
        fraction = float(effective_fractions(groups, wanted, hits, rng).min())
        if fraction > largest:
            best, largest = groups, fraction
        if fraction >= WANTED_EFFECTIVE_FRACTION:
            break
    return best


def effective_fractions(
    groups: FloatArray, wanted: FloatArray, hits: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Return the effective sample fraction that every band will have, shape (n_bands,).

    One over the mean of the factor of `scattering_weights` among paths that are drawn with the
    band's own scattering, whose numbers of hits follow Poisson's distribution.
    """
    if len(groups) == 1:  # in closed form; drawn weights would be of few large ones
        room = np.maximum(groups[0] * (1.0 - groups[0]), 1e-300)[:, None]
        excess = np.square(wanted - groups[0][:, None]) / room
        return np.asarray(np.exp(-(hits @ excess)))
    struck = rng.poisson(hits, (1000, hits.size))
    found = np.empty(wanted.shape[1])
    for band, s in enumerate(wanted.T):
        diffuse = rng.binomial(struck, s)
        changes = _log_changes(groups, s)
        drawn = changes[:, 0] @ diffuse.T + changes[:, 1] @ (struck - diffuse).T
        found[band] = 1.0 / np.mean(1.0 / np.exp(np.minimum(drawn, 700.0)).mean(axis=0))
    return found
