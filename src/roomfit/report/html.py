"""The report of an answer: one self-contained HTML file, or a table for a notebook.

The answer comes first: one sentence, four figures, the findings as a count that opens, absorption
with its intervals. Then what was measured and predicted, the room, and folded away the rest.
"""

from __future__ import annotations

import base64
import hashlib
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping
from html import escape
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure

from roomfit.base.errors import InputError
from roomfit.base.findings import Code, Finding, Severity
from roomfit.base.table import Cell, Table, html_of
from roomfit.base.typing import BoolArray
from roomfit.predict.diffuse_field import FORMULAS, DiffuseAbsorption
from roomfit.report.decay_times import Series, decay_time_figure
from roomfit.report.disagreement import disagreement_table
from roomfit.report.figures import (
    absorption_figure,
    answer_figures,
    has_curves,
    svg,
)
from roomfit.report.html_tables import (
    absorption_tables,
    area_tables,
    budget_tables,
    coefficient_cells,
    condition_tables,
    error_tables,
    errors_of,
    fit_tables,
    fixed_coefficients,
    known_mean,
    material_rows,
    material_table,
    mean_abs_jnd,
    mean_row,
    overview_table,
    pair_sections,
    pair_title,
    parameter_keys,
    position_table,
    prior_tables,
    share_tables,
    source_tables,
    sti_tables,
)
from roomfit.report.room_figure import MOST_FACES, drawn_faces, room_figure
from roomfit.report.text import DIFFUSE_WORDS
from roomfit.report.usable import remaining_usable
from roomfit.report.wording import (
    DASH,
    area,
    band_heads,
    band_ranges,
    band_tables,
    coefficient,
    count,
    decay_time_key,
    hertz,
    listing,
    number,
    parameter,
)
from roomfit.result import ComparedPair, Result
from roomfit.room.mesh import surface_area_m2, volume_m3
from roomfit.room.scene import Scene, wall_materials
from roomfit.uncertainty.gaussian import LARGEST_CHI2_REDUCED, WIDEST_IDENTIFIABLE

if TYPE_CHECKING:
    from roomfit.files.remedies import Advice

_SEVERITIES: tuple[Severity, ...] = ("serious", "warning", "info")
_MOST_ENDS, _MOST_NAMES = 3, 8
_PROJECT = ("client", "author", "date", "instruments")
_REPORTED = ("T20_s", "T30_s", "EDT_s", "C80_dB")


def summary_sentences(answer: Result) -> tuple[str, ...]:
    """Return what was done, what is identifiable, what is not, and how well it predicts."""
    return tuple(
        sentence
        for sentence in (
            _what_was_done(answer),
            *_what_is_determined(answer),
            _where_it_does_not_fit(answer),
            _how_well_it_predicts(answer),
            _how_many_findings(answer),
        )
        if sentence
    )


def determined_in_words(answer: Result) -> tuple[tuple[str, str], ...]:
    """Return band and sentence where the data know groups of materials, or leave some open."""
    sentences = zip(answer.bands.centres_hz, answer.sentences, strict=False)
    return tuple(
        (hertz(float(centre)), sentence.replace("+-", "\N{PLUS-MINUS SIGN}"))
        for centre, sentence in sentences
        if sentence
    )


def finding_groups(findings: tuple[Finding, ...]) -> tuple[list[Finding], ...]:
    """Return the findings by severity, those of one code together."""
    alike: dict[tuple[Severity, Code], list[Finding]] = {}
    for finding in sorted(findings, key=lambda f: _SEVERITIES.index(f.severity)):
        alike.setdefault((finding.severity, finding.code), []).append(finding)
    return tuple(alike.values())


def _what_was_done(answer: Result) -> str:
    fitted = sum(pair.use == "fit" for pair in answer.pairs)
    kept = len(answer.pairs) - fitted
    data = count(fitted, "fitted measurement")
    if kept:
        data += f" and {count(kept, 'measurement')} kept for validation"
    everywhere = np.ones(len(answer.bands), dtype=np.bool_)
    return (
        f"Absorption of {count(len(answer.materials), 'material')} in "
        f"{count(len(answer.bands), f'{answer.bands.kind} band')} "
        f"({band_ranges(answer.bands.centres_hz, everywhere)}), from {data}; "
        f"method {answer.method}, model {answer.model}."
    )


def _what_is_determined(answer: Result) -> list[str]:
    is_fixed = fixed_coefficients(answer)
    sure = answer.identifiable & ~is_fixed
    wanted = int(np.sum(~is_fixed))
    if not wanted:
        return ["Every coefficient was given; nothing was fitted."]
    sentences = [f"The data determine {int(sure.sum())} of {wanted} coefficients."]
    names, whole, never = answer.materials, [], []
    some = []
    for name, found, fixed in zip(names, sure, is_fixed, strict=True):
        if fixed.all():
            continue
        if (found | fixed).all():
            whole.append(name)
        elif not found.any():
            never.append(name)
        else:
            some.append(f"{name} ({_where(answer, found)})")
    if whole:
        sentences.append(f"Identified in every band: {_first(whole)}.")
    if some:
        sentences.append(f"Identified in some bands: {_first(some)}.")
    if never:
        sentences.append(f"Not identifiable in any band: {_first(never)}.")
    fixed_names = [name for name, fixed in zip(names, is_fixed, strict=True) if fixed.all()]
    if fixed_names:
        sentences.append(f"Given and fixed: {_first(fixed_names)}.")
    return sentences


def _where(answer: Result, found: BoolArray) -> str:
    """Return the bands; their number where they are too scattered to be read."""
    if int(np.sum(np.diff(found.astype(int)) != 0)) > _MOST_ENDS:
        return f"{int(found.sum())} of {len(answer.bands)} bands"
    return band_ranges(answer.bands.centres_hz, found)


def _first(names: list[str]) -> str:
    """Return a list short enough to be read; the tables are complete."""
    more = len(names) - _MOST_NAMES
    return listing(names) if more <= 0 else listing([*names[:_MOST_NAMES], f"{more} more"])


def _where_it_does_not_fit(answer: Result) -> str:
    misfit = answer.chi2_reduced > LARGEST_CHI2_REDUCED
    if not misfit.any():
        return ""
    return (
        f"The model does not explain the data at {band_ranges(answer.bands.centres_hz, misfit)} "
        f"(φ above {LARGEST_CHI2_REDUCED:g}); no coefficient counts as identifiable there."
    )


def _how_well_it_predicts(answer: Result) -> str:
    kept = [pair for pair in answer.pairs if pair.use == "validate"]
    pairs = kept or list(answer.pairs)
    sentences = []
    known = parameter_keys(pairs)
    for key in [key for key in _REPORTED if key in known] or known:
        model, baseline = map(known_mean, errors_of(pairs, key))
        if not np.isfinite(model):
            continue
        how = parameter(key)
        words = f"{how.symbol} {number(model, how.error_decimals)} {how.error_unit}"
        if np.isfinite(baseline):
            words += f" ({number(baseline, how.error_decimals)})"
        sentences.append(words)
    if not sentences:
        return ""
    which = "measurements kept for validation" if kept else "fitted measurements"
    return (
        f"Mean error of the {which}, in brackets that of guessing the mean of the others: "
        f"{listing(sentences)}."
    )


def _how_many_findings(answer: Result) -> str:
    counts = [
        (sum(f.severity == severity for f in answer.findings), severity) for severity in _SEVERITIES
    ]
    words = {"serious": "serious finding", "warning": "warning", "info": "note"}
    counted = [count(n, words[severity]) for n, severity in counts if n]
    return f"Read first: {listing(counted)}." if counted else ""


def headline(answer: Result, say: Callable[[str], str] = str) -> str:
    """Return the answer in one sentence: how many coefficients are determined, and how well.

    Parameters
    ----------
    answer : Result
    say : callable, optional
        Translates sentences before names and numbers are put in.
    """
    is_fixed = fixed_coefficients(answer)
    sure, wanted = answer.identifiable & ~is_fixed, ~is_fixed
    if not wanted.any():
        return say("Every coefficient was given; nothing was fitted.")
    everywhere = np.ones(len(answer.bands), dtype=np.bool_)
    numbers = {
        "found": int(sure.sum()),
        "wanted": int(wanted.sum()),
        "materials": count(len(answer.materials), "material")
        if say is str
        else f"{len(answer.materials)} {say('materials')}",
        "bands": _in_language(band_ranges(answer.bands.centres_hz, everywhere), say),
        "half": _half_width(answer),
    }
    if not sure.any():
        void = any(f.code.voids_identifiability for f in answer.findings)
        words = (
            "The data contradict the description of the room: no absorption coefficient may be "
            "used before the findings are resolved."
            if void
            else "The data do not determine the absorption of any material by itself, only the "
            "mean of the room."
        )
        return say(words)
    open_ = [
        f"{name} ({_in_language(_where(answer, missing), say)})"
        for name, missing in zip(answer.materials, wanted & ~sure, strict=True)
        if missing.any()
    ]
    text = say(
        "The measurements determine {found} of {wanted} absorption coefficients of {materials}, "
        "{bands}, half of them to within ±{half}"
    ).format(**numbers)
    if open_:
        named = open_[:_MOST_OPEN]
        if len(open_) > _MOST_OPEN:
            named.append(f"{len(open_) - _MOST_OPEN}{say(' more')}")
        text += say("; not determined: {names}").format(names=", ".join(named))
    return f"{text}."


_MOST_OPEN = 4


def _in_language(words: str, say: Callable[[str], str]) -> str:
    """Return a list of bands with its small words in the language of the page."""
    if say is str:
        return words
    for small in (" to ", " and ", " of ", " bands"):
        words = words.replace(small, say(small))
    return words


def _half_width(answer: Result) -> str:
    """Return half of the median interval of what is identifiable and was not given."""
    sure = answer.identifiable & ~fixed_coefficients(answer)
    if not sure.any():
        return DASH
    half = 0.5 * float(np.median((answer.upper95 - answer.lower95)[sure]))
    return number(half, 2 if half >= 0.0095 else 3)


def key_figures(answer: Result, say: Callable[[str], str] = str) -> tuple[tuple[str, str], ...]:
    """Return four numbers and what they are: the first screen of the report."""
    fixed = fixed_coefficients(answer)
    found = int((answer.identifiable & ~fixed).sum())
    middle = int(np.argmin(np.abs(np.log2(answer.bands.centres_hz / 1000.0))))
    mean, low, high = (coefficient(x, 1.0) for x in map(float, answer.mean_absorption[:, middle]))
    at = hertz(float(answer.bands.centres_hz[middle]))
    figures = [
        (f"{found} / {int((~fixed).sum())}", say("coefficients determined")),
        *(
            [(f"±{_half_width(answer)}", say("half of them are known to within this, at 95 %"))]
            if found
            else []
        ),
        (f"{mean} ({low}{DASH}{high})", say("mean absorption of the room at {at}").format(at=at)),
    ]
    kept = [pair for pair in answer.pairs if pair.use == "validate"]
    pairs = kept or list(answer.pairs)
    known = parameter_keys(pairs)
    key = decay_time_key(known) or next(iter(known), None)
    if key is None:
        return (*figures, (DASH, say("no measured room parameter to compare with")))
    how = parameter(key)
    model, baseline = (known_mean(x) for x in errors_of(pairs, key))
    words = say("error of predicted {symbol}, mean of {pairs}").format(
        symbol=how.symbol,
        pairs=say("measurements that were not fitted" if kept else "the fitted measurements"),
    )
    if np.isfinite(baseline):
        words += say("; by the mean of the others {baseline}").format(
            baseline=f"{number(baseline, how.error_decimals)} {how.error_unit}"
        )
    return (*figures, (f"{number(model, how.error_decimals)} {how.error_unit}", words))


def findings_count(answer: Result, say: Callable[[str], str] = str) -> str:
    """Return how many findings of which severity there are, for the head of the list."""
    words = {"serious": "serious", "warning": "to look at", "info": "to know"}
    counts = [
        f"{n} {say(words[severity])}"
        for severity in _SEVERITIES
        if (n := sum(f.severity == severity for f in answer.findings))
    ]
    return f"{say('Findings')}: {', '.join(counts) or '0'}"


def _translator(language: str) -> Callable[[str], str]:
    """Return what gives a text of the page in its language; what has no translation is English."""
    if language != "de":
        return str
    german: dict[str, str] = tomllib.loads(_template("german.toml").render())
    return lambda english: german.get(english, english)


def _css_string(text: str) -> Markup:
    """Return a text as a string of a style sheet that no character of it can end."""
    plain = " ".join(text.split())
    return Markup(
        '"{}"'.format(
            "".join(c if c.isalnum() and c.isascii() else f"\\{ord(c):x} " for c in plain)
        )
    )


def report_html(
    answer: Result,
    scene: Scene,
    *,
    title: str,
    campaign: str | None = None,
    inputs_sha256: Mapping[str, str] | None = None,
    project: Mapping[str, str] | None = None,
    figures: Mapping[str, Figure] | None = None,
    advice: Advice | None = None,
) -> str:
    """Return the report of an identification as the text of one HTML file.

    Its order: the answer in a sentence, four figures, findings as a count that opens, absorption
    with its intervals; predictions beside measurements and the baseline, the room; folded away
    profiles, priors, absorption areas, single pairs and provenance. The file executes nothing and
    requests nothing: figures are SVG within it, and the page's own content security policy forbids
    scripts and requests. Equal arguments give equal text.

    Parameters
    ----------
    answer : Result
    scene : Scene
        That the answer was found in: room, positions and air.
    title : str
    campaign : str, optional
        Name of the campaign file, for provenance.
    inputs_sha256 : mapping of str to str, optional
        SHA-256 of every input file by its name.
    project : mapping of str to str, optional
        Of client, author, date, instruments, language ("en" or "de": headings and the first
        screen, not findings) and logo (a data URL of PNG or JPEG) what there is.
    figures : mapping of str to Figure, optional
        Those of `answer_figures`, `mean_decay_figure` ("decay_times") and `room_figure` ("room"),
        where they are written as files, too.
    advice : mapping of Code to lines, optional
        What findings advise to write into the campaign, see `roomfit.files.remedies.advice`.

    Returns
    -------
    str
        Write it as UTF-8.

    Examples
    --------
    >>> import roomfit
    >>> room = roomfit.shoebox_room((6.0, 5.0, 3.0), "plaster")
    >>> scene = roomfit.scene_of(room, {"S": (1.5, 1.2, 1.5)}, {"R": (4.0, 3.5, 1.2)})
    >>> measured = roomfit.MeasuredValues("S", "R", [1000.0], {"T20_s": [0.8]})
    >>> octave, few = roomfit.bands_between("octave", 1000, 1000), roomfit.Settings(n_rays=2000)
    >>> result = roomfit.identify(scene, [measured], bands=octave, settings=few)
    >>> page = report_html(result, scene, title="Lecture room")
    >>> "<title>Lecture room</title>" in page, "<script" in page
    (True, False)
    """
    choices = tuple(pair for pair in answer.pairs if has_curves(pair))
    off = [mean_abs_jnd(pair) for pair in choices]
    about = dict(project or {})
    language, logo = about.pop("language", "en"), about.pop("logo", "")
    if logo and not re.fullmatch(r"data:image/(png|jpeg);base64,[A-Za-z0-9+/=]+", logo):
        raise InputError("the logo is no data URL of PNG or JPEG", found=repr(logo[:40]))
    say = _translator(language)
    drawn = answer_figures(answer) if figures is None else figures
    return render_sealed(
        "report.html.j2",
        t=say,
        language="de" if language == "de" else "en",
        title=title,
        running=_css_string(" · ".join(filter(None, (title, about.get("client", ""))))),
        page_words=tuple(_css_string(say(word)) for word in ("Page", "of")),
        project=tuple((k, v) for k in _PROJECT if (v := about.get(k))),
        logo=logo,
        headline=headline(answer, say),
        usable=remaining_usable(answer),
        decay_times=_decay_times(answer, drawn if language == "en" else {}, say),
        figures=key_figures(answer, say),
        findings_count=findings_count(answer, say),
        summary=summary_sentences(answer),
        findings=finding_groups(answer.findings),
        advice=advice or {},
        room=_room(scene, drawn),
        materials=material_table(scene.room),
        positions=position_table(scene),
        answer=answer,
        absorption=_absorption(answer, drawn if language == "en" else {}, say),
        certainty=_certainty(drawn),
        prior_tables=prior_tables(answer),
        budget_tables=budget_tables(answer),
        condition_tables=condition_tables(answer),
        absorption_tables=absorption_tables(answer, say),
        fit_tables=(*fit_tables(answer), *source_tables(answer)),
        area_tables=(*area_tables(answer, scene), *share_tables(answer)),
        determined=determined_in_words(answer),
        disagreement=disagreement_table(answer, scene),
        error_tables=(*error_tables(answer), *sti_tables(answer)),
        overview=overview_table(answer),
        decay=_decays(drawn["decays"], len(choices)) if choices else None,
        curves=tuple(pair_title(pair) for pair in choices),
        chosen=int(np.argmax(np.nan_to_num(off, nan=-1.0))) if off else 0,
        without_curve=len(answer.pairs) - len(choices),
        pairs=pair_sections(answer),
        provenance=_provenance(answer, scene, campaign),
        inputs=tuple((inputs_sha256 or {}).items()),
    )


def tables_page(title: str, lead: str, shown: Iterable[Table]) -> str:
    """Return a page of a few tables, in the style and under the policy of the report."""
    return render_sealed("list.html.j2", title=title, lead=lead, shown=tuple(shown))


def answer_page(
    title: str,
    lead: str,
    picture: Figure | None,
    figures: Iterable[tuple[str, str]],
    findings: tuple[Finding, ...],
    tables: Iterable[tuple[str, str, Iterable[Table]]],
    *,
    more: Markup | str = "",
) -> str:
    """Return a page under the policy of the report.

    Parameters
    ----------
    title, lead : str
        The lead is the answer in a sentence.
    picture : Figure, optional
        From `decay_time_figure`.
    figures : iterable of (number, words)
    findings : tuple of Finding
    tables : iterable of (heading, words, tables)
        Each folded.
    more : Markup, optional
        Below the figures, as another picture.
    """
    drawn: Markup | str = ""
    if picture is not None:
        caption = (
            "Means over the positions; bars are 95 % intervals. A listener does not notice "
            "what stays within the pale box of a band."
        )
        drawn = drawing(picture, "decay-times", "Decay times over frequency", caption)
    return render_sealed(
        "answer.html.j2",
        title=title,
        lead=lead,
        picture=drawn,
        figures=tuple(figures),
        more=more,
        findings=finding_groups(findings),
        n_findings=len(findings),
        serious=any(f.severity == "serious" for f in findings),
        folded=[(heading, words, tuple(shown)) for heading, words, shown in tables],
    )


def render_sealed(template: str, **content: Any) -> str:
    """Return a page of one of the templates, under its own policy."""
    text: str = _template(template).render(**content)
    return _sealed(text)


def diffuse_page(found: DiffuseAbsorption) -> str:
    """Return mean absorption from decay times as a page: times, formulas, materials by Eyring."""

    centres, eyring = found.bands.centres_hz, found.absorption[FORMULAS.index("Eyring")]
    measured = zip(found.decay_s.tolist(), found.decay_sd_s.tolist(), strict=True)
    times = [Cell(number(t, 2), (f"± {number(sd, 2)}",)) for t, sd in measured]
    means = zip(FORMULAS, found.mean, strict=True)
    materials = zip(found.materials, eyring, strict=True)
    shown = (
        *band_tables(
            "Decay time in s, with its standard deviation",
            "",
            centres,
            [("mean over positions", *times)],
        ),
        *band_tables(
            "Mean absorption of the room, 95 % interval",
            "formula",
            centres,
            [(formula, *coefficient_cells(values)) for formula, values in means],
        ),
        *band_tables(
            "Materials by Eyring: their priors, moved together, and no more",
            "material",
            centres,
            [(name, *coefficient_cells(values)) for name, values in materials],
        ),
    )
    middle = int(np.argmin(np.abs(np.log(centres / 500.0))))
    value, low, high = (number(x, 2) for x in found.mean[FORMULAS.index("Eyring"), :, middle])
    first = f"By Eyring the mean absorption of the room at {hertz(centres[middle])} is {value} "
    lead = f"{first}({low} to {high}). {DIFFUSE_WORDS}"
    return tables_page("Mean absorption from decay times", lead, shown)


def _sealed(page: str) -> str:
    """Enter the digests of the page's own style rules into its policy: no others hold."""
    rules = re.findall(r"<style>(.*?)</style>", page, flags=re.DOTALL)
    digests = {base64.b64encode(hashlib.sha256(rule.encode()).digest()).decode() for rule in rules}
    return page.replace("RULES", " ".join(f"'sha256-{d}'" for d in sorted(digests)), 1)


def result_fragment(answer: Result) -> str:
    """Return absorption with its 95 % intervals as an HTML table without a page, for a notebook.

    One row a material, one column a band, and the mean of the room; a question mark and grey
    follow what is not identifiable, "given" what was fixed. Where findings void walls, what remains
    usable stands above it.
    """

    caption = f"Absorption coefficient, 95 % interval ({answer.interval_kind}); "
    rows = [
        (Cell(row[0].text), *map(_without_brackets, row[1:]))
        for row in (*material_rows(answer), mean_row(answer))
    ]
    heads = ("", *band_heads(answer.bands.centres_hz))
    usable = "".join(f"<p>{escape(sentence)}</p>" for sentence in remaining_usable(answer))
    shown = html_of(Table(caption + "? = not identifiable", heads, rows), "roomfit")
    return usable + _FRAGMENT_STYLE + shown


_FRAGMENT_STYLE = (
    "<style>table.roomfit td.unsure { color: #777 } table.roomfit small { display: block }</style>"
)


def _without_brackets(cell: Cell) -> Cell:
    """Return a cell as a page without a style sheet shows it: a question mark says what is open."""
    doubt = "?" if cell.style == "unsure" and cell.text != DASH else ""
    return Cell(f"{cell.text.strip('()')}{doubt}", cell.small[:1], cell.style)


def drawing(
    figure: Figure, name: str, title: str, caption: str, narrow: Figure | None = None
) -> Markup:
    """Return a figure element; words become part of its SVG escaped.

    Where there is a `narrow` drawing, it stands instead of the other on the screen of a telephone.
    """
    wide = Markup(svg(figure, name, title))
    if narrow is None:
        drawings = Markup('<div class="drawing">{}</div>').format(wide)
    else:
        drawings = Markup(
            '<div class="drawing wide-only">{}</div>\n<div class="drawing narrow-only">{}</div>'
        ).format(wide, Markup(svg(narrow, f"{name}-narrow", title)))
    return Markup("<figure>\n{}\n<figcaption>{}</figcaption>\n</figure>\n").format(
        drawings, caption
    )


def _room(scene: Scene, drawn: Mapping[str, Figure]) -> Markup:
    caption = (
        "Above: the room without the walls towards the viewer, colours as in the table of "
        "materials; dotted lines lead down to the floor. Below: the plan with its materials and "
        "two side views, all to one scale."
    )
    _, n_observed = drawn_faces(scene.room)
    if n_observed > MOST_FACES:
        caption += f" Of {n_observed} faces in view only the largest {MOST_FACES} are drawn."
    title = (
        f"The room with {count(len(wall_materials(scene.room)), 'material')}, "
        f"{count(len(scene.sources), 'source')} and {count(len(scene.receivers), 'receiver')}: "
        "in space, in plan and from two sides; the tables below hold the numbers."
    )
    wide = drawn.get("room") or room_figure(scene)
    return drawing(wide, "room", title, caption, room_figure(scene, narrow=True))


def _decay_times(
    answer: Result, drawn: Mapping[str, Figure], say: Callable[[str], str]
) -> Markup | str:
    """Return measured and predicted decay times over frequency, means over the pairs."""
    narrow = mean_decay_figure(answer, say, narrow=True)
    wide = drawn.get("decay_times") or mean_decay_figure(answer, say)
    if narrow is None or wide is None:
        return ""
    symbol = parameter(_shown_decay(answer)[1] or "").symbol
    is_kept = any(pair.use == "validate" for pair in answer.pairs)
    which = "measurements that were not fitted" if is_kept else "the fitted measurements"
    return drawing(
        wide,
        "decay-times",
        f"{symbol} over frequency, measured and predicted",
        say(
            "{symbol} over frequency, mean of {pairs}. A listener does not notice what stays "
            "within the pale box of a band, one just noticeable difference about what was measured."
        ).format(symbol=symbol, pairs=say(which)),
        narrow,
    )


def _shown_decay(answer: Result) -> tuple[list[ComparedPair], str | None]:
    """Return the pairs kept for validation, else all, and which decay time of them is shown."""
    kept = [pair for pair in answer.pairs if pair.use == "validate"]
    pairs = kept or list(answer.pairs)
    known = parameter_keys(pairs)
    return pairs, "T30_s" if "T30_s" in known else decay_time_key(known)


def mean_decay_figure(
    answer: Result, say: Callable[[str], str] = str, *, narrow: bool = False
) -> Figure | None:
    """Return measured and predicted decay times, means over the pairs; None where none is known."""
    pairs, key = _shown_decay(answer)
    if key is None:
        return None
    both = np.array(
        [
            (p.parameters[key].measured, p.parameters[key].predicted)
            for p in pairs
            if key in p.parameters
        ]
    )
    # only where both are known, so that means are over the same pairs
    both = np.where(np.isfinite(both).all(axis=1, keepdims=True), both, np.nan)
    n_known = np.isfinite(both).sum(axis=0)
    if not n_known.any():
        return None
    with np.errstate(invalid="ignore", divide="ignore"):
        measured, predicted = np.where(n_known > 0, np.nansum(both, axis=0) / n_known, np.nan)
    series = (Series(say("measured"), measured), Series(say("predicted"), predicted))
    symbol = parameter(key).symbol
    return decay_time_figure(answer.bands.centres_hz, series, symbol, narrow=narrow)


def _absorption(answer: Result, drawn: Mapping[str, Figure], say: Callable[[str], str]) -> Markup:
    return drawing(
        drawn.get("absorption") or absorption_figure(answer, say=say),
        "absorption",
        f"Absorption coefficient over frequency with 95 % intervals, "
        f"{count(len(answer.materials), 'material')} and the mean of the room; the table below "
        "holds every number.",
        say(
            "Points with bars: absorption and its 95 % interval. Filled: identifiable. Hollow: not "
            "identifiable, the number may come from the prior. Diamonds: given. "
            "Above each panel the area of the material, and in how many bands it is identifiable."
        ),
        absorption_figure(answer, narrow=True, say=say),
    )


def _certainty(drawn: Mapping[str, Figure]) -> tuple[Markup, ...]:
    drawings = [
        drawing(
            drawn["identifiable"],
            "identifiable",
            "Matrix of materials by bands: width of the 95 % interval; the tables hold every "
            "number.",
            "Width of the 95 % interval of every coefficient, dark where it is narrow. The scale "
            f"ends at {WIDEST_IDENTIFIABLE:g}, beyond which nothing is identifiable. A tick marks "
            "what is identifiable, G what was given.",
        )
    ]
    if "profiles" in drawn:
        drawings.append(
            drawing(
                drawn["profiles"],
                "profiles",
                "Profiles of the likelihood of single coefficients; their ends are in the table.",
                "How the cost rises when one coefficient is moved and all else is fitted again, "
                "misfit taken out. The 95 % interval ends where the curve meets the dotted line "
                "at 1.92; bands beside are taken for another standard deviation where absorption "
                "changes fast.",
            )
        )
    return tuple(drawings)


def _decays(figure: Figure, n_pairs: int) -> Markup:
    caption = (
        "Energy left in the room relative to the whole, after each time; above each panel the "
        "decay time, measured → predicted, and shaded the range of levels from which it was read. "
        "Where the measured curve meets the dotted line the noise takes over: later energy is "
        "extrapolated."
    )
    if n_pairs > 1:
        caption += " Shown first: the pair whose parameters are furthest off."
    return drawing(
        figure,
        "decay",
        f"Measured and predicted energy decay curves of {count(n_pairs, 'pair')}, one panel a "
        "band; the tables below hold the parameters derived from them.",
        caption,
    )


def _provenance(answer: Result, scene: Scene, campaign: str | None) -> tuple[tuple[str, str], ...]:
    mesh, air = scene.room.mesh, scene.air
    return (
        ("roomfit", version("roomfit")),
        ("campaign", campaign or "not specified"),
        ("method, model", f"{answer.method}, {answer.model}"),
        ("intervals", answer.interval_kind),
        ("seed", str(answer.seed)),
        ("time", f"{number(answer.seconds, 1)} s"),
        ("evaluations", str(answer.evaluations)),
        ("cost", f"{number(answer.cost, 2)} (half the sum of squared weighted residuals)"),
        ("room", f"V = {area(volume_m3(mesh))} m³, S = {area(surface_area_m2(mesh))} m²"),
        (
            "air",
            f"{number(air.temperature_c, 1)} °C, {number(air.humidity_percent, 0)} % relative "
            f"humidity, {number(air.pressure_kpa, 1)} kPa; attenuation "
            f"{'by ISO 9613-1' if air.attenuation == 'iso9613' else 'none'}",
        ),
        ("speed of sound", f"{number(answer.speed_of_sound_m_s, 2)} m/s"),
    )


def _template(name: str) -> Any:
    environment = Environment(
        loader=PackageLoader("roomfit.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals["html_of"] = lambda *shown: Markup(html_of(*shown))
    return environment.get_template(name)
