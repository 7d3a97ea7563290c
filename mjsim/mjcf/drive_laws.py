"""Laws of actuators: the force over the command, and laws that no drive of a chain stands for, each with what works in its place.

    force = gain u + constant + of_length l + of_speed l'        u: the first control, l: length of the transmission

``<motor>``, ``<position>``, ``<velocity>``, ``<intvelocity>`` and ``<general>`` of fixed gain are this law as they stand.
``<pid>``, and ``<dcmotor>`` with the torque-space gains kp and kv = kd of its controller, are it by their inputs, of which those
beside the command are held at zero:

    pos, pos vel    gain = kp, of_length = -kp, of_speed = -kv        the setpoint u slewed by slewmax
    vel             gain = kv, of_speed = -kv                         of kp = 0
    ff              gain = 1, of_speed = -kv                          of kp = 0
    voltage         gain = K / R, of_speed = -K^2 / R                 K: motorconst, R: resistance of a ``<dcmotor>``

With a setpoint ``pos`` there may be a force ki act beside it, act' = u - l.

The force of a controller is limited by its speed where it has a Vmax: K Vmax / R at rest, none at Vmax / K. Cogging and bristles
of a ``<dcmotor>`` act beside this law, outside of its limits.

Source: MuJoCo documentation, XML reference, ``actuator/general``, ``actuator/pid``, ``actuator/dcmotor``; plugin ``mujoco.pid``.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

import mujoco
import numpy as np

__all__ = [
    "CONTROLLER", "IMAX", "DriveLaw", "Form", "begin", "controller_of", "electric_of", "has_more", "law_of", "range_of",
    "refused_law",
]  # fmt: skip

INPUTS = mujoco.mjtCtrlInput
POS, VEL, FF = int(INPUTS.mjINPUT_POS), int(INPUTS.mjINPUT_VEL), int(INPUTS.mjINPUT_FF)
VOLTAGE = int(INPUTS.mjINPUT_VOLTAGE)
WORDS = {POS: "pos", VEL: "vel", FF: "ff", VOLTAGE: "voltage"}
IMAX, SLEW = 0, 1  # of dynprm of a pid
DC_SLEW, ELECTRIC, HEAT = 7, 0, slice(2, 4)  # of dynprm of a dcmotor: slewmax, L / R, thermal resistance and capacitance
BRISTLE = 5  # of dynprm of a dcmotor: its stiffness
RESISTANCE, CONSTANT, KP, KI, KD, VMAX = 0, 1, 4, 5, 6, 7  # of gainprm of a dcmotor
CONTROLLER = ("kp", "ki", "kd", "slewmax", "Imax", "Vmax")  # of the attribute controller of a dcmotor
DC_IMAX = 8  # of dynprm of a dcmotor
SERVOS = (POS, POS | VEL, VEL, FF)  # inputs that are a servo or a torque


class Form(enum.Enum):
    """The element that a law is that of."""

    GENERAL = "general"
    PID = "pid"
    DCMOTOR = "dcmotor"


@dataclass(frozen=True)
class DriveLaw:
    """The law of an actuator, as in the module's text.

    inputs: names of the controls of a ``<pid>`` or ``<dcmotor>``, the command first, empty of a ``<general>``; slew: largest
    speed of the setpoint [rad/s | m/s]; integral: its ki [N m/(rad s) | N/(m s)]; stall [N m | N], no_load [rad/s | m/s]: force
    at rest, and speed without force, of a limited voltage.
    """

    gain: float
    constant: float = 0.0
    of_length: float = 0.0
    of_speed: float = 0.0
    form: Form = Form.GENERAL
    inputs: tuple[str, ...] = ()
    slew: float = math.inf
    integral: float = 0.0
    stall: float = math.inf
    no_load: float = math.inf

    @property
    def servo(self) -> bool:
        """Whether the force depends on the motion."""
        return bool(self.of_length or self.of_speed)


def law_of(model: mujoco.MjModel, a: int) -> DriveLaw:
    """The law of actuator ``a``, which `refused_law` lets pass."""
    constant, of_length, of_speed = (float(x) for x in model.actuator_biasprm[a, :3])
    spec, form = int(model.actuator_ctrlspec[a]), _form(model, a)
    if form is Form.PID:
        gain = -of_length if spec & POS else -of_speed if spec & VEL else 1.0
        slew = _limit(model.actuator_dynprm[a, SLEW])
        ki = float(model.actuator_gainprm[a, 0]) if spec & POS else 0.0
        return DriveLaw(gain, constant, of_length, of_speed, form, _inputs(spec), slew, ki)
    if form is Form.DCMOTOR:
        return _motor(model, a, spec)
    gain = float(model.actuator_gainprm[a, 0])
    if int(model.actuator_biastype[a]) == mujoco.mjtBias.mjBIAS_NONE:
        return DriveLaw(gain)
    return DriveLaw(gain, constant, of_length, of_speed)


def _motor(model: mujoco.MjModel, a: int, spec: int) -> DriveLaw:
    """Of a ``<dcmotor>`` by its voltage or its controller."""
    resistance, constant, kp, kd, most = (float(model.actuator_gainprm[a, i]) for i in (RESISTANCE, CONSTANT, KP, KD, VMAX))
    ki = float(model.actuator_gainprm[a, KI]) if spec & POS else 0.0
    if spec & VOLTAGE:
        per_volt = constant / resistance
        return DriveLaw(per_volt, 0.0, 0.0, -per_volt * constant, Form.DCMOTOR, _inputs(spec))
    gain = kp if spec & POS else kd if spec & VEL else 1.0
    line = (constant * most / resistance, most / constant) if most > 0 else (math.inf, math.inf)
    return DriveLaw(
        gain, 0.0, 0.0 - kp, 0.0 - kd, Form.DCMOTOR, _inputs(spec), _limit(model.actuator_dynprm[a, DC_SLEW]), ki, *line
    )  # fmt: skip


def electric_of(model: mujoco.MjModel, a: int) -> tuple[float, float]:
    """Resistance [Ohm] and motor constant [N m/A] of a ``<dcmotor>``."""
    return float(model.actuator_gainprm[a, RESISTANCE]), float(model.actuator_gainprm[a, CONSTANT])


def controller_of(model: mujoco.MjModel, a: int) -> list[float]:
    """Numbers of the controller of a ``<dcmotor>``, in the order of `CONTROLLER`."""
    gain, dynamics = model.actuator_gainprm[a], model.actuator_dynprm[a]
    return [float(x) for x in (*gain[[KP, KI, KD]], *dynamics[[DC_SLEW, DC_IMAX]], gain[VMAX])]


def has_more(model: mujoco.MjModel, a: int) -> bool:
    """Whether a ``<dcmotor>`` has cogging or a bristle."""
    return bool(model.actuator_biasprm[a, 0] or model.actuator_dynprm[a, BRISTLE])


def _limit(value: float) -> float:
    return float(value) if value > 0 else math.inf


def _inputs(spec: int) -> tuple[str, ...]:
    """Names of the controls, in the order of ctrl."""
    return tuple(word for bit, word in WORDS.items() if spec & bit)


def _form(model: mujoco.MjModel, a: int) -> Form:
    kind = mujoco.mjtGain(int(model.actuator_gaintype[a]))
    return {mujoco.mjtGain.mjGAIN_PID: Form.PID, mujoco.mjtGain.mjGAIN_DCMOTOR: Form.DCMOTOR}.get(kind, Form.GENERAL)


def range_of(model: mujoco.MjModel, a: int) -> tuple[float, float]:
    """Range to which MuJoCo clips the command of actuator ``a``, infinite where there is none."""
    at = int(model.actuator_ctrladr[a])
    if not model.actuator_ctrllimited[at]:
        return -math.inf, math.inf
    low, high = map(float, model.actuator_ctrlrange[at])
    return low, high


def begin(
    model: mujoco.MjModel, data: mujoco.MjData, a: int, before: float, first: float, total: float | None = None,
    integral: float | None = None,
) -> None:  # fmt: skip
    """Set what actuator ``a`` keeps of its command, which was ``before`` for long: delay, filter, integrator, slewed setpoint.

    A slewed setpoint begins at the ``first`` command, unless that acts late. ``total``: state of an integrator, ``before`` where
    None. ``integral``: constant force of the actuator and that of its integral action together [N m | N]; the latter is zero
    where None. Further inputs of the actuator are zero.
    """
    kind, at = mujoco.mjtDyn(int(model.actuator_dyntype[a])), int(model.actuator_actadr[a])
    kept = int(model.actuator_history[a, 0])
    low, high = range_of(model, a)
    if kind == mujoco.mjtDyn.mjDYN_INTEGRATOR:
        data.act[at] = before if total is None else total
    elif kind in (mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT):
        data.act[at] = min(max(before, low), high)
    elif kind in (mujoco.mjtDyn.mjDYN_PID, mujoco.mjtDyn.mjDYN_DCMOTOR) and math.isfinite(law_of(model, a).slew):
        data.act[at] = min(max(before if kept else first, low), high)
    law = law_of(model, a)
    if law.integral and integral is not None:
        data.act[at + math.isfinite(law.slew)] = (integral - law.constant) / law.integral
    if kept:
        held = np.zeros((kept, int(model.actuator_ctrlnum[a])))
        held[:, 0] = before
        mujoco.mj_initCtrlHistory(model, data, a, None, held)


def refused_law(model: mujoco.MjModel, a: int) -> tuple[str, str] | None:
    """What is outside in the law of actuator ``a``, and what to do instead; None where it is a torque or a servo's law."""
    if int(model.actuator_plugin[a]) >= 0:
        return (
            "takes its force from a plugin, which states no law",
            "where it is a PID without an integral part, use <position kp=... kv=...>; or record its torque and use <motor>",
        )
    form = _form(model, a)
    if form is Form.DCMOTOR:
        return _electric(model, a) or _controlled(model, a, float(model.actuator_dynprm[a, DC_IMAX]))
    if form is Form.PID:
        return _controlled(model, a, float(model.actuator_dynprm[a, IMAX]))
    if mujoco.mjtGain(int(model.actuator_gaintype[a])) != mujoco.mjtGain.mjGAIN_FIXED:
        return "has a gain that depends on the motion", "use <motor>, or gaintype fixed"
    return None


def _controlled(model: mujoco.MjModel, a: int, imax: float) -> tuple[str, str] | None:
    """Inputs and gains that make no servo and no torque; ``imax``: of the integral action."""
    spec, law, tag = int(model.actuator_ctrlspec[a]), law_of(model, a), f"<{_form(model, a).value}>"
    if spec not in SERVOS and spec != VOLTAGE:
        return (
            f"is a {tag} with the inputs {' '.join(law.inputs)}, of which a log holds one",
            'use input="pos" (or "pos vel", its velocity setpoint held at zero), "vel" or "ff"',
        )
    if law.integral and imax:
        return f"is a {tag} that stops its integral at imax = {imax:g}", 'use imax="0", where the integral stays within it'
    if spec & POS and law.of_length == 0.0:
        return f"is a {tag} with a position setpoint and kp = 0, which does nothing", 'give it kp, or use input="vel"'
    if spec == VEL and law.of_speed == 0.0:
        return (
            f"is a {tag} with a velocity setpoint and no gain on it, which does nothing",
            'give it that gain, or use input="ff"',
        )
    if not spec & POS and law.of_length != 0.0:
        return (
            f'is a {tag} of input="{WORDS[spec]}" whose kp = {-law.of_length:g} holds the joint at 0',
            'write kp="0" (the default of a <pid> is 1), and give the joint that stiffness where there is such a spring',
        )
    if not spec & POS and math.isfinite(law.slew):
        return f'is a {tag} of input="{WORDS[spec]}" with slewmax', "write slewmax = 0: that of a position setpoint can be read"
    if spec == FF and not law.servo and math.isfinite(law.stall):
        return f"is a {tag} by its torque with a Vmax", "write Vmax = 0, and limit the torque by saturation"
    return None


def _electric(model: mujoco.MjModel, a: int) -> tuple[str, str] | None:
    """What of a motor's electric part no law stands for."""
    dynamics = model.actuator_dynprm[a]
    if dynamics[ELECTRIC] > 0:
        return (
            f"is a <dcmotor> with inductance: its current follows voltage and back-EMF within {float(dynamics[ELECTRIC]):g} s, "
            "which no lag of its command is",
            "leave inductance (and current_rate) out where that time is short against the sample time; or record the current and "
            "use <motor> with motorconst times gear as its gear",
        )
    if np.any(dynamics[HEAT] > 0):
        return (
            "is a <dcmotor> whose resistance changes with its temperature",
            "leave thermal out: a recording shows the resistance at which it was made",
        )
    return None
