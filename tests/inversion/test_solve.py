"""What the settings of a user become in a fit of pressures."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import roomfit
from roomfit.bands import bands_between
from roomfit.inversion.sequential import CoherentOptions
from roomfit.inversion.solve import coherent_task
from roomfit.response.directivity import UnknownDirectivity
from roomfit.settings import Settings

BANDS = bands_between("octave", 500, 1000)


def task_of(settings: Settings, **measured):
    scene = roomfit.scene_of(
        roomfit.shoebox_room((6.0, 5.0, 3.0), {}),
        {"S": (1.5, 1.2, 1.5), "T": (4.5, 1.2, 1.5)},
        {"R": (4.0, 3.5, 1.2)},
    )
    all_of_it = {"responses": (), "values": (), "directivities": {}, **measured}
    found = SimpleNamespace(scene=scene, bands=BANDS, **all_of_it)
    traced = SimpleNamespace(fit_until_s=0.7, scattering=None, scattering_sd=None, binned=None)
    return coherent_task(found, (), traced, np.zeros(2), settings)


@pytest.mark.parametrize(
    ("settings", "options"),
    [
        ({"positions": "fixed"}, {"positions": "fixed"}),
        ({"positions": "fit"}, {"positions": "fit"}),
        ({"model": "coherent"}, {"model": "coherent"}),
        ({"model": "auto"}, {"model": "auto"}),
        ({"reflection_delays": False}, {"delays": False}),
        ({"coherent_until_s": 0.13}, {"end_s": 0.13}),
        ({"speed_of_sound_sd": 0.004}, {"speed_sd": 0.004}),
        ({"max_rounds": 7}, {"max_rounds": 7}),
        ({"quick": True}, {"quick": True}),
    ],
)
def test_each_setting_changes_the_option_it_is_of_and_no_other(settings, options):
    usual = Settings()
    own = {
        "positions": "fit", "delays": True, "model": "auto", "end_s": usual.coherent_until_s,
        "late_end_s": 0.7, "speed_sd": usual.speed_of_sound_sd, "max_rounds": usual.max_rounds,
        "quick": False,
    }  # fmt: skip
    assert task_of(Settings(**settings)).settings == CoherentOptions(**{**own, **options})


def test_a_source_is_fitted_tested_or_taken_as_it_is_specified():
    """One without a directivity is tested for one, unless another is unknown and fitted."""
    bare = task_of(Settings())
    assert bare.directivity_parameters is None and bare.tested_sources.sources == ("S", "T")
    fitted = task_of(Settings(), directivities={"S": UnknownDirectivity()})
    assert fitted.tested_sources is None and fitted.directivity_parameters.sources == ("S",)
    known = task_of(Settings(), directivities={"S": SimpleNamespace()})
    assert known.directivity_parameters is None and known.tested_sources.sources == ("T",)


@pytest.mark.parametrize(
    ("method", "values", "fits"),
    [("auto", (), True), ("annealing", (), False), ("auto", ("table",), False)],
)
def test_what_contradicts_an_omnidirectional_source_is_fitted_to_responses_alone(
    monkeypatch, method, values, fits
):
    """By least squares, and where no room parameters are fitted as well."""
    monkeypatch.setattr("roomfit.inversion.solve.value_terms", lambda *_: [None, None])
    task = task_of(Settings(method=method), values=values)
    assert task.fits_contradicted is fits and task.others == ((), ())
