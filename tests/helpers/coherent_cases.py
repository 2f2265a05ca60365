"""A small box with two observations as a partly coherent problem, made without any file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import csr_array

from roomfit.base.air import Air
from roomfit.base.bands import Bands
from roomfit.materials.priors import uniform_scattering
from roomfit.model.binned import BinnedPaths, bin_paths, in_band
from roomfit.model.energy import EnergyTerm, Observation, fine_edges_s, in_air
from roomfit.model.parameters import Block, Parameters
from roomfit.model.problem import Objective
from roomfit.model.windows import window_edges_s
from roomfit.pressures.bands import coherent_term
from roomfit.pressures.data_term import CoherentTerm
from roomfit.pressures.geometry import Geometry, geometry_block
from roomfit.pressures.response import image_paths
from roomfit.room.mesh import shoebox_mesh
from roomfit.room.scene import Point, Room, Scene
from roomfit.signals.filters import energy_share, spreading_kernel, statistical_bandwidth_hz
from roomfit.tracing.image_sources import trace_images
from roomfit.tracing.paths import Paths

SPEED_M_S = 340.0
END_S = 0.06
MATERIALS = ("walls", "floor", "ceiling")
CENTRE_HZ = 250.0


def small_scene() -> Scene:
    """Return a box of three materials with one source and two receivers."""
    lengths = (4.0, 3.1, 2.5)
    room = Room(shoebox_mesh(lengths), MATERIALS, np.array([0, 0, 0, 0, 1, 2]), lengths)
    return Scene(
        room,
        (Point("S", np.array([1.1, 0.9, 1.2]), 0.01),),
        (Point("A", np.array([2.9, 2.1, 1.5]), 0.01), Point("B", np.array([3.1, 0.8, 0.9]), 0.01)),
        np.array([[0, 0], [0, 1]]),
        Air(speed_of_sound_m_s=SPEED_M_S, attenuation="none"),
    )


def small_term(centre_hz: float = CENTRE_HZ, paths: Paths | None = None) -> CoherentTerm:
    """Return windows without any coherence, their data all one."""
    scene = small_scene()
    bands = Bands("octave", np.array([centre_hz]))
    if paths is None:
        paths = trace_images(scene, 100, END_S, uniform_scattering(MATERIALS, 0.0))
    binned = bin_paths(scene, bands, paths, END_S)
    energies = energy_term(bands, scene, in_band(binned, centre_hz))
    images = image_paths(paths, np.arange(2), 0.0)
    term = coherent_term(bands, 0, energies, 0.0, images, binned, small_geometry())
    # finite differences ask for more than single precision
    return replace(term, grid=replace(term.grid, real=np.float64))


def small_paths() -> tuple[Scene, Paths]:
    """Return the scene and its image paths."""
    scene = small_scene()
    return scene, trace_images(scene, 100, END_S, uniform_scattering(MATERIALS, 0.0))


def small_geometry() -> Geometry:
    """Return the unknowns of the two observations."""
    sd = np.array([*[0.01] * 9, 2e-3, 2e-5, *[2e-4] * 3])
    labels = tuple(f"unknown {i}" for i in range(sd.size))
    shared = [9, 10, 11, 12, 13]
    columns = np.array([[0, 1, 2, 3, 4, 5, *shared], [0, 1, 2, 6, 7, 8, *shared]])
    return Geometry(labels, sd, np.ones(sd.size, dtype=np.bool_), SPEED_M_S, columns)


def energy_term(bands: Bands, scene: Scene, binned: BinnedPaths) -> EnergyTerm:
    """Return the energies of both observations, one gain for both."""
    bandwidth = float(statistical_bandwidth_hz(bands)[0])
    kernel = spreading_kernel(bands)
    centres = 0.5 * (binned.edges_s[1:] + binned.edges_s[:-1])
    observations = []
    for pair in range(2):
        edges = window_edges_s(0.006, END_S - 0.004, bandwidth, periods=0.75)
        fine = fine_edges_s(edges, bandwidth)
        shares, fine_spreading = (
            csr_array(energy_share(kernel, 0, centres, e).T) for e in (edges, fine)
        )
        n = edges.size - 1
        observations.append(
            Observation(
                *(pair, edges, np.ones(n), np.zeros(n), shares, fine, fine_spreading),
                *(csr_array(shares.shape), 0.0, 0),
            )
        )
    term = EnergyTerm(
        *(float(bands.centres_hz[0]), bandwidth, 0.0, binned.rows), *(tuple(observations), 0.0, 0.0)
    )
    return in_air(term)


def objective_of(term: EnergyTerm | CoherentTerm) -> Objective:
    """Return the objective of such windows: three absorptions, a gain and their geometry."""
    held = np.ones(3, dtype=np.bool_)
    absorption = Block(
        *("absorption", MATERIALS, "logit", np.array([0.2, 0.4, 0.1]), held),
        *(np.full(3, -1.7), np.full(3, 1.5), np.zeros(3), np.ones(3)),
    )
    gain = Block(
        *("gain", ("S",), "log", np.array([2.0]), np.ones(1, dtype=np.bool_)),
        *(np.zeros(1), np.full(1, np.inf), np.zeros(1), np.ones(1)),
    )
    geometry = (geometry_block(term.geometry),) if isinstance(term, CoherentTerm) else ()
    return Objective(Parameters((absorption, gain, *geometry)), (term,))


def with_data(term: CoherentTerm, data: np.ndarray) -> CoherentTerm:
    """Return the windows with other measured energies, observations end to end."""
    observed = []
    first = 0
    for o in term.energies.observations:
        n = o.energy.size
        observed.append(replace(o, energy=data[first : first + n]))
        first += n
    return replace(term, energies=replace(term.energies, observations=tuple(observed)))
