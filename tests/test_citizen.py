"""Files by which others install, cite and test the package agree with the package."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import roomfit
from roomfit.cli.arguments import parsers

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
SOURCE = "".join(
    " ".join(file.read_text(encoding="utf-8").split())
    for file in Path(roomfit.__file__).parent.rglob("*.py")
)


def text(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def test_every_file_has_the_version_of_the_package():
    assert PROJECT["version"] == roomfit.__version__
    assert f"version: {roomfit.__version__}\n" in text("CITATION.cff")
    assert f'version = "{roomfit.__version__}"' in text("conda/meta.yaml")


def test_the_citation_has_what_its_format_requires():
    lines = text("CITATION.cff").split("\n")
    keys = {line.split(":")[0] for line in lines if re.match(r"[a-z]", line)}
    assert {"cff-version", "message", "title", "authors", "license", "version"} <= keys


def test_the_conda_recipe_needs_what_the_package_needs():
    """Under the names of conda-forge."""
    renamed = {
        "soundfile": "pysoundfile",
        "matplotlib": "matplotlib-base",
        "mapbox-earcut": "mapbox_earcut",
    }
    wanted = {
        (renamed.get(name, name), least)
        for name, least in (entry.split(">=") for entry in PROJECT["dependencies"])
    }
    run = text("conda/meta.yaml").split("  run:\n")[1].split("test:")[0]
    found = set(re.findall(r"- (\S+) >=(\S+)", run))
    assert found == wanted | {("python", PROJECT["requires-python"].removeprefix(">="))}


def test_the_workflow_tests_three_systems_and_every_python_is_supported():
    workflow = text(".github/workflows/test.yml")
    assert "[ubuntu-latest, macos-latest, windows-latest]" in workflow
    least = tuple(map(int, PROJECT["requires-python"].removeprefix(">=").split(".")))
    named = re.findall(r'"(3\.\d+)"', workflow) + re.findall(r'"(3\.\d+)"', text("noxfile.py"))
    assert named and all(tuple(map(int, version.split("."))) >= least for version in named)


def test_the_readme_lists_every_command():
    readme = text("README.md")
    assert "pip install" in readme
    for name in parsers()[1]:
        assert f"`roomfit {name}" in readme, name


def test_every_source_of_the_methods_page_stands_in_the_module_it_names():
    """Its journal with volume and pages, or its number as a standard."""
    page = text("docs/methods.md")
    cited = re.findall(r"\d+, \d+-\d+ \(\d{4}\)", page)
    cited += re.findall(r"(?:ISO|IEC) [\d-]+:\d{4}", page)
    assert len(cited) > 30
    for source in cited:
        assert source in SOURCE, source


def test_every_module_of_the_methods_page_exists():
    page = text("docs/methods.md")
    rows = [row for row in page.split("\n") if row.startswith("| ") and "---" not in row]
    names = [n for row in rows for n in re.findall(r"`([\w.]+)`", row.rsplit("|", 2)[1])]
    assert len(names) > 40
    folder = Path(roomfit.__file__).parent
    for name in names:
        place = folder / name.replace(".", "/")
        assert place.is_dir() or place.with_suffix(".py").exists(), name


def test_what_every_extra_needs_is_locked():
    """What the lock lacks would not be what the tests ran with."""
    locked = set(re.findall(r"^([a-z0-9-]+)==", text("requirements/dev.txt"), re.MULTILINE))
    needed = {
        re.split(r"[<>=\[;! ]", package)[0].lower()
        for packages in PROJECT["optional-dependencies"].values()
        for package in packages
    }
    assert needed - locked - {"roomfit"} == set()
    assert "sounddevice" in needed
