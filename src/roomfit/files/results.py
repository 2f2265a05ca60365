"""The files of an answer, format_version 1: ``result.json`` and ``absorption.csv``.

Both are written here, and read back as absorption with its posterior. Keys of the files are a
contract: they keep their names where a term in the code is another.
"""

from __future__ import annotations

import hashlib
import logging
import shutil
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from roomfit.base.arguments import bool_array, check_known, float_array, unique_names
from roomfit.base.bands import Bands, bands_of
from roomfit.base.door import complete, csv_rows, decoded, read_text
from roomfit.base.errors import InputError, RoomfitError, StoreError, located
from roomfit.base.findings import Finding
from roomfit.base.logit import logit
from roomfit.base.table import csv_of, without_apostrophe
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.base.whole_files import nearest_existing, write_json_atomically, write_text_atomically
from roomfit.files import encoding
from roomfit.files.tables import number_in
from roomfit.materials.priors import object_absorption
from roomfit.result import ComparedPair, Result, absorption_posterior, fitted_pair
from roomfit.uncertainty.posterior import (
    AbsorptionPosterior,
    FittedPair,
    covariance_from_intervals,
)

_LOG = logging.getLogger("roomfit")

# Of result.json, by table: what may stand there.
RESULT_KEYS = {
    "": "format format_version bands_hz materials combinations pairs findings fit plan settings "
    "trace provenance usable remains states sd_without mean_sd_without directivity geometry "
    "posterior objects reverberation files_sha256 content_sha256",
    "materials": "absorption lower95 upper95 identifiable area_m2 scattering share share_lower95 "
    "share_upper95 prior interval",
    "posterior": "materials logit_mean logit_covariance prior_logit_mean prior_logit_sd "
    "prior_logit_covariance draws prior_specified",
    "fit": "method model cost models phi by_pressures evaluations converged seconds seed "
    "intervals method_chosen reasons",
    "pairs": "source receiver use state distance_m parameters sti",
    "findings": "code severity sentence about evidence remedies",
}
_WHOLE = "a result.json as roomfit writes it"
_INTERVAL = ("absorption", "lower95", "upper95")
_COLUMNS = ("material", "band_hz", *_INTERVAL, "identifiable")
_OBJECT = ("absorption_area_m2", "lower95_m2", "upper95_m2", "identifiable", "room_volume_m3")

# Of report, tables and pictures of the demo, and of a pair's decay: 2.0 MB with eight pairs.
_RESULT_BYTES, _PAIR_BYTES = 1.5e6, 2e5


def check_disk_room(path: Path, n_pairs: int, n_results: int = 1) -> None:
    """Refuse a disk on which results of so many pairs find no room, before the work.

    About so much: by what the demo writes. An earlier result stays until the new one is whole, so
    that its place does not count. A disk that does not say how much is free is not refused.
    """
    needed_mb = (n_results * _RESULT_BYTES + n_pairs * _PAIR_BYTES) / 1e6
    with suppress(OSError):
        disk = shutil.disk_usage(nearest_existing(Path(path)))
        if disk.total > 0 and disk.free < 1e6 * needed_mb:
            raise StoreError(
                "the disk has no room for the result",
                where=str(path),
                found=f"{disk.free / 1e6:.1f} MB free",
                needed=f"about {needed_mb:.1f} MB",
                hint="make room, or choose a folder on another disk",
            )


# Reading.


@dataclass(frozen=True, slots=True, eq=False)
class MaterialTable:
    """Materials of a result."""

    names: tuple[str, ...]
    bands: Bands
    absorption: FloatArray  # (n_materials, n_bands), 0 to 1; and so the next two
    lower95: FloatArray
    upper95: FloatArray
    identifiable: BoolArray  # (n_materials, n_bands)
    scattering: FloatArray | None = None  # (n_materials, n_bands); None where the result has none
    findings: tuple[Finding, ...] = ()  # on the file

    def __post_init__(self) -> None:
        shape = (len(self.names), len(self.bands))
        checked: dict[str, object] = {
            name: float_array(name, value, shape, low=0.0, high=1.0)
            for name in (*_INTERVAL, "scattering")
            if (value := getattr(self, name)) is not None
        }
        checked["names"] = unique_names("material", self.names)
        checked["identifiable"] = bool_array("identifiable", self.identifiable, shape)
        for name, values in checked.items():
            object.__setattr__(self, name, values)


def material_table_of(result: Result) -> MaterialTable:
    """Return the materials of a result in memory."""
    columns = {name: getattr(result, name) for name in (*_COLUMNS[2:], "scattering")}
    return MaterialTable(result.materials, result.bands, **columns)


def read_result(file: encoding.ResultFile) -> AbsorptionPosterior:
    """Return the absorption of a result with its posterior.

    A ``result.json`` holds the covariance between materials; from an ``absorption.csv``, or a
    result without ``posterior``, the intervals are taken as independent.

    Parameters
    ----------
    file : Path or EditedFile
        ``EditedFile(path)`` reads what was changed since roomfit wrote it.

    Raises
    ------
    InputError
        There is no such file, it is neither of the two, or its numbers are out of range; or its
        content is not that of its digest, and the file is given as a path.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "absorption.csv"
    ...     _ = file.write_text(
    ...         "material,band_hz,absorption,lower95,upper95,identifiable\\n"
    ...         "carpet,500,0.3,0.25,0.36,true\\n"
    ...     )
    ...     found = read_result(file)
    >>> found.materials, found.absorption
    (('carpet',), array([[0.3]]))
    """
    table, content = read_materials(file)
    for doubt in table.findings:
        _LOG.warning("%s: %s", doubt.severity, doubt.sentence)
    with located(str(encoding.path_of(file))), complete("result", _WHOLE):
        volumes_m3, (value, low, high) = _with_objects(table, content)
        posterior, fit = content.get("posterior", {}), content.get("fit", {})
        own: dict[str, Any] = {
            name: np.moveaxis(np.array(posterior[name], dtype=kind), 0, axis)
            for name, (kind, axis) in _POSTERIOR.items()
            if name in posterior or (posterior and name == "logit_covariance")
        }
        own.setdefault("logit_covariance", covariance_from_intervals(value, low, high))
        fitted = [pair for pair in content.get("pairs", ()) if pair["use"] == "fit"]
        areas = [content.get("materials", {}).get(n, {}).get("area_m2") for n in table.names]
        scattering, of_objects = table.scattering, np.zeros((len(volumes_m3), len(table.bands)))
        found = [encoding.finding_of(one, "findings") for one in content.get("findings", ())]
        return AbsorptionPosterior(
            (*table.names, *volumes_m3),
            table.bands,
            value,
            low,
            high,
            **own,
            scattering=None if scattering is None else np.concatenate((scattering, of_objects)),
            directivities=_directivities(content.get("directivity", {})),
            by_pressures=fit.get("by_pressures"),
            chi2_reduced=fit.get("phi"),
            fitted=tuple(_fitted_pair(p, table.bands) for p in fitted),
            areas_m2=None if None in areas else np.array([*areas, *(0.0,) * len(volumes_m3)]),
            result_findings=(*table.findings, *found),
            objects=volumes_m3,
        )


def _fitted_pair(pair: Mapping[str, Any], bands: Bands) -> FittedPair:
    place = (
        pair["source"],
        pair["receiver"],
        pair.get("state") or "",
        float(pair.get("distance_m", np.nan)),
    )
    tables = pair["parameters"].items()
    return fitted_pair(place, {n: (c["measured"], c["predicted"]) for n, c in tables}, bands)


# Arrays of a posterior that are read again: their kind, and where their first axis of the file is
_POSTERIOR: dict[str, tuple[type, int]] = {
    "logit_covariance": (np.float64, 0),
    "prior_logit_mean": (np.float64, 1),
    "prior_logit_sd": (np.float64, 1),
    "prior_logit_covariance": (np.float64, 0),
    "draws": (np.float64, 0),
    "prior_specified": (np.bool_, 0),  # not stated in a file that does not say which were
}


def _with_objects(
    table: MaterialTable, content: Mapping[str, Any]
) -> tuple[dict[str, float], list[FloatArray]]:
    """Return the volume of each object's room, and absorption and bounds of walls and objects."""
    found = content.get("objects", {})
    volumes_m3 = {name: float(one["room_volume_m3"]) for name, one in found.items()}
    whole = []
    for key, area in zip(_INTERVAL, _OBJECT, strict=False):
        shares = [
            object_absorption(np.array(one[area], dtype=np.float64), volumes_m3[name])
            for name, one in found.items()
        ]
        whole.append(np.concatenate([getattr(table, key), *(s[None] for s in shares)]))
    return volumes_m3, whole


def _directivities(by_source: Mapping[str, Any]) -> dict[str, Any]:
    """Return the pattern of every source for which it was fitted."""
    if not by_source:
        return {}
    from roomfit.model.patterns import Pattern  # compiled: other results do not wait for it

    return {
        name: Pattern(np.array(one["b"]), one.get("aim"), one.get("loudspeaker", ""))
        for name, one in by_source.items()
    }


def read_result_content(file: encoding.ResultFile) -> tuple[dict[str, Any], tuple[Finding, ...]]:
    """Return the content of a ``result.json`` of this version, and what its digest says of it."""
    content, findings = encoding.written_content(file, "result")
    with located(str(encoding.path_of(file))), complete("result", _WHOLE):
        own = content if isinstance(content, dict) else {}
        stated = own.get("format"), own.get("format_version")
        if stated != ("roomfit-result", 1):
            raise InputError(
                "this is no result of roomfit, or not of this version",
                found=f"format {stated[0]!r}, format_version {stated[1]!r}",
                needed='"format": "roomfit-result" and "format_version": 1 in the file',
                hint="give a result.json that roomfit identify has written, or identify again",
            )
        for name, known in RESULT_KEYS.items():
            part = content.get(name, {}) if name else content
            tables: dict[str, Any] = {name or "top level": part}
            if name == "materials":
                tables = {f"materials.{own}": table for own, table in part.items()}
            elif isinstance(part, list):
                tables = {f"{name}[{i}]": table for i, table in enumerate(part, start=1)}
            for where, key in ((where, key) for where, table in tables.items() for key in table):
                hint = "read it with the version of roomfit that `provenance` names"
                what = "unknown key in a file of roomfit"
                check_known(what, key, sorted(known.split()), where=where, else_try=hint)
    return content, findings


def read_materials(file: encoding.ResultFile) -> tuple[MaterialTable, dict[str, Any]]:
    """Return the materials of a ``result.json``, with its content, or of an ``absorption.csv``."""
    path = encoding.path_of(file)
    if path.suffix.lower() == ".csv":
        text = read_text(path, "result")
        findings = encoding.digest_findings(file, "table", text_digest(text), _digest_beside(path))
        with located(str(path), hint="export the table again, or give the result.json beside it"):
            return replace(_from_csv(text), findings=findings), {}
    content, findings = read_result_content(file)
    needed = "bands_hz, and for each material absorption, lower95, upper95, identifiable"
    with located(str(path)), complete("result", needed):
        entries = content["materials"].values()
        scattering = [m.get("scattering") for m in entries]
        table = MaterialTable(
            tuple(content["materials"]),
            bands_of(content["bands_hz"]),
            **{key: np.array([m[key] for m in entries]) for key in _COLUMNS[2:]},
            scattering=None if None in scattering or not entries else np.array(scattering),
            findings=findings,
        )
    return table, content


def text_digest(text: str) -> str:
    """Return the SHA-256 of a text file as roomfit writes it, whatever ends its lines."""
    return hashlib.sha256(decoded(text.encode(errors="replace")).encode()).hexdigest()


def _digest_beside(path: Path) -> object:
    """Return the digest of a file that the result beside it states; None without such a result."""
    with suppress(RoomfitError, AttributeError):
        content, doubts = encoding.written_content(path.with_name("result.json"), "result")
        return None if doubts else content.get("files_sha256", {}).get(path.name)
    return None


def _from_csv(text: str) -> MaterialTable:
    # as `absorption_csv` writes it: every name counts, also one with blanks or a # before it
    header, *lines = [cells for _, cells in csv_rows(text, "") if cells] or [[]]
    place: dict[tuple[str, float], tuple[float, ...]] = {}
    needed, hint = "a number with a decimal point", "fill the row up, or remove it"
    with complete("table of absorption", ", ".join(_COLUMNS)):
        for number, cells in enumerate(lines, start=2):
            # a row that is too short has empty cells
            row = dict.fromkeys(header, "") | dict(zip(header, cells, strict=False))
            centre, *values = (
                number_in(row[name], f"line {number}, column {name}", needed, hint)
                for name in _COLUMNS[1:-1]
            )
            flag, what = row["identifiable"].lower(), "identifiable is neither true nor false"
            check_known(what, flag, ("true", "false"), where=f"line {number}", else_try=hint)
            place[without_apostrophe(row["material"]), centre] = (*values, flag == "true")
    names = tuple(dict.fromkeys(name for name, _ in place))
    centres = sorted({centre for _, centre in place})
    if not place or len(place) != len(lines) or len(lines) != len(names) * len(centres):
        raise InputError(
            "the table of absorption is not complete",
            found=f"{len(lines)} rows, {len(names)} materials, {len(centres)} bands",
            needed="each material in each band once",
            hint="remove the rows given twice, and add what is missing",
        )
    found = np.array([[place[m, f] for f in centres] for m in names]).transpose(2, 0, 1)
    value, low, high, sure = found
    return MaterialTable(names, bands_of(centres), value, low, high, sure.astype(np.bool_))


# Writing.


def write_result(
    folder: Path, answer: Result, inputs: Iterable[Path], usable: Sequence[str] = ()
) -> None:
    """Write ``result.json`` and ``absorption.csv`` into a folder.

    Parameters
    ----------
    folder : Path
        One that exists.
    answer : Result
    inputs : iterable of Path
        Files whose SHA-256 is written; the first is the campaign, relative to which the others are
        named.
    usable : sequence of str, optional
        What remains usable where findings void walls, from `roomfit.report.doubts`.

    Raises
    ------
    StoreError
        The disk refuses.

    Examples
    --------
    >>> import tempfile
    >>> import roomfit
    >>> room = roomfit.shoebox_room((6.0, 5.0, 3.0), "plaster")
    >>> scene = roomfit.scene_of(room, {"S": (1.5, 1.2, 1.5)}, {"R": (4.0, 3.5, 1.2)})
    >>> measured = roomfit.MeasuredValues("S", "R", [1000.0], {"T20_s": [0.8]})
    >>> octave, few = roomfit.bands_between("octave", 1000, 1000), roomfit.Settings(n_rays=2000)
    >>> result = roomfit.identify(scene, [measured], bands=octave, settings=few)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_result(Path(folder), result, [])
    ...     found = read_result(Path(folder) / "result.json")
    >>> bool(np.all(found.absorption == result.absorption))
    True
    """
    content, table = result_content(answer, inputs, usable), absorption_csv(answer)
    content["files_sha256"] = {"absorption.csv": text_digest(table)}
    write_text_atomically(folder / "absorption.csv", table)
    write_json_atomically(folder / "result.json", content)


def absorption_csv(answer: Result) -> str:
    """Return the absorption table: material, band_hz, absorption, bounds, identifiable."""
    return csv_of(answer.records(), missing="nan")


def _stated(content: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in content.items() if value is not None}


def result_content(
    answer: Result, inputs: Iterable[Path], usable: Sequence[str] = ()
) -> dict[str, Any]:
    """Return the content of result.json: arrays over bands_hz, null only inside pairs.

    The first of the inputs is the campaign; the others are named relative to its folder.
    ``posterior`` is the Gaussian of logit absorption in each band, where the answer has it.
    `roomfit.base.whole_files.json_text` turns it into text.
    """
    from roomfit.checks.verdict import what_remains

    remains = what_remains(answer)
    content = {
        "format": "roomfit-result",
        "format_version": 1,
        "bands_hz": answer.bands.centres_hz,
        "materials": {name: _material(answer, i) for i, name in enumerate(answer.materials)},
        "objects": _objects(answer),
        "combinations": _combinations(answer),
        "pairs": [_pair(p, answer.bands) for p in answer.pairs],
        "findings": [encoding.finding_content(f) for f in answer.findings],
        "fit": _fit(answer),
        "plan": answer.plan or None,
        "settings": answer.settings.changed(),
        "trace": answer.trace or None,
        "provenance": encoding.provenance(inputs)
        | {
            "speed_of_sound_m_s": answer.speed_of_sound_m_s,
            "speed_of_sound_formula": "Cramer 1993 as in pyfar, or as given by the campaign",
        },
        "usable": usable if remains.voids else None,
        "remains": {
            "void": [code.value for code in remains.codes],
            "mean_usable": [bool(b) for b in remains.mean_usable],
            "decay_error": encoding.numbers_or_null(remains.decay_error),
            "decay_parameter": remains.decay_name or None,
            "void_but_identifiable_by_rule": remains.taken,
        }
        if remains.voids
        else None,
        "states": {
            name: dict(zip(("mean_absorption", *_INTERVAL[1:]), mean, strict=True))
            for name, mean in (answer.state_means or {}).items()
        }
        or None,
        "sd_without": _without(answer.costs, 4),
        "mean_sd_without": _without(answer.mean_costs, 6),
        "directivity": {
            name: {"b": d.b, "sd": d.sd}
            | ({} if p.aim is None else {"aim": p.aim, "loudspeaker": p.loudspeaker})
            for d in answer.directivities
            for name, p in d.patterns().items()
        }
        or None,
        "geometry": _geometry(answer),
        "posterior": posterior_content(absorption_posterior(answer)),
    }
    return _stated(content)


def _without(costs: Sequence[Mapping[str, Any]], decimals: int) -> list[dict[str, Any]] | None:
    """How well absorption was known without each term of its uncertainty, by band."""
    if not any(costs):
        return None
    return [
        {
            name or "nothing": encoding.numbers_or_null(np.round(sd, decimals))
            for name, sd in band.items()
        }
        for band in costs
    ]


def _geometry(answer: Result) -> dict[str, Any] | None:
    """Shifts that arrival times need: no measurement of positions."""
    if (geometry := answer.geometry) is None:
        return None
    return {
        "note": "fitted to arrival times; these absorb errors of the model, too",
        "speed_of_sound_m_s": geometry.speed_of_sound_m_s,
        "labels": geometry.labels,
        "change": geometry.change,
        "sd": geometry.sd,
        "told_sd": geometry.prior_sd,
    }


_FIT = ("method", "model", "cost", "models", "evaluations", "converged", "seed", "reasons")


def _fit(answer: Result) -> dict[str, Any]:
    """How the answer was found, how well it fits, and how its intervals were made."""
    added = answer.by_pressures
    content = {name: getattr(answer, name) for name in _FIT} | {
        "phi": answer.chi2_reduced,
        "by_pressures": added if added is not None and added.any() else None,
        "seconds": round(answer.seconds, 3),
        "intervals": answer.interval_kind,
        "method_chosen": answer.method,
    }
    return _stated(content)


def posterior_content(own: AbsorptionPosterior) -> dict[str, Any]:
    """Return the Gaussian of logit absorption in each band, its prior, and draws of it.

    Objects are among the materials.
    """
    found = {name: getattr(own, name) for name in _POSTERIOR if getattr(own, name) is not None}
    content = {name: np.moveaxis(a, _POSTERIOR[name][1], 0) for name, a in found.items()}
    if own.draws is not None:
        # a share that objects absorb in a step is a hundred times smaller than that of a wall
        content["draws"] = np.round(own.draws, 7 if own.objects else 5)
    return {"materials": own.materials, "logit_mean": logit(own.absorption).T, **content}


def _objects(answer: Result) -> dict[str, Any] | None:
    """Return the equivalent absorption area of each object in m2, with its interval."""
    if (found := answer.objects) is None:
        return None
    volumes_m3 = [round(v, 4) for v in found.volumes_m3.values()]
    columns = (found.area_m2, found.lower95_m2, found.upper95_m2, found.identifiable, volumes_m3)
    rows = zip(*columns, strict=True)
    return {n: dict(zip(_OBJECT, r, strict=True)) for n, r in zip(found.names, rows, strict=True)}


def _material(answer: Result, i: int) -> dict[str, Any]:
    """Absorption of a material, its share (air left out), its prior, and kinds of intervals."""
    content: dict[str, Any] = {name: getattr(answer, name)[i] for name in _COLUMNS[2:]}
    content["area_m2"] = round(float(answer.areas_m2[i]), 4)
    if answer.scattering is not None:
        content["scattering"] = answer.scattering[i]
    names = ("share", "share_lower95", "share_upper95")
    content |= zip(names, answer.shares[:, i], strict=True)
    content["prior"] = dict(zip(_INTERVAL, answer.prior[:, i], strict=True))
    content["interval"] = [kinds[i] for kinds in answer.interval_kinds]
    return content


def _combinations(answer: Result) -> list[dict[str, Any]]:
    """Means over groups of materials that the data determine, the whole room's first."""

    def entry(kind: str, c: Any) -> dict[str, Any]:
        named = zip(answer.materials, c.weights, strict=True)
        weights = {name: round(float(w), 6) for name, w in named if w != 0.0}
        numbers = {"absorption": c.value, "lower95": c.lower95, "upper95": c.upper95}
        return {"kind": kind, "weights": weights, **numbers, "determined": c.determined}

    sentences = answer.sentences or ("",) * len(answer.combinations)
    bands = zip(answer.bands.centres_hz, answer.combinations, sentences, strict=True)
    return [
        {
            "band_hz": centre,
            **entry("mean", c),
            "differences": [entry("difference", d) for d in c.differences],
            **({"sentence": sentence} if number == 0 and sentence else {}),
        }
        for centre, band, sentence in bands
        for number, c in enumerate(band)
    ]


def _pair(pair: ComparedPair, bands: Bands) -> dict[str, Any]:
    sti = np.full(2, np.nan)
    if pair.decay is not None:
        from roomfit.signals.speech import sti_of_decay

        curves = (pair.decay.measured_db, pair.decay.predicted_db)
        sti = np.array([sti_of_decay(bands, pair.decay.time_s, levels) for levels in curves])
    known = dict(zip(("measured", "predicted"), encoding.numbers_or_null(sti), strict=True))
    columns = {"measured": "measured", "predicted": "predicted", "jnd": "jnd"}
    columns |= {"mean_of_others": "null", "diffuse_field": "diffuse"}
    content = {
        "source": pair.source,
        "receiver": pair.receiver,
        "use": pair.use,
        "state": pair.state or None,
        "distance_m": None if np.isnan(pair.distance_m) else round(pair.distance_m, 4),
        "parameters": {
            name: {
                key: encoding.numbers_or_null(values)
                for key, own in columns.items()
                if (values := getattr(c, own)) is not None
            }
            for name, c in pair.parameters.items()
        },
        "sti": known if np.isfinite(sti).any() else None,
    }
    return _stated(content)
