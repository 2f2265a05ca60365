"""Answers of any size without a fit, a reader for the report's tables, and a browser."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import dataclass, field, replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np

from roomfit.base.air import Air
from roomfit.base.bands import bands_between
from roomfit.base.findings import About, Code, Finding
from roomfit.base.logit import logit
from roomfit.base.table import Table, written
from roomfit.materials.priors import unknown_material
from roomfit.result import Compared, ComparedPair, Decay, Result
from roomfit.room.mesh import shoebox_mesh
from roomfit.room.scene import Point, Room, Scene, material_areas_m2
from roomfit.settings import Settings
from roomfit.signals.decay import in_jnd
from roomfit.solver import Ending
from roomfit.uncertainty.combinations import Combination, Determined
from roomfit.uncertainty.gaussian import BandEstimate
from roomfit.uncertainty.posterior import covariance_from_intervals

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
VALUES = {
    "T20_s": 0.8, "T30_s": 0.85, "EDT_s": 0.7, "C50_dB": 3.0, "C80_dB": 6.0, "D50_percent": 60.0,
    "TS_ms": 50.0,
}  # fmt: skip


def scene_of(materials=("walls", "floor", "ceiling"), sources=("S1",), receivers=("R1", "R2")):
    """Return a box of 6 x 4 x 3 m; what materials are left after four walls share the rest."""
    owners = np.minimum([0, 0, 0, 0, 1, 2], len(materials) - 1)
    room = Room(shoebox_mesh((6.0, 4.0, 3.0)), tuple(materials), owners, (6.0, 4.0, 3.0))
    rng = np.random.default_rng(5)

    def points(names):
        return tuple(Point(n, rng.uniform((0.6, 0.6, 0.6), (5.4, 3.4, 2.4))) for n in names)

    pairs = [(i, j) for i in range(len(sources)) for j in range(len(receivers))]
    return Scene(room, points(sources), points(receivers), np.array(pairs).reshape(-1, 2), Air())


def answer_of(scene, *, kind="octave", low=125, high=4000, kept=(), findings=()):
    """Return an answer with random numbers for every pair; those `kept` were not fitted."""
    rng = np.random.default_rng(11)
    bands = bands_between(kind, low, high)
    n, m = len(scene.room.materials), len(bands)
    absorption = rng.uniform(0.02, 0.9, (n, m))
    width = rng.uniform(0.02, 0.3, (n, m))
    lower, upper = np.maximum(absorption - width, 0.0), np.minimum(absorption + width, 1.0)
    areas = material_areas_m2(scene.room)
    covariance, chi2 = covariance_from_intervals(absorption, lower, upper), np.linspace(0.8, 2.6, m)
    estimates = [
        BandEstimate(
            *(absorption[:, j], lower[:, j], upper[:, j], logit(absorption[:, j]), covariance[j]),
            *(chi2[j], 12.5 / m, 20),
            Ending.CONVERGED if j % 2 == 0 else Ending.OUT_OF_ROUNDS,
            "energy",
            kinds=("gaussian",) * n,
        )
        for j in range(m)
    ]
    mean = areas @ absorption / areas.sum()
    groups = [
        Determined(
            (Combination(areas / areas.sum(), x, 0.9 * x, 1.1 * x, 0.05 * x),),
            "",
            np.outer((1.0, 0.9, 1.1), areas * absorption[:, j] / (areas @ absorption[:, j])),
        )
        for j, x in enumerate(mean)
    ]
    names = [(scene.sources[i].name, scene.receivers[j].name) for i, j in scene.pairs]
    return Result(
        scene=scene,
        bands=bands,
        priors=tuple(unknown_material(name, m) for name in scene.room.materials),
        estimates=tuple(estimates),
        determined=tuple(groups),
        identifiable=upper - lower <= 0.2,
        identifiable_by_rule=upper - lower <= 0.2,
        pairs=tuple(
            pair_of(rng, *p, m, "validate" if k in kept else "fit") for k, p in enumerate(names)
        ),
        findings=tuple(findings),
        settings=Settings(seed=3),
        evaluations=120,
        seconds=4.2,
    )


def with_bands(answer, **changes):
    """Return an answer whose estimates have other values, (..., n_bands), by name."""
    estimates = [
        replace(b, **{name: values[..., j] for name, values in changes.items()})
        for j, b in enumerate(answer.estimates)
    ]
    return replace(answer, estimates=tuple(estimates))


def pair_of(rng, source, receiver, n_bands, use="fit"):
    """Return a compared pair with every parameter and a straight decay."""
    found = {}
    for name, value in VALUES.items():
        measured, predicted, null = value * rng.uniform(0.8, 1.25, (3, n_bands))
        found[name] = Compared(measured, predicted, null, in_jnd(name, measured, predicted))
    time_s = np.arange(0.0, 0.9, 0.002)
    slopes = rng.uniform(50.0, 90.0, (2, n_bands, 1))
    measured_db, predicted_db = -slopes * time_s
    measured_db[:, time_s > 0.6] = np.nan
    return ComparedPair(source, receiver, use, found, Decay(time_s, measured_db, predicted_db))


def finding(severity, sentence):
    """Return a finding of the first code that has this severity."""
    return Finding(next(code for code in Code if code.severity == severity), About(), sentence)


@dataclass
class Reader(HTMLParser):
    """What stands in a page: tables by caption, visible words, references, and open elements."""

    tables: dict[str, dict[str, list[list[str]]]] = field(default_factory=dict)
    words: list[str] = field(default_factory=list)
    references: list[tuple[str, str, str]] = field(default_factory=list)
    elements: list[tuple[str, dict[str, str]]] = field(default_factory=list)
    headings: list[str] = field(default_factory=list)
    raw: dict[str, list[str]] = field(default_factory=dict)
    path: list[str] = field(default_factory=list)

    VOID = frozenset(("meta", "img", "br", "link", "input"))

    def __post_init__(self):
        super().__init__()
        self._caption, self._row, self._lines = "", None, None

    def handle_starttag(self, tag, attributes):
        known = {k: v or "" for k, v in attributes}
        self.elements.append((tag, known))
        self.references += [
            (tag, k, v) for k, v in known.items() if k in ("src", "href", "action", "data")
        ]
        if tag not in self.VOID:
            self.path.append(tag)
        if tag == "caption":
            self._caption = ""
        if tag in ("th", "td"):
            self._lines = [""]
        if tag == "tr":
            self._row = []
        if tag == "small" and self._lines is not None:
            self._lines.append("")

    def handle_endtag(self, tag):
        assert self.path.pop() == tag, f"{tag} closes something else"
        if tag == "caption":
            assert self._caption not in self.tables, self._caption
            self.tables[self._caption] = {}
        elif tag in ("th", "td"):
            self._row.append([line.strip() for line in self._lines])
            self._lines = None
        elif tag == "tr":
            self.tables[self._caption][self._row[0][0] or ""] = self._row[1:]

    def handle_startendtag(self, tag, attributes):
        self.elements.append((tag, dict(attributes)))

    def handle_data(self, data):
        here = self.path[-1] if self.path else ""
        if here in ("script", "style"):
            self.raw.setdefault(here, []).append(data)
            return
        self.words.append(data)
        if here in ("h1", "h2", "h3"):
            self.headings.append(data)
        if here == "caption":
            self._caption += data
        if self._lines is not None:
            self._lines[-1] += data


def texts_of(table: Table) -> list[list[str]]:
    """Return the texts of all cells of a table, smaller lines left out."""
    forms = [c.form for c in table.described()]
    return [[written(v, f) for v, f in zip(row, forms, strict=True)] for row in table.rows]


def read_page(text: str) -> Reader:
    """Return what an HTML page holds; every element must be closed."""
    reader = Reader()
    reader.feed(text)
    reader.close()
    assert reader.path == []
    return reader


def drawing(text: str, name: str) -> str:
    """Return the SVG element of that name."""
    (found,) = re.findall(rf'<svg role="img" aria-labelledby="{name}-title".*?</svg>', text, re.S)
    return found


def look_at(file: Path, folder: Path) -> tuple[Path, str, list[str]]:
    """Open a page in Chromium; return a screenshot, the page as drawn, and errors it logged."""
    picture = folder / "page.png"
    common = [
        CHROMIUM, "--headless=new", "--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader",
        "--disable-background-networking", "--no-first-run", "--enable-logging=stderr",
        "--window-size=1280,2400", "--virtual-time-budget=20000", f"--user-data-dir={folder}/user",
    ]  # fmt: skip
    shown = subprocess.run(
        [*common, f"--screenshot={picture}", file.as_uri()],
        capture_output=True, text=True, timeout=3600, check=True,
    )  # fmt: skip
    drawn = subprocess.run(
        [*common, "--dump-dom", file.as_uri()],
        capture_output=True, text=True, timeout=3600, check=True,
    )  # fmt: skip
    logged = re.findall(r"CONSOLE:\d+\] (\".*)", shown.stderr + drawn.stderr)
    # what the graphics driver says of its own speed is no fault of the page
    harmless = ("GL Driver Message", "willReadFrequently")
    return picture, drawn.stdout, [m for m in logged if not any(h in m for h in harmless)]
