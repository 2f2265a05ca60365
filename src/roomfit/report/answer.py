"""An identification as blocks: the answer first, then why, how sure, and from what."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from importlib.metadata import version
from typing import TYPE_CHECKING

import numpy as np

from roomfit.base.table import Cell, Table
from roomfit.base.typing import BoolArray
from roomfit.report import tables, wording
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
from roomfit.report.doubts import disagreement_table, remaining_usable, serious_lines
from roomfit.report.html import page
from roomfit.result import ComparedPair, Result
from roomfit.room.mesh import surface_area_m2, volume_m3
from roomfit.room.scene import Scene, wall_materials

if TYPE_CHECKING:
    from roomfit.files.remedies import Advice

_MOST_ENDS, _MOST_OPEN, _MOST_DECAY_FILES = 3, 4, 12
_PROJECT = ("client", "author", "date", "instruments")


def report_html(
    answer: Result,
    scene: Scene,
    *,
    title: str,
    campaign: str | None = None,
    inputs_sha256: Mapping[str, str] | None = None,
    project: Mapping[str, str] | None = None,
) -> str:
    """Return the report of an identification as the text of one HTML file, see `result_blocks`.

    The file executes nothing and requests nothing; equal arguments give equal text. Write it as
    UTF-8.

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
        Of client, author, date, instruments, language ("en", "de" or "fr") and logo (a data
        URL of PNG or JPEG) what there is.

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
    return page(
        result_blocks(
            answer, scene, title=title, campaign=campaign, inputs_sha256=inputs_sha256,
            project=project,
        )
    )  # fmt: skip


def describe(answer: Result) -> Blocks:
    """Return what a result says without its room."""
    return result_blocks(answer)


def result_blocks(
    answer: Result,
    scene: Scene | None = None,
    *,
    title: str = "Absorption",
    campaign: str | None = None,
    inputs_sha256: Mapping[str, str] | None = None,
    project: Mapping[str, str] | None = None,
    advice: Advice | None = None,
) -> Blocks:
    """Return an identification as blocks, see `report_html`.

    First the answer; folded away how sure it is, and where it comes from. `advice` is what findings
    advise to write into the campaign.
    """
    about, files = project or {}, inputs_sha256 or {}
    first, *usable = (*remaining_usable(answer), headline(answer))
    head: list[Block] = [
        Sentence(first, "lead"),
        Terms(key_figures(answer), are_numbers=True),
        *_decay_times(answer),
        tables.answer_table(answer),
        Listed(serious_lines(answer.findings)),
        Sentence(_next_step(answer)),
    ]
    blocks: list[Block] = [
        Findings(answer.findings, advice or {}),
        *map(Sentence, usable),
        Part("Absorption", tuple(_absorption(answer)), "absorption"),
        Part("Measured and predicted", tuple(_predictions(answer, scene)), "predictions"),
    ]
    if scene is not None:
        blocks.append(Part("The room", _room(scene), "room", in_text=False))
    if answer.plan:
        words = "The plan in words: no recording tells it from its mirror image"
        blocks.append(Part(words, (Listed(answer.plan),), folded=True, on_paper=False))

    def folded(heading: str, name: str, words: str, shown: Iterable[Block]) -> None:
        blocks.append(Part(heading, tuple(shown), name, words, folded=True, in_text=False))

    words = "how well the model explains what was measured"
    folded("How sure", "certainty", words, (*tables.fit_tables(answer), Sentence(_PHI, "note")))
    if scene is not None:
        areas: list[Block] = [Sentence(_AREAS), *tables.area_tables(answer, scene)]
        words = "\N{GREEK SMALL LETTER ALPHA}S of every material, and its share of the room"
        areas += tables.rating_tables(answer)
        folded("Absorption areas", "areas", words, areas)
    words = "every room parameter, measured and predicted"
    folded("Pair by pair", "pairs", words, _pairs(answer))
    if scene is not None:
        words = "how the answer was made, and from which files"
        made = _provenance(answer, scene, campaign, files)
        folded("Provenance", "provenance", words, made)
    return Blocks(
        title,
        tuple(head),
        tuple(blocks),
        project=tuple((k, v) for k in _PROJECT if (v := about.get(k))),
        logo=about.get("logo", ""),
        language=about.get("language", "en"),
        names=frozenset() if scene is None else names_of(scene, title, *files, *about.values()),
    )


_PHI = (
    "φ is chi-square over degrees of freedom. Where it is above 2 the model does not explain the "
    "data, and no coefficient counts as identifiable."
)
_AREAS = (
    "Absorption coefficient times area, summed over the surfaces, and what the air absorbs. "
    "Brackets: the coefficient is not identifiable; the sum is known better than its parts. A "
    "share is that of one material in the sum of all surfaces."
)


# ---------------------------------------------------------------- the first screen


def headline(answer: Result) -> str:
    """Return the answer in one sentence: how many coefficients are determined, and how well."""
    is_fixed = tables.fixed_coefficients(answer)
    sure, wanted = answer.identifiable & ~is_fixed, ~is_fixed
    if not wanted.any():
        return "Every coefficient was given; nothing was fitted."
    if not sure.any():
        if any(f.code.voids_identifiability for f in answer.findings):
            return (
                "The data contradict the description of the room: no absorption coefficient may "
                "be used before the findings are resolved."
            )
        if not tables.known_means(answer).any():
            return "The data determine neither any material nor the mean of the room."
        return (
            "The data do not determine the absorption of any material by itself: the mean of the "
            "room, the groups and what the walls are made of are the answer together."
        )
    everywhere = np.ones(len(answer.bands), dtype=np.bool_)
    half = 0.5 * float(np.median((answer.upper95 - answer.lower95)[sure]))
    text = (
        f"The measurements determine {int(sure.sum())} of {int(wanted.sum())} absorption "
        f"coefficients of {wording.count(len(answer.materials), 'material')}, "
        f"{wording.band_ranges(answer.bands.centres_hz, everywhere)}, half of them to within "
        f"±{wording.number(half, 2 if half >= 0.0095 else 3)}"
    )
    open_ = [
        f"{name} ({_where(answer, missing)})"
        for name, missing in zip(answer.materials, wanted & ~sure, strict=True)
        if missing.any()
    ]
    if open_:
        named = open_[:_MOST_OPEN]
        if len(open_) > _MOST_OPEN:
            named.append(f"{len(open_) - _MOST_OPEN} more")
        text += f"; not determined: {', '.join(named)}"
    return f"{text}."


def _where(answer: Result, found: BoolArray) -> str:
    """Return the bands; their number where they are too scattered to be read."""
    if int(np.sum(np.diff(found.astype(int)) != 0)) > _MOST_ENDS:
        return f"{int(found.sum())} of {len(answer.bands)} bands"
    return wording.band_ranges(answer.bands.centres_hz, found)


def _next_step(answer: Result) -> str:
    """Return what to do with the answer, in a sentence."""
    if any(f.severity == "serious" for f in answer.findings):
        return "Next: cure what is serious, and identify again."
    rows = zip(answer.materials, answer.identifiable.tolist(), strict=True)
    open_ = [name for name, sure in rows if not all(sure)]
    if not open_:
        return "Next: ask what other materials would do, or what to hang where."
    names = wording.listing(open_[:3])
    return (
        f"Next: use what has no question mark; for the rest measure at more positions, or specify "
        f"what is known of {names}."
    )


def key_figures(answer: Result) -> tuple[tuple[str, str], ...]:
    """Return the mean of the room, the error of its decay time, this time, and how much is known.

    Of a mean that is determined nowhere there is no number.
    """
    centres, known = answer.bands.centres_hz, tables.known_means(answer)
    distance = np.abs(np.log2(centres / 1000.0))
    middle = int(np.argmin(np.where(known, distance, np.inf) if known.any() else distance))
    mean, low, high = (
        wording.coefficient(x, 1.0) for x in map(float, answer.mean_absorption[:, middle])
    )
    words = f"mean absorption of the room at {wording.hertz(float(centres[middle]))}"
    figures = [(f"{mean} ({low}{wording.DASH}{high})", words)]
    if not known.any():
        figures = [("?", "mean absorption of the room: determined in no band")]
    pairs = tables.compared_pairs(answer.pairs)
    known_keys = tables.parameter_keys(pairs)
    key = wording.decay_time_key(known_keys) or next(iter(known_keys), None)
    if key is None:
        figures.append((wording.DASH, "no measured room parameter to compare with"))
    else:
        figures.append(_error_figure(answer, pairs, key))
    if (times := tables.mean_decay_times(answer.pairs)) is not None:
        value = wording.mid_mean(centres, times[1])
        words = f"measured {times[0]} at {wording.mid_words(centres, times[1])}"
        figures.append((f"{wording.number(value, 2)} s", words))
    wanted = ~tables.fixed_coefficients(answer)
    sure = str(int((answer.identifiable & wanted).sum()))
    return *figures, (sure, f"of {int(wanted.sum())} coefficients are determined")


def _error_figure(answer: Result, pairs: list[ComparedPair], key: str) -> tuple[str, str]:
    how = wording.parameter(key)
    model, baseline, _ = (tables.known_mean(x) for x in tables.errors_of(pairs, key))
    words = f"error of predicted {how.symbol}, mean of {tables.compared_words(answer)}"
    if np.isfinite(baseline):
        beside = f"{wording.number(baseline, how.error_decimals)} {how.error_unit}"
        words += f"; by the mean of the others {beside}"
    return f"{wording.number(model, how.error_decimals)} {how.error_unit}", words


def _decay_times(answer: Result) -> list[Block]:
    """Return measured and predicted decay times over frequency, means over the pairs."""
    found = tables.mean_decay_times(answer.pairs)
    if found is None:
        return []
    symbol, measured, predicted = found
    words = (
        f"{symbol} over frequency, mean of {tables.compared_words(answer)}. A listener does not "
        "notice what stays within the pale box of a band, one just noticeable difference about "
        "what was measured."
    )
    series = wording.Series("measured", measured), wording.Series("predicted", predicted)
    of = answer.bands.centres_hz, series, symbol
    return [Drawing("decay_times", f"{symbol} over frequency", words, "decay_time_figure", of)]


# ---------------------------------------------------------------- the parts


def _absorption(answer: Result) -> list[Block]:
    more: list[Block] = [*tables.object_tables(answer), *tables.source_tables(answer)]
    sentences = tuple(
        (wording.hertz(float(centre)), f"{sentence}.")
        for centre, sentence in zip(answer.bands.centres_hz, answer.sentences, strict=False)
        if sentence
    )
    if sentences:
        words = "What the data determine of materials that they do not separate"
        half = (
            "“±” precedes half of the 95 % interval. What is not in the data comes from the prior."
        )
        more.append(Part(words, (Terms(sentences), Sentence(half)), folded=True))
    if (found := answer.geometry) is not None and found.n_offsets:
        words = "Fitted along by early reflections, from the specified value; intervals hold there"
        each = zip(found.labels, found.change, found.sd, found.prior_sd, strict=True)
        offsets = [
            (label, f"{change:+.3f} ± {sd:.3f} m (specified within {prior_sd:.3f} m)")
            for label, change, sd, prior_sd in each
        ]
        more += [Sentence(words), Terms(tuple(offsets[-found.n_offsets :]))]
    return [
        _absorption_drawing(answer),
        *tables.absorption_tables(answer),
        Sentence(
            "In the table, brackets and the words “not identif.” mark a coefficient that the data "
            "do not determine. There the mean of the room, the groups and what the walls are made "
            "of (“before”: the prior) are the answer together; measure more positions, or specify "
            "a prior.",
            "note",
        ),
        *more,
    ]


def _absorption_drawing(answer: Result) -> Drawing:
    return Drawing(
        "absorption",
        f"Absorption coefficient over frequency with 95 % intervals, "
        f"{wording.count(len(answer.materials), 'material')} and the mean of the room; the table "
        "below holds every number.",
        "Points with bars: absorption and its 95 % interval. Filled: identifiable. Hollow: not "
        "identifiable, the number may come from the prior. Diamonds: given. "
        "Above each panel the area of the material, and in how many bands it is identifiable.",
        "absorption_figure",
        (answer,),
    )


def _predictions(answer: Result, scene: Scene | None) -> list[Block]:
    kept = sum(pair.use == "validate" for pair in answer.pairs)
    words = wording.count(len(answer.pairs) - kept, "fitted measurement")
    words += f" and {wording.count(kept, 'measurement')} kept for validation" if kept else ""
    done = Sentence(f"From {words}; method {answer.method}, model {answer.model}.")
    if not answer.pairs:
        return [done, Sentence("There are no measurements to compare with.")]
    found: list[Block] = [done]
    if scene is not None:
        words = "Decay times and clarity agree: no mean over the pairs is off by more than a "
        agree = Sentence(words + "listener notices.")
        off = disagreement_table(answer, scene)
        if off is not None or tables.parameter_keys(answer.pairs):
            found.append(off or agree)
    errors = tables.error_tables(answer)
    worse = (("worse", "▲ marks where the model is worse than a baseline."),) if errors else ()
    found += [
        Sentence(
            "Each error is shown beside those of the baselines, which need no model of the room: "
            "the mean of the same parameter over the other fitted measurements (“others”), and "
            "the revised theory of Barron and Lee with their decay time (“Barron”).",
            "",
            worse,
        ),
        *errors,
        *tables.sti_tables(answer),
    ]
    return [*found, Part("", tuple(_decays(answer)), in_text=False)]


def _decays(answer: Result) -> list[Block]:
    found = [(i, pair) for i, pair in enumerate(answer.pairs, start=1) if _has_curves(pair)]
    if not found:
        return [Sentence("No measurement came as a recording, so there are no curves to show.")]
    pairs = [pair for _, pair in found]
    caption = (
        "Energy left in the room relative to the whole, after each time; above each panel the "
        "decay time, measured → predicted, and shaded the range of levels from which it was read. "
        "Where the measured curve meets the dotted line the noise takes over: later energy is "
        "extrapolated."
    )
    if len(pairs) > 1:
        caption += " Shown first: the pair whose parameters are furthest off."
    title = (
        f"Measured and predicted energy decay curves of {wording.count(len(pairs), 'pair')}, one "
        "panel a band; the tables below hold the parameters derived from them."
    )
    names = [
        f"decay_{i:02d}_{wording.in_file_name(*filter(None, (p.source, p.receiver, p.state)))}"
        for i, p in found[:_MOST_DECAY_FILES]
    ]
    off = np.nan_to_num([tables.mean_abs_jnd(pair) for pair in pairs], nan=-1.0)
    choices, of = tuple(map(tables.pair_title, pairs)), (answer, *pairs)
    shown = Drawing(
        "decay", title, caption, "decay_figure", of, choices, tuple(names), int(np.argmax(off))
    )
    without = len(answer.pairs) - len(pairs)
    words = f"Without a curve, for there is no recording: {without} of {len(answer.pairs)}."
    return [shown, Sentence(words, "note")] if without else [shown]


def _has_curves(pair: ComparedPair) -> bool:
    """Return whether there are decay curves to draw: values alone have none."""
    decay = pair.decay
    levels = [] if decay is None else [decay.measured_db, decay.predicted_db]
    return any(bool(np.isfinite(x).any()) for x in levels)


def _room(scene: Scene) -> tuple[Block, ...]:
    caption = (
        "Above: the room without the walls towards the viewer, colours as in the table of "
        "materials; dotted lines lead down to the floor. Below: the plan with its materials and "
        "two side views, all to one scale. Of many faces in view only the largest are drawn."
    )
    title = (
        f"The room with {wording.count(len(wall_materials(scene.room)), 'material')}, "
        f"{wording.count(len(scene.sources), 'source')} and "
        f"{wording.count(len(scene.receivers), 'receiver')}: "
        "in space, in plan and from two sides; the tables below hold the numbers."
    )
    picture = Drawing("room", title, caption, "room_figure.room_figure", (scene,))
    return picture, tables.material_table(scene.room), tables.position_table(scene)


def _pairs(answer: Result) -> tuple[Block, ...]:
    if not tables.parameter_keys(answer.pairs):
        return (Sentence("No room-acoustic parameters to compare."),)
    words = (
        "In each cell: the mean size of predicted minus measured, and of the band that is furthest "
        "off its difference and its values (measured → predicted); all in just noticeable "
        "differences, as the error of the mean of the others. Every band is in result.json."
    )
    jnd = (
        "Audible differences (ISO 3382-1: 5 % of T20, T30 and EDT, 1 dB of C50, C80 and G, 5 "
        "points of D50, 10 ms of TS are one just noticeable difference, JND):"
    )
    keys = (("near", "up to 1 JND"), ("middle", "1 to 2 JND"), ("far", "above 2 JND"))
    return Sentence(jnd, "", keys), Sentence(words), tables.pair_table(answer)


def _provenance(
    answer: Result, scene: Scene, campaign: str | None, digests: Mapping[str, str]
) -> tuple[Block, ...]:
    mesh, air_ = scene.room.mesh, scene.air
    law = "by ISO 9613-1" if air_.attenuation == "iso9613" else "none"
    terms = (
        ("roomfit", version("roomfit")),
        ("campaign", campaign or "not specified"),
        ("method, model", f"{answer.method}, {answer.model}"),
        ("intervals", answer.interval_kind),
        ("seed", str(answer.seed)),
        ("time", f"{wording.number(answer.seconds, 1)} s"),
        ("evaluations", str(answer.evaluations)),
        ("cost", f"{wording.number(answer.cost, 2)} (half the sum of squared weighted residuals)"),
        (
            "room",
            f"V = {wording.area(volume_m3(mesh))} m³, S = {wording.area(surface_area_m2(mesh))} m²",
        ),
        (
            "air",
            f"{wording.number(air_.temperature_c, 1)} °C, "
            f"{wording.number(air_.humidity_percent, 0)} % relative humidity, "
            f"{wording.number(air_.pressure_kpa, 1)} kPa; attenuation {law}",
        ),
        ("speed of sound", f"{wording.number(answer.speed_of_sound_m_s, 2)} m/s"),
    )
    rows = [(name, Cell(digest, style="words")) for name, digest in digests.items()]
    digest = (Table("SHA-256 of the inputs", ("file", "digest"), rows),) if rows else ()
    return (*map(Sentence, answer.reasons), Terms(terms), *digest)
