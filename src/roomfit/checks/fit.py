"""Whether fits ended, explain the data, and answer by them: convergence, misfit, minima, priors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from roomfit.base.bands import bands_in_words
from roomfit.base.findings import About, Code, Finding
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.checks.evidence import UNDECIDED, Evidence
from roomfit.fit.symmetry import deviation_m, fitted_scene, mirror_symmetries
from roomfit.materials.catalogue import broad_prior_findings, product_findings
from roomfit.materials.priors import are_specified, prior_logits
from roomfit.uncertainty.gaussian import LARGEST_CHI2_REDUCED

_FEWEST_BANDS, _LARGEST_MEDIAN_CHI2 = 2, 1.5
# Of the prior's standard deviation: an answer that keeps more of it comes from the prior.
_PRIOR_DOMINATED = 0.9


def check_data(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding for the bands in which nothing could be fitted."""
    answers = zip(evidence.measured.bands.centres_hz, evidence.fits.answers, strict=True)
    empty = [float(f) for f, answer in answers if answer.model == "prior"]
    if empty:
        text = (
            f"Too little decay rises above the noise at {', '.join(f'{f:g}' for f in empty)} Hz: "
            "absorption there is its prior, with the interval 0 to 1 where none was stated."
        )
        yield Finding(Code.BAND_NOT_FITTED, About(bands_hz=empty), text, {"bands_hz": empty})


def check_bands(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding for the bands that the model misfits."""
    bands, answers = evidence.measured.bands, evidence.fits.answers
    bad = [j for j, a in enumerate(answers) if a.chi2_reduced > LARGEST_CHI2_REDUCED]
    if bad:
        values = [f"{answers[j].chi2_reduced:.1f}" for j in bad]
        text = (
            "The model does not explain the data within their noise; the reduced chi-square is "
            f"{bands_in_words(bands, bad, values)}. No material is called identifiable there, "
            "and intervals are widened by the misfit."
        )
        hz = bands.centres_hz[bad].tolist()
        yield Finding(Code.MODEL_DOES_NOT_FIT, About(bands_hz=hz), text, {"bands_hz": hz})


def check_convergence(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding for the bands whose fits did not converge."""
    bands, answers = evidence.measured.bands, evidence.fits.answers
    slow = [j for j, a in enumerate(answers) if not a.converged]
    if slow:
        # what the last round moved, in words
        moved = [", ".join(answers[j].moved) or answers[j].ending.value[0] for j in slow]
        bands_hz = bands.centres_hz[slow].tolist()
        yield Finding(
            Code.FIT_NOT_CONVERGED,
            About(bands_hz=bands_hz),
            "The fit did not converge within the rounds of updated weights that are allowed. "
            f"Last moved: {bands_in_words(bands, slow, moved)}. "
            "Allow more (max_rounds in [settings]), or fix what the data do not determine.",
            {"bands_hz": bands_hz, "moved": [list(answers[j].moved) for j in slow]},
        )


def check_misfit(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding where the model misfits most bands.

    One band that fits badly may have its own reason. Where the median is high, a fault is in what
    all share, the description of the room: 0.3 to 0.8 in simulated rooms that were described
    correctly, 2.0 with a curtain or an open door forgotten, 1.2 to 1.6 with directional
    loudspeakers taken for omnidirectional. Of two bands both must be high. Bands without responses
    are left out.
    """
    chi2 = [a.chi2_reduced for a in evidence.fits.answers if a.model in ("coherent", "energy")]
    if len(chi2) < _FEWEST_BANDS:
        return
    median = float(np.median(chi2) if len(chi2) > 2 else min(chi2))
    if not median > _LARGEST_MEDIAN_CHI2:
        return
    where, value = "most bands", f"median of the reduced chi-square {median:.1f}"
    if len(chi2) == 2:
        where, value = "both bands", f"reduced chi-square {median:.1f} or more"
    yield Finding(
        Code.MODEL_MISFIT_ALL_BANDS,
        About(),
        f"In {where} the model does not explain the data within their noise ({value}): the "
        "description of the room is wrong in a material, an opening, scattering, a source or a "
        "position. Intervals are too narrow, and no material is called identifiable.",
        {"median_phi": median},
    )


def check_starts(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding where energies have another minimum that explains them alike."""
    minima = [
        (float(f), e.starts.loss, e.starts.other)
        for f, e in zip(evidence.measured.bands.centres_hz, evidence.fits.answers, strict=True)
        if e.starts is not None and e.starts.other is not None
    ]
    if not minima:
        return
    centres_hz, names = [f for f, *_ in minima], evidence.materials
    where = ", ".join(f"{f:g} Hz (log-likelihood lower by {x:.1f})" for f, x, _ in minima)
    yield Finding(
        Code.MULTIPLE_MINIMA_MULTISTART,
        About(bands_hz=centres_hz),
        "Least squares from another start ends in absorptions outside of the intervals that "
        f"explain the energies alike: {where}. Measure more positions, or tell what is known.",
        {
            "bands_hz": centres_hz,
            "other_answer": [
                dict(zip(names, np.round(other, 6).tolist(), strict=True)) for *_, other in minima
            ],
            "log_likelihood_lower_by": [round(x, 3) for _, x, _ in minima],
        },
    )


def check_priors(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding for each material whose answer is nearly its prior, and what was assumed.

    Under the default prior such an answer has a wide interval, which needs no finding.
    """
    bands, priors, answers = evidence.measured.bands, evidence.priors, evidence.fits.answers
    specified, sds = are_specified(priors), prior_logits(priors)[1]
    fitted = np.array([a.model != "prior" for a in answers])
    for i, own in enumerate(priors):
        left = np.array([np.sqrt(a.logit_covariance[i, i]) for a in answers]) / sds[i]
        bad = np.flatnonzero(fitted & (left > _PRIOR_DOMINATED))
        if own.known is None and own.tied_to is None and specified[i] and bad.size:
            shares = [f"{100 * min(left[j], 1.0):.0f} %" for j in bad]
            bands_hz = bands.centres_hz[bad].tolist()
            yield Finding(
                Code.PRIOR_DOMINATED,
                About(materials=[own.name], bands_hz=bands_hz),
                f"The absorption of {own.name} is nearly its prior, of whose standard deviation so "
                f"much is left: {bands_in_words(bands, bad, shares)}. The data add next to "
                "nothing; measure pairs whose sound strikes it more often.",
                {
                    "material": own.name,
                    "bands_hz": bands_hz,
                    "spread_left": [round(float(left[j]), 3) for j in bad],
                },
            )
    yield from broad_prior_findings(priors)
    yield from product_findings(priors)


def check_mirrors(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding with both answers for each symmetry of room and fitted pairs.

    Where both agree within their intervals nothing is ambiguous; bands whose second fit from the
    exchanged answer lost 2 units of log-likelihood are left out.
    """
    measured, absorption = evidence.measured, evidence.absorption
    trials, scene = [b.mirrors for b in evidence.fits.answers], fitted_scene(measured)
    for number, symmetry in enumerate(mirror_symmetries(measured, evidence.priors)):
        other = absorption[symmetry.exchange]
        gains = [t[number].gain if number < len(t) else None for t in trials]
        differs = (other < evidence.lower95) | (other > evidence.upper95)
        differs &= np.array([g is None or g > -UNDECIDED for g in gains])
        if np.any(differs):
            columns = np.flatnonzero(differs.any(axis=0))
            tried = [g for j in columns if (g := gains[j]) is not None]
            apart_m = float(deviation_m(symmetry, scene).max())
            yield _ambiguous(evidence, other, differs, tried, apart_m)


def _ambiguous(
    evidence: Evidence,
    other: FloatArray,
    differs: BoolArray,
    gains: Sequence[float],
    apart_m: float,
) -> Finding:
    """Return that another absorption explains the data as well, where it differs from the answer.

    `gains` are of the log-likelihood, where a second fit began there.
    """
    names, absorption, bands = evidence.materials, evidence.absorption, evidence.measured.bands
    moved, columns = np.flatnonzero(differs.any(axis=1)), np.flatnonzero(differs.any(axis=0))
    whole = differs[np.ix_(moved, columns)].all()  # else they are named one by one
    entries = [(names[i], float(bands.centres_hz[j])) for i, j in np.argwhere(differs)]
    concerned, bands_hz = [names[i] for i in moved], bands.centres_hz[columns].tolist()

    def row(values: FloatArray) -> str:
        return ", ".join(f"{v:.2f}" for v in values[columns])

    listed = "; ".join(f"{names[i]} {row(other[i])} instead of {row(absorption[i])}" for i in moved)
    confirmed = ""
    if gains:
        least, most = min(gains), max(gains)
        between = f"{least:+.1f}" if most - least < 0.05 else f"{least:+.1f} to {most:+.1f}"
        confirmed = (
            f" A second fit that starts there changes the log-likelihood by {between}: "
            "the data do not decide."
        )
    return Finding(
        Code.MIRROR_AMBIGUITY,
        About(concerned, bands_hz, entries=() if whole else entries),
        f"The room is symmetric, and every fitted pair stands within {100 * apart_m:.0f} cm of "
        "that symmetry: a second answer explains the data as well. At "
        f"{bands_in_words(bands, columns)}: {listed}.{confirmed} Measure a pair off the symmetry, "
        "or specify a prior of one of these materials.",
        {
            "materials": concerned,
            "bands_hz": bands_hz,
            "other_answer": {n: x.round(6).tolist() for n, x in zip(names, other, strict=True)},
            "apart_m": apart_m,
            "log_likelihood_change": [round(g, 3) for g in gains],
        },
    )
