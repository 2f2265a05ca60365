"""A treatment as blocks: what to hang where, what it does, and how likely it is enough."""

from __future__ import annotations

from typing import TYPE_CHECKING

from roomfit.base.table import Table
from roomfit.predict.prediction import named_values
from roomfit.report.blocks import (
    Block,
    Blocks,
    Findings,
    Listed,
    Numbers,
    Part,
    Sentence,
    drawing,
)
from roomfit.report.decay_times import Limit
from roomfit.report.predicted import DecayAnswer, decay_answer, parameter_lines, parameter_rows
from roomfit.report.wording import band_tables
from roomfit.treat.arrangements import apart
from roomfit.treat.question import USUAL_HZ

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from roomfit.treat.arrangements import Arrangement, Treatment


def describe(treatment: Treatment) -> Blocks:
    """Return the first arrangement in a sentence, T30 before and after, and all arrangements."""
    answer, first = _answer(treatment, treatment.arrangements[0]), treatment.arrangements[0]
    wanted = "all targets" if len(first.probability) > 1 else "the target"
    words = f"probability that a measurement meets {wanted}"
    area_m2 = sum(h.area_m2 for h in first.hung)
    numbers = [
        (f"{area_m2:.4g} m²", f"hung, cost {first.cost:g}"),
        (f"{_percent(treatment, first.joint)} %", words),
        *([] if answer is None else answer.numbers[:2]),
    ]
    head: list[Block] = [Sentence(treatment_sentence(treatment), "lead")]
    head += [] if answer is None else [answer.drawing(_limits(treatment, answer.symbol))]
    caption = (
        "The room from above one corner. Covered surfaces are coloured, the paler the less of "
        "them is covered; those that face away from the viewer are seen through."
    )
    maker = "prediction_figures.treatment_figure"
    head += [
        Numbers(tuple(numbers)),
        drawing("treatment", "The room and what hangs where", caption, maker, treatment),
    ]
    blocks = [
        Part(_title(treatment, a, number), _arrangement(treatment, a, number), folded=True)
        for number, a in enumerate(treatment.arrangements, start=1)
    ]
    found = Findings(treatment.findings)
    return Blocks("What to hang where", tuple(head), (found, *blocks), "treatment.json")


def draw(treatment: Treatment) -> Figure:
    """Return the room and what hangs where in the first arrangement."""
    from roomfit.report.prediction_figures import treatment_figure

    return treatment_figure(treatment)


def _title(treatment: Treatment, a: Arrangement, number: int) -> str:
    first = f"Arrangement {number}" if treatment.is_met else "Not met; what misses least"
    return f"{first}, cost {a.cost:g}"


def _arrangement(treatment: Treatment, a: Arrangement, number: int) -> tuple[Block, ...]:
    """Return what hangs where, the targets with their odds, what to measure, every parameter."""
    hung = [(h.surface, h.product, f"{h.area_m2:.2f}", f"{100 * h.share:.0f}") for h in a.hung] or [
        ("nothing", "", "", "")
    ]
    odds = [
        (str(t), f"{100 * before:.0f}", _percent(treatment, after))
        for t, before, after in zip(treatment.targets, a.before, a.probability, strict=True)
    ]
    if len(treatment.targets) > 1:
        odds.append(("all targets", "", _percent(treatment, a.joint)))
    more: list[Block] = []
    if a.decisive and not a.is_sure:
        name, share = a.decisive[0]
        words = (
            f"To be surer, measure {name}: {100 * share:.0f} % of the spread of the least likely "
            "target goes with its absorption."
        )
        more = [Sentence(words), *([Listed(treatment.to_measure)] if number == 1 else [])]
    lines = parameter_lines(named_values(a.mean, None), is_changed=True)
    heads = ("target, as a mean over all pairs", "as it is", "treated")
    speech: tuple[Block, ...] = ()
    if a.sti is not None:
        rows = parameter_rows(parameter_lines({"STI": a.sti}, is_changed=True))
        speech = (Table("Speech transmission index", ("", "125 Hz to 8 kHz"), rows),)
    return (
        Table("What hangs where", ("surface", "product", "m²", "% of it"), hung),
        Table("Met with a probability of, %", heads, odds),
        *more,
        *band_tables(
            "Means over all pairs", "parameter", treatment.bands.centres_hz, parameter_rows(lines)
        ),
        *speech,
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
