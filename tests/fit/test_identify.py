"""The main job from end to end, on small campaigns whose truth is known and on measured rooms."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roomfit.base.findings import Code
from roomfit.files.campaign import read_campaign
from roomfit.files.inputs import identify_arguments, load_campaign
from roomfit.identify import identify
from roomfit.result import Result
from small_campaign import ABSORPTION, small_responses, write_campaign, write_wav


def answer_to(folder: Path, *changes: tuple[str, str]) -> Result:
    return identify(**load_campaign(write_campaign(folder, *changes)))


def codes(answer: Result) -> set[str]:
    return {finding.code for finding in answer.findings}


def assert_same_absorption(answer: Result, other: Result, tolerance: float) -> None:
    assert answer.materials == other.materials
    np.testing.assert_allclose(answer.absorption, other.absorption, rtol=0, atol=tolerance)


@pytest.fixture(scope="module")
def plain(tmp_path_factory) -> Result:
    """The answer to the campaign as it stands."""
    return answer_to(tmp_path_factory.mktemp("plain"))


def test_the_mean_absorption_of_the_room_is_found(plain):
    """Two files of a box whose mean absorption is 0.23; two pairs cannot tell it any better."""
    areas = dict(zip(plain.materials, plain.areas_m2, strict=True))
    truth = sum(ABSORPTION[n] * a for n, a in areas.items()) / sum(areas.values())
    mean, lower, upper = plain.mean_absorption
    np.testing.assert_allclose(mean, truth, atol=0.08)
    assert np.all((lower < mean) & (mean < upper))


def test_a_first_answer_is_hardly_less_certain_and_says_what_was_not_looked_for(tmp_path, plain):
    arguments = load_campaign(write_campaign(tmp_path))
    arguments["settings"] = replace(arguments["settings"], quick=True)
    first = identify(**arguments)
    assert codes(first) - codes(plain) >= {Code.FIRST_ANSWER}
    assert first.evaluations < 0.7 * plain.evaluations
    width, full = (x.upper95 - x.lower95 for x in (first, plain))
    assert width.mean() < 1.5 * full.mean()
    # of the same data: the two differ by less than either may be wrong
    assert np.all(np.abs(first.absorption - plain.absorption) < 0.5 * np.maximum(width, full))
    assert set(np.ravel(first.interval_kinds)) <= {"gaussian", "profile", "none", "given"}


@pytest.mark.slow
@pytest.mark.parametrize("method", ["simplex", "annealing"])
def test_the_papers_methods_agree_with_least_squares_within_its_interval(tmp_path, plain, method):
    """Same squares, three ways down: what differs must be far smaller than the uncertainty."""
    one_band = ("to_hz = 1000", f'to_hz = 500\nmethod = "{method}"')
    answer = answer_to(tmp_path, one_band)
    assert answer.method == method
    assert answer.evaluations > 0
    width = (plain.upper95 - plain.lower95)[:, 0]
    apart = np.abs(answer.absorption[:, 0] - plain.absorption[:, 0])
    assert np.all(apart <= 0.25 * width + 0.002)


@pytest.mark.slow
@pytest.mark.parametrize("level", ["per-source", "per-file"])
def test_a_louder_recording_gives_the_same_absorption(tmp_path, level):
    """All files 20 dB up: an unknown gain takes it; one file alone: only a gain per file does."""
    change = ('file = "LS1', f'level = "{level}"\nfile = "LS1')
    path = write_campaign(tmp_path, change)
    campaign = read_campaign(path)
    before = identify(**identify_arguments(campaign))
    louder = ["MP1", "MP2"] if level == "per-source" else ["MP2"]
    for name in louder:
        write_wav(tmp_path / f"LS1_{name}.wav", 10.0 * small_responses()[name])
    # float32 in the file rounds anew: 6e-8
    assert_same_absorption(before, identify(**identify_arguments(campaign)), 1e-4)


@pytest.mark.slow
def test_an_absolute_level_is_taken_at_its_word(tmp_path, plain):
    """The files hold pressure with a direct sound of 1/(4 pi r): knowing it costs nothing.

    6 dB less would mean more absorption; the direct sound's window then no longer fits.
    """
    change = ('file = "LS1', 'level = "absolute"\nfile = "LS1')
    campaign = read_campaign(write_campaign(tmp_path, change))
    reported = identify(**identify_arguments(campaign))
    np.testing.assert_allclose(reported.mean_absorption[0], plain.mean_absorption[0], atol=0.06)
    assert np.all(reported.chi2_reduced < 2.0)
    for name, pressure in small_responses().items():
        write_wav(tmp_path / f"LS1_{name}.wav", 0.5 * pressure)
    assert np.all(
        identify(**identify_arguments(campaign)).mean_absorption[0]
        > reported.mean_absorption[0] + 0.05
    )


@pytest.mark.slow
@pytest.mark.parametrize("time_zero", ["direct", "unknown"])
def test_a_file_without_a_clock_is_put_on_that_of_the_geometry(tmp_path, plain, time_zero):
    """The direct sound's onset is found within 3 samples, 13 cm at this low sampling rate."""
    path = write_campaign(tmp_path, ('file = "LS1', f'time_zero = "{time_zero}"\nfile = "LS1'))
    for name, pressure in small_responses().items():
        write_wav(tmp_path / f"LS1_{name}.wav", np.pad(pressure, (321, 0)))
    answer = identify(**load_campaign(path))
    np.testing.assert_allclose(answer.mean_absorption[0], plain.mean_absorption[0], atol=0.05)
    assert Code.TIME_ZERO_MISMATCH not in codes(answer)


def test_a_material_that_no_sound_meets_is_not_determined(tmp_path):
    """A niche behind a closed sheet would be such; here its data are none: 0 to 1, and said so."""
    from roomfit.model.parameters import Block, Parameters
    from roomfit.uncertainty.gaussian import absorption_intervals

    names, one = ("met", "never met"), np.ones(2)
    # the broad default, and a prior that was stated, of which a misfit takes nothing away
    for mean, sd, low, high in (
        (np.log(0.15 / 0.85), 1.5, 0.0, 1.0),
        (0.0, 0.5, 1.0 / (1.0 + np.exp(0.979982)), 1.0 / (1.0 + np.exp(-0.979982))),
    ):
        block = Block(
            "absorption", names, "logit", 0.15 * one, one > 0, mean * one, sd * one, 0 * one, one
        )
        information = np.diag([1.0 / sd**2 + 4000.0, 1.0 / sd**2])
        vector = np.array([-1.0, mean])
        found = absorption_intervals(
            Parameters((block,)), vector, 1.9 * np.linalg.inv(information), 1.9
        )
        assert (found.lower95[1], found.upper95[1]) == pytest.approx((low, high), abs=1e-5)
        assert found.upper95[0] - found.lower95[0] < 0.05
