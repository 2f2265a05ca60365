"""Walls and spectra in pictures: reflection, absorption, impedance; measured and predicted.

result.json and impedance.csv of ``roomfit impedance``, format_version 1.

Impedances in words and tables, for a terminal.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from roomfit.cache import write_json_atomically, write_text_atomically
from roomfit.impedance.result import ImpedanceAnswer, MaterialAnswer
from roomfit.io.encoding import (
    csv_text,
    finding_content,
    number_or_null,
    numbers_or_null,
    provenance,
)
from roomfit.report.figures import OKABE_ITO, new_figure
from roomfit.report.text import findings_text
from roomfit.typing import ComplexArray, FloatArray

_COLUMNS = (
    "r0_real", "r0_imag", "absorption_normal", "absorption_random",
    "admittance_real", "admittance_imag", "z_real", "z_imag",
)  # fmt: skip


def write_impedance(folder: Path, answer: ImpedanceAnswer, inputs: Iterable[Path]) -> None:
    """Write ``result.json`` and ``impedance.csv`` into a folder.

    Raises
    ------
    StoreError
        The disk refuses.
    """
    write_text_atomically(folder / "impedance.csv", impedance_csv(answer))
    write_json_atomically(folder / "result.json", impedance_content(answer, inputs))


def impedance_content(answer: ImpedanceAnswer, inputs: Iterable[Path]) -> dict[str, Any]:
    """Return what result.json holds: lists as long as frequency_hz, null where Z is not shown."""
    return {
        "format": "roomfit-impedance",
        "format_version": 1,
        "frequency_hz": answer.frequency_hz,
        "tau_s": answer.tau_s,
        "materials": {m.name: _material(answer, m) for m in answer.materials},
        "nuisances": [
            {
                "name": n.name,
                "unit": n.unit,
                "value": float(n.value),
                "lower95": float(n.lower95),
                "upper95": float(n.upper95),
                "prior_sd": float(n.prior_sd),
            }
            for n in answer.nuisances
        ],
        "verdict": {
            "word": answer.verdict.word,
            "cause": answer.verdict.cause,
            "sentence": answer.verdict.sentence,
            "weaker": answer.verdict.weaker,
        },
        "findings": [finding_content(f) for f in answer.findings],
        "pairs": [_pair(answer, i) for i in range(len(answer.pairs))],
        "fit": {
            "chi2": number_or_null(answer.chi2),
            "model_error": number_or_null(answer.model_error),
            "condition": number_or_null(answer.condition),
            "starts": answer.n_starts,
            "agreeing_starts": answer.agreeing_starts,
            "ending": answer.ending,
            "evaluations": answer.evaluations,
            "rounds": answer.rounds,
            "seconds": round(answer.seconds, 3),
            "seed": answer.seed,
        },
        "provenance": provenance(inputs),
    }


def _material(answer: ImpedanceAnswer, material: MaterialAnswer) -> dict[str, Any]:
    content: dict[str, Any] = {"frequency_hz": answer.frequency_hz, "model": material.kind}
    for name in _COLUMNS:
        for ending in ("", "_lower95", "_upper95"):
            content[name + ending] = numbers_or_null(_column(material, name, ending))
    content["identified"] = [bool(b) for b in material.identified]
    content["parameters"] = {
        name: {"unit": unit, "value": value, "lower95": lower, "upper95": upper}
        for name, unit, value, lower, upper in material.parameters
    }
    return content


def _column(material: MaterialAnswer, name: str, ending: str) -> np.ndarray[Any, Any]:
    field, _, axis = name.rpartition("_")
    if axis not in ("real", "imag"):
        return np.asarray(getattr(material, name + ending))
    values: ComplexArray = getattr(material, {"z": "impedance"}.get(field, field) + ending)
    return np.asarray(values.real if axis == "real" else values.imag)


def _pair(answer: ImpedanceAnswer, i: int) -> dict[str, Any]:
    fitted = answer.evaluations > 0
    measured, predicted = answer.measured[i], answer.predicted[i]
    return {
        "source": answer.pairs[i][0],
        "receiver": answer.pairs[i][1],
        "measured_real": measured.real,
        "measured_imag": measured.imag,
        "predicted_real": predicted.real if fitted else None,
        "predicted_imag": predicted.imag if fitted else None,
        "expected_rms": answer.expected_rms[i],
    }


def impedance_csv(answer: ImpedanceAnswer) -> str:
    """Return one row a material and frequency; cells of Z are empty where it is not shown."""
    names = [n + e for n in _COLUMNS for e in ("", "_lower95", "_upper95")]
    rows = []
    for material in answer.materials:
        columns = [_column(material, n, e) for n in _COLUMNS for e in ("", "_lower95", "_upper95")]
        for j, frequency in enumerate(answer.frequency_hz):
            cells = [f"{c[j]:.6g}" if np.isfinite(c[j]) else "" for c in columns]
            identified = "true" if material.identified[j] else "false"
            rows.append([material.name, f"{frequency:g}", *cells, identified])
    return csv_text(["material", "frequency_hz", *names, "identified"], rows)


def wall_figure(
    answer: ImpedanceAnswer, material: MaterialAnswer, true_r0: ComplexArray | None = None
) -> Figure:
    """Return |R0|, its phase, absorption and impedance of a material, with 95 % bands.

    Impedance is drawn only where its interval is narrow. `true_r0` is drawn in black dashes.
    """
    f = answer.frequency_hz
    figure = new_figure(8.6, 5.6)
    panels = figure.subplots(2, 2, sharex=True)
    size, angle = panels[0]
    _reflection(size, angle, f, material)
    absorbed, z = panels[1]
    for name, label, colour in (
        ("absorption_normal", "normal incidence", OKABE_ITO[0]),
        ("absorption_random", "random incidence", OKABE_ITO[1]),
    ):
        lower, upper = (getattr(material, f"{name}_{end}95") for end in ("lower", "upper"))
        _band(absorbed, f, getattr(material, name), lower, upper, colour, label)
    absorbed.set_ylabel("absorption coefficient")
    absorbed.set_ylim(-0.02, 1.02)
    absorbed.legend(frameon=False, fontsize=8)
    value, low, up = (
        material.impedance,
        material.impedance_lower95,
        material.impedance_upper95,
    )
    _band(z, f, value.real, low.real, up.real, OKABE_ITO[0], "real part")
    _band(z, f, value.imag, low.imag, up.imag, OKABE_ITO[1], "imaginary part")
    z.set_ylabel("impedance over that of air")
    if material.impedance_shown.any():
        z.legend(frameon=False, fontsize=8)
    else:
        z.text(
            0.5, 0.5, "interval wider than 20 %\nat every frequency",
            ha="center", va="center", transform=z.transAxes,
        )  # fmt: skip
    if true_r0 is not None:
        _truth(panels, f, true_r0, material)
    for axes in panels.ravel():
        axes.grid(alpha=0.25)
        _frequency_axis(axes, f)
    figure.supxlabel("frequency (Hz)")
    weaker = " (a weaker verdict)" if answer.verdict.weaker else ""
    title = f"{material.name}, {material.kind}: {answer.verdict.word}{weaker}; bands hold 95 %"
    figure.suptitle(title)
    return figure


def _reflection(size: Axes, angle: Axes, f: FloatArray, material: MaterialAnswer) -> None:
    # |R0| has the interval of 1 - |R0|**2
    lower = np.sqrt(1.0 - material.absorption_normal_upper95)
    upper = np.sqrt(1.0 - material.absorption_normal_lower95)
    _band(size, f, np.abs(material.r0), lower, upper, OKABE_ITO[0], None)
    size.set_ylabel("|R0|")
    size.set_ylim(-0.02, 1.02)
    reach = 0.5 * (material.r0_upper95 - material.r0_lower95)
    phase = np.angle(material.r0)
    across = np.hypot(np.sin(phase) * reach.real, np.cos(phase) * reach.imag)
    turn = np.degrees(np.minimum(across / np.maximum(np.abs(material.r0), 1e-9), np.pi))
    degrees = np.degrees(np.unwrap(phase))
    _band(angle, f, degrees, degrees - turn, degrees + turn, OKABE_ITO[0], None)
    angle.set_ylabel("phase of R0 (degrees)")


def _truth(
    panels: np.ndarray[tuple[int, int], np.dtype[np.object_]],
    f: FloatArray,
    r0: ComplexArray,
    material: MaterialAnswer,
) -> None:
    from roomfit.impedance.laws import absorption_normal, absorption_random, impedance_of_r0

    z = np.where(material.impedance_shown, impedance_of_r0(r0), np.nan)
    for axes, values in (
        (panels[0, 0], np.abs(r0)),
        (panels[0, 1], np.degrees(np.unwrap(np.angle(r0)))),
        (panels[1, 0], absorption_normal(r0)),
        (panels[1, 0], absorption_random(r0)),
        (panels[1, 1], z.real),
        (panels[1, 1], z.imag),
    ):
        axes.plot(f, values, color="black", lw=1.0, ls=(0, (4, 3)))
    panels[0, 0].plot([], [], color="black", lw=1.0, ls=(0, (4, 3)), label="true")
    panels[0, 0].legend(frameon=False, fontsize=8)


def spectra_figure(answer: ImpedanceAnswer, pairs: Sequence[int]) -> Figure:
    """Return measured and predicted levels of some pairs, and how far they differ."""
    n = len(pairs)
    columns = min(n, 2)
    rows = -(-n // columns)
    figure = new_figure(4.6 * columns, 2.2 * rows + 0.6)
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    loudest = float(np.abs(answer.measured).max())
    for axes, i in zip(panels.ravel(), pairs, strict=False):
        f = answer.frequency_hz
        off = np.abs(answer.measured[i] - answer.predicted[i])
        axes.plot(f, _db(answer.measured[i], loudest), color="black", lw=1.6, label="measured")
        axes.plot(
            f, _db(answer.predicted[i], loudest), color=OKABE_ITO[1], lw=1.6, ls="--",
            label="predicted",
        )  # fmt: skip
        axes.plot(f, _db(off, loudest), color=OKABE_ITO[0], lw=1.0, label="difference")
        axes.plot(
            f, _db(answer.expected_rms[i], loudest), color=OKABE_ITO[2], lw=1.2, ls=":",
            label="difference expected (rms)",
        )  # fmt: skip
        axes.set_title(" to ".join(answer.pairs[i]), fontsize=9)
        axes.grid(alpha=0.25)
        _frequency_axis(axes, f)
    for axes in panels.ravel()[n:]:
        axes.set_visible(False)
    panels[0, 0].set_ylim(-80.0, 5.0)
    figure.supxlabel("frequency (Hz)")
    figure.supylabel("level (dB, 0 is the loudest measured)")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4, frameon=False, fontsize=8)
    return figure


def _db(values: ComplexArray | FloatArray, reference: float) -> FloatArray:
    return np.asarray(20.0 * np.log10(np.maximum(np.abs(values), 1e-9 * reference) / reference))


def _band(
    axes: Axes,
    f: FloatArray,
    value: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    colour: str,
    label: str | None,
) -> None:
    if len(f) == 1:
        bars = np.array([value - lower, upper - value])
        axes.errorbar(f, value, yerr=np.maximum(bars, 0.0), fmt="o", color=colour, label=label)
        return
    axes.fill_between(f, lower, upper, color=colour, alpha=0.25, lw=0.0)
    axes.plot(f, value, color=colour, lw=1.6, label=label)


def _frequency_axis(axes: Axes, f: FloatArray) -> None:
    if len(f) == 1:
        return
    axes.set_xlim(float(f[0]), float(f[-1]))


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
