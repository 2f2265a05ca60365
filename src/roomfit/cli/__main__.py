"""``python -m roomfit.cli``."""

from roomfit.cli import main

main()
