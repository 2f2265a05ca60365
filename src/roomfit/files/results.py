"""The files of an answer, format_version 1: ``result.json`` and ``absorption.csv``.

Both are written here, and read back as absorption with its posterior. Keys of the files are a
contract: they keep their names where a term in the code is another.
"""

from __future__ import annotations

import logging
import shutil
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from roomfit.base.bands import Bands
from roomfit.base.door import complete
from roomfit.base.errors import InputError, StoreError, located
from roomfit.base.logit import logit
from roomfit.base.table import csv_of
from roomfit.base.typing import FloatArray
from roomfit.base.whole_files import nearest_existing, write_json_atomically, write_text_atomically
from roomfit.files.encoding import (
    ResultFile,
    finding_content,
    finding_of,
    number_or_null,
    numbers_or_null,
    path_of,
    provenance,
)
from roomfit.files.exports import (
    material_table,
    read_material_table,
    read_result_content,
    text_digest,
)
from roomfit.materials.priors import object_absorption
from roomfit.result import (
    ComparedPair,
    ObjectAreas,
    Result,
    absorption_posterior,
    departures_jnd,
)
from roomfit.uncertainty.posterior import AbsorptionPosterior, covariance_from_intervals

if TYPE_CHECKING:  # compiled: reading a result does not wait for it
    from roomfit.fit.fits import FittedGeometry
    from roomfit.model.patterns import Pattern
    from roomfit.uncertainty.combinations import Combination, Difference

_LOG = logging.getLogger("roomfit")


# Of report, tables and pictures of the demo, and of a pair's decay: 2.0 MB with eight pairs.
_RESULT_BYTES, _PAIR_BYTES = 1.5e6, 2e5


def check_disk_room(path: Path, n_pairs: int, n_results: int = 1) -> None:
    """Refuse a disk on which results of so many pairs find no room, before the work.

    About so much: by what the demo writes. An earlier result stays until the new one is whole, so
    that its place does not count. A disk that does not say how much is free is not refused.

    Raises
    ------
    StoreError
        Too little is free.
    """
    needed_mb = (n_results * _RESULT_BYTES + n_pairs * _PAIR_BYTES) / 1e6
    nearest = nearest_existing(Path(path))
    with suppress(OSError):
        disk = shutil.disk_usage(nearest)
        if disk.total > 0 and disk.free < 1e6 * needed_mb:
            raise StoreError(
                "the disk has no room for the result",
                where=str(path),
                found=f"{disk.free / 1e6:.1f} MB free",
                needed=f"about {needed_mb:.1f} MB",
                hint="make room, or choose a folder on another disk",
            )


def read_result(file: ResultFile) -> AbsorptionPosterior:
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
    path = path_of(file)
    content: dict[str, Any] = {}
    if path.suffix.lower() == ".csv":
        table = read_material_table(file)
    else:
        content, doubts = read_result_content(file)
        table = material_table(file, content, doubts)
    for doubt in table.findings:
        _LOG.warning("%s: %s", doubt.severity, doubt.sentence)
    with located(str(path)), complete("result", "a result.json as roomfit writes it"):
        posterior = content.get("posterior")
        objects, of_objects = _read_objects(content, len(table.bands))
        of_walls = (table.absorption, table.lower95, table.upper95)
        value, low, high = (np.concatenate(x) for x in zip(of_walls, of_objects, strict=True))
        if posterior is None:
            covariance = covariance_from_intervals(value, low, high)
        else:
            covariance = _posterior_table(posterior, "logit_covariance")
        mean = sd = together = None
        if posterior is not None and "prior_logit_mean" in posterior:
            mean = _posterior_table(posterior, "prior_logit_mean").T
            sd = _posterior_table(posterior, "prior_logit_sd").T
        if posterior is not None and "prior_logit_covariance" in posterior:
            together = _posterior_table(posterior, "prior_logit_covariance")
        # None of a file that does not say which priors were specified
        flags = (posterior or {}).get("prior_specified")
        return AbsorptionPosterior(
            (*table.names, *objects),
            table.bands,
            value,
            low,
            high,
            logit_covariance=covariance,
            prior_logit_mean=mean,
            prior_logit_sd=sd,
            prior_logit_covariance=together,
            scattering=_read_scattering(content, table.names, np.zeros_like(of_objects[0])),
            directivities=_read_directivities(content),
            by_pressures=content.get("fit", {}).get("by_pressures"),
            chi2_reduced=content.get("fit", {}).get("phi"),
            prior_specified=None if flags is None else np.array(flags, dtype=np.bool_),
            draws=_posterior_table(posterior, "draws") if "draws" in (posterior or {}) else None,
            fitted_jnd=_read_departures(content, table.bands),
            areas_m2=_read_areas(content, table.names, len(objects)),
            fitted_states=_read_states(content),
            result_findings=(
                *table.findings,
                *(finding_of(one, "findings") for one in content.get("findings", ())),
            ),
            objects=objects,
        )


@contextmanager
def _of_numbers(where: str, needed: str) -> Iterator[None]:
    """Refuse a part of a result that is no table of numbers, as one that was edited may be."""
    try:
        yield
    except (AttributeError, KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"{where} of the result: no table of numbers",
            where=where,
            found=f"{type(error).__name__}: {error}",
            needed=needed,
            hint="give result.json as roomfit identify wrote it, or identify again",
        ) from error


def _read_objects(
    content: dict[str, Any], n_bands: int
) -> tuple[dict[str, float], tuple[FloatArray, FloatArray, FloatArray]]:
    """Return the volume of each object's room, and the absorption of its area with both bounds."""
    found = content.get("objects", {})
    with _of_numbers(
        "objects", "by object: room_volume_m3, absorption_area_m2, lower95_m2 and upper95_m2"
    ):
        volumes_m3 = {name: float(one["room_volume_m3"]) for name, one in found.items()}
        keys = ("absorption_area_m2", "lower95_m2", "upper95_m2")
        areas = [
            [object_absorption(np.array(one[k], float), volumes_m3[n]) for n, one in found.items()]
            for k in keys
        ]
    value, low, high = (np.array(own).reshape(-1, n_bands) for own in areas)
    return volumes_m3, (value, low, high)


def _posterior_table(posterior: Any, name: str) -> FloatArray:
    with _of_numbers("posterior", "logit_covariance: for each band a matrix over the materials"):
        return np.array(posterior[name], dtype=np.float64)


def _read_directivities(content: dict[str, Any]) -> dict[str, Pattern]:
    """Return the directivity of every source for which it was fitted."""
    by_source = content.get("directivity", {})
    if not by_source:
        return {}
    from roomfit.model.patterns import Pattern

    with _of_numbers("directivity", "by source: b, three numbers for each band"):
        return {
            name: Pattern(np.array(one["b"]), one.get("aim"), one.get("loudspeaker", ""))
            for name, one in by_source.items()
        }


def _read_states(content: dict[str, Any]) -> tuple[str, ...] | None:
    """Return the states of the fitted pairs, None where the file has no pairs."""
    found = {str(p.get("state", "")) for p in content.get("pairs", ()) if p.get("use") == "fit"}
    return tuple(sorted(found)) or None


def _read_areas(
    content: dict[str, Any], names: tuple[str, ...], n_objects: int
) -> FloatArray | None:
    """Return the areas of walls in the room that was fitted, 0 of objects; None where one lacks."""
    found = [content.get("materials", {}).get(name, {}).get("area_m2") for name in names]
    if not found or any(not isinstance(a, int | float) for a in found):
        return None
    return np.array([*found, *(0.0,) * n_objects])


def _read_departures(content: dict[str, Any], bands: Bands) -> FloatArray | None:
    """Return the departures of the fitted pairs, None where the file has no pairs."""
    with _of_numbers(
        "pairs", "parameters with jnd, one number or null for each band, of every pair"
    ):
        tables = [
            {name: c["jnd"] for name, c in pair["parameters"].items()}
            for pair in content.get("pairs", ())
            if pair["use"] == "fit"
        ]
        return departures_jnd(tables, bands) if tables else None


def _read_scattering(
    content: dict[str, Any], names: tuple[str, ...], of_objects: FloatArray
) -> FloatArray | None:
    """Return the scattering that the fit used, that of objects last, None where some is lacking."""
    rows = [content.get("materials", {}).get(name, {}).get("scattering") for name in names]
    if not rows or any(row is None for row in rows):
        return None
    with _of_numbers("materials", "scattering: one number for each band"):
        return np.concatenate((np.array(rows, dtype=np.float64), of_objects))


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
        What remains usable where findings void walls, from `roomfit.report.usable`.

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


def result_content(
    answer: Result, inputs: Iterable[Path], usable: Sequence[str] = ()
) -> dict[str, Any]:
    """Return the content of result.json: arrays over bands_hz, null only inside pairs.

    The first of the inputs is the campaign; the others are named relative to its folder.
    ``posterior`` is the Gaussian of logit absorption in each band, where the answer has it.
    `roomfit.base.whole_files.json_text` turns it into text.
    """
    content: dict[str, Any] = {
        "format": "roomfit-result",
        "format_version": 1,
        "bands_hz": answer.bands.centres_hz,
        "materials": {name: _material(answer, i) for i, name in enumerate(answer.materials)},
        **({"objects": _objects(answer.objects)} if answer.objects is not None else {}),
        "combinations": _combinations(answer),
        "pairs": [_pair(p, answer.bands) for p in answer.pairs],
        "findings": [finding_content(f) for f in answer.findings],
        "fit": _fit(answer),
        **({"plan": answer.plan} if answer.plan else {}),
        "settings": answer.settings.changed(),
        **({"trace": answer.trace} if answer.trace else {}),
        "provenance": provenance(inputs)
        | {
            "speed_of_sound_m_s": answer.speed_of_sound_m_s,
            "speed_of_sound_formula": "Cramer 1993 as in pyfar, or as given by the campaign",
        },
    }
    from roomfit.checks.verdict import what_remains

    remains = what_remains(answer)
    if remains.voids:
        content["usable"] = usable
        content["remains"] = {
            "void": [code.value for code in remains.codes],
            "mean_usable": [bool(b) for b in remains.mean_usable],
            "decay_error": numbers_or_null(remains.decay_error),
            "decay_parameter": remains.decay_name or None,
            "void_but_identifiable_by_rule": remains.taken,
        }
    if answer.state_means:
        content["states"] = {
            name: dict(zip(("mean_absorption", "lower95", "upper95"), mean, strict=True))
            for name, mean in answer.state_means.items()
        }
    content |= _sd_without(answer)
    if answer.directivities:
        content["directivity"] = {
            name: {"b": d.b, "sd": d.sd}
            | ({} if p.aim is None else {"aim": p.aim, "loudspeaker": p.loudspeaker})
            for d in answer.directivities
            for name, p in d.patterns().items()
        }
    if answer.geometry is not None:
        content["geometry"] = _geometry(answer.geometry)
    if answer.logit_covariance is not None:
        content["posterior"] = _posterior(answer)
    return content


def _sd_without(answer: Result) -> dict[str, Any]:
    """Return how well materials and the mean of the room were known without each term."""
    content: dict[str, Any] = {}
    if any(answer.costs):
        content["sd_without"] = [
            {name or "nothing": numbers_or_null(np.round(sd, 4)) for name, sd in band.items()}
            for band in answer.costs
        ]
    if any(answer.mean_costs):
        content["mean_sd_without"] = [
            {name or "nothing": number_or_null(round(sd, 6)) for name, sd in band.items()}
            for band in answer.mean_costs
        ]
    return content


def _fit(answer: Result) -> dict[str, Any]:
    """How the answer was found, how well it fits, and how its intervals were made."""
    added = answer.by_pressures
    return {
        "method": answer.method,
        "model": answer.model,
        "cost": answer.cost,
        "models": answer.models,
        "phi": answer.chi2_reduced,
        **({"by_pressures": added} if added is not None and added.any() else {}),
        "evaluations": answer.evaluations,
        "converged": answer.converged,
        "seconds": round(answer.seconds, 3),
        "seed": answer.seed,
        "intervals": answer.interval_kind,
        "method_chosen": answer.method,
        "reasons": answer.reasons,
    }


def _posterior(answer: Result) -> dict[str, Any]:
    """The Gaussian of logit absorption in each band, its prior, and draws of it."""
    own = absorption_posterior(answer)  # objects among the materials
    content: dict[str, Any] = {
        "materials": own.materials,
        "logit_mean": logit(own.absorption).T,
        "logit_covariance": own.logit_covariance,
    }
    if own.prior_logit_mean is not None and own.prior_logit_sd is not None:
        content |= {"prior_logit_mean": own.prior_logit_mean.T}
        content |= {"prior_logit_sd": own.prior_logit_sd.T}
    if own.prior_logit_covariance is not None:
        content["prior_logit_covariance"] = own.prior_logit_covariance
    if own.draws is not None:
        # a share that objects absorb in a step is a hundred times smaller than that of a wall
        content["draws"] = np.round(own.draws, 7 if own.objects else 5)
    if own.prior_specified is not None:
        content["prior_specified"] = [bool(b) for b in own.prior_specified]
    return content


def _objects(found: ObjectAreas) -> dict[str, Any]:
    """Return the equivalent absorption area of each object in m2, with its interval."""
    volumes_m3 = found.posterior.objects
    return {
        name: {
            "absorption_area_m2": found.area_m2[i],
            "lower95_m2": found.lower95_m2[i],
            "upper95_m2": found.upper95_m2[i],
            "identifiable": found.identifiable[i],
            "room_volume_m3": round(volumes_m3[name], 4),
        }
        for i, name in enumerate(found.names)
    }


def _material(answer: Result, i: int) -> dict[str, Any]:
    """Absorption of a material, its share (air left out), its prior, and kinds of intervals."""
    content: dict[str, Any] = {
        "absorption": answer.absorption[i],
        "lower95": answer.lower95[i],
        "upper95": answer.upper95[i],
        "identifiable": answer.identifiable[i],
        "area_m2": round(float(answer.areas_m2[i]), 4),
    }
    if answer.scattering is not None:
        content["scattering"] = answer.scattering[i]
    if answer.shares is not None:
        names = ("share", "share_lower95", "share_upper95")
        content |= zip(names, answer.shares[:, i], strict=True)
    if answer.prior is not None:
        names = ("absorption", "lower95", "upper95")
        content["prior"] = dict(zip(names, answer.prior[:, i], strict=True))
    if answer.interval_kinds and all(answer.interval_kinds):
        content["interval"] = [kinds[i] for kinds in answer.interval_kinds]
    return content


def _combinations(answer: Result) -> list[dict[str, Any]]:
    """Means over groups of materials that the data determine, the whole room's first."""

    def entry(kind: str, c: Combination | Difference) -> dict[str, Any]:
        named = zip(answer.materials, c.weights, strict=True)
        return {
            "kind": kind,
            "weights": {name: round(float(w), 6) for name, w in named if w != 0.0},
            "absorption": c.value,
            "lower95": c.lower95,
            "upper95": c.upper95,
            "determined": c.determined,
        }

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


def _geometry(geometry: FittedGeometry) -> dict[str, Any]:
    """Shifts of positions that arrival times need: no measurement of positions."""
    return {
        "note": "fitted to arrival times; these absorb errors of the model, too",
        "speed_of_sound_m_s": geometry.speed_of_sound_m_s,
        "labels": geometry.labels,
        "change": geometry.change,
        "sd": geometry.sd,
        "told_sd": geometry.prior_sd,
    }


def _pair(pair: ComparedPair, bands: Bands) -> dict[str, Any]:
    sti = np.full(2, np.nan)
    if pair.decay is not None:
        from roomfit.signals.speech import sti_of_decay

        curves = (pair.decay.measured_db, pair.decay.predicted_db)
        sti = np.array([sti_of_decay(bands, pair.decay.time_s, levels) for levels in curves])
    known = {"sti": dict(zip(("measured", "predicted"), numbers_or_null(sti), strict=True))}
    return {
        "source": pair.source,
        "receiver": pair.receiver,
        "use": pair.use,
        **({"state": pair.state} if pair.state else {}),
        "parameters": {
            name: {
                "measured": numbers_or_null(c.measured),
                "predicted": numbers_or_null(c.predicted),
                "jnd": numbers_or_null(c.jnd),
                "mean_of_others": numbers_or_null(c.null),
            }
            for name, c in pair.parameters.items()
        },
        **(known if np.isfinite(sti).any() else {}),
    }
