"""Answers that symmetry makes as good as the one found: reported, and not identifiable."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from roomfit.air import Air
from roomfit.bands import Bands
from roomfit.diagnostics import mirrors
from roomfit.diagnostics.verdict import voided
from roomfit.findings import Code
from roomfit.geometry.mesh import shoebox_mesh
from roomfit.inversion.measurements import Measurements
from roomfit.materials.priors import unknown_material
from roomfit.scene import Point, Room, Scene
from roomfit.signals.iso3382 import MeasuredValues
from seen import evidence

LENGTHS = (5.0, 4.0, 3.0)
NAMES = ("walls", "floor", "ceiling")
OWNERS = (0, 0, 0, 0, 1, 2)
BANDS = Bands("octave", [500.0, 1000.0])
KNOWN = tuple(unknown_material(n, 2) for n in NAMES)
ABSORPTION = np.array([[0.1, 0.1], [0.3, 0.3], [0.6, 0.35]])


def measurements(*heights_m: float, sd_m: float = 0.01) -> Measurements:
    """One source at half height, receivers at the given ones; room parameters only."""
    positions = [(1.0 + 0.7 * i, 2.9, z) for i, z in enumerate(heights_m)]
    receivers = tuple(Point(f"R{i}", np.array(p), sd_m) for i, p in enumerate(positions))
    scene = Scene(
        Room(shoebox_mesh(LENGTHS), NAMES, np.array(OWNERS), LENGTHS),
        (Point("S", np.array([3.9, 1.3, 1.5]), sd_m),),
        receivers,
        np.array([(0, i) for i in range(len(receivers))]),
        Air(),
    )
    values = tuple(MeasuredValues("S", r.name, BANDS.centres_hz, {}, {}) for r in receivers)
    return Measurements(scene, BANDS, {}, (), values, (), ())


def found(data: Measurements, priors=KNOWN):
    """Return the findings."""
    no_trials = SimpleNamespace(answers=[SimpleNamespace(mirrors=())] * len(BANDS))
    seen = evidence(
        measured=data,
        priors=priors,
        fits=no_trials,
        absorption=ABSORPTION,
        lower95=ABSORPTION - 0.1,
        upper95=ABSORPTION + 0.1,
    )
    return tuple(mirrors.check(seen))


def test_floor_and_ceiling_can_be_exchanged_where_everything_stands_at_half_height():
    (finding,) = found(measurements(1.5, 1.51))
    ambiguous = voided(finding, KNOWN, BANDS)
    # at 1 kHz both answers lie within the intervals
    assert ambiguous.tolist() == [[False, False], [True, False], [True, False]]
    assert finding.code == Code.MIRROR_AMBIGUITY
    assert finding.evidence["materials"] == ["floor", "ceiling"]
    assert finding.evidence["other_answer"]["floor"] == [0.6, 0.35]
    assert finding.evidence["bands_hz"] == [500.0]
    assert finding.evidence["apart_m"] == pytest.approx(0.01)
    assert "floor 0.60 instead of 0.30" in finding.sentence


def test_one_pair_off_the_plane_is_enough():
    for heights in ((1.5, 1.6), (1.2,)):
        assert found(measurements(*heights)) == ()
    # positions with a standard deviation of 4 cm may be symmetric after all
    assert len(found(measurements(1.5, 1.6, sd_m=0.04))) == 1


def test_a_prior_of_one_wall_breaks_the_symmetry():
    known = replace(KNOWN[1], known=np.array([0.3, 0.3]))
    assert found(measurements(1.5), (KNOWN[0], known, KNOWN[2])) == ()
    prior = replace(
        KNOWN[1], prior_logit_sd=np.full(2, 0.2), prior_logit_mean=np.full(2, -0.8), specified=True
    )
    assert found(measurements(1.5), (KNOWN[0], prior, KNOWN[2])) == ()
