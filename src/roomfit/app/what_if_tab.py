"""What if: other materials, and what they would do to every pair."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from nicegui import ui

from roomfit.app.server import Bench


def build(bench: Bench) -> Callable[[], Awaitable[None]]:
    """Draw the tab; return what draws it anew."""

    async def refresh() -> None:
        return

    return refresh
