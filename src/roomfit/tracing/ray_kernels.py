"""The loop over rays, walls and receivers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import prange

from roomfit.compiled import kernel
from roomfit.tracing.acceleration import Walls, next_wall, wall_material
from roomfit.tracing.bounce import Vector, after_wall
from roomfit.tracing.random import ray_key
from roomfit.tracing.spheres import Spheres, chord
from roomfit.typing import FloatArray, IntArray

CHUNK_RAYS = 256
ESCAPES_KEPT = 4


class Job(NamedTuple):
    """What all rays of one source have in common.

    Attributes
    ----------
    start_m : float array, shape (3,)
    scattering : float array, shape (n_materials,)
    max_length_m : float
        Nothing is recorded that arrives after more than this.
    max_hits : int
        A ray ends at the wall hit of this number.
    seed, source : int
    """

    start_m: FloatArray
    scattering: FloatArray
    max_length_m: float
    max_hits: int
    seed: int
    source: int


class Caught(NamedTuple):
    """Room for what each chunk of rays records; the first axis of every array is the chunk.

    Attributes
    ----------
    found : int64 array, shape (n_chunks,)
        Crossings found, more than `capacity` where the rest did not fit.
    sphere : int32 array, shape (n_chunks, capacity)
    ray : int64 array, shape (n_chunks, capacity)
    length_m, chord_m : float arrays, shape (n_chunks, capacity)
    hits_specular, hits_diffuse : uint16 arrays, shape (n_chunks, capacity, n_materials)
    arrival : float32 array, shape (n_chunks, capacity, 3)
    """

    found: IntArray
    sphere: IntArray
    ray: IntArray
    length_m: FloatArray
    chord_m: FloatArray
    hits_specular: IntArray
    hits_diffuse: IntArray
    arrival: FloatArray


class Tally(NamedTuple):
    """What each chunk counts beside its crossings; the first axis is the chunk.

    Attributes
    ----------
    hits, escapes, free_paths : int64 arrays, shape (n_chunks,)
    sum_m, sum_m2 : float arrays, shape (n_chunks,)
        Sum of the free paths and of their squares.
    escape_from_m : float array, shape (n_chunks, ESCAPES_KEPT, 3)
        Where the first rays to escape began their last flight.
    escape_direction : float array, shape (n_chunks, ESCAPES_KEPT, 3)
    """

    hits: IntArray
    escapes: IntArray
    free_paths: IntArray
    sum_m: FloatArray
    sum_m2: FloatArray
    escape_from_m: FloatArray
    escape_direction: FloatArray


@kernel(parallel=True)
def trace_chunks(
    walls: Walls,
    spheres: Spheres,
    job: Job,
    directions: FloatArray,
    first_ray: int,
    caught: Caught,
    tally: Tally,
) -> None:
    """Trace consecutive rays, each chunk into its own part of `caught` and `tally`.

    Parameters
    ----------
    directions : float array, shape (n_rays, 3)
        Start directions of these rays.
    first_ray : int
        Number of the first of them among all rays of the source.
    """
    for chunk in prange(len(caught.found)):
        _trace_chunk(walls, spheres, job, directions, first_ray, chunk, caught, tally)


@kernel()
def _trace_chunk(
    walls: Walls,
    spheres: Spheres,
    job: Job,
    directions: FloatArray,
    first_ray: int,
    chunk: int,
    caught: Caught,
    tally: Tally,
) -> None:
    specular = np.zeros(len(job.scattering), np.uint16)
    diffuse = np.zeros(len(job.scattering), np.uint16)
    caught.found[chunk] = 0
    tally.hits[chunk] = tally.escapes[chunk] = tally.free_paths[chunk] = 0
    tally.sum_m[chunk] = tally.sum_m2[chunk] = 0.0
    for i in range(chunk * CHUNK_RAYS, min((chunk + 1) * CHUNK_RAYS, len(directions))):
        specular[:] = 0
        diffuse[:] = 0
        d = (directions[i, 0], directions[i, 1], directions[i, 2])
        _trace_ray(walls, spheres, job, d, first_ray + i, chunk, specular, diffuse, caught, tally)


@kernel()
def _trace_ray(
    walls: Walls,
    spheres: Spheres,
    job: Job,
    d: Vector,
    ray: int,
    chunk: int,
    specular: IntArray,
    diffuse: IntArray,
    caught: Caught,
    tally: Tally,
) -> None:
    key = ray_key(job.seed, job.source, ray)
    o = (job.start_m[0], job.start_m[1], job.start_m[2])
    travelled, hit = 0.0, 0
    while True:
        flight, wall = next_wall(walls, o, d)
        _catch(spheres, job, o, d, flight, travelled, ray, chunk, specular, diffuse, caught)
        if wall < 0:
            _note_escape(o, d, chunk, tally)
            return
        if hit > 0:  # the way from the source to the first wall is no free path
            tally.free_paths[chunk] += 1
            tally.sum_m[chunk] += flight
            tally.sum_m2[chunk] += flight * flight
        travelled += flight
        if travelled > job.max_length_m:
            return
        tally.hits[chunk] += 1
        if hit + 1 == job.max_hits:
            return
        o = (o[0] + flight * d[0], o[1] + flight * d[1], o[2] + flight * d[2])
        material = wall_material(walls, wall, o)
        normal = (walls.normal[wall, 0], walls.normal[wall, 1], walls.normal[wall, 2])
        d, is_diffuse = after_wall(d, normal, job.scattering[material], key, hit)
        if is_diffuse:
            diffuse[material] += np.uint16(1)
        else:
            specular[material] += np.uint16(1)
        hit += 1


@kernel()
def _catch(
    spheres: Spheres,
    job: Job,
    o: Vector,
    d: Vector,
    flight: float,
    travelled: float,
    ray: int,
    chunk: int,
    specular: IntArray,
    diffuse: IntArray,
    caught: Caught,
) -> None:
    for k in range(len(spheres.radius_m)):
        nearest, length = chord(spheres, k, o, d, flight)
        if length <= 0.0 or travelled + nearest > job.max_length_m:
            continue
        i = caught.found[chunk]
        caught.found[chunk] += 1
        if i >= caught.ray.shape[1]:
            continue
        caught.sphere[chunk, i] = k
        caught.ray[chunk, i] = ray
        caught.length_m[chunk, i] = travelled + nearest
        caught.chord_m[chunk, i] = length
        for m in range(len(specular)):
            caught.hits_specular[chunk, i, m] = specular[m]
            caught.hits_diffuse[chunk, i, m] = diffuse[m]
        for axis in range(3):
            caught.arrival[chunk, i, axis] = d[axis]


@kernel()
def _note_escape(o: Vector, d: Vector, chunk: int, tally: Tally) -> None:
    n = tally.escapes[chunk]
    tally.escapes[chunk] += 1
    if n < ESCAPES_KEPT:
        for axis in range(3):
            tally.escape_from_m[chunk, n, axis] = o[axis]
            tally.escape_direction[chunk, n, axis] = d[axis]
