"""Blocks as text for a terminal."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from importlib import import_module

from roomfit.base.findings import Code, Finding
from roomfit.base.table import Shown, Table, text_of
from roomfit.report.blocks import Block, Blocks, Findings, Listed, Part, Sentence, Terms

_WIDTH = 100
_MOST_SENTENCES = 12


def shown_text(answer: object, *, details: bool) -> str:
    """Return an answer, or what describes one, for a terminal; any other text as it is."""
    if isinstance(answer, Shown):
        answer = import_module(f"roomfit.report.{answer.described_in}").describe(answer)
    return text(answer, details=details) if isinstance(answer, Blocks) else str(answer)


def text(answer: Blocks, *, details: bool = True) -> str:
    """Return an answer for a terminal: its first screen, or all that is not a page's alone."""
    shown = (*answer.head, *answer.blocks) if details else answer.head
    parts = [_block(b, answer.file) for b in sorted(shown, key=lambda b: isinstance(b, Findings))]
    if not details:  # in a screen: blank lines about what is long
        aside = [isinstance(b, Table | Terms) or b == answer.head[0] for b in shown]
        parts = [f"{p}\n" if p and x else p for p, x in zip(parts, aside, strict=True)]
    for block in () if details else answer.blocks:
        if isinstance(block, Findings) and block.findings:
            codes = ", ".join(dict.fromkeys(same[0].code.value for same in block.groups()))
            parts.append(filled(f"Findings: {codes}. All of it: --details."))
    return ("\n\n" if details else "\n").join(p for p in parts if p)


def _block(block: Block, file: str) -> str:
    match block:
        case Sentence():
            return "" if block.kind == "note" else filled(block.text)
        case Terms():
            width = max((len(first) for first, _ in block.pairs), default=0)
            side = "<>"[block.are_numbers]
            return "\n".join(
                filled(f"{first:{side}{width}}  {words}", width + 2) for first, words in block.pairs
            )
        case Listed():
            more = len(block.sentences) - _MOST_SENTENCES
            rest = [f"(and {more} more in {file})"] if more > 0 else []
            return "\n".join([*map(filled, block.sentences[:_MOST_SENTENCES]), *rest])
        case Table():
            return text_of(block)
        case Findings():
            return findings_text(block.findings, block.advice, file)
        case Part():
            parts = [_block(b, file) for b in block.blocks] if block.in_text else []
            body = "\n\n".join(p for p in parts if p)
            return f"{block.heading}\n{body}" if body and block.folded else body
        case _:
            return ""


def filled(words: str, indent: int = 0) -> str:
    """Return a paragraph in lines; codes are looked up, so they stay whole."""
    return textwrap.fill(words, _WIDTH, subsequent_indent=" " * indent, break_on_hyphens=False)


def findings_text(
    findings: Sequence[Finding],
    advice: Mapping[Code, Sequence[str]] | None = None,
    file: str = "result.json",
) -> str:
    """Return the findings, most serious first; one line for each code, and what it advises."""
    lines = ["Findings"] if findings else []
    where = f" in {file}" if file else ""
    for same in Findings(tuple(findings)).groups():
        first = same[0]
        more = f" (and {len(same) - 1} more of this kind{where})" if same[1:] else ""
        lines.append(filled(f"- {first.severity}: {first.sentence}{more} [{first.code}]", 2))
        if (e := first.error) is not None:
            parts = {"where": e.where, "found": e.found, "needed": e.needed, "try": e.hint}
            lines += [f"    {key:<7} {words}" for key, words in parts.items() if words]
        lines += [f"    {line}" for line in (advice or {}).get(first.code, ())]
    return "\n".join(lines)
