"""``python -m simgap`` is the command ``simgap``."""

from simgap.cli import main

main()
