"""``python -m roomfit``."""

from __future__ import annotations

from roomfit.cli import main

main()
