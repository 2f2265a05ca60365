"""An answer in words and tables, for a terminal."""

from __future__ import annotations

import textwrap

import numpy as np

from roomfit.findings import Finding
from roomfit.typing import BoolArray, FloatArray
from roomfit.uncertainty.answer import Answer, ComparedPair

_SHOWN = ("T20_s", "EDT_s", "C80_dB")
_BELOW_BAND = " " * 11
_RELATIVE = ("T20_s", "T30_s", "EDT_s", "TS_ms")


def answer_text(answer: Answer) -> str:
    """Return everything a user must see: absorption, what can be told apart, pairs, findings."""
    parts = [
        absorption_table(answer),
        separable_text(answer),
        shares_table(answer),
        directivity_text(answer),
        certificate_text(answer),
        pairs_table(answer),
        findings_text(answer.findings),
    ]
    return "\n\n".join(p for p in parts if p)


def absorption_table(answer: Answer) -> str:
    """Return absorption with its interval per material and band; ``?`` marks what is not sure."""
    width = max(len(n) for n in (*answer.materials, "room mean"))
    head = "  ".join(f"{f:>13g}" for f in answer.bands.centres_hz)
    lines = [
        f"Absorption, 95 % interval ({answer.interval_kind}); ? = not identifiable",
        f"{'Hz':<{width}}  {head}",
    ]
    for i, name in enumerate(answer.materials):
        cells = [
            _interval_cell(*values, sure=bool(sure))
            for *values, sure in zip(
                answer.absorption[i],
                answer.lower95[i],
                answer.upper95[i],
                answer.identifiable[i],
                strict=True,
            )
        ]
        lines.append(f"{name:<{width}}  " + "  ".join(cells))
    cells = [_interval_cell(*column, sure=True) for column in answer.mean_absorption.T]
    lines.append(f"{'room mean':<{width}}  " + "  ".join(cells))
    return "\n".join(lines)


def separable_text(answer: Answer) -> str:
    """Return in words which materials the data tell apart, band by band."""
    told = any(answer.sentences)
    lines = ["What the data tell" + (" (+-: half of the 95 % interval)" if told else "")]
    for j, centre in enumerate(answer.bands.centres_hz):
        held = answer.lower95[:, j] == answer.upper95[:, j]
        sure = _names(answer.materials, answer.identifiable[:, j] & ~held)
        mean, lower, upper = answer.mean_absorption[:, j]
        known = sure if sure else "no single material"
        if held.any():
            known += f"; given: {_names(answer.materials, held)}"
        fit = "" if answer.phi[j] <= 2.0 else f"; the model does not fit (phi {answer.phi[j]:.1f})"
        lines.append(
            f"{centre:>6g} Hz  identified: {known}; mean of the room {mean:.2f} "
            f"({lower:.2f} to {upper:.2f}){fit}"
        )
        if answer.sentences and answer.sentences[j]:
            lines.append(_below_band(answer.sentences[j]))
    return "\n".join(lines)


def _below_band(sentence: str) -> str:
    return textwrap.fill(sentence, 100, initial_indent=_BELOW_BAND, subsequent_indent=_BELOW_BAND)


def shares_table(answer: Answer) -> str:
    """Return what each material contributes to the room's absorption, in percent."""
    if answer.shares is None:
        return ""
    width = max(len(n) for n in answer.materials)
    head = "  ".join(f"{f:>10g}" for f in answer.bands.centres_hz)
    lines = [
        "Share of the room's absorption in %, 95 % interval (air left out)",
        f"{'Hz':<{width}}  {head}",
    ]
    for i, name in enumerate(answer.materials):
        cells = [
            f"{100 * value:.0f} ({100 * low:.0f}-{100 * high:.0f})"
            for value, low, high in answer.shares[:, i].T
        ]
        lines.append(f"{name:<{width}}  " + "  ".join(f"{cell:>10}" for cell in cells))
    return "\n".join(lines)


def directivity_text(answer: Answer) -> str:
    """Return strength and axis of every source whose directivity was fitted, band by band."""
    lines = []
    for found in answer.directivities:
        lines.append(f"{found.source} sends with the amplitude 1 + b cos of the angle to its axis")
        for centre, b, sd in zip(answer.bands.centres_hz, found.b, found.sd, strict=True):
            length = float(np.linalg.norm(b))
            axis = b / length if length > 0.0 else b
            along = float(np.sqrt(axis**2 @ sd**2)) if length > 0.0 else float(sd.max())
            towards = ", ".join(f"{x:.2f}" for x in axis)
            lines.append(f"{centre:>6g} Hz  b {length:.2f} +- {along:.2f} towards ({towards})")
    return "\n".join(lines)


def certificate_text(answer: Answer) -> str:
    """Return what was proven of the cost in each band, and the places that come near the lowest."""
    lines = []
    for centre, proof in zip(answer.bands.centres_hz, answer.certificates, strict=False):
        if proof is None:
            continue
        lines.append(f"{centre:>6g} Hz  {proof.sentence}")
        for cluster in proof.clusters if len(proof.clusters) > 1 else ():
            at = ", ".join(
                f"{name} {value:.2f}"
                for name, value in zip(proof.coordinates, cluster.minimiser, strict=True)
            )
            lines.append(f"           {cluster.value:.4g} at {at}")
    head = ["Cost of the energies with their weights held:"] if lines else []
    return "\n".join(head + lines)


def _names(materials: tuple[str, ...], chosen: BoolArray) -> str:
    return ", ".join(n for n, c in zip(materials, chosen, strict=True) if c)


def pairs_table(answer: Answer) -> str:
    """Return mean absolute errors of predicted parameters beside the null model's.

    The null model is the mean of the same parameter over the other fitted measurements.
    """
    if not answer.pairs:
        return ""
    lines = [
        "Predicted against measured: mean T20 (measured > predicted), then mean absolute errors "
        "(model | mean of the others)"
    ]
    head = "  ".join(f"{f:>13g}" for f in answer.bands.centres_hz)
    lines.append(f"{'Hz':<16}  {head}")
    for use in ("fit", "validate"):
        pairs = [p for p in answer.pairs if p.use == use]
        if not pairs:
            continue
        lines.append(_decay_line(pairs, use))
        for name in _SHOWN:
            compared = [p.parameters[name] for p in pairs]
            ours = _mean_error(
                name, [c.predicted for c in compared], [c.measured for c in compared]
            )
            null = _mean_error(name, [c.null for c in compared], [c.measured for c in compared])
            unit = "%" if name in _RELATIVE else name.split("_")[1]
            cells = [_pair_cell(a, b) for a, b in zip(ours, null, strict=True)]
            label = f"{name.split('_')[0]} {unit} {_said(use)}"
            lines.append(f"{label:<16}  " + "  ".join(cells))
    return "\n".join(lines)


def _decay_line(pairs: list[ComparedPair], use: str) -> str:
    """Return the mean T20 in seconds, measured > predicted, over pairs that have both."""
    measured = np.array([p.parameters["T20_s"].measured for p in pairs])
    predicted = np.array([p.parameters["T20_s"].predicted for p in pairs])
    both = np.isfinite(measured) & np.isfinite(predicted)
    counts = np.maximum(both.sum(axis=0), 1)
    means = [np.where(both, t, 0.0).sum(axis=0) / counts for t in (measured, predicted)]
    cells = [
        f"{m:5.2f} > {p:5.2f}" if known else f"{'-':>5} > {'-':>5}"
        for m, p, known in zip(*means, both.any(axis=0), strict=True)
    ]
    return f"{'T20 s ' + _said(use):<16}  " + "  ".join(cells)


def _said(use: str) -> str:
    return "fitted" if use == "fit" else "not fitted"


def findings_text(findings: tuple[Finding, ...]) -> str:
    """Return the findings, most serious first; what many files share is told once."""
    order = {"serious": 0, "warning": 1, "info": 2}
    alike: dict[str, list[Finding]] = {}
    for finding in sorted(findings, key=lambda f: order[f.severity]):
        alike.setdefault(finding.code, []).append(finding)
    lines = ["Findings"] if findings else []
    for code, same in alike.items():
        more = f" (and {len(same) - 1} more of this kind in result.json)" if same[1:] else ""
        text = f"{same[0].severity}: {same[0].sentence}{more} [{code}]"
        lines.append(textwrap.fill(text, 100, initial_indent="- ", subsequent_indent="  "))
    return "\n".join(lines)


def _interval_cell(value: float, lower: float, upper: float, *, sure: bool) -> str:
    mark = " " if sure else "?"
    return f"{_short(value)}{mark}{_short(lower)}-{_short(upper)}"


def _short(value: float) -> str:
    """Three characters and a point less: .07, 1.0."""
    return "1.00"[:3] if value >= 0.995 else f"{value:.2f}"[1:]


def _pair_cell(ours: float, null: float) -> str:
    def told(value: float) -> str:
        return f"{value:.1f}" if np.isfinite(value) else "-"

    return f"{told(ours):>5} | {told(null):>5}"


def _mean_error(name: str, guesses: list[FloatArray], measured: list[FloatArray]) -> FloatArray:
    """Mean absolute error over pairs, in percent for times; NaN where nothing can be compared."""
    errors = np.abs(np.array(guesses) - np.array(measured))
    if name in _RELATIVE:
        errors = 100.0 * errors / np.array(measured)
    known = np.isfinite(errors)
    counts = known.sum(axis=0)
    sums = np.where(known, errors, 0.0).sum(axis=0)
    return np.asarray(np.where(counts > 0, sums / np.maximum(counts, 1), np.nan))
