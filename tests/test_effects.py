"""One conformance suite over every registered effect: a new effect is tested by existing.

Here the law and its equations; that MuJoCo agrees with them is held by ``tests/mjsim/test_crosscheck.py`` and the round trip
through MJCF by ``tests/mjsim/test_mjcf_write.py``, both over the registry as well.
"""

from __future__ import annotations

import ctypes
import dataclasses
import importlib
import inspect
import math
import re
from pathlib import Path

import numpy as np
import pytest

from diagnose.data.experiment import prepare
from diagnose.data.scales import scales_by_place
from diagnose.problem.hypothesis import make
from mjsim.axis import Axis
from mjsim.effects import Effect, NotApplicableError, ports, register, registered
from mjsim.effects.law import N_LOCAL
from mjsim.mjcf import load_axis
from mjsim.models import shipped_model
from mjsim.ode import simulate
from mjsim.quantity import Motion, Quantity
from mjsim.recording import Recording
from mjsim.system import assemble

DT = 5e-4
TIME = DT * np.arange(4000)
TORQUE = 2.0 * np.sin(2 * np.pi * (0.5 * TIME + 0.25 * 29.5 / TIME[-1] * TIME**2))

CASES = [(name, place) for name, cls in registered().items() for place in cls.places]
KEYS = [f"{name}@{place}" for name, place in CASES]
every_place = pytest.mark.parametrize(("name", "place"), CASES, ids=KEYS)
# code is compiled for limits at each number of bodies: `make proof` runs that of stops on this chain of three, which a single
# inertia has below
few_kernels = pytest.mark.parametrize(
    ("name", "place"), [pytest.param(*c, marks=pytest.mark.slow) if c[0].endswith("joint_stop") else c for c in CASES], ids=KEYS
)
every_effect = pytest.mark.parametrize("cls", registered().values(), ids=registered())


@pytest.fixture(scope="module")
def axis():
    return load_axis(shipped_model("robot_axis1"))


@pytest.fixture(scope="module")
def driven(axis):
    """The axis by a torque and, for what a servo has, under a position servo; each with its run and its scales."""
    from mjsim.servo import Servo

    servo = Axis(dataclasses.replace(axis.chain, servo=Servo(1.0, 0.1)))
    out = []
    for carrier, command in ((axis, None), (servo, TORQUE)):
        run = simulate(carrier, TORQUE, DT)
        velocity = run.velocity + 0.02 * np.random.default_rng(0).standard_normal(len(TIME))
        log = Recording(TIME, TORQUE, velocity, run.angle, DT, command=command)
        of = scales_by_place(carrier, prepare(log))
        low, high = np.quantile(run.angle, (0.2, 0.8))
        stops = ((-1, float(low), 0.02), (1, float(high), 0.02))
        out.append((carrier, run, {place: dataclasses.replace(s, orders=(1.0, 3.0), stops=stops) for place, s in of.items()}))
    return out


@pytest.fixture
def carrier(request, driven):
    """(axis, run, scales) of the drive that the effect of this test has a place on."""
    name = request.node.callspec.params.get("name", "")
    cls = registered().get(name) or request.node.callspec.params.get("cls")
    if cls is not None and cls.family == "servo":
        return driven[1]
    return driven[0]


@pytest.fixture
def scales(carrier):
    return carrier[2]


@pytest.fixture
def nominal(carrier):
    return carrier[1]


def rms(x):
    return float(np.sqrt(np.mean(np.square(x))))


def scaled(effect, factor):
    return effect.with_values({n: factor * effect.values[n] for n in type(effect).amplitudes})


def laws(effect, chain):
    return [(p.law, p.p) for p in effect.ports(chain) if hasattr(p, "law")]


@every_effect
def test_it_says_what_it_is(cls):
    assert re.fullmatch(r"[a-z]+(_[a-z]+)*", cls.id)
    module = importlib.import_module(cls.__module__)
    assert Path(module.__file__).stem == cls.id, "one effect, one file, one name"
    assert re.search(r"[=<>]", module.__doc__), "the formula stands in the module's text"
    assert re.search(r"\d{4}", cls.citation), "a citation has a year"
    assert dataclasses.is_dataclass(cls)
    assert cls.__dataclass_params__.frozen
    assert set(cls.places) <= {"motor", "gearbox", "arm", "actuator", "sensor"}
    assert set(cls.refines) <= set(registered())
    assert cls.id not in cls.refines
    assert set(cls.amplitudes) <= {s.name for s in cls.specs()}
    assert set(cls.sizes or ()) <= {s.name for s in cls.specs()}
    assert 0 < cls.tolerance <= 1e-2
    assert inspect.getmodule(cls).__all__ == [cls.__name__]


@every_effect
def test_parameters_have_units_bounds_and_meaning(cls):
    assert cls.specs()
    for spec in cls.specs():
        assert isinstance(spec.quantity, Quantity)
        assert spec.unit(Motion.HINGE)
        assert spec.unit(Motion.SLIDE)
        assert spec.lower < spec.upper
        assert spec.about


@every_place
def test_it_starts_from_scales(name, place, scales):
    for values in registered()[name].starts(scales[place]):
        assert make(name, place, values).place == place


@every_place
def test_bounds_are_enforced(name, place, scales):
    effect = make(name, place, registered()[name].starts(scales[place])[0])
    for spec in effect.specs():
        for bound, outside in ((spec.lower, -1.0), (spec.upper, 1.0)):
            if math.isfinite(bound):
                with pytest.raises(ValueError, match=spec.name):
                    effect.with_values({spec.name: bound + outside * (1e-3 + abs(bound))})
        with pytest.raises(ValueError, match=spec.name):
            effect.with_values({spec.name: math.nan})


@every_effect
def test_an_unknown_place_names_the_choices(cls, scales):
    values = cls.starts(scales[cls.places[0]])[0]
    with pytest.raises(ValueError, match=cls.places[0]):
        cls(place="elsewhere", **values)


@every_place
@pytest.mark.parametrize("motion", Motion)
def test_its_sentence_is_plain(name, place, motion, scales):
    effect = make(name, place, registered()[name].starts(scales[place])[0])
    said = effect.describe(motion)
    assert not set("{}") & set(said)
    assert said.endswith(".")
    assert len(said) > 20


@every_place
def test_its_law_is_the_same_in_python_and_compiled(name, place, carrier, scales):
    """Same numbers from both, on random local quantities; differences are those of the mathematical library (last bits)."""
    axis = carrier[0]
    effect = make(name, place, registered()[name].starts(scales[place])[0])
    rng = np.random.default_rng(1)
    for law, p in laws(effect, axis.chain):
        compiled = ctypes.CFUNCTYPE(None, *(3 * [ctypes.POINTER(ctypes.c_double)]))(law.address)
        parameters = (ctypes.c_double * max(len(p), 1))(*p)
        for _ in range(50):
            z = (10.0 ** rng.uniform(-3, 1, N_LOCAL) * rng.choice([-1.0, 1.0], N_LOCAL)).tolist()
            z[0] = abs(z[0])
            z[3] = float(np.sign(z[3]))
            plain, fast = [0.0, 0.0, 0.0], (ctypes.c_double * 3)()
            law(z, p, plain)
            compiled((ctypes.c_double * N_LOCAL)(*z), parameters, fast)
            np.testing.assert_allclose(fast, plain, rtol=1e-12, atol=1e-300)


@every_place
def test_its_slope_is_its_derivative(name, place, carrier, scales):
    """A twist and a changed inertia write their slope over the angle; central differences agree."""
    axis = carrier[0]
    effect = make(name, place, registered()[name].starts(scales[place])[0])
    for port in effect.ports(axis.chain):
        if not isinstance(port, ports.Twist | ports.BodyInertia):
            continue
        h = 1e-5
        for angle in np.linspace(-3, 3, 13):
            values = []
            for at in (angle - h, angle, angle + h):
                z, out = [0.0, at, 0.0, 1.0, 0.0, at, 0.0, 0.0], [0.0, 0.0, 0.0]
                port.law(z, port.p, out)
                values.append(out)
            slope = (values[2][0] - values[0][0]) / (2 * h)
            assert values[1][1] == pytest.approx(slope, rel=1e-6, abs=1e-9 * abs(port.p[0]))


@every_place
def test_friction_never_drives(name, place, carrier, scales):
    """The sliding and the breakaway level are not negative, in either direction, at any state."""
    axis = carrier[0]
    effect = make(name, place, registered()[name].starts(scales[place])[0])
    rng = np.random.default_rng(2)
    for port in effect.ports(axis.chain):
        if isinstance(port, ports.Friction):
            for _ in range(200):
                z = (10.0 ** rng.uniform(-3, 2, N_LOCAL) * rng.choice([-1.0, 1.0], N_LOCAL)).tolist()
                z[0], z[3] = abs(z[0]), float(np.sign(z[3]))
                out = [0.0, 0.0, 0.0]
                port.law(z, port.p, out)
                assert out[0] >= 0
                assert out[1] >= 0


@few_kernels
def test_it_runs_on_the_axis_and_converges(name, place, carrier, nominal, scales):
    """The default number of steps a sample and eight times as many agree within half the tolerance that the effect declares."""
    axis = carrier[0] + make(name, place, registered()[name].starts(scales[place])[0])
    run = simulate(axis, TORQUE, DT)
    assert np.all(np.isfinite(run.velocity))
    assert np.all(np.isfinite(run.angle))
    assert rms(run.velocity - nominal.velocity) > 1e-6 * rms(nominal.velocity), "an effect of the size of its start is seen"
    steps = assemble(axis).substeps(DT, float(np.max(np.abs(run.velocity))))
    fine = simulate(axis, TORQUE, DT, substeps=min(8 * steps, 64))
    assert rms(run.velocity - fine.velocity) <= 0.5 * max(type(axis.effects[0]).tolerance, 2e-5) * rms(fine.velocity)


@every_place
def test_its_response_vanishes_with_its_amplitude(name, place, carrier, nominal, scales):
    cls, axis = registered()[name], carrier[0]
    if not cls.amplitudes:
        pytest.skip("no amplitude scales its response")
    effect = make(name, place, cls.starts(scales[place])[0])
    whole = rms(simulate(axis + effect, TORQUE, DT).velocity - nominal.velocity)
    thousandth = rms(simulate(axis + scaled(effect, 1e-3), TORQUE, DT).velocity - nominal.velocity)
    assert thousandth < 5e-3 * whole
    if all(s.lower <= 0 for s in cls.specs() if s.name in cls.amplitudes):
        zero = simulate(axis + scaled(effect, 0.0), TORQUE, DT).velocity
        # an axis with a nonlinear port takes another integrator than a linear one: the engine's error remains
        assert rms(zero - nominal.velocity) < 5e-6 * rms(nominal.velocity)


@every_place
def test_it_has_a_place_or_says_so_on_a_single_inertia(name, place, scales):
    """On the EMPS slide an effect either runs or raises NotApplicableError: nothing in between."""
    axis = load_axis(shipped_model("emps"))
    effect = make(name, place, registered()[name].starts(scales[place])[0])
    try:
        velocity = simulate(axis + effect, 10.0 * TORQUE[:400], 1e-3).velocity
    except NotApplicableError:
        velocity = np.zeros(1)
    assert np.all(np.isfinite(velocity))


def test_effects_compose_by_addition(axis):
    one = make("coulomb_friction", "motor", {"torque_Nm": 0.1})
    two = make("backlash", "gearbox", {"gap_rad": 5e-4})
    both = axis + one + two
    assert axis.effects == ()
    assert both.effects == (one, two)
    assert both.without(one.key) == axis + two
    with pytest.raises(ValueError, match="twice"):
        axis + one + one
    with pytest.raises(KeyError, match="backlash@gearbox"):
        both.without("backlash@arm")
    with pytest.raises(TypeError):
        axis + 1.0


def test_a_duplicate_in_the_registry_raises():
    cls = registered()["coulomb_friction"]
    with pytest.raises(ValueError, match="registered twice"):
        register(cls)


def test_the_contract_is_covered():
    contract = {
        "coulomb_friction": "motor gearbox arm", "static_friction": "motor", "stribeck_friction": "motor",
        "asymmetric_friction": "motor",
        "quadratic_friction": "motor", "presliding_friction": "motor", "load_dependent_friction": "motor gearbox",
        "friction_drift": "motor", "position_dependent_friction": "motor", "backlash": "gearbox arm",
        "hardening_stiffness": "gearbox arm", "hysteresis": "gearbox arm", "transmission_error": "gearbox",
        "torque_ripple": "motor", "torque_offset": "motor", "gravity_load": "arm",
        "extra_flexible_mode": "arm", "position_dependent_inertia": "arm",
        "torque_gain_droop": "actuator", "actuator_saturation": "actuator", "actuator_deadzone": "actuator",
        "actuator_lag": "actuator", "time_delay": "actuator sensor", "sensor_lag": "sensor", "sensor_quantisation": "sensor",
        "sensor_offset": "sensor", "servo_deadband": "actuator", "velocity_limit": "actuator", "torque_speed_limit": "actuator",
        "sublinear_viscous_friction": "motor",
    }  # fmt: skip
    assert {k: set(v.split()) for k, v in contract.items()} == {k: set(registered()[k].places) for k in contract}


def test_nothing_in_an_effect_can_be_changed(axis):
    effect = make("coulomb_friction", "motor", {"torque_Nm": 0.1})
    with pytest.raises(dataclasses.FrozenInstanceError):
        effect.torque_Nm = 0.2
    assert isinstance(effect, Effect)
    assert isinstance(axis, Axis)
