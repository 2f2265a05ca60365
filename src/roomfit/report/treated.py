"""A treatment as blocks: what to hang where, what it does, and how likely it is enough."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from roomfit.base.table import Table
from roomfit.predict.prediction import named_values
from roomfit.report import wording
from roomfit.report.blocks import (
    Block,
    Blocks,
    Drawing,
    Findings,
    Listed,
    Part,
    Sentence,
    Terms,
    names_of,
)
from roomfit.report.doubts import serious_lines
from roomfit.report.predicted import DecayAnswer, decay_answer, parameter_rows, variant_tables
from roomfit.room.mesh import surface_area_m2, volume_m3
from roomfit.treat.arrangements import apart
from roomfit.treat.question import USUAL_HZ

if TYPE_CHECKING:
    from roomfit.predict.prediction import Predicted
    from roomfit.treat.arrangements import Arrangement, Treatment
    from roomfit.treat.question import Target


def describe(treatment: Treatment) -> Blocks:
    """Return the first arrangement in a sentence, T30 before and after, and all arrangements."""
    answer, first = _answer(treatment), treatment.arrangements[0]
    head: list[Block] = [*_head(treatment), _hung_table(first)]
    head += [] if answer is None else answer.tables(limits_of(treatment.targets))
    head += [Listed(serious_lines(treatment.findings)), Sentence(_next_step(first))]
    head += [] if first.is_sure else [Listed(treatment.to_measure)]
    blocks: list[Block] = [Findings(treatment.findings)]
    blocks += [] if answer is None else [answer.drawing(limits_of(treatment.targets))]
    for number, a in enumerate(treatment.arrangements, start=1):
        title = f"Arrangement {number}" if treatment.is_met else "Not met; what misses least"
        shown = _arrangement(treatment, a)
        blocks.append(Part(f"{title}, cost {a.cost:g}", shown, folded=True))
    title, names = "What to hang where", _names(treatment)
    return Blocks(title, tuple(head), tuple(blocks), "treatment.json", names=names)


def _names(treatment: Treatment, *others: str) -> frozenset[str]:
    hung = [h for a in treatment.arrangements for h in a.hung]
    own = [name for h in hung for name in (h.surface, h.product)]
    return names_of(treatment.room.scene, *own, *others)


def _head(treatment: Treatment) -> tuple[Block, ...]:
    """Return the sentence, four numbers, and the picture."""
    first, answer = treatment.arrangements[0], _answer(treatment)
    met = f"{_percent(treatment, first.joint)} %"
    numbers = [(met, "probability that all targets are met")]
    if answer is not None:
        centres_hz, after = answer.centres_hz, answer.series[-1]
        where = wording.mid_words(centres_hz, after.values_s)
        words = f"{answer.symbol} at {where}, treated"
        numbers.append((wording.with_interval(*after.mid_s(centres_hz)), words))
    numbers.append((f"{sum(h.area_m2 for h in first.hung):.4g} m²", "to be hung"))
    numbers.append((f"{first.cost:g}", "cost, in the units of the treatment file"))
    shown = Terms(tuple(numbers), are_numbers=True)
    caption = (
        "The room from above one corner. Covered surfaces are coloured, the paler the less of "
        "them is covered; those that face away from the viewer are seen through."
    )
    maker = "prediction_figures.treatment_figure"
    title = "The room and what hangs where"
    picture = Drawing("treatment", title, caption, maker, (treatment,))
    return Sentence(treatment_sentence(treatment), "lead"), shown, picture


def limits_of(targets: Iterable[Target]) -> list[tuple[tuple[float, ...], float, float]]:
    """Return bands in Hz, lowest and highest time in s, of targets of T20 or T30."""
    own = (t for t in targets if t.parameter in ("T20_s", "T30_s"))
    return [(t.bands_hz or USUAL_HZ, t.low, t.high) for t in own]


def _hung_table(a: Arrangement) -> Table:
    rows: list[tuple[str, ...]] = [
        (h.surface, h.product, f"{h.area_m2:.2f}", f"{100 * h.share:.0f}", str(h.pieces),
         f"{h.cost:g}")
        for h in a.hung
    ]  # fmt: skip
    heads = ("surface", "product", "m²", "% of it", "pieces", "cost")
    return Table("What hangs where", heads, rows or [("nothing", *[""] * 5)])


def _odds_table(treatment: Treatment, a: Arrangement) -> Table:
    odds = [
        (str(t), f"{100 * before:.0f}", _percent(treatment, after))
        for t, before, after in zip(treatment.targets, a.before, a.probability, strict=True)
    ]
    if len(treatment.targets) > 1:
        odds.append(("all targets", "", _percent(treatment, a.joint)))
    heads = ("target, as a mean over all pairs", "as it is", "treated")
    return Table("Met with a probability of, %", heads, odds)


def _next_step(a: Arrangement) -> str:
    if a.is_sure or not a.decisive:
        return "Next: hang it, and measure again."
    name, share = a.decisive[0]
    return (
        f"To be surer, measure {name}: {100 * share:.0f} % of the spread of the least likely "
        "target goes with its absorption."
    )


def client_blocks(
    treatment: Treatment,
    project: Mapping[str, str],
    measured: str,
    variants: Mapping[str, Predicted] | None = None,
) -> Blocks:
    """Return what a client needs to know of a treatment, on two sheets of A4.

    `project` is that of `roomfit.report.answer.report_html`, `measured` what was measured, in
    words, `variants` stand beside by their names.
    """
    beside = variants or {}
    first, answer, room = treatment.arrangements[0], _answer(treatment), treatment.room.scene.room
    sizes = " \N{MULTIPLICATION SIGN} ".join(
        f"{x:.2f} m" for x in np.ptp(room.mesh.vertices_m, axis=0)
    )
    size = (
        f"The room: {sizes}, volume {wording.area(volume_m3(room.mesh))} m³, surfaces "
        f"{wording.area(surface_area_m2(room.mesh))} m²."
    )
    times: tuple[Block, ...] = ()
    if answer is not None:
        limits = limits_of(treatment.targets)
        times = *answer.tables(limits), answer.drawing(limits)
    sure = (
        f"Of 100 rooms of which as much is known as of this one, {_percent(treatment, first.joint)}"
        " would meet all targets when they are measured afterwards."
    )
    if first.decisive:
        name, share = first.decisive[0]
        sure += (
            f" What is not known for certain of {name} makes {100 * share:.0f} % of the spread of "
            "the least likely target."
        )
    serious = Listed(serious_lines(treatment.findings))
    done = [
        ("measured", measured),
        *((k, project[k]) for k in ("date", "author", "instruments") if k in project),
    ]
    blocks = (
        Part("What hangs where", (_hung_table(first),)),
        Part("Reverberation before and after", (*times, *variant_tables(beside)[:-1])),
        Part("How sure", (Sentence(sure), _odds_table(treatment, first), serious)),
        Part("What was measured", (Terms(tuple(done)),)),
    )
    return Blocks(
        project.get("title", "What to hang where"),
        (*_head(treatment), Sentence(size)),
        blocks,
        project=tuple((k, project[k]) for k in ("client", "author") if k in project),
        logo=project.get("logo", ""),
        language=project.get("language", "en"),
        names=_names(treatment, *project.values(), *beside),
    )


def _arrangement(treatment: Treatment, a: Arrangement) -> tuple[Block, ...]:
    """Return what hangs where, the targets with their odds, what to measure, every parameter."""
    own = [] if a is treatment.arrangements[0] else [_hung_table(a)]
    blocks: list[Block] = [*own, _odds_table(treatment, a)]
    if a.decisive and not a.is_sure:
        blocks.append(Sentence(_next_step(a)))
    rows = parameter_rows(named_values(a.mean, None), is_changed=True)
    centres_hz = treatment.bands.centres_hz
    blocks += wording.band_tables("Means over all pairs", "parameter", centres_hz, rows)
    if a.sti is not None:
        rows = parameter_rows({"STI": a.sti}, is_changed=True)
        blocks.append(Table("Speech transmission index", ("", "125 Hz to 8 kHz"), rows))
    return tuple(blocks)


def treatment_sentence(treatment: Treatment) -> str:
    """Return what is hung where, what the decay time does then, and how likely it is enough."""
    first, answer = treatment.arrangements[0], _answer(treatment)
    hung = ", ".join(f"{h.area_m2:.4g} m² {h.product} on {h.surface}" for h in first.hung)
    found = f"{hung or 'Nothing'}." if answer is None else f"{hung or 'Nothing'}: {answer.sentence}"
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


def _answer(treatment: Treatment) -> DecayAnswer | None:
    """Return what the first arrangement does to the decay time."""
    means, before = named_values(treatment.arrangements[0].mean, None), treatment.before
    return decay_answer(treatment.bands, means, is_changed=True, before=before, after="treated")
