"""What findings advise: a button for each, what it would write, and a step back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from html import escape
from pathlib import Path
from typing import Any

from nicegui import ui

from roomfit.app import project
from roomfit.app.elements import (
    emptied,
    finding_html,
    heading,
    markup,
    quiet_button,
    saying_errors,
)
from roomfit.files import edits


class Advice:
    """The remedies of the findings of a tab; nothing is written before it was shown."""

    def __init__(self, folder: Path) -> None:
        self.file = project.campaign_file(folder)
        self.place = ui.element("section").props('aria-label="Remedies"').style("width: 100%")
        self.dialog = ui.dialog().props('aria-label="What is written"')

    def show(self, advised: Sequence[Mapping[str, Any]]) -> None:
        """Draw a button for each code of a finding, with a choice where there is one."""
        can_undo = edits.can_undo(self.file)
        if not emptied(self.place, (advised, can_undo)) or not (advised or can_undo):
            return
        with self.place, ui.element("div").classes("panel remedies"):
            heading("What the findings advise")
            for entry in advised:
                self.show_entry(entry)
            if can_undo:
                with ui.element("div").classes("bar"):
                    quiet_button("Undo the last remedy", self.undo)

    def show_entry(self, entry: Mapping[str, Any]) -> None:
        """Draw what the findings of one code advise."""
        name = str(entry["code"]).replace("-", " ")
        text = f"{name[:1].upper()}{name[1:]}" + (f", {entry['n']} times" if entry["n"] > 1 else "")
        markup(finding_html({"severity": entry["severity"], "sentence": text}))
        options = list(entry["options"])
        with ui.element("div").classes("bar"):
            if len(options) == 1:
                quiet_button(f"Set {options[0]['words']}", partial(self.ask, options[0]))
                return
            words = dict(enumerate(option["words"] for option in options))
            chosen = ui.select(words, label=f"Set, of {name}", value=0).props("outlined dense")
            chosen.style("flex: 1 1 16rem; min-width: 0")
            button = quiet_button("Set this", lambda: self.ask(options[int(chosen.value)]))
            button.props["aria-label"] = f"Set this, of {name}"

    def ask(self, option: Mapping[str, Any]) -> None:
        """Show the lines that a remedy writes, as they are and as they will be."""
        with saying_errors(self.place):
            wanted = edits.preview(
                self.file,
                [edits.Edit(tuple(e["table"]), e["key"], e["value"]) for e in option["edits"]],
            )
            self.dialog.clear()
            with self.dialog, ui.card().classes("preview"):
                heading("What is written into campaign.toml")
                markup(preview_html(wanted))
                with ui.element("div").classes("bar"):
                    ui.button("Apply", on_click=lambda: self.apply(wanted)).props(
                        "no-caps autofocus"
                    )
                    quiet_button("Leave it as it is", self.dialog.close)
            self.dialog.open()

    def apply(self, wanted: edits.Preview) -> None:
        """Write what was shown; the page sees that the file has changed."""
        self.dialog.close()
        with saying_errors(self.place):
            edits.apply(self.file, wanted)

    def undo(self) -> None:
        """Take the last remedy back."""
        with saying_errors(self.place):
            edits.undo(self.file)


def preview_html(wanted: edits.Preview) -> str:
    """Return the lines of a remedy, each below the one that it replaces."""
    parts = [
        f"<dt><code>{escape(table)}</code></dt>"
        f"<dd>now <code>{escape(now)}</code></dd><dd>then <code>{escape(then)}</code></dd>"
        for table, now, then in wanted.lines
    ]
    return f'<dl class="lines">{"".join(parts)}</dl>'
