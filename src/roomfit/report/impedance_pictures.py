"""Walls and spectra in pictures: reflection, absorption, impedance; measured and predicted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from roomfit.impedance.answer import ImpedanceAnswer
from roomfit.impedance.intervals import MaterialAnswer
from roomfit.report.pictures import OKABE_ITO, new_figure
from roomfit.typing import ComplexArray, FloatArray


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
    from roomfit.materials.impedance_laws import (
        absorption_normal,
        absorption_random,
        impedance_of_r0,
    )

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
