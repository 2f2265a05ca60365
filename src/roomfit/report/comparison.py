"""Two answers beside each other: which coefficients of the same materials differ, and how surely.

Before and after a renovation, two methods, or two measurements of one room.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from scipy.special import ndtr, ndtri

from roomfit.base.errors import InputError
from roomfit.base.table import Column, Shown, Table, csv_of
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.base.whole_files import check_output_folder, whole_output_folder, write_text_atomically
from roomfit.files.encoding import ResultFile
from roomfit.files.results import read_result
from roomfit.report.blocks import Blocks, Sentence
from roomfit.report.wording import count, hertz, listing
from roomfit.uncertainty.posterior import AbsorptionPosterior

Verdict = Literal["changed", "perhaps", "no", "given"]
FALSE_ALARM_RATE = 0.05
"""That any coefficient is called changed where none did; and of each that is called perhaps."""
_QUANTILE95 = float(ndtri(0.975))


@dataclass(frozen=True, slots=True, eq=False)
class Comparison(Shown):
    """Absorption of the materials and bands that two answers have in common."""

    described_in: ClassVar[str] = "comparison"

    materials: tuple[str, ...]
    centres_hz: FloatArray  # (n_bands,)
    # (3, n_materials, n_bands), coefficient and its 95 % bounds, of the first and of the second
    first: FloatArray
    second: FloatArray
    difference: FloatArray  # (3, n_materials, n_bands), second minus first with its 95 % bounds
    p_value: FloatArray  # (n_materials, n_bands), of no difference; 1 where both were given alike
    verdicts: tuple[tuple[Verdict, ...], ...]  # by material and band
    missing: tuple[str, ...]  # sentences on what only one of the two has


def compare_results(first: AbsorptionPosterior, second: AbsorptionPosterior) -> Comparison:
    """Compare the absorption of two answers, material by material and band by band.

    Of `roomfit.absorption_posterior` or `roomfit.read_result`. Materials are matched by name, bands
    by centre frequency; `InputError` where none is in both.

    Notes
    -----
    Errors of the two are taken as independent. The 95 % bounds of a difference are those of
    MOVER [1]_ from the bounds of both, so that skew intervals stay skew:
    ``d - sqrt((b - l_b)^2 + (u_a - a)^2)`` below, the mirror image above. Its standard deviation
    is what the bound on the side of 0 is of ``d``: the root of the summed variances where
    intervals are symmetrical. "Changed" are differences that remain when the whole table is to
    raise a false alarm in 5 % of cases at most, by Holm's step-down [2]_, whatever depends on
    what; "perhaps" are those whose own bounds exclude 0.

    What both answers have in common (positions, air, a directivity, a prior, the geometry of one
    model) is in both intervals and cancels in part: the test then finds less than there is. A
    description that is wrong in one of the two only is in neither.

    References
    ----------
    .. [1] G. Y. Zou, A. Donner, "Construction of confidence limits about effect measures: a
           general approach", Statistics in Medicine 27, 1693-1702 (2008).
    .. [2] S. Holm, "A simple sequentially rejective multiple test procedure", Scandinavian Journal
           of Statistics 6, 65-70 (1979).

    Examples
    --------
    >>> import roomfit
    >>> bands = roomfit.bands_between("octave", 500, 500)
    >>> def found(a, low, high):
    ...     table = (np.array([[x]]) for x in (a, low, high))
    ...     return AbsorptionPosterior(("wall",), bands, *table, np.full((1, 1, 1), 0.01))
    >>> compared = compare_results(found(0.1, 0.08, 0.12), found(0.3, 0.27, 0.33))
    >>> compared.verdicts, np.round(compared.difference[:, 0, 0], 3).tolist()
    ((('changed',),), [0.2, 0.164, 0.236])
    """
    if first.bands.kind != second.bands.kind:
        raise InputError(
            "the two results have bands of different width",
            found=f"{first.bands.kind} and {second.bands.kind} bands",
            needed="both in octaves, or both in third octaves",
            hint="identify one of the two again in the bands of the other",
        )
    heads = [tuple(hertz(float(f)) for f in x.bands.centres_hz) for x in (first, second)]
    names, only = _in_common("material", first.materials, second.materials)
    _, only_bands = _in_common("band", *heads)
    sentences = sorted((*only, *only_bands), key=lambda text: "first" not in text)
    centres = np.intersect1d(first.bands.centres_hz, second.bands.centres_hz)
    a, b = (_chosen(x, names, centres) for x in (first, second))
    difference, p_value, given = _differences(a, b)
    verdicts = _verdicts(p_value, given)
    return Comparison(tuple(names), centres, a, b, difference, p_value, verdicts, tuple(sentences))


def _in_common(
    what: str, first: tuple[str, ...], second: tuple[str, ...]
) -> tuple[list[str], list[str]]:
    """Return the names that both have, and sentences on those that only one has."""
    common = [name for name in first if name in second]
    if not common:
        raise InputError(
            f"the two results have no {what} in common",
            found=f"{', '.join(first)} and {', '.join(second)}",
            needed="the same names in both campaigns" if what == "material" else "one band",
            hint="compare two results of one room, fitted in a common band",
        )
    lone = {"first": set(first) - set(common), "second": set(second) - set(common)}
    return common, [
        f"Only the {which} result has the {what}{'s' * (len(own) > 1)} "
        f"{listing([name for name in (*first, *second) if name in own])}."
        for which, own in lone.items()
        if own
    ]


def _chosen(answer: AbsorptionPosterior, names: list[str], centres_hz: FloatArray) -> FloatArray:
    """Return coefficients and bounds of these materials and bands."""
    rows = np.array([answer.materials.index(name) for name in names])
    columns = np.flatnonzero(np.isin(answer.bands.centres_hz, centres_hz))
    tables = (answer.absorption, answer.lower95, answer.upper95)
    return np.stack([table[np.ix_(rows, columns)] for table in tables])


def _differences(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return differences with bounds, p-values, and where both coefficients were given."""
    d = b[0] - a[0]
    below = np.sqrt((b[0] - b[1]) ** 2 + (a[2] - a[0]) ** 2)
    above = np.sqrt((b[2] - b[0]) ** 2 + (a[0] - a[1]) ** 2)
    given = (below == 0.0) & (above == 0.0)
    towards = np.where(d > 0.0, below, above)
    with np.errstate(divide="ignore", invalid="ignore"):
        z = np.where(d == 0.0, 0.0, np.abs(d) / towards) * _QUANTILE95
    p_value = np.where(np.isfinite(d), 2.0 * ndtr(-np.nan_to_num(z, posinf=np.inf)), 1.0)
    return np.stack([d, d - below, d + above]), p_value, given


def _verdicts(p_value: FloatArray, given: BoolArray) -> tuple[tuple[Verdict, ...], ...]:
    order = np.argsort(p_value, axis=None, kind="stable")
    order = order[~given.ravel()[order]]
    n = len(order)
    # the first that fails ends the list: Holm
    passed = p_value.ravel()[order] <= FALSE_ALARM_RATE / np.arange(n, 0, -1)
    sure = np.zeros(p_value.size, dtype=np.bool_)
    sure[order[: n if passed.all() else int(np.argmin(passed))]] = True
    words = np.where(sure, "changed", np.where(p_value.ravel() <= 0.05, "perhaps", "no"))
    exact = np.where(p_value == 0.0, "changed", "given")
    verdicts = np.where(given, exact, words.reshape(p_value.shape))
    return tuple(tuple(row) for row in verdicts.tolist())


def comparison_sentences(compared: Comparison) -> tuple[str, ...]:
    """Return what changed, at which rate of false alarms, and what the comparison cannot know."""
    verdicts = np.array(compared.verdicts)
    tested = int((verdicts != "given").sum())
    changed, perhaps = (int((verdicts == v).sum()) for v in ("changed", "perhaps"))
    by_chance = f"{FALSE_ALARM_RATE * tested:.1f}"
    return (
        f"{changed} of {count(tested, 'coefficient')} changed (*), {perhaps} perhaps (?).",
        f"Were nothing changed, a * would appear anywhere in {100 * FALSE_ALARM_RATE:g} % of such "
        f"tables at most (Holm), and on average {by_chance} coefficients would bear a ? or *.",
        "Errors of the two results are taken as independent. Which they share (positions, air, "
        "source, prior, model) is not known: shared errors cancel, and the test then finds less "
        "than there is. An error of the description of one of them is in neither interval.",
        *compared.missing,
    )


_MARKS = {"changed": "*", "perhaps": "?", "no": "", "given": "="}


def describe(compared: Comparison) -> Blocks:
    """Return the table: first, second, difference with its 95 % bounds."""
    rows = []
    for i, name in enumerate(compared.materials):
        for j, centre in enumerate(compared.centres_hz):
            first, second = (_interval(x[:, i, j]) for x in (compared.first, compared.second))
            d, low, high = compared.difference[:, i, j]
            difference = f"{d:+.3f} ({low:+.3f} to {high:+.3f})"
            mark = _MARKS[compared.verdicts[i][j]]
            rows.append((name, centre, first, second, difference, mark))
    columns = ("material", "Hz", "first", "second", "difference", "")
    words = tuple(map(Sentence, comparison_sentences(compared)))
    return Blocks("Absorption compared", (Table("", columns, rows), *words), ())


def compare_to_folder(
    first: ResultFile, second: ResultFile, out: Path | None = None, *, overwrite: bool = False
) -> Comparison:
    """Compare two files of results; write compared.csv where there is a folder for it."""
    if out is not None:
        check_output_folder(out, overwrite=overwrite)
    compared = compare_results(read_result(first), read_result(second))
    if out is not None:
        with whole_output_folder(out, overwrite=overwrite) as folder:
            write_text_atomically(folder / "compared.csv", csv_of(comparison_records(compared)))
    return compared


def _interval(values: FloatArray) -> str:
    value, low, high = (float(v) for v in values)
    return f"{value:.3f} ({low:.3f}-{high:.3f})"


def comparison_records(compared: Comparison) -> Table:
    """Return the content of compared.csv: numbers with five decimals, and the verdict."""
    columns: list[str | Column] = [
        *("material", Column("band_hz"), "first", "first_lower95", "first_upper95"),
        *("second", "second_lower95", "second_upper95"),
        *("difference", "difference_lower95", "difference_upper95"),
        *(Column("p_value", ".3g"), "changed"),
    ]
    tables = np.concatenate([compared.first, compared.second, compared.difference])
    rows = [
        (name, centre, *tables[:, i, j], compared.p_value[i, j], compared.verdicts[i][j])
        for i, name in enumerate(compared.materials)
        for j, centre in enumerate(compared.centres_hz)
    ]
    return Table("", columns, rows, form=".5f")
