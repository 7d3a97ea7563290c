"""Real machines: EMPS and the six axes of a KUKA KR300, judged by force, from inertia and viscous friction alone."""

from __future__ import annotations

import shutil
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from lab.panel.case import Case, Content
from lab.panel.local import local_copy
from lab.panel.shipped import copy_model
from lab.speed.kuka_other_axes import BINDING, FILES, MJCF

__all__ = ["machine_cases"]

# Published: asymmetric friction (or friction and an offset); a ripple of one turn of the screw stands in the residual.
EMPS: dict[str, Any] = {
    "verdicts": ["missing_physics"],
    "effects": [["asymmetric_friction", "torque_ripple"], ["coulomb_friction", "torque_offset", "torque_ripple"]],
}
# Published for axis 1: viscous and Coulomb friction. The others carry weights and each other's torques: no truth is known.
KUKA_1: dict[str, Any] = {"verdicts": ["missing_physics"], "effects": [["coulomb_friction"]]}


def _copy(data: str, names: tuple[str, ...], folder: Path) -> tuple[tuple[str, ...], tuple[str, ...]]:
    for name in names:
        shutil.copyfile(local_copy(data, name), folder / name)
    return names[:1], names[1:]


def _emps(folder: Path) -> Content:
    estimation, held_out = _copy("emps", ("DATA_EMPS.mat", "DATA_EMPS_PULSES.mat"), folder)
    return Content(estimation, held_out, copy_model("emps", folder), expected=EMPS)


def _kuka_1(folder: Path) -> Content:
    estimation, held_out = _copy("kuka_kr300", FILES, folder)
    return Content(estimation, held_out, copy_model("kuka_kr300_axis1", folder), expected=KUKA_1)


def _kuka(axis: int, folder: Path) -> Content:
    """An axis, counted from 1, from the a-priori inertia and viscous friction in the file itself."""
    from scipy.io import loadmat

    row = axis - 1
    estimation, held_out = _copy("kuka_kr300", FILES, folder)
    first = loadmat(folder / FILES[0], squeeze_me=True)
    priors = {name: float(np.asarray(first["para"][name].item())[row]) for name in ("u", "J_mr", "f_vis")}
    gear = abs(priors["u"])
    model = folder / f"axis{axis}.xml"
    text = MJCF.format(
        axis=axis, viscous=priors["f_vis"], rotor=priors["J_mr"] * gear**2, arm=first["m_all"][row].mean(), gear=gear
    )
    model.write_text(text, encoding="utf-8")
    model.with_suffix(".toml").write_text(BINDING.format(row=row), encoding="utf-8")
    return Content(estimation, held_out, model.name)


def machine_cases() -> list[Case]:
    """Seven cases."""
    kuka = [Case(f"kuka_axis{axis}", "real", "kuka", partial(_kuka, axis)) for axis in range(2, 7)]
    return [Case("emps", "real", "emps", _emps), Case("kuka_axis1", "real", "kuka", _kuka_1), *kuka]
