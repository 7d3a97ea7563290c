"""``simgap schema``: the JSON Schema of ``diagnosis.json``."""

from __future__ import annotations

import click

__all__ = ["command"]


@click.command("schema", epilog="Example: simgap schema > diagnosis.schema.json")
def command() -> None:
    """Print the JSON Schema (draft 2020-12) of diagnosis.json."""
    import json

    from diagnose.report.schema import diagnosis_schema

    click.echo(json.dumps(diagnosis_schema(), indent=2))
