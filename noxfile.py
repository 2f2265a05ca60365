"""The matrix: ``nox`` runs the quick tests on every Python, ``nox -s lint docs`` the rest."""

from __future__ import annotations

import nox

PYTHONS = ("3.11", "3.12", "3.13")
nox.options.sessions = ["tests"]


@nox.session(python=PYTHONS)
def tests(session: nox.Session) -> None:
    """Run pytest with the locked dependencies; arguments after ``--`` go to it."""
    _install(session)
    session.run("python", "-m", "pytest", *(session.posargs or ["-m", "not slow"]))


@nox.session(python=PYTHONS[0])
def lint(session: nox.Session) -> None:
    """Check format, lint, types and layers."""
    _install(session)
    session.run("ruff", "format", "--check", ".")
    session.run("ruff", "check", ".")
    session.run("mypy")
    session.run("lint-imports")


@nox.session(python=PYTHONS[0])
def docs(session: nox.Session) -> None:
    """Build the documentation into docs/_build/html."""
    _install(session)
    session.run("python", "-m", "sphinx", "-W", "-b", "html", "docs", "docs/_build/html")


def _install(session: nox.Session) -> None:
    session.install("--require-hashes", "-r", "requirements/build.txt")
    session.install("--require-hashes", "-r", "requirements/dev.txt")
    session.install("--no-deps", "--no-build-isolation", "-e", ".")
