"""The uncertainty budget: sources and remainder make the combined variance."""

from __future__ import annotations

import csv
import json
from dataclasses import replace

import numpy as np
import pytest

from report_cases import answer_of, scene_of
from roomfit.base.errors import InputError
from roomfit.base.logit import Z95
from roomfit.base.whole_files import json_text
from roomfit.cli.export import export_result
from roomfit.files.budget import (
    AFTER,
    MEAN,
    REMAINDER,
    budget_records,
    contribution,
    uncertainty_budget,
)
from roomfit.files.results import result_content

TERMS = ("", "noise", "model", "air", "neighbours", "prior")
SMALLER = np.array([1.0, 0.8, 0.5, 1.0, 0.7, np.inf])  # of the whole, by which term is left out


@pytest.fixture(scope="module")
def answer():
    """An answer of three materials, one of them given and one of which nothing is known."""
    scene = scene_of(receivers=("R1", "R2", "R3"))
    made = answer_of(scene)
    rng = np.random.default_rng(3)
    n, m = made.absorption.shape
    whole = rng.uniform(0.1, 0.3, (m, n))
    whole[:, 1] = 0.0
    lower, upper = np.array(made.lower95), np.array(made.upper95)
    lower[1] = upper[1] = made.absorption[1]
    lower[2, 2], upper[2, 2] = 0.0, 1.0
    covariance = np.array([np.diag(1.21 * row**2) for row in whole])
    mean, _, high = made.mean_absorption
    with np.errstate(invalid="ignore"):
        estimates = tuple(
            replace(
                b,
                lower95=lower[:, j],
                upper95=upper[:, j],
                logit_covariance=covariance[j],
                costs={
                    k: np.nan_to_num(f * whole[j], nan=0.0, posinf=np.inf)
                    for k, f in zip(TERMS, SMALLER, strict=True)
                },
                mean_costs={
                    k: 0.8 * f * (high[j] - mean[j]) / Z95
                    for k, f in zip(TERMS, SMALLER, strict=True)
                },
            )
            for j, b in enumerate(made.estimates)
        )
    return scene, replace(made, estimates=estimates)


def test_sources_and_the_remainder_make_the_combined_variance(answer):
    """Of every quantity, and the expanded uncertainty is half of the reported interval."""
    _, result = answer
    found = uncertainty_budget(result, (500.0, 4000.0))
    assert [(one.band_hz, one.quantity) for one in found] == [
        *((500.0, name) for name in ("walls", "floor", MEAN)),  # nothing is known of the ceiling
        *((4000.0, name) for name in ("walls", "floor", "ceiling", MEAN)),
    ]
    for one in found:
        np.testing.assert_allclose(sum(one.variances.values()), one.standard**2, rtol=1e-12)
        assert 2.0 * Z95 * one.standard == pytest.approx(one.upper95 - one.lower95, abs=1e-15)


def test_a_source_counts_by_how_much_the_variance_falls_without_it(answer):
    """In the share of the squares of ``sd_without``; a term that changes nothing counts nothing."""
    _, result = answer
    wall, _, _, mean = uncertainty_budget(result, [1000.0])
    # after the fit the standard deviation was 1.1 times as large; of the mean 1.25 times
    for one, wider in ((wall, 1.1), (mean, 1.25)):
        whole = (one.standard / wider) ** 2
        assert one.variances["air"] == 0.0
        # four digits of the logit's standard deviation, .1 to .3, are written
        for name, smaller in (("noise", 0.8), ("model", 0.5), ("neighbours", 0.7)):
            share = one.variances[name] / whole
            assert share == pytest.approx(1.0 - smaller**2, abs=2e-3)
        assert one.variances[AFTER] / whole == pytest.approx(wider**2 - 1.0, abs=2e-3)
        # these terms overlap: .36 + .75 + .51 is more than the whole
        assert one.variances[REMAINDER] / whole == pytest.approx(-0.62, abs=3e-3)
        assert one.without_prior == np.inf


def test_an_absorption_that_was_given_has_no_uncertainty(answer):
    _, result = answer
    floor = uncertainty_budget(result, [1000.0])[1]
    assert floor.quantity == "floor"
    assert floor.standard == floor.without_prior == 0.0
    assert set(floor.variances.values()) == {0.0}


def test_the_table_of_a_file_is_that_of_the_result_in_memory(answer, tmp_path):
    """500 and 1000 Hz; a row for each source, then sum, factor, expansion and prior."""
    _, result = answer
    file, out = tmp_path / "result.json", tmp_path / "budget.csv"
    file.write_text(json_text(result_content(result, ())))
    export_result(file, "budget", out)
    rows = list(csv.DictReader(out.open(encoding="utf-8")))
    assert {float(r["band_hz"]) for r in rows} == {500.0, 1000.0}
    own = {r["source"]: r for r in rows if (r["quantity"], r["band_hz"]) == ("walls", "1000")}
    one = uncertainty_budget(result)[3]
    for name, part in one.variances.items():
        assert float(own[name]["uncertainty"]) == pytest.approx(contribution(part), abs=6e-6)
    assert float(own["combined standard uncertainty"]["uncertainty"]) == pytest.approx(
        one.standard, abs=6e-6
    )
    assert float(own["coverage factor"]["uncertainty"]) == pytest.approx(1.96, abs=1e-3)
    assert float(own["expanded uncertainty"]["uncertainty"]) == pytest.approx(
        0.5 * (one.upper95 - one.lower95), abs=6e-6
    )
    assert own["without the prior"]["uncertainty"] == ""
    # the interval of a mean is symmetric in absorption, that of a wall in the logit
    laws = {r["quantity"]: r["meaning"] for r in rows if r["source"] == "coverage factor"}
    assert laws["walls"] == "95 %, normal in the logit" and laws[MEAN] == "95 %, normal"
    shares = [float(own[name]["variance_percent"]) for name in one.variances]
    assert sum(shares) == pytest.approx(100.0, abs=0.4)
    assert len(budget_records(uncertainty_budget(result)).rows) == len(rows)


def without_costs(result):
    none = tuple(replace(b, costs={}, mean_costs={}) for b in result.estimates)
    return replace(result, estimates=none)


def test_what_has_no_budget_says_why(answer, tmp_path):
    _, result = answer
    with pytest.raises(InputError, match="does not state what its uncertainty is made of"):
        uncertainty_budget(without_costs(result))
    with pytest.raises(InputError, match="band of the budget was not fitted"):
        uncertainty_budget(result, [630.0])
    file = tmp_path / "result.json"
    file.write_text(json.dumps({"format": "other"}))
    with pytest.raises(InputError, match="this is no result of roomfit"):
        uncertainty_budget(file)
