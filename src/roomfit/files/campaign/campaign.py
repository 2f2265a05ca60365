"""A campaign in the words of the science: what a campaign file says, checked and converted."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from roomfit.air import Air
from roomfit.bands import OCTAVES_HZ, Bands, bands_between
from roomfit.checks import nearest
from roomfit.errors import InputError, located
from roomfit.files.campaign.read import read_campaign_table
from roomfit.files.campaign.schema import (
    AirTable,
    CampaignTable,
    IdentifyTable,
    MaterialTable,
    MeasurementTable,
    Prior,
    Spectrum,
)
from roomfit.files.responses.spec import ResponseSpec
from roomfit.files.rooms.spec import PolygonSpec, RoomSpec
from roomfit.materials.knowledge import (
    DEFAULT_MEAN,
    MaterialKnowledge,
    logit_prior,
    unknown_material,
)
from roomfit.scene.scene import Point
from roomfit.typing import FloatArray

Level = Literal["per-source", "per-file", "absolute"]


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredFile:
    """One measured response: where it lies, whose pair it is, and how it is to be used."""

    source: str
    receiver: str
    response: ResponseSpec
    level: Level
    use: Literal["fit", "validate"]


@dataclass(frozen=True, slots=True, eq=False)
class Campaign:
    """Everything that a campaign file says.

    Attributes
    ----------
    path : Path
        The file itself; paths in it are relative to its folder.
    room : RoomSpec
    air : Air
    sources, receivers : tuple of Point
        Only those that a measurement names.
    measurements : tuple of MeasuredFile
    bands : Bands
        Bands to fit.
    materials : mapping of name to MaterialTable
        What the file says of materials, for `material_knowledge`.
    method : str
    model : str
    seed : int
    """

    path: Path
    room: RoomSpec
    air: Air
    sources: tuple[Point, ...]
    receivers: tuple[Point, ...]
    measurements: tuple[MeasuredFile, ...]
    bands: Bands
    materials: dict[str, MaterialTable]
    method: str
    model: str
    seed: int


def read_campaign(path: Path) -> Campaign:
    """Read a campaign file.

    Raises
    ------
    InputError
        See `read_campaign_table`; also a key whose meaning this version does not know yet is
        refused rather than ignored.
    """
    path = Path(path)
    table = read_campaign_table(path)
    _refuse_what_is_not_built(path, table)
    used_sources = {m.source for m in table.measurements}
    used_receivers = {m.receiver for m in table.measurements}
    return Campaign(
        path,
        _room_spec(path, table),
        _air(path, table.air),
        tuple(
            Point(n, np.array(s.position), s.position_sd)
            for n, s in table.sources.items()
            if n in used_sources
        ),
        tuple(
            Point(n, np.array(r.position), r.position_sd)
            for n, r in table.receivers.items()
            if n in used_receivers
        ),
        tuple(_measured_file(path, m) for m in table.measurements),
        _bands(path, table.identify),
        dict(table.materials),
        table.identify.method,
        table.identify.model,
        table.identify.seed,
    )


def material_knowledge(
    campaign: Campaign, materials: tuple[str, ...]
) -> tuple[MaterialKnowledge, ...]:
    """Return what the campaign says of each of the room's materials, in their order.

    Raises
    ------
    InputError
        The campaign describes a material that the room does not have; or lists that do not have
        one value per fitted band; or a prior outside its bounds.
    """
    for name in campaign.materials:
        if name not in materials:
            guess = nearest(name, materials)
            raise InputError(
                "the campaign describes a material that the room does not have",
                where=f"{campaign.path}, materials.{name}",
                needed=f"one of {', '.join(materials)}",
                hint=f"did you mean {guess!r}?" if guess else "see [room.materials]",
            )
    with located(str(campaign.path)):
        return tuple(_knowledge(campaign, name) for name in materials)


def input_files(campaign: Campaign) -> tuple[Path, ...]:
    """Return every file whose content decides the answer, each once, the campaign's own first."""
    room = campaign.room
    files = [campaign.path]
    if room.file is not None:
        files.append(room.file)
    if room.polygons is not None:
        files += [*room.polygons.corners, *room.polygons.planes, *room.polygons.replace.values()]
    files += [m.response.path for m in campaign.measurements]
    return tuple(dict.fromkeys(files))


def _knowledge(campaign: Campaign, name: str) -> MaterialKnowledge:
    n = len(campaign.bands)
    plain = unknown_material(name, n)
    table = campaign.materials.get(name)
    if table is None:
        return plain
    where = f"materials.{name}"
    mean, sd = plain.prior_logit_mean, plain.prior_logit_sd
    lower, upper = table.bounds if table.bounds is not None else (0.0, 1.0)
    if table.bounds is not None:
        # the broad prior's middle where it lies well between the bounds, else theirs
        share = (DEFAULT_MEAN - lower) / (upper - lower)
        share = share if 0.1 <= share <= 0.9 else 0.5
        mean, _ = logit_prior(np.full(n, share), np.ones(n))
    if isinstance(table.prior, Prior):
        alpha = _per_band(table.prior.mean, n, f"{where}.prior.mean")
        alpha_sd = _per_band(table.prior.sd, n, f"{where}.prior.sd")
        inside = (alpha > max(lower, 0.0)) & (alpha < min(upper, 1.0)) & (alpha_sd > 0.0)
        if not np.all(inside):
            band = int(np.argmin(inside))
            raise InputError(
                "a prior lies outside of its bounds or has no spread",
                where=f"{where}.prior",
                found=f"mean {alpha[band]:g}, sd {alpha_sd[band]:g} "
                f"at {campaign.bands.centres_hz[band]:g} Hz",
                needed=f"{lower:g} < mean < {upper:g} and sd > 0",
                hint="to hold an absorption fixed, write absorption = [...] instead",
            )
        between = (alpha - lower) / (upper - lower)
        mean, sd = logit_prior(between, alpha_sd / (upper - lower))
    known = None
    if table.absorption is not None:
        known = _per_band(table.absorption, n, f"{where}.absorption")
        _check_within(known, lower, upper, f"{where}.absorption")
    return MaterialKnowledge(
        name,
        mean,
        sd,
        scattering=_scattering(table, campaign.bands, where),
        known=known,
        lower=lower,
        upper=upper,
        fit_scattering=table.scattering == "fit",
    )


def _check_within(values: FloatArray, lower: float, upper: float, where: str) -> None:
    bad = np.flatnonzero((values < lower) | (values > upper))
    if bad.size:
        raise InputError(
            "a given absorption lies outside of its own bounds",
            where=where,
            found=f"{values[bad[0]]:g}",
            needed=f"{lower:g} to {upper:g}",
            hint="remove bounds: an absorption that is given is held fixed",
        )


def _scattering(table: MaterialTable, bands: Bands, where: str) -> FloatArray | None:
    """The told coefficient of every fitted band, shape (n_bands,)."""
    told = table.scattering
    if told is None or isinstance(told, str):
        return None
    if isinstance(told, Spectrum):
        if len(told.centres_hz) != len(told.values):
            raise InputError(
                "scattering has not as many values as centres",
                where=f"{where}.scattering",
                found=f"{len(told.values)} values and {len(told.centres_hz)} centres",
            )
        order = np.argsort(told.centres_hz)
        at = np.log(np.array(told.centres_hz)[order])
        at_bands = np.interp(np.log(bands.centres_hz), at, np.array(told.values)[order])
        return np.asarray(at_bands, dtype=np.float64)
    return _per_band(told, len(bands), f"{where}.scattering")


def _per_band(values: float | list[float], n: int, where: str) -> FloatArray:
    array = np.atleast_1d(np.array(values, dtype=np.float64))
    if array.size == 1:
        return np.full(n, array[0])
    if array.size != n:
        raise InputError(
            "a list has not one value per fitted band",
            where=where,
            found=f"{array.size} values",
            needed=f"{n} values, or a single number for all bands",
        )
    return array


def _room_spec(path: Path, table: CampaignTable) -> RoomSpec:
    room = table.room
    kinds = [k for k in ("file", "shoebox", "polygons") if getattr(room, k) is not None]
    if len(kinds) != 1:
        raise InputError(
            "the room needs exactly one description",
            where=f"{path}, room",
            found=", ".join(kinds) or "none",
            needed="one of file, shoebox, polygons",
        )
    folder = path.parent
    polygons = None
    if room.polygons is not None:
        polygons = PolygonSpec(
            corners=tuple(folder / f for f in room.polygons.corners),
            planes=tuple(folder / f for f in room.polygons.planes),
            replace={key: folder / f for key, f in room.polygons.replace.items()},
            drop=tuple(room.polygons.drop),
            sides=dict(room.polygons.sides),
        )
    return RoomSpec(
        file=None if room.file is None else folder / room.file,
        shoebox=room.shoebox,
        polygons=polygons,
        unit=room.unit,
        up=room.up,
        materials=dict(room.materials),
    )


def _measured_file(path: Path, row: MeasurementTable) -> MeasuredFile:
    # `read_campaign_table` has made sure that all three are given
    return MeasuredFile(
        str(row.source),
        str(row.receiver),
        ResponseSpec(
            path=path.parent / str(row.file),
            channel=row.channel,
            variable=row.variable,
            sampling_rate_variable=row.sampling_rate_variable,
            sampling_rate_hz=row.sampling_rate_hz,
            measurement=row.measurement,
            receiver_index=row.receiver_index,
            time_zero=row.time_zero,
            latency_s=row.latency_s,
        ),
        row.level,
        row.use,
    )


def _air(path: Path, table: AirTable) -> Air:
    with located(str(path)):
        return Air(
            table.temperature_c,
            table.humidity_percent,
            table.pressure_kpa,
            table.speed_of_sound_m_s,
            table.attenuation,
        )


def _bands(path: Path, table: IdentifyTable) -> Bands:
    if table.from_hz > table.to_hz:
        raise InputError(
            "the lowest band lies above the highest",
            where=f"{path}, identify",
            found=f"from_hz = {table.from_hz:g}, to_hz = {table.to_hz:g}",
            needed="from_hz <= to_hz",
        )
    with located(f"{path}, identify.bands"):
        if isinstance(table.bands, str):
            return bands_between(table.bands, table.from_hz, table.to_hz)
        octaves = set(table.bands) <= set(OCTAVES_HZ)
        return Bands("octave" if octaves else "third-octave", np.array(table.bands))


def _refuse_what_is_not_built(path: Path, table: CampaignTable) -> None:
    """A key that would change the answer is refused where this version cannot obey it."""
    refusals: list[tuple[str, object, bool]] = [
        ("identify.method", table.identify.method, table.identify.method in _LATER_METHODS),
        ("identify.model", table.identify.model, table.identify.model == "coherent"),
        (
            "air.temperature_sd_c",
            table.air.temperature_sd_c,
            table.air.temperature_sd_c is not None,
        ),
    ]
    for name, source in table.sources.items():
        refusals.append(
            (f"sources.{name}.directivity", source.directivity, source.directivity != "omni")
        )
    for name, material in table.materials.items():
        where = f"materials.{name}"
        refusals.append((f"{where}.scattering", "fit", material.scattering == "fit"))
        refusals.append((f"{where}.prior", material.prior, isinstance(material.prior, str)))
    for number, row in enumerate(table.measurements, start=1):
        for kind in ("parameters", "spectrum"):
            found = getattr(row, kind)
            refusals.append((f"measurements[{number}].{kind}", found, found is not None))
    for where, found, refused in refusals:
        if refused:
            raise InputError(
                "this version of roomfit cannot do that yet",
                where=f"{path}, {where}",
                found=repr(found),
                hint="remove it, or use a later version; it is refused so that no answer "
                "pretends to have obeyed it",
            )


_LATER_METHODS = ("certified", "posterior")
