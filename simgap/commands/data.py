"""``simgap data``: find a public recording of a real machine here, or download it, and verify its SHA-256."""

from __future__ import annotations

import hashlib
import json
import os
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from shlex import quote

import click

from simgap.arguments import need_folder

__all__ = ["DATA_SETS", "DataSet", "PublicFile", "command", "fetch", "files_of", "locate"]


@dataclass(frozen=True)
class PublicFile:
    """A file that is pinned: its name, size [bytes] and SHA-256, what it is for, and where it can be fetched (None: by hand)."""

    name: str
    size: int
    sha256: str
    role: str
    url: str | None = None


@dataclass(frozen=True)
class DataSet:
    """A public data set: who made it, under which terms, where it stands, the shipped model that it belongs to, its files."""

    name: str
    about: str
    source: str
    terms: str
    model: str
    files: tuple[PublicFile, ...]


_EMPS = "https://raw.githubusercontent.com/forgi86/sysid-neural-continuous/93afc131780fb1d5477472935a18ac8405683890/examples/EMPS/data/"

DATA_SETS = {
    d.name: d
    for d in (
        DataSet(
            "emps",
            "Electro-mechanical positioning system: a carriage on a ball screw, position control (Janot, Gautier, Brunot 2019)",
            "nonlinearbenchmark.org; copies in https://github.com/forgi86/sysid-neural-continuous (examples/EMPS/data) and "
            "https://github.com/wmkouw/NSI-EMPS",
            "the authors state no licence for the data: fetched to your machine, not shipped",
            "emps",
            (
                PublicFile("DATA_EMPS.mat", 626039, "6cf6814ae14618795da0101aae2bb97ff0c6351b0501b5492751b02b07facf7e",
                           "estimation", _EMPS + "DATA_EMPS.mat"),
                PublicFile("DATA_EMPS_PULSES.mat", 630990, "0eab75bb1f6b16228ee78791343a88bf9bfd9a51036ac9807d7b5fc11c0e1704",
                           "held-out", _EMPS + "DATA_EMPS_PULSES.mat"),
            ),
        ),
        DataSet(
            "kuka_kr300",
            "KUKA KR300 R2500, six axes under position control (Weigand, Ulmen, Janot, Ruskowski 2021)",
            "https://github.com/JonasWeigand/Robot_Identification, recordings '2020-10-21 10s FF A' and 'FF B'",
            "MIT",
            "kuka_kr300_axis1",
            (
                PublicFile("rec_FF_A.mat", 1816588, "4c152c5b7f2c899731fdeebcf0d011cc103df72be19fac160caf47aa9b73ab75",
                           "estimation"),
                PublicFile("rec_FF_B.mat", 1808746, "edeb35f65c4ec4bb697e757fc1e4e9668551b6fe7b2c3dbbb526d040dd8d5ce7",
                           "held-out"),
            ),
        ),
    )
}  # fmt: skip


def _cache() -> Path:
    """Where fetched files are kept."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "simgap" / "data"


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _files(folder: Path, suffix: str) -> Iterator[Path]:
    """Files of a kind below a folder, in a fixed order."""
    for root, directories, names in os.walk(folder):
        directories.sort()
        for name in sorted(names):
            if name.endswith(suffix):
                yield Path(root) / name


def locate(file: PublicFile, folder: Path) -> Path | None:
    """The file below a folder, by its content: whatever it is called there. None when it is not there.

    Raises InputError when a file of its name is there and none of its content.
    """
    from mjsim.errors import InputError

    namesake: Path | None = None
    for path in _files(folder, Path(file.name).suffix):
        if path.stat().st_size == file.size and _sha256(path) == file.sha256:
            return path
        if path.name == file.name:
            namesake = path
    if namesake is not None:
        raise InputError(
            namesake, f"SHA-256 {_sha256(namesake)[:16]}...", f"{file.sha256[:16]}... ({file.size} bytes)",
            "fetch the file again: this one is another or was changed",
        )  # fmt: skip
    return None


def fetch(file: PublicFile, data_set: DataSet, folder: Path) -> Path:
    """Download a file to a folder; it stands there under its name only when its hash is right. Raises InputError."""
    from ident.serial import write_atomic
    from mjsim.errors import InputError

    by_hand = f"download it by hand from {data_set.source}, then simgap data {data_set.name} --from DIR"
    if file.url is None:
        raise InputError(file.name, "not on this machine, and it has no download address", "a local copy", by_hand)
    try:
        with urllib.request.urlopen(file.url, timeout=60) as answer:
            content = answer.read(4 * file.size)
    except (OSError, ValueError) as error:
        raise InputError(file.url, f"cannot be fetched ({error})", "the network", by_hand) from None
    digest = hashlib.sha256(content).hexdigest()
    if digest != file.sha256:
        raise InputError(file.url, f"SHA-256 {digest[:16]}...", f"{file.sha256[:16]}...", f"the source has changed; {by_hand}")
    try:
        write_atomic(folder / file.name, content)
    except OSError as error:
        raise InputError(folder, f"cannot be written ({error.strerror})", "a writable folder", "choose another --to") from None
    return folder / file.name


def _folders(given: Path | None) -> list[Path]:
    """Where to look: --from alone when it is given, else SIMGAP_DATA and the cache."""
    from mjsim.errors import InputError

    if given is not None:
        if not given.is_dir():
            raise InputError(given, "no such folder", "the folder that holds the recordings", "correct --from")
        return [given]
    named = os.environ.get("SIMGAP_DATA")
    if named and not Path(named).is_dir():
        raise InputError(f"SIMGAP_DATA={named}", "no such folder", "the folder that holds the recordings", "correct or unset it")
    return [p for p in (Path(named) if named else None, _cache()) if p is not None and p.is_dir()]


def files_of(data_set: DataSet, source: Path | None = None, to: Path | None = None) -> dict[str, Path]:
    """The files of a data set by their role: below ``source`` when that is given, else on this machine, else fetched to ``to``.

    Raises InputError when one is in none of these places.
    """
    from mjsim.errors import InputError

    folders = _folders(source)
    found: dict[str, Path] = {}
    for file in data_set.files:
        places = (p for p in (locate(file, folder) for folder in folders) if p is not None)
        path = next(places, None)
        if path is None and source is not None:
            raise InputError(
                source, f"{file.name} is not there", f"a file of SHA-256 {file.sha256[:16]}...", f"from {data_set.source}"
            )
        found[file.role] = path or fetch(file, data_set, to or _cache())
    return found


@click.command("data", epilog="Example: simgap data emps --from downloads/")
@click.argument("name", required=False, shell_complete=lambda _, __, typed: [n for n in DATA_SETS if n.startswith(typed)])
@click.option(
    "--from", "source", type=click.Path(path_type=Path), help="Folder that holds a local copy (searched with its subfolders)."
)
@click.option("--to", type=click.Path(path_type=Path), help="Folder for downloads (default: the user's cache).")
@click.option("--list", "listing", is_flag=True, help="List the data sets.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def command(name: str | None, source: Path | None, to: Path | None, listing: bool, as_json: bool) -> None:
    """Find or download the recordings of the public data set NAME and verify their SHA-256.

    Searches --from, else the folder that the environment variable SIMGAP_DATA names and the cache. Files that are in none of
    these are downloaded from their public repository.
    """
    from mjsim.errors import InputError, nearest
    from mjsim.models import shipped_model

    if listing:
        if as_json:
            click.echo(json.dumps({d.name: {"about": d.about, "source": d.source, "terms": d.terms} for d in DATA_SETS.values()}))
        for d in () if as_json else DATA_SETS.values():
            click.echo(f"{d.name:12s} {d.about}\n{'':12s} from {d.source}\n{'':12s} terms: {d.terms}")
        return
    if name is None:
        raise click.UsageError("name a data set (simgap data --list shows them)")
    if name not in DATA_SETS:
        raise InputError(f"data set {name!r}", "not known", f"one of {', '.join(DATA_SETS)}", nearest(name, DATA_SETS))
    data_set = DATA_SETS[name]
    if to is not None:
        need_folder(to, "choose another --to")
    found = files_of(data_set, source, to)
    model = shipped_model(data_set.model)
    if as_json:
        files = [{"file": str(found[f.role]), "role": f.role, "sha256": f.sha256} for f in data_set.files]
        click.echo(json.dumps({"name": name, "model": str(model), "terms": data_set.terms, "files": files}, indent=2))
        return
    click.echo(data_set.about)
    for file in data_set.files:
        click.echo(f"  {file.role:11s} {found[file.role]}   SHA-256 verified")
    click.echo(f"  terms: {data_set.terms}")
    options = f"--held-out {quote(str(found['held-out']))} --model {data_set.model} --out out/{name}"
    click.echo(f"Next: simgap diagnose {quote(str(found['estimation']))} {options}")
