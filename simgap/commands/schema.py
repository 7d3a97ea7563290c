"""``simgap schema``: the JSON Schemas of the files that commands write."""

from __future__ import annotations

import click

from simgap.arguments import Choice

__all__ = ["command"]


@click.command("schema", epilog="Example: simgap schema check > check.schema.json")
@click.argument("file", type=Choice(["diagnosis", "check", "identification"]), default="diagnosis")
def command(file: str) -> None:
    """Print the JSON Schema (draft 2020-12) of diagnosis.json, or of another FILE: check.json, identification.json.

    They are also those of what `diagnose`, `check` and `identify` print with `--json`.
    """
    import json

    from diagnose.report.schema import schema_of

    click.echo(json.dumps(schema_of(file), indent=2))
