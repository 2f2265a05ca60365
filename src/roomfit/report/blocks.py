"""What an answer says, described once: a terminal, a page and a file each show what they can.

An answer becomes `Blocks` in the module that knows it; `roomfit.report.text`, `.html` and
`.documents` render them and know no answer.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import cached_property
from importlib import import_module
from pathlib import PurePath
from typing import TYPE_CHECKING, Any, TypeAlias

from roomfit.base.findings import Code, Finding, Severity
from roomfit.base.table import Cell, Column, Table, Value, written
from roomfit.report.wording import DASH, Translator, translator

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from roomfit.room.scene import Scene

SEVERITIES: tuple[Severity, ...] = ("serious", "warning", "info")


@dataclass(frozen=True, slots=True)
class Sentence:
    """A paragraph; the style sheet's name for it is ``lead``, ``usable``, ``note`` or none."""

    text: str
    kind: str = ""
    keys: tuple[tuple[str, str], ...] = ()  # coloured words behind it: style and word


@dataclass(frozen=True, slots=True)
class Terms:
    """Names with a text each; or a few numbers, each with what it is."""

    pairs: tuple[tuple[str, str], ...]
    are_numbers: bool = False


@dataclass(frozen=True, slots=True)
class Listed:
    """A list of sentences."""

    sentences: tuple[str, ...]


@dataclass(frozen=True)
class Drawing:
    """A figure, drawn once and when it is first looked at: matplotlib is imported then."""

    name: str  # of its file, without ending
    title: str  # for those who do not see it
    caption: str
    maker: str  # function of `roomfit.report.figures`, or of the module that it names
    of: tuple[Any, ...]  # its arguments
    # of what is drawn over each other one is shown at a time, `chosen` first; names of files
    choices: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    chosen: int = 0
    say: Translator | None = None  # its words in another language

    @cached_property
    def figure(self) -> Figure:
        """Return the figure."""
        module, _, function = self.maker.rpartition(".")
        found = import_module(f"roomfit.report.{module or 'figures'}")
        figure: Figure = getattr(found, function)(*self.of)
        if self.say is not None:
            import_module("roomfit.report.figures").say_in(figure, self.say)
        return figure

    @cached_property
    def svg(self) -> str:
        """Return the SVG element."""
        key = self.name.replace("_", "-")
        return str(import_module("roomfit.report.figures").svg(self.figure, key, self.title))


@dataclass(frozen=True, slots=True)
class Findings:
    """Findings, and what they advise to write into the campaign."""

    findings: tuple[Finding, ...]
    advice: Mapping[Code, Sequence[str]] = field(default_factory=dict)

    def groups(self) -> tuple[list[Finding], ...]:
        """Return the findings by severity, those of one code together."""
        alike: dict[tuple[Severity, Code], list[Finding]] = {}
        for finding in sorted(self.findings, key=lambda f: SEVERITIES.index(f.severity)):
            alike.setdefault((finding.severity, finding.code), []).append(finding)
        return tuple(alike.values())


@dataclass(frozen=True, slots=True)
class Part:
    """Blocks under a heading."""

    heading: str
    blocks: tuple[Block, ...]
    name: str = ""  # links lead to it
    words: str = ""  # behind the heading of what is folded
    folded: bool = False
    on_paper: bool = True  # whether it is printed though it is folded
    in_text: bool = True  # False: a page alone has it


Block: TypeAlias = "Sentence | Terms | Listed | Table | Drawing | Findings | Part"


@dataclass(frozen=True, slots=True)
class Blocks:
    """An answer."""

    title: str
    head: tuple[Block, ...]  # the first screen
    blocks: tuple[Block, ...]
    file: str = "result.json"  # which has all of it
    project: tuple[tuple[str, str], ...] = ()
    logo: str = ""  # a data URL
    language: str = "en"
    is_said: bool = False  # its texts are in the language already
    names: frozenset[str] = frozenset()  # of walls, places, persons: the same in every language

    def drawings(self) -> tuple[Drawing, ...]:
        """Return all figures, in their order."""
        return tuple(b for b in _flat((*self.head, *self.blocks)) if isinstance(b, Drawing))


def _flat(blocks: Sequence[Block]) -> Iterator[Block]:
    for block in blocks:
        yield block
        if isinstance(block, Part):
            yield from _flat(block.blocks)


# ---------------------------------------------------------------- languages


def names_of(scene: Scene, *others: str) -> frozenset[str]:
    """Return the names in a scene, and others, as `Blocks` has them."""
    room, points = scene.room, (*scene.sources, *scene.receivers)
    of_walls = (*room.materials, *(s.name for s in room.mesh.surfaces))
    return frozenset(
        (*of_walls, *(s.name for s in room.states), *(p.name for p in points), *others)
    )


def in_its_language(answer: Blocks) -> Blocks:
    """Return an answer with all its texts in its language; one that has them stays as it is."""
    if answer.language == "en" or answer.is_said:
        return answer
    found = [f for b in _flat(answer.blocks) if isinstance(b, Findings) for f in b.findings]
    files = [PurePath(file).name for f in found for file in f.about.files]
    said: Blocks = _said(answer, translator(answer.language, answer.names.union(files)))
    return replace(said, is_said=True)


# fields of blocks, tables and findings that hold words
_WORDS = (
    *("text", "keys", "pairs", "sentences", "title", "caption", "choices", "sentence", "findings"),
    *("heading", "words", "blocks", "head", "small", "columns", "rows", "notes", "project"),
)


def _said(value: Any, say: Translator) -> Any:
    match value:
        case str():
            return say(value)
        case Column():
            return value._replace(name=say(value.name))
        case tuple() | list():
            return type(value)(_said(one, say) for one in value)
        case Table():
            columns = value.described()
            rows = [list(map(_in_words, row, columns)) for row in value.rows]
            value = replace(value, rows=rows, columns=list(columns))
    if not is_dataclass(value) or isinstance(value, type):
        return value
    own = {f.name: getattr(value, f.name) for f in fields(value) if f.name in _WORDS}
    changed = {name: _said(one, say) for name, one in own.items()}
    if isinstance(value, Drawing):
        changed["say"] = say
    return replace(value, **changed)


def _in_words(value: Value, column: Column) -> Value:
    if isinstance(value, Cell | str):
        return value
    return written(value, column.form, DASH).replace("-", "\N{MINUS SIGN}")
