"""``python -m lab.panel``."""

from lab.panel.cli import main

main()
