"""What is chosen of curves, laws and verdicts, by made-up numbers on both sides of each limit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from roomfit.errors import InputError
from roomfit.findings import Code
from roomfit.impedance import diagnostics, wave_model
from roomfit.impedance import fit as fits
from roomfit.impedance.data import Observed
from roomfit.impedance.diagnostics import _chi2_by_octave, _fits, data_findings
from roomfit.impedance.fit import Start, WallModel, multistart, with_laws
from roomfit.impedance.laws import (
    LAWS,
    CausalCurve,
    as_spline,
    causal_curve,
    constant,
    law_curve,
    miki_material,
    spline,
)
from roomfit.impedance.wave_model import Nuisances
from simulated_rooms.impedance_box import box_scene


def damped(f: Any, tau_s: float = 0.01) -> Any:
    return np.asarray(f, dtype=float) - 0.5j / (np.pi * tau_s)


def test_a_material_by_miki_has_his_numbers_at_one_and_his_powers_elsewhere():
    own, wave = miki_material(np.array([1.0 + 0j, 0.1, 0.01]))
    assert own[0] == 1.070 - 0.107j and wave[0] == 1.109 - 0.160j
    np.testing.assert_allclose((own[1:] - 1.0) / (own[0] - 1.0), 10.0 ** np.array([0.632, 1.264]))
    np.testing.assert_allclose((wave[1:] - 1.0) / (wave[0] - 1.0), 10.0 ** np.array([0.618, 1.236]))


@pytest.mark.parametrize(
    ("low", "high", "n"),
    # every quarter octave, but 25 Hz apart: 100, 125, 150, 178, 212, ..., 504
    [(400.0, 1500.0, 9), (100.0, 500.0, 10), (50.0, 150.0, 5)],
)
def test_a_spline_has_knots_a_quarter_octave_or_25_hz_apart_and_adds_to_one(low, high, n):
    """Two functions more than knots; no second difference of what is straight."""
    f = np.arange(low, high + 1.0, 5.0)
    curve = spline(f, 0.3 - 0.4j)
    assert curve.basis.shape == (f.size, n + 2)
    np.testing.assert_allclose(curve.basis.sum(axis=1), 1.0, rtol=1e-12)
    np.testing.assert_allclose(curve.r0(curve.start), 0.3 - 0.4j, rtol=1e-12)
    line = np.arange(n + 2.0)
    assert curve.roughness.shape == (2 * n, 2 * n + 4)
    np.testing.assert_allclose(curve.roughness @ np.tile(line, 2), 0.0, atol=1e-12)
    bent = np.zeros(2 * n + 4)
    bent[3] = 1.0
    assert sorted(curve.roughness[:n] @ bent)[:2] == [-2.0, 0.0] and not np.any(
        curve.roughness[n:] @ bent
    )
    # where it must be passive: at the frequencies, and at eight points a knot besides
    dense, slope = curve.between(curve.start)
    assert len(dense) == f.size + 8 * n and slope.shape == (len(dense), 2 * n + 4)
    np.testing.assert_allclose(dense, 0.3 - 0.4j, rtol=1e-12)
    level = constant(f, 0.2 + 0.1j)
    np.testing.assert_allclose(level.r0(level.start), 0.2 + 0.1j)
    assert level.kind == "constant" and level.basis.shape == (f.size, 1)
    assert level.roughness.shape == (0, 2)


@pytest.mark.parametrize("f", [np.arange(100.0, 1001.0, 25.0), np.array([100.0, 200, 400, 800])])
def test_a_density_reaches_three_octaves_beyond_the_data_by_two_knots_an_octave(f):
    """Coefficients of a straight line are its abscissae; of few frequencies fewer knots."""
    curve = causal_curve(damped(f))
    assert isinstance(curve, CausalCurve)
    free = spline(f)
    n_inner = free.basis.shape[1] - 2
    at = curve.log_coefficients
    assert len(at) == n_inner + 12 + 2
    middle = 0.5 * np.log(f[0] * f[-1])
    assert at[0] == pytest.approx(np.log(f[0] / 8.0) - middle)
    assert at[-1] == pytest.approx(np.log(f[-1] * 8.0) - middle)
    half = 0.5 * np.log(2.0)
    np.testing.assert_allclose(np.diff(at[2:6]), half)
    np.testing.assert_allclose(curve.density.sum(axis=1), 1.0, rtol=1e-12)
    np.testing.assert_allclose(
        curve.roughness[:, : len(at)], np.diff(np.eye(len(at)), 2, axis=0), atol=0
    )
    assert not curve.roughness[:, len(at) :].any()
    assert as_spline(curve).basis is curve.basis and as_spline(free) is free
    # at 0.03 of a unit the factor departs by a thousandth
    x = curve.start
    n = len(at)
    x[n : n + free.basis.shape[1]] += 1.0
    y = [(1.0 - r) / (1.0 + r) for r in (curve.r0(curve.start), curve.r0(x))]
    np.testing.assert_allclose(y[1] / y[0], np.exp(0.03), rtol=1e-9)
    turned = curve.start
    turned[n + free.basis.shape[1] :] += 1.0
    there = curve.r0(turned)
    np.testing.assert_allclose((1.0 - there) / (1.0 + there) / y[0], np.exp(0.03j), rtol=1e-9)


@dataclass
class Kept:
    """A fit as far as choices of laws look at it."""

    curves: tuple[Any, ...]
    effective: float
    residual: Any


def test_a_law_that_is_specified_is_fitted_and_of_auto_the_nearest_where_it_pays(monkeypatch):
    """Up to a misfit of 30; it must save numbers worth log n each."""
    residual = np.ones(100)
    before = Kept(("a", "b", "c"), 20.0, residual)
    asked = []

    def nearest(_fit, i, kinds, _wall, _rng):
        asked.append((i, tuple(kinds)))
        return f"law {i}", misfits[i]

    def replaced(fit, curves):
        own = tuple(curves.get(i, c) for i, c in enumerate(fit.curves))
        return Kept(own, fit.effective - 2.0 * len(curves), grown * fit.residual)

    monkeypatch.setattr(fits, "_nearest_law", nearest)
    monkeypatch.setattr(fits, "_replaced", replaced)
    walls = {"A": WallModel("miki"), "B": WallModel("spline"), "C": WallModel("auto")}
    rng = np.random.default_rng(1)
    # 2 log(100) = 9.21 is what two numbers are worth
    for misfit, squares, curve in ((30.0, 9.2, "law 2"), (30.1, 0.0, "c"), (1.0, 9.22, "c")):
        misfits, asked[:] = {0: 99.0, 2: misfit}, []
        grown = 1.0
        first = replaced(before, {0: "law 0"})
        grown = np.sqrt(1.0 + squares / 100.0)

        def once(fit, curves, first=first):
            return first if fit is before else replaced(fit, curves)

        monkeypatch.setattr(fits, "_replaced", once)
        found = with_laws(before, walls, rng)
        assert found.curves == ("law 0", "b", curve)
        assert asked == [(0, ("miki",)), (2, ("constant", *LAWS))]
        monkeypatch.setattr(fits, "_replaced", replaced)
    assert with_laws(before, {"A": WallModel(), "B": WallModel()}, rng) is before


def test_random_starts_are_even_over_the_disc_and_laws_begin_about_their_own():
    """Of |R0| = .95 at most: its square is even; a law's numbers are normal about its start."""
    rng = np.random.default_rng(2)
    curve = spline(np.arange(200.0, 401.0, 20.0))
    drawn = np.array([curve.r0(fits._random_start(curve, rng))[0] for _ in range(2000)])
    share = np.abs(drawn / 0.95) ** 2
    assert share.max() <= 1.0 and share.mean() == pytest.approx(0.5, abs=5 * 0.29 / 2000**0.5)
    assert abs(np.mean(drawn / np.abs(drawn))) < 5.0 * 0.7 / 2000**0.5
    law = law_curve("panel", damped([200.0, 300.0]), 343.0)
    off = np.array([fits._random_start(law, rng) - law.start for _ in range(2000)])
    np.testing.assert_allclose(off.mean(axis=0), 0.0, atol=5.0 / 2000**0.5)
    np.testing.assert_allclose(off.std(axis=0), 1.0, rtol=5.0 / 4000**0.5)


def test_starts_come_lowest_first_and_the_first_is_that_of_the_curves(monkeypatch):
    """Each random one for every material; progress by how many are done."""
    f = np.arange(200.0, 401.0, 20.0)
    curves = (spline(f), spline(f, 0.5))
    n = len(curves[0].start)
    layout = SimpleNamespace(curves=(slice(0, n), slice(n, 2 * n)))
    thin = SimpleNamespace(layout=layout, curves=curves)
    monkeypatch.setattr(fits, "thinned", lambda _: thin)
    monkeypatch.setattr(fits, "start_of", lambda _: np.concatenate([c.start for c in curves]))
    monkeypatch.setattr(fits, "r0_of", lambda _, x: x)
    begun: list[Any] = []

    def led(_problem, x, gain):
        begun.append(np.array(x))
        return SimpleNamespace(x=x, cost=float((3, 1, 2)[len(begun) - 1]), gain=gain)

    monkeypatch.setattr(fits, "continuation", led)
    done: list[float] = []
    found = multistart(SimpleNamespace(), 2, np.random.default_rng(3), done.append)
    np.testing.assert_array_equal(begun[0], np.concatenate([c.start for c in curves]))
    assert np.all(begun[1] != begun[0]) and np.all(begun[2] != begun[1])
    assert not np.allclose(begun[1][:n], begun[1][n:])
    assert [s.cost for s in found] == [1.0, 2.0, 3.0]
    assert found[2].x is not None and np.array_equal(found[2].x, begun[0])
    np.testing.assert_allclose(done, [1 / 3, 2 / 3, 1.0])
    far = Start(np.zeros(1), np.array([[0.0, 0.02]]), 1.0)
    near = replace_start(far, 0.0141)
    assert fits.distance(far.r0, near.r0) == pytest.approx(0.0141)
    assert fits.distinct((far, near)) == (far, near)
    assert fits.distinct((far, replace_start(far, 0.0099))) == (far,)


def replace_start(start: Start, by: float) -> Start:
    return start._replace(r0=start.r0 + by)


def fit_of(f: Any, squares: Any, effective: float = 0.0) -> Any:
    """Return a fit of one pair whose mean square residual at each frequency is given."""
    residual = np.sqrt(np.tile(np.asarray(squares, dtype=float), 2))
    observed = SimpleNamespace(frequency_hz=np.asarray(f), pressure=np.ones((1, len(f))))
    return SimpleNamespace(
        problem=SimpleNamespace(observed=observed), residual=residual, effective=effective
    )


def test_residuals_are_judged_by_octave_after_what_was_fitted_is_taken_off():
    """Up to 2.5 in each octave, and 1.6 in all; ends belong to both octaves."""
    f = np.array([100.0, 150.0, 200.0, 300.0, 400.0, 500.0])
    found = _chi2_by_octave(fit_of(f, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0], 3.0))
    np.testing.assert_allclose(
        found, [(200.0, 2.0 / 0.75), (400.0, 4.0 / 0.75), (500.0, 5.5 / 0.75)]
    )
    for squares, fits_well in (
        ([1.59] * 6, True),
        ([1.61] * 6, False),
        ([0.1, 0.1, 0.1, 0.1, 0.1, 4.89], True),
        ([0.1, 0.1, 0.1, 0.1, 0.1, 4.91], False),
    ):
        assert _fits(fit_of(f, squares)) is fits_well


def observed_with(noise: Any, level: float = 1.0) -> Any:
    return Observed(np.array([200.0, 300.0]), 0.01, np.full((1, 2), level + 0j), noise)


@pytest.mark.parametrize(
    ("chi2", "noise", "shares", "rivals", "word", "cause"),
    [
        (1.0, None, (0.8, 0.8), (), "identified", ""),
        (1.0, None, (0.8, 0.5), (), "not identifiable", "the data hardly depend on b"),
        (1.0, None, (0.5, 0.5), (), "not identifiable", "the data hardly depend on a, b"),
        (1.0, None, (1.0, 0.5), ("r",), "not identifiable", "other walls explain the data as well"),
        (9.0, None, (1.0, 1.0), (), "does not fit", "the cause"),
        (1.0, 0.149, (1.0, 1.0), (), "identified", ""),
        (1.0, 0.151, (1.0, 1.0), (), "does not fit",
         "what the fit leaves is larger than any noise should be"),
    ],
)  # fmt: skip
def test_a_verdict_is_by_misfit_then_rivals_then_how_much_of_each_wall_is_known(
    monkeypatch, chi2, noise, shares, rivals, word, cause
):
    """Noise that was estimated above 15 % of the level is no noise; four of five frequencies."""
    monkeypatch.setattr(diagnostics, "reduced_chi2", lambda _: chi2)
    monkeypatch.setattr(diagnostics, "_fits", lambda _: chi2 < 2.0)
    monkeypatch.setattr(diagnostics, "_likely_cause", lambda _: "the cause")
    given = observed_with(None if noise else np.full((1, 2), 0.5))
    fitted = observed_with(np.full((1, 2), noise or 0.5))
    materials: Any = tuple(
        SimpleNamespace(name=n, identified=np.arange(10) < round(10 * share))
        for n, share in zip("ab", shares, strict=True)
    )
    fit: Any = SimpleNamespace(problem=SimpleNamespace(observed=fitted))
    verdict, findings = diagnostics._verdict(fit, rivals, given, materials)
    assert (verdict.word, verdict.cause, verdict.weaker) == (word, cause, False)
    codes = {"does not fit": Code.IMPEDANCE_DOES_NOT_FIT,
             "not identifiable": Code.IMPEDANCE_NOT_IDENTIFIABLE}  # fmt: skip
    assert [f.code for f in findings] == [codes[w] for w in codes if w == word]
    if word == "not identifiable":
        unsure = [n for n, share in zip("ab", shares, strict=True) if share < 0.8]
        assert findings[0].evidence == {"rivals": len(rivals), "materials": unsure}
        assert list(findings[0].about.materials) == unsure
    elif word == "does not fit":
        assert findings[0].evidence == {"chi2": chi2, "cause": cause}
        assert f"it leaves {chi2:.1f} times the expected squares" in verdict.sentence


@pytest.mark.parametrize("kind", ["spline", *LAWS, "constant"])
@pytest.mark.parametrize("has_phase", [True, False])
def test_data_must_be_as_many_as_the_numbers_of_walls_and_gains(kind, has_phase):
    """Two a pair and frequency, or one level; spectra of two sources take two a frequency each."""
    f = np.arange(200.0, 401.0, 20.0)
    n_laws = {"miki": 3, "resonator": 4, "panel": 3, "constant": 2}
    curve: Any = constant(f) if kind == "constant" else causal_curve(damped(f))
    numbers = n_laws.get(kind, 2 * spline(f).basis.shape[1])
    for n_pairs, gain, n_gain in ((1, "known", 0), (3, "pair", 6), (4, "spectrum", 0)):
        pressure = np.ones((n_pairs, f.size), dtype=complex)
        scene = SimpleNamespace(pairs=np.array([[i % 2, 0] for i in range(n_pairs)]))
        problem: Any = SimpleNamespace(
            observed=Observed(f, 0.01, pressure, has_phase=has_phase),
            curves=(curve,),
            nuisances=Nuisances(gain=gain),
            model=SimpleNamespace(scene=scene),
            layout=SimpleNamespace(gain=slice(2, 2 + n_gain)),
        )
        data = (2 if has_phase else 1) * n_pairs * f.size
        data -= 2 * 2 * f.size if gain == "spectrum" else 0
        found = data_findings(problem, {"wall": WallModel(kind)})
        assert bool(found) is (data < numbers + n_gain)
        # to the very number
        for more, is_raised in ((data - numbers, False), (data - numbers + 1, True)):
            problem.layout = SimpleNamespace(gain=slice(0, more))
            raised = data_findings(problem, {"wall": WallModel(kind)})
            assert bool(raised) is is_raised
        assert raised[0].code is Code.TOO_FEW_DATA
        assert raised[0].evidence == {"data": data, "unknowns": data + 1}


@pytest.mark.parametrize(
    ("n_f", "n_pairs", "has_phase", "words"),
    [
        (3, 2, True, "2 pairs at 3 frequencies cannot distinguish 2 materials: 3 pairs"),
        (1, 1, True, "1 pair at one frequency cannot distinguish 2 materials"),
        (3, 3, True, ""),
        (3, 9, False, "Levels without phase at 3 frequencies do not distinguish"),
        (4, 9, False, ""),
        (4, 2, True, "numbers were measured"),
    ],
)
def test_of_fewer_than_four_frequencies_phases_and_one_pair_more_than_walls_are_needed(
    n_f, n_pairs, has_phase, words
):
    f = 200.0 + 50.0 * np.arange(n_f)
    observed = Observed(f, 0.01, np.ones((n_pairs, n_f), dtype=complex), has_phase=has_phase)
    scene = SimpleNamespace(pairs=np.zeros((n_pairs, 2), dtype=int))
    problem: Any = SimpleNamespace(
        observed=observed, curves=(spline(f), spline(f)), nuisances=Nuisances(gain="known"),
        model=SimpleNamespace(scene=scene), layout=SimpleNamespace(gain=slice(0, 4)),
    )  # fmt: skip
    found = data_findings(problem, {"a": WallModel(), "b": WallModel()})
    assert bool(found) is bool(words)
    if found:
        assert words in found[0].sentence and found[0].evidence.get("pairs", n_pairs) == n_pairs


def test_a_room_of_many_walls_is_refused_where_the_search_for_its_paths_takes_too_long(monkeypatch):
    """From 61 triangles on; the work is shared by the sources, and a thousandth is rounding."""
    scene = box_scene()
    mesh = scene.room.mesh
    n_sources = len(np.unique(scene.pairs[:, 0]))
    tau_s, lengths = 0.004, 7.0
    asked, shares = list[Any](), list[float]()

    def affordable(_scene, duration_s, *, work, images):
        asked.append((duration_s, work, images))
        return shares[-1] * duration_s

    monkeypatch.setattr(wave_model, "affordable_duration_s", affordable)
    monkeypatch.setattr(wave_model, "_reflections_to_weigh", lambda *_: 1.0)
    for few, share, is_refused in ((60, 0.1, False), (11, 0.9991, False), (11, 0.9989, True)):
        shares.append(share)
        monkeypatch.setattr(wave_model, "_FEW_TRIANGLES", few)
        if not is_refused:
            wave_model.check_cost(scene, 10, tau_s, lengths)
            continue
        with pytest.raises(InputError) as caught:
            wave_model.check_cost(scene, 10, tau_s, lengths)
        said = str(caught.value)
        assert f"tau = 4 ms, a room of {len(mesh.triangles)} triangles" in said
        assert "tau of at most 3.9 ms here" in said and "a room of fewer walls" in said
    assert len(mesh.triangles) == 12 and n_sources > 1
    assert asked == [(lengths * tau_s, 3e7 / n_sources, 1e6)] * 2


def test_nuisances_are_freed_no_farther_than_they_are_already():
    """Positions to 20 mm, the speed of sound to a hundredth, known and common gains to sources."""
    tight = Nuisances(position_sd_m=0.001, speed_sd=0.001, gain="known")
    freed = diagnostics._free_geometry(tight)
    assert (freed.position_sd_m, freed.least_position_sd_m, freed.speed_sd) == (0.02, 0.02, 0.01)
    wide = Nuisances(position_sd_m=0.05, speed_sd=0.03, gain="pair")
    wide = replace(wide, least_position_sd_m=0.04)
    kept = diagnostics._free_geometry(wide)
    assert (kept.position_sd_m, kept.least_position_sd_m, kept.speed_sd) == (0.05, 0.04, 0.03)
    for gain, to in (("known", "source"), ("common", "source"), ("pair", "pair")):
        assert diagnostics._free_gain(replace(tight, gain=gain)).gain == to


def test_a_wall_may_start_as_one_that_gives_back_all_and_no_more():
    for start_r0 in (1.0, -1.0, 1.0j, 0.6 - 0.8j):
        assert WallModel(start_r0=start_r0).start_r0 == start_r0
    with pytest.raises(InputError, match="more than it receives") as caught:
        WallModel(start_r0=0.8 + 0.7j)
    assert "|R0| = 1.063" in str(caught.value)


def test_every_law_names_its_numbers_with_units_and_starts_within_their_ranges():
    units = {
        "flow_resistivity": "Pa s/m2", "thickness_m": "m", "air_gap_m": "m", "resistance": "rho c",
        "mass_m": "m", "depth_m": "m",
    }  # fmt: skip
    for law, parameters in LAWS.values():
        assert callable(law) and parameters
        assert all(p.unit == units[p.name] for p in parameters)
        assert all(0.0 < p.low < p.start < p.high for p in parameters)
