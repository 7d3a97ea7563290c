"""The sealed plant against closed forms, its own step halving, and energy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from lab.benchmark.catalogue import CATALOGUE, OTHER_LAWS, OUTSIDE, Entry, compose, draw, find
from lab.benchmark.experiment import RATE, chirp, draw_experiment, multisine
from lab.benchmark.laws import Laws
from lab.benchmark.measurement import Measurement
from lab.benchmark.plant import free_run, record
from lab.benchmark.refit import rms
from mjsim.errors import InputError

SOLVER_ERROR = 1e-3  # rad/s rms: 2 % of the usual noise of 0.05, so 2e-4 of it in variance
QUIET = Measurement(0.0, 0.0)


def state_space(p: Laws) -> tuple[np.ndarray, np.ndarray]:
    """x = [angles, speeds] of motor, gearbox, arm; x' = A x + B u."""
    M = np.diag([p.Jm, p.Jg, p.Ja])
    g, a = np.array([p.ratio, -1.0, 0.0]), np.array([0.0, 1.0, -1.0])
    K = p.kg * np.outer(g, g) + p.ka * np.outer(a, a)
    D = p.dg * np.outer(g, g) + p.da * np.outer(a, a) + np.diag([p.fm, 0, 0])
    A = np.block([[np.zeros((3, 3)), np.eye(3)], [-np.linalg.solve(M, K), -np.linalg.solve(M, D)]])
    return A, np.concatenate([np.zeros(3), [1 / p.Jm, 0, 0]])


def test_linear_axis_against_the_matrix_exponential() -> None:
    u = chirp(4.0, 2.0, 0.5, 45.0).torque
    A, B = state_space(Laws())
    full = expm(np.block([[A, B[:, None]], [np.zeros((1, 7))]]) / RATE)
    x, speed, angle = np.zeros(6), [], []
    for value in u:
        speed.append(x[3])
        angle.append(x[0])
        x = full[:6, :6] @ x + full[:6, 6] * value
    motion = free_run(Laws(), u)
    assert rms(motion.velocity - np.array(speed)) < 2e-4
    assert rms(motion.angle - np.array(angle)) < 2e-6
    assert np.allclose(motion.end[[0, 1, 2, 4, 5, 6]], x, rtol=1e-3, atol=1e-5)


def test_extra_mode_against_the_matrix_exponential() -> None:
    p = Laws(Je=0.4, ke=15000.0, de=2.0)
    u = chirp(2.0, 2.0, 0.5, 30.0).torque
    M = np.diag([p.Jm, p.Jg, p.Ja - p.Je, p.Je])
    rows = [(p.kg, p.dg, [p.ratio, -1, 0, 0]), (p.ka, p.da, [0, 1, -1, 0]), (p.ke, p.de, [0, 0, 1, -1])]
    K = sum(k * np.outer(r, r) for k, _, r in rows)
    D = sum(d * np.outer(r, r) for _, d, r in rows) + np.diag([p.fm, 0, 0, 0])
    A = np.block([[np.zeros((4, 4)), np.eye(4)], [-np.linalg.solve(M, K), -np.linalg.solve(M, D)]])
    B = np.concatenate([np.zeros(4), [1 / p.Jm, 0, 0, 0]])
    full = expm(np.block([[A, B[:, None]], [np.zeros((1, 9))]]) / RATE)
    x, speed = np.zeros(8), []
    for value in u:
        speed.append(x[4])
        x = full[:8, :8] @ x + full[:8, 8] * value
    assert rms(free_run(p, u).velocity - np.array(speed)) < 2e-4


def test_coulomb_friction_alone_against_its_closed_form() -> None:
    """A free motor (no gear): held torque F against level L accelerates by (F - L)/J, then stops in v J/L seconds."""
    p = Laws(fm=0.0, kg=1e-9, dg=0.0, coulomb_m=0.11)
    u = np.concatenate([np.full(200, 0.3), np.zeros(500)])
    v = free_run(p, u).velocity
    top = 0.19 / p.Jm * 0.1
    assert v[200] == pytest.approx(top, rel=1e-9)
    stop = 200 + int(np.ceil(top * p.Jm / 0.11 * RATE))
    assert v[stop - 1] > 0.0
    assert np.all(v[stop:] == 0.0)


def test_static_friction_holds_up_to_its_peak() -> None:
    p = Laws(fm=0.0, kg=1e-9, dg=0.0, coulomb_m=0.1, peak_m=3.0)
    ramp = np.linspace(0.0, 0.6, 1200, endpoint=False)
    v = free_run(p, ramp).velocity
    first = int(np.flatnonzero(v)[0])
    assert ramp[first - 1] > 0.3 >= ramp[first - 2]
    assert v[first] == pytest.approx((ramp[first - 1] - 0.1) / p.Jm / RATE, rel=1e-6)


def test_time_delay_of_any_fraction_of_a_row() -> None:
    u = multisine(2.0, 1.0, 0.5, 30.0, np.random.default_rng(1)).torque
    held = free_run(Laws(), np.concatenate([np.zeros(3), u[:-3]])).velocity
    assert rms(free_run(Laws(act_delay=1.5e-3), u).velocity - held) < 1e-9
    t = np.arange(u.size) / RATE
    fine = free_run(Laws(), u)
    for delay in (0.7e-3, 1.5e-3, 2.21e-3):
        late = np.interp(t - delay, t, fine.velocity_true, left=0.0)
        tolerance = 5e-3 if (delay * RATE) % 1 else 1e-9  # of the interpolation here
        assert rms(free_run(Laws(sen_delay=delay), u).velocity - late) < tolerance * rms(late)
        assert rms(free_run(Laws(act_delay=delay), u).velocity - late) < tolerance * rms(late) + 1e-6


def test_homogeneity() -> None:
    """Torque, Coulomb level and gap scaled together scale the output: an exact law of the axis."""
    u = chirp(3.0, 1.0, 0.5, 30.0).torque
    small = free_run(Laws(coulomb_m=0.05, gap_g=3e-4), u).velocity
    large = free_run(Laws(coulomb_m=0.2, gap_g=12e-4), 4 * u).velocity
    assert np.allclose(large, 4 * small, rtol=1e-9, atol=1e-9)


def test_asymmetric_friction_is_coulomb_friction_and_an_offset() -> None:
    u = multisine(2.0, 0.5, 0.5, 30.0, np.random.default_rng(4)).torque
    one = free_run(Laws(coulomb_m=0.15, asymmetry_m=0.06), u).velocity
    two = free_run(Laws(coulomb_m=0.15, offset_m=-0.06), u).velocity
    assert rms(one - two) < 1e-9


def test_energy_of_a_conservative_axis_equals_the_work_done() -> None:
    p = Laws(fm=0.0, dg=0.0, da=0.0, gap_g=3e-4, cubic_a=2e9, ripple_amplitude=0.05, ripple_cycles=3.0, ripple_phase=0.4)
    p = p._replace(inertia_amplitude=0.4, inertia_cycles=30.0, inertia_phase=1.0, gravity=20.0, gravity_phase=0.7)
    p = p._replace(error_amplitude=5e-5, error_cycles=2.0, error_phase=0.3, error_relaxed=1.0, x_soft=0.3)
    p = p._replace(x_soft_cycles=60.0, Je=0.3, ke=12000.0)
    u = multisine(2.0, 0.5, 0.5, 30.0, np.random.default_rng(2)).torque
    motion = free_run(p, u)
    qm, qg, qa, qe, vm, vg, va, ve = motion.end
    work = float(np.sum(u * np.diff(np.append(motion.angle_true, qm))))
    J = p.Ja - p.Je + p.Ja * p.inertia_amplitude * np.sin(p.inertia_cycles * qa + p.inertia_phase)
    kinetic = 0.5 * (p.Jm * vm**2 + p.Jg * vg**2 + J * va**2 + p.Je * ve**2)
    lead = p.ratio * qm + p.error_amplitude * (np.sin(p.error_cycles * qm + p.error_phase) - np.sin(p.error_phase)) - qg
    stretch = np.sign(lead) * max(abs(lead) - p.gap_g / 2, 0.0)
    ka = p.ka * (1 + p.x_soft * np.sin(p.x_soft_cycles * qa))
    elastic = 0.5 * p.kg * stretch**2 + 0.5 * ka * (qg - qa) ** 2 + 0.25 * p.cubic_a * (qg - qa) ** 4
    elastic += 0.5 * p.ke * (qa - qe) ** 2
    ripple = p.ripple_amplitude / 3.0 * (np.cos(p.ripple_phase) - np.cos(3.0 * qm + p.ripple_phase))
    weight = p.gravity * (np.cos(p.gravity_phase) - np.cos(qa + p.gravity_phase))
    assert kinetic + elastic + ripple + weight == pytest.approx(work, rel=1e-4)


def halving(entry: Entry, seed: int, kind: str, seconds: float) -> tuple[float, float]:
    """Rms change of the velocity [rad/s] by halving the step, and the rms of the velocity."""
    rng = np.random.default_rng(seed)
    experiment = draw_experiment(kind, rng, 1.5, seconds)
    laws = compose(Laws(), entry, draw(entry, rng, 1.5))
    runs = [record(laws, experiment, QUIET, np.random.default_rng(0), substeps=substeps).velocity_true for substeps in (100, 200)]
    return rms(runs[0] - runs[1]), rms(runs[1])


FAST = ("stribeck_friction", "backlash", "time_delay")


@pytest.mark.parametrize("effect", FAST)
def test_step_halving(effect: str) -> None:
    for entry in CATALOGUE + OTHER_LAWS:
        if entry.effect == effect:
            assert halving(entry, 4, "multisine", 2.0)[0] < SOLVER_ERROR, (entry.place, entry.law)


@pytest.mark.slow
@pytest.mark.parametrize("entry", CATALOGUE + OTHER_LAWS + OUTSIDE, ids=lambda e: f"{e.effect}-{e.place}-{e.law}")
def test_step_halving_of_every_law(entry: Entry) -> None:
    changes = [halving(entry, seed, kind, 10.0)[0] for seed in (5, 6) for kind in ("chirp", "multisine", "trapezoid")]
    # one motion in several may part ways at a breakaway or an impact: that is sensitivity, not the solver's error
    assert np.median(changes) < SOLVER_ERROR / 10
    assert sorted(changes)[-2] < SOLVER_ERROR


def test_the_catalogue_covers_the_contract() -> None:
    contract = {
        ("coulomb_friction", "motor"), ("coulomb_friction", "gearbox"), ("coulomb_friction", "arm"),
        ("static_friction", "motor"), ("stribeck_friction", "motor"), ("asymmetric_friction", "motor"),
        ("quadratic_friction", "motor"), ("presliding_friction", "motor"), ("load_dependent_friction", "motor"),
        ("load_dependent_friction", "gearbox"), ("friction_drift", "motor"), ("position_dependent_friction", "motor"),
        ("backlash", "gearbox"), ("backlash", "arm"), ("hardening_stiffness", "gearbox"),
        ("hardening_stiffness", "arm"), ("hysteresis", "gearbox"), ("hysteresis", "arm"),
        ("transmission_error", "gearbox"), ("torque_ripple", "motor"), ("torque_offset", "motor"),
        ("gravity_load", "arm"), ("extra_flexible_mode", "arm"), ("position_dependent_inertia", "arm"),
        ("torque_gain_droop", "actuator"), ("actuator_saturation", "actuator"), ("actuator_deadzone", "actuator"),
        ("actuator_lag", "actuator"), ("time_delay", "actuator"), ("time_delay", "sensor"), ("sensor_lag", "sensor"),
        ("sensor_quantisation", "sensor"), ("sensor_offset", "sensor"),
    }  # fmt: skip
    assert {(e.effect, e.place) for e in CATALOGUE} == contract
    assert len(CATALOGUE) == len(contract)


def test_every_law_changes_the_motion_and_shares_none() -> None:
    u = multisine(1.0, 1.0, 1.0, 30.0, np.random.default_rng(3)).torque
    base = free_run(Laws(), u).velocity
    for entry in CATALOGUE + OTHER_LAWS + OUTSIDE:
        parameters = draw(entry, np.random.default_rng(3), 1.5)
        laws = compose(Laws(), entry, parameters)
        if entry.fields:
            assert not np.array_equal(free_run(laws, u).velocity, base), entry.effect
            with pytest.raises(InputError, match="in use"):
                compose(laws, entry, parameters)


def test_an_unknown_effect_lists_the_known_ones() -> None:
    with pytest.raises(InputError, match="backlash at gearbox"):
        find("backlash", "motor")
