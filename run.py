"""What scripts/install, scripts/demo and scripts/test do, where there is no shell (Windows).

python run.py install [--dev]      make .venv and install the locked dependencies into it
python run.py demo [ARGS ...]      simulate a measured room, identify it, print true beside found
python run.py test [ARGS ...]      check everything; --quick leaves out the slow tests
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parent
BIN = ROOT / ".venv" / ("Scripts" if os.name == "nt" else "bin")
PYTHON = BIN / ("python.exe" if os.name == "nt" else "python")
CHECKS = (("ruff", "format", "--check", "."), ("ruff", "check", "."), ("mypy",), ("lint-imports",))


def call(*command: str | Path, **environment: str) -> None:
    """Run a command in the repository; its exit code is ours where it fails."""
    done = subprocess.run(
        [str(part) for part in command], cwd=ROOT, env={**os.environ, **environment}, check=False
    )
    if done.returncode:
        sys.exit(done.returncode)


def install(dev: bool) -> None:
    """Make .venv where there is none, and install unless the same was installed before."""
    if sys.version_info < (3, 11):  # noqa: UP036 - this file may be run by any Python
        sys.exit(f"roomfit needs Python 3.11 or newer\n  found   {sys.version.split()[0]}")
    if not PYTHON.exists():
        venv.create(ROOT / ".venv", with_pip=True)
    lock = ROOT / "requirements" / ("dev.txt" if dev else "user.txt")
    content = lock.read_bytes() + (ROOT / "pyproject.toml").read_bytes()
    digest = hashlib.sha256(content).hexdigest()
    # the same stamps as scripts/install
    stamps = {name: ROOT / ".venv" / f".installed-{name}" for name in ("user", "dev")}
    wanted = "dev" if dev else "user"
    if stamps[wanted].exists() and stamps[wanted].read_text().strip() == digest:
        return
    pip = (PYTHON, "-m", "pip", "--disable-pip-version-check", "install", "--quiet")
    for needed in (ROOT / "requirements" / "build.txt", lock):
        call(*pip, "--require-hashes", "-r", needed)
    call(*pip, "--no-deps", "--no-build-isolation", "-e", ".")
    stamps[wanted].write_text(digest + "\n")


def main(arguments: list[str]) -> None:
    """Carry out one of the three commands."""
    command, rest = (arguments or [""])[0], arguments[1:]
    if command == "install" and set(rest) <= {"--dev"}:
        install(dev=bool(rest))
    elif command == "demo":
        install(dev=False)
        call(PYTHON, "-m", "roomfit", "demo", "--out", "out/demo", "--overwrite", *rest)
    elif command == "test":
        install(dev=True)
        few = {"NUMBA_NUM_THREADS": "2", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        quick = rest == ["--quick"]
        if not rest or quick:
            for name, *options in CHECKS:
                call(BIN / name, *options)
            rest = ["-n", "2", "--dist", "loadfile", "--no-loadscope-reorder"]
            rest += ["-m", "not slow"] if quick else []
        call(PYTHON, "-m", "pytest", *rest, MPLBACKEND="Agg", **few)
    else:
        sys.stderr.write(f"{__doc__}\n")
        sys.exit(2)


if __name__ == "__main__":
    main(sys.argv[1:])
