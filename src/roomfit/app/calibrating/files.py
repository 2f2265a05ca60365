"""What `roomfit calibrate` leaves beside its replicates: JSON, table, picture."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from roomfit.app.calibrating.calibrate import CalibrationResult, calibrate
from roomfit.app.calibrating.settings import CalibrationSettings
from roomfit.files.campaign.campaign import read_campaign
from roomfit.files.store import (
    write_bytes_atomically,
    write_json_atomically,
    write_text_atomically,
)
from roomfit.report.calibration_text import calibration_csv, calibration_text
from roomfit.typing import Progress
from roomfit.uncertainty.calibration import CalibrationRow, Share, calibration_rows


def calibrate_to_folder(
    campaign_file: Path,
    out: Path,
    settings: CalibrationSettings | None = None,
    *,
    progress: Progress | None = None,
) -> CalibrationResult:
    """Calibrate a campaign and write calibration.json, calibration.csv and calibration.png.

    They tell of all replicates in the folder, whichever run has made them.

    Raises
    ------
    InputError, CannotTell, StoreError
        See `calibrate`.
    """
    from roomfit.report.calibration_picture import calibration_figure
    from roomfit.report.pictures import png

    result = calibrate(read_campaign(campaign_file), out, settings, progress=progress)
    write_text_atomically(out / "calibration.csv", calibration_csv(calibration_rows(result.found)))
    write_bytes_atomically(out / "calibration.png", png(calibration_figure(result.found)))
    write_json_atomically(out / "calibration.json", calibration_json(result))
    return result


def result_text(result: CalibrationResult) -> str:
    """Return everything a user must see."""
    return calibration_text(
        calibration_rows(result.found),
        result.done,
        result.asked,
        result.roads,
        result.findings,
        result.refused,
    )


def calibration_json(result: CalibrationResult) -> dict[str, Any]:
    """Return the content of calibration.json."""
    *bands, together = calibration_rows(result.found)
    return {
        "format": "roomfit-calibration",
        "format_version": 1,
        "replicates": {
            "asked": result.asked,
            "done": result.done,
            "refused": list(result.refused),
        },
        "drawn_from": result.drawn_from,
        "made_by": result.roads,
        "materials": list(result.found.materials),
        "bands": [_row(row) for row in bands],
        "all": _row(together),
        "findings": result.findings,
    }


def _row(row: CalibrationRow) -> dict[str, Any]:
    told = {} if row.band_hz is None else {"band_hz": row.band_hz}
    return {
        **told,
        "hold": _share(row.holds),
        "identifiable": _share(row.identifiable),
        "identifiable_wrong": _share(row.wrong),
        "median_width": _number(row.width),
        "median_error": _number(row.error),
        "median_error_prior": _number(row.error_prior),
        "median_error_uniform": _number(row.error_uniform),
    }


def _share(share: Share) -> dict[str, Any]:
    return {
        "count": share.count,
        "of": share.of,
        "share": _number(share.value),
        "lower95": share.low,
        "upper95": share.high,
    }


def _number(value: float) -> float | None:
    return None if math.isnan(value) else value
