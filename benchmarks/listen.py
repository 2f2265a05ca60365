"""`roomfit listen` on a measured room whose change is known: is the made response as predicted?

    python benchmarks/listen.py DATA [--step DEGREES] [--rings 150 200] [--seed SEED] [--out DIR]

DATA holds `r3vival` (one room in three states of its wall panels, Amengual Gari and others), which
does not come with roomfit. States 000 and 100 are fitted together, floor and ceiling as one; every
response of state 000 is made into one of state 100 by the absorption that was found of the four
walls with their panels turned.

Printed by octave, judged from 250 Hz up since below single modes decide: EDT, T20, T30 and C50 of
the made responses beside what is predicted of them (measured in 000, and the change,
and by the model alone) and beside what was measured in 100. --out writes WAV files of both states
and of the made one.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import soundfile

import roomfit
from known_changes import BANDS, JUDGED_HZ, fitted, panels, r3vival_together
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.fit.measurements import observe
from roomfit.predict.changes import Change
from roomfit.predict.listen import ChangedResponse, listen
from roomfit.predict.predict import predict
from roomfit.predict.prediction import Predicted
from roomfit.predict.question import Question
from roomfit.result import absorption_posterior
from roomfit.room.scene import Scene
from roomfit.signals.decay import PARAMETER_NAMES, ParameterName
from roomfit.signals.measurement import Measurement

SHOWN: tuple[ParameterName, ...] = ("EDT_s", "T20_s", "T30_s", "C50_dB")


def parameters_of(
    scene: Scene, measured: Sequence[Measurement], made: Sequence[ChangedResponse]
) -> FloatArray:
    """Return the room parameters of the made responses, (n_pairs, n_names, n_bands)."""
    again = [
        Measurement(m.source, m.receiver, c.samples, m.sampling_rate_hz, time_zero="unknown")
        for m, c in zip(measured, made, strict=True)
    ]
    return np.array([o.parameters.values for o in observe(scene, again, BANDS)[0]])


def error_lines(
    found: FloatArray, carried: Predicted, truth: Predicted, judged: BoolArray
) -> list[str]:
    """Return the errors of every parameter in the mean and pair by pair."""
    lines = []
    for name in SHOWN:
        row = found[:, PARAMETER_NAMES.index(name)]
        values = [p.parameters[name] for p in carried.pairs]
        others = {
            "predicted": np.array([v.predicted for v in values]),
            "measured in state 100": np.array([p.parameters[name].measured for p in truth.pairs]),
        }
        before = np.array([v.measured for v in values])
        unit = "dB" if name == "C50_dB" else "%"
        limit = 1.0 if name == "C50_dB" else 5.0
        for label, other in others.items():
            if name == "C50_dB":
                mean, apart = np.nanmean(row, 0) - np.nanmean(other, 0), row - other
                none = np.nanmean(before, 0) - np.nanmean(other, 0)
            else:
                mean = 100.0 * (np.nanmean(row, 0) / np.nanmean(other, 0) - 1.0)
                apart = 100.0 * (row / other - 1.0)
                none = 100.0 * (np.nanmean(before, 0) / np.nanmean(other, 0) - 1.0)
            pairs = np.abs(apart[:, judged])
            lines.append(
                f"{name[:3]:4}made - {label:30}"
                + "".join(f"{e:8.2f}" for e in mean)
                + f" {unit}; by pair median {np.nanmedian(pairs):.2f}, "
                f"{100.0 * np.mean(pairs[np.isfinite(pairs)] < limit):.0f} % within {limit:g}"
                f"; unchanged {np.abs(none[judged]).max():.1f}"
            )
    return lines


def main() -> None:
    """Fit both states, make the second of the first, and print how far it is from the truth."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else None)
    parser.add_argument("data", nargs="?", type=Path)
    parser.add_argument("--step", type=int, default=30, help="degrees between loudspeakers")
    parser.add_argument("--rings", nargs="+", default=["150", "200"], help="distances in cm")
    parser.add_argument("--seed", type=int, default=1, help="of the rays")
    parser.add_argument("--out", type=Path, help="folder for WAV files")
    asked = parser.parse_args()
    if asked.data is None:
        print("no folder of measurements given: nothing to do")
        return
    settings = roomfit.Settings(model="energy", seed=asked.seed)
    case = r3vival_together(asked.data, ("000", "100"), (), asked.step, asked.rings)
    result = fitted("r3vival 000 and 100", case, None, settings, product_sd=0.3)
    scene, measurements, _ = case
    measured, other = ([m for m in measurements if m.state == s] for s in ("", "100"))
    posterior = absorption_posterior(result)
    changes = [
        Change(one, "catalogue", entry=two)
        for one, two in zip(panels("000").values(), panels("100").values(), strict=True)
        if one != two
    ]
    made, _ = listen(Question(scene, posterior, changes, measured, settings=settings))
    carried = predict(Question(scene, posterior, changes, measured, settings=settings))
    there = replace(scene, pair_state=np.ones(len(scene.pairs), dtype=np.int64))
    truth = predict(Question(there, posterior, (), other, settings=settings))
    found = parameters_of(scene, measured, made)
    print(f"\n{len(made)} responses made; error of the mean by octave, Hz:" +
          "".join(f"{f:8g}" for f in BANDS.centres_hz))  # fmt: skip
    print("\n".join(error_lines(found, carried, truth, BANDS.centres_hz > JUDGED_HZ)))
    ends = np.nanmedian([c.noise_from_s for c in made], axis=0)
    print("noise carries the tail from " + " ".join(f"{t:.2f}" for t in ends) + " s on (median)")
    same = listen(Question(scene, posterior, (), measured[:1], settings=settings))[0][0].samples
    print("unchanged, bit by bit:", bool(np.array_equal(same, measured[0].response.pressure)))
    if asked.out is not None:
        asked.out.mkdir(parents=True, exist_ok=True)
        for m, c, t in zip(measured, made, other, strict=True):
            for kind, samples in (
                ("000", m.response.pressure),
                ("made", c.samples),
                ("100", t.response.pressure),
            ):
                rate = round(m.response.sampling_rate_hz)
                soundfile.write(
                    asked.out / f"{m.source}_{kind}.wav", samples, rate, subtype="FLOAT"
                )


if __name__ == "__main__":
    main()
