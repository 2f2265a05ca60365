"""Chi-square per degree of freedom, roughness by its evidence, and what is known of the air."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from roomfit.air import Air
from roomfit.impedance import campaign as campaign_module
from roomfit.impedance.fit import _marginal_likelihood_roughness, reduced_chi2


def test_chi_square_is_reduced_by_the_numbers_that_the_data_determined():
    """40 residuals of a variance of 0.75 about a fit of 10 numbers are as good as expected."""
    residual = np.sqrt(0.75) * np.where(np.arange(40) % 2, 1.0, -1.0)
    fit: Any = SimpleNamespace(residual=residual, effective=10.0)
    assert reduced_chi2(fit) == pytest.approx(1.0)
    fit = SimpleNamespace(residual=residual, effective=40.0)
    assert reduced_chi2(fit) == pytest.approx(30.0)


def test_the_roughness_is_the_one_of_the_largest_evidence():
    """Its fixed point beside the maximum of the marginal likelihood of a linear problem."""
    rng = np.random.default_rng(12)
    n = 30
    rows = np.diff(np.eye(n), 2, axis=0)
    truth = np.cumsum(np.cumsum(0.05 * rng.standard_normal(n)))
    data = truth + 0.2 * rng.standard_normal(n)
    information = np.eye(n) / 0.2**2

    def posterior(rough: float):
        normal = information + rows.T @ rows / rough**2
        return normal, np.linalg.solve(normal, information @ data)

    def minus_evidence(log_rough: float) -> float:
        rough = float(np.exp(log_rough))
        normal, x = posterior(rough)
        cost = (data - x) @ information @ (data - x) + np.sum((rows @ x) ** 2) / rough**2
        return 0.5 * cost + 0.5 * np.linalg.slogdet(normal)[1] + len(rows) * np.log(rough)

    best = np.exp(minimize_scalar(minus_evidence, bounds=(-6.0, 1.0), method="bounded").x)
    problem: Any = SimpleNamespace(
        curves=[SimpleNamespace(roughness=rows)], layout=SimpleNamespace(curves=[slice(0, n)])
    )
    rough = np.array([0.3])
    for _ in range(300):
        normal, x = posterior(float(rough[0]))
        found: Any = SimpleNamespace(normal=normal, x=x)
        rough = _marginal_likelihood_roughness(problem, found, rough)
    assert rough[0] == pytest.approx(best, rel=0.01)


@pytest.mark.parametrize(("sd_c", "expected"), [(2.0, 0.5 * 2.0 / 293.15), (0.5, 0.25 / 293.15)])
def test_the_speed_of_sound_is_known_as_well_as_the_temperature(monkeypatch, sd_c, expected):
    monkeypatch.setattr(campaign_module, "_gain", lambda *_: None)
    made = []
    monkeypatch.setattr(campaign_module, "Nuisances", _Recorded(made))
    campaign: Any = SimpleNamespace(
        impedance=_Anything(speed_of_sound="fit"),
        settings=SimpleNamespace(temperature_sd_c=sd_c),
        air=Air(temperature_c=20.0),
    )
    campaign_module._nuisances(campaign, [], [])
    assert made[-1]["speed_sd"] == pytest.approx(expected, rel=1e-3)


class _Anything(SimpleNamespace):
    """A table of a campaign; what is not given is None."""

    def __getattr__(self, _: str) -> None:
        return None


class _Recorded:
    """Stands for a record and keeps what it is made of."""

    def __init__(self, made: list[dict[str, Any]]) -> None:
        self._made = made

    def __call__(self, *values: Any, **named: Any) -> Any:
        from roomfit.impedance.wave_model import Nuisances

        self._made.append(named)
        return Nuisances(*values)
