"""``roomfit check``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def check(
    room: Annotated[Path, typer.Argument(help="Room file: .obj, .ac, .ply, .stl or .glb.")],
    unit: Annotated[
        str | None, typer.Option(help="m, mm, cm, ft or in; needed where the format has none.")
    ] = None,
    up: Annotated[str | None, typer.Option(help="Axis that points up: z or y.")] = None,
) -> None:
    """Tell a room's volume, surface, materials and mean free path, and name each fault."""
    from roomfit.app.check import check_room
    from roomfit.files.rooms.spec import RoomSpec
    from roomfit.report.room_text import room_text

    result = check_room(RoomSpec(file=room, unit=unit, up=up))
    typer.echo(room_text(str(room), result))
    if not result.traceable:
        raise typer.Exit(2)
