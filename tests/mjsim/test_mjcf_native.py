"""Native values: every effect is written as values, and what a file says by its own elements is read as the same values."""

from __future__ import annotations

import dataclasses
import itertools
import math
from pathlib import Path

import mujoco
import numpy as np
import pytest

from mjsim.axis import Axis
from mjsim.effects import BacklashLaw, NotApplicableError, effect_class, native, registered
from mjsim.errors import InputError
from mjsim.mjcf import load_axis, load_model, write_corrected
from mjsim.mjcf.native_read import read_native
from mjsim.models import shipped_model
from mjsim.mujoco_run import run_literal
from mjsim.ode import simulate

PLACED = [(name, place) for name, cls in registered().items() for place in cls.places]
VALUES = {
    "gap_rad": 5e-4, "inertia_kgm2": 0.5, "stiffness_Nm_rad": 2.5e3, "peak": 2.0, "cycles_per_rev": 8.0, "time_constant_s": 0.004,
    "delay_s": 0.00321, "limit_Nm": 0.8, "torque_Nm": 0.1 / 3, "coefficient_Nm_rad3": 1e8,
    "lower_rad": -0.3, "upper_rad": 0.4, "start_Nm": 0.0,  # of a run, which no file holds
}  # fmt: skip
IN_THE_CHAIN = (native.ViscousDamping, native.SplitBody, native.JointRange)  # a file that holds them is another chain
PENDULUM = (
    '<mujoco><compiler angle="radian"/><option timestep="5e-4" integrator="RK4" gravity="0 0 -9.81"/><worldbody>'
    '<body name="bob"><joint name="j" axis="0 1 0" damping="0.05"/>'
    '<inertial pos="0.02 0 -0.3" mass="1.2" diaginertia="0.02 0.02 0.003"/></body></worldbody>'
    '<actuator><motor name="u" joint="j"/></actuator>'
    '<sensor><jointvel name="motor_velocity" joint="j"/><jointpos name="motor_angle" joint="j"/></sensor></mujoco>'
)
SERVO = PENDULUM.replace(
    '<motor name="u" joint="j"/>',
    '<dcmotor name="u" joint="j" input="pos" motorconst=".5" resistance=".3" controller="8 0 .3 0 0 0"/>',
).replace("0.02 0 -0.3", "0 0 0")  # without a weight
CURVE = 0.8 * np.sin(2 * np.pi * 0.9 * 1e-3 * np.arange(1500))


@pytest.fixture(scope="module")
def nominal() -> Path:
    return shipped_model("robot_axis1")


@pytest.fixture(scope="module")
def home(nominal, tmp_path_factory):
    """``home(name)``: the file that has a place for an effect, one of a servo for those of servos, and its chain."""
    servo = tmp_path_factory.mktemp("servo") / "servo.xml"
    servo.write_text(SERVO)
    chains = {path: load_axis(path).chain for path in (nominal, servo)}

    def find(name: str):
        path = servo if effect_class(name).family == "servo" else nominal
        return path, chains[path]

    return find


@pytest.fixture
def pendulum(tmp_path) -> Path:
    (tmp_path / "pendulum.xml").write_text(PENDULUM)
    return tmp_path / "pendulum.xml"


def make(name: str, place: str):
    cls = effect_class(name)
    return cls(place=place, **{s.name: VALUES.get(s.name, max(0.0123, s.lower)) for s in cls.specs()})


def plain(path: Path) -> Path:
    """The file without what simgap carries in it."""
    text = path.read_text(encoding="utf-8")
    start, end = text.index("<custom>"), text.index("</custom>") + len("</custom>")
    out = path.with_name("plain.xml")
    out.write_text(text[:start] + text[end:], encoding="utf-8")
    return out


def numbers(value) -> list[float]:
    out = list(map(float, dataclasses.astuple(value)))
    if isinstance(value, native.Weight | native.Cogging):
        out[-1] = math.remainder(out[-1], 2 * math.pi)
    return out


def by_kind(values) -> list:
    return sorted(values, key=lambda v: type(v).__name__)


def relative(a, b) -> float:
    return float(np.sqrt(np.mean((a - b) ** 2) / np.mean(b**2)))


@pytest.mark.parametrize(("name", "place"), PLACED)
def test_what_is_written_natively_is_read_as_the_same_values(tmp_path, home, name, place):
    nominal, chain = home(name)
    effect = make(name, place)
    try:
        wanted = effect.native(chain)
    except NotApplicableError:
        pytest.skip("no such place")
    axis = Axis(chain, (effect,), BacklashLaw.UNGATED)
    written = write_corrected(nominal, axis, tmp_path / "corrected.xml")
    held = [v for v in wanted.values if not isinstance(v, (*IN_THE_CHAIN, native.Weight))]
    assert bool(written.lacks) == (bool(wanted.lacks) or any(isinstance(v, native.Weight) for v in wanted.values))
    model = load_model(plain(tmp_path / "corrected.xml"))
    found = read_native(model.found, model.path)
    assert [type(v) for v in by_kind(found)] == [type(v) for v in by_kind(held)]
    for a, b in zip(by_kind(found), by_kind(held), strict=True):
        assert numbers(a) == pytest.approx(numbers(b), rel=1e-9, abs=1e-12)


@pytest.mark.parametrize(("name", "place"), PLACED)
def test_an_effect_recognises_its_own_value_and_no_other_effect_does(home, name, place):
    _, chain = home(name)
    effect = make(name, place)
    for value in effect.native(chain).values:
        claimed = [e for e in (cls.read(value, chain) for cls in registered().values()) if e is not None]
        assert len(claimed) <= 1
        own = type(effect).read(value, chain)
        if own is not None:
            assert own.key == effect.key
            assert own.values == pytest.approx(effect.values, rel=1e-12)


READ = [(n, p) for n, p in PLACED if "read" in vars(effect_class(n)) and n != "gravity_load"]


@pytest.mark.parametrize(("name", "place"), READ)
def test_a_native_effect_is_loaded_without_what_simgap_carries(tmp_path, home, name, place):
    nominal, chain = home(name)
    axis = Axis(chain, (make(name, place),), BacklashLaw.UNGATED)
    write_corrected(nominal, axis, tmp_path / "corrected.xml")
    (back,) = load_axis(plain(tmp_path / "corrected.xml")).effects
    assert back.key == axis.effects[0].key
    assert back.values == pytest.approx(axis.effects[0].values, rel=1e-9)


@pytest.mark.parametrize(("name", "place"), [e for e in READ if e[0] != "backlash"])
def test_an_effect_of_the_authors_file_is_changed_in_its_place(tmp_path, home, name, place):
    """A correction that changes an effect of the file edits its element and adds no second one."""
    nominal, chain = home(name)
    first = Axis(chain, (make(name, place),), BacklashLaw.UNGATED)
    write_corrected(nominal, first, tmp_path / "corrected.xml")
    own = plain(tmp_path / "corrected.xml")
    read = load_axis(own)
    scaled = read.effects[0].with_values({n: 1.5 * read.effects[0].values[n] for n in type(read.effects[0]).amplitudes})
    write_corrected(own, dataclasses.replace(read, effects=(scaled,)), tmp_path / "again.xml")
    assert load_axis(tmp_path / "again.xml").effects == (scaled,)
    (back,) = load_axis(plain(tmp_path / "again.xml")).effects
    assert back.values == pytest.approx(scaled.values, rel=1e-9)
    assert load_model(tmp_path / "again.xml").mjmodel.nactuator == load_model(own).mjmodel.nactuator


OTHER_WEIGHTS = list(itertools.product((0.0, 0.05, 0.5, 0.9, 1.185, 3.0), (0.6, 1.0, 1.4), (0.0, 0.3)))  # weight, inertia, turn
QUICK = {(0.0, 0.6, 0.3), (0.05, 1.0, 0.0), (0.9, 0.6, 0.3), (1.185, 1.0, 0.0), (3.0, 1.4, 0.3)}


@pytest.mark.parametrize(
    ("weight", "inertia", "turn"), [w if w in QUICK else pytest.param(*w, marks=pytest.mark.slow) for w in OTHER_WEIGHTS]
)
def test_another_weight_acts_in_plain_mujoco(tmp_path, pendulum, weight, inertia, turn):
    axis = load_axis(pendulum)
    (gravity,) = axis.effects
    changed = gravity.with_values(
        {"torque_Nm": weight * gravity.values["torque_Nm"], "phase_rad": gravity.values["phase_rad"] + turn}
    )
    axis = Axis(axis.chain, (changed,)).with_linear({"Jm": inertia * axis.chain.bodies[0].inertia})
    assert write_corrected(pendulum, axis, tmp_path / "corrected.xml").lacks == ()
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "corrected.xml"))
    assert not np.any(model.body_gravcomp)
    run = run_literal(load_model(tmp_path / "corrected.xml"), CURVE, 1e-3)
    assert relative(run.velocity, simulate(axis, CURVE, 1e-3).velocity) < 1e-5


def test_a_weight_is_native_in_a_file_that_has_gravity_switched_off(tmp_path):
    own = tmp_path / "afloat.xml"
    own.write_text(PENDULUM.replace('gravity="0 0 -9.81"', 'gravity="0 0 0"'))
    axis = load_axis(own)
    assert axis.effects == ()
    heavier = Axis(axis.chain.with_linear({"Jm": 1.3 * axis.chain.bodies[0].inertia}), (make("gravity_load", "arm"),))
    assert write_corrected(own, heavier, tmp_path / "corrected.xml").lacks == ()
    run = run_literal(load_model(tmp_path / "corrected.xml"), CURVE, 1e-3)
    assert relative(run.velocity, simulate(heavier, CURVE, 1e-3).velocity) < 1e-5
    (again,) = load_axis(tmp_path / "corrected.xml").effects
    assert again.values == pytest.approx(heavier.effects[0].values)
    write_corrected(tmp_path / "corrected.xml", axis, tmp_path / "back.xml")
    assert not mujoco.MjModel.from_xml_path(str(tmp_path / "back.xml")).opt.gravity.any()


@pytest.mark.parametrize("degrees", [False, True])
def test_a_spring_to_the_ground_is_read_and_written(tmp_path, degrees):
    own = tmp_path / "held.xml"
    text = PENDULUM.replace('damping="0.05"', f'damping="0.05" stiffness="2.5" springref="{20.0 if degrees else 0.3}"')
    own.write_text(text.replace('angle="radian"', 'angle="degree"') if degrees else text)
    axis = load_axis(own)
    spring = next(e for e in axis.effects if e.key == "joint_spring@motor")
    rest = np.radians(20.0) if degrees else 0.3
    assert spring.values == pytest.approx({"stiffness_Nm_rad": 2.5, "torque_at_zero_Nm": 2.5 * rest})
    assert relative(run_literal(load_model(own), CURVE, 1e-3).velocity, simulate(axis, CURVE, 1e-3).velocity) < 1e-5
    other = axis.with_values({f"{spring.key}.stiffness_Nm_rad": 4.0, f"{spring.key}.torque_at_zero_Nm": -0.8})
    assert write_corrected(own, other, tmp_path / "corrected.xml").lacks == ()
    run = run_literal(load_model(tmp_path / "corrected.xml"), CURVE, 1e-3)
    assert relative(run.velocity, simulate(other, CURVE, 1e-3).velocity) < 1e-5


def test_a_weight_of_a_balanced_body_is_carried(tmp_path):
    own = tmp_path / "balanced.xml"
    own.write_text(PENDULUM.replace('gravity="0 0 -9.81"', 'gravity="0 0 0"').replace("0.02 0 -0.3", "0 0 0"))
    written = write_corrected(own, load_axis(own) + make("gravity_load", "arm"), tmp_path / "corrected.xml")
    assert len(written.lacks) == 1


def test_the_weight_along_a_slide_stays_when_its_mass_changes(tmp_path):
    own = tmp_path / "lift.xml"
    own.write_text(PENDULUM.replace('axis="0 1 0"', 'type="slide" axis="0 0 1"'))
    axis = load_axis(own)
    assert [e.key for e in axis.effects] == ["torque_offset@motor"]
    for factor in (0.7, 1.6):
        other = axis.with_linear({"Jm": factor * axis.chain.bodies[0].inertia})
        assert write_corrected(own, other, tmp_path / "corrected.xml").lacks == ()
        run = run_literal(load_model(tmp_path / "corrected.xml"), 12.0 * CURVE, 1e-3)
        assert relative(run.velocity, simulate(other, 12.0 * CURVE, 1e-3).velocity) < 1e-6


def test_constant_torques_of_the_file_and_of_an_effect_add_up(tmp_path, nominal):
    offset = effect_class("torque_offset")(torque_Nm=0.05)
    write_corrected(nominal, load_axis(nominal) + offset, tmp_path / "corrected.xml")
    own = plain(tmp_path / "corrected.xml")
    more = load_axis(own) + effect_class("asymmetric_friction")(torque_Nm=0.1, asymmetry_Nm=0.02)
    write_corrected(own, more, tmp_path / "again.xml")
    model = load_model(plain(tmp_path / "again.xml"))
    assert native.DriveTorque(pytest.approx(0.03)) in read_native(model.found, model.path)


def test_sensors_with_different_delays_are_refused(tmp_path, pendulum):
    pendulum.write_text(
        PENDULUM.replace('jointvel name="motor_velocity"', 'jointvel delay="0.01" nsample="30" name="motor_velocity"')
    )
    with pytest.raises(InputError, match="different delays"):
        load_axis(pendulum)
