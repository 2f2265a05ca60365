"""Two results beside each other: what changed, and how often that is said where nothing did."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from roomfit.base.bands import bands_between
from roomfit.base.errors import InputError
from roomfit.base.logit import expit, logit
from roomfit.cli import main
from roomfit.report.comparison import compare_results, comparison_sentences
from roomfit.uncertainty.posterior import AbsorptionPosterior

BANDS = bands_between("octave", 125, 4000)
NAMES = ("brick", "carpet", "curtain", "glass", "tiles", "wood")


def found(absorption, sd=0.1, names=NAMES, bands=BANDS):
    """Return a result with Gaussian intervals of this standard deviation in logit."""
    a = np.broadcast_to(absorption, (len(names), len(bands)))
    x = logit(a)
    low, high = (expit(x - 1.96 * sd), expit(x + 1.96 * sd)) if sd else (a, a)
    covariance = np.broadcast_to(np.eye(len(names)) * sd**2, (len(bands), *2 * (len(names),)))
    return AbsorptionPosterior(names, bands, a, low, high, covariance)


def test_narrow_symmetrical_intervals_give_the_root_of_the_summed_variances():
    """At 2 % of the value logit and its derivative agree to 2 %: d / sd by hand."""
    first, second = found(0.5, 0.02), found(0.52, 0.03)
    compared = compare_results(first, second)
    sds = [0.5 * 0.5 * 0.02, 0.52 * 0.48 * 0.03]
    half = 1.96 * np.hypot(*sds)
    np.testing.assert_allclose(compared.difference[0], 0.02, atol=1e-12)
    np.testing.assert_allclose(compared.difference[1], 0.02 - half, atol=0.02 * half)
    np.testing.assert_allclose(compared.difference[2], 0.02 + half, atol=0.02 * half)
    assert (compared.p_value < 0.05).all() == bool(0.02 / np.hypot(*sds) > 1.96)


def test_exchanging_the_two_turns_every_difference_round():
    rng = np.random.default_rng(4)
    shape = (len(NAMES), len(BANDS))
    first, second = (found(rng.uniform(0.05, 0.9, shape), sd) for sd in (0.2, 0.4))
    there, back = compare_results(first, second), compare_results(second, first)
    np.testing.assert_allclose(there.difference[0], -back.difference[0])
    np.testing.assert_allclose(there.difference[1], -back.difference[2])
    np.testing.assert_allclose(there.p_value, back.p_value)
    assert there.verdicts == back.verdicts


@pytest.mark.parametrize("true", [0.03, 0.2, 0.6])
@pytest.mark.parametrize("sd", [0.1, 0.5])
def test_without_a_change_the_rate_of_false_alarms_is_what_the_page_says(true, sd):
    """400 tables of 36: 5 % singly, 5 % of tables by Holm; bounds of 4 standard deviations.

    Wide intervals of small coefficients are skew: there MOVER may be off by two hundredths.
    """
    rng = np.random.default_rng(7)
    tables = alarms = single = 0
    for _ in range(400):
        trials = [expit(logit(true) + sd * rng.standard_normal((6, 6))) for _ in range(2)]
        verdicts = np.array(compare_results(*(found(t, sd) for t in trials)).verdicts)
        alarms += (verdicts == "changed").any()
        single += (verdicts != "no").sum()
        tables += 1
    rate = single / (36 * tables)
    assert abs(rate - 0.05) < 4.0 * np.sqrt(0.05 * 0.95 / (36 * tables)) + 0.02 * (sd > 0.1)
    assert alarms / tables <= 0.05 + 4.0 * np.sqrt(0.05 * 0.95 / tables)


def test_a_change_of_one_material_is_found_and_of_no_other():
    after = np.full((6, 6), 0.3)
    after[2] = 0.5
    compared = compare_results(found(0.3), found(after))
    assert [set(row) for row in compared.verdicts] == [{"no"}] * 2 + [{"changed"}] + [{"no"}] * 3
    words = " ".join(comparison_sentences(compared))
    assert words.startswith("6 of 36 coefficients changed (*), 0 perhaps (?).")
    assert "5 % of such tables" in words and "on average 1.8 coefficients" in words
    assert "shared errors cancel" in words


def test_what_was_given_is_compared_exactly():
    first, second = found(0.3, 0.0), found(np.where(np.arange(6) == 2, 0.31, 0.3), 0.0)
    compared = compare_results(first, second)
    assert {row[2] for row in compared.verdicts} == {"changed"}
    assert {v for row in compared.verdicts for j, v in enumerate(row) if j != 2} == {"given"}
    assert "of 6 coefficients" in comparison_sentences(compared)[0]
    with pytest.raises(InputError, match="no figure of this answer"):
        compared.plot()


def test_what_only_one_has_is_said_and_the_rest_compared():
    first = found(0.3, names=("brick", "carpet"))
    second = found(0.3, names=("carpet", "panels"), bands=bands_between("octave", 250, 8000))
    compared = compare_results(first, second)
    assert compared.materials == ("carpet",)
    assert compared.centres_hz.tolist() == [250.0, 500.0, 1000.0, 2000.0, 4000.0]
    assert compared.missing == (
        "Only the first result has the material brick.",
        "Only the first result has the band 125 Hz.",
        "Only the second result has the material panels.",
        "Only the second result has the band 8 kHz.",
    )


def test_results_without_anything_in_common_are_refused():
    with pytest.raises(InputError, match="no material in common"):
        compare_results(found(0.3, names=("a",)), found(0.3, names=("b",)))
    with pytest.raises(InputError, match="no band in common"):
        compare_results(found(0.3), found(0.3, bands=bands_between("octave", 8000, 8000)))
    thirds = bands_between("third-octave", 125, 4000)
    with pytest.raises(InputError, match="different width"):
        compare_results(found(0.3), found(0.3, bands=thirds))


def test_the_command_prints_the_table_and_writes_it(tmp_path, capsys):
    heading = "material,band_hz,absorption,lower95,upper95,identifiable\n"
    for name, a in (("before", 0.1), ("after", 0.4)):
        text = f"=wall,500,{a},{a - 0.03},{a + 0.03},true\nfloor,500,0.2,0.1,0.3,true\n"
        (tmp_path / f"{name}.csv").write_text(heading + text)
    files = [str(tmp_path / f"{name}.csv") for name in ("before", "after")]
    main(["compare", *files, "--out", str(tmp_path / "out")])
    printed = capsys.readouterr().out
    assert "+0.300 (+0.258 to +0.342)  *" in printed
    assert "1 of 2 coefficients changed" in printed
    rows = list(csv.DictReader((tmp_path / "out" / "compared.csv").open()))
    assert [row["changed"] for row in rows] == ["changed", "no"]
    # a spreadsheet must not take the name for a formula
    assert rows[0]["material"] == "'=wall"
    assert sorted(f.name for f in (tmp_path / "out").glob("[!.]*")) == ["compared.csv"]
    with pytest.raises(SystemExit):
        main(["compare", *files, "--out", str(tmp_path / "out")])
