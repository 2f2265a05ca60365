"""The files of ``roomfit impedance``: result.json, impedance.csv (format_version 1), figures."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase

from roomfit.base.table import Column, Table, Value, csv_of
from roomfit.base.typing import ComplexArray, FloatArray
from roomfit.base.whole_files import (
    whole_output_folder,
    write_bytes_atomically,
    write_json_atomically,
    write_text_atomically,
)
from roomfit.files.encoding import (
    finding_content,
    number_or_null,
    numbers_or_null,
    provenance,
)
from roomfit.report.figures import new_figure, png
from roomfit.report.wording import OKABE_ITO

if TYPE_CHECKING:
    from roomfit.impedance.result import ImpedanceResult, MaterialImpedance

# What the command writes, and so may remove when it writes over an earlier result.
_PAIRS_A_PICTURE = 6
_MOST_PICTURES = 6


def write_impedance(
    out: Path, result: ImpedanceResult, inputs: Iterable[Path], *, overwrite: bool = False
) -> None:
    """Write result.json, impedance.csv and pictures into a folder, all of it or nothing.

    Parameters
    ----------
    inputs : iterable of Path
        Files whose digests result.json shall name.
    overwrite : bool
        Write into a folder that is not empty, after removing an earlier result.

    Raises
    ------
    InputError
        The folder is not empty, and `overwrite` is false.
    StoreError
        The disk refuses.
    """
    with whole_output_folder(out, overwrite=overwrite) as folder:
        write_text_atomically(folder / "impedance.csv", csv_of(impedance_records(result)))
        write_json_atomically(folder / "result.json", impedance_content(result, inputs))
        for material in result.materials:
            # without what a path gives a meaning to
            name = "".join(c if c.isalnum() or c in "-_." else "_" for c in material.name)[:60]
            picture = png(walls_figure(result, [material]))
            write_bytes_atomically(folder / f"impedance_{name}.png", picture)
        firsts = range(0, len(result.pairs) if result.evaluations else 0, _PAIRS_A_PICTURE)
        for number, first in enumerate(firsts[:_MOST_PICTURES], start=1):
            own = range(len(result.pairs))[first : first + _PAIRS_A_PICTURE]
            write_bytes_atomically(
                folder / f"spectra_{number}.png", png(spectra_figure(result, own))
            )


def impedance_content(result: ImpedanceResult, inputs: Iterable[Path]) -> dict[str, Any]:
    """Return what result.json holds: lists as long as frequency_hz, null where Z is not shown."""
    return {
        "format": "roomfit-impedance",
        "format_version": 1,
        "frequency_hz": result.frequency_hz,
        "tau_s": result.tau_s,
        "materials": {m.name: _material(result, m) for m in result.materials},
        "nuisances": [
            {k: v if isinstance(v, str) else float(v) for k, v in asdict(n).items()}
            for n in result.nuisances
        ],
        "verdict": asdict(result.verdict),
        "findings": [finding_content(f) for f in result.findings],
        "pairs": [_pair(result, i) for i in range(len(result.pairs))],
        "fit": {
            "chi2": number_or_null(result.chi2),
            "model_error": number_or_null(result.model_error),
            "condition": number_or_null(result.condition),
            "starts": result.n_starts,
            "agreeing_starts": result.agreeing_starts,
            "ending": result.ending,
            "evaluations": result.evaluations,
            "rounds": result.rounds,
            "seconds": round(result.seconds, 3),
            "seed": result.seed,
        },
        "provenance": provenance(inputs),
    }


def _material(result: ImpedanceResult, material: MaterialImpedance) -> dict[str, Any]:
    content: dict[str, Any] = {"frequency_hz": result.frequency_hz, "model": material.kind}
    content |= {name: numbers_or_null(values) for name, values in material.columns().items()}
    content["identified"] = [bool(b) for b in material.identified]
    content["parameters"] = {
        p.name: {"unit": p.unit, "value": p.value, "lower95": p.lower95, "upper95": p.upper95}
        for p in material.parameters
    }
    return content


def _pair(result: ImpedanceResult, i: int) -> dict[str, Any]:
    fitted = result.evaluations > 0
    measured, predicted = result.measured[i], result.predicted[i]
    return {
        "source": result.pairs[i][0],
        "receiver": result.pairs[i][1],
        "measured_real": measured.real,
        "measured_imag": measured.imag,
        "predicted_real": predicted.real if fitted else None,
        "predicted_imag": predicted.imag if fitted else None,
        "expected_rms": result.expected_rms[i],
    }


def impedance_records(result: ImpedanceResult) -> Table:
    """Return the content of impedance.csv: one row a material and frequency."""
    names = (*result.materials[0].columns(), "identified")
    rows: list[Sequence[Value]] = []
    for material in result.materials:
        numbers = np.column_stack([result.frequency_hz, *material.columns().values()]).tolist()
        flags = material.identified.tolist()
        rows += [(material.name, *x, flag) for x, flag in zip(numbers, flags, strict=True)]
    return Table("", ("material", Column("frequency_hz"), *names), rows, form=".6g")


def walls_figure(result: ImpedanceResult, materials: Sequence[MaterialImpedance]) -> Figure:
    """Return |R0|, its phase, absorption and impedance of some materials, with 95 % bands.

    Impedance is drawn only where its interval is narrow.
    """
    figure = new_figure(8.6, 5.6 * len(materials))
    for part_of, material in zip(
        figure.subfigures(len(materials), squeeze=False)[:, 0], materials, strict=True
    ):
        _draw_wall(part_of, result, material)
    return figure


def _draw_wall(figure: FigureBase, result: ImpedanceResult, material: MaterialImpedance) -> None:
    f, columns, panels = result.frequency_hz, material.columns(), figure.subplots(2, 2, sharex=True)
    (size, angle), (absorption, z) = panels
    # |R0| has the interval of 1 - |R0|**2
    lower = np.sqrt(1.0 - material.absorption_normal_upper95)
    upper = np.sqrt(1.0 - material.absorption_normal_lower95)
    _band(size, f, (np.abs(material.r0), lower, upper), OKABE_ITO[0], None)
    size.set_ylabel("|R0|")
    size.set_ylim(-0.02, 1.02)
    reach = 0.5 * (material.r0_upper95 - material.r0_lower95)
    phase = np.angle(material.r0)
    across = np.hypot(np.sin(phase) * reach.real, np.cos(phase) * reach.imag)
    turn = np.degrees(np.minimum(across / np.maximum(np.abs(material.r0), 1e-9), np.pi))
    degrees = np.degrees(np.unwrap(phase))
    _band(angle, f, (degrees, degrees - turn, degrees + turn), OKABE_ITO[0], None)
    angle.set_ylabel("phase of R0 (degrees)")
    for axes, name, label, colour in (
        (absorption, "absorption_normal", "normal incidence", OKABE_ITO[0]),
        (absorption, "absorption_random", "random incidence", OKABE_ITO[1]),
        (z, "z_real", "real part", OKABE_ITO[0]),
        (z, "z_imag", "imaginary part", OKABE_ITO[1]),
    ):
        limits = [columns[name + end] for end in ("", "_lower95", "_upper95")]
        _band(axes, f, limits, colour, label)
    absorption.set_ylabel("absorption coefficient")
    absorption.set_ylim(-0.02, 1.02)
    absorption.legend(frameon=False, fontsize=8)
    z.set_ylabel("impedance over that of air")
    if material.impedance_shown.any():
        z.legend(frameon=False, fontsize=8)
    else:
        z.text(
            0.5, 0.5, "interval wider than 20 %\nat every frequency",
            ha="center", va="center", transform=z.transAxes,
        )  # fmt: skip
    for axes in panels.ravel():
        axes.grid(alpha=0.25)
        _set_limits(axes, f)
    figure.supxlabel("frequency (Hz)")
    weaker = " (a weaker verdict)" if result.verdict.weaker else ""
    title = f"{material.name}, {material.kind}: {result.verdict.word}{weaker}; bands hold 95 %"
    figure.suptitle(title)


def spectra_figure(result: ImpedanceResult, pairs: Sequence[int]) -> Figure:
    """Return measured and predicted levels of some pairs, and their difference."""
    n = len(pairs)
    columns = min(n, 2)
    rows = -(-n // columns)
    figure = new_figure(4.6 * columns, 2.2 * rows + 0.6)
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    loudest = float(np.abs(result.measured).max())
    for axes, i in zip(panels.ravel(), pairs, strict=False):
        f = result.frequency_hz
        off = np.abs(result.measured[i] - result.predicted[i])
        axes.plot(f, _db(result.measured[i], loudest), color="black", lw=1.6, label="measured")
        axes.plot(
            f, _db(result.predicted[i], loudest), color=OKABE_ITO[1], lw=1.6, ls="--",
            label="predicted",
        )  # fmt: skip
        axes.plot(f, _db(off, loudest), color=OKABE_ITO[0], lw=1.0, label="difference")
        axes.plot(
            f, _db(result.expected_rms[i], loudest), color=OKABE_ITO[2], lw=1.2, ls=":",
            label="difference expected (rms)",
        )  # fmt: skip
        axes.set_title(" to ".join(result.pairs[i]), fontsize=9)
        axes.grid(alpha=0.25)
        _set_limits(axes, f)
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
    axes: Axes, f: FloatArray, values: Sequence[FloatArray], colour: str, label: str | None
) -> None:
    """Draw a value between its lower and upper limit."""
    value, lower, upper = values
    if len(f) == 1:
        bars = np.array([value - lower, upper - value])
        axes.errorbar(f, value, yerr=np.maximum(bars, 0.0), fmt="o", color=colour, label=label)
        return
    axes.fill_between(f, lower, upper, color=colour, alpha=0.25, lw=0.0)
    axes.plot(f, value, color=colour, lw=1.6, label=label)


def _set_limits(axes: Axes, f: FloatArray) -> None:
    if len(f) > 1:
        axes.set_xlim(float(f[0]), float(f[-1]))
