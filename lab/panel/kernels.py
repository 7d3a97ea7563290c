"""The same cases under several kernels of the linear algebra: rounding differs, and no answer may.

OpenBLAS chooses its kernels by the processor, unless OPENBLAS_CORETYPE names them. Kernels of another processor add in another
order and with or without fused multiplication, as another machine would.
"""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from ident.serial import write_atomic
from lab.benchmark.resume import plain
from lab.panel.case import Case
from lab.panel.compare import Comparison, compare, markdown
from lab.panel.run import Setting, run_cases
from mjsim.errors import InputError

__all__ = ["KERNELS", "VARIABLE", "differs", "kernels_in_use", "under_kernels"]

KERNELS = ("Haswell", "Sandybridge")  # with fused multiplication and without
VARIABLE = "OPENBLAS_CORETYPE"
_ASK = "import numpy, threadpoolctl; print(*(i['architecture'] for i in threadpoolctl.threadpool_info() if 'architecture' in i))"


def kernels_in_use(name: str) -> str:
    """The kernels that NumPy computes with where ``name`` is asked for: those of an unknown processor are not taken."""
    said = subprocess.run(
        [sys.executable, "-c", _ASK], env={**os.environ, VARIABLE: name}, capture_output=True, text=True, check=True
    )
    return said.stdout.split()[0] if said.stdout.split() else "none"


def under_kernels(
    names: Sequence[str], cases: Sequence[Case], out: Path, setting: Setting, jobs: int, say: Callable[[str], None]
) -> dict[str, Comparison]:
    """Run the cases under each of the kernels; by kernels, the comparison with the first. Each run is resumed as any other.

    ``out/KERNELS/comparison.md`` says the changed answers, ``out/kernels.json`` all figures. Raises InputError where kernels are
    not those that were asked for, so that nothing would be compared.
    """
    for name in names:
        found = kernels_in_use(name)
        if found.lower() != name.lower():
            raise InputError(
                VARIABLE, f"{name} is asked for and {found} is used", "kernels that this OpenBLAS has", "name others"
            )
    records, compared = {}, {}
    for name in names:
        say(f"under the kernels of {name}")
        under = dataclasses.replace(setting, environment={**setting.environment, VARIABLE: name}, rule=name)
        records[name] = run_cases(cases, out / name, under, jobs, say).records
        if name != names[0]:
            compared[name] = compare(records[names[0]], records[name])
            write_atomic(out / name / "comparison.md", markdown(compared[name], names[0], name))
    said = {"commit": setting.tree.commit, "kernels": {name: c.as_dict() for name, c in compared.items()}}
    write_atomic(out / "kernels.json", json.dumps(plain(said), indent=1) + "\n")
    return compared


def differs(compared: Mapping[str, Comparison]) -> bool:
    """Whether a verdict or a name depends on the kernels, or more parameters than 95 % intervals leave out."""
    return any(c.changes or c.parameters_differ for c in compared.values())
