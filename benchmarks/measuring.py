"""What microphones, loudspeakers and noise do to absorption that was measured with sweeps.

    python benchmarks/measuring.py [--seed SEED] [--chains NAME ...]

The demo's campaign, simulated without the model that is fitted, here without noise. Its eight
responses are measured anew: the sweeps of `roomfit measure` go through the loudspeaker, the room,
a delay that differs from file to file, noise and the microphone, and are deconvolved; the first
row is the files as they were simulated. Each row has a first answer (``--quick``) of its own:
range of the decay in the worst of the octaves from 125 Hz to 4 kHz, how many responses `roomfit
measure` wants again, mean error and width of the intervals of what is identifiable, how many
coefficients that is, how many intervals hold the truth, and the serious findings. The baseline is
one absorption for all walls.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import soundfile
from scipy.signal import fftconvolve, firwin2, minimum_phase

from roomfit.base.errors import InputError
from roomfit.base.typing import FloatArray
from roomfit.cli.commands import identify_to_folder
from roomfit.demo.boxes import (
    PLAN_BANDS,
    POSITION_ERROR_M,
    SAMPLING_RATE_HZ,
    demo_plan,
    pressure_response,
    true_box,
    write_box_campaign,
)
from roomfit.files.responses.sweep import (
    SweepPlan,
    SweepResponse,
    excitation,
    response_from_recording,
    wav_bytes,
)

_PLAN = SweepPlan(SAMPLING_RATE_HZ, seconds=4.0, silence_s=2.0, repetitions=2)
_DURATION_S = 1.5  # of a simulated response
_PEAK = 0.3  # of the loudest recording
_NOISE_DB = -75.0  # rms of the background, where nothing else is said; full scale 0
# A phone: no bass, a bump, a hole, a fall.
_COLOUR_HZ = (0.0, 60.0, 120.0, 250.0, 1000.0, 3000.0, 5000.0, 7000.0, 9000.0, 14_000.0)
_COLOUR_DB = (-40.0, -18.0, -9.0, -2.0, 0.0, 0.0, 6.0, -4.0, 8.0, -10.0)

Chain = Callable[[FloatArray, FloatArray, float, np.random.Generator], FloatArray]


def recorded(
    played: FloatArray, response: FloatArray, gain: float, rng: np.random.Generator
) -> FloatArray:
    """Return the sweeps through a room and a delay of 5 to 60 ms, without noise."""
    late = np.concatenate([np.zeros(rng.integers(160, 1920)), gain * response])
    return np.asarray(fftconvolve(played, late)[: len(played)])


def noisy(level_db: float) -> Chain:
    def chain(
        played: FloatArray, response: FloatArray, gain: float, rng: np.random.Generator
    ) -> FloatArray:
        x = recorded(played, response, gain, rng)
        return np.asarray(x + 10.0 ** (level_db / 20.0) * rng.normal(size=len(x)))

    return chain


def coloured(share: float) -> Chain:
    """Return a microphone with a share of a phone's decibels, of minimum phase as they are."""
    at, level = np.array(_COLOUR_HZ), 10.0 ** (share * np.array(_COLOUR_DB) / 20.0)
    rate_hz = _PLAN.sampling_rate_hz
    even = firwin2(8191, [*at, 0.5 * rate_hz], [*level, level[-1]], fs=rate_hz)
    taps = minimum_phase(even, method="homomorphic", half=False)

    def chain(
        played: FloatArray, response: FloatArray, gain: float, rng: np.random.Generator
    ) -> FloatArray:
        x = noisy(_NOISE_DB)(played, response, gain, rng)
        return np.asarray(fftconvolve(x, taps)[: len(x)])

    return chain


def distorted(
    played: FloatArray, response: FloatArray, gain: float, rng: np.random.Generator
) -> FloatArray:
    """A loudspeaker with 5 % of the second and of the third harmonic."""
    share = played / 0.5
    return noisy(_NOISE_DB)(0.5 * (share + 0.1 * share**2 - 0.2 * share**3), response, gain, rng)


def automatic(
    played: FloatArray, response: FloatArray, gain: float, rng: np.random.Generator
) -> FloatArray:
    """A gain that follows the level of the last 300 ms, at half its decibels."""
    x = noisy(_NOISE_DB)(played, response, gain, rng)
    n = round(0.3 * _PLAN.sampling_rate_hz)
    power = fftconvolve(x**2, np.exp(-np.arange(5 * n) / n) / n)[: len(x)]
    return np.asarray(x * np.maximum(power, 1e-7) ** -0.25 * 0.05)


def other_clock(
    played: FloatArray, response: FloatArray, gain: float, rng: np.random.Generator
) -> FloatArray:
    """A recording whose clock is fast by 50 parts in a million."""
    x = noisy(_NOISE_DB)(played, response, gain, rng)
    at = np.arange(len(x))
    return np.asarray(np.interp(at * (1.0 + 5e-5), at, x))


CHAINS: dict[str, Chain | None] = {
    "files as simulated": None,
    "a good chain, background -75 dBFS": noisy(_NOISE_DB),
    "background -55 dBFS": noisy(-55.0),
    "background -50 dBFS": noisy(-50.0),
    "background -40 dBFS": noisy(-40.0),
    "a microphone with +1 to -1 dB of colour": coloured(0.12),
    "a microphone with +8 to -18 dB of colour": coloured(1.0),
    "a loudspeaker with 5 % of harmonics": distorted,
    "automatic gain": automatic,
    "two clocks, 50 ppm apart": other_clock,
}


def simulate(folder: Path, rng: np.random.Generator) -> None:
    """Write the demo's campaign without noise; positions are a centimetre off, as there."""
    plan = demo_plan()
    box, true_at = true_box(plan, POSITION_ERROR_M, rng)
    levels_db = {source: rng.normal(0.0, 3.0, len(PLAN_BANDS)) for source in plan.sources_m}
    responses = {
        (s, r): pressure_response(
            box, true_at[s], true_at[r], _DURATION_S, SAMPLING_RATE_HZ, levels_db[s]
        )
        for s in plan.sources_m
        for r in plan.receivers_m
    }
    write_box_campaign(plan, folder, responses)


def measured(folder: Path, chain: Chain, rng: np.random.Generator) -> list[SweepResponse]:
    """Replace the files of a campaign by what is measured of them."""
    files = {f: soundfile.read(f)[0] for f in sorted(folder.glob("*.wav"))}
    played = excitation(_PLAN)
    loudest = max(
        float(np.abs(fftconvolve(played[: round(6.0 * SAMPLING_RATE_HZ)], h)).max())
        for h in files.values()
    )
    found = []
    for file, response in files.items():
        own = response_from_recording(_PLAN, chain(played, response, _PEAK / loudest, rng))
        file.write_bytes(wav_bytes(own.response))
        found.append(own)
    campaign = folder / "campaign.toml"
    campaign.write_text(f'{campaign.read_text()}\n[defaults]\ntime_zero = "direct"\n')
    return found


def row(name: str, folder: Path, responses: list[SweepResponse]) -> str:
    """Identify, and return what is found beside the truth."""
    answer = identify_to_folder(folder / "campaign.toml", folder / "result", quick=True)
    plan = demo_plan()
    at = [int(np.argmin(np.abs(PLAN_BANDS.centres_hz - f))) for f in answer.bands.centres_hz]
    truth = plan.absorption[np.ix_([plan.materials.index(m) for m in answer.materials], at)]
    good = answer.identifiable
    error = np.abs(answer.absorption - truth)
    baseline = np.abs(answer.mean_absorption[0] - truth)
    inside = (answer.lower95 <= truth) & (truth <= answer.upper95)
    width = (answer.upper95 - answer.lower95)[good]
    least = min((float(r.range_db[:6].min()) for r in responses), default=np.nan)
    again = sum(bool(r.again) for r in responses)
    serious = Counter(f.code.value for f in answer.findings if f.severity == "serious")
    numbers = [
        f"{least:.0f}" if responses else "",
        f"{again} of {len(responses)}" if responses else "",
        f"{error[good].mean():.3f}" if good.any() else "",
        f"{baseline[good].mean():.3f}" if good.any() else "",
        f"{width.mean():.2f}" if good.any() else "",
        f"{good.sum()} of {good.size}",
        f"{inside.sum()}",
        ", ".join(serious),
    ]
    return f"| {name} | {' | '.join(numbers)} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--chains", nargs="*", default=list(CHAINS))
    options = parser.parse_args()
    print(
        "| chain | range, dB | again | error | baseline | width | identifiable | held | serious |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as place:
        base = Path(place) / "base"
        base.mkdir()
        simulate(base, np.random.default_rng(options.seed))
        for i, name in enumerate(options.chains):
            chain, folder = CHAINS[name], Path(place) / str(i)
            shutil.copytree(base, folder)
            rng = np.random.default_rng(options.seed)
            try:
                responses = [] if chain is None else measured(folder, chain, rng)
            except InputError as error:
                print(f"| {name} | | refused: {error.what} | | | | | | |", flush=True)
                continue
            print(row(name, folder, responses), flush=True)
            for reason in sorted({reason for r in responses for reason in r.again}):
                print(f"    {reason}")


if __name__ == "__main__":
    main()
