"""``simgap proof``: diagnose recordings of real machines and write a page with the results."""

from __future__ import annotations

from pathlib import Path

import click

from simgap.arguments import Choice, InputFile, OutputFolder, take_folder

__all__ = ["PAGES", "command"]

PAGES = ("emps", "kuka", "kuka_robot", "so101", "concealed", "summary")


@click.command("proof", epilog="Example: simgap proof emps --out out/proof")
@click.argument("name", type=Choice(PAGES))
@click.option("--out", required=True, type=OutputFolder(), help="Folder for the page, its pictures and its numbers.")
@click.option(
    "--from", "source", type=click.Path(path_type=Path),
    help="Folder with local copies of the recordings (default: where simgap data finds them).",
)  # fmt: skip
@click.option(
    "--benchmark",
    type=InputFile(".json", usual="benchmark.json"),
    help="benchmark.json of a simgap benchmark run, for the summary.",
)
@click.option(
    "--jobs", default=2, show_default=True, type=click.IntRange(1), help="Threads. The answer does not depend on their number."
)
@click.option("--json", "as_json", is_flag=True, help="Print the page's numbers as JSON.")
def command(name: str, out: Path, source: Path | None, benchmark: Path | None, jobs: int, as_json: bool) -> None:
    """Write one page of the proof; every number on it is computed by this command.

    emps, kuka: real machines compared with published values. kuka_robot: the KUKA's six axes by force. so101: six servos from
    command and position, from the Parquet files in the folder of --from. concealed: known physics removed from the model or
    added to real signals. summary: the results of all pages in OUT and of a benchmark.json, written as proof.md beside OUT; it
    names what was not run.
    """
    import json

    from lab.proof.page import plain, write_page

    take_folder(out)
    page = _made(name, out, source, benchmark, jobs)
    # the summary stands above the pages that it names
    path = write_page(page, out.resolve().parent, figures=False) if name == "summary" else write_page(page, out)
    click.echo(json.dumps(plain(page.figures), indent=1) if as_json else f"{page.text}\n{path}")


def _made(name: str, out: Path, source: Path | None, benchmark: Path | None, jobs: int):  # type: ignore[no-untyped-def]
    """The page of that name."""
    from simgap.commands.data import DATA_SETS, files_of

    def say(text: str) -> None:
        click.echo(text, err=True)

    if name == "summary":
        from lab.proof.summary import summary_page

        return summary_page(out, benchmark)
    if name == "so101":
        from lab.proof.so101 import so101_page

        return so101_page(_given(source), say)
    emps, kuka = DATA_SETS["emps"], DATA_SETS["kuka_kr300"]
    if name == "emps":
        from lab.proof.emps import emps_page

        return emps_page(files_of(emps, source), say, jobs)
    if name == "kuka":
        from lab.proof.kuka import kuka_page

        return kuka_page(files_of(kuka, source), say, jobs)
    if name == "kuka_robot":
        from lab.proof.kuka_robot import kuka_robot_page

        return kuka_robot_page(files_of(kuka, source), say)
    from lab.proof.concealed import concealed_page

    return concealed_page(files_of(emps, source), files_of(kuka, source), say, jobs)


def _given(source: Path | None) -> Path:
    """The folder of --from. Raises InputError without one."""
    from mjsim.errors import InputError

    if source is None or not source.is_dir():
        raise InputError("--from", "no folder of recordings", "the Parquet files of SO-101", "give their folder by --from")
    return source
