"""What `roomfit impedance` says of measured rooms: `python benchmarks/impedance_measured.py DATA`.

DATA as of `measured_rooms.py`. Nobody knows the impedances of these walls; what is shown is the
verdict, how much of the pressure is explained, and what a null model without reflections (direct
sound alone, with the same free spectrum and gains) and one with rigid walls leave.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

from measured_rooms import DELFT_SHIFT_M, bras_campaign, dechorate_campaign, delft_campaign
from roomfit.files.campaign import read_campaign
from roomfit.impedance.campaign import identify_campaign_impedance, impedance_arguments
from roomfit.impedance.identify import wave_problem
from roomfit.impedance.problem import source_spectra
from roomfit.impedance.wave_model import at_rest, predicted_pressure

TAU_S = 0.012
_ALTERNATIONS = 30


def left_over(campaign_file: Path, r0: float) -> float:
    """Share of the squared pressure that walls of one R0 leave.

    The spectrum of the source and a gain of each pair are fitted in turn.
    """
    measured, _ = impedance_arguments(read_campaign(campaign_file))
    problem = wave_problem(measured["scene"], measured["observed"], None, measured["nuisances"])
    walls = np.full(
        (len(measured["walls"]), len(measured["observed"].frequency_hz)), r0, dtype=complex
    )
    p = predicted_pressure(problem.model, walls, at_rest(problem.model), spherical=False)
    d = measured["observed"].pressure
    own = np.ones((len(d), 1), dtype=complex)
    for _ in range(_ALTERNATIONS):
        gain = source_spectra(problem, own * p)
        model = gain * p
        own = np.sum(np.conj(model) * d, axis=1) / np.sum(np.abs(model) ** 2, axis=1)
        own = own[:, None]
    return float(np.sum(np.abs(d - own * gain * p) ** 2) / np.sum(np.abs(d) ** 2))


def show(name: str, text: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "campaign.toml"
        file.write_text(text)
        answer = identify_campaign_impedance(read_campaign(file))
        if answer.evaluations == 0:
            print(f"{name}: {answer.verdict.sentence} {answer.findings[-1].sentence}", flush=True)
            return
        rigid = left_over(file, 0.999)
        soft = left_over(file, 0.0)
    whole = np.sum(np.abs(answer.measured) ** 2)
    share = np.sum(np.abs(answer.measured - answer.predicted) ** 2) / whole
    expected = np.sum(answer.expected_rms**2) / whole
    print(f"{name}: {answer.verdict.word}; {answer.verdict.sentence}")
    print(
        f"   left of the squared pressure: {100 * share:.1f} %; rigid walls {100 * rigid:.0f} %, "
        f"no walls {100 * soft:.0f} %; expected {100 * expected:.2f} %; "
        f"{answer.agreeing_starts} of {answer.n_starts} starts agree, "
        f"{answer.seconds:.0f} s"
    )
    for m in answer.materials:
        alpha = m.absorption_normal
        print(
            f"   {m.name}: absorption {alpha.min():.2f} to {alpha.max():.2f}, identified at "
            f"{100 * np.mean(m.identified):.0f} % of frequencies"
        )
    for finding in answer.findings:
        print(f"   {finding.severity} {finding.code}")
    sys.stdout.flush()


def six_walls(text: str) -> str:
    """Return a campaign with each wall of its box a material of its own."""
    for wall in ("west", "east", "south", "north"):
        text = text.replace(f'{wall} = "walls"', f'{wall} = "{wall}"')
    return text


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, nargs="?")
    data: Path | None = parser.parse_args().data
    if data is None:
        print("no folder of measurements given: nothing to do")
        return
    three = dechorate_campaign(data / "dechorate", ())
    delft = delft_campaign(data / "tudelft_inhouse", 7, DELFT_SHIFT_M)
    for name, text, low, high in (
        ("CR2 (BRAS), its one response", bras_campaign(data / "bras_cr2"), 100, 400),
        ("dEchorate, three materials", three, 100, 400),
        ("dEchorate, six walls", six_walls(three), 100, 400),
        ("dEchorate, three materials", three, 200, 800),
        ("TU Delft, four loudspeakers by eight microphones", delft, 100, 400),
    ):
        band = f"from_hz = {low}\nto_hz = {high}\ntau_s = {TAU_S}\nrandom_starts = 1\n"
        show(f"{name}, {low} to {high} Hz", text + "[impedance]\n" + band)


if __name__ == "__main__":
    main()
