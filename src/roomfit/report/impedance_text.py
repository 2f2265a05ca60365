"""Impedances in words and tables, for a terminal."""

from __future__ import annotations

import numpy as np

from roomfit.impedance.answer import ImpedanceAnswer
from roomfit.impedance.intervals import MaterialAnswer
from roomfit.report.answer_text import findings_text

_ROWS = 8


def impedance_text(answer: ImpedanceAnswer) -> str:
    """Return the verdict, a table of some frequencies for every material, and all findings."""
    weaker = " (a weaker verdict, see the findings)" if answer.verdict.weaker else ""
    parts = [answer.verdict.sentence + weaker]
    if answer.evaluations:
        parts += [_material_text(answer, m) for m in answer.materials]
        parts.append(_fit_text(answer))
    parts.append(findings_text(answer.findings))
    return "\n\n".join(p for p in parts if p)


def _material_text(answer: ImpedanceAnswer, material: MaterialAnswer) -> str:
    f = answer.frequency_hz
    rows = np.unique(np.linspace(0, len(f) - 1, min(_ROWS, len(f))).round().astype(int))
    lines = [
        f"{material.name} ({material.kind})",
        f"  {'Hz':>6}  {'R0':>14}  {'absorption, 95 %':>18}  {'random':>6}  {'Z / rho c':>16}",
    ]
    for i in rows:
        r0, alpha = material.r0[i], material.absorption_normal[i]
        low, up = material.absorption_normal_lower95[i], material.absorption_normal_upper95[i]
        z = material.impedance[i]
        shown = f"{z.real:7.2f} {z.imag:+7.2f}j" if material.impedance_shown[i] else "not narrow"
        mark = " " if material.identified[i] else "?"
        lines.append(
            f"  {f[i]:6.0f}  {r0.real:+.3f} {r0.imag:+.3f}j{mark} {alpha:6.3f} {low:.3f}-{up:.3f}"
            f"    {material.absorption_random[i]:6.3f}  {shown:>16}"
        )
    for name, unit, value, lower, upper in material.parameters:
        lines.append(f"  {name} {value:.4g} {unit}, 95 % {lower:.4g} to {upper:.4g}")
    return "\n".join(lines)


def _fit_text(answer: ImpedanceAnswer) -> str:
    lines = [
        f"{answer.agreeing_starts} of {answer.n_starts} starts agree; residual "
        f"{answer.chi2:.2f} of what was expected; condition number {answer.condition:.0f}; "
        f"{answer.seconds:.1f} s"
    ]
    for n in answer.nuisances:
        if n.unit != "m":
            lines.append(
                f"{n.name}: {n.value:.5g} {n.unit}, 95 % {n.lower95:.5g} to {n.upper95:.5g}"
            )
    moves = [n for n in answer.nuisances if n.unit == "m"]
    if moves:
        size = float(np.sqrt(np.mean([n.value**2 for n in moves])))
        lines.append(f"positions moved by {1000 * size:.1f} mm a coordinate (rms)")
    return "\n".join(lines)
