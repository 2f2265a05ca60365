"""Measure here: sweeps played and recorded by the browser, and what the response is good for."""

from __future__ import annotations

from html import escape
from typing import Any, ClassVar

from nicegui import ui

from roomfit.app import project
from roomfit.app.elements import Recorder, emptied, findings, heading, markup, table_html
from roomfit.app.jobs import Bench
from roomfit.report.wording import hertz

_LENGTHS = {
    "seconds": ("Sweep (s)", 6),
    "silence_s": ("Silence (s)", 3),
    "repetitions": ("Repetitions", 3),
}


class MeasureTab:
    """Two names, how long, a recorder, and what the last response is good for."""

    name: ClassVar[str] = "Measure"
    files: ClassVar[tuple[str, ...]] = (project.RECORDINGS,)

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.asked: dict[str, Any] = {"source": "S1", "receiver": "R1", "again": False}
        self.asked |= {key: start for key, (_, start) in _LENGTHS.items()}
        with ui.element("div").classes("panel"):
            heading("Measure an impulse response")
            ui.label(
                "Stand away, keep still, and set the loudspeaker as loud as it plays cleanly. The "
                "response is written as recordings/SOURCE_RECEIVER.wav."
            ).classes("soft")
            with ui.element("div").classes("bar").style("margin: 0.5rem 0"):
                for key, label in (("source", "Source"), ("receiver", "Receiver")):
                    field = ui.input(label, value=self.asked[key])
                    field.bind_value_to(self.asked, key).props("outlined dense")
                    field.style("width: 7rem").on_value_change(self.ask)
                for key, (label, start) in _LENGTHS.items():
                    number = ui.number(label, value=start, min=0).props("outlined dense")
                    number.bind_value_to(self.asked, key).style("width: 6.5rem")
                    number.on_value_change(self.ask)
                again = ui.checkbox("Measure again: replace this pair's response")
                again.bind_value_to(self.asked, "again").on_value_change(self.ask)
            self.recorder = Recorder(self.show)
        self.quality = ui.element("div").style("margin: 0.75rem 0").props('role="status"')
        self.measured = ui.label().classes("soft")
        self.ask()

    def ask(self, _: object = None) -> None:
        """Hand on what is typed."""
        self.recorder.ask(self.asked)

    async def show(self, quality: dict[str, Any]) -> None:
        """Show how good the response is that was measured just now."""
        if not emptied(self.quality, quality):
            return
        with self.quality, ui.element("div").classes("panel"):
            heading(f"{quality['source']} to {quality['receiver']}")
            doubts = [f"Measure again: {reason}." for reason in quality["again"]]
            doubts += [quality["not_named"]] if "not_named" in quality else []
            findings({"severity": "warning", "sentence": sentence} for sentence in doubts)
            if not quality["again"]:
                ui.label("It suffices from 125 Hz to 4 kHz.")
            markup(quality_html(quality))

    async def refresh(self) -> None:
        """Show which responses there are."""
        folder = self.bench.folder / project.RECORDINGS
        names = sorted(p.name for p in folder.glob("[!.]*")) if folder.is_dir() else []
        self.measured.set_text(f"In recordings: {', '.join(names) or 'none yet'}")


def quality_html(quality: dict[str, Any]) -> str:
    """Return range of the decay by octave, and levels, as a table."""
    peak_db, noise_db = float(quality["peak_dbfs"]), float(quality["noise_dbfs"])
    clipped = f"{int(quality['n_clipped'])} samples clipped"
    caption = f"Peak {peak_db:.1f} dBFS, {clipped}, background {noise_db:.1f} dBFS"
    rows = [
        [hertz(f), f"{range_db:.0f} dB", escape(good or "too short")]
        for f, range_db, good in zip(
            quality["bands_hz"], quality["range_db"], quality["suffices_for"], strict=True
        )
    ]
    return table_html(caption, ("Octave", "Range of the decay", "Suffices for"), rows)
