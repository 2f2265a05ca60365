"""The files of ``roomfit impedance``: result.json, impedance.csv (format_version 1), figures."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from roomfit.base.table import Column, Table, Value, csv_of
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


def write_impedance(
    out: Path, result: ImpedanceResult, inputs: Iterable[Path], *, overwrite: bool = False
) -> None:
    """Write result.json, impedance.csv and pictures into a folder, all of it or nothing."""
    with whole_output_folder(out, overwrite=overwrite) as folder:
        write_text_atomically(folder / "impedance.csv", csv_of(impedance_records(result)))
        write_json_atomically(folder / "result.json", impedance_content(result, inputs))
        picture = png(walls_figure(result))
        write_bytes_atomically(folder / "impedance.png", picture)


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


_PANELS: tuple[tuple[str, tuple[tuple[str, str], ...]], ...] = (
    ("R0", (("r0_real", "real part"), ("r0_imag", "imaginary part"))),
    (
        "absorption coefficient",
        (("absorption_normal", "normal incidence"), ("absorption_random", "random incidence")),
    ),
    ("impedance over that of air", (("z_real", "real part"), ("z_imag", "imaginary part"))),
)


def walls_figure(result: ImpedanceResult) -> Figure:
    """Return R0, absorption and impedance of every material with 95 % bands, one row each.

    Impedance is drawn only where its interval is narrow.
    """
    n, f = len(result.materials), result.frequency_hz
    figure = new_figure(11.0, 2.6 * n + 0.6)
    rows = figure.subplots(n, len(_PANELS), sharex=True, squeeze=False)
    for row, material in zip(rows, result.materials, strict=True):
        columns = material.columns()
        for axes, (label, drawn) in zip(row, _PANELS, strict=True):
            for (name, text), colour in zip(drawn, OKABE_ITO, strict=False):
                value, low, high = (columns[name + end] for end in ("", "_lower95", "_upper95"))
                axes.fill_between(f, low, high, color=colour, alpha=0.25, lw=0.0)
                axes.plot(f, value, color=colour, lw=1.6, label=text)
            axes.set_ylabel(label)
            axes.grid(alpha=0.25)
            axes.legend(frameon=False, fontsize=8)
        row[0].set_title(f"{material.name} ({material.kind})", fontsize=10)
    weaker = " (a weaker verdict)" if result.verdict.weaker else ""
    figure.suptitle(f"{result.verdict.word}{weaker}; bands hold 95 %", fontsize=10)
    figure.supxlabel("frequency (Hz)", fontsize=10)
    return figure
