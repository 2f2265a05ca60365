"""Which scattering was fitted or assumed, and whether walls that are taken for smooth scatter."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from roomfit.base.findings import About, Code, Finding
from roomfit.checks.evidence import Evidence, Law
from roomfit.fit.scattering import GRID

# A coefficient must gain more than this in log-likelihood, and lose less in every band: of nine
# boxes that scatter by .08 or .15 one lost 3.7 in a band; a smooth one lost 5, and gained 22.
_LEAST_GAIN, _LARGEST_LOSS = 5.0, 4.0

_GIVEN = Law("the scattering of every wall is specified", "none")
LAWS = {
    Code.SCATTERING_ASSUMED: _GIVEN,
    Code.SCATTERING_FITTED: _GIVEN,
    Code.SCATTERING_UNDERESTIMATED: Law(
        "walls that are specified as smooth are smooth, and sources radiate as specified",
        "log-likelihood of a scattering of 0.15 over that of 0, by energies",
        0.0067,  # e^-5
    ),
}


def check_chosen(evidence: Evidence) -> Iterator[Finding]:
    """Yield which scattering was assumed, and which was fitted."""
    for chosen in evidence.traced.chosen_scattering:
        names = list(chosen.materials)
        if chosen.is_fitted:
            each = zip(*chosen[:4], strict=True)
            ranges = ", ".join(f"{n} {s:g} ({low:g} to {high:g})" for n, s, low, high in each)
            text = f"Most likely scattering coefficients, of {len(GRID)} values each: {ranges}."
            about = About(materials=names)
            yield Finding(Code.SCATTERING_FITTED, about, text, {"materials": names})
            continue
        value, low, high, reason = chosen.value[0], chosen.lower[0], chosen.upper[0], ""
        if chosen.has_data:
            others = f"{low:g} to {high:g} do as well" if low < high else "others do worse"
            reason = f", which explains the responses well ({others})"
        yield Finding(
            Code.SCATTERING_ASSUMED,
            About(materials=names),
            f"The scattering of {', '.join(names)} is unspecified; {value:g} was assumed{reason}.",
            {"materials": names, "scattering": value},
        )


def check(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding where walls taken for smooth explain the data better if they scatter.

    Where 0.15 gains more than 5 in log-likelihood, all bands together, and no band loses 4, which
    indicates something else than scattering: a loudspeaker that rings, for instance, or sound that
    runs along hard walls.

    Of walls that are smooth, a model that is otherwise right raises the doubt in fewer than one
    room in a hundred: a likelihood ratio has the mean 1 under the model in its denominator, so that
    it exceeds e^5 with a probability below e^-5 (A. Wald, Sequential Analysis, 1947, section 3.2).
    Sources whose directivity was fitted, or that the data contradict, radiate otherwise than in
    both of its models, so that the ratio says nothing.
    """
    trial, fits = evidence.traced.scattering_trial, evidence.fits
    if trial is None or fits.unknown_sources is not None or fits.contradicted:
        return
    gain, names = float(np.sum(trial.gains)), list(trial.materials)
    if gain > _LEAST_GAIN and np.all(trial.gains > -_LARGEST_LOSS):
        yield Finding(
            Code.SCATTERING_UNDERESTIMATED,
            About(materials=names),
            f"The data are explained better if {', '.join(names)} scatter: a coefficient of "
            f"{trial.coefficient:g} raises the log likelihood by {gain:.0f}. Absorption "
            "compensates for scattering that is specified as 0, so that no material is called "
            "identifiable. Specify the scattering of these materials, or have it fitted: "
            'scattering = "fit".',
            {"materials": names, "scattering": trial.coefficient, "gain": gain},
        )
