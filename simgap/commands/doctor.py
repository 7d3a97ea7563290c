"""``simgap doctor``: what the tool runs on: versions, rendering, cores, linear algebra, caches, compiled code."""

from __future__ import annotations

import json
import os
import platform
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import click

__all__ = ["command", "compile_all", "examine"]

BODIES = range(1, 5)  # of the axes whose simulation is compiled ahead: up to three inertias and a further mode

REQUIRED = ("mujoco", "numpy", "scipy", "numba", "matplotlib", "control", "pydantic", "click", "rich", "jinja2", "imageio-ffmpeg")
OPTIONAL = {  # package: what needs it, the extra that installs it
    "pyarrow": ("Parquet recordings and LeRobot data sets", "formats"), "mcap": ("MCAP recordings", "formats"),
    "mcap-ros2-support": ("ROS 2 in MCAP", "formats"), "rosbags": ("ROS bags", "formats"), "h5py": ("MATLAB 7.3", "formats"),
    "distributed": ("simgap fleet", "fleet"), "starlette": ("simgap app", "app"), "uvicorn": ("simgap app", "app"),
}  # fmt: skip


def examine() -> dict[str, Any]:
    """All that the command prints, as plain values; a part that fails says why in its own ``problem``."""
    parts = {
        "versions": _versions,
        "system": _system,
        "rendering": _rendering,
        "linear_algebra": _linear_algebra,
        "compiled": _compiled,
        "data": _data,
        "models": _models,
    }
    out: dict[str, Any] = {}
    for name, part in parts.items():
        try:
            out[name] = part()
        except Exception as error:  # the command must say what is broken, whatever is
            out[name] = {"problem": f"{type(error).__name__}: {error}"}
    return out


def _versions() -> dict[str, Any]:
    from simgap import __version__

    found: dict[str, Any] = {"simgap": __version__, "python": platform.python_version()}
    for name in (*REQUIRED, *OPTIONAL):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = None
    missing = [n for n in REQUIRED if found[n] is None]
    if missing:
        found["problem"] = f"not installed: {', '.join(missing)}"
    return found


def _system() -> dict[str, Any]:
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {"platform": platform.platform(), "processor": platform.machine(), "cores": os.cpu_count(), "usable_cores": usable,
            "python": sys.executable}  # fmt: skip


def _rendering() -> dict[str, Any]:
    import imageio_ffmpeg

    from mjsim.errors import InputError
    from mjsim.render.context import backend

    out: dict[str, Any] = {"backend": None, "ffmpeg": None}
    try:
        out["backend"] = backend()
    except InputError as error:
        out["problem"] = str(error)
    try:
        out["ffmpeg"] = imageio_ffmpeg.get_ffmpeg_version()
    except (OSError, RuntimeError) as error:
        out["problem"] = "; ".join([*filter(None, [out.get("problem")]), f"no ffmpeg ({error}): write .gif instead of .mp4"])
    return out


def _linear_algebra() -> dict[str, Any]:
    import numpy  # noqa: F401  (its BLAS is one of those that are listed)
    import scipy.linalg  # noqa: F401
    from threadpoolctl import threadpool_info

    libraries = [
        {"library": i["internal_api"], "version": i.get("version"), "kernel": i.get("architecture"), "threads": i["num_threads"],
         "file": Path(i["filepath"]).name}
        for i in threadpool_info() if i["user_api"] == "blas"
    ]  # fmt: skip
    return {"blas": libraries, "openblas_coretype": os.environ.get("OPENBLAS_CORETYPE")}


def _compiled() -> dict[str, Any]:
    from mjsim import kernel
    from mjsim.compiled import kept_at

    where = kept_at(kernel.integrate)
    if where is None:
        return {
            "folder": None, "files": 0, "megabytes": 0.0, "simulation": False,
            "NUMBA_CACHE_DIR": os.environ.get("NUMBA_CACHE_DIR"),
            "problem": "no folder can be written: every run compiles anew; set NUMBA_CACHE_DIR to a writable folder",
        }  # fmt: skip
    folder = Path(where)
    kept = list(folder.glob("*.nbc")) if folder.is_dir() else []
    stem = Path(str(kernel.__file__)).stem
    there = next(p for p in (folder, *folder.parents) if p.exists())
    out = {
        "folder": str(folder), "files": len(kept), "megabytes": round(sum(p.stat().st_size for p in kept) / 1e6, 1),
        "simulation": any(p.name.startswith(f"{stem}.integrate") for p in kept),
        "NUMBA_CACHE_DIR": os.environ.get("NUMBA_CACHE_DIR"),
    }  # fmt: skip
    if not os.access(there, os.W_OK):
        out["problem"] = f"{there} cannot be written: every run compiles anew; set NUMBA_CACHE_DIR to a writable folder"
    return out


def compile_all() -> None:
    """Compile the simulation of axes of one to four bodies, and of more, and keep it on disk; tells each on standard error."""
    import time

    from mjsim.ode import load_kernel

    for bodies in BODIES:
        began = time.monotonic()
        click.echo(f"simgap: simulation {bodies} of {BODIES[-1]} ...", err=True, nl=False)
        load_kernel(bodies)
        click.echo(f" {time.monotonic() - began:.0f} s", err=True)


def _data() -> dict[str, Any]:
    from simgap.commands.data import DATA_SETS, _cache

    return {"sets": list(DATA_SETS), "folder": str(_cache()), "SIMGAP_DATA": os.environ.get("SIMGAP_DATA")}


def _models() -> dict[str, Any]:
    from mjsim.models import models_directory, shipped_models

    return {"folder": str(models_directory()), "names": list(shipped_models())}


def _lines(found: dict[str, Any]) -> list[tuple[str, str]]:
    """The parts as rows of the table on the terminal."""
    v, s = found["versions"], found["system"]
    rows = [("simgap", f"{v['simgap']}, Python {v['python']} ({s['python']})")]
    rows.append(("packages", ", ".join(f"{n} {v[n] or 'MISSING'}" for n in REQUIRED)))
    for name, (use, extra) in OPTIONAL.items():
        rows.append((name, v[name] or f"not installed: needed for {use} (pip install 'simgap[{extra}]')"))
    rows.append(("system", f"{s['platform']}, {s['usable_cores']} of {s['cores']} cores usable"))
    r, c = found["rendering"], found["compiled"]
    if "backend" in r:
        rows.append(("rendering", f"{r['backend'] or 'none'}, ffmpeg {r['ffmpeg'] or 'none'}"))
    blas = found["linear_algebra"].get("blas", ())
    rows += [("BLAS", f"{b['library']} {b['version']}, kernel {b['kernel']}, {b['threads']} threads ({b['file']})") for b in blas]
    if "folder" in c:
        later = "not compiled yet: the first diagnosis takes one to three minutes longer; simgap doctor --compile does it now"
        state = "compiled" if c["simulation"] else later
        rows.append(("simulation", f"{state}; {c['files']} files, {c['megabytes']} MB in {c['folder']}"))
    if "folder" in found["data"]:
        rows.append(("recordings", f"{', '.join(found['data']['sets'])}; downloads in {found['data']['folder']}"))
    if "folder" in found["models"]:
        rows.append(("models", f"{', '.join(found['models']['names'])} in {found['models']['folder']}"))
    return rows


@click.command("doctor", epilog="Example: simgap doctor --json")
@click.option("--compile", "do_compile", is_flag=True, help="Compile the simulation now, for axes of one to four bodies.")
@click.option("--json", "as_json", is_flag=True, help="Print the report as JSON.")
def command(do_compile: bool, as_json: bool) -> None:
    """Report what simgap runs on, for a bug report or a slow or failing installation.

    Versions, cores, the OpenGL back end for films, the BLAS library and its kernel, the folder of the compiled simulation and
    whether it is compiled, the folder of downloads, the shipped models. Exit 1 when something that simgap needs is missing.
    """
    from mjsim.errors import CheckError
    from simgap.terminal import one_line, printable

    if do_compile:
        compile_all()
    found = examine()
    problems = [
        f"{name.replace('_', ' ')}: {one_line(part['problem']).removeprefix(f'{name}: ')}"
        for name, part in found.items()
        if "problem" in part
    ]
    if as_json:
        click.echo(json.dumps(found, indent=1))
    else:
        lines = _lines(found)
        width = max(len(name) for name, _ in lines)
        for name, text in lines:
            click.echo(printable(f"{name:{width}s}  {text}"))
    if problems:
        raise CheckError("; ".join(problems))
