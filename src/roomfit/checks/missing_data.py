"""Which recordings and bands had no data to be fitted."""

from __future__ import annotations

from collections.abc import Iterator

from roomfit.base.findings import About, Code, Finding
from roomfit.checks.evidence import Evidence, Law, file_name, pair_of
from roomfit.model.observation import has_data_in_band

_CLEAR = "a decay rises above the noise"
LAWS = {
    Code.RECORDING_BELOW_NOISE: Law(_CLEAR, "the fitted model of decay and noise of a band"),
    Code.BAND_NOT_FITTED: Law(_CLEAR, "windows above the noise against unknowns"),
}


def check_recordings(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding for each recording that is left out of some bands."""
    bands = evidence.measured.bands
    for m in evidence.measured.responses:
        has_data = [has_data_in_band(m, band) for band in range(len(bands))]
        if m.measurement.use != "fit" or all(has_data):
            continue
        missing = [float(f) for f, t in zip(bands.centres_hz, has_data, strict=True) if not t]
        own = m.measurement
        yield Finding(
            Code.RECORDING_BELOW_NOISE,
            About(bands_hz=missing, files=[own.where], pairs=[pair_of(own)]),
            f"{file_name(own)}: no decay rises above the noise at "
            f"{', '.join(f'{f:g}' for f in missing)} Hz; it was not fitted there.",
            {"bands_hz": missing},
        )


def check_bands(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding for the bands in which nothing could be fitted."""
    answers = zip(evidence.measured.bands.centres_hz, evidence.fits.answers, strict=True)
    empty = [float(f) for f, answer in answers if answer.model == "prior"]
    if empty:
        yield Finding(
            Code.BAND_NOT_FITTED,
            About(bands_hz=empty),
            f"Too little decay rises above the noise at {', '.join(f'{f:g}' for f in empty)} Hz: "
            "absorption there is its prior, with the interval 0 to 1 where none was stated.",
            {"bands_hz": empty},
        )
