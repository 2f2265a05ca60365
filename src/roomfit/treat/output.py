"""A treatment as treatment.json and treatment.csv (format_version 1), as text, and as a figure."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_hex, to_rgb, to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from roomfit.base.table import Cell, Column, Table, csv_of, text_of
from roomfit.base.whole_files import (
    write_json_atomically,
    write_text_atomically,
)
from roomfit.files.encoding import finding_content, number_or_null, provenance
from roomfit.predict.answer import DecayAnswer, decay_answer
from roomfit.predict.output import (
    one_number,
    parameter_lines,
    parameter_rows,
    parameters_content,
)
from roomfit.predict.tables import named_values
from roomfit.report.decay_times import Limit
from roomfit.report.figures import OKABE_ITO, figure_legend, literal, new_figure
from roomfit.report.html import answer_page, drawing
from roomfit.report.room_figure import COLOURS, drawn_faces, outline_m, projection
from roomfit.report.text import findings_text
from roomfit.report.wording import band_tables
from roomfit.room.mesh import corners_m
from roomfit.room.scene import triangle_material
from roomfit.signals.decay import FIT_RANGES_DB
from roomfit.treat.arrangements import apart
from roomfit.treat.question import USUAL_HZ, TargetName

if TYPE_CHECKING:
    from roomfit.treat.arrangements import Arrangement, Treatment


def write_treatment(folder: Path, treatment: Treatment, inputs: Iterable[Path]) -> None:
    """Write ``treatment.json``, ``.csv`` and ``.html`` into a folder."""
    write_text_atomically(folder / "treatment.csv", treatment_csv(treatment))
    write_text_atomically(folder / "treatment.html", treatment_page(treatment))
    write_json_atomically(folder / "treatment.json", treatment_content(treatment, inputs))


def treatment_csv(treatment: Treatment) -> str:
    """Return one row for each product on each surface of each arrangement."""
    columns = (
        *("arrangement", "surface", "product", Column("area_m2", ".3f"), Column("share", ".4f")),
        *(Column("cost"), Column("probability_of_all", ".3f")),
    )
    rows = [
        (number, h.surface, h.product, h.area_m2, h.share, a.cost, a.joint)
        for number, a in enumerate(treatment.arrangements, start=1)
        for h in a.hung
    ]
    return csv_of(Table("", columns, rows))


def treatment_content(treatment: Treatment, inputs: Iterable[Path]) -> dict[str, Any]:
    """Return what treatment.json holds: lists as long as bands_hz, null where nothing is known."""
    return {
        "format": "roomfit-treatment",
        "format_version": 1,
        "bands_hz": treatment.bands.centres_hz,
        "is_met": treatment.is_met,
        "probability_asked": treatment.asked,
        "sentence": treatment_sentence(treatment),
        "targets": [
            {
                "parameter": t.parameter,
                "at_least": number_or_null(t.low),
                "at_most": number_or_null(t.high),
                "bands_hz": list(t.bands_hz),
                "mean_of_bands": t.mean_of_bands,
                "source": t.source,
            }
            for t in treatment.targets
        ],
        "arrangements": [
            {
                "hung": [
                    {"surface": h.surface, "product": h.product, "area_m2": h.area_m2}
                    for h in a.hung
                ],
                "cost": a.cost,
                "probability": a.probability,
                "probability_before": a.before,
                "probability_of_all": a.joint,
                "missed": list(a.missed),
                "decisive": [{"material": name, "share": share} for name, share in a.decisive],
                "mean": parameters_content(a.mean),
                "sti": one_number(a.sti),
            }
            for a in treatment.arrangements
        ],
        "to_measure": list(treatment.to_measure),
        "findings": [finding_content(f) for f in treatment.findings],
        "provenance": provenance(inputs),
    }


def treatment_page(treatment: Treatment) -> str:
    """Return the first arrangement as a page: a sentence, T30 before and after, where it hangs.

    The other arrangements and all tables are folded; under the policy of the report.
    """
    answer, first = _answer(treatment, treatment.arrangements[0]), treatment.arrangements[0]
    folded = [
        (f"Arrangement {number}", _words(a), _arrangement_tables(treatment, a))
        for number, a in enumerate(treatment.arrangements, start=1)
    ]
    odds = f"{_percent(treatment, first.joint)} %"
    wanted = "all targets" if len(first.probability) > 1 else "the target"
    words = f"probability that a measurement meets {wanted}"
    area_m2 = sum(h.area_m2 for h in first.hung)
    figures = [(f"{area_m2:.4g} m²", f"hung, cost {first.cost:g}"), (odds, words)]
    drawn = _picture(new_figure(6.4, 4.4), treatment, first)
    return answer_page(
        "What to hang where",
        treatment_sentence(treatment),
        None if answer is None else answer.figure(_limits(treatment, answer.symbol)),
        [*figures, *([] if answer is None else answer.figures[:2])],
        treatment.findings,
        folded,
        more=drawing(drawn, "hung", "The room and what hangs where", _WHERE),
    )


_WHERE = (
    "The room from above one corner. Covered surfaces are coloured, the paler the less of them is "
    "covered; those that face away from the viewer are seen through."
)


def treatment_sentence(treatment: Treatment) -> str:
    """Return what is hung where, what the decay time does then, and how likely it is enough."""
    first = treatment.arrangements[0]
    answer = _answer(treatment, first)
    found = f"{_words(first)}." if answer is None else f"{_words(first)}: {answer.sentence}"
    all_ = "All targets are" if len(treatment.targets) > 1 else "The target is"
    met = f"{all_} met with a probability of {_percent(treatment, first.joint)} %"
    if treatment.is_met:
        return f"{found} {met}."
    if treatment.asked > 0.5:
        return (
            f"{found} {met}; nothing that was allowed meets each target with the "
            f"{100 * treatment.asked:g} % that were asked for."
        )
    return (
        f"{found} By the likeliest prediction this does not meet the targets; nothing that was "
        "allowed does."
    )


def _percent(treatment: Treatment, probability: float) -> str:
    """Return a probability in percent; one below that asked for with what tells it apart."""
    if probability >= treatment.asked:
        return f"{100 * probability:.0f}"
    return apart(100 * probability, 100 * treatment.asked, 0)[0]


def _words(a: Arrangement) -> str:
    """Return what is hung where in a line."""
    return ", ".join(f"{h.area_m2:.4g} m² {h.product} on {h.surface}" for h in a.hung) or "Nothing"


def _answer(treatment: Treatment, a: Arrangement) -> DecayAnswer | None:
    means = named_values(a.mean, None)
    return decay_answer(
        treatment.bands, means, is_changed=True, before=treatment.before, after="treated"
    )


def _limits(treatment: Treatment, symbol: str) -> list[Limit]:
    return [
        Limit(t.bands_hz or USUAL_HZ, t.low, t.high)
        for t in treatment.targets
        if t.parameter == f"{symbol}_s"
    ]


def _arrangement_tables(treatment: Treatment, a: Arrangement) -> list[Table]:
    """Return what hangs where, the targets with their odds, and every parameter."""
    hung = [(h.surface, h.product, f"{h.area_m2:.2f}", f"{100 * h.share:.0f}") for h in a.hung] or [
        ("nothing", "", "", "")
    ]
    odds = [
        (str(t), f"{100 * before:.0f}", _percent(treatment, after))
        for t, before, after in zip(treatment.targets, a.before, a.probability, strict=True)
    ]
    rows = [
        (Cell(label, (what,)), *cells)
        for label, what, cells in parameter_lines(named_values(a.mean, None), is_changed=True)
    ]
    return [
        Table("What hangs where", ("surface", "product", "m²", "% of it"), hung),
        Table("Met with a probability of, %", ("target", "as it is", "treated"), odds),
        *band_tables("Means over all pairs", "parameter", treatment.bands.centres_hz, rows),
    ]


def treatment_text(treatment: Treatment) -> str:
    """Return the answer in a sentence, arrangements, what they do, and how likely it is enough."""
    parts = [treatment_sentence(treatment), "Targets, as means over all pairs"]
    parts[1] += "".join(f"\n  {i}. {t}" for i, t in enumerate(treatment.targets, start=1))
    for number, a in enumerate(treatment.arrangements, start=1):
        parts.append(_arrangement_text(treatment, a, number))
    parts.append(findings_text(treatment.findings))
    return "\n\n".join(p for p in parts if p)


def _arrangement_text(treatment: Treatment, a: Arrangement, number: int) -> str:
    title = f"Arrangement {number}, cost {a.cost:g}"
    if not treatment.is_met:
        title = f"Not met; what misses least, cost {a.cost:g}"
    lines = [title]
    for h in a.hung:
        lines.append(f"  {h.area_m2:7.2f} m2 {h.product} on {h.surface} ({100 * h.share:.0f} %)")
    if not a.hung:
        lines.append("  nothing")
    for i, (before, after) in enumerate(zip(a.before, a.probability, strict=True), start=1):
        lines.append(
            f"  target {i} is met with a probability of {_percent(treatment, after)} % "
            f"(as it is: {100 * before:.0f} %)"
        )
    if len(treatment.targets) > 1:
        lines.append(f"  all targets: {_percent(treatment, a.joint)} %")
    if a.decisive and not a.is_sure:
        name, share = a.decisive[0]
        lines.append(
            f"  to be surer, measure {name}: {100 * share:.0f} % of the spread of the least likely "
            "target goes with its absorption"
        )
        if number == 1:
            lines += [f"    {line}" for line in treatment.to_measure]
    wanted = {t.parameter for t in treatment.targets}
    shown = {n: v for n, v in a.mean.items() if n in wanted or n in ("T30_s", "C50_dB")}
    rows = parameter_rows(named_values(shown, a.sti), is_changed=True)
    heads = ("Hz", *(f"{f:g}" for f in treatment.bands.centres_hz))
    return "\n".join([*lines, text_of(Table("", heads, rows), indent="  ")])


def treatment_figure(treatment: Treatment) -> Figure:
    """Return the room with the first arrangement, and each target's parameter by band."""
    a = treatment.arrangements[0]
    names = list(dict.fromkeys(t.parameter for t in treatment.targets))[:2]
    figure = new_figure(10.5, 4.6)
    grid = figure.add_gridspec(len(names), 2, width_ratios=(1.15, 1.0))
    _draw_room(figure.add_subplot(grid[:, 0]), treatment, a)
    heads = [f"{f:g}" for f in treatment.bands.centres_hz]
    first = None
    for row, name in enumerate(names):
        axes = figure.add_subplot(grid[row, 1])
        first = first or axes
        v = named_values(a.mean, a.sti)[name]
        at = np.arange(v.predicted.size)
        if v.change is not None:
            c = v.change
            axes.vlines(at - 0.1, c.before_lower95, c.before_upper95, color=OKABE_ITO[0], lw=1.6)
            axes.plot(at - 0.1, c.before, "s", color=OKABE_ITO[0], ms=4, label="as it is")
        axes.vlines(at + 0.1, v.lower95, v.upper95, color=OKABE_ITO[1], lw=1.6)
        axes.plot(at + 0.1, v.predicted, "o", color=OKABE_ITO[1], ms=4, label="treated")
        _draw_limits(axes, treatment, name)
        symbol, _, unit = name.partition("_")
        unit = {"percent": "%"}.get(unit, unit)
        axes.set_ylabel(f"{symbol} ({unit})" if unit else symbol)
        axes.set_xticks(at, ["125 to 8000"] if name == "STI" else heads)
        axes.grid(alpha=0.25, axis="y")
    axes.set_xlabel("frequency (Hz)")
    if first is not None:
        figure_legend(figure, first, 3, "mean over all pairs with 95 % intervals")
    return figure


def _draw_limits(axes: Axes, treatment: Treatment, name: TargetName) -> None:
    """Draw a bar across each band of each target at its limits, and what lies near them."""
    label, highest = "limit", 0.0
    first = treatment.arrangements[0]
    v = named_values(first.mean, first.sti)[name]
    for t in treatment.targets:
        wanted = t.bands_hz or USUAL_HZ
        at = np.flatnonzero(np.isin(treatment.bands.centres_hz, wanted))
        at = np.zeros(1, dtype=np.int64) if name == "STI" else at
        if t.parameter == name and v.change is not None and at.size:
            own = [v.upper95[at], v.change.before_upper95[at], np.array([t.low, t.high])]
            highest = max(highest, *(float(x[np.isfinite(x)].max(initial=0.0)) for x in own))
        for limit in (t.low, t.high):
            if t.parameter == name and np.isfinite(limit) and at.size:
                axes.hlines(
                    np.full(at.size, limit), at - 0.4, at + 0.4, color="black", lw=1.4, label=label
                )
                label = "_"
    # a band without a target, whose interval may be endless, does not make the others small
    if name in FIT_RANGES_DB and highest > 0.0:
        axes.set_ylim(0.0, 1.5 * highest)


def _picture(figure: Figure, treatment: Treatment, a: Arrangement) -> Figure:
    _draw_room(figure.add_subplot(), treatment, a)
    return figure


def _draw_room(axes: Axes, treatment: Treatment, a: Arrangement) -> None:
    """Draw the room from above one corner, treated surfaces in colour; walls in front left out."""
    room, onto = treatment.room.scene.room, projection()[:2]
    by_surface: dict[str, list[str]] = {}
    covered: dict[str, float] = {}
    for h in a.hung:
        text = f"{h.area_m2:.4g} m² {h.product} ({100 * h.share:.0f} %)"
        by_surface.setdefault(h.surface, []).append(text)
        covered[h.surface] = covered.get(h.surface, 0.0) + h.share
    # the less of a surface is covered the paler it is
    colour = {}
    for i, (name, share) in enumerate(covered.items()):
        red, green, blue = (
            1.0 - (0.3 + 0.7 * min(share, 1.0)) * (1.0 - part)
            for part in to_rgb(COLOURS[i % len(COLOURS)])
        )
        colour[name] = to_hex((red, green, blue))
    faces, _ = drawn_faces(room)
    owner = [room.materials[int(i)] for i in triangle_material(room)[faces]]
    colours = [colour.get(name, "#EEEEEE") for name in owner]
    axes.add_collection(
        PolyCollection(
            list(corners_m(room.mesh)[faces] @ onto.T),
            facecolors=colours, edgecolors=colours, linewidths=0.5, closed=True, clip_on=False,
        )
    )  # fmt: skip
    # covered walls whose inside is turned away stand before the others, and are seen through
    is_hidden = ~np.isin(np.arange(len(room.mesh.triangles)), faces)
    for name in colour:
        front = is_hidden & (triangle_material(room) == room.materials.index(name))
        axes.add_collection(
            PolyCollection(
                list(corners_m(room.mesh)[front] @ onto.T),
                facecolors=[to_rgba(colour[name], 0.35)], edgecolors=[to_rgba(colour[name], 0.9)],
                linewidths=0.5, closed=True, clip_on=False, zorder=2.5,
            )
        )  # fmt: skip
    edges = outline_m(room, 1500)
    axes.add_collection(
        LineCollection(list(edges @ onto.T), colors="#444444", linewidths=0.8, clip_on=False)
    )
    flat = room.mesh.vertices_m @ onto.T
    axes.set_xlim(flat[:, 0].min(), flat[:, 0].max())
    axes.set_ylim(flat[:, 1].min(), flat[:, 1].max())
    axes.set_aspect("equal")
    axes.set_axis_off()
    handles = [
        Patch(facecolor=colour[s], edgecolor="#777777", label=literal(f"{s}: {', '.join(t)}", 60))
        for s, t in by_surface.items()
    ]
    handles.append(Patch(facecolor="#EEEEEE", edgecolor="#777777", label="as it is"))
    axes.legend(
        handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.02), frameon=False, fontsize=8
    )
