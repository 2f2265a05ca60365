"""Common materials by name: what published tables print of their absorption, as priors.

Tables print absorption without a spread. Here it comes from the tables themselves: how far they
disagree where they use the same name. All sums are done in logit absorption, where a spread means
the same for a hard wall and for a soft one.
"""

from __future__ import annotations

import re
import tomllib
import unicodedata
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from roomfit.base.arguments import did_you_mean, nearest, read_only
from roomfit.base.bands import Bands, one_per_band
from roomfit.base.errors import InputError, located
from roomfit.base.findings import About, Code, Edit, Finding, Remedy
from roomfit.base.logit import expit, logit
from roomfit.base.typing import FloatArray
from roomfit.materials.priors import (
    DEFAULT_LOGIT_SD,
    DEFAULT_MEAN,
    MaterialPrior,
    are_specified,
    logit_prior,
)

OCTAVES_HZ = (63.0, 125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0, 8000.0)
LEAST_ALPHA = 0.005  # half of what tables print last
LARGEST_ALPHA = 0.98

# ISO 12999-2:2020, table 1: two laboratories that measure one specimen by ISO 354 differ with the
# standard deviation m alpha + n. The last pair, for 8 kHz, repeats that of 5 kHz, where it ends.
_REPRODUCIBILITY_M = np.array([0.450, 0.180, 0.090, 0.050, 0.040, 0.035, 0.030, 0.026])
_REPRODUCIBILITY_N = np.array([0.015, 0.015, 0.015, 0.015, 0.015, 0.021, 0.040, 0.060])

# How much an own scatter weighs against the common one, in readings: three tables are too few for
# a variance of their own.
_COMMON_WEIGHT = 4.0
_LOW_SLOPE = 0.75
_LOW_STEP = 0.7
LOW_WIDENING = 0.6
HIGH_WIDENING = 0.4


def table_logit(absorption: FloatArray) -> FloatArray:
    """Return logit absorption; what tables print as 0, 1 or above is moved to 0.005 and 0.98."""
    return logit(np.clip(absorption, LEAST_ALPHA, LARGEST_ALPHA))


def distinct(readings: FloatArray) -> FloatArray:
    """Return the different rows: a table that reprints another one adds nothing.

    `readings`, shape (n_readings, 8): absorption in octaves from 63 Hz; NaN where not printed.

    The result has the shape (n_distinct, 8): in the order of first appearance.
    """
    kept: dict[tuple[float, ...], FloatArray] = {}
    for row in readings:
        kept.setdefault(tuple(row[1:7].tolist()), row)
    return np.array(list(kept.values()))


def common_spread(materials: Iterable[FloatArray]) -> float:
    """Return the standard deviation of logit absorption among readings of the same name.

    Pooled over all names, and over octaves 125 to 4000 Hz: it varies little from band to band.
    Names with a single distinct reading are left out.
    """
    squares, freedom = 0.0, 0
    for readings in materials:
        values = table_logit(distinct(readings)[:, 1:7])
        squares += float(np.sum((values - values.mean(axis=0)) ** 2))
        freedom += (len(values) - 1) * values.shape[1]
    return float(np.sqrt(squares / freedom))


def octave_correlation(materials: Iterable[FloatArray]) -> float:
    """Return how what readings of the same name are off their mean correlates an octave apart.

    In logit, pooled over all names and neighbours among octaves 125 to 4000 Hz. Octaves further
    apart correlate by its power, as they do in the tables (of classes .81, .63, .51, .41, .29).
    """
    off = [v - v.mean(axis=0) for m in materials for v in [table_logit(distinct(m)[:, 1:7])]]
    lower, upper = (np.concatenate(off)[:, own] for own in (slice(0, 5), slice(1, 6)))
    return float(np.sum(lower * upper) / np.sqrt(np.sum(lower**2) * np.sum(upper**2)))


def typical_logit(readings: FloatArray, common: float) -> tuple[FloatArray, FloatArray]:
    """Return middle and standard deviation of logit absorption, each of shape (8,).

    Octaves 125 to 4000 Hz: the mean over distinct readings; its variance is the readings' own,
    drawn towards the `common` one as if that came from four readings more. It never falls below
    what two laboratories differ by (ISO 12999-2), as far as that is less than half the value:
    tables of hard walls agree better than a reverberation room could measure them.

    63 Hz, where no table prints it: three quarters of the step from 250 to 125 Hz are made once
    more, at most 0.7; 8 kHz: the value of 4 kHz is kept. Used the other way round, to predict
    125 Hz from the next two octaves and 4 kHz from 2 kHz, the two rules miss by 0.6 and 0.4
    (standard deviation over the catalogue): by so much the spread is widened there.
    """
    rows = distinct(readings)
    values = table_logit(rows)
    n = len(values)
    middle = np.empty(8)
    middle[1:7] = values[:, 1:7].mean(axis=0)
    own = np.sum((values[:, 1:7] - middle[1:7]) ** 2, axis=0)
    variance = np.empty(8)
    variance[1:7] = (_COMMON_WEIGHT * common**2 + own) / (_COMMON_WEIGHT + n - 1)
    low_step = np.clip(_LOW_SLOPE * (middle[1] - middle[2]), -_LOW_STEP, _LOW_STEP)
    for end, inner, rule, widening in (
        (0, 1, middle[1] + low_step, LOW_WIDENING),
        (7, 6, middle[6], HIGH_WIDENING),
    ):
        printed = values[~np.isnan(values[:, end]), end]
        middle[end] = printed.mean() if printed.size else rule
        variance[end] = variance[inner] + (0.0 if printed.size else widening**2)
    middle = table_logit(expit(middle))
    a = expit(middle)
    between_laboratories = np.minimum(_REPRODUCIBILITY_M * a + _REPRODUCIBILITY_N, 0.5 * a)
    return middle, np.maximum(np.sqrt(variance), between_laboratories / (a * (1.0 - a)))


class Reading(NamedTuple):
    """One row of one published table."""

    source: str  # the publication, in full
    row: str  # what the table calls it, in brackets whom it credits
    # (8,), octaves 63 to 8000 Hz as printed, above 1 included; NaN where nothing is printed
    absorption: FloatArray


class CatalogueEntry(NamedTuple):
    """A common material with what tables print of it."""

    name: str  # lower case with hyphens: ``"carpet-on-underlay"``
    group: str
    description: str
    readings: tuple[Reading, ...]
    # logit_mean, logit_sd: (8,), of logit absorption in octaves 63 to 8000 Hz; see
    # `roomfit.materials.catalogue`
    logit_mean: FloatArray
    logit_sd: FloatArray
    octave_correlation: float  # of what a material is off that mean, see `octave_correlation`

    @property
    def absorption(self) -> FloatArray:
        """Middle absorption in octaves 63 to 8000 Hz, shape (8,), 0.005 to 0.98."""
        return expit(self.logit_mean)


class Catalogue(NamedTuple):
    """All entries group by group, classes first."""

    entries: tuple[CatalogueEntry, ...]
    classes: tuple[str, ...]  # what walls are made of, as people say who do not know which kind


@cache
def _content() -> dict[str, Any]:
    text = files("roomfit.materials").joinpath("catalogue.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


@cache
def catalogue() -> Catalogue:
    """Return the catalogue that comes with roomfit."""
    return catalogue_from(_content())


def catalogue_from(content: Mapping[str, Any]) -> Catalogue:
    """Return a catalogue from the content of a file like ``catalogue.toml``.

    `content`: ``sources`` maps short keys to publications; ``materials`` maps a name to ``group``,
    ``what`` and ``readings``: lists of source key, row, and six values (octaves 125 to 4000 Hz) or
    seven (from 63 Hz); ``classes``, if any, a name to ``what`` and ``of``: which materials it may
    be. A class has all their readings, and the spread of one reading more.
    """
    given, readings = content["materials"], {}
    for name, material in given.items():
        rows = []
        for source, row, values in material["readings"]:
            eight = np.full(8, np.nan)
            eight[7 - len(values) : 7] = values
            rows.append(Reading(content["sources"][source], row, read_only(eight)))
        readings[name] = tuple(rows)
    kinds = {name: (m["group"], m["what"], readings[name]) for name, m in given.items()}
    classes = {
        name: (
            given[own["of"][0]]["group"],
            own["what"],
            tuple(r._replace(row=f"{of}: {r.row}") for of in own["of"] for r in readings[of]),
        )
        for name, own in content.get("classes", {}).items()
    }
    # a class is no average of its kinds but one more of them
    entries = [*_entries(classes, one_more=True), *_entries(kinds)]
    groups = list(dict.fromkeys(m["group"] for m in given.values()))
    entries.sort(key=lambda e: groups.index(e.group))
    return Catalogue(tuple(entries), tuple(classes))


def _entries(
    named: Mapping[str, tuple[str, str, tuple[Reading, ...]]], *, one_more: bool = False
) -> Iterator[CatalogueEntry]:
    tables = {k: np.array([r.absorption for r in rows]) for k, (*_, rows) in named.items()}
    common = common_spread(tables.values()) if tables else 0.0
    apart = octave_correlation(tables.values()) if tables else 0.0
    for name, table in tables.items():
        mean, sd = typical_logit(table, common)
        sd *= np.sqrt(1.0 + one_more / len(distinct(table)))
        yield CatalogueEntry(name, *named[name], read_only(mean), read_only(sd), apart)


def find_material(name: str) -> CatalogueEntry:
    """Return the entry of that name; case does not matter, and blanks stand for hyphens.

    Examples
    --------
    >>> find_material("Carpet on underlay").name
    'carpet-on-underlay'
    """
    wanted = "-".join(name.lower().replace("_", " ").replace("-", " ").split())
    for entry in catalogue().entries:
        if entry.name == wanted:
            return entry
    hint = _similar(wanted)
    what = "the catalogue has no such material"
    needed = f"one of the {len(catalogue().entries)} names that `roomfit catalogue` lists"
    raise InputError(what, found=repr(name), needed=needed, hint=hint)


def _similar(wanted: str) -> str | None:
    """Names to offer instead: the nearest one, or those that share a word like one of `wanted`."""
    names = [entry.name for entry in catalogue().entries]
    guess = did_you_mean(wanted, names)
    if guess:
        return guess
    words = {word for name in names for word in name.split("-")}
    known = [w for w in (nearest(part, words) for part in wanted.split("-")) if w]
    offered = [name for name in names if any(w in name.split("-") for w in known)]
    return f"did you mean one of {', '.join(offered[:6])}?" if offered else None


# what follows says where the material is, or what is behind it
_BESIDE = re.compile(r"\b(?:on|in|over|with|auf|vor|mit|aus|sur|avec|devant|en)\b|[,(]")


def suggested_entries(name: str) -> tuple[str, ...]:
    """Return entries of the catalogue that a material of this name may be, the likeliest first.

    By that of some English, German and French words that stands last in the name, before any "on",
    "auf", "sur", comma or bracket: a wooden door is a door, and a carpet on concrete a carpet.
    Nothing where it holds none of them. A name is a hint and no more: which entry it is, if any,
    somebody who has seen the room must say.

    Examples
    --------
    >>> suggested_entries("Vorhang, Nordseite")[0], suggested_entries("Holztür")
    ('curtain', ('door',))
    """
    plain = name.lower().replace("ü", "ue").replace("_", " ")
    plain = unicodedata.normalize("NFKD", plain)  # accents become letters, which go below
    head = "".join(c for c in _BESIDE.split(plain)[0] if c.isalnum())
    found = [
        (head.rfind(word) + len(word), len(word), entries)
        for words, entries in _content()["words"].items()
        for word in words.split()
        if word in head
    ]
    return tuple(max(found, key=lambda match: match[:2])[2]) if found else ()


def broad_prior_findings(priors: Sequence[MaterialPrior]) -> tuple[Finding, ...]:
    """Return one finding for all materials of which nothing is specified, with what they may be."""
    each = zip(priors, are_specified(tuple(priors)), strict=True)
    broad = [k for k, own in each if k.known is None and k.tied_to is None and not own]
    if not broad:
        return ()
    names = [k.name for k in broad]
    tables = [f"[products.{name}]" for name in dict.fromkeys(k.product for k in broad if k.product)]
    if not all(k.product for k in broad):
        tables.append("[materials.NAME]")
    entries = {name: list(suggested_entries(name)) for name in names}
    hints = [f"{name}: {', '.join(found)}" for name, found in entries.items() if found]
    sentence = (
        f"Nothing is specified of {', '.join(names)}: a broad prior was taken, 95 % of it from "
        f'0.01 to 0.77. Where more is known, say it: prior = "ENTRY" or '
        f"{{mean = [...], sd = [...]}} under {' or '.join(tables)}."
    )
    if hints:
        sentence += f" By their names these entries of the catalogue may fit: {'; '.join(hints)}."
    evidence = {"materials": names, "entries": entries}
    owners = [("products", k.product) if k.product else ("materials", k.name) for k in broad]
    remedies = [
        Remedy([Edit(owner, "prior", entry, now=[None])])
        for owner, found in zip(owners, entries.values(), strict=True)
        for entry in found
    ]
    about = About(materials=names)
    return (Finding(Code.BROAD_PRIOR_ASSUMED, about, sentence, evidence, remedies=remedies),)


def product_findings(priors: Sequence[MaterialPrior]) -> tuple[Finding, ...]:
    """Return one finding for each product, with its materials and how unlike they may be."""
    findings = []
    for product in dict.fromkeys(k.product for k in priors if k.product is not None):
        members = [k for k in priors if k.product == product]
        names, sd = [k.name for k in members], members[0].product_sd
        sentence = (
            f"{', '.join(names)} are of one product, {product}: their absorption was taken to be "
            f"alike, each off by {sd:g} in logit (standard deviation). Intervals are valid as "
            "far as that is true."
        )
        evidence = {"product": product, "materials": names, "sd": sd}
        about = About(materials=names)
        findings.append(Finding(Code.PRODUCT_ASSUMED, about, sentence, evidence))
    return tuple(findings)


def catalogue_prior(name: str, bands: Bands) -> tuple[FloatArray, FloatArray]:
    """Return mean and standard deviation of absorption of a catalogue material, (n_bands,) each.

    Between the octaves of the catalogue logit mean and spread are interpolated linearly in the
    logarithm of frequency; beyond 63 Hz and 8 kHz the mean is held and the spread widened further
    for every octave. `logit_prior` turns the two into logit absorption again.
    """
    if find_material(name).group == _PIECES:
        what = "an entry of the catalogue is no absorption coefficient"
        found = f"{name!r}, m2 of one piece"
        hint = f"people stand in the room: [objects.NAME] absorption_area_m2 = {name!r}"
        raise InputError(what, found=found, needed="an entry of a surface", hint=hint)
    return _middle_and_sd(name, bands)


def band_correlation(name: str, bands: Bands) -> FloatArray:
    """Return how deviations from an entry correlate between bands, shape (n_bands, n_bands)."""
    apart = np.abs(np.subtract.outer(np.log2(bands.centres_hz), np.log2(bands.centres_hz)))
    return np.asarray(find_material(name).octave_correlation ** apart)


def _middle_and_sd(name: str, bands: Bands) -> tuple[FloatArray, FloatArray]:
    """Return what tables print of an entry in some bands, with its standard deviation."""
    entry, at, known = find_material(name), np.log2(bands.centres_hz), np.log2(OCTAVES_HZ)
    mean = expit(np.interp(at, known, entry.logit_mean))
    below, above = np.maximum(known[0] - at, 0.0), np.maximum(at - known[-1], 0.0)
    sd = np.interp(at, known, entry.logit_sd)
    sd = np.sqrt(sd**2 + below * LOW_WIDENING**2 + above * HIGH_WIDENING**2)
    return np.asarray(mean), np.asarray(sd * mean * (1.0 - mean))


_PIECES = "people, m2 each"
SEATS = "seats and people"  # group whose coefficients are of floor


def object_catalogue_area(
    name: str, bands: Bands, *, by_floor: bool
) -> tuple[FloatArray, FloatArray]:
    """Return mean and standard deviation of an equivalent absorption area of the catalogue, in m2.

    Of one piece, or of 1 m2 of floor on which people or seats stand: their absorption coefficient;
    shape (n_bands,) each.
    """
    if (find_material(name).group == _PIECES) == by_floor:
        raise InputError(
            "an entry of the catalogue is of another kind than the object",
            found=f"{name!r}, " + ("m2 of one piece" if by_floor else "a coefficient"),
            needed="a coefficient, of 1 m2 of floor" if by_floor else f"an entry of {_PIECES!r}",
            hint="give count in place of a floor" if by_floor else "give floor_area_m2 or outlines",
        )
    return _middle_and_sd(name, bands)


_NARROWEST = 1e-3  # between bounds


def material_prior(
    name: str,
    bands: Bands,
    *,
    absorption: ArrayLike | None = None,
    prior: str | tuple[ArrayLike, ArrayLike] | None = None,
    bounds: tuple[float, float] | None = None,
    scattering: ArrayLike | Literal["fit"] | None = None,
    same_absorption_as: str | None = None,
    delay_sd_s: float | None = None,
) -> MaterialPrior:
    """Return what is known of a material before the measurement.

    To say that materials are of one product, alike but not equal, state the same of each, and then
    ``dataclasses.replace(prior, product="panel")``; see `MaterialPrior`.

    Parameters
    ----------
    name : str
        Of a material of the room.
    bands : Bands
        Those to be fitted; arrays have one value per band, or one for all.
    absorption : array, optional
        Energy absorption coefficient that is fixed, 0 to 1.
    prior : str or (mean, standard deviation), optional
        Of the absorption coefficient, both dimensionless; or the name of an entry of the
        catalogue. Left out: a broad prior, 95 % of it from 0.01 to 0.77.
    bounds : two floats, optional
        The absorption lies strictly between them.
    scattering : array or "fit", optional
        Scattering coefficient (ISO 17497-1), 0 to 1; "fit": determined with the absorption. Left
        out: one value for all such materials, chosen by the data where there are responses.
    same_absorption_as : str, optional
        Another material that has the same absorption.
    delay_sd_s : float, optional
        Prior standard deviation of the delay at a reflection, 0 to 0.1 s.

    Raises
    ------
    InputError
        A value is out of range or has not one number per band, or a prior lies outside its bounds.

    Examples
    --------
    >>> from roomfit.base.bands import bands_between
    >>> glass = material_prior("glass", bands_between("octave", 250, 500), absorption=0.04)
    >>> glass.known
    array([0.04, 0.04])
    """
    n, where = len(bands), f"materials.{name}"
    lower, upper = (0.0, 1.0) if bounds is None else bounds
    if not (lower >= 0.0 and upper <= 1.0 and upper - lower >= _NARROWEST):
        what, found = "lower bound is not below the upper one", f"{lower:g} and {upper:g}"
        needed = f"0 <= lower, upper <= 1, and {_NARROWEST:g} between them"
        hint = "an absorption that is known is fixed: absorption = ..."
        raise InputError(what, where=f"{where}.bounds", found=found, needed=needed, hint=hint)
    # the broad prior's middle where it lies well between the bounds, else theirs
    share = (DEFAULT_MEAN - lower) / (upper - lower)
    mean = logit(np.full(n, share if 0.1 <= share <= 0.9 else 0.5), 0.0)
    sd = np.full(n, DEFAULT_LOGIT_SD)
    if prior is not None:
        mean, sd = _stated_prior(prior, bands, lower, upper, f"{where}.prior")
    known = None if absorption is None else one_per_band(absorption, bands, f"{where}.absorption")
    if known is not None and not np.all((known >= lower) & (known <= upper)):
        what = "a given absorption lies outside of its own bounds"
        found = f"{known[np.argmax((known < lower) | (known > upper))]:g}"
        needed = f"{lower:g} to {upper:g}"
        hint = "remove bounds: an absorption that is given is fixed"
        raise InputError(what, where=f"{where}.absorption", found=found, needed=needed, hint=hint)
    specified = None
    if scattering is not None and not isinstance(scattering, str):
        specified = one_per_band(scattering, bands, f"{where}.scattering")
    return MaterialPrior(
        name,
        mean,
        sd,
        scattering=specified,
        known=known,
        lower=lower,
        upper=upper,
        fit_scattering=isinstance(scattering, str),
        tied_to=same_absorption_as,
        wall_delay_sd_s=delay_sd_s,
        specified=prior is not None or bounds is not None,
    )


def _stated_prior(
    prior: str | tuple[ArrayLike, ArrayLike], bands: Bands, lower: float, upper: float, where: str
) -> tuple[FloatArray, FloatArray]:
    """Return mean and standard deviation of the logit between bounds, (n_bands,) each."""
    if isinstance(prior, str):
        with located(where):
            alpha, alpha_sd = catalogue_prior(prior, bands)
    else:
        alpha = one_per_band(prior[0], bands, f"{where}.mean")
        alpha_sd = one_per_band(prior[1], bands, f"{where}.sd")
    inside = (alpha > max(lower, 0.0)) & (alpha < min(upper, 1.0)) & (alpha_sd > 0.0)
    if not np.all(inside):
        band = int(np.argmin(inside))
        what = "a prior lies outside of its bounds or has no spread"
        found = f"mean {alpha[band]:g}, sd {alpha_sd[band]:g} at {bands.centres_hz[band]:g} Hz"
        needed = f"{lower:g} < mean < {upper:g} and sd > 0"
        hint = "to fix an absorption, write absorption = [...] instead"
        raise InputError(what, where=where, found=found, needed=needed, hint=hint)
    between = (alpha - lower) / (upper - lower)
    return logit_prior(between, alpha_sd / (upper - lower))
