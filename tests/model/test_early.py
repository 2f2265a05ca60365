"""Windows of displaced image sources beside paths that stay: the variance of energies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_array

from coherent_cases import small_term
from roomfit.base.typing import FloatArray
from roomfit.model.directivity import DIRECTIVITY, BandDirectivities, UnknownDirectivities
from roomfit.model.early import DisplacedTerm, fixed_paths


@pytest.mark.parametrize("gain", [1e-3, 1.0, 300.0])
def test_where_no_image_moves_the_variance_is_that_of_the_windows(gain):
    """Noise and errors of the model, of paths that all stay, at the answer; by another class.

    Up to half of what was measured is noise. At the lowest gain what was measured is far above what
    is expected and decides the error of the model; there single reflections, which the two classes
    do not count alike where none moves, are a millionth of the noise.
    """
    energies = small_term().energies
    loud = tuple(
        replace(o, energy=np.linspace(1.0, 3.0, o.energy.size), noise=np.full(o.energy.size, 0.5))
        for o in energies.observations
    )
    term = replace(energies, observations=loud, model_error=0.2, ringing_error=0.1)
    absorption = np.linspace(0.1, 0.3, term.rows[0].hits.shape[1])
    kept = fixed_paths(term, None, absorption, np.zeros((0, 3)))
    no_image, n = np.zeros((0, absorption.size)), term.measured().size
    shares, fine = csr_array((n, 0)), csr_array((kept.fine_energy.size, 0))
    still = DisplacedTerm(
        kept, np.zeros(0, np.int64), no_image, no_image[:, 0], no_image[:, :3],
        spreading=shares, fine_spreading=fine, squared_fine=fine, squared_slopes=shares,
    )  # fmt: skip
    values = {"absorption": absorption, "gain": np.array([gain])}
    np.testing.assert_allclose(still.expected(values), term.expected(values), rtol=1e-12)
    found, wanted = still.variance_parts(values), term.variance_parts(values)
    for name in ("model", "ringing"):
        assert wanted[name].max() > 0.0
        np.testing.assert_allclose(found[name], wanted[name], rtol=1e-10)
    assert np.all(found["reflections"] >= wanted["noise"] * (1.0 - 1e-12))
    if gain < 1.0:
        np.testing.assert_allclose(found["reflections"], wanted["noise"], rtol=1e-6)


def displaced(gain: int = 0) -> DisplacedTerm:
    """Return three images of each response beside paths that stay, of a source of unknown b."""
    rng = np.random.default_rng(4)
    energies = small_term().energies
    observations = tuple(replace(o, gain=gain) for o in energies.observations)
    term = replace(energies, observations=observations)
    n_materials, n_observations = term.rows[0].hits.shape[1], len(observations)
    kept = fixed_paths(term, None, np.linspace(0.1, 0.3, n_materials), np.zeros((0, 3)))
    unknown = UnknownDirectivities(("A",), rng.normal(size=3), np.tril(rng.normal(size=(3, 3))) + 2)
    source = np.zeros(n_observations, np.int64)
    source[-1] = -1 if n_observations > 1 else 0
    kept = replace(
        kept,
        directivity=BandDirectivities(unknown, source, (), (None,) * n_observations),
        b=rng.normal(size=(1, 3)),
        log_slopes=rng.normal(size=(kept.energy.size, 3)),
    )
    n, n_windows = 3 * n_observations, kept.energy.size
    way = rng.normal(size=(n, 3))
    # windows of a response hold images of its own
    of_image = np.repeat(np.arange(n_observations), 3)
    n_pieces = np.diff(np.append(kept.first_piece, kept.fine_energy.size))
    own = kept.observation[:, None] == of_image
    fine = csr_array(
        rng.uniform(size=(kept.fine_energy.size, n)) * np.repeat(own, n_pieces, axis=0)
    )
    return DisplacedTerm(
        kept,
        of_image,
        rng.integers(0, 4, (n, n_materials)).astype(np.float64),
        rng.uniform(1.0, 2.0, n) * kept.energy.max(),
        way / np.linalg.norm(way, axis=1)[:, None],
        spreading=csr_array(own * rng.uniform(size=(n_windows, n))),
        fine_spreading=fine,
        squared_fine=fine.power(2),
        squared_slopes=csr_array(own * rng.uniform(size=(n_windows, n))),
    )


def image_energies(term: DisplacedTerm, absorption: FloatArray, b: FloatArray) -> FloatArray:
    """Return what every image brings, by its hits and by the pattern where it is unknown."""
    energy = term.weight * np.prod((1.0 - absorption) ** term.hits, axis=1)
    known = term.kept.directivity.source[term.observation] < 0
    return energy * np.where(known, 1.0, (1.0 + term.basis @ b) ** 2 / (1.0 + b @ b / 3.0))


def test_images_have_the_energy_of_their_hits_and_of_where_they_leave_the_source():
    """A pattern of unit power; paths that stay grow as linearised, by e^5 at most."""
    term = displaced()
    kept, gain = term.kept, 3.0
    absorption, z = np.linspace(0.3, 0.15, term.hits.shape[1]), np.array([0.3, -0.2, 0.4])
    values = {"absorption": absorption, "gain": np.array([gain]), DIRECTIVITY: z}
    unknown = kept.directivity.unknown
    b = unknown.mean + unknown.root @ z
    energy = image_energies(term, absorption, b)
    log_growth = kept.mean_hits @ (np.log(1.0 - absorption) - kept.log_reflected)
    log_growth += kept.log_slopes @ (b - kept.b[0])
    rest = kept.energy * np.exp(np.clip(log_growth, -50.0, 5.0))
    signal = gain * (term.spreading @ energy + rest)
    np.testing.assert_allclose(term.signal(values), signal, rtol=1e-9)
    np.testing.assert_allclose(term.expected(values), signal + kept.noise, rtol=1e-9)
    expected, again, _ = term.predict(values)
    np.testing.assert_allclose(expected, signal + kept.noise, rtol=1e-9)
    np.testing.assert_allclose(again, signal, rtol=1e-9)
    absolute = displaced(-1)
    np.testing.assert_allclose(
        absolute.signal(values | {"gain": np.zeros(0)}), signal / gain, rtol=1e-9
    )


def test_images_have_the_derivatives_of_finite_differences():
    term = displaced()
    kept = term.kept
    values = {
        "absorption": np.linspace(0.3, 0.15, term.hits.shape[1]),
        "gain": np.array([3.0]),
        # about the answer, where what stays is not cut
        DIRECTIVITY: np.linalg.solve(
            kept.directivity.unknown.root, kept.b[0] + 0.01 - kept.directivity.unknown.mean
        ),
    }
    _, _, derivatives = term.predict(values)
    for name, at in values.items():
        for k in range(at.size):
            step = 1e-6 * np.eye(at.size)[k]
            ahead, behind = (term.signal(values | {name: at + s * step}) for s in (1.0, -1.0))
            numeric = (ahead - behind) / 2e-6
            scale = np.abs(numeric).max()
            np.testing.assert_allclose(derivatives[name][:, k], numeric, atol=1e-6 * scale)


def test_the_variance_of_images_is_that_of_their_pieces_and_of_their_times():
    """Written out window by window: pairs of images in a piece, times, rays, and noise."""
    term = displaced()
    kept = replace(term.kept, tracing=np.linspace(1.0, 2.0, term.kept.energy.size))
    term = replace(term, kept=kept)
    observations = tuple(replace(o, timing_sd_s=1e-4) for o in kept.term.observations)
    kept = replace(kept, term=replace(kept.term, observations=observations))
    term = replace(term, kept=kept)
    gain, absorption = 2.0, 1.0 - np.exp(kept.log_reflected)
    z = np.linalg.solve(kept.directivity.unknown.root, kept.b[0] - kept.directivity.unknown.mean)
    values = {"absorption": absorption, "gain": np.array([gain]), DIRECTIVITY: z}
    energy = image_energies(term, absorption, kept.b[0])
    found = term.variance_parts(values)["reflections"]
    ends = [*kept.first_piece, kept.fine_energy.size]
    widths_s = np.concatenate([np.diff(o.fine_edges_s) for o in observations])
    shares, slopes = term.fine_spreading.toarray(), term.squared_slopes.toarray()
    signal = term.signal(values)
    for w in range(kept.energy.size):
        own = 0.0
        for piece in range(ends[w], ends[w + 1]):
            arrived = shares[piece] * energy
            whole = (arrived.sum() + kept.fine_energy[piece]) ** 2 - np.sum(arrived**2)
            own += whole / (kept.term.bandwidth_hz * widths_s[piece])
        own += 1e-8 * float(slopes[w] @ energy**2) + kept.tracing[w]
        noise = kept.background[w, 0] + kept.background[w, 1] * signal[w]
        assert found[w] == pytest.approx(gain**2 * own + noise, rel=1e-9)
