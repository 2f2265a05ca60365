"""Bands, air, absorption: the few definitions that everything else rests on."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from roomfit.base.air import Air
from roomfit.base.bands import OCTAVES_HZ, THIRD_OCTAVES_HZ, Bands, bands_between
from roomfit.base.errors import InputError
from roomfit.materials.priors import MaterialPrior, Scattering
from roomfit.model.parameters import Block
from roomfit.model.patterns import MeasuredDirectivity, Pattern, unit_vector
from roomfit.room.mesh import shoebox_mesh
from roomfit.room.scene import Point, PointGroup, scene_of, shoebox_room
from roomfit.signals.iso3382 import MeasuredValues
from roomfit.signals.measurement import Measurement
from roomfit.signals.response import ImpulseResponse
from roomfit.tracing.paths import TraceSettings
from simulated_rooms.polyhedra import Cells


@pytest.mark.parametrize(
    ("kind", "table", "ratio"),
    [("octave", OCTAVES_HZ, 2.0), ("third-octave", THIRD_OCTAVES_HZ, 2.0 ** (1 / 3))],
)
def test_standard_bands_touch_and_have_their_nominal_centres(kind, table, ratio):
    """IEC 61260-1: an octave is 10**0.3; nominal centres lie within 2 % of the exact ones."""
    bands = bands_between(kind, table[0], table[-1])
    np.testing.assert_allclose(bands.upper_hz[:-1], bands.lower_hz[1:], rtol=1e-12)
    np.testing.assert_allclose(bands.upper_hz / bands.lower_hz, ratio, rtol=2.5e-3)
    np.testing.assert_allclose(bands.exact_centres_hz, bands.centres_hz, rtol=0.02)


def test_a_frequency_that_is_no_centre_is_refused():
    with pytest.raises(InputError, match=r"not a centre(?s:.*)300 Hz"):
        Bands("octave", np.array([125.0, 300.0]))


BOX = shoebox_mesh((3.0, 2.0, 1.0))
HALL = shoebox_room((3.0, 2.0, 1.0), "wall")
SCENE = scene_of(HALL, {"S": (1.0, 1.0, 0.5)}, {"R": (2.0, 1.0, 0.5), "Q": (0.5, 0.5, 0.5)})
EYE = np.eye(3)


def directivity(**given: object) -> MeasuredDirectivity:
    own = {"centres_hz": [500.0], "factor": np.ones((1, 3, 4)), "axes": EYE}
    return MeasuredDirectivity(**(own | given))


# What makes a record of one number, and the closed range that the number may be in.
NUMBERS = {
    "band centre": (lambda x: Bands("octave", [x]), 1.0, 1e5),
    "temperature": (lambda x: Air(temperature_c=x), -20.0, 50.0),
    "relative humidity": (lambda x: Air(humidity_percent=x), 0.0, 100.0),
    "atmospheric pressure": (lambda x: Air(pressure_kpa=x), 50.0, 120.0),
    "speed of sound": (lambda x: Air(speed_of_sound_m_s=x), 250.0, 450.0),
    "sampling rate": (lambda x: ImpulseResponse(np.ones(2), x), 1000.0, 1e6),
    "vertices": (lambda x: replace(BOX, vertices_m=np.full((8, 3), x)), -1e6, 1e6),
    "triangles": (lambda x: replace(BOX, triangles=np.full((12, 3), int(x))), 0, 7),
    "surface of each": (lambda x: replace(BOX, triangle_surface=np.full(12, int(x))), 0, 5),
    "material of each": (lambda x: replace(HALL, surface_material=np.full(6, int(x))), 0, 0),
    "lengths_sd": (lambda x: replace(HALL, lengths_sd_m=(0.0, x, 0.0)), 0.0, 1.0),
    "position of P": (lambda x: Point("P", [x, 0.0, 0.0]), -1e6, 1e6),
    "groups.G.sd": (lambda x: PointGroup("G", ("P",), x), 0.0, 1.0),
    r"groups.G.sd.*\n.*\[1\]": (lambda x: PointGroup("G", ("P",), (0, x, 0)), 0.0, 1.0),
    r"pair(.|\n)*(-1|1)": (lambda x: replace(SCENE, pairs=[[int(x), 0]]), 0, 0),
    r"pair(.|\n)*(-1|2)": (lambda x: replace(SCENE, pairs=[[0, int(x)]]), 0, 1),
    "state of each": (lambda x: replace(SCENE, pair_state=[int(x), 0]), 0, 0),
    "axes of a": (lambda x: directivity(axes=np.diag([x, 1.0, 1.0])), -1.0, 1.0),
    "centres": (lambda x: directivity(centres_hz=[x]), 0.0, np.inf),
    "directivity is": (lambda x: directivity(factor=np.full((1, 3, 4), x)), 0.0, np.inf),
    "directivity.*\n": (lambda x: Pattern([0.0, x, 0.0]), -1e3, 1e3),
    "aim": (lambda x: unit_vector([x, 0.0, 1.0]), -1e6, 1e6),
    "band centres": (lambda x: MeasuredValues("S", "R", [x], {}), 1.0, np.inf),
    "absorption": (lambda x: MaterialPrior("w", [0.0], [1.0], known=[x]), 0.0, 1.0),
    "scattering": (lambda x: MaterialPrior("w", [0.0], [1.0], scattering=[x]), 0.0, 1.0),
    "scattering coefficient": (lambda x: Scattering(("w",), [x]), 0.0, 1.0),
    "duration_s": (lambda x: TraceSettings(x), 1e-4, 100.0),
    "n_rays": (lambda x: TraceSettings(1.0, n_rays=int(x)), 0, 10**9),
    "image_order": (lambda x: TraceSettings(1.0, image_order=int(x)), -1, 1000),
    "receiver_radius_m": (lambda x: TraceSettings(1.0, receiver_radius_m=x), 1e-3, 100.0),
    "max_hits": (lambda x: TraceSettings(1.0, max_hits=int(x)), 1, 65_535),
    "n_batches": (lambda x: TraceSettings(1.0, n_batches=int(x)), 1, 10_000),
    "seed": (lambda x: TraceSettings(1.0, seed=int(x)), 0, 2**63 - 1),
    "image_until_s": (lambda x: TraceSettings(1.0, image_until_s=x), 0.0, 100.0),
}


@pytest.mark.parametrize("words", NUMBERS)
def test_a_number_is_taken_up_to_its_limits_and_refused_beyond_them(words):
    """A limit itself may be no centre of a band, but is in range; beyond is the next number."""
    make, low, high = NUMBERS[words]
    for limit, way in ((low, -np.inf), (high, np.inf)):
        if np.isfinite(limit):
            try:
                make(limit)
            except InputError as refused:
                assert "out of range" not in refused.what
            beyond = limit + int(np.sign(way)) if isinstance(limit, int) else 0.0
            with pytest.raises((InputError, OverflowError), match=f"{words}|int too"):
                make(beyond if isinstance(limit, int) else np.nextafter(limit, way))


RECORDS = {
    "bands": Bands("octave", [500.0, 1000.0]),
    "response": ImpulseResponse([0.0, 1.0], 8000.0),
    "measurement": Measurement("S", "R", [0.0, 1.0, 0.5], 8000.0),
    "mesh": BOX,
    "room": HALL,
    "point": Point("P", [1.0, 2.0, 3.0]),
    "scene": replace(SCENE, pair_state=[0, 0]),
    "loudspeaker": directivity(),
    "pattern": Pattern([0.0, 1.0, 0.0], [1.0, 0.0, 0.0]),
    "values": MeasuredValues("S", "R", [500.0], {"T20_s": [1.0]}),
    "prior": MaterialPrior("w", [0.0], [1.0], known=[0.1], scattering=[0.2]),
    "scattering": Scattering(("w",), [0.5]),
    "cells": Cells([[0.0, 0.0, 0.0]], (), ()),
    "block": Block(
        "a", ("x", "y"), "logit", fitted=[True, False], start=[0.5, 0.5], prior_mean=[0.0, 0.0],
        prior_sd=[1.0, np.inf], lower=[0.0, 0.0], upper=[1.0, 1.0], leader=[0, 0],
        correlation=np.eye(2),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", RECORDS)
def test_arrays_of_a_record_are_copies_that_nobody_changes(name):
    """Whoever changes what was handed over changes no record, and a record says so itself."""
    before = RECORDS[name]
    given = {f.name: getattr(before, f.name) for f in fields(before) if f.init}
    own = {k: np.array(v) for k, v in given.items() if isinstance(v, np.ndarray)}
    after = replace(before, **own)
    for key, array in own.items():
        found = getattr(after, key)
        assert not found.flags.writeable and not np.shares_memory(found, array)
        np.testing.assert_array_equal(found, array)
        assert found.dtype == getattr(before, key).dtype
    for f in fields(before):
        if not f.init and isinstance(found := getattr(after, f.name), np.ndarray):
            assert not found.flags.writeable
    if name == "values":
        with pytest.raises(TypeError):
            after.values["T30_s"] = np.ones(1)
        assert not after.values["T20_s"].flags.writeable
