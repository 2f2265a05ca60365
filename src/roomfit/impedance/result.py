"""What an identification of impedances finds, and its files.

Every quantity of a wall has its 95 % interval; all follow from R0 and the covariance of its real
and imaginary part.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from roomfit.base import whole_files
from roomfit.base.findings import Finding
from roomfit.base.table import Column, Table, Value, csv_of
from roomfit.base.typing import BoolArray, ComplexArray, FloatArray
from roomfit.files.encoding import finding_content, numbers_or_null, provenance
from roomfit.impedance.laws import absorption_normal, absorption_random, impedance_of_r0
from roomfit.report.blocks import Block, Blocks, Findings, Sentence
from roomfit.report.text import text

Z95 = 1.959964  # standard normal, 97.5 %
# R0 counts as identified where its interval is no wider, Z is shown where its is, relative.
WIDEST_R0 = 0.2
WIDEST_Z = 0.2
_STEP = 1e-6

# Name of a column, field of `MaterialImpedance`, part of the complex number.
_COLUMNS = (
    ("r0_real", "r0", "real"),
    ("r0_imag", "r0", "imag"),
    ("absorption_normal", "absorption_normal", "real"),
    ("absorption_random", "absorption_random", "real"),
    ("admittance_real", "admittance", "real"),
    ("admittance_imag", "admittance", "imag"),
    ("z_real", "impedance", "real"),
    ("z_imag", "impedance", "imag"),
)


class Estimate(NamedTuple):
    """A number of the measurement that was found, with its 95 % interval."""

    name: str  # such as "x of LS1" or "speed of sound"
    unit: str
    value: float  # shifts are from the specified position
    lower95: float
    upper95: float
    prior_sd: float  # in the same unit


class MaterialImpedance(NamedTuple):
    """What was found of one material, over frequency.

    Arrays have the shape (n_frequencies,). Every pair of `_lower95` and `_upper95` is a 95 %
    interval of real numbers: of complex quantities, real and imaginary parts hold the limits of
    real and imaginary part. Impedance and admittance are relative to those of air.
    """

    name: str
    kind: str  # the curve that was fitted: spline or constant
    r0: ComplexArray
    r0_lower95: ComplexArray
    r0_upper95: ComplexArray
    absorption_normal: FloatArray
    absorption_normal_lower95: FloatArray
    absorption_normal_upper95: FloatArray
    absorption_random: FloatArray
    absorption_random_lower95: FloatArray
    absorption_random_upper95: FloatArray
    admittance: ComplexArray
    admittance_lower95: ComplexArray
    admittance_upper95: ComplexArray
    impedance: ComplexArray  # this and its limits: nan where `impedance_shown` is false
    impedance_lower95: ComplexArray
    impedance_upper95: ComplexArray
    impedance_shown: BoolArray  # where the interval of Z is no wider than a fifth of its size
    identified: BoolArray  # where those of real and imaginary part of R0 are no wider than 0.2

    def columns(self) -> dict[str, FloatArray]:
        """Return all quantities in real numbers by their names in result.json and impedance.csv."""
        return {
            name + end: np.asarray(getattr(getattr(self, field + end), part))
            for name, field, part in _COLUMNS
            for end in ("", "_lower95", "_upper95")
        }


class Verdict(NamedTuple):
    """Whether the walls may be used."""

    word: Literal["identified", "not identifiable", "does not fit"]
    cause: str  # "" where identified
    sentence: str
    weaker: bool = False  # whether noise was estimated from the residual, or phases were missing


@dataclass(frozen=True, slots=True, eq=False)
class ImpedanceResult:
    """The walls of a room, and how far to trust what is said of them.

    Made by `roomfit.identify_impedance`. ``print(result)`` shows the verdict, a table of every
    material and the findings.
    """

    frequency_hz: FloatArray  # (n_frequencies,)
    tau_s: float  # time constant of the exponential window
    materials: tuple[MaterialImpedance, ...]
    verdict: Verdict
    findings: tuple[Finding, ...]
    pairs: tuple[tuple[str, str], ...]  # source and receiver
    measured: ComplexArray  # (n_pairs, n_frequencies)
    predicted: ComplexArray  # likewise, with gains and delays
    seconds: float = 0.0
    nuisances: tuple[Estimate, ...] = ()  # of the measurement, estimated together with the walls
    # Sum of squared residuals over what noise and model error explain; 1 and less is good. This
    # and the next are nan where nothing was fitted.
    chi2: float = math.nan
    # rms error of the image model in this room by the residual, relative to the level, times
    # wavenumber and mean free path
    model_error: float = math.nan
    agreeing_starts: int = 0  # how many starts led to the lowest minimum
    n_starts: int = 0
    ending: str = "nothing was fitted"
    evaluations: int = 0  # 0 where nothing was fitted
    seed: int | None = None

    def __str__(self) -> str:
        """Return the verdict, a table of some frequencies for every material, and all findings."""
        weaker = " (a weaker verdict, see the findings)" if self.verdict.weaker else ""
        head: list[Block] = [Sentence(self.verdict.sentence + weaker, "lead")]
        if self.evaluations:
            head += [*(_table(self, m) for m in self.materials), Sentence(_fit_text(self))]
        return text(Blocks("Impedance", tuple(head), (Findings(self.findings),)))


def _table(result: ImpedanceResult, material: MaterialImpedance) -> Table:
    """Return some frequencies: R0 (with ? where not identified), absorption and impedance."""
    n, rows = len(result.frequency_hz), []
    for i in np.unique(np.linspace(0, n - 1, min(8, n)).round()).astype(int):
        r0, z = material.r0[i], material.impedance[i]
        low, up = material.absorption_normal_lower95[i], material.absorption_normal_upper95[i]
        rows.append(
            (
                f"{result.frequency_hz[i]:.0f}",
                f"{r0.real:+.3f} {r0.imag:+.3f}j{' ' if material.identified[i] else '?'}",
                f"{material.absorption_normal[i]:.3f} {low:.3f}-{up:.3f}",
                material.absorption_random[i],
                f"{z.real:.2f} {z.imag:+7.2f}j" if material.impedance_shown[i] else "not narrow",
            )
        )
    columns = (Column("Hz", align=">"), "R0", "absorption, 95 %", "random", "Z / rho c")
    return Table(f"{material.name} ({material.kind})", columns, rows, form=".3f")


def _fit_text(result: ImpedanceResult) -> str:
    lines = [
        f"{result.agreeing_starts} of {result.n_starts} starts agree; residual "
        f"{result.chi2:.2f} of what was expected; {result.seconds:.1f} s"
    ]
    lines += [
        f"{n.name}: {n.value:.5g} {n.unit}, 95 % {n.lower95:.5g} to {n.upper95:.5g}"
        for n in result.nuisances
        if n.unit != "m"
    ]
    moves = [n.value for n in result.nuisances if n.unit == "m"]
    if moves:
        size = float(np.sqrt(np.mean([move**2 for move in moves])))
        lines.append(f"positions moved by {1000 * size:.1f} mm a coordinate (rms)")
    return "\n".join(lines)


def material_impedance(
    name: str, kind: str, r0: ComplexArray, covariance: FloatArray
) -> MaterialImpedance:
    """Return all quantities of a material with their intervals.

    Shapes: `r0` (n_frequencies,), `covariance` (n_frequencies, 2, 2).
    """
    # With the second order, without which a wall that is matched, R0 = 0, would be known exactly:
    # of a normal R0 with mean r and covariance S the square has the variance 4 r S r + 2 trace(S S)
    # and a mean that is larger by trace(S).
    parts = np.stack([r0.real, r0.imag], axis=1)
    first = np.einsum("fa,fab,fb->f", parts, covariance, parts)
    second = np.einsum("fab,fba->f", covariance, covariance)
    dn = Z95 * np.sqrt(np.maximum(4.0 * first + 2.0 * second, 0.0))
    # inside the disc, so that the steps meet walls that absorb
    inner = r0 * (1.0 - 2.0 * _STEP)
    at = absorption_random(inner)
    by = [(absorption_random(inner + d) - at) / _STEP for d in (_STEP, 1j * _STEP)]
    dr = _reach(covariance, np.stack(by, axis=1))
    below, above = (np.where(np.abs(x) < 1e-9, 1e-9, x) for x in (1.0 + r0, 1.0 - r0))
    by_r0 = (np.ones(len(r0), dtype=np.complex128), -2.0 / below**2, 2.0 / above**2)
    d0, dy, dz = (_complex_reach(covariance, np.asarray(by)) for by in by_r0)
    z = impedance_of_r0(r0)
    shown = 2.0 * np.maximum(dz.real, dz.imag) <= WIDEST_Z * np.abs(z)
    z = np.where(shown, z, complex(np.nan, np.nan))
    fields: dict[str, Any] = {}
    for quantity, value, down, up in (
        ("r0", r0, d0, d0),
        ("absorption_normal", absorption_normal(r0), dn + np.trace(covariance.T), dn),
        ("absorption_random", absorption_random(r0), dr, dr),
        ("admittance", (1.0 - r0) / below, dy, dy),
        ("impedance", z, dz, dz),
    ):
        low, high = np.asarray(value - down), np.asarray(value + up)
        if quantity == "r0":
            low, high = _clipped(low), _clipped(high)
        elif quantity.startswith("absorption"):
            low, high = np.clip(low, 0.0, 1.0), np.clip(high, 0.0, 1.0)
        fields |= {quantity: value, f"{quantity}_lower95": low, f"{quantity}_upper95": high}
    identified = 2.0 * np.maximum(d0.real, d0.imag) <= WIDEST_R0
    return MaterialImpedance(name, kind, **fields, impedance_shown=shown, identified=identified)


def _complex_reach(covariance: FloatArray, by_r0: ComplexArray) -> ComplexArray:
    """Return half the interval of real and imaginary part of what changes by `by_r0` dR0."""
    real = np.stack([by_r0.real, -by_r0.imag], axis=1)
    imaginary = np.stack([by_r0.imag, by_r0.real], axis=1)
    return np.asarray(_reach(covariance, real) + 1j * _reach(covariance, imaginary))


def _reach(covariance: FloatArray, by: FloatArray) -> FloatArray:
    variance = np.einsum("fa,fab,fb->f", by, covariance, by)
    return np.asarray(Z95 * np.sqrt(np.maximum(variance, 0.0)))


def _clipped(r0: ComplexArray) -> ComplexArray:
    return np.asarray(np.clip(r0.real, -1.0, 1.0) + 1j * np.clip(r0.imag, -1.0, 1.0))


def write_impedance(
    out: Path, result: ImpedanceResult, inputs: Iterable[Path], *, overwrite: bool = False
) -> None:
    """Write result.json and impedance.csv into a folder, both or nothing."""
    with whole_files.whole_output_folder(out, overwrite=overwrite) as folder:
        whole_files.write_text_atomically(folder / "impedance.csv", csv_of(_records(result)))
        whole_files.write_json_atomically(folder / "result.json", _content(result, inputs))


def _content(result: ImpedanceResult, inputs: Iterable[Path]) -> dict[str, Any]:
    """Return what result.json holds: lists as long as frequency_hz, null where Z is not shown."""
    fitted = result.evaluations > 0
    return {
        "format": "roomfit-impedance",
        "format_version": 1,
        "frequency_hz": result.frequency_hz,
        "tau_s": result.tau_s,
        "materials": {
            m.name: {
                "model": m.kind,
                **{name: numbers_or_null(values) for name, values in m.columns().items()},
                "identified": [bool(b) for b in m.identified],
            }
            for m in result.materials
        },
        "nuisances": [
            {k: v if isinstance(v, str) else float(v) for k, v in n._asdict().items()}
            for n in result.nuisances
        ],
        "verdict": result.verdict._asdict(),
        "findings": [finding_content(f) for f in result.findings],
        "pairs": [
            {
                "source": source,
                "receiver": receiver,
                "measured_real": result.measured[i].real,
                "measured_imag": result.measured[i].imag,
                "predicted_real": result.predicted[i].real if fitted else None,
                "predicted_imag": result.predicted[i].imag if fitted else None,
            }
            for i, (source, receiver) in enumerate(result.pairs)
        ],
        "fit": {
            "chi2": numbers_or_null(result.chi2),
            "model_error": numbers_or_null(result.model_error),
            "starts": result.n_starts,
            "agreeing_starts": result.agreeing_starts,
            "ending": result.ending,
            "evaluations": result.evaluations,
            "seconds": round(result.seconds, 3),
            "seed": result.seed,
        },
        "provenance": provenance(inputs),
    }


def _records(result: ImpedanceResult) -> Table:
    """Return the content of impedance.csv (format_version 1): one row a material and frequency."""
    names = (*result.materials[0].columns(), "identified")
    rows: list[Sequence[Value]] = []
    for material in result.materials:
        numbers = np.column_stack([result.frequency_hz, *material.columns().values()]).tolist()
        flags = material.identified.tolist()
        rows += [(material.name, *x, flag) for x, flag in zip(numbers, flags, strict=True)]
    return Table("", ("material", Column("frequency_hz"), *names), rows, form=".6g")
