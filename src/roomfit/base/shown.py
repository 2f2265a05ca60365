"""How answers look: an answer names what describes it, and `roomfit.report` is loaded then."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Shown:
    """An answer that is printed, shown in a notebook, and drawn."""

    __slots__ = ()
    described_in: ClassVar[str]  # module of `roomfit.report` with `describe`, and `draw` for `plot`

    def _called(self, module: str, function: str, *arguments: Any) -> Any:
        return getattr(import_module(f"roomfit.report.{module}"), function)(*arguments)

    def __str__(self) -> str:
        """Return what the command line prints."""
        return str(self._called("text", "text", self._called(self.described_in, "describe", self)))

    def _repr_html_(self) -> str:
        """Return the same for a notebook, as a piece of HTML."""
        return str(
            self._called("html", "fragment", self._called(self.described_in, "describe", self))
        )

    def plot(self, *chosen: int) -> Figure:
        """Return a figure of what an answer is about, for a prediction that of the chosen pair."""
        figure: Figure = self._called(self.described_in, "draw", self, *chosen)
        return figure
