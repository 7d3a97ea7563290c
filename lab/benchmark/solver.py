"""The sealed plant's own solver: leapfrog with exact stick, a fixed fine step, compiled.

One step of h seconds: positions drift half a step; every torque is taken there, with velocities predicted to mid-step
from the last acceleration; each body's velocity is advanced through its friction inclusion (`friction.dry_step`);
positions drift the other half. Second order also across reversals, contacts and releases. The recorder samples at
t = k/fs, *before* the torque of row k acts; that torque is held until row k + 1.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from lab.benchmark.friction import bristle_step, dry_step
from lab.benchmark.joints import joint_torque, slip_step
from lab.benchmark.laws import Laws

__all__ = ["integrate", "run"]


@njit(cache=True, nogil=True, inline="always")
def _drive(u: float, p: Laws) -> float:
    """Torque [Nm] of the actuator's static laws: dead zone, droop u (1 - c u^2), saturation."""
    if p.deadzone > 0.0:
        u = math.copysign(max(abs(u) - p.deadzone, 0.0), u)
    u = u * (1.0 - p.droop * u * u)
    return min(max(u, -p.limit), p.limit)


@njit(cache=True, nogil=True, inline="always")
def _motor_level(p: Laws, v: float, t: float, angle: float, load: float) -> float:
    """Level [Nm] of the motor's dry friction, asymmetry apart, at speed v, time t, angle and transmitted torque."""
    level = p.coulomb_m + p.load_m * abs(load)
    if p.stribeck_extra > 0.0:
        x = v / p.stribeck_speed
        level += p.stribeck_extra * math.exp(-x * x)
    if p.drift_change != 0.0:
        level *= 1.0 + p.drift_change * math.exp(-t / p.drift_time)
    if p.place_amplitude != 0.0:
        level *= 1.0 + p.place_amplitude * math.sin(p.place_cycles * angle + p.place_phase)
    return level


def run(
    p: Laws, torque: np.ndarray, speed_set: np.ndarray, kp: float, ki: float, closed: bool, feed_noise: bool, noise_v: np.ndarray,
    noise_a: np.ndarray, drop: np.ndarray, fs: float, substeps: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """`integrate` on arguments of one type each: numba compiles a function anew, which takes half a minute, for every other."""
    return integrate(
        type(p)(*map(float, p)), np.array(torque, float), np.array(speed_set, float), float(kp), float(ki), bool(closed),
        bool(feed_noise), np.array(noise_v, float), np.array(noise_a, float), np.array(drop, np.int8), float(fs), int(substeps),
    )  # fmt: skip


@njit(cache=True, nogil=True)
def integrate(
    p: Laws, torque: np.ndarray, speed_set: np.ndarray, kp: float, ki: float, closed: bool, feed_noise: bool, noise_v: np.ndarray,
    noise_a: np.ndarray, drop: np.ndarray, fs: float, substeps: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Simulate from rest; returns logged torque [Nm], then measured and true motor velocity [rad/s] and angle [rad],
    and the state at the end: angles [rad] of motor, gearbox, arm and the mass split off it, then their speeds [rad/s].

    ``torque`` is the held input (a feed-forward when ``closed``: u = torque + kp (speed_set - v) + ki * integral).
    ``drop`` is 1 on rows where the sensor repeats its last value.
    """
    n = torque.size
    dt = 1.0 / fs
    h = dt / substeps
    r = p.ratio
    Ja = p.Ja - p.Je
    u_log = np.zeros(n)
    v_meas = np.zeros(n)
    v_true = np.zeros(n)
    a_meas = np.zeros(n)
    a_true = np.zeros(n)
    v_late = np.zeros(n + 1)  # lagged sensor signals at the delay's fraction before each row
    a_late = np.zeros(n + 1)
    act_whole = math.floor(p.act_delay * fs + 1e-9)
    act_part = max(p.act_delay - act_whole * dt, 0.0)
    sen_whole = math.floor(p.sen_delay * fs + 1e-9)
    sen_part = max(p.sen_delay - sen_whole * dt, 0.0)
    act_decay = math.exp(-h / p.act_lag) if p.act_lag > 0.0 else 0.0
    sen_decay = math.exp(-h / p.sen_lag) if p.sen_lag > 0.0 else 0.0
    qm = qg = qa = qe = 0.0
    vm = vg = va = ve = 0.0
    am = ag = aa = ae = 0.0
    Fm_before = Fg_before = Fa_before = 0.0
    bristle = slip_g = slip_a = 0.0
    act = 0.0
    sv = sa = 0.0
    memory = lagged = heat = clutch = warm = 0.0
    integral = 0.0
    bristles = p.bristle_level > 0.0
    for i in range(n):
        # --- the recorder reads, the controller answers
        v_true[i] = vm
        a_true[i] = qm
        if i >= sen_whole:
            v_sensor = v_late[i - sen_whole] if sen_part > 0.0 or sen_whole > 0 else sv
            a_sensor = a_late[i - sen_whole] if sen_part > 0.0 or sen_whole > 0 else sa
        else:
            v_sensor = a_sensor = 0.0
        v_sensor += p.sen_offset
        if p.repeat_amplitude != 0.0:
            arg = p.repeat_cycles * qm + p.repeat_phase
            v_sensor += p.repeat_amplitude * p.repeat_cycles * vm * math.cos(arg)
            a_sensor += p.repeat_amplitude * math.sin(arg)
        if p.sen_step > 0.0 and p.sen_step_first > 0.0:
            v_sensor = p.sen_step * math.floor(v_sensor / p.sen_step + 0.5)
        v_clean = v_sensor
        v_sensor += noise_v[i]
        a_sensor += noise_a[i]
        if p.sen_step > 0.0 and p.sen_step_first == 0.0:
            v_sensor = p.sen_step * math.floor(v_sensor / p.sen_step + 0.5)
        if p.encoder_step > 0.0:
            a_sensor = p.encoder_step * math.floor(a_sensor / p.encoder_step + 0.5)
        if drop[i] > 0 and i > 0:
            v_sensor = v_meas[i - 1]
            a_sensor = a_meas[i - 1]
        v_meas[i] = v_sensor
        a_meas[i] = a_sensor
        u = torque[i]
        if closed:
            gap = speed_set[i] - (v_sensor if feed_noise else v_clean)
            integral += ki * gap * dt
            u += kp * gap + integral
        u_log[i] = u
        k_new = i - act_whole
        u_new = u_log[k_new] if k_new >= 0 else 0.0
        u_old = u_log[k_new - 1] if k_new >= 1 else 0.0
        # --- the axis moves
        for j in range(substeps):
            t = i * dt + (j + 0.5) * h
            w = min(max((act_part - j * h) / h, 0.0), 1.0)
            jump = (w > 0.0 or j * h <= act_part + h) if act_part > 0.0 else j == 0
            command = w * u_old + (1.0 - w) * u_new
            if p.act_lag > 0.0:
                mean = command + (act - command) * (1.0 - act_decay) * p.act_lag / h
                act = command + (act - command) * act_decay
                command = mean
                jump = False
            drive = _drive(command, p)
            # mid-step positions, predicted mid-step velocities
            qmh = qm + 0.5 * h * vm
            qgh = qg + 0.5 * h * vg
            qah = qa + 0.5 * h * va
            pm = vm + 0.5 * h * am
            pg = vg + 0.5 * h * ag
            pa = va + 0.5 * h * aa
            # laws that no library knows, on the drive
            if p.x_derate != 0.0:
                warm += h * (drive * drive - warm) / p.x_derate_time
                drive /= 1.0 + p.x_derate * warm
            if p.x_fade != 0.0 and drive * pm > 0.0:
                drive *= max(1.0 - p.x_fade * abs(pm), 0.0)
            # gearbox
            lead = r * qmh
            slope = r
            if p.error_amplitude != 0.0:
                arg = p.error_cycles * qmh + p.error_phase
                lead += p.error_amplitude * (math.sin(arg) - p.error_relaxed * math.sin(p.error_phase))
                slope += p.error_amplitude * p.error_cycles * math.cos(arg)
            rate = slope * pm - pg
            Tg = joint_torque(
                lead - qgh - clutch, rate, slope * vm - vg, p.kg, p.cubic_g, p.dg, p.gap_g, p.gap_law_g, p.impact_g, h
            )
            if p.slip_stiffness_g > 0.0:
                mid, slip_g = slip_step(slip_g, rate, p.slip_stiffness_g, p.slip_torque_g, p.slip_sharp, h)
                Tg += mid
            if abs(Tg) > p.x_clutch:
                clutch += (abs(Tg) - p.x_clutch) / p.kg * math.copysign(1.0, Tg)
                Tg = math.copysign(p.x_clutch, Tg)
            # arm
            phi = qgh - qah
            rate = pg - pa
            k_arm = p.ka
            turn = 0.0
            if p.x_soft != 0.0:
                arg = p.x_soft_cycles * qah + p.x_soft_phase
                k_arm *= 1.0 + p.x_soft * math.sin(arg)
                turn = 0.5 * p.ka * p.x_soft * p.x_soft_cycles * math.cos(arg) * phi * phi
            Ta = joint_torque(phi, rate, vg - va, k_arm, p.cubic_a, p.da, p.gap_a, p.gap_law_a, p.impact_a, h)
            if p.slip_stiffness_a > 0.0:
                mid, slip_a = slip_step(slip_a, rate, p.slip_stiffness_a, p.slip_torque_a, p.slip_sharp, h)
                Ta += mid
            Fa = Ta - turn
            J = Ja
            if p.inertia_amplitude != 0.0:
                arg = p.inertia_cycles * qah + p.inertia_phase
                J = Ja + p.Ja * p.inertia_amplitude * math.sin(arg)
                Fa -= 0.5 * p.Ja * p.inertia_amplitude * p.inertia_cycles * math.cos(arg) * pa * pa
            if p.gravity != 0.0:
                Fa -= p.gravity * math.sin(qah + p.gravity_phase)
            if p.Je > 0.0:
                qeh = qe + 0.5 * h * ve
                Te = p.ke * (qah - qeh) + p.de * (pa - (ve + 0.5 * h * ae))
                Fa -= Te
                ae = Te / p.Je
                ve += h * ae
                qe = qeh + 0.5 * h * ve
            # motor
            load = slope * Tg
            Fm = drive + p.offset_m - p.fm * pm - load - p.quadratic_m * pm * abs(pm)
            if p.ripple_amplitude != 0.0:
                Fm -= p.ripple_amplitude * math.sin(p.ripple_cycles * qmh + p.ripple_phase)
            if p.x_load_speed != 0.0:
                Fm -= p.x_load_speed * abs(load) * pm * abs(pm)
            if p.x_cog != 0.0:
                Fm -= p.x_cog * abs(pm) * (math.sin(p.x_cog_first * qmh) + 0.6 * math.sin(p.x_cog_second * qmh))
            if p.x_detent != 0.0:
                memory = min(max(memory, qmh - p.x_detent_width), qmh + p.x_detent_width)
                Fm -= p.x_detent * math.sin(p.x_detent_cycles * (qmh - memory))
            if bristles:
                level = p.bristle_level + p.bristle_extra * math.exp(-((pm / p.bristle_speed) ** 2))
                before = bristle
                mid, bristle = bristle_step(bristle, pm, level, p.bristle_stiffness, h)
                Fm -= p.bristle_stiffness * mid + p.bristle_damping * (bristle - before) / h
            level = _motor_level(p, pm, t, qmh, load)
            still = _motor_level(p, 0.0, t, qmh, load)
            if p.x_lag_level > 0.0:
                lagged += h * (abs(pm) - lagged) / p.x_lag_time
                extra = p.x_lag_level * math.exp(-lagged / p.x_lag_speed) / (1.0 + p.x_heat * heat)
                heat += h * ((level + extra) * abs(pm) - heat / p.x_heat_time)
                level += extra if pm > 0.0 else 0.5 * extra
                still += extra
            up = max(level + p.asymmetry_m, 0.0)
            down = max(level - p.asymmetry_m, 0.0)
            up0 = max(still + p.asymmetry_m, 0.0)
            down0 = max(still - p.asymmetry_m, 0.0)
            vm_new = dry_step(vm, Fm, Fm_before, up, down, up0, down0, p.peak_m * up0, p.peak_m * down0, p.Jm, h, jump)
            Fm_before = Fm
            # gearbox and arm masses
            Fg = Tg - Ta
            level = p.coulomb_g + p.load_g * abs(Tg)
            vg_new = dry_step(vg, Fg, Fg_before, level, level, level, level, level, level, p.Jg, h, False)
            Fg_before = Fg
            level = p.coulomb_a
            va_new = dry_step(va, Fa, Fa_before, level, level, level, level, level, level, J, h, False)
            Fa_before = Fa
            am = (vm_new - vm) / h
            ag = (vg_new - vg) / h
            aa = (va_new - va) / h
            vm_old = vm
            qm_old = qm
            vm = vm_new
            vg = vg_new
            va = va_new
            qm = qmh + 0.5 * h * vm
            qg = qgh + 0.5 * h * vg
            qa = qah + 0.5 * h * va
            # sensor
            sv_old = sv
            sa_old = sa
            if p.sen_lag > 0.0:
                sv = 0.5 * (vm + vm_old) + (sv - 0.5 * (vm + vm_old)) * sen_decay
                sa = 0.5 * (qm + qm_old) + (sa - 0.5 * (qm + qm_old)) * sen_decay
            else:
                sv = vm
                sa = qm
            left = dt - (j + 1) * h  # time from the end of this step to the next row
            if left <= sen_part + 1e-12 and left + h > sen_part + 1e-12:
                x = (sen_part - left) / h
                v_late[i + 1] = sv + (sv_old - sv) * x
                a_late[i + 1] = sa + (sa_old - sa) * x
    return u_log, v_meas, v_true, a_meas, a_true, np.array([qm, qg, qa, qe, vm, vg, va, ve])
