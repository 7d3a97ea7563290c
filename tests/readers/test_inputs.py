"""The input of a log: a control value of the actuator by its header, a drive that was off, a binding that names a part."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mjsim.binding import Binding
from mjsim.chain import Body, Chain
from mjsim.control import as_driven
from mjsim.errors import InputError
from mjsim.readers import Table, guess_control
from mjsim.recording import Recording, from_table
from mjsim.servo import Servo, Target

N = 200
T = 0.01 * np.arange(N)
U, Q = np.sin(3.0 * T), np.cos(2.0 * T)
BODY = (Body("motor", 0.1, 0.0, "hinge"),)
MOTOR = Chain(BODY, (), gain=8.8, actuator="motor")
PLAIN = Chain(BODY, (), actuator="motor")
DC = Chain(BODY, (), actuator="motor", servo=Servo(0.0, 0.02, Target.VELOCITY, scale=5.0))
SERVO = Chain(BODY, (), actuator="servo", servo=Servo(9.0, 0.3))
SPEED = Chain(BODY, (), actuator="loop", servo=Servo(0.0, 2.0, Target.VELOCITY))
FREE = Chain(BODY, (), actuator="", driven=False)


def read(columns: dict[str, np.ndarray], toml: str = "", *, driven: bool = True) -> Recording:
    import tomllib

    binding = Binding.from_tables(tomllib.loads(toml), Path("log.toml")) if toml else None
    return from_table(Path("log.csv"), Table.of(columns), binding or Binding.default(), driven=driven)


@pytest.mark.parametrize(
    ("columns", "found"),
    [
        (("voltage_V", "angle_rad"), ("voltage_V", "V")),
        (("current_A",), ("current_A", "A")),
        (("Motor current [mA]",), ("Motor current [mA]", "mA")),
        (("motor_current",), ("motor_current", "1")),
        (("iq_A",), ("iq_A", "A")),
        (("ctrl",), ("ctrl", "1")),
        (("u",), ("u", "1")),
        (("pwm",), ("pwm", "1")),
        (("command_V",), ("command_V", "V")),
        (("supply_V",), None),
        (("bus voltage [V]",), None),
        (("current_A", "voltage_V"), None),
        (("torque_Nm", "acceleration"), None),
    ],
)
def test_a_control_value_is_known_by_its_header(columns, found):
    assert guess_control(columns) == found


@pytest.mark.parametrize("header", ["current_A", "voltage_V", "ctrl", "u", "pwm", "motor_current"])
def test_a_log_of_a_control_value_and_an_angle_is_read(header):
    record = read({"time_s": T, header: U, "angle_rad": Q})
    assert record.control is not None
    assert record.current is None
    assert np.array_equal(record.input, U)
    assert header == "ctrl" or "Columns guessed from their headers" in record.notes[0]
    assert np.array_equal(as_driven(MOTOR, record).torque, U)


def test_milliamperes_are_amperes():
    record = read({"time_s": T, "current_mA": U, "angle_rad": Q})
    assert np.allclose(record.input, 1e-3 * U)
    assert record.units["control"] == "A"


def test_a_torque_or_a_command_goes_before_a_control():
    record = read({"time_s": T, "torque_Nm": U, "current_A": 2 * U, "angle_rad": Q})
    assert record.control is None
    assert record.current is not None
    command = read({"time_s": T, "command_rad": U, "ctrl": 2 * U, "angle_rad": Q})
    assert np.array_equal(as_driven(SERVO, command).input, U)


@pytest.mark.parametrize(
    ("chain", "header", "role"),
    [(MOTOR, "voltage_V", "torque"), (DC, "voltage_V", "command"), (SERVO, "ctrl", "command"), (SPEED, "u", "command")],
)
def test_the_model_says_what_a_control_is(chain, header, role):
    record = as_driven(chain, read({"time_s": T, header: U, "angle_rad": Q}))
    assert np.array_equal(getattr(record, role), U)
    assert record.control is None


@pytest.mark.parametrize(
    ("chain", "header", "said"),
    [
        (PLAIN, "current_A", r"\[recording\] / torque = \{ column = 'current_A', unit = 'A', gain = X \}"),
        (PLAIN, "voltage_V", "unit = 'V', gain = X"),
        (SERVO, "current_A", "is a current .A., and 'servo' of the model is a servo"),
        (DC, "current_A", "is a current"),
        (SPEED, "voltage_V", "is a voltage"),
    ],
)
def test_a_control_of_another_kind_is_refused(chain, header, said):
    with pytest.raises(InputError, match=said):
        as_driven(chain, read({"time_s": T, header: U, "angle_rad": Q}))


def test_the_two_lines_that_the_refusal_tells_are_enough():
    toml = "[recording]\ntorque = { column = 'current_A', unit = 'A', gain = 0.11 }"
    record = read({"time_s": T, "current_A": U, "angle_deg": Q}, toml)
    assert np.allclose(record.torque, 0.11 * U)
    assert np.allclose(record.angle, np.radians(Q))
    assert "angle = 'angle_deg' [deg]" in record.notes[0]


def test_two_candidates_are_no_guess():
    with pytest.raises(InputError, match="no column 'torque_Nm'"):
        read({"time_s": T, "current_A": U, "voltage_V": U, "angle_rad": Q})


def test_a_drive_that_was_off_needs_no_column():
    record = read({"time_s": T, "angle_rad": Q}, '[recording]\ninput = "none"')
    assert not record.driven
    assert record.judge == "motion"
    assert not record.torque.any()
    assert "torque_Nm" not in record.signals()
    assert not as_driven(MOTOR, record).driven


def test_a_drive_that_was_off_leaves_the_columns_of_an_input_out():
    record = read({"time_s": T, "torque_Nm": U, "angle_rad": Q}, '[recording]\ninput = "none"')
    assert not record.torque.any()


def test_without_an_input_the_error_tells_how_to_say_that_the_drive_was_off():
    with pytest.raises(InputError, match='where the drive was off, write input = "none"'):
        read({"time_s": T, "angle_rad": Q})


@pytest.mark.parametrize(
    ("toml", "said"),
    [('input = "off"', "'off'; expected \"none\""), ('input = "none"\ntorque = "torque_Nm"', "and a column for torque")],
)
def test_input_is_none_or_a_column(toml, said):
    with pytest.raises(InputError, match=said):
        read({"time_s": T, "torque_Nm": U, "angle_rad": Q}, f"[recording]\n{toml}")


def test_a_servo_cannot_be_off():
    record = read({"time_s": T, "angle_rad": Q}, '[recording]\ninput = "none"')
    with pytest.raises(InputError, match="a servo, which acts without an input"):
        as_driven(SERVO, record)


def test_a_model_without_an_actuator_needs_no_input():
    record = as_driven(FREE, read({"time_s": T, "angle_deg": Q}, driven=False))
    assert not record.driven
    assert not record.torque.any()


def test_a_torque_needs_an_actuator():
    record = read({"time_s": T, "torque_Nm": U, "angle_rad": Q}, driven=False)
    with pytest.raises(InputError, match="the model has no actuator"):
        as_driven(FREE, record)
    zero = read({"time_s": T, "torque_Nm": 0 * U, "angle_rad": Q}, driven=False)
    assert not as_driven(FREE, zero).driven
