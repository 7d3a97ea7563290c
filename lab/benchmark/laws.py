"""The numbers of the sealed plant: one flat record that the compiled solver reads; every law is inactive by default."""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["GAP_ELASTO", "GAP_IMPACT", "GAP_NO_PULL", "Laws"]

# How a joint with play transmits torque once it is in contact (field `gap_law_*`).
GAP_ELASTO = 0.0  # k e + d phi' : ElastoBacklash of 1999; jumps at contact, able to pull
GAP_NO_PULL = 1.0  # the same, never pulling (2007)
GAP_IMPACT = 2.0  # k e (1 + c |phi'| sign(e phi')) : Hunt-Crossley compliant impact; no jump, never pulling


class Laws(NamedTuple):
    """Every number the plant knows [SI; motor side for the motor, arm side for gearbox and arm].

    The fields named as in Table 2 of the study are the linear axis; the others are effects, inactive at their defaults.
    """

    # linear axis (Table 2)
    Jm: float = 4.56e-4
    Jg: float = 9.92
    Ja: float = 1.72
    fm: float = 3.55e-2
    kg: float = 1.50e5
    ka: float = 0.446e5
    dg: float = -62.0
    da: float = 20.0
    ratio: float = 1.0 / 118.0

    # dry friction of the motor: level(v, t, angle) and a breakaway factor at standstill
    coulomb_m: float = 0.0
    peak_m: float = 1.0
    asymmetry_m: float = 0.0
    stribeck_extra: float = 0.0
    stribeck_speed: float = 1.0
    load_m: float = 0.0
    drift_change: float = 0.0
    drift_time: float = 1.0
    place_amplitude: float = 0.0
    place_cycles: float = 0.0
    place_phase: float = 0.0
    quadratic_m: float = 0.0
    # bristle friction of the motor (Dahl where the damping is nought, LuGre else)
    bristle_level: float = 0.0
    bristle_stiffness: float = 1.0
    bristle_damping: float = 0.0
    bristle_extra: float = 0.0
    bristle_speed: float = 1.0
    # dry friction of gearbox and arm
    coulomb_g: float = 0.0
    load_g: float = 0.0
    coulomb_a: float = 0.0

    # joints
    gap_g: float = 0.0
    gap_law_g: float = GAP_ELASTO
    impact_g: float = 0.0
    cubic_g: float = 0.0
    slip_stiffness_g: float = 0.0
    slip_torque_g: float = 0.0
    gap_a: float = 0.0
    gap_law_a: float = GAP_ELASTO
    impact_a: float = 0.0
    cubic_a: float = 0.0
    slip_stiffness_a: float = 0.0
    slip_torque_a: float = 0.0
    slip_sharp: float = 0.0  # 0: Bouc-Wen, yields gradually; 1: one Maxwell element, yields at once
    error_amplitude: float = 0.0
    error_cycles: float = 0.0
    error_phase: float = 0.0
    error_relaxed: float = 0.0  # 1: the axis starts with its spring unstrained in spite of the error at angle zero

    # torques on the motor and on the arm, the arm's inertia, a further mode
    ripple_amplitude: float = 0.0
    ripple_cycles: float = 0.0
    ripple_phase: float = 0.0
    offset_m: float = 0.0
    gravity: float = 0.0
    gravity_phase: float = 0.0
    inertia_amplitude: float = 0.0
    inertia_cycles: float = 0.0
    inertia_phase: float = 0.0
    Je: float = 0.0
    ke: float = 0.0
    de: float = 0.0

    # actuator
    droop: float = 0.0
    limit: float = 1e300
    deadzone: float = 0.0
    act_lag: float = 0.0
    act_delay: float = 0.0

    # sensor (velocity and angle pass the same lag and delay; step and offset are the velocity's, encoder the angle's)
    sen_lag: float = 0.0
    sen_delay: float = 0.0
    sen_step: float = 0.0
    sen_step_first: float = 0.0  # 1: rounded ahead of the noise (a coarse digital signal on a noisy line)
    sen_offset: float = 0.0
    encoder_step: float = 0.0
    repeat_amplitude: float = 0.0  # error of the angle over one turn [rad]; the velocity shows its derivative
    repeat_cycles: float = 0.0
    repeat_phase: float = 0.0

    # laws that no library of effects knows
    x_load_speed: float = 0.0  # c |r Tg| v |v| opposing the motor [s2/rad2]
    x_lag_level: float = 0.0  # frictional memory: level falls with the *lagged* speed [Nm]
    x_lag_time: float = 1.0
    x_lag_speed: float = 1.0
    x_heat: float = 0.0  # the heat of friction lowers that level [1/J]
    x_heat_time: float = 1.0
    x_clutch: float = 1e300  # torque limit of a slipping clutch in the gearbox, arm side [Nm]
    x_cog: float = 0.0  # cogging growing with speed [Nm s/rad]
    x_cog_first: float = 0.0
    x_cog_second: float = 0.0
    x_soft: float = 0.0  # arm stiffness ka (1 + c sin(n (arm angle) + phase))
    x_soft_cycles: float = 0.0
    x_soft_phase: float = 0.0
    x_detent: float = 0.0  # detent with memory: -A sin(n (angle - memory)) [Nm]
    x_detent_cycles: float = 0.0
    x_detent_width: float = 1.0
    x_derate: float = 0.0  # the torque gain falls with the filtered u^2 [1/Nm2]
    x_derate_time: float = 1.0
    x_fade: float = 0.0  # the available torque falls with speed while driving: u (1 - c |v|) for u v > 0 [s/rad]
