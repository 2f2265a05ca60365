"""The uncertainty budget of an absorption: what its standard uncertainty is made of.

By the form of the GUM: of each quantity its value, the contribution of each source, the combined
standard uncertainty, the coverage factor and the expanded uncertainty. Sources are the terms that
an identification states in ``sd_without``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from roomfit.base.arguments import check_known
from roomfit.base.door import complete
from roomfit.base.errors import InputError, located
from roomfit.base.logit import Z95, logit
from roomfit.base.table import Column, Table, Value
from roomfit.files.encoding import ResultFile, path_of
from roomfit.files.results import read_result_content, result_content
from roomfit.result import Result

MEAN = "mean of the room"
REMAINDER = "remainder"
AFTER = "after the fit"

SOURCES: Mapping[str, str] = {
    "interference": "sound paths that interfere within a window",
    "positions": "positions of sources and receivers",
    "rays": "the finite number of rays",
    "noise": "background noise of the recordings",
    "model": "error of the model in each window",
    "ringing": "ringing of the band filters",
    "values": "scatter of measured room parameters",
    "air": "attenuation of sound by the air",
    "scattering": "scattering coefficients, specified or assumed",
    "decay": "the rate of decay of the whole room",
    "lost coherence": "late pressures that add as energies",
    "gain": "levels of sources, fitted along",
    "directivity": "directivity of sources, fitted along",
    "geometry": "positions, speed of sound and delays, fitted along",
    "neighbours": "neighbouring windows, which share information",
    "misfit": "reduced chi-square above 1",
    AFTER: "absorption that changes within the band, and neighbouring bands",
    REMAINDER: "what no term changes by itself; negative where terms overlap",
}
"""The sources in words, those that follow from all others last."""


@dataclass(frozen=True, slots=True, eq=False)
class Budget:
    """What the combined variance of one quantity in one band is made of."""

    quantity: str  # a material, or `MEAN`
    band_hz: float
    value: float  # absorption coefficient
    lower95: float  # the reported coverage interval, which need not be symmetric
    upper95: float
    standard: float  # combined standard uncertainty: half the interval over the coverage factor
    # by source, in squares of absorption coefficients: by how much the combined variance would fall
    # without it, negative where it would rise; `AFTER` and `REMAINDER` make the sum ``standard**2``
    variances: Mapping[str, float]
    without_prior: float  # `standard` without the prior; infinite: nothing would be known


def uncertainty_budget(
    result: Result | ResultFile, bands_hz: Sequence[float] = ()
) -> tuple[Budget, ...]:
    """Return the uncertainty budget of every material and of the room's mean absorption.

    Band by band, materials in the order of the result, the mean last; where no bands are named, of
    500 and 1000 Hz if these were fitted, else of all. Left out: a material of which nothing is
    known, and bands without responses.

    Notes
    -----
    ``sd_without`` is the standard deviation that the answer would have if one term were left out
    and the data weighed as suits the others. Its square, less the whole, is what stands here as
    that term's contribution. These are no independent variances that add up: without one of two
    terms of which each suffices little changes, and what multiplies others (`misfit`,
    `neighbours`) is counted with them. What is missing to the combined variance is therefore a row
    of its own, the remainder. The prior is information and no source [1]_; `without_prior` says
    what it is worth. To first order, in the logit, and carried over by the width of the interval.

    References
    ----------
    .. [1] JCGM 100:2008, "Guide to the expression of uncertainty in measurement", 5.1, 7.2, 8.
    """
    if isinstance(result, Result):
        return _budgets(result_content(result, ()), bands_hz)
    content, _ = read_result_content(result)
    with located(str(path_of(result))), complete("result", "a result.json as roomfit writes it"):
        return _budgets(content, bands_hz)


def _budgets(content: Mapping[str, Any], bands_hz: Sequence[float]) -> tuple[Budget, ...]:
    if "sd_without" not in content:
        raise InputError(
            "the result does not state what its uncertainty is made of",
            found="no sd_without",
            needed="a result from impulse responses, by this version of roomfit",
            hint="identify again; decay times alone have no budget",
        )
    centres_hz = [float(f) for f in content["bands_hz"]]
    for band_hz in bands_hz:
        what, known = "a band of the budget was not fitted", [f"{f:g}" for f in centres_hz]
        check_known(what, f"{band_hz:g}", known, else_try="name fitted bands, or none")
    usual = [f for f in centres_hz if f in (bands_hz or (500.0, 1000.0))] or centres_hz
    found = []
    for band, centre_hz in ((centres_hz.index(f), f) for f in usual):
        terms = content["sd_without"][band]
        for i, (name, material) in enumerate(content["materials"].items() if terms else ()):
            interval = [float(material[key][band]) for key in _INTERVAL]
            if interval[1:] != [0.0, 1.0]:
                low, high = logit(np.array(interval[1:]))
                sd = float(high - low) / (2.0 * Z95)
                if "posterior" in content:
                    sd = float(np.sqrt(content["posterior"]["logit_covariance"][band][i][i]))
                own = {term: sds[i] for term, sds in terms.items()}
                found.append(_budget(name, centre_hz, interval, own, sd))
        of_mean = content.get("mean_sd_without", {band: {}})[band]
        mean = next((c for c in content["combinations"] if c["band_hz"] == centre_hz), None)
        if of_mean and mean is not None:
            interval = [float(mean[key]) for key in _INTERVAL]
            sd = 0.5 * (interval[2] - interval[1]) / Z95
            found.append(_budget(MEAN, centre_hz, interval, of_mean, sd))
    return tuple(found)


_INTERVAL = ("absorption", "lower95", "upper95")


def _budget(
    quantity: str,
    band_hz: float,
    interval: Sequence[float],
    sd_without: Mapping[str, float | None],
    sd: float,
) -> Budget:
    """Return one budget of an absorption with its bounds.

    `sd_without` is of the absorption or its logit ("nothing": with all terms; None: infinite), and
    `sd` of the same as reported, all that came after the fit included.
    """
    value, lower95, upper95 = interval
    standard = (upper95 - lower95) / (2.0 * Z95)
    known = {name: np.inf if x is None else float(x) for name, x in sd_without.items()}
    whole, prior = known.pop("nothing"), known.pop("prior", np.inf)
    scale = standard / sd if sd > 0.0 else 0.0
    variances = {name: scale**2 * (whole**2 - x**2) for name, x in known.items()}
    after = scale**2 * (sd**2 - whole**2)
    variances |= {AFTER: after, REMAINDER: standard**2 - sum(variances.values()) - after}
    without = float(np.sqrt((scale * prior) ** 2 + max(after, 0.0))) if scale > 0.0 else 0.0
    return Budget(quantity, band_hz, value, lower95, upper95, standard, variances, without)


def contribution(variance: float) -> float:
    """Return a contribution in absorption: the root of a variance, with its sign."""
    return float(np.copysign(np.sqrt(abs(variance)), variance))


def share(variance: float, whole: Budget) -> float:
    """Return a variance in percent of the combined variance; 0 where there is none."""
    return 100.0 * variance / whole.standard**2 if whole.standard > 0.0 else 0.0


def budget_records(found: Iterable[Budget]) -> Table:
    """Return the content of budget.csv: a row for each source of each quantity, then the sum."""
    rows: list[Sequence[Value]] = []
    for one in found:
        head = (one.quantity, one.band_hz, one.value)
        for name, part in one.variances.items():
            rows.append((*head, name, contribution(part), share(part, one), SOURCES.get(name, "")))
        expanded = Z95 * one.standard
        law = "95 %, normal" if one.quantity == MEAN else "95 %, normal in the logit"
        interval = f"{one.lower95:.5f} to {one.upper95:.5f}"
        rows += [
            (*head, "combined standard uncertainty", one.standard, None, ""),
            (*head, "coverage factor", Z95, None, law),
            (*head, "expanded uncertainty", expanded, None, f"half of the interval {interval}"),
            (*head, "without the prior", one.without_prior, None, "standard uncertainty"),
        ]
    columns = (
        *("quantity", Column("band_hz"), "absorption", "source", "uncertainty"),
        *(Column("variance_percent", ".1f"), "meaning"),
    )
    return Table("", columns, rows, form=".5f")
