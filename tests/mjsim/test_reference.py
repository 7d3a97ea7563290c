"""The exact reference against the matrix exponential, against DOP853 with events, and against the kernel."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from robot_axis import CHAIN, DT, axis, chirp, effect, relative
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from mjsim import ode, reference
from mjsim.effects import BacklashLaw
from mjsim.system import assemble, state_matrix


def test_linear_run_is_the_matrix_exponential() -> None:
    u = chirp(2.0)
    a = state_matrix(assemble(axis()).f)
    b = np.zeros(6)
    b[3] = 1 / CHAIN.bodies[0].inertia
    m = np.zeros((7, 7))
    m[:6, :6], m[:6, 6] = a, b
    phi = expm(m * DT)
    x, v = np.zeros(6), []
    for value in u:
        v.append(x[3])
        x = phi[:6, :6] @ x + phi[:6, 6] * value
    assert relative(reference.simulate(axis(), u, DT).velocity, np.array(v)) < 1e-11


def test_friction_and_gap_against_dop853() -> None:
    """Sliding and contact written out here, integrated by SciPy with located events on a smooth stretch of motion."""
    friction, gap, dt = 0.05, 5e-4, 1e-3
    u = np.full(80, 1.5)
    run = reference.simulate(axis(effect("coulomb_friction", torque_Nm=friction), effect("backlash", gap_rad=gap)), u, dt)
    r, k, d, ka, da = 1 / 118, 1.5e5, -62.0, 0.446e5, 20.0

    def rates(_t: float, y: np.ndarray, side: int) -> np.ndarray:
        q, v = y[:3], y[3:]
        e = r * q[0] - q[1]
        t0 = 0.0 if side == 0 else k * (e - side * gap / 2) + d * (r * v[0] - v[1])
        t1 = ka * (q[1] - q[2]) + da * (v[1] - v[2])
        acc = [(1.5 - 0.0355 * v[0] - friction - r * t0) / 4.56e-4, (t0 - t1) / 9.92, t1 / 1.72]
        return np.concatenate([v, acc])

    def edge(_t: float, y: np.ndarray, side: int) -> float:
        e = r * y[0] - y[1]
        return float(side * e - gap / 2 if side else gap / 2 - abs(e))

    edge.terminal, edge.direction = True, -1  # type: ignore[attr-defined]
    t, y, side, seen = 0.0, np.zeros(6), 0, {}
    grid = dt * np.arange(80)
    while t < grid[-1]:
        inner = grid[(grid > t) & (grid <= grid[-1])]
        s = solve_ivp(
            rates, (t, grid[-1]), y, "DOP853", t_eval=inner, events=edge, args=(side,), rtol=1e-11, atol=1e-14, max_step=1e-3
        )
        seen.update(zip(s.t, s.y[3], strict=True))
        if s.status != 1:
            break
        t, y = s.t_events[0][0], s.y_events[0][0]
        e = r * y[0] - y[1]
        side = 0 if side else (1 if e > 0 else -1)
        # step off the edge, so that the same event is not met again
        probe = solve_ivp(rates, (t, t + 1e-9), y, "DOP853", args=(side,), rtol=1e-12, atol=1e-16)
        t, y = t + 1e-9, probe.y[:, -1]
    assert np.all(run.velocity[1:] > 0)
    expected = np.array([seen[g] for g in grid[1:]])
    assert relative(run.velocity[1:], expected) < 1e-8


CASES = {
    "coulomb": [("coulomb_friction", {"torque_Nm": 0.1})],
    "peak": [("static_friction", {"torque_Nm": 0.1, "peak": 5.0})],
    "gap": [("backlash", {"gap_rad": 1e-3})],
    "gap and peak": [("backlash", {"gap_rad": 5e-4}), ("static_friction", {"torque_Nm": 0.1, "peak": 2.0})],
    "two gaps": [("backlash", {"gap_rad": 5e-4}), ("backlash", {"gap_rad": 2e-4, "place": "arm"})],
    "asymmetric": [("asymmetric_friction", {"torque_Nm": 0.1, "asymmetry_Nm": 0.03}), ("torque_offset", {"torque_Nm": 0.05})],
    "gearbox": [("coulomb_friction", {"torque_Nm": 5.0, "place": "gearbox"})],
    "mode": [("extra_flexible_mode", {"inertia_kgm2": 0.5, "stiffness_Nm_rad": 2e4, "damping_Nms_rad": 2.0})],
    "lag": [("actuator_lag", {"time_constant_s": 2e-3}), ("coulomb_friction", {"torque_Nm": 0.1})],
    "delay": [("time_delay", {"delay_s": 1.23e-3}), ("torque_gain_droop", {"coefficient_per_Nm2": 0.1})],
    "sensor lag": [("sensor_lag", {"time_constant_s": 2e-3})],
    "sensor delay": [("time_delay", {"delay_s": 1.23e-3, "place": "sensor"})],
}


@pytest.mark.parametrize("name", CASES)
def test_kernel_converges_to_the_reference(name: str) -> None:
    model = axis(*(effect(k, **v) for k, v in CASES[name]))  # type: ignore[arg-type]
    u = chirp(4.0)
    exact = reference.simulate(model, u, DT).velocity
    assert relative(ode.simulate(model, u, DT, substeps=16).velocity, exact) < 2e-6
    assert relative(ode.simulate(model, u, DT).velocity, exact) < 1e-4


@pytest.mark.parametrize("law", list(BacklashLaw))
def test_scaling_law(law: BacklashLaw) -> None:
    """Torque, friction and gap times a give the output times a."""
    u = chirp(4.0)
    big = axis(effect("backlash", gap_rad=5e-4), law=law)
    small = axis(effect("backlash", gap_rad=1e-4), law=law)
    assert relative(5 * reference.simulate(small, 0.2 * u, DT).velocity, reference.simulate(big, u, DT).velocity) < 1e-9


def test_no_pull_never_pulls() -> None:
    model = axis(effect("backlash", gap_rad=5e-4), law=BacklashLaw.NO_PULL)
    run = reference.simulate(model, chirp(4.0), DT)
    deflection = run.q[:, 0] / 118 - run.q[:, 1]
    assert np.all(run.coupling_torque[:, 0] * np.sign(deflection) >= -1e-9)


def test_what_is_not_affine_is_named() -> None:
    model = axis(effect("quadratic_friction", coefficient_Nm_s2_rad2=1e-4))
    with pytest.raises(reference.NotAffineError, match="quadratic_friction@motor"):
        reference.simulate(model, chirp(0.1), DT)
    assert reference.not_affine(axis(effect("coulomb_friction", torque_Nm=0.1))) is None


@pytest.mark.parametrize("name", ["linear", "coulomb", "gap", "gap and peak", "lag", "gearbox"])
def test_propagators_and_runge_kutta_agree(name: str) -> None:
    """The two ways in which the kernel takes a whole step: matrix exponentials of the modes, and RK4 (general axes)."""
    model = assemble(axis(*(effect(k, **v) for k, v in CASES.get(name, []))))  # type: ignore[arg-type]
    assert model.affine
    u = chirp(2.0)
    fast = ode.simulate(model, u, DT)
    general = ode.simulate(dataclasses.replace(model, affine=False), u, DT, substeps=8)
    assert relative(fast.velocity, general.velocity) < 1e-6
    np.testing.assert_allclose(fast.coupling_torque, general.coupling_torque, atol=1e-2)


def test_a_reversal_inside_one_step_is_seen() -> None:
    """A body that comes to rest and slides on within one sample: RK4 in one step per sample once slid past it."""
    model = axis(effect("coulomb_friction", torque_Nm=0.1))
    exact = reference.simulate(model, chirp(10.0), DT).velocity
    general = dataclasses.replace(assemble(model), affine=False)
    assert relative(ode.simulate(general, chirp(10.0), DT, substeps=1).velocity, exact) < 4e-6


def test_a_short_lag_is_resolved() -> None:
    model = axis(effect("actuator_lag", time_constant_s=2e-5))
    u = chirp(1.0)
    assert relative(ode.simulate(model, u, DT).velocity, reference.simulate(model, u, DT).velocity) < 1e-10


@pytest.mark.parametrize(
    ("coulomb", "tau"),
    [
        (0.0, 7.8e-6),
        (0.1, 7.8e-6),
        pytest.param(0.1, 1e-6, marks=pytest.mark.slow),
        pytest.param(0.0, 1e-6, marks=pytest.mark.slow),
    ],
)
def test_a_lag_shorter_than_any_step_delays(tau: float, coulomb: float) -> None:
    model = axis(effect("actuator_lag", time_constant_s=tau), effect("coulomb_friction", torque_Nm=coulomb))
    u = chirp(1.0)
    exact = reference.simulate(model, u, DT).velocity
    without = ode.simulate(axis(effect("coulomb_friction", torque_Nm=coulomb)), u, DT).velocity
    left = relative(ode.simulate(model, u, DT).velocity, exact)
    assert left < 4e-6
    assert left < 0.01 * relative(without, exact) + 1e-7, "the lag is there to first order"


@pytest.mark.parametrize("name", ["lag", "delay"])
def test_torque_ahead_of_the_record(name: str) -> None:
    model = axis(*(effect(k, **v) for k, v in CASES[name]))  # type: ignore[arg-type]
    u = 1.0 + chirp(0.5)
    runs = [module.simulate(model, u, DT, before=0.7).velocity for module in (ode, reference)]
    assert relative(*runs) < 1e-6
    assert relative(ode.simulate(model, u, DT).velocity, runs[1]) > 1e-4


@pytest.mark.parametrize(("name", "values"), [("sensor_lag", {"time_constant_s": 2e-3}), ("time_delay", {"delay_s": 2.3e-3})])
def test_a_law_follows_the_angle_ahead_of_a_late_sensor(name: str, values: dict[str, float]) -> None:
    """Tied to an angle that the sensor hands on late, a ripple would be late too: by .5 % of the motion here."""
    plant = axis(
        effect("torque_ripple", amplitude_Nm=0.1, cycles_per_rev=4.0, phase_rad=0.3), effect(name, place="sensor", **values)
    )
    u = chirp(4.0)
    free = ode.simulate(plant, u, DT)
    tied = ode.simulate(plant, u, DT, angle=free.angle)
    assert relative(tied.velocity, free.velocity) < 1e-4


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("coulomb_friction", {"torque_Nm": 0.1}),
        ("asymmetric_friction", {"torque_Nm": 0.1, "asymmetry_Nm": 0.03}),
        ("static_friction", {"torque_Nm": 0.1, "peak": 1.5}),
    ],
)
def test_friction_of_constant_levels_is_the_same_as_by_its_law(name: str, values: dict[str, float]) -> None:
    """The kernel reads the levels where they are constant; by address, its law says the same to the last digit."""
    model = axis(effect(name, **values), effect("torque_ripple", amplitude_Nm=0.05, cycles_per_rev=4.0, phase_rad=1.0))
    (friction, _) = model.effects
    (port,) = friction.ports(model.chain)
    by_levels = assemble(model)
    elements, parameters = by_levels.elements.copy(), by_levels.parameters.copy()
    (row,) = np.flatnonzero(elements[:, 2] == 0)
    elements[row, 2:4] = port.law.address, len(parameters)
    by_law = dataclasses.replace(by_levels, elements=elements, parameters=np.array([*parameters, *port.p]))
    u = 0.5 * chirp(2.0)
    first, other = ode.simulate(by_levels, u, DT), ode.simulate(by_law, u, DT)
    assert np.ptp(first.velocity) > 0
    np.testing.assert_array_equal(first.velocity, other.velocity)
    np.testing.assert_array_equal(first.coupling_torque, other.coupling_torque)
