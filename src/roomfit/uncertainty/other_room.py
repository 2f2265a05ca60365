"""What a result says of another room: materials matched by name, bands by frequency."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roomfit.base.bands import Bands
from roomfit.base.errors import InputError
from roomfit.base.findings import About, Code, Finding
from roomfit.base.typing import FloatArray
from roomfit.materials.priors import (
    MaterialPrior,
    object_absorption,
    object_area_m2,
    object_volumes_m3,
)
from roomfit.model.patterns import (
    Directivities,
    Directivity,
    Pattern,
    UnknownDirectivity,
)
from roomfit.uncertainty.posterior import AbsorptionPosterior


def common_bands(wanted: Bands, known: Bands) -> tuple[Bands, tuple[Finding, ...]]:
    """Return those of the wanted bands in which the absorption is known."""
    common = [f for f in wanted.centres_hz if f in known.centres_hz and wanted.kind == known.kind]
    if not common:
        raise InputError(
            "the absorption is known in other bands than the campaign asks for",
            found=", ".join(f"{f:g}" for f in known.centres_hz),
            needed=", ".join(f"{f:g}" for f in wanted.centres_hz) + f" Hz ({wanted.kind})",
            hint="change bands, from_hz and to_hz of the campaign",
        )
    left_out = [float(f) for f in wanted.centres_hz if f not in common]
    if not left_out:
        return wanted, ()
    return Bands(wanted.kind, np.array(common)), (
        Finding(
            Code.BAND_NOT_PREDICTED,
            About(bands_hz=left_out),
            f"The absorption is not known at {', '.join(f'{f:g}' for f in left_out)} Hz: nothing "
            "is predicted there.",
            {"bands_hz": left_out},
        ),
    )


def room_posterior(
    absorption: AbsorptionPosterior,
    priors: Sequence[MaterialPrior],
    bands: Bands,
    directivities: Directivities | None = None,
    *,
    replaced: Sequence[str] = (),
) -> AbsorptionPosterior:
    """Return what is known of a room's own materials and sources, from a result of any room.

    Materials are matched by name. One that the result does not name has its fixed absorption. What
    a fit found or assumed of scattering belongs to the absorption it found, and stands wherever
    the room's own is unspecified or to be fitted; so does the directivity of sources. A source
    whose directivity is unknown and was not found has the mean of its prior, or is
    omnidirectional, with a finding.
    """
    names, volumes_m3 = tuple(k.name for k in priors), object_volumes_m3(priors)
    absorption = _known_here(absorption, priors, replaced)
    theirs = [i for i, n in enumerate(absorption.materials) if n in names]
    own = [names.index(absorption.materials[i]) for i in theirs]
    at = [int(np.flatnonzero(absorption.bands.centres_hz == f)[0]) for f in bands.centres_hz]
    shape = (len(names), len(bands))
    fixed, lowest, highest = _stated(priors, len(bands))

    def matched(values: FloatArray | None, otherwise: FloatArray) -> FloatArray:
        found = otherwise.copy()
        if values is not None:
            found[own] = values[np.ix_(theirs, at)]
        return found

    def matched_covariance(values: FloatArray, otherwise: FloatArray) -> FloatArray:
        found = np.tile(otherwise, (len(bands), 1, 1))
        for j, band in enumerate(at):
            found[j][np.ix_(own, own)] = values[band][np.ix_(theirs, theirs)]
        return found

    def in_bands(values: NDArray[Any] | None) -> NDArray[Any] | None:
        return None if values is None else values[..., at]

    n, mean, sd = len(names), absorption.prior_logit_mean, absorption.prior_logit_sd
    has_prior = mean is not None and sd is not None
    before, draws = absorption.prior_logit_covariance, absorption.draws
    specified = np.ones(n, dtype=np.bool_)
    if (flags := absorption.prior_specified) is not None:
        specified[own] = flags[theirs]
    scattering = _scattering(priors, matched(absorption.scattering, np.full(shape, np.nan)))
    sources, findings = _sources_as_found(absorption, directivities or {}, at)
    return AbsorptionPosterior(
        names,
        bands,
        matched(absorption.absorption, fixed),
        matched(absorption.lower95, lowest),
        matched(absorption.upper95, highest),
        matched_covariance(absorption.logit_covariance, np.zeros((n, n))),
        matched(mean, np.zeros(shape)) if has_prior else None,
        matched(sd, np.ones(shape)) if has_prior else None,
        None if before is None else matched_covariance(before, np.eye(n)),
        scattering=scattering,
        directivities=sources,
        prior_specified=None if flags is None else specified,
        chi2_reduced=in_bands(absorption.chi2_reduced),
        by_pressures=in_bands(absorption.by_pressures),
        draws=None if draws is None else np.stack([matched(drawn, fixed) for drawn in draws]),
        fitted=tuple(
            p._replace(measured=p.measured[:, at], predicted=p.predicted[:, at])
            for p in absorption.fitted
        ),
        is_other_room=absorption.is_other_room,
        findings=findings,
        result_findings=absorption.result_findings,
        objects=volumes_m3,
    )


def _stated(priors: Sequence[MaterialPrior], n_bands: int) -> FloatArray:
    """Return fixed absorptions with their bounds, (3, n_materials, n_bands).

    What is only known after a change has no variance, and an interval of 0 to 1.
    """
    found = np.tile(np.array([0.5, 0.0, 1.0])[:, None, None], (1, len(priors), n_bands))
    for i, k in enumerate(priors):
        if k.known is not None:
            found[:, i] = k.known
    return found


def _scattering(priors: Sequence[MaterialPrior], found: FloatArray) -> FloatArray:
    """Return what was found, or what is specified where nothing was or it is not to be fitted."""
    for i, k in enumerate(priors):
        if k.scattering is not None and (not k.fit_scattering or np.isnan(found[i]).any()):
            found[i] = k.scattering
    return found


def _in_volume(known: AbsorptionPosterior, name: str, own_m3: float) -> AbsorptionPosterior:
    """Return the same area of an object as its absorption in a room of another volume.

    Logarithms of areas and of small absorptions differ by a constant: covariances stay.
    """
    before_m3 = known.objects.get(name)
    if name in known.materials and before_m3 is None:
        what = "an object has the name of a wall in the result"
        needed = "an object of the result, or absorption_area_m2 in the campaign"
        raise InputError(what, found=repr(name), needed=needed, hint="rename the object")
    if before_m3 is None or before_m3 == own_m3:
        return known
    at, mean, volumes_m3 = known.materials.index(name), known.prior_logit_mean, (before_m3, own_m3)

    def moved(values: FloatArray) -> FloatArray:
        out = np.array(values)
        area_m2 = object_area_m2(out[..., at, :], volumes_m3[0])
        out[..., at, :] = object_absorption(area_m2, volumes_m3[1])
        return out

    if mean is not None:
        mean = np.array(mean)
        mean[at] += np.log(before_m3 / own_m3)
    return replace(
        known,
        absorption=moved(known.absorption),
        lower95=moved(known.lower95),
        upper95=moved(known.upper95),
        draws=None if known.draws is None else moved(known.draws),
        prior_logit_mean=mean,
    )


def _known_here(
    absorption: AbsorptionPosterior, priors: Sequence[MaterialPrior], replaced: Sequence[str]
) -> AbsorptionPosterior:
    """Refuse materials of which nothing is known; areas of objects in the room's volume."""
    known = {*absorption.materials, *replaced}
    missing = [k.name for k in priors if k.name not in known and k.known is None]
    if missing:
        raise InputError(
            "the absorption of some of the room's materials is not known",
            found=f"no {', '.join(missing)} among {', '.join(absorption.materials)}",
            needed="the same names in both, or absorption = [...] in the campaign",
            hint=f"add absorption to [materials.{missing[0]}], or --set {missing[0]}=...",
        )
    for name, volume_m3 in object_volumes_m3(priors).items():
        absorption = _in_volume(absorption, name, volume_m3)
    return absorption


def _sources_as_found(
    absorption: AbsorptionPosterior, directivities: Directivities, at: Sequence[int]
) -> tuple[Mapping[str, Directivity], tuple[Finding, ...]]:
    """Return known directivities, and unknown ones as the fit of the absorption found them.

    A source that belongs to a loudspeaker radiates as any other of that loudspeaker was found to,
    about its own aim, wherever it stands and whatever its name.
    """
    found = absorption.directivities or {}
    makes = {p.loudspeaker: p for p in found.values() if isinstance(p, Pattern) and p.loudspeaker}
    known: dict[str, Directivity] = {}
    unfitted = []
    for name, directivity in directivities.items():
        if not isinstance(directivity, UnknownDirectivity):
            known[name] = directivity
            continue
        fitted = found.get(name)
        aim = fitted.aim if isinstance(fitted, Pattern) else None
        if directivity.loudspeaker is not None:
            fitted, aim = makes.get(directivity.loudspeaker), directivity.aim
        if isinstance(fitted, Pattern) and fitted.b.ndim == 2:
            known[name] = Pattern(fitted.b[at], aim, fitted.loudspeaker)
        elif fitted is not None:
            known[name] = fitted
        elif directivity.mean is not None:
            known[name] = Pattern(np.tile(directivity.mean, (len(at), 1)), directivity.aim)
        else:
            unfitted.append(name)
    if not unfitted:
        return known, ()
    return known, (
        Finding(
            Code.DIRECTIVITY_NOT_KNOWN,
            About(),
            f"The directivity of {', '.join(unfitted)} was to be fitted, and the absorption comes "
            "without it: predicted as omnidirectional.",
            {"sources": unfitted},
        ),
    )
