"""Logs in inches and pounds."""

from __future__ import annotations

import numpy as np
import pytest

from mjsim.binding import SI_UNITS, UNITS
from mjsim.recording import load


@pytest.mark.parametrize(
    ("unit", "si"),
    [("in", 0.0254), ("ft/s", 0.3048), ("kip", 4448.22), ("lbf", 4.44822), ("lbf in", 0.112985), ("ozf in", 7.06155e-3),
     ("lbf ft", 1.35582), ("kgf cm", 0.0980665), ("rev/s", 6.28319)],
)  # fmt: skip
def test_the_factor_of_a_unit(unit, si):
    assert UNITS[unit][0] == pytest.approx(si, rel=1e-5)


def test_every_unit_has_its_si():
    assert set(UNITS) <= set(SI_UNITS)


def test_a_cylinder_in_inches_and_kips(tmp_path):
    t = np.arange(300) / 100
    table = np.column_stack([t, np.sin(t), 3 * np.cos(t), 2 * np.sin(t)])
    path = tmp_path / "log.csv"
    np.savetxt(path, table, delimiter=",", header="t,load,stroke,rate", comments="")
    units = 'time = "t"\ntorque = {column = "load", unit = "kip"}\nangle = {column = "stroke", unit = "in"}\n'
    (tmp_path / "log.toml").write_text(f'[recording]\n{units}velocity = {{column = "rate", unit = "in/s"}}\n', encoding="utf-8")
    r = load(path)
    assert r.torque == pytest.approx(4448.2216152605 * np.sin(t))
    assert r.angle == pytest.approx(0.0762 * np.cos(t))
    assert r.units["torque"] == "N"
    assert r.units["velocity"] == "m/s"
