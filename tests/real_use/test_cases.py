"""The lab's plain MuJoCo cases: the design is even, a log is its machine's, the score counts what it says."""

from __future__ import annotations

import dataclasses
from collections import Counter

import mujoco
import pytest

from lab.real_use.design import BLOCK, FACTORS, KINDS, Case, draw, kinds
from lab.real_use.logs import extent, follow, make
from lab.real_use.machines import nominal, text, true_numbers
from lab.real_use.run import read, write_files
from lab.real_use.score import Count, Outcome, outcome
from mjsim.effects.registry import registered


def test_every_block_is_even_and_a_prefix_is_the_same_cases():
    cases = draw(10 * BLOCK, 1)
    assert cases[:BLOCK] == draw(BLOCK, 1)
    for factor, levels in FACTORS.items():
        for block in range(10):
            rows = cases[block * BLOCK : (block + 1) * BLOCK]
            assert Counter(getattr(c, factor) for c in rows) == Counter(levels)
    pairs = Counter((c.machine, c.loop) for c in cases)
    assert min(pairs.values()) >= 8
    assert max(pairs.values()) <= 12
    for c in cases:
        assert c.kind in kinds(c.group, c.machine, c.loop)
        assert c.timestep * c.rate <= 1


def test_names_that_are_right_are_effects_of_the_library():
    assert {name for _, name, _, _ in KINDS.values() if name} <= set(registered())


@pytest.mark.parametrize("kind", KINDS)
def test_the_log_of_a_kind_is_its_machines_and_not_the_files(kind, monkeypatch):
    monkeypatch.setattr("lab.real_use.logs.SECONDS", {100.0: 8.0})
    group, _, machines, loops = KINDS[kind]
    machine = "slide" if kind == "stop" else machines[-1]
    case = Case(0, machine, "stiff", "implicitfast", 100.0, loops[-1], group, kind, 0.002, 5)
    given = nominal(case)
    truth = true_numbers(case, given, extent(case, text(case, given), given))
    log = make(case, text(case, truth), given, 1)
    assert follow(text(case, truth), case.rate, log) == pytest.approx(log.noise, rel=0.08)
    lost = follow(text(case, given), case.rate, log)
    assert lost == pytest.approx(log.noise, rel=0.08) if kind == "nothing" else lost > 1.3 * log.noise


def test_a_slack_joint_and_a_cam_compile_with_default_settings():
    for kind in ("slack_joint", "cam", "flexible_joint"):
        machine = KINDS[kind][2][0]
        case = Case(0, machine, "default", "RK4", 1000.0, "open", "effect", kind, 0.001, 3)
        given = nominal(case)
        truth = true_numbers(case, given, extent(case, text(case, given), given))
        assert mujoco.MjModel.from_xml_string(text(case, truth)).nv > 1


def test_files_and_records_are_read_back(tmp_path):
    (case,) = draw(1, 2)
    write_files(case, tmp_path / "case")
    names = {"nominal.xml", "true.xml", "estimation.csv", "held_out.csv"}
    assert {p.name for p in (tmp_path / "case").iterdir()} == names
    path = tmp_path / "records.jsonl"
    path.write_text('{"number": 3}\n{"number": 4', encoding="utf-8")
    assert list(read(path)) == [3]


def _record(**changes):
    case = dataclasses.asdict(Case(0, "slide", "stiff", "Euler", 100.0, "open", "effect", "drag", 0.001, 1))
    return {**case, "exit": 0, "verdict": "missing_physics", "found": ["quadratic_friction"], "equivalents": [], **changes}


def test_outcomes():
    assert outcome(_record()) == Outcome.RIGHT
    assert outcome(_record(verdict="unexplained")) == Outcome.VERDICT
    assert outcome(_record(found=[])) == Outcome.MISSED
    assert outcome(_record(found=["coulomb_friction"])) == Outcome.WRONG
    assert outcome(_record(found=["coulomb_friction", "quadratic_friction"])) == Outcome.MORE
    assert outcome(_record(exit=2)) == Outcome.ERROR
    assert outcome(_record(group="nothing", kind="nothing")) == Outcome.ALARM
    assert outcome(_record(group="nothing", kind="nothing", found=[], verdict="no_mismatch")) == Outcome.RIGHT
    assert outcome(_record(group="outside", kind="stop", found=[], verdict="unexplained")) == Outcome.MISSED
    for found in ("joint_stop", "upper_joint_stop"):
        assert outcome(_record(group="outside", kind="stop", found=[found], verdict="missing_physics")) == Outcome.RIGHT
    assert outcome(_record(group="outside", kind="stop")) == Outcome.WRONG
    assert outcome(_record(group="outside", kind="spring", found=["joint_spring"])) == Outcome.RIGHT


def test_wilsons_interval():
    low, high = Count(0, 50).interval
    assert low == 0
    assert high == pytest.approx(0.0713, abs=1e-3)
    assert Count(95, 100).interval == pytest.approx((0.888, 0.978), abs=1e-3)
