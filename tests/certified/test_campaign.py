"""``method = "certified"`` in a campaign: what is proven, specified and refused."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import roomfit
from roomfit.bands import Bands
from roomfit.certified.certificate import (
    affordable_certificate,
    certified_fit,
    tracing_delta,
)
from roomfit.certified.convex import total_misfit
from roomfit.certified.question import energy_global_problem, free_vector
from roomfit.certified.search import tools_for
from roomfit.findings import Code
from roomfit.io.inputs import identify_arguments
from roomfit.objective.energy import EnergyTerm
from roomfit.objective.parameters import physical_values, prior_residuals, start_vector
from roomfit.report.text import certificate_text
from roomfit.solvers.certificate import Certificate, certificate_findings
from roomfit.solvers.ending import Ending
from roomfit.solvers.least_squares import fit_band
from small_campaign import write_campaign

# one band, and one material known, so that two absorptions and a gain are left
CHANGES = (
    ("to_hz = 1000", 'to_hz = 500\nmethod = "certified"'),
    ("[materials.tiles]\n", "[materials.tiles]\nabsorption = 0.3\n"),
)


@pytest.fixture(scope="module")
def certified(tmp_path_factory: pytest.TempPathFactory) -> tuple[roomfit.Result, list[Any]]:
    """The small campaign certified in one band, with its problem."""
    problems: list[Any] = []

    def watched(problem: Any, *args: Any, **more: Any) -> Any:
        problems.append(problem)
        return certified_fit(problem, *args, **more)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("roomfit.certified.certificate.certified_fit", watched)
        path = write_campaign(tmp_path_factory.mktemp("certified"), *CHANGES)
        answer = roomfit.identify(**roomfit.load_campaign(path))
    return answer, problems


def test_a_campaign_is_certified(certified: tuple[roomfit.Result, list[Any]]) -> None:
    """The answer is the certified minimiser, within a fifth of its interval."""
    answer, _ = certified
    assert answer.method == "certified"
    assert answer.model == "energy"
    (proof,) = answer.certificates
    assert isinstance(proof, Certificate)
    assert proof.status == "certified"
    assert proof.coordinates == ("walls", "carpet", "gain of LS1")
    best = proof.clusters[0].minimiser[:2]
    width = (answer.upper95 - answer.lower95)[:2, 0]
    assert np.all(np.abs(best - answer.absorption[:2, 0]) < 0.2 * width)
    assert proof.lower_bound <= answer.cost <= proof.value + proof.delta


def test_the_question_is_the_cost_of_the_fit(certified: tuple[roomfit.Result, list[Any]]) -> None:
    """Its rows merged and smeared, against residuals and priors by the fit's own prediction."""
    (problem,) = certified[1]
    fit = fit_band(problem)
    (energies,), parameters = problem.terms, problem.parameters
    global_problem = energy_global_problem(energies, parameters, fit.vector)
    tools = tools_for(global_problem)
    spread = problem.variance(fit.vector) * problem.correlation_length()
    rng = np.random.default_rng(3)
    for _ in range(20):
        vector = fit.vector + rng.normal(0.0, 0.7, fit.vector.size)
        values, _ = physical_values(problem.parameters, vector)
        g = np.concatenate((np.log1p(-values["absorption"][:2]), np.log(values["gain"])))
        off = problem.predict(vector).expected - problem.measured()
        prior, _ = prior_residuals(problem.parameters, vector)
        expected = 0.5 * float(np.sum(off**2 / spread) + prior @ prior)
        # shares below the rounding of their table, 1e-16 of one, are cut at 0
        assert total_misfit(tools.data, g, tools.most) == pytest.approx(expected, rel=1e-9)
        place = np.concatenate((values["absorption"][:2], values["gain"]))
        np.testing.assert_allclose(free_vector(parameters, place), vector, atol=1e-8)


def test_delta_is_what_other_rays_change(certified: tuple[roomfit.Result, list[Any]]) -> None:
    """Louder rays have louder noise; image sources alone have none, and the least delta is left."""
    (problem,) = certified[1]
    (energies,) = problem.terms
    fit = fit_band(problem)
    precision = 0.5 / (problem.variance(fit.vector) * problem.correlation_length())
    louder = tuple(
        replace(rows, weight_per_m2=np.where(rows.batch >= 0, 30.0, 1.0) * rows.weight_per_m2)
        for rows in energies.rows
    )
    noisy = replace(energies, rows=louder)
    before = tracing_delta(energies, problem.parameters, fit.vector, precision)
    after = tracing_delta(noisy, problem.parameters, fit.vector, precision)
    silent = tuple(
        replace(rows, n_batches=0, batch=np.full_like(rows.batch, -1)) for rows in energies.rows
    )
    assert (
        tracing_delta(replace(energies, rows=silent), problem.parameters, fit.vector, precision)
        == 0.02
    )
    assert after > before >= 0.02


def test_a_certificate_stands_in_the_result_file(
    certified: tuple[roomfit.Result, list[Any]], tmp_path: Path
) -> None:
    """Every key of the contract, and numbers that JSON can hold."""
    answer, _ = certified
    campaign = write_campaign(tmp_path / "in", *CHANGES)
    roomfit.write_result(tmp_path, answer, (campaign,))
    content = json.loads((tmp_path / "result.json").read_text())
    proof = content["fit"]["certified"]
    (band,) = proof["bands"]
    assert band["band_hz"] == 500.0
    assert band["value"] == proof["value"] >= proof["lower_bound"]
    wanted = {"status", "value", "lower_bound", "delta", "clusters", "boxes", "seconds"}
    assert wanted <= set(proof)
    for cluster in proof["clusters"]:
        assert set(cluster) == {"band_hz", "lower", "upper", "minimiser", "value", "unique"}
        assert len(cluster["minimiser"]) == len(band["unknowns"])
        assert np.all(np.array(cluster["lower"]) <= np.array(cluster["upper"]))


@pytest.mark.slow
def test_auto_proves_what_is_affordable(tmp_path: Path) -> None:
    """Two materials and a gain: energies are certified, and the answer's distance is reported."""
    changes = (("to_hz = 1000", 'to_hz = 500\nmodel = "energy"'), *CHANGES[1:])
    path = write_campaign(tmp_path / "in", *changes)
    answer = roomfit.identify(**roomfit.load_campaign(path))
    assert answer.method == "least-squares"
    roomfit.write_result(tmp_path, answer, (path,))
    proof = json.loads((tmp_path / "result.json").read_text())["fit"]["certified"]
    assert proof["status"] == "certified"
    assert "energies" in proof["objective"]
    (band,) = proof["bands"]
    assert band["delta"] >= 0.25
    best = np.array(proof["clusters"][0]["minimiser"][:2])
    assert band["distance"] == pytest.approx(np.max(np.abs(best - answer.absorption[:2, 0])))
    assert band["distance"] < 0.2 * np.max((answer.upper95 - answer.lower95)[:2])


def test_nobody_waits_for_a_proof_of_many_unknowns(
    certified: tuple[roomfit.Result, list[Any]],
) -> None:
    """More unknowns than three, or another kind of data: no proof, and no search."""
    (problem,) = certified[1]
    fit = fit_band(problem)
    assert affordable_certificate(problem, fit.vector) is not None
    assert affordable_certificate(problem, np.zeros(4)) is None
    assert affordable_certificate(replace(problem, terms=problem.terms * 2), fit.vector) is None


def test_certificates_of_pressures_and_room_parameters_are_refused(tmp_path: Path) -> None:
    """Told at once, before anything is traced."""
    change = ("to_hz = 1000", 'to_hz = 500\nmethod = "certified"\nmodel = "coherent"')
    campaign = roomfit.read_campaign(write_campaign(tmp_path, change))
    with pytest.raises(roomfit.InputError, match="a certificate exists for energies"):
        roomfit.identify(**identify_arguments(campaign))


def test_what_is_too_large_or_no_energy_is_refused(
    certified: tuple[roomfit.Result, list[Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows above the limit; a problem of another kind."""
    (problem,) = certified[1]
    with monkeypatch.context() as patch:
        patch.setattr("roomfit.certified.certificate.MOST_ROWS", 5)
        with pytest.raises(roomfit.InputError, match="too many rows"):
            certified_fit(problem)
    with pytest.raises(roomfit.InputError, match="only energies"):
        certified_fit(replace(problem, terms=problem.terms * 2))
    assert isinstance(problem.terms[0], EnergyTerm)


def test_open_searches_and_several_answers_are_findings(
    certified: tuple[roomfit.Result, list[Any]],
) -> None:
    """One code each, with the band; nothing where all is proven."""
    (proof,) = certified[0].certificates
    assert proof is not None
    bands = Bands("octave", np.array([500.0]))
    (cluster, *_) = proof.clusters
    clean = replace(proof, clusters=(cluster,))
    assert certificate_findings(bands, [clean]) == ()
    assert certificate_findings(bands, [None]) == ()
    stopped = replace(clean, status="stopped", lower_bound=clean.value - 1.0)
    assert [f.code for f in certificate_findings(bands, [stopped])] == [Code.NOT_CERTIFIED]
    two = replace(proof, clusters=(cluster, cluster))
    reported = certificate_text(replace(certified[0], certificates=(two,)))
    assert proof.sentence in reported
    assert reported.count("gain of LS1") == 2
    assert [f.code for f in certificate_findings(bands, [two])] == [Code.MULTIPLE_MINIMA_CERTIFIED]


def test_an_identification_loads_the_global_search_only_where_it_is_asked_for() -> None:
    """No module that a fit imports imports it."""
    code = (
        "import sys, roomfit.identification; "
        "print([m for m in sys.modules if m.startswith('roomfit.certified')])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_fit_above_the_proven_minimum_starts_again_from_there(
    certified: tuple[roomfit.Result, list[Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that ended 5 too high: its evaluations count, and the end is where the proof says."""
    (problem,) = certified[1]
    right, given, done = fit_band(problem), list[Any](), list[float]()
    ends: list[Any] = []

    def fitted(objective: Any, *solver: Any) -> Any:
        given.append(solver)
        if not solver:
            return replace(right, cost=right.cost + 5.0, evaluations=1000)
        ends.append(fit_band(objective, *solver))
        return ends[-1]

    monkeypatch.setattr("roomfit.certified.certificate.fit_band", fitted)
    proven = certified[0].certificates[0]
    monkeypatch.setattr("roomfit.certified.certificate.certify", lambda *_: proven)
    found, proof = certified_fit(problem, progress=done.append)
    assert [len(solver) for solver in given] == [0, 1] and done == [0.5, 1.0]
    assert proof is proven
    np.testing.assert_allclose(found.vector, right.vector, atol=0.02)
    assert found.evaluations == 1000 + ends[0].evaluations > 1000
    ((solver,),) = given[1:]
    stays = solver(lambda x: (3.0 * x, np.zeros(0)), np.zeros(found.vector.size))
    np.testing.assert_allclose(stays.x, found.vector, atol=0.02)
    assert stays.cost == pytest.approx(4.5 * float(stays.x @ stays.x))
    assert (stays.evaluations, stays.ending) == (1, Ending.CONVERGED)


def test_gains_are_searched_within_a_factor_of_e_cubed_and_absorptions_within_their_bounds(
    certified: tuple[roomfit.Result, list[Any]],
) -> None:
    """The prior's columns are weight, mean, and one less both bounds of the absorption."""
    (problem,) = certified[1]
    (energies,), parameters = problem.terms, problem.parameters
    asked = energy_global_problem(energies, parameters, start_vector(parameters))
    absorption, gain = (next(b for b in parameters.blocks if b.name == n)
                        for n in ("absorption", "gain"))  # fmt: skip
    own = np.flatnonzero(absorption.fitted)
    middle = np.log(gain.start[gain.fitted])
    n = own.size
    assert n == 2 and asked.is_absorption.tolist() == [True, True, False]
    np.testing.assert_allclose(asked.least[n:], middle - 3.0)
    np.testing.assert_allclose(asked.most[n:], middle + 3.0)
    np.testing.assert_allclose(np.exp(asked.most[:n]), 1.0 - absorption.lower[own])
    np.testing.assert_allclose(np.exp(asked.least[:n]), 1.0 - absorption.upper[own], atol=1e-12)
    sd, mean = absorption.prior_sd[own], absorption.prior_mean[own]
    bounds = 1.0 - absorption.lower[own], 1.0 - absorption.upper[own]
    np.testing.assert_allclose(asked.prior[:n], np.stack((0.5 / sd**2, mean, *bounds), axis=1))
    assert not asked.prior[n:].any()
    # what a gain multiplies are all rows but those of the noise, which have no hits
    noise = ~asked.exponents.any(axis=1)
    assert np.all(asked.exponents[~noise, n] == 1)
