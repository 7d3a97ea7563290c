"""The one command, ``simgap``: a lazy group, so that ``--help`` starts without numba, MuJoCo or matplotlib."""

from __future__ import annotations

import atexit
import contextlib
import gc
import importlib
import os
import select
import signal
import sys
import warnings
from collections.abc import Iterator, MutableMapping
from typing import TYPE_CHECKING, Any

import click

from mjsim.notices import tell_compiling
from simgap import __version__
from simgap.terminal import file_error, one_line, printable

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

__all__ = ["main"]

HELP: Any = getattr(click.exceptions, "NoArgsIsHelpError", ())  # where no command is given; click < 8.2 ends the program itself
COMPILING = "simgap: compiling the simulation, once on this machine: this takes up to three minutes ..."
UNKEPT = (
    "simgap: compiling the simulation for this run alone, up to three minutes: no folder for compiled code can be written; "
    "set NUMBA_CACHE_DIR to one that can ..."
)
OWN = ("mjsim", "ident", "diagnose", "simgap", "lab")  # packages of this project
TRACEBACK = "SIMGAP_TRACEBACK"  # environment variable: show the traceback of a fault of simgap
LESS = "use a shorter recording or fewer --jobs, or allow more"
REPORT = "report it with the input: it is a fault of simgap"
TERMINATED = 143  # exit code of a program ended by SIGTERM, 128 + 15
CLOSED = 141  # exit code when nobody reads standard output any more: that of a program ended by SIGPIPE, 128 + 13

# name -> one line of help; the code of a command is simgap/commands/<name>.py, attribute `command`.
COMMANDS: dict[str, str] = {
    "demo": "Diagnose a simulated axis with a hidden effect and compare with the truth.",
    "check": "Say what was understood of model and log, and what is wrong with the log.",
    "diagnose": "Locate, name, model and prove the mismatch between recordings and a model.",
    "fleet": "Diagnose many recordings of many robots, on a Dask cluster: one table, one page.",
    "gate": "Fail when a model predicts recordings worse than a baseline diagnosis.",
    "run": "Simulate a scenario, shipped or your own, and write its log.",
    "render": "Film a model or a scenario without a display.",
    "crosscheck": "Compare MuJoCo with the analytic equations, effect by effect.",
    "replay": "Simulate a model, with the physics found in it, on a recorded input.",
    "identify": "Filter, decimate and fit a Box-Jenkins model to a recording.",
    "app": "All commands, and runs side by side, in the browser; on this machine only.",
    "effects": "List the effects that a diagnosis can name, or describe one.",
    "schema": "Print the JSON Schema of diagnosis.json, check.json or identification.json.",
    "data": "Find or download a public recording and verify its hash.",
    "benchmark": "Diagnose many simulated recordings with hidden effects and score the answers.",
    "proof": "Diagnose recordings of real machines and compare with published values.",
    "study": "Reproduce a published study's figures and judge each of its claims.",
    "doctor": "Report versions, rendering, cores, caches and compiled code.",
}


# Thresholds of the garbage collector. A command imports about 200 000 objects that stay (numba's type tables); with Python's
# own threshold of 700 they are scanned 300 times.
COLLECT = (50_000, 20, 50)


class _ClosedPipe(Exception):  # noqa: N818  (no error: nobody reads what is written)
    """A pipe was closed by its reader; click would end with exit code 1, which means here that a check failed."""


class _Termination(KeyboardInterrupt):
    """SIGTERM: ends a command as Ctrl-C does, so that temporary files go and fits are kept."""

    asked = False


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

    def invoke(self, ctx: click.Context) -> object:
        """As click does, but for closed pipes."""
        try:
            result = super().invoke(ctx)
            sys.stdout.flush()
            return result
        except BrokenPipeError as error:
            raise _ClosedPipe(file_error(error)) from None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))

    def resolve_command(self, ctx: click.Context, args: list[str]) -> tuple[str | None, click.Command | None, list[str]]:
        """As click does; an unknown name is told with the nearest known one."""
        name = args[0] if args else ""
        if name not in COMMANDS and not name.startswith("-"):
            from mjsim.errors import nearest

            ctx.fail(f"no command {name!r}; {nearest(name, COMMANDS, 'simgap --help lists the commands')}")
        return super().resolve_command(ctx, args)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Names of commands from `COMMANDS`, so that completing one imports none; options as click has them."""
        from click.shell_completion import CompletionItem

        if incomplete.startswith("-"):
            return super().shell_complete(ctx, incomplete)
        return [CompletionItem(name, help=about) for name, about in COMMANDS.items() if name.startswith(incomplete)]


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="simgap")
def cli() -> None:
    """Find the physics that a robot simulation left out.

    Example: simgap diagnose log.csv --model robot_axis1 --held-out other.csv --out report/

    A MODEL is an MJCF file or the name of a shipped model (simgap doctor lists them). Shell completion, for bash:
    eval "$(_SIMGAP_COMPLETE=bash_source simgap)"; for zsh and fish: zsh_source, fish_source.
    """


def main() -> None:
    """Run the command line; bad input is one line on standard error and exit 2, no traceback."""
    open_closed_streams()
    gc.set_threshold(*COLLECT)
    atexit.register(gc.freeze)  # without it the interpreter scans every object once more as it ends, which takes half a second
    defer_rendering(os.environ)
    refuse_numerical_warnings()
    tell_compiling(lambda kept: click.echo(COMPILING if kept else UNKEPT, err=True))
    with _ended_by_sigterm():
        code = _ended()
    with contextlib.suppress(OSError):
        if code == CLOSED:  # what is still buffered would raise once more as the interpreter ends
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    sys.exit(code)


@contextlib.contextmanager
def _ended_by_sigterm() -> Iterator[None]:
    """Let SIGTERM end the command as Ctrl-C does, with its own exit code; where this is not the main thread it is left alone."""

    def end(number: int, frame: object) -> None:
        _Termination.asked = True
        raise _Termination

    before = None
    with contextlib.suppress(ValueError):
        before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        if before is not None:
            signal.signal(signal.SIGTERM, before)


def _ended() -> int:
    """The exit code of the command, also where SIGTERM made it exit by itself."""
    try:
        return _outcome()
    except SystemExit as ended:
        if _Termination.asked:
            return _tell("terminated", TERMINATED)
        if isinstance(ended.__context__, BrokenPipeError):  # by which rich ends the process with code 1
            return CLOSED
        raise


def open_closed_streams() -> None:
    """Open the null device in place of standard streams that are closed (``>&-``): the next file would take their descriptors."""
    for descriptor, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free descriptor, which is this one
        if getattr(sys, name) is None:
            setattr(sys, name, open(descriptor, "r" if name == "stdin" else "w", encoding="utf-8", closefd=False))  # noqa: SIM115


def defer_rendering(environ: MutableMapping[str, str]) -> None:
    """Keep MuJoCo from loading the OpenGL library that MUJOCO_GL names until something is drawn.

    ``import mujoco`` fails when that library is missing, and most commands draw nothing. The choice is kept in
    `mjsim.render.context.CHOICE` (SIMGAP_GL), where the renderer reads it, as do processes started from here.
    """
    wanted = environ.get("MUJOCO_GL")
    if wanted is not None and wanted.lower() != "disable":
        environ["SIMGAP_GL"] = wanted
        environ["MUJOCO_GL"] = "disable"


def refuse_numerical_warnings() -> None:
    """Make a warning of NumPy out of this project's code (overflow, division by zero, NaN) an error: its result is no number.

    Warnings of other libraries' code stay warnings.
    """
    for package in OWN:
        warnings.filterwarnings("error", category=RuntimeWarning, module=rf"{package}\.")


def _outcome() -> int:
    """Run the command and tell what stopped it; the exit code."""
    from mjsim.errors import CheckError, InputError

    try:
        code = cli.main(standalone_mode=False)
        return code if isinstance(code, int) else 0
    except (click.exceptions.Abort, KeyboardInterrupt):
        return _tell("interrupted", 130)
    except HELP as error:
        click.echo(error.format_message(), err=True)
        return int(error.exit_code)
    except click.UsageError as error:
        return _tell(one_line(printable(_usage(error))), error.exit_code)
    except click.ClickException as error:
        return _tell(one_line(printable(error.format_message())), error.exit_code)
    except InputError as error:
        return _tell(one_line(str(error)), 2)
    except CheckError as error:
        return _tell(one_line(str(error)), 1)
    except _ClosedPipe as error:
        return CLOSED if _nobody_reads() else _tell(one_line(str(error)), 2)
    except OSError as error:
        return _tell(one_line(file_error(error)), 2)
    except Exception as error:
        if os.environ.get(TRACEBACK):
            raise
        return _fault(error)


def _fault(error: Exception) -> int:
    """Tell of what no part of the command expected: no memory, numbers that are none, a fault of simgap."""
    if isinstance(error, MemoryError):
        return _tell(one_line(f"not enough memory{f' ({error})' if str(error) else ''}; {LESS}"), 2)
    if isinstance(error, RuntimeWarning):
        return _tell(one_line(f"{error} in {_place_of(error)}; the numbers are no result; {REPORT}"), 1)
    return _tell(one_line(f"{type(error).__name__} in {_place_of(error)}: {error}; {REPORT} ({TRACEBACK}=1 shows more)"), 1)


def _place_of(error: BaseException) -> str:
    """Module and line in which an exception arose."""
    import traceback

    frame = traceback.extract_tb(error.__traceback__)[-1]
    return f"{'/'.join(frame.filename.split(os.sep)[-2:])}:{frame.lineno}"


def _usage(error: click.UsageError) -> str:
    """What is wrong with a command line, and the help that says what is right."""
    said = error.format_message().rstrip(".")
    said = said[:1].lower() + said[1:]
    path = error.ctx.command_path if error.ctx is not None else "simgap"
    where = path.removeprefix("simgap").strip()
    return f"{where + ': ' if where else ''}{said}; {path} --help has the options"


def _tell(line: str, code: int) -> int:
    """Say what stopped the command; after SIGTERM that is what did, whatever else broke in its wake."""
    if _Termination.asked:
        line, code = "terminated", TERMINATED
    with contextlib.suppress(OSError):
        click.echo(f"simgap: {line}", err=True)
    return code


def _nobody_reads() -> bool:
    """Whether the reading end of standard output is closed, as after ``| head``."""
    try:
        poll = select.poll()
        poll.register(sys.stdout.fileno(), select.POLLOUT)
        return any(event & select.POLLERR for _, event in poll.poll(0))
    except (OSError, ValueError, AttributeError):  # no descriptor, or no poll on this system
        return True


if __name__ == "__main__":
    main()
