"""``python -m roomfit``."""

from __future__ import annotations

import os
import sys

# `python -m` looks for modules in the user's folder first: one called numba would be run
if not sys.flags.safe_path and sys.path and sys.path[0] == os.getcwd():  # noqa: PTH109
    del sys.path[0]

from roomfit.cli import main

main()
