"""The one command, ``simgap``: a lazy group, so that ``--help`` starts without numba, MuJoCo or matplotlib."""

from __future__ import annotations

import atexit
import gc
import importlib
import sys

import click

from simgap import __version__

__all__ = ["main"]

# name -> one line of help; the code of a command is simgap/commands/<name>.py, attribute `command`.
COMMANDS: dict[str, str] = {
    "demo": "Conceal an effect, diagnose it from the recordings alone, open the envelope.",
    "diagnose": "Locate, name, model and prove the mismatch between recordings and a model.",
    "run": "Run a scenario, shipped or your own, and write its log.",
    "render": "Render the motion of a scenario or a model without a display.",
    "crosscheck": "Hold MuJoCo against the analytic equations, effect by effect.",
    "replay": "Run a model, found physics included, free on a recorded input.",
    "identify": "Filter, decimate and fit a Box-Jenkins model to a recording.",
    "data": "Locate or fetch a public real recording, proven by its hash.",
    "benchmark": "Conceal effects in many recordings, diagnose them, open the envelope, score.",
    "proof": "Diagnose real machines, beside their published values, and write the pages of the proof.",
    "study": "Draw the report's figures and give each of its claims a verdict.",
}


# Objects until the collector looks through the young ones, and its rounds until the older ones are looked at. What a command
# imports, and numba's tables of types, are 200 000 objects that stay: by Python's own 700 they were gone through 300 times.
COLLECT = (50_000, 20, 50)


class LazyGroup(click.Group):
    """A click group that imports a command's module when it is called, and lists the others from `COMMANDS`."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names in the order of the flow."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import ``simgap.commands.<cmd_name>`` and return its ``command``."""
        if cmd_name not in COMMANDS:
            return None
        loaded = importlib.import_module(f"simgap.commands.{cmd_name}").command
        assert isinstance(loaded, click.Command)
        return loaded

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="simgap")
def cli() -> None:
    """Find the physics that a robot simulation left out.

    Example: simgap diagnose log.csv --model models/robot_axis1.xml --held-out other.csv --out report/
    """


def main() -> None:
    """Run the command line; bad input is one line on standard error and exit 2, no traceback."""
    from mjsim.errors import CheckError, InputError

    gc.set_threshold(*COLLECT)
    atexit.register(gc.freeze)  # else the interpreter goes through every object once more as it ends: half a second
    try:
        code = cli.main(standalone_mode=False)
    except click.exceptions.Abort:
        click.echo("simgap: interrupted", err=True)
        sys.exit(130)
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except InputError as error:
        click.echo(f"simgap: {error}", err=True)
        sys.exit(2)
    except CheckError as error:
        click.echo(f"simgap: {error}", err=True)
        sys.exit(1)
    except KeyboardInterrupt:
        click.echo("simgap: interrupted", err=True)
        sys.exit(130)
    sys.exit(code if isinstance(code, int) else 0)


if __name__ == "__main__":
    main()
