"""Use case: where to measure, so that the absorption comes out as sure as it can."""

from __future__ import annotations

import time

import numpy as np

from roomfit._numba import one_blas_thread
from roomfit.air import speed_of_sound_m_s
from roomfit.errors import InputError
from roomfit.experiment_design.candidates import (
    Candidates,
    PriorInformation,
    design_candidates,
    information_from_fit,
    information_from_priors,
    least_source_distance_m,
    measured_pairs,
    trace_candidates,
)
from roomfit.experiment_design.choose import Criterion, Design, choose, random_design
from roomfit.experiment_design.information import (
    PairInformation,
    Unknowns,
    information_of,
    interval_widths,
    material_widths,
)
from roomfit.geometry.mesh import volume_m3
from roomfit.io.campaign import Campaign
from roomfit.io.rooms import read_room
from roomfit.prediction.setup import eyring_time_s
from roomfit.scene import Room, Scene
from roomfit.typing import FloatArray, IntArray, Progress, part
from roomfit.uncertainty.posterior import AbsorptionPosterior

CANDIDATES = 200
CHOSEN = 6
N_RANDOM = 200


@one_blas_thread
def design(
    campaign: Campaign,
    *,
    candidates: int = CANDIDATES,
    choose_n: int | None = None,
    most_sources: int | None = None,
    criterion: Criterion | None = None,
    result: AbsorptionPosterior | None = None,
    misfit: FloatArray | None = None,
    n_random: int = N_RANDOM,
    progress: Progress | None = None,
) -> Design:
    """Choose the pairs of source and receiver that tell most of the absorption.

    The room is traced once for all candidates. What each of them would tell comes from the noise
    model of the fit, at several draws of the absorption; gains and, where pressures will be added,
    places, latency, speed of sound and delays of walls are unknown as they are in a fit. Measured
    pairs count as held, by the same model; or the covariance of a finished fit does.

    Parameters
    ----------
    campaign : Campaign
        Read with ``to_fit=False``: it need not have a measurement.
    candidates : int
        Most pairs to choose from.
    choose_n : int, optional
        How many to choose; left out: 6, or 1 after a fit.
    most_sources : int, optional
        How many different sources they may have; left out: what the campaign says.
    criterion : {"determinant", "mean", "worst"}, optional
        Left out: what the campaign says, or "worst" after a fit.
    result : AbsorptionPosterior, optional
        A finished fit, from `roomfit.io.results.read_result`.
    misfit : float array, shape (n_result_bands,), optional
        phi of that fit: where it is above 1, new measurements are taken to tell less by it.
    n_random : int
        Random designs to compare with.
    progress : callable, optional

    Raises
    ------
    InputError
        The rules leave no candidate or too few, or something in campaign or room is not as needed.
    """
    began = time.perf_counter()
    _check_numbers(candidates, choose_n, most_sources)
    room, findings = read_room(campaign.room)
    names = room.materials
    known = (
        information_from_priors(campaign, names)
        if result is None
        else information_from_fit(campaign, names, result)
    )
    distance_m = _source_distance_m(campaign, room, known)
    found = design_candidates(
        *(campaign, room, candidates, distance_m),
        most_sources=most_sources,
        count_measured=result is None,
    )
    n = choose_n or (CHOSEN if result is None else 1)
    n_pairs = n + len(measured_pairs(campaign))
    traced = trace_candidates(campaign, found.scene, known, n_pairs, part(progress, 0.0, 0.95))
    matrices = traced.matrices
    if misfit is not None and result is not None:
        at = np.searchsorted(result.bands.centres_hz, known.bands.centres_hz)
        matrices = matrices / np.maximum(misfit[at], 1.0)[:, None, None]
    pairs = PairInformation(matrices, _gains(campaign, found.scene))
    wanted = criterion or (campaign.design.criterion if result is None else "worst")
    fixed = tuple(range(found.n_fixed))
    rng = np.random.default_rng(campaign.seed)
    chosen = choose(known.unknowns, pairs, found.rules, n, wanted, fixed, rng=rng)
    return Design(
        scene=found.scene,
        n_fixed=found.n_fixed,
        chosen=np.array(chosen),
        bands=known.bands,
        materials=names,
        to_find=known.unknowns.number >= 0,
        widths=_widths(known.unknowns, pairs, fixed, chosen),
        random_means=_random_means(campaign, known.unknowns, pairs, found, n, n_random),
        criterion=wanted,
        model="coherent" if traced.coherent else "energy",
        absorption=known.typical,
        n_draws=len(known.draws),
        after_fit=result is not None,
        source_distance_m=distance_m,
        receiver_distance_m=campaign.design.receiver_distance_m,
        wall_distance_m=campaign.design.wall_distance_m,
        findings=(*findings, *known.findings, *found.findings, *traced.findings),
        seed=campaign.seed,
        seconds=time.perf_counter() - began,
    )


def _check_numbers(candidates: int, chosen: int | None, most_sources: int | None) -> None:
    for name, number in (
        ("candidates", candidates),
        ("measurements to choose", chosen),
        ("sources", most_sources),
    ):
        if number is not None and number < 1:
            raise InputError(f"the number of {name} is below 1", found=str(number), needed="1")


def _source_distance_m(campaign: Campaign, room: Room, known: PriorInformation) -> float:
    """Return the least distance of a receiver from its source, ISO 3382's where none is told."""
    specified_m = campaign.design.source_distance_m
    if specified_m is not None:
        return specified_m
    nobody = Scene(room, (), (), np.zeros((0, 2), dtype=np.int64), campaign.air)
    decay_s = float(np.median(eyring_time_s(nobody, known.bands, known.typical)))
    return least_source_distance_m(volume_m3(room.mesh), speed_of_sound_m_s(campaign.air), decay_s)


def _gains(campaign: Campaign, scene: Scene) -> IntArray:
    n = len(scene.pairs)
    if campaign.design.level == "per-source":
        return np.asarray(scene.pairs[:, 0])
    return np.arange(n) if campaign.design.level == "per-file" else np.full(n, -1)


def _widths(
    unknowns: Unknowns, pairs: PairInformation, fixed: tuple[int, ...], chosen: tuple[int, ...]
) -> FloatArray:
    """Return the widths before and after each of the chosen, (n + 1, n_materials, n_bands)."""
    steps = [[*fixed, *chosen[:i]] for i in range(len(chosen) + 1)]
    return np.stack(
        [
            material_widths(
                unknowns, interval_widths(unknowns, information_of(unknowns, pairs, step))
            )
            for step in steps
        ]
    )


def _random_means(
    campaign: Campaign,
    unknowns: Unknowns,
    pairs: PairInformation,
    found: Candidates,
    n: int,
    n_random: int,
) -> FloatArray:
    """Return the mean widths of random designs, (n_random, n + 1), NaN where one ends early."""
    rng = np.random.default_rng(campaign.seed)
    fixed = tuple(range(found.n_fixed))
    out: FloatArray = np.full((n_random, n + 1), np.nan)
    for row in out:
        drawn = random_design(found.rules, n, rng, fixed)
        widths = _widths(unknowns, pairs, fixed, drawn)
        row[: len(drawn) + 1] = widths[:, unknowns.number >= 0].mean(axis=(1, 2))
    return out
