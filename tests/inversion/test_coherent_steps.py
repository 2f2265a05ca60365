"""What the steps of a fit of pressures are handed, and what they say on the way."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from roomfit.air import Air, speed_of_sound_m_s
from roomfit.bands import bands_between
from roomfit.inversion import coherent

BANDS = bands_between("octave", 250, 1000)


def response(pair: int, use: str = "fit") -> SimpleNamespace:
    return SimpleNamespace(pair=pair, measurement=SimpleNamespace(use=use))


def test_images_reach_five_periods_of_the_lowest_band_beyond_what_is_added(monkeypatch):
    """Of the pairs that are fitted."""
    monkeypatch.setattr(coherent, "image_paths", lambda *arguments: arguments)
    task = SimpleNamespace(
        measured=(response(4), response(2, "validate"), response(1)),
        settings=SimpleNamespace(end_s=0.2), bands=BANDS, scene=SimpleNamespace(air=Air()),
    )  # fmt: skip
    paths, pairs, first_m, last_m = coherent._images(SimpleNamespace(task=task, paths="paths"))
    assert paths == "paths" and pairs.tolist() == [4, 1] and first_m == 0.0
    reach_s = 0.2 + 5.0 / 250.0
    assert last_m == pytest.approx(speed_of_sound_m_s(Air()) * reach_s)


def test_a_first_answer_is_logged_in_percent_by_the_likelier_model_of_each_band(
    monkeypatch, caplog
):
    """A band without data has no column; where neither is known to be likelier, pressures."""
    low = {"p": 0.0, "q": 0.1, "r": 0.2}

    def intervals(parameters, vector, information, chi2):
        assert (vector, information, chi2) == (f"v{parameters}", f"i{parameters}", f"c{parameters}")
        a = np.array([0.234, 0.51]) + low[parameters[0]]
        return SimpleNamespace(absorption=a, lower95=a - 0.1, upper95=a + 0.3)

    def fit_of(name):
        return SimpleNamespace(vector=f"v{name}", information=f"i{name}", chi2_reduced=f"c{name}")

    energies = [SimpleNamespace(parameters=n) for n in "pq"]
    bands = (
        *(SimpleNamespace(energies=e, energy_fit=fit_of(e.parameters)) for e in energies),
        None,
    )
    fits = (SimpleNamespace(parameters="r", fit=fit_of("r")),) * 2 + (None,)
    monkeypatch.setattr(coherent, "absorption_intervals", intervals)
    evidence = {"p": (1.0, 0.9), "q": (1.0, 1.0)}
    monkeypatch.setattr(coherent, "log_evidences", lambda own, _: evidence[own.energies.parameters])
    priors = [SimpleNamespace(name=n) for n in ("wood", "a name of very many letters")]
    task = SimpleNamespace(bands=BANDS, priors=priors)
    with caplog.at_level(coherent._NOTICE, logger="roomfit"):
        coherent._log_first_answer(SimpleNamespace(task=task, bands=bands), fits)
    lines = [r.getMessage() for r in caplog.records]
    assert lines[0] == "so far, absorption in % and its 95 % interval; not yet examined:"
    assert lines[1].split() == ["250", "Hz", "500", "Hz"]
    assert lines[2] == "wood            " + "  23 (13-53)" + "  43 (33-73)"
    assert lines[3] == "a name of very m" + "  51 (41-81)" + " 71 (61-101)"
    caplog.clear()
    with caplog.at_level(logging.CRITICAL, logger="roomfit"):
        coherent._log_first_answer(SimpleNamespace(task=task, bands=bands), fits)
    assert not caplog.records


@dataclass(frozen=True)
class Problem:
    """An objective, of which windows, directivity and other data are kept."""

    own: object
    inflation: object = None
    parameters: str = "parameters"

    def measured(self) -> np.ndarray:
        return np.zeros(9)


@pytest.mark.parametrize("is_inflated", [True, False])
def test_energies_are_fitted_where_pressures_do_not_decide_with_the_factors_of_their_files(
    monkeypatch, is_inflated
):
    """The first factor of a file's fine windows is that of all of its windows."""
    inflation = np.array([1.0, 1.0, 5.0, 5.0, 5.0, 2.0]) if is_inflated else None

    @dataclass(frozen=True)
    class Rows:
        made_of: object
        unknown: object = None

    sizes = [SimpleNamespace(energy=np.zeros(k)) for k in (2, 3, 1)]
    own = SimpleNamespace(
        directivity=SimpleNamespace(unknown="of the band"),
        energies=SimpleNamespace(inflation=inflation),
        coherent=SimpleNamespace(energies=SimpleNamespace(observations=sizes)),
    )
    task = SimpleNamespace(
        scene=SimpleNamespace(room="room"), bands=BANDS, priors="priors", measured="measured",
        start="start", others="abc", directivity_parameters="unknown",
        settings=SimpleNamespace(model="auto", max_rounds=7),
    )  # fmt: skip
    state = SimpleNamespace(task=task, bands=(own, None, own), paths="paths", binned="binned")
    given = {
        "material_areas_m2": lambda room: ("areas", room),
        "row_bases": lambda *arguments: arguments,
        "energy_term": lambda *arguments: None if arguments[-1] == 1 else (arguments, "block"),
        "fitted_in_band": lambda *_: ["x", "y", "z"],
        "directed_band": lambda *arguments: Rows(arguments),
        "energy_objective": lambda *arguments: Problem(arguments),
        "variance_inflation": lambda _w, files, outliers, n: (tuple(files), outliers, n),
        "fit_band": lambda objective, max_rounds: ("fit", objective, max_rounds),
        "_relative_errors": lambda *arguments: ("relative", arguments),
        "_sources": lambda _task, number: ("sources", number),
        "shared_errors": lambda *arguments: ("shared", arguments),
        "with_shared_errors": lambda *arguments, areas_m2: ("noisy", arguments, areas_m2),
        "band_estimate": lambda *arguments: arguments,
        "FittedBand": lambda *arguments: arguments,
    }
    for name, function in given.items():
        monkeypatch.setattr(coherent, name, function)
    evidences = np.array([[0.0, 1.9], [0.0, 0.0], [0.0, 2.0]])
    fit = SimpleNamespace(state=state, fits=("some",) * 3, log_evidences=evidences)
    estimate = coherent.energy_estimates(fit)
    assert estimate(1) is None and estimate(2) is None
    answer, objective, own_fit = estimate(0)
    windows = (task.scene, BANDS, "priors", "measured", "binned", "start", 0)
    bases = ("unknown", task.scene, "paths", "binned")
    rows = Rows(("unknown", task.scene, bases, windows, ["x", "y", "z"]), "of the band")
    assert objective.own == (windows, "block", rows, "a")
    factors = {"x": 1.0, "y": 5.0, "z": 2.0}
    assert objective.inflation == ((("x", "y", "z"), factors, 9) if is_inflated else None)
    assert own_fit == ("fit", objective, 7)
    relative = ("relative", (state, objective, own_fit, windows))
    shared = ("shared", (objective, own_fit, ("sources", 0), relative))
    noisy = ("noisy", (objective, own_fit, shared), ("areas", "room"))
    assert answer == ("parameters", noisy, "energy")
    task.settings.model = "coherent"
    assert coherent.energy_estimates(fit)(0) is None
    fit.fits = (None, "some", "some")
    assert coherent.energy_estimates(fit)(0) is not None


def test_absorption_is_by_pressures_where_these_were_fitted_else_by_energies_else_the_start(
    monkeypatch,
):
    monkeypatch.setattr(
        coherent, "physical_values", lambda shift, vector: ({"absorption": vector + shift}, None)
    )

    def band(x: float) -> SimpleNamespace:
        fit = SimpleNamespace(vector=np.array([x, 2.0 * x]))
        return SimpleNamespace(energies=SimpleNamespace(parameters=0.5), energy_fit=fit)

    task = SimpleNamespace(start=np.array([0.1, 0.2, 0.3]), priors=("a", "b"))
    state = SimpleNamespace(task=task, bands=(None, band(1.0), band(3.0)))
    energies = [[0.1, 1.5, 3.5], [0.1, 2.5, 6.5]]
    np.testing.assert_allclose(coherent.current_absorption(state), energies)
    fits = (None, None, SimpleNamespace(parameters=0.25, fit=SimpleNamespace(vector=np.ones(2))))
    found = coherent.current_absorption(state, fits)
    np.testing.assert_allclose(found, [[0.1, 1.5, 1.25], [0.1, 2.5, 1.25]])
