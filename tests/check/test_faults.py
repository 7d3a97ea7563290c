"""One conformance suite over the registry, and a synthetic twin of every fault, just above and just below its threshold."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from diagnose.check import LogVerdict, Machine, Problem, Severity, check_log
from diagnose.check.context import Context
from diagnose.check.faults.spike import spikes
from diagnose.check.registry import check, checks
from diagnose.check.thresholds import ACTUATOR_DELAY, CLIPPED_SHARE, MODE_RATE, RANGE_FIX, SKEW_FIX
from mjsim.chain import Limit
from mjsim.mjcf import load_model
from mjsim.models import shipped_model


def names(result) -> set[str]:
    return {p.problem for p in result.problems}


def only(result, problem: str) -> Problem:
    """The one problem that was named, of this kind."""
    assert names(result) == {problem}, [p.sentence for p in result.problems]
    return next(p for p in result.problems)


def change(recording, **channels):
    return dataclasses.replace(recording, **channels)


def times(recording, **factors):
    return change(recording, **{name: factor * recording.column(name) for name, factor in factors.items()})


def gapped(r):
    keep = np.r_[0:1000, 1003 : len(r)]
    return dataclasses.replace(r.slice(0, len(keep)), **{n: r.column(n)[keep] for n in ("time", "torque", "velocity", "angle")})


def low_passed(r):
    def smooth(x):
        padded = np.concatenate([x[::-1], x, x[::-1], x])
        f = np.fft.rfftfreq(len(padded)) * 2
        return np.fft.irfft(np.fft.rfft(padded) / (1 + (f / 0.2) ** 8), len(padded))[len(x) : 2 * len(x)]

    return change(r, velocity=smooth(r.velocity), angle=smooth(r.angle))


def repeated(r, every=20):
    k = np.arange(len(r))
    k[every::every] -= 1
    return change(r, torque=r.torque[k], velocity=r.velocity[k], angle=r.angle[k])


def late_velocity(r, samples=10):
    n = len(r) - samples
    return change(r.slice(0, n), velocity=r.velocity[:n], angle=r.angle[samples:], torque=r.torque[samples:])


def spiked(r, value=1e9):
    velocity = r.velocity.copy()
    velocity[700] = value
    return change(r, velocity=velocity)


TWINS = {
    "spike": lambda log: spiked(log()),
    "constant_input": lambda log: change(log(), torque=np.full(len(log()), 0.3)),
    "same_column": lambda log: change(log(), velocity=2.0 * log().torque),
    "jitter": lambda log: change(log(), time=log().time + 0.2 * log().dt * np.random.default_rng(1).uniform(-1, 1, len(log()))),
    "short": lambda log: log().slice(0, 199),
    "gap": lambda log: gapped(log()),
    "duplicated_rows": lambda log: repeated(log()),
    "command_as_torque": lambda log: change(log(), torque=np.roll(log().angle, -10)),
    "sign": lambda log: times(log(), torque=-1.0),
    "unit": lambda log: times(log(), angle=180 / np.pi),
    "channel_ratio": lambda log: times(log(), velocity=3.3),
    "torque_scale": lambda log: times(log(), torque=1 / 8.0),
    "skew": lambda log: log(late=0.03),
    "channel_skew": lambda log: late_velocity(log()),
    "hold": lambda log: log(rate=250, between="linear"),
    "clipping": lambda log: change(log(), velocity=np.clip(log().velocity, -2.0, 2.0)),
    "quantisation": lambda log: change(log(), angle=0.02 * np.round(log().angle / 0.02)),
    "low_pass": lambda log: low_passed(log()),
}


def test_every_check_answers_for_itself():
    for name, one in checks().items():
        assert one.problems, name
        assert one.question.endswith("?"), name
        assert one.run.__doc__, name
    with pytest.raises(ValueError, match="registered already"):
        check("skew", "another", question="?")(lambda *_: [])


def test_every_problem_has_a_twin():
    elsewhere = {
        "side",
        "gear_ratio",
        "joint_range",
        "joint_stop",
        "sample_rate",
    }  # they need another machine: tests of their own below
    assert {p for one in checks().values() for p in one.problems} == set(TWINS) | elsewhere


def test_a_sound_log_is_ready(log, checked):
    for options in ({}, {"rate": 250}, {"rate": 1000}, {"seed": 1}):
        result = checked(log(**options))
        assert result.verdict is LogVerdict.READY, [p.sentence for p in result.problems]
    assert result.excitation
    assert "pivot" in result.understood["chain"]


@pytest.mark.parametrize("problem", TWINS)
def test_a_twin_is_named(problem, log, machine):
    recording = TWINS[problem](log)
    before = {n: recording.column(n).copy() for n in ("time", "torque", "velocity", "angle")}
    result = check_log(machine(), [recording])
    assert problem in names(result), [p.sentence for p in result.problems]
    for p in result.problems:
        assert p.recording == recording.source
        assert np.isfinite(p.value)
        assert p.unit
        assert p.advice
        assert p.ci95 is None or p.ci95[0] <= p.value <= p.ci95[1]
    owner = next(one for one in checks().values() if problem in one.problems)
    told = owner.run(recording, machine(), Context(recording, machine()))
    assert {p.problem for p in told} <= set(owner.problems)
    assert all(np.array_equal(before[n], recording.column(n)) for n in before)


@pytest.mark.parametrize(
    ("factors", "channel", "what"),
    [
        ({"angle": 180 / np.pi}, "angle", "deg"),
        ({"velocity": 30 / np.pi}, "velocity", "rpm"),
        ({"velocity": 180 / np.pi}, "velocity", "deg/s"),
        ({"angle": 180 / np.pi, "velocity": 180 / np.pi}, "angle", "deg and deg/s"),
        ({"torque": 1e3}, "torque", "mN m"),
    ],
)
def test_units(factors, channel, what, log, checked):
    found = only(checked(times(log(), **factors)), "unit")
    assert found.channel == channel
    assert what in found.sentence
    assert found.severity is Severity.FIX


def test_milliseconds(log, checked):
    r = log()
    found = only(checked(change(r, time=1e3 * r.time, dt=1e3 * r.dt)), "unit")
    assert found.channel == "time"
    assert "ms" in found.sentence


@pytest.mark.parametrize("channel", ["torque", "velocity", "angle"])
def test_signs(channel, log, checked):
    assert only(checked(times(log(), **{channel: -1.0})), "sign").channel == channel


@pytest.mark.parametrize("factors", [{"torque": 20.0}, {"velocity": 20.0, "angle": 20.0}])
def test_sides_of_a_gear(factors, log, checked):
    sound = log(gain=20.0)
    assert checked(sound, gain=20.0).verdict is LogVerdict.READY
    found = only(checked(times(sound, **factors), gain=20.0), "side")
    assert "20" in found.sentence


def test_an_angle_of_a_motor_behind_a_gear_that_the_model_lacks(log, checked):
    alone = dataclasses.replace(log(), velocity=None)
    assert "gear_ratio" not in names(checked(alone))
    found = only(checked(times(alone, angle=300.0)), "gear_ratio")
    assert found.severity is Severity.FIX
    assert abs(found.value - 300.0 * 4.0 / 4.4) < 15.0  # by the weight of the model, which is 10 % off


def test_a_wrong_parameter_is_no_unit(log, checked):
    """An inertia, or every torque, off by a factor of two is a parameter."""
    assert checked(times(log(), torque=2.0)).verdict is LogVerdict.READY
    assert checked(times(log(), torque=0.5)).verdict is LogVerdict.READY


def test_a_scale_of_the_inertia_alone_is_no_unit(log, machine):
    """Friction and gravity as in the model contradict a unit of the torque, whatever the inertia is."""
    m = machine()
    light = dataclasses.replace(m.axis.chain.bodies[0], inertia=m.axis.chain.bodies[0].inertia / 1000)
    other = Machine(dataclasses.replace(m.axis, chain=dataclasses.replace(m.axis.chain, bodies=(light,))))
    assert not names(check_log(other, [log()])) & {"unit", "side", "sign", "torque_scale"}


@pytest.mark.parametrize(("torque", "fixed"), [(1 / 200, True), (1 / 7, False), (30.0, True), (7.0, False)])
def test_a_model_out_of_reach_of_any_fit_is_a_scale(torque, fixed, log, machine):
    """Inertia and weight that differ from the model by unlike factors, both beyond a tenth or ten times."""
    m = machine()
    heavy = dataclasses.replace(m.axis.chain.bodies[0], inertia=m.axis.chain.bodies[0].inertia * (3.0 if torque < 1 else 1 / 3.0))
    other = Machine(dataclasses.replace(m.axis, chain=dataclasses.replace(m.axis.chain, bodies=(heavy,))))
    found = [p for p in check_log(other, [times(log(), torque=torque)]).problems if p.problem == "torque_scale"]
    assert [p.severity for p in found] == [Severity.FIX] * fixed
    if fixed:
        low, high = found[0].ci95
        assert low < torque * 0.2 / 0.18 / (3.0 if torque < 1 else 1 / 3.0) < high


@pytest.mark.parametrize("late", [-0.2, -0.03, -0.005, 0.005, 0.2])
def test_a_skew_is_measured(late, log, checked):
    found = only(checked(log(rate=1000, late=late)), "skew")
    assert found.value == pytest.approx(late, abs=5e-4)
    assert found.severity is (Severity.FIX if late < 0 or late > SKEW_FIX else Severity.LIMITS)


@pytest.mark.parametrize("part", [-0.8, -0.4, 0.4, 0.8])
def test_a_delay_that_a_drive_explains_is_no_skew(part, log, checked):
    assert "skew" not in names(checked(log(rate=1000, late=part * ACTUATOR_DELAY)))


def test_a_lag_is_no_skew(log, checked):
    """A first-order lag of 12 ms delays by more than the bound, and is physics."""
    r = log(rate=1000)
    lagged = []
    for x in (r.velocity, r.angle):
        out, y = [], float(x[0])
        for value in x:
            y += (1 - np.exp(-r.dt / 0.012)) * (value - y)
            out.append(y)
        rng = np.random.default_rng(5)
        lagged.append(np.array(out) + 0.002 * np.std(x) * rng.standard_normal(len(x)))
    assert "skew" not in names(checked(change(r, velocity=lagged[0], angle=lagged[1])))


@pytest.mark.parametrize("between", ["linear", "mean"])
def test_the_hold_is_told(between, log, checked):
    found = only(checked(log(rate=250, between=between)), "hold")
    assert f'hold = "{between}"' in found.advice
    assert found.value == pytest.approx(-0.5 if between == "linear" else -1.0, abs=0.1)


def test_clipping_above_and_below_its_share(log, checked):
    r = log()
    for share, severity in ((CLIPPED_SHARE * 1.6, Severity.FIX), (CLIPPED_SHARE * 0.6, Severity.LIMITS)):
        top = float(np.quantile(r.velocity, 1 - share))
        found = [p for p in checked(change(r, velocity=np.minimum(r.velocity, top))).problems if p.problem == "clipping"]
        assert [p.severity for p in found] == [severity]
        assert found[0].value == pytest.approx(top)
        assert found[0].marks


def test_a_clipped_torque_log_is_told_from_a_drive_at_its_limit(log, checked, machine):
    from mjsim.ode import simulate

    r = log()
    clipped = np.clip(r.torque, -2.0, 2.0)
    log_only = [p for p in checked(change(r, torque=clipped)).problems if p.problem == "clipping"]
    assert log_only
    assert all(p.severity is Severity.FIX for p in log_only)
    run = simulate(machine().axis, clipped, r.dt)
    rng = np.random.default_rng(2)
    noisy = [x + s * np.std(x) * rng.standard_normal(len(x)) for x, s in ((run.velocity, 0.01), (run.angle, 0.001))]
    assert "clipping" not in names(checked(change(r, torque=clipped, velocity=noisy[0], angle=noisy[1])))


def test_jitter_above_and_below_the_rounding_of_stamps(log, checked):
    r, rng = log(), np.random.default_rng(4)
    shake = rng.uniform(-1, 1, len(r))
    assert "jitter" not in names(checked(change(r, time=r.time + 0.02 * r.dt * shake)))
    assert only(checked(change(r, time=r.time + 0.15 * r.dt * shake)), "jitter").severity is Severity.LIMITS
    assert only(checked(change(r, time=r.time + 0.4 * r.dt * shake)), "jitter").severity is Severity.FIX


def test_the_range_of_the_joint(log, checked):
    r = log()
    low, high = float(np.min(r.angle)), float(np.max(r.angle))
    span = high - low
    assert checked(r, range=(low, high + 0.001 * span)).verdict is LogVerdict.READY
    assert only(checked(r, range=(low, high - 0.6 * RANGE_FIX * span)), "joint_range").severity is Severity.LIMITS
    assert only(checked(r, range=(low, high - 2 * RANGE_FIX * span)), "joint_range").severity is Severity.FIX


def test_a_soft_limit_may_yield(log, machine):
    """Motion past the range is no fault up to the depth at which MuJoCo's own limit stops it, and one beyond."""
    r, axis = log(), machine()
    low, high = float(np.min(r.angle)), float(np.max(r.angle))
    past = 2 * RANGE_FIX * (high - low)
    for factor, expected in ((1.02, []), (0.9, ["joint_range"])):
        speed = float(np.max(np.abs(r.velocity)))
        limit = Limit(low, high - past, (speed / (factor * past * 0.9999)) ** 2, 1.0, (0.9999, 0.9999, 0.001, 0.5, 2.0))
        result = check_log(dataclasses.replace(axis, range=(low, high - past), limit=limit), [r])
        assert [p.problem for p in result.problems] == expected


def test_modes_out_of_reach_are_named_by_their_frequency(log):
    axis = Machine.of(load_model(shipped_model("robot_axis1")))
    mode = axis.modes[0]
    for factor, expected in ((0.98, 2), (1.02, 1)):  # of the two modes
        r = log()
        rate = factor * MODE_RATE * mode
        slow = change(r, dt=1 / rate, time=np.arange(len(r)) / rate)
        one = checks()["sample_rate"].run(slow, axis, Context(slow, axis))
        assert len(one) == expected
    assert one[0].value == pytest.approx(axis.modes[1])
    assert mode == pytest.approx(25.34, abs=0.01)


def test_a_servo_log_without_torque_is_checked_by_its_channels(log, checked):
    """The relation is left out where the log holds no torque."""
    r = log()
    result = checked(change(r, torque=np.full(len(r), np.nan)))
    assert not names(result) & {"sign", "unit", "skew", "constant_input"}


def test_spikes_at_their_threshold():
    """A single sample counts from the range of all others on; a step, and a pulse of two samples, do not."""
    x = np.sin(0.01 * np.arange(1000))
    spread = np.ptp(x)
    for factor, found in ((1.02, [500]), (0.98, [])):
        y = x.copy()
        y[500] = max(y[499], y[501]) + factor * spread
        assert spikes(y).tolist() == found
    step = np.where(np.arange(1000) < 500, x, x + 100)
    pulse = x.copy()
    pulse[500:502] += 100
    assert spikes(step).size == spikes(pulse).size == spikes(np.zeros(1000)).size == 0
    assert spikes(np.array([0.0, 9.0, 0.0])).tolist() == [1]
    assert spikes(np.array([0.0, 9.0])).size == 0
