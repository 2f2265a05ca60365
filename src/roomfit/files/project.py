"""``[project]`` of a campaign: what the report says of itself."""

from __future__ import annotations

from base64 import b64encode
from pathlib import Path

from roomfit.base.door import read_bytes
from roomfit.base.errors import InputError
from roomfit.files.schema import ProjectTable

_LOGOS = {"png": b"\x89PNG\r\n\x1a\n", "jpeg": b"\xff\xd8\xff"}


def project_details(own: ProjectTable, folder: Path) -> dict[str, str]:
    """Return what a project says, as `roomfit.report_html` takes it, the logo as a data URL.

    Parameters
    ----------
    own : ProjectTable
    folder : Path
        That of the campaign, where the logo is looked for.

    Raises
    ------
    InputError
        The logo is missing, too large, or neither PNG nor JPEG.
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
