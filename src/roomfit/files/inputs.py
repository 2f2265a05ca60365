"""What a campaign file names, read, as the arguments of the functions that answer questions."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any, TypedDict, cast

import numpy as np
from numpy.typing import ArrayLike

from roomfit.base.arguments import check_known
from roomfit.base.bands import Bands, bands_between
from roomfit.base.door import check_files, read_bytes
from roomfit.base.errors import InputError, located
from roomfit.base.findings import About, Code, Finding
from roomfit.base.typing import FloatArray
from roomfit.files import schema
from roomfit.files.campaign import input_files, read_campaign
from roomfit.files.directivity import read_directivity
from roomfit.files.responses import read_response
from roomfit.files.rooms import read_mesh, read_room
from roomfit.files.schema import Directivity as FirstOrderTable
from roomfit.files.values import read_parameters
from roomfit.materials import catalogue
from roomfit.materials.priors import MaterialPrior, complete_priors, in_bands, object_prior
from roomfit.model.patterns import Directivity, UnknownDirectivity, aimed, unit_vector
from roomfit.room.audience import audience_area_m2, points_on
from roomfit.room.inside import nearest_triangles
from roomfit.room.mesh import Mesh, area_vectors_m2, volume_m3
from roomfit.room.scene import (
    Room,
    RoomCheck,
    Scene,
    check_mesh,
    position_findings,
    room_from_mesh,
    triangle_material,
    with_objects,
    with_states,
)
from roomfit.settings import Settings
from roomfit.signals.iso3382 import MeasuredValues
from roomfit.signals.measurement import Measurement
from roomfit.signals.speech import speech_levels


def source_directivities(
    campaign: schema.Campaign, bands: Bands
) -> dict[str, Directivity | UnknownDirectivity]:
    """Return the directivity of every source that is not omnidirectional."""
    found = {}
    for name, table in campaign.source_tables.items():
        if table.directivity != "omni":
            with located(f"{campaign.path}, sources.{name}.directivity"):
                found[name] = _directivity(campaign, table.directivity, bands)
    return found


def _directivity(
    campaign: schema.Campaign, table: schema.SourceDirectivity, bands: Bands
) -> Directivity | UnknownDirectivity:
    folder = campaign.path.parent
    if isinstance(table, str):
        return UnknownDirectivity() if table == "fit" else read_directivity(folder / table, bands)
    if isinstance(table, FirstOrderTable):
        known = aimed(table.aim, table.b)
        return UnknownDirectivity(known.b, table.b_sd) if table.b_sd > 0.0 else known
    if isinstance(table, schema.SharedDirectivity):
        shared = campaign.loudspeakers[table.loudspeaker]
        if shared.directivity == "fit":
            return UnknownDirectivity(None, shared.b_sd, unit_vector(table.aim), table.loudspeaker)
        with located(f"loudspeakers.{table.loudspeaker}.directivity"):
            return read_directivity(folder / shared.directivity, bands, table.aim, table.up)
    return read_directivity(folder / table.file, bands, table.aim, table.up)


def material_priors(
    campaign: schema.Campaign,
    materials: tuple[str, ...],
    mesh: Mesh | None = None,
    bands: Bands | None = None,
) -> tuple[MaterialPrior, ...]:
    """Return what the campaign says of each of the room's materials, in their order.

    Objects among them have areas in the volume of a mesh, which is needed only of these. In the
    campaign's bands, unless others are given in which its lists have their values.
    """
    bands = campaign.bands if bands is None else bands
    volume = 0.0 if mesh is None else volume_m3(mesh)
    with located(str(campaign.path)):
        own = [_material_prior(campaign, t, k, bands) for k, t in campaign.materials.items()]
        for name in (k for k in materials if k in campaign.objects):
            known, law = object_areas_m2(campaign, name, mesh, bands)
            own.append(object_prior(name, bands, volume, absorption_area_m2=known, prior_m2=law))
        return complete_priors(materials, own, bands)


def object_areas_m2(
    campaign: schema.Campaign, name: str, mesh: Mesh | None, bands: Bands
) -> tuple[FloatArray | None, tuple[FloatArray, FloatArray] | None]:
    """Return the absorption area of all pieces of an object in m2: known, or mean and sd."""
    table, ways = campaign.objects[name], ("count", "floor_area_m2", "outlines")
    by_floor = table.floor_area_m2 is not None or table.outlines is not None
    known, prior = table.absorption_area_m2, table.prior
    law: tuple[ArrayLike, ArrayLike] | None = None
    with located(f"objects.{name}"):
        if sum(getattr(table, way) is not None for way in ways) > 1:
            hint = "keep what the object's absorption was measured by"
            schema.the_one(table, ways, "an object is measured in two ways", "", hint)
        n = next((x for x in (table.floor_area_m2, table.count) if x is not None), 1.0)
        if isinstance(known, str):
            known = catalogue.object_catalogue_area(known, bands, by_floor=by_floor)[0].tolist()
        if isinstance(prior, str):
            law = catalogue.object_catalogue_area(prior, bands, by_floor=by_floor)
        elif prior is not None:
            law = _mean_and_sd(prior, bands)
        if table.outlines is not None:
            n = _blocks_m2(table, mesh)[1]
        area_m2 = in_these(known, bands, "absorption_area_m2")
    found = None if known is None else n * np.asarray(area_m2, dtype=np.float64)
    if law is None:
        return found, None
    mean_m2, sd_m2 = (n * np.asarray(x, dtype=np.float64) for x in law)
    return found, (mean_m2, sd_m2)


def _blocks_m2(table: schema.ObjectTable, mesh: Mesh | None) -> tuple[float, float]:
    """Return the area of an object's blocks of seats, and that with strips along free edges."""
    if mesh is None:
        what = "outlines of seats without a room"
        hint = "without a room give floor_area_m2, strips along free edges included"
        raise InputError(what, found="outlines", needed="a table [room]", hint=hint)
    outlines = [np.array(o, dtype=np.float64) for o in table.outlines or ()]
    return audience_area_m2(mesh, outlines, table.edge_m)


def audience_findings(campaign: schema.Campaign, room: Room) -> tuple[Finding, ...]:
    """Return what area seats and audience absorb with, as blocks and as faces of the drawing."""
    found = []
    seats = {name: entry for name, table in campaign.materials.items() if (entry := _seats(table))}
    areas, owner = area_vectors_m2(room.mesh), triangle_material(room)
    for name, table in campaign.objects.items():
        if table.outlines is None:
            continue
        with located(f"objects.{name}"):
            own, whole = _blocks_m2(table, room.mesh)
        on = np.concatenate([points_on(np.array(o, dtype=np.float64)) for o in table.outlines])
        below = {room.materials[owner[t]] for t in nearest_triangles(room.mesh, on)[1]}
        if twice := sorted(below & seats.keys()):
            raise InputError(
                "the same seats absorb twice",
                where=f"objects.{name}",
                found=f"outlines on faces of the material {twice[0]!r}, {seats[twice[0]]!r}",
                needed="either the outlines, or the material",
                hint="give the faces the material of the floor",
            )
        text = (
            f"{name}: {own:.1f} m2 of seats absorb as {whole:.1f} m2, with strips of up to "
            f"{table.edge_m:g} m along their free edges."
        )
        found.append(Finding(Code.AUDIENCE_AREA, About((name,)), text, {"area_m2": [own, whole]}))
    for name in (k for k in room.materials if k in seats):
        own_areas = areas[owner == room.materials.index(name)]
        sizes = np.linalg.norm(own_areas, axis=1)
        upright = float(sizes[np.abs(own_areas[:, 2]) < 0.5 * sizes].sum())
        level = float(sizes.sum() - upright)
        text = (
            f"{name}: {level:.1f} m2 of level and {upright:.1f} m2 of upright faces absorb as "
            f"{seats[name]!r}. Its coefficients are of the floor that seats take with a strip of "
            "0.5 m along free edges, for which the upright faces stand: half of it where they are "
            "0.25 m high, 1.6 times where they are 0.8 m high."
        )
        evidence = {"level_m2": level, "upright_m2": upright}
        found.append(Finding(Code.AUDIENCE_AREA, About((name,)), text, evidence))
    return tuple(found)


def _seats(table: schema.MaterialTable) -> str:
    """Return the entry of the catalogue that a material has if that is of seats, else ""."""
    named = [x for x in (table.absorption, table.prior) if isinstance(x, str)]
    return named[0] if named and catalogue.find_material(named[0]).group == catalogue.SEATS else ""


def _material_prior(
    campaign: schema.Campaign, table: schema.MaterialTable, name: str, bands: Bands
) -> MaterialPrior:
    where, known = f"materials.{name}", cast("Any", table.absorption)
    if isinstance(known, str):
        with located(f"{where}.absorption"):
            known, _ = catalogue.catalogue_prior(known, bands)
    # what is known of a product is stated with it
    product = None if table.product is None else campaign.products[table.product]
    stated = table if product is None else product
    prior = stated.prior
    with nullcontext() if product is None else located(f"products.{table.product}"):
        found = catalogue.material_prior(
            name,
            bands,
            absorption=in_these(known, bands, f"{where}.absorption"),
            prior=prior if prior is None or isinstance(prior, str) else _mean_and_sd(prior, bands),
            bounds=stated.bounds,
            scattering=in_these(table.scattering, bands, f"{where}.scattering"),
            same_absorption_as=table.same_absorption_as,
            delay_sd_s=None if table.delay_sd_ms is None else 1e-3 * table.delay_sd_ms,
        )
    if product is None:
        return found
    return replace(found, product=table.product, product_sd=product.sd)


def _mean_and_sd(
    prior: schema.Prior | schema.AreaPrior, bands: Bands
) -> tuple[ArrayLike, ArrayLike]:
    if prior.centres_hz is None:
        return prior.mean, prior.sd
    mean, sd = (
        _interpolated(prior.centres_hz, own, bands, f"prior.{key}")
        if isinstance(own, list)
        else own
        for key, own in (("mean", prior.mean), ("sd", prior.sd))
    )
    return mean, sd


def in_these(given: Any, bands: Bands, where: str) -> Any:
    """Return the values of a spectrum at the bands; anything else as it is."""
    if not isinstance(given, schema.Spectrum):
        return given
    return _interpolated(given.centres_hz, given.values, bands, where)


def _interpolated(
    centres_hz: Sequence[float], values: Sequence[float], bands: Bands, where: str
) -> FloatArray:
    """Return values at the bands, interpolated over the logarithm of the frequency.

    `centres_hz`: in any order. Beyond the lowest and the highest, the nearest value.
    """
    if len(centres_hz) != len(values):
        raise InputError(
            "not as many values as centres",
            where=where,
            found=f"{len(values)} values and {len(centres_hz)} centres",
            needed="one value for each centre",
            hint="add the values that lack, or leave centres out that have none",
        )
    order = np.argsort(centres_hz)
    at = np.log(np.array(centres_hz)[order])
    return np.asarray(np.interp(np.log(bands.centres_hz), at, np.array(values)[order]))


def read_measurements(campaign: schema.Campaign) -> tuple[Measurement | MeasuredValues, ...]:
    """Return everything that a campaign file names as measured, responses first."""
    if campaign.spectra:
        raise InputError(
            "damped spectra hold impedances, not absorption in bands",
            where=str(campaign.path),
            found=str(campaign.spectra[0].path.name),
            needed="impulse responses (file) or room parameters",
            hint="roomfit impedance reads this campaign",
        )
    known: dict[str, Iterable[str]] = {
        "source": campaign.source_tables,
        "receiver": campaign.receiver_tables,
    }
    found: list[MeasuredValues] = []
    for table in campaign.tables:
        values, findings = read_parameters(table.path, table.source or None, table.receiver or None)
        for i, own in enumerate(values):
            for kind, names in known.items():
                what = f"a table of room parameters names a {kind} that no table defines"
                hint = f"add [{kind}s.NAME], or choose rows with source and receiver"
                check_known(what, getattr(own, kind), names, where=str(table.path), else_try=hint)
            doubts = findings if i == 0 else ()
            found.append(replace(own, use=table.use, findings=doubts, state=table.state))
    return (*map(read_file, campaign.measurements), *found)


def read_file(file: schema.MeasurementTable) -> Measurement:
    """Read one impulse response that a campaign names, with what is doubtful about it."""
    spec = file.response
    response, findings = read_response(spec)
    return Measurement(
        file.source,
        file.receiver,
        response.pressure,
        response.sampling_rate_hz,
        latency_s=response.time_zero_s,
        time_zero=spec.time_zero,
        latency_sd_s=file.latency_sd_s,
        level=file.level,
        use=file.use,
        name=spec.path.name,
        state=file.state,
        where=spec.where,
        findings=findings,
    )


class IdentifyArguments(TypedDict):
    """What `roomfit.identify` takes."""

    scene: Scene
    measurements: tuple[Measurement | MeasuredValues, ...]
    materials: tuple[MaterialPrior, ...]
    bands: Bands
    settings: Settings
    directivities: dict[str, Directivity | UnknownDirectivity]


def load_campaign(path: Path | str) -> IdentifyArguments:
    """Read a campaign file and every file that it names, as arguments of `roomfit.identify`.

    Raises
    ------
    InputError
        The campaign, the room, or a measured file is not as needed.
    StoreError
        The disk refuses.

    Examples
    --------
    ``roomfit.identify(**roomfit.load_campaign("campaign.toml"))`` is what the command line does.

    >>> import tempfile
    >>> from pathlib import Path
    >>> text = '''
    ... [room]
    ... shoebox = [6, 5, 3]
    ... [sources.S]
    ... position = [1.5, 1.2, 1.5]
    ... [receivers.R]
    ... position = [4.0, 3.5, 1.2]
    ... [[measurements]]
    ... parameters = "measured.csv"
    ... '''
    >>> table = "source,receiver,parameter,500,1000\\nS,R,T30,0.9,0.8\\n"
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "campaign.toml"
    ...     _ = file.write_text(text)
    ...     _ = file.with_name("measured.csv").write_text(table)
    ...     arguments = load_campaign(file)
    >>> arguments["measurements"][0].values["T30_s"]
    array([0.9, 0.8])
    """
    return identify_arguments(read_campaign(Path(path)))


def identify_arguments(
    campaign: schema.Campaign, between_hz: tuple[float, float] | None = None
) -> IdentifyArguments:
    """Return a campaign that was read as arguments of `roomfit.identify`, see `load_campaign`.

    `between_hz`: lowest and highest centre to fit in place of the campaign's, of the same kind.
    Lists with a value for each band stay those of the campaign's, and hold for the ones among them.
    """
    check_files(input_files(campaign), str(campaign.path))
    room = campaign_room(campaign)
    bands = campaign.bands
    bands = bands if between_hz is None else bands_between(bands.kind, *between_hz)
    return {
        "scene": campaign_scene(campaign, room),
        "measurements": read_measurements(campaign),
        "materials": room_priors(campaign, room, bands),
        "bands": bands,
        "settings": campaign.settings,
        "directivities": source_directivities(campaign, bands),
    }


def positions_m(campaign: schema.Campaign) -> FloatArray:
    """Return where sources and receivers stand, shape (n, 3): the room is the air about them."""
    points = (*campaign.sources, *campaign.receivers)
    return np.array([p.position_m for p in points], dtype=np.float64).reshape(-1, 3)


def campaign_room(campaign: schema.Campaign) -> Room:
    """Return the room of a campaign with what was found in reading it."""
    room, findings = read_room(campaign.room, positions_m(campaign))
    with located(str(campaign.path)):
        findings = (*findings, *campaign.findings)
        described = replace(room, findings=findings, lengths_sd_m=campaign.room.lengths_sd)
        described = with_states(described, campaign.states)
        findings = (*findings, *audience_findings(campaign, described))
        return _furnished(replace(described, findings=findings), campaign)


def room_priors(
    campaign: schema.Campaign, room: Room, bands: Bands | None = None
) -> tuple[MaterialPrior, ...]:
    """Return what is said of each of the room's materials, in the campaign's bands or in others."""
    own = described = campaign.bands
    bands = own if bands is None else bands
    if not np.isin(bands.centres_hz, own.centres_hz).all():
        # all of both: more than a list of the campaign has values for, which is then refused
        ends_hz = np.concatenate([own.centres_hz, bands.centres_hz])
        described = bands_between(own.kind, float(ends_hz.min()), float(ends_hz.max()))
    priors = material_priors(campaign, room.materials, room.mesh, described)
    return in_bands(priors, np.searchsorted(described.centres_hz, bands.centres_hz))


def speech_db(campaign: schema.Campaign) -> FloatArray | None:
    """Return octave levels of speech and noise, shape (2, 7), None where none are stated."""
    speech = campaign.speech
    return speech_levels(speech.level_dba, speech.noise_db) if speech else None


def _furnished(room: Room, campaign: schema.Campaign) -> Room:
    return with_objects(room, {name: table.states for name, table in campaign.objects.items()})


def campaign_scene(campaign: schema.Campaign, room: Room) -> Scene:
    """Return every source with every receiver that a campaign defines."""
    sources, receivers = campaign.sources, campaign.receivers
    pairs = np.indices((len(sources), len(receivers)), dtype=np.int64).reshape(2, -1).T
    return Scene(room, sources, receivers, pairs, campaign.air, groups=campaign.groups)


def check_room(spec: schema.RoomSpec) -> RoomCheck:
    """Read a room and return all its faults."""
    mesh, findings = read_mesh(spec)
    return check_mesh(mesh, spec.materials, findings)


def check_campaign(campaign: schema.Campaign) -> RoomCheck:
    """Return all faults of a campaign's room and of the positions of sources and receivers.

    Measured files are not opened. Positions are checked once the room itself has no fault.
    """
    spec = campaign.room
    mesh, findings = read_mesh(spec, positions_m(campaign))
    check = check_mesh(mesh, spec.materials, findings)
    if not check.traceable:
        return check
    room = _furnished(with_states(room_from_mesh(mesh, spec.materials), campaign.states), campaign)
    priors = room_priors(campaign, room)
    assumed = (*catalogue.broad_prior_findings(priors), *catalogue.product_findings(priors))
    assumed += audience_findings(campaign, room)
    position_doubts = position_findings(room, campaign.sources, campaign.receivers)
    return replace(check, findings=(*check.findings, *position_doubts, *assumed))


_LOGOS = {"png": b"\x89PNG\r\n\x1a\n", "jpeg": b"\xff\xd8\xff"}


def project_details(own: schema.ProjectTable, folder: Path) -> dict[str, str]:
    """Return what a project says, as `roomfit.report_html` takes it, the logo as a data URL.

    `folder`: that of the campaign, where the logo is looked for.
    """
    said = own.model_dump(exclude_none=True, exclude={"logo"})
    said |= {"date": str(said.get("date", "")), "instruments": ", ".join(own.instruments)}
    if own.logo is not None:
        content = read_bytes(folder / own.logo, "logo", most="logo_bytes")
        kind = next((k for k, begin in _LOGOS.items() if content.startswith(begin)), None)
        if kind is None:
            raise InputError(
                "the logo is no picture that a report can show",
                where="project.logo",
                found=str(folder / own.logo),
                needed="a PNG or JPEG file",
                hint="save it as PNG",
            )
        said["logo"] = f"data:image/{kind};base64,{b64encode(content).decode()}"
    return {key: value for key, value in said.items() if value}
