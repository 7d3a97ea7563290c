"""``simgap app``: the flow from model to results in the browser."""

from __future__ import annotations

from pathlib import Path

import click

__all__ = ["command"]


@click.command("app", epilog="Example: simgap app --folder runs/")
@click.option(
    "--folder",
    default=Path("simgap-runs"),
    show_default=True,
    type=click.Path(path_type=Path),
    help="Folder that keeps the runs.",
)
@click.option("--port", default=0, type=click.IntRange(0, 65535), help="Port on 127.0.0.1; default: a free one.")
@click.option("--browser/--no-browser", default=True, show_default=True, help="Open the system's browser.")
def command(folder: Path, port: int, browser: bool) -> None:
    """Run all commands in the browser: model, recordings, check, diagnosis, results, others, runs side by side.

    The server answers on this machine only, to who has the address that is printed. Ctrl-C ends it; runs stay in the folder.
    """
    from simgap.arguments import take_folder

    take_folder(folder, "choose another --folder")
    try:
        import starlette  # noqa: F401
        import uvicorn  # noqa: F401
    except ImportError as error:
        from mjsim.errors import InputError

        raise InputError(
            "simgap app", f"the package {error.name!r} is not installed", "it", "pip install 'simgap[app]'"
        ) from None
    from simgap.app.serve import serve

    serve(folder, port, browser, lambda address: click.echo(f"simgap app: {address}\nCtrl-C ends it."))
