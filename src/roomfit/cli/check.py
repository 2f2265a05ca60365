"""``roomfit check``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def check(
    room: Annotated[
        Path,
        typer.Argument(help="Room (.obj, .ac, .ply, .stl, .glb), or a campaign file (.toml)."),
    ],
    unit: Annotated[
        str | None, typer.Option(help="m, mm, cm, ft or in; needed where the format has none.")
    ] = None,
    up: Annotated[str | None, typer.Option(help="Axis that points up: z or y.")] = None,
) -> None:
    """Tell a room's volume, surface, materials and mean free path, and name each fault.

    Of a campaign, the places of its sources and receivers are examined, too.
    """
    from roomfit.commands import check_campaign, check_room
    from roomfit.errors import InputError
    from roomfit.io.campaign import read_campaign
    from roomfit.io.rooms.model import RoomSpec
    from roomfit.report.text import room_text

    if room.suffix.lower() == ".toml":
        if unit is not None or up is not None:
            raise InputError(
                "a campaign says itself which unit and axis its room has",
                where=str(room),
                found="--unit or --up",
                hint="write them under [room]",
            )
        result = check_campaign(read_campaign(room))
    else:
        result = check_room(RoomSpec(file=room, unit=unit, up=up))
    typer.echo(room_text(str(room), result))
    if not result.traceable:
        raise typer.Exit(2)
