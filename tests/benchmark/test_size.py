"""The size of a concealed effect: what nothing else in the plant can stand in for."""

from __future__ import annotations

import numpy as np

from lab.benchmark.catalogue import compose, find
from lab.benchmark.experiment import multisine
from lab.benchmark.laws import Laws
from lab.benchmark.size import sizes

TORQUE = multisine(2.0, 0.6, 0.1, 60.0, np.random.default_rng(4)).torque
NOISE = 0.05


def test_an_offset_beside_friction_of_two_levels_is_no_effect_of_its_own() -> None:
    offset, friction = find("torque_offset", "motor"), find("asymmetric_friction", "motor")
    laws = compose(Laws(), offset, {"torque_Nm": -0.01})
    laws = compose(laws, friction, {"torque_Nm": 0.07, "asymmetry_Nm": 0.009})
    alone = sizes(laws, offset, TORQUE, NOISE)
    beside = sizes(laws, offset, TORQUE, NOISE, beside=(offset, friction))
    assert alone is not None
    assert alone.distinct > 1.0
    assert beside is not None
    assert beside.distinct < 1e-3


def test_a_delay_beside_friction_stays_what_it_is() -> None:
    delay, friction = find("time_delay", "sensor"), find("coulomb_friction", "motor")
    laws = compose(Laws(), delay, {"delay_s": 9e-4})
    laws = compose(laws, friction, {"torque_Nm": 0.1})
    beside = sizes(laws, delay, TORQUE, NOISE, beside=(delay, friction))
    assert beside is not None
    assert 0.8 * beside.after_refit < beside.distinct <= beside.after_refit


def test_the_steps_of_a_sensor_are_noise_to_what_else_is_there() -> None:
    steps, mode = find("sensor_quantisation", "sensor"), find("extra_flexible_mode", "arm")
    laws = compose(Laws(), mode, {"inertia_kgm2": 0.085, "stiffness_Nm_rad": 9440.0, "damping_Nms_rad": 2.5})
    smooth = sizes(laws, mode, TORQUE, NOISE)
    beside = sizes(compose(laws, steps, {"step": 0.11}), mode, TORQUE, NOISE, beside=(steps, mode))
    assert smooth is not None
    assert beside == smooth
