"""Blocks as a page: one self-contained HTML file that executes and requests nothing.

Figures are SVG within it, and the page's own content security policy forbids scripts and requests.
"""

from __future__ import annotations

import base64
import hashlib
import re
from typing import Any

from roomfit.base.errors import InputError
from roomfit.base.table import html_of
from roomfit.report.blocks import (
    SEVERITIES,
    Blocks,
    Findings,
    Part,
    in_its_language,
)
from roomfit.report.wording import translator


def page(answer: Blocks) -> str:
    """Return an answer as the text of one HTML file, to be written as UTF-8.

    Equal answers give equal text.
    """
    if answer.logo and not re.fullmatch(
        r"data:image/(png|jpeg);base64,[A-Za-z0-9+/=]+", answer.logo
    ):
        raise InputError("the logo is no data URL of PNG or JPEG", found=repr(answer.logo[:40]))
    answer, say = in_its_language(answer), translator(answer.language)
    running = " · ".join(filter(None, (answer.title, dict(answer.project).get("client", ""))))
    text = _template(
        "page",
        t=say,
        whole=True,
        drawn=True,
        a=answer,
        running=_css_string(running),
        page_words=tuple(_css_string(say(word)) for word in ("Page", "of")),
        parts=tuple(b for b in answer.blocks if isinstance(b, Part) and b.name),
        picked=[d for d in answer.drawings() if len(d.choices) > 1],
    )
    # the digests of the page's own style rules go into its policy: no others hold
    rules = re.findall(r"<style>(.*?)</style>", text, flags=re.DOTALL)
    digests = {base64.b64encode(hashlib.sha256(rule.encode()).digest()).decode() for rule in rules}
    return text.replace("RULES", " ".join(f"'sha256-{d}'" for d in sorted(digests)), 1)


def fragment(answer: Blocks, *, first: bool = False) -> str:
    """Return an answer as a piece of HTML without drawings, for a notebook; or its first screen.

    Question mark and grey follow what is not identifiable, for the page's style sheet is missing.
    The `first` screen has its drawing.
    """
    shown = answer.head if first else (*answer.head, *answer.blocks)
    return _template("fragment", t=str, blocks=shown, whole=False, drawn=first)


def findings_count(block: Findings) -> str:
    """Return how many findings of which severity there are, for the head of the list."""
    words = {"serious": "serious", "warning": "to look at", "info": "to know"}
    counts = [
        f"{n} {words[severity]}"
        for severity in SEVERITIES
        if (n := sum(f.severity == severity for f in block.findings))
    ]
    return f"Findings: {', '.join(counts) or '0'}"


def _css_string(text: str) -> str:
    """Return a text as a string of a style sheet that no character of it can end."""
    letters = (
        c if c.isalnum() and c.isascii() else f"\\{ord(c):x} " for c in " ".join(text.split())
    )
    return '"{}"'.format("".join(letters))


def _template(name: str, **content: Any) -> str:
    from jinja2 import Environment, PackageLoader, StrictUndefined  # for pages alone
    from markupsafe import Markup

    environment = Environment(
        loader=PackageLoader("roomfit.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals.update(
        html_of=lambda shown: Markup(html_of(shown)),
        svg_of=lambda drawing: Markup(drawing.svg),
        kind_of=lambda block: type(block).__name__,
        findings_count=findings_count,
    )
    text: str = environment.get_template(f"{name}.html.j2").render(**content)
    return text
