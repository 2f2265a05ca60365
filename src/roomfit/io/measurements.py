"""What a campaign file names as measured: responses and tables of ISO 3382 values, read."""

from __future__ import annotations

from dataclasses import replace

from roomfit.errors import InputError
from roomfit.io.campaign import Campaign, MeasuredFile
from roomfit.io.iso3382 import read_parameters
from roomfit.io.responses import read_response
from roomfit.measurement import Measurement
from roomfit.signals.iso3382 import MeasuredValues


def read_measurements(campaign: Campaign) -> tuple[Measurement | MeasuredValues, ...]:
    """Return everything that a campaign file names as measured, responses first.

    Raises
    ------
    InputError
        A file is missing, broken or empty; a table names a source or a receiver that the campaign
        does not define; or the campaign names spectra, which hold no absorption in bands.
    StoreError
        The disk refuses.
    """
    if campaign.spectra:
        raise InputError(
            "damped spectra hold impedances, not absorption in bands",
            where=str(campaign.path),
            found=str(campaign.spectra[0].path.name),
            needed="impulse responses (file) or room parameters",
            hint="roomfit impedance reads this campaign",
        )
    return (*map(read_file, campaign.measurements), *_read_tables(campaign))


def read_file(file: MeasuredFile) -> Measurement:
    """Return an impulse response of a campaign as a measurement, and what reading it raised."""
    spec = file.response
    response, findings = read_response(spec)
    chosen = (spec.channel, spec.variable, spec.measurement, spec.receiver_index)
    part = ", ".join(str(c) for c in chosen if c is not None)
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
        where=f"{spec.path}[{part}]" if part else str(spec.path),
        findings=findings,
    )


def _read_tables(campaign: Campaign) -> list[MeasuredValues]:
    found: list[MeasuredValues] = []
    for table in campaign.tables:
        values, findings = read_parameters(table.path, table.source, table.receiver)
        for i, own in enumerate(values):
            _check_names(campaign, own, str(table.path))
            found.append(replace(own, use=table.use, findings=findings if i == 0 else ()))
    return found


def _check_names(campaign: Campaign, found: MeasuredValues, where: str) -> None:
    for kind, name, known in (
        ("source", found.source, [s.name for s in campaign.sources]),
        ("receiver", found.receiver, [r.name for r in campaign.receivers]),
    ):
        if name not in known:
            raise InputError(
                f"a table of room parameters names a {kind} that the campaign does not define",
                where=where,
                found=repr(name),
                needed=f"one of {', '.join(known)}",
                hint=f"add [{kind}s.{name}], or choose rows with source and receiver",
            )
