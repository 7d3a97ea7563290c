"""``python -m lab.fuzz``."""

from lab.fuzz.cli import main

main()
