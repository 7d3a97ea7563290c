"""``python -m lab.mutation``."""

from lab.mutation.cli import main

main()
