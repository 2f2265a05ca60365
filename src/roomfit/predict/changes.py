"""What if: materials with another absorption than the one that was found."""

from __future__ import annotations

import re
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from roomfit.base.arguments import check_known, float_array
from roomfit.base.bands import Bands, one_per_band
from roomfit.base.errors import InputError, located
from roomfit.base.findings import About, Code, Finding
from roomfit.base.typing import FloatArray
from roomfit.materials.catalogue import band_correlation, catalogue_prior
from roomfit.materials.priors import logit_normal, object_absorption
from roomfit.uncertainty.posterior import AbsorptionPosterior

_NEEDED = (
    "MATERIAL=0.3, 0.3+-0.05, one value per band, x1.5+-0.2, another material of the room in one "
    "of its states, or a name of the catalogue, each also of a part, as 40% 0.3; OBJECT=0, or its "
    "area in m2"
)
_NUMBER = r"(\d+\.?\d*|\.\d+)"
_VALUE = re.compile(rf"^(x?){_NUMBER}(?:(?:\+-|±){_NUMBER})?$")
_PART = re.compile(rf"^{_NUMBER} ?% ?(?=\S)")
# what is meant as a number, and is none of these; a material may be called 3mm-glass
_TWO_WHOLE = re.compile(r"(\d+),(\d+)")  # two bands, or a number with a decimal comma
_LIKE_NUMBERS = re.compile(r"x?([-+±.,\deE]+|[-+]?(nan|inf))")


@dataclass(frozen=True, slots=True)
class Change:
    """Another absorption for one material, or for a part of it."""

    material: str
    # a new absorption, a factor on the one that was found, or a name: of another material that was
    # found, else of an entry of the catalogue
    kind: Literal["value", "factor", "catalogue"]
    values: tuple[float, ...] = ()  # one for all bands, or one a band
    sds: tuple[float, ...] = ()  # their standard deviations; left out: none
    entry: str = ""  # name of a material or in the catalogue
    share: float = 1.0  # of the area of the material, 0 to 1
    variant: str = ""  # of the room to which it belongs; those of one stand beside the others

    def __post_init__(self) -> None:
        if not self.sds:
            object.__setattr__(self, "sds", (0.0,) * len(self.values))
        name = f"standard deviations of the absorption of {self.material}, one a value,"
        float_array(name, self.sds, (len(self.values),), low=0.0)


def _not_written(text: str) -> InputError:
    what, hint = "a change is not written as it must be", "write floor=0.3, say, or floor=x1.5"
    return InputError(what, found=repr(text), needed=_NEEDED, hint=hint)


def read_change(text: str) -> Change:
    """Return a change as it is written on the command line: ``floor=0.3``.

    Or of a variant with a name: ``thick carpet | floor=0.3``.
    """
    variant, _, change = (part.strip() for part in text.rpartition("|"))
    material, sign, specified = (part.strip() for part in change.partition("="))
    if not (material and sign and specified):
        raise _not_written(text)
    share, part_of = 1.0, _PART.match(specified)
    if part_of:
        share, specified = float(part_of[1]) / 100.0, specified[part_of.end() :]
        if not 0.0 < share <= 1.0:
            raise _not_written(text)
    if either := _TWO_WHOLE.fullmatch(specified):
        what, needed = "a comma that may stand for a point", "a point, or a space behind the comma"
        hint = "write {0}.{1} for one number, or {0}, {1} for two bands".format(*either.groups())
        raise InputError(what, found=repr(text), needed=needed, hint=hint)
    found = [_VALUE.match(part.replace(" ", "")) for part in specified.split(",")]
    matches = [m for m in found if m is not None]
    if not matches and _LIKE_NUMBERS.fullmatch(specified):
        raise _not_written(text)
    if not matches:
        return Change(material, "catalogue", entry=specified, share=share, variant=variant)
    factors = {m[1] for m in matches}
    if len(matches) != len(found) or len(factors) != 1:
        raise _not_written(text)
    values = tuple(float(m[2]) for m in matches)
    sds = tuple(float(m[3] or 0.0) for m in matches)
    kind: Literal["factor", "value"] = "factor" if factors == {"x"} else "value"
    return Change(material, kind, values, sds, share=share, variant=variant)


def by_variant(changes: Sequence[Change]) -> dict[str, list[Change]]:
    """Return changes by the variant to which they belong, first, as "", those of none."""
    names = dict.fromkeys(["", *(c.variant for c in changes)])
    return {name: [c for c in changes if c.variant == name] for name in names}


def change_text(change: Change) -> str:
    """Return a change in the words of the command line."""
    head = f"{change.material}=" + (f"{100.0 * change.share:.9g}% " if change.share < 1.0 else "")
    if change.kind == "catalogue":
        return f"{head}{change.entry}"
    mark = "x" if change.kind == "factor" else ""
    values = [
        f"{mark}{v:g}" + (f"+-{sd:g}" if sd else "")
        for v, sd in zip(change.values, change.sds, strict=True)
    ]
    written = ",".join(values)
    return head + (written.replace(",", ", ") if _TWO_WHOLE.fullmatch(written) else written)


def changed_draws(
    posterior: AbsorptionPosterior, draws: FloatArray, changes: Sequence[Change], seed: int
) -> tuple[FloatArray, FloatArray, tuple[Finding, ...]]:
    """Return absorption and its draws after all changes.

    Of a material that is changed in part the mean by area: in the diffuse limit its energy.

    Shapes: `draws` (n_draws, n_materials, n_bands), `absorption` (n_materials, n_bands), `draws`
    (n_draws, n_materials, n_bands).
    """
    absorption, drawn = posterior.absorption.copy(), draws.copy()
    findings: list[Finding] = []
    changed: dict[str, float] = {}
    for change in changes:
        where = change_text(change)
        what = "a change names a material that the room does not have"
        check_known(what, change.material, posterior.materials, where=where)
        index = posterior.materials.index(change.material)
        share = changed[change.material] = changed.get(change.material, 0.0) + change.share
        if share > 1.0 + 1e-6:
            raise InputError(
                "a material is changed twice",
                where=where,
                found=repr(change.material),
                needed="each material once, or parts of it that make 100 % at most",
                hint="keep the last of the two",
            )
        with located(where):
            new, drawn_new, clipped = _new_absorption(posterior, draws, change, seed)
        part = change.share
        absorption[index] = absorption[index] - part * posterior.absorption[index] + part * new
        drawn[:, index] = drawn[:, index] - part * draws[:, index] + part * drawn_new
        findings += clipped
    return absorption, drawn, tuple(findings)


def _new_absorption(
    posterior: AbsorptionPosterior, draws: FloatArray, change: Change, seed: int
) -> tuple[FloatArray, FloatArray, tuple[Finding, ...]]:
    """Return what a material becomes, with draws, (n_bands,) and (n_draws, n_bands)."""
    index = posterior.materials.index(change.material)
    if change.kind == "factor":
        factor, sd = values_per_band(change, posterior.bands, high=np.inf)
        wanted, z = posterior.absorption[index] * factor, _normals(len(draws), seed, index, sd)
        factors = np.maximum(factor + sd * z[:, None], 0.0)
        new, drawn = np.minimum(wanted, 1.0), np.minimum(draws[:, index] * factors, 1.0)
        return new, drawn, _clipped(change, wanted, posterior.bands)
    if change.entry in posterior.materials:
        # what was found of it, with all that it shares with the others
        other = posterior.materials.index(change.entry)
        return posterior.absorption[other], draws[:, other], ()
    correlation = None
    if change.kind == "catalogue":
        if change.material in posterior.objects:
            raise InputError(
                "an object is changed to an entry of the catalogue",
                found=change.entry,
                needed="its equivalent absorption area in m2, 0 where it is not there",
                hint=f"write {change.material}=0, or its area in m2",
            )
        mean, sd = catalogue_prior(change.entry, posterior.bands)
        correlation = band_correlation(change.entry, posterior.bands)
    elif change.material in posterior.objects:
        # areas in m2, as the absorption that they stand for in the room
        volume_m3 = posterior.objects[change.material]
        area_m2, sd_m2 = values_per_band(change, posterior.bands, high=1e5)
        mean = object_absorption(area_m2, volume_m3)
        sd = object_absorption(area_m2 + sd_m2, volume_m3) - mean
    else:
        mean, sd = values_per_band(change, posterior.bands, high=1.0)
    return mean, product_draws(mean, sd, len(draws), seed, correlation), ()


def product_draws(
    mean: FloatArray, sd: FloatArray, n: int, seed: int, correlation: FloatArray | None = None
) -> FloatArray:
    """Return draws of what is not of the room, (n, n_bands): of one product the same anywhere.

    `correlation`, (n_bands, n_bands): of what bands are off; left out, all are off alike.
    """
    if correlation is None:
        return logit_normal(mean, sd, _normals(n, seed, 0, mean, sd))
    z = _normals(n * len(mean), seed, 0, mean, sd).reshape(n, -1)
    return logit_normal(mean, sd, z @ np.linalg.cholesky(correlation).T)


def _normals(n: int, seed: int, *key: int | FloatArray) -> FloatArray:
    """Return standard normal numbers, (n,), the same for the same key.

    One number a draw for all bands: a material is thicker, or hung closer, at all frequencies.
    """
    named = zlib.crc32(b"".join(np.asarray(k, dtype=np.float64).tobytes() for k in key))
    return np.random.default_rng((seed, named)).standard_normal(n)


def values_per_band(change: Change, bands: Bands, high: float) -> tuple[FloatArray, FloatArray]:
    """Return values and standard deviations of a change, one a band; refuse another number."""
    unit, name = "m2" if 1.0 < high < np.inf else "", f"the absorption of {change.material}"
    values = one_per_band(change.values, bands)
    values = float_array(name, values, (None,), low=0.0, high=high, unit=unit)
    return values, one_per_band(change.sds, bands)


def _clipped(change: Change, wanted: FloatArray, bands: Bands) -> tuple[Finding, ...]:
    over = np.flatnonzero(wanted > 1.0)
    if not over.size:
        return ()
    where = ", ".join(f"{bands.centres_hz[j]:g} Hz ({wanted[j]:.2f})" for j in over)
    return (
        Finding(
            Code.ABSORPTION_CLIPPED,
            About(materials=[change.material], bands_hz=bands.centres_hz[over].tolist()),
            f"The change {change_text(change)} would make the absorption larger than 1 at {where}; "
            "1 was taken.",
            {"material": change.material, "bands_hz": bands.centres_hz[over].tolist()},
        ),
    )
