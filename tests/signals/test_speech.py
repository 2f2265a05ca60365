"""The speech transmission index: closed forms, laws, derivatives, and another program."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roomfit.base.bands import Bands
from roomfit.signals.decay import decay_curve, echogram_decay_curve
from roomfit.signals.response import ImpulseResponse, find_onset
from roomfit.signals.speech import (
    MODULATIONS_HZ,
    SPEECH_BANDS_HZ,
    modulation_gradients,
    modulation_transfer,
    speech_transmission,
    sti_gradients,
    transfer_of_bins,
)

OCTAVES = Bands("octave", np.array(SPEECH_BANDS_HZ))
levels = st.lists(st.floats(-20.0, 110.0), min_size=14, max_size=14).map(
    lambda v: np.array(v).reshape(2, 7)
)


def exponential(decay_s: float) -> np.ndarray:
    """Return the closed form: 13.8 is 6 ln 10."""
    m = 1.0 / np.hypot(1.0, 2.0 * np.pi * MODULATIONS_HZ * decay_s / (6.0 * np.log(10.0)))
    return np.tile(m, (7, 1))


def echogram(decay_s: np.ndarray, length: float = 1.2, bin_s: float = 1e-3):
    edges_s = np.arange(0.0, length * float(np.max(decay_s)), bin_s)
    energy = -np.diff(10.0 ** (-6.0 * edges_s / np.asarray(decay_s)[:, None]), axis=1)
    return echogram_decay_curve(Bands("octave", OCTAVES.centres_hz[: len(decay_s)]), energy,
                                edges_s, 0.0)  # fmt: skip


@pytest.mark.parametrize("length", [0.6, 1.5])
def test_exponential_decays_have_schroeders_transfer(length):
    """Short echograms too, since the rest is extrapolated; bins of 1 ms blur by (pi F 1 ms)^2/6."""
    decay_s = np.array([0.2, 0.5, 1.0, 2.0, 4.0, 0.3, 0.8])
    found = modulation_transfer(echogram(decay_s, length))
    expected = np.stack([exponential(t)[0] for t in decay_s])
    # bins that hold the end of a stretch in part move the tail by less than a thousandth
    np.testing.assert_allclose(found, expected, rtol=1.5e-3)


@pytest.mark.parametrize("length", [0.6, 1.5])
def test_many_echograms_have_the_transfer_of_their_curves(length):
    decay_s = np.array([[0.2, 0.5, 1.0], [2.0, 0.3, 0.8]])
    edges_s = np.arange(0.0, length * 2.0, 1e-3)
    energies = -np.diff(10.0 ** (-6.0 * edges_s / decay_s[..., None]), axis=-1)
    three = Bands("octave", OCTAVES.centres_hz[:3])
    one_by_one = [
        modulation_transfer(echogram_decay_curve(three, e, edges_s, 0.0), 0.0) for e in energies
    ]
    np.testing.assert_allclose(transfer_of_bins(energies, edges_s), one_by_one, rtol=1e-9)


def test_noise_divides_the_modulation_as_the_signal_to_noise_ratio_says():
    """Loud enough that no threshold counts, and bands so that none masks the next."""
    m = exponential(1.0)
    own = np.array([90.0, 30.0, 90.0, 30.0, 90.0, 30.0, 90.0])
    snr = 3.0
    found = speech_transmission(m, np.stack([own, own - snr]))
    loud = np.array([True, False] * 3 + [True])
    expected = m / (1.0 + 10.0 ** (-0.1 * snr))
    # masking at 90 dB is 14.8 dB below its band: 75 dB, of which the quiet bands hold nothing
    expected[~loud] = 0.0
    assert found == pytest.approx(float(speech_transmission(expected)), abs=1e-3)


def test_equal_bands_give_the_mean_transmission_index():
    """The weights less what is common add up to one."""
    m = exponential(1.3)
    level = 10.0 * np.log10(m[0] / (1.0 - m[0]))
    expected = np.mean((np.clip(level, -15.0, 15.0) + 15.0) / 30.0)
    assert float(speech_transmission(m)) == pytest.approx(expected, abs=1e-12)


@given(st.floats(0.1, 10.0), st.floats(0.1, 10.0), st.floats(-10.0, 60.0), st.floats(-10.0, 60.0))
def test_shorter_decays_and_less_noise_never_lower_it(one_s, other_s, noise, more):
    """All bands alike; a single band may, see `speech_transmission`."""
    short, long = sorted((one_s, other_s))
    assert speech_transmission(exponential(short)) >= speech_transmission(exponential(long)) - 1e-12
    speech = np.full(7, 75.0)
    quiet, loud = (np.stack([speech, np.full(7, n)]) for n in sorted((noise, more)))
    m = exponential(short)
    # masking rises with the noise of the lower band: no band gains
    assert speech_transmission(m, quiet) >= speech_transmission(m, loud) - 2e-3


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 10_000))
def test_the_derivatives_are_those_of_finite_differences(seed):
    rng = np.random.default_rng(seed)
    m = rng.uniform(0.1, 0.9, (7, 14))
    at_listener = np.stack([rng.uniform(40.0, 80.0, 7), rng.uniform(20.0, 60.0, 7)])
    for given_levels in (None, at_listener):
        by_transfer, by_level = sti_gradients(m, given_levels)
        toward, step = rng.normal(size=m.shape), 1e-6
        both = [speech_transmission(m + s * step * toward, given_levels) for s in (-1, 1)]
        assert np.sum(by_transfer * toward) == pytest.approx(
            (both[1] - both[0]) / (2 * step), rel=1e-5, abs=1e-8
        )
    for k in range(7):
        moved = np.zeros((2, 7))
        moved[0, k] = 1e-5
        both = [speech_transmission(m, at_listener + s * moved) for s in (-1, 1)]
        assert by_level[k] == pytest.approx((both[1] - both[0]) / 2e-5, rel=1e-4, abs=1e-9)


def test_the_transfers_derivatives_by_energies_are_exact():
    """An echogram of 30 bins that ends 25 dB down, the tail's derivative in it."""
    rng = np.random.default_rng(3)
    edges_s = np.linspace(0.0, 0.4, 31)
    energy = -np.diff(10.0 ** (-6.0 * edges_s / 0.9)) * rng.uniform(0.8, 1.2, 30)
    octave = Bands("octave", np.array([1000.0]))

    def transfer(e):
        return modulation_gradients(echogram_decay_curve(octave, e[None], edges_s, 0.0), 0)

    _, gradients = transfer(energy)
    step = 1e-6 * energy
    for j in range(30):
        moved = np.zeros(30)
        moved[j] = step[j]
        numeric = (transfer(energy + moved)[0] - transfer(energy - moved)[0]) / (2.0 * step[j])
        np.testing.assert_allclose(gradients[:, j], numeric, rtol=1e-4, atol=1e-5)


# IEC 60268-16:2020, tables A.1 and A.2: dB of the threshold of reception; alpha and beta.
THRESHOLD_DB = (46.0, 27.0, 12.0, 6.5, 7.5, 8.0, 12.0)
ALPHA = (0.085, 0.127, 0.230, 0.233, 0.309, 0.224, 0.173)
BETA = (0.085, 0.078, 0.065, 0.011, 0.047, 0.095)


def masking_db(level_db: float) -> float:
    """Return how far below the level of a band it masks the next higher one, A.4.2."""
    if level_db < 63.0:
        return 0.5 * level_db - 65.0
    if level_db < 67.0:
        return 1.8 * level_db - 146.9
    return 0.5 * level_db - 59.8 if level_db < 100.0 else -10.0


@pytest.mark.parametrize("of_all_db", [5.0, 30.0, 55.0, 64.0, 67.0, 85.0, 100.0])
def test_the_index_is_that_of_the_standard_written_out_band_by_band(of_all_db):
    """Levels about and on the joints of the masking's lines; modulations beyond +-15 dB as well."""
    m = np.linspace(0.01, 0.995, 98).reshape(7, 14)[:, ::-1]
    speech = of_all_db + np.array([0.0, -1.0, 1.0, 0.0, 2.0, -2.0, 0.0])
    noise = np.array([3.0, -np.inf, 9.0, 15.0, -np.inf, 1.0, 20.0])
    mti = []
    for band in range(7):
        own, other = 10.0 ** (speech[band] / 10.0), 10.0 ** (noise[band] / 10.0)
        other += 10.0 ** (THRESHOLD_DB[band] / 10.0)
        if band:
            below = sum(10.0 ** (x[band - 1] / 10.0) for x in (speech, noise))
            other += below * 10.0 ** (masking_db(10.0 * np.log10(below)) / 10.0)
        heard = m[band] * own / (own + other)
        snr = np.clip(10.0 * np.log10(heard / (1.0 - heard)), -15.0, 15.0)
        mti.append(float(np.mean((snr + 15.0) / 30.0)))
    wanted = sum(a * x for a, x in zip(ALPHA, mti, strict=True))
    wanted -= sum(b * (x * y) ** 0.5 for b, x, y in zip(BETA, mti, mti[1:], strict=False))
    found = float(speech_transmission(m, np.stack([speech, noise])))
    assert found == pytest.approx(wanted, rel=1e-9)


@pytest.mark.slow
def test_pyrato_finds_nearly_the_same_of_measured_responses(real_data):
    """R3VIVAL's first ring in two states, noise in pyrato's: within a third of a jnd."""
    pyrato, pyfar = pytest.importorskip("pyrato.parameters"), pytest.importorskip("pyfar")
    soundfile = pytest.importorskip("soundfile")
    for name in ("000_S000_200", "000_S120_200", "100_S000_200", "100_S240_200"):
        samples, rate_hz = soundfile.read(real_data / "r3vival" / f"{name}.wav")
        response = ImpulseResponse(samples[:, 0], rate_hz)
        curve = decay_curve(OCTAVES, response, find_onset(response))
        found = float(speech_transmission(modulation_transfer(curve)))
        # pyrato asks for 1.6 s
        padded = pyfar.Signal(np.pad(samples[:, 0], (0, rate_hz)), rate_hz)
        theirs = pyrato.speech_transmission_index_indirect(padded)
        assert found == pytest.approx(float(theirs[0]), abs=0.01), name
