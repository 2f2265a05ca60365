"""The documentation against the code: what it shows runs, what it names exists."""

from __future__ import annotations

import doctest
import importlib
import os
import re
import runpy
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pydantic import BaseModel

import roomfit
from roomfit.cli.arguments import parsers
from roomfit.demo.boxes import demo_plan, write_measured_box
from roomfit.files import schema
from roomfit.files.inputs import material_priors
from roomfit.fit.trace_plan import LEAST_RADIUS_M, LEAST_RAYS
from roomfit.materials.priors import DEFAULT_LOGIT_SD, DEFAULT_MEAN
from roomfit.model.energy import EnergyTerm
from roomfit.model.observation import DEFAULT_POSITION_SD_M
from roomfit.pressures.sequential import NOISES
from roomfit.room.build import TOO_WARPED_FROM_M
from roomfit.settings import Settings
from roomfit.tracing.enclosure import LEAK_LIMIT
from roomfit.treat.campaign import read_treatment
from roomfit.uncertainty.gaussian import LARGEST_CHI2_REDUCED, WIDEST_IDENTIFIABLE

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
SOURCE = Path(roomfit.__file__).parent
GENERATED = {"_build", "gallery", "reference"}
PAGES = sorted(
    page for page in DOCS.rglob("*.md") if not GENERATED & set(page.relative_to(DOCS).parts)
)
# tutorials are walked in tests/test_tutorials.py
SINGLE = [page for page in PAGES if not page.name.startswith("tutorial-")]
EXAMPLES = sorted((DOCS / "examples").glob("plot_*.py"))
SOURCES = sorted(SOURCE.rglob("*.py"))


def page(name: str) -> str:
    return (DOCS / name).read_text(encoding="utf-8")


def named(path: Path) -> str:
    # the package may be a copy elsewhere, as one with a planted bug is
    above = SOURCE.parents[1] if path.is_relative_to(SOURCE) else ROOT
    return path.relative_to(above).as_posix()


def code_blocks(path: Path, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", path.read_text("utf-8"), re.M | re.S)


def run_python(*arguments: str, folder: Path) -> str:
    """Run a fresh interpreter, as a reader would, and return what it printed."""
    environment = {**os.environ, "MPLBACKEND": "Agg"}
    done = subprocess.run(
        [sys.executable, *arguments],
        cwd=folder, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


# What the pages show runs.


@pytest.mark.parametrize("source", [f for f in SOURCES if ">>> " in f.read_text()], ids=named)
def test_examples_in_docstrings_print_what_they_say(source):
    parts = source.relative_to(SOURCE.parent).with_suffix("").parts
    module = importlib.import_module(".".join(p for p in parts if p != "__init__"))
    found = doctest.testmod(module, extraglobs={"np": np})
    assert found.attempted > 0
    assert found.failed == 0


@pytest.mark.slow
@pytest.mark.parametrize("example", EXAMPLES, ids=named)
def test_an_example_of_the_gallery_runs_in_a_fresh_interpreter(example, tmp_path):
    printed = run_python(str(example), folder=tmp_path)
    # what the text around the code says of the result
    expected = {
        "plot_check_room": [
            "volume V        46.80 m3",
            "The room can be traced.",
            "the mesh leaks",
        ],
        "plot_error_landscape": ["ill_defined  [0.65 0.35], one minimum: True"],
        "plot_identify_box": [
            "mean of the room",
            "Each error is shown beside those of the baselines",
        ],
        "plot_trace_once": ["paths over the materials"],
    }
    assert all(text in printed for text in expected[example.stem])
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def campaign_folder(tmp_path_factory):
    """A folder with campaign.toml and its recordings: one source, one octave, to be quick."""
    folder = tmp_path_factory.mktemp("campaign")
    plan = demo_plan()
    plan = replace(plan, sources_m={"LS1": plan.sources_m["LS1"]})
    campaign = write_measured_box(plan, folder, np.random.default_rng(1))
    text = campaign.read_text().replace("from_hz = 125", "from_hz = 4000")
    campaign.write_text(text)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize(
    "path", [p for p in [ROOT / "README.md", *SINGLE] if code_blocks(p, "python")], ids=named
)
def test_python_on_a_page_runs_from_top_to_bottom(path, campaign_folder):
    run_python("-c", "\n".join(code_blocks(path, "python")), folder=campaign_folder)


@pytest.mark.parametrize(
    ("path", "number"),
    [(p, n) for p in [ROOT / "README.md", *PAGES] for n, _ in enumerate(code_blocks(p, "toml"))],
    ids=lambda value: named(value) if isinstance(value, Path) else str(value),
)
def test_a_campaign_on_a_page_is_a_good_one(path, number, tmp_path):
    file = tmp_path / "campaign.toml"
    file.write_text(code_blocks(path, "toml")[number], encoding="utf-8")
    if path.name == "treat.md":
        assert read_treatment(file).targets
        return
    campaign = roomfit.read_campaign(file)
    known = material_priors(campaign, tuple(campaign.room.materials.values()))
    assert len(known) == len(campaign.room.materials)


def test_the_picture_of_the_pipeline_is_what_its_script_draws():
    script = DOCS / "pictures" / "pipeline.py"
    drawn = runpy.run_path(str(script))["draw"]()
    assert script.with_suffix(".svg").read_text(encoding="utf-8") == drawn


# The first pages are short, and take their figures from the page that has the commands.


def test_the_readme_is_read_in_a_few_minutes_and_shows_python_before_the_commands():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.split()) <= 900
    (example,) = code_blocks(ROOT / "README.md", "python")
    assert len([line for line in example.split("\n") if line]) <= 15
    assert text.index("```python") < text.index("| to | command |")


def test_a_cell_of_the_accuracy_in_the_readme_has_one_number_that_its_page_has_too():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    table = text[text.index("| data |") : text.index("Among positions")].strip().split("\n")
    rows = [[cell.strip() for cell in row.strip("|").split("|")] for row in table[2:]]
    assert len(rows) > 5
    known = set(re.findall(r"[\d.]+", page("accuracy.md")))
    for _, quantity, found, baseline in rows:
        for cell in (found, baseline):
            numbers = re.findall(r"[\d.]+", cell)
            assert len(numbers) == 1 or not cell, quantity
            assert set(numbers) <= known, quantity


def test_a_version_in_the_changelog_takes_600_words_at_most():
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    for version in text.split("\n## ")[1:]:
        assert len(version.split()) <= 600, version.split("\n")[0]


# What the pages name exists.


def headings(text: str) -> set[str]:
    """Return the anchors of a page: its headings as MyST writes them, and explicit targets."""
    titles = re.findall(r"^#+ (.*)$", text, re.M)
    slugs = {re.sub(r"[^\w\- ]", "", t.lower()).replace(" ", "-") for t in titles}
    return slugs | set(re.findall(r"^\(([\w-]+)\)=$", text, re.M))


@pytest.mark.parametrize("path", [*PAGES, *sorted(ROOT.glob("*.md"))], ids=named)
def test_links_lead_somewhere(path):
    for target, anchor in re.findall(
        r"\]\(([^)#\s]*)(?:#([\w-]+))?\)", path.read_text(encoding="utf-8")
    ):
        if target.startswith(("http://", "https://")):
            continue
        aim = (path.parent / target).resolve() if target else path
        if aim.parent == DOCS / "gallery":
            made_from = DOCS / "examples" / f"{aim.stem}.py"
            assert aim.stem == "index" or made_from.exists(), target
            continue
        assert aim.exists(), target
        assert not anchor or anchor in headings(aim.read_text(encoding="utf-8")), anchor


def test_every_page_is_reached_from_the_first():
    reached, waiting = set(), [DOCS / "index.md"]
    while waiting:
        here = waiting.pop()
        reached.add(here)
        for tree in code_blocks(here, r"\{toctree\}"):
            entries = [line for line in tree.split("\n") if line and line[0] != ":"]
            found = [f for entry in entries for f in here.parent.glob(f"{entry}.md")]
            waiting += [f for f in found if f not in reached]
    assert reached == set(PAGES)


def listed_names(module: str) -> list[str]:
    """Return the names that the reference lists under a module, without those of its parts."""
    current, found = "", list[str]()
    for block in code_blocks(DOCS / "api.md", r"\{eval-rst\}"):
        for line in block.split("\n"):
            if line.startswith(".. currentmodule:: "):
                current = line.rpartition(" ")[2]
            elif current == module and re.fullmatch(r" {3}\w+", line):
                found.append(line.strip())
    return found


def test_every_public_name_stands_in_the_reference_and_no_other():
    assert sorted(listed_names("roomfit")) == sorted(set(roomfit.__all__) - {"__version__"})


def test_names_of_modules_in_the_reference_exist():
    dotted = re.findall(r"^ {3}([\w.]+)\.(\w+)$", page("api.md"), re.M)
    assert dotted
    for module, name in dotted:
        assert hasattr(importlib.import_module(f"roomfit.{module}"), name), f"{module}.{name}"


def test_files_and_tests_that_a_page_names_are_there():
    for path in PAGES:
        for name in re.findall(r"`((?:tests|scripts|benchmarks)/[\w./]+)`", path.read_text()):
            assert (ROOT / name).exists(), f"{named(path)} names {name}"
    for name in re.findall(r"scripts/bench (\w+)", page("benchmarks.md")):
        assert (ROOT / "benchmarks" / f"{name}.py").exists(), name


def test_every_benchmark_is_run_or_left_out_by_name_and_stands_on_its_page():
    """Those that need no argument are run; each has a row that says what it prints."""
    programs = {p.stem for p in (ROOT / "benchmarks").glob("[a-z]*.py")}
    script = (ROOT / "scripts" / "bench").read_text(encoding="utf-8")
    left_out = set(re.findall(r'left_out="([^"]*)"', script)[0].split())
    assert left_out < programs
    named = set(re.findall(r"scripts/bench (\w+)", page("benchmarks.md")))
    assert programs <= named


def test_every_command_and_option_is_reported():
    reported = "".join(path.read_text(encoding="utf-8") for path in PAGES)
    for name, parser in parsers()[1].items():
        assert f"roomfit {name}" in reported
        for option in re.findall(r"--[\w-]+", parser.format_usage()):
            assert option in reported, f"roomfit {name} {option}"


# What the pages say is what the code does.


def tables() -> list[type[BaseModel]]:
    found = [t for t in vars(schema).values() if isinstance(t, type) and issubclass(t, BaseModel)]
    return [t for t in found if t not in (BaseModel, schema.Table)]


@pytest.mark.parametrize("table", tables())
def test_every_key_of_a_campaign_is_reported_with_its_default(table):
    text = page("campaign-file.md") + page("treat.md")
    rows = [line.strip("| ").split(" | ") for line in text.split("\n") if line.startswith("| `")]
    for name, field in table.model_fields.items():
        key = field.alias or name
        assert re.search(rf"\b{key}\b", text), key
        default = field.default
        if isinstance(default, int | float | str):
            reported = default if isinstance(default, str) else f"{default:g}"
            reported = str(default).lower() if isinstance(default, bool) else reported
            # the second cell holds the default where there is a column for it
            cells = [row[1] for row in rows if f"`{key}`" in row[0]]
            assert any(re.search(rf"(?<![\w.]){reported}\b", cell) for cell in cells), key


def test_numbers_that_the_pages_tell_are_those_of_the_code():
    fields = EnergyTerm.__dataclass_fields__
    settings = Settings()
    default_s = settings.default_scattering
    middle = np.log(DEFAULT_MEAN / (1.0 - DEFAULT_MEAN))
    reach = 1.96 * DEFAULT_LOGIT_SD
    low, high = (1.0 / (1.0 + np.exp(-x)) for x in (middle - reach, middle + reach))
    reported = {
        "results.md": [
            f"(φ at most {LARGEST_CHI2_REDUCED:g}), "
            f"the interval is no wider than {WIDEST_IDENTIFIABLE:g}"
        ],
        "findings.md": [
            f"explains the responses best, and {default_s:g} where there are only room",
            f"More than {100 * LEAK_LIMIT:g} % of hits escape",
            f"`phi` exceeds {LARGEST_CHI2_REDUCED:g}",
            f"; {100 * DEFAULT_POSITION_SD_M:g} cm a coordinate was assumed",
            f"by more than {1e3 * TOO_WARPED_FROM_M:g} mm",
        ],
        "campaign-file.md": [
            f"({default_s:g} where there are only room parameters), with a finding",
            f"Left out: {DEFAULT_POSITION_SD_M:g}",
            f"lies between {low:.2f} and {high:.2f}",
        ],
        "how-it-works.md": [
            f"({LEAST_RADIUS_M:g} m in radius",
            f"up to some 300 m³ {LEAST_RAYS:,} rays a source",
            f"{100 * fields['model_error'].default:g} % of the window's energy",
            f"{100 * fields['ringing_error'].default:g} % of what a loudspeaker",
            f"(mean {DEFAULT_MEAN:g}, standard deviation {DEFAULT_LOGIT_SD:g} in logit)",
        ],
    }
    for name, sentences in reported.items():
        text = " ".join(page(name).split())
        for sentence in sentences:
            assert sentence in text, f"{name} no longer says: {sentence}"


def test_errors_of_the_model_are_those_that_the_page_states():
    low, high = re.findall(r"error of the model, (\d+) to (\d+) %", page("how-it-works.md"))[0]
    models = [model for model, _, _ in NOISES]
    assert (100 * min(models), 100 * max(models)) == (float(low), float(high))
