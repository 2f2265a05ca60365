"""A treatment as blocks: what to hang where, what it does, and how likely it is enough."""

from __future__ import annotations

from typing import TYPE_CHECKING

from roomfit.base.table import Table
from roomfit.predict.prediction import named_values
from roomfit.report.blocks import Block, Blocks, Drawing, Findings, Listed, Part, Sentence
from roomfit.report.predicted import DecayAnswer, decay_answer, parameter_rows
from roomfit.report.wording import band_tables
from roomfit.treat.arrangements import apart
from roomfit.treat.question import USUAL_HZ

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from roomfit.treat.arrangements import Arrangement, Treatment


def describe(treatment: Treatment) -> Blocks:
    """Return the first arrangement in a sentence, T30 before and after, and all arrangements."""
    answer = _answer(treatment)
    head: list[Block] = [Sentence(treatment_sentence(treatment), "lead")]
    if answer is not None:
        limits = [
            (t.bands_hz or USUAL_HZ, t.low, t.high)
            for t in treatment.targets
            if t.parameter == f"{answer.symbol}_s"
        ]
        head.append(answer.drawing(limits))
    caption = (
        "The room from above one corner. Covered surfaces are coloured, the paler the less of "
        "them is covered; those that face away from the viewer are seen through."
    )
    maker = "prediction_figures.treatment_figure"
    title = "The room and what hangs where"
    head.append(Drawing("treatment", title, caption, maker, (treatment,)))
    blocks: list[Block] = [Findings(treatment.findings)]
    for number, a in enumerate(treatment.arrangements, start=1):
        title = f"Arrangement {number}" if treatment.is_met else "Not met; what misses least"
        shown = _arrangement(treatment, a, number)
        blocks.append(Part(f"{title}, cost {a.cost:g}", shown, folded=True))
    return Blocks("What to hang where", tuple(head), tuple(blocks), "treatment.json")


def draw(treatment: Treatment) -> Figure:
    """Return the room and what hangs where in the first arrangement."""
    from roomfit.report.prediction_figures import treatment_figure

    return treatment_figure(treatment)


def _arrangement(treatment: Treatment, a: Arrangement, number: int) -> tuple[Block, ...]:
    """Return what hangs where, the targets with their odds, what to measure, every parameter."""
    hung = [(h.surface, h.product, f"{h.area_m2:.2f}", f"{100 * h.share:.0f}") for h in a.hung]
    odds = [
        (str(t), f"{100 * before:.0f}", _percent(treatment, after))
        for t, before, after in zip(treatment.targets, a.before, a.probability, strict=True)
    ]
    if len(treatment.targets) > 1:
        odds.append(("all targets", "", _percent(treatment, a.joint)))
    heads = ("target, as a mean over all pairs", "as it is", "treated")
    blocks: list[Block] = [
        Table(
            "What hangs where", ("surface", "product", "m²", "% of it"),
            hung or [("nothing", "", "", "")],
        ),
        Table("Met with a probability of, %", heads, odds),
    ]  # fmt: skip
    if a.decisive and not a.is_sure:
        name, share = a.decisive[0]
        words = (
            f"To be surer, measure {name}: {100 * share:.0f} % of the spread of the least likely "
            "target goes with its absorption."
        )
        blocks += [Sentence(words), *([Listed(treatment.to_measure)] if number == 1 else [])]
    rows = parameter_rows(named_values(a.mean, None), is_changed=True)
    centres_hz = treatment.bands.centres_hz
    blocks += band_tables("Means over all pairs", "parameter", centres_hz, rows)
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
