"""Whether the room and its sources are as described, and sound reaches and suits what is fitted."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from roomfit.base.bands import bands_in_words
from roomfit.base.findings import About, Code, Edit, Finding, Remedy
from roomfit.checks.evidence import Evidence, Recorded
from roomfit.fit.measurements import median_decay_s
from roomfit.fit.scattering import GRID, TRIAL
from roomfit.fit.trace_plan import scattering_assumed, scattering_remedies
from roomfit.model.eyring import schroeder_hz
from roomfit.room.mesh import volume_m3
from roomfit.room.scene import pair_names

# A coefficient must gain more than this in log-likelihood, and lose less in every band: of nine
# boxes that scatter by .08 or .15 one lost 3.7 in a band; a smooth one lost 5, and gained 22.
_LEAST_GAIN, _LARGEST_LOSS = 5.0, 4.0


def check_reached(evidence: Evidence) -> Iterator[Finding]:
    """Yield what tracing raised, and the materials to be fitted which no path strikes."""
    yield from evidence.traced.findings
    paths = evidence.traced.paths
    met = np.asarray(paths.hits_specular.any(axis=0) | paths.hits_diffuse.any(axis=0))
    walls = [k.name for k in evidence.priors if k.object_volume_m3 is None and k.known is None]
    names = [name for name in walls if not met[paths.materials.index(name)]]
    if names:
        yield Finding(
            Code.MATERIAL_NOT_REACHED,
            About(materials=names),
            f"No path between the measured pairs strikes {', '.join(names)}: its absorption "
            "cannot be determined, and its prior is all that is reported.",
            {"materials": names},
        )


def check_chosen_scattering(evidence: Evidence) -> Iterator[Finding]:
    """Yield which scattering was assumed, and which was fitted."""
    for chosen in evidence.traced.chosen_scattering:
        names = list(chosen.materials)
        if chosen.is_fitted:
            each = zip(*chosen[:4], strict=True)
            ranges = ", ".join(f"{n} {s:g} ({low:g} to {high:g})" for n, s, low, high in each)
            text = f"Most likely scattering coefficients, of {len(GRID)} values each: {ranges}."
            about = About(materials=names)
            yield Finding(Code.SCATTERING_FITTED, about, text, {"materials": names})
            continue
        value, low, high, reason = chosen.value[0], chosen.lower[0], chosen.upper[0], ""
        if chosen.has_data:
            others = f"{low:g} to {high:g} do as well" if low < high else "others do worse"
            reason = f", which explains the responses well ({others})"
        yield scattering_assumed(names, value, reason)


def check_scattering(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding where walls taken for smooth explain the data better if they scatter.

    Where no band loses 4, which indicates something else: a loudspeaker that rings, or sound that
    runs along hard walls. Under a right model a likelihood ratio exceeds e^5 in fewer than one room
    in a hundred (A. Wald, Sequential Analysis, 1947, section 3.2). It says nothing of sources whose
    directivity was fitted, or that the data contradict.
    """
    trial, fits = evidence.traced.scattering_trial, evidence.fits
    if trial is None or fits.unknown_sources is not None or fits.contradicted:
        return
    names, gains = list(trial[0]), trial[1]
    gain = float(np.sum(gains))
    if gain > _LEAST_GAIN and np.all(gains > -_LARGEST_LOSS):
        yield Finding(
            Code.SCATTERING_UNDERESTIMATED,
            About(materials=names),
            f"The data are explained better if {', '.join(names)} scatter: a coefficient of "
            f"{TRIAL:g} raises the log likelihood by {gain:.0f}. Absorption "
            "compensates for scattering that is specified as 0, so that no material is called "
            "identifiable. Specify the scattering of these materials, or have it fitted: "
            'scattering = "fit".',
            {"materials": names, "scattering": TRIAL, "gain": gain},
            remedies=scattering_remedies(names, TRIAL),
        )


def check_sources(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding for each source taken for omnidirectional that the data contradict."""
    unknown = evidence.fits.unknown_sources
    fitted = () if unknown is None else unknown.prior.sources
    for own in evidence.fits.contradicted:
        strongest = own.b[int(np.argmax(np.linalg.norm(own.b, axis=1)))]
        towards = ", ".join(f"{x:.1f}" for x in strongest / np.linalg.norm(strongest))
        pairs = [(p, r) for p, r, _ in pair_names(evidence.measured.scene) if p == own.source]
        consequence = (
            "Absorption compensates for it, so that no material is called identifiable. "
            'Specify the directivity, or have it fitted: directivity = "fit".'
        )
        if own.source in fitted:
            consequence = (
                'It was fitted together with the absorption, as by directivity = "fit"; specify '
                "it where it is known."
            )
        gain = own.log_likelihood_gain
        edit = Edit(("sources", own.source), "directivity", "fit", now=["omni"])
        yield Finding(
            Code.SOURCE_PATTERN_FITTED if own.source in fitted else Code.SOURCE_NOT_OMNIDIRECTIONAL,
            About(pairs=tuple(dict.fromkeys(pairs))),
            f"{own.source} was taken for omnidirectional, which the data contradict: a "
            f"first-order directivity that radiates more towards ({towards}) raises the "
            f"log-likelihood by {gain:.0f}. {consequence}",
            {"source": own.source, "log_likelihood_gain": gain, "b": own.b.tolist()},
            remedies=[] if own.source in fitted else [Remedy([edit])],
        )


def check_schroeder(evidence: Recorded) -> Iterator[Finding]:
    """Yield a finding for the bands that begin below the Schroeder frequency.

    In simulated boxes the 95 % intervals of such bands covered the true value less often.
    """
    bands = evidence.measured.bands
    decay_s = median_decay_s(evidence.measured, bands.centres_hz)
    limit_hz = schroeder_hz(decay_s, volume_m3(evidence.measured.scene.room.mesh))
    low = np.flatnonzero(bands.lower_hz < limit_hz)
    if low.size:
        limits = [f"{limit_hz[j]:.0f} Hz" for j in low]
        bands_hz = bands.centres_hz[low].tolist()
        yield Finding(
            Code.BELOW_SCHROEDER_FREQUENCY,
            About(bands_hz=bands_hz),
            "Part of the band lies below the Schroeder frequency at "
            f"{bands_in_words(bands, low, limits)}: single modes are resolved there, which the "
            "model does not contain. Trust these intervals less.",
            {"bands_hz": bands_hz},
        )
