"""Where a free run starts that suits a recording: Gauss-Newton steps by the fitting engine, whose runs cost little."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.thresholds import SIGMAS, SMALL
from diagnose.verdict.reference import Case, Run, judged
from mjsim.axis import Axis
from mjsim.effects import NotApplicableError
from mjsim.ode import DivergedError, simulate
from mjsim.plant import Start
from mjsim.system import assemble

__all__ = ["OWN_STEP", "ROUNDS", "Shift", "errors_of", "run_surrogate", "suited"]

OWN_STEP = 0.1  # standard deviations of a difference
ROUNDS = 8  # Gauss-Newton steps of a start, or of a file's numbers
PARTS = (1.0, 0.3, 0.1)  # of a step

Errors = Callable[[Case, Run], np.ndarray]


@dataclass(frozen=True, eq=False)
class Shift:
    """How far a start is moved from an origin, in standard deviations (s,), by name; what one does (n, s) to the errors."""

    origin: Start
    names: tuple[str, ...]
    sizes: tuple[float, ...]
    responses: np.ndarray
    moved: np.ndarray

    def best(self, e: np.ndarray) -> tuple[np.ndarray, float]:
        """The change (s,) of the shift that suits errors e (n,) over the noise, and the fall of the cost that it promises."""
        x = self.responses
        change = np.linalg.solve(x.T @ x + np.eye(x.shape[1]), x.T @ e - self.moved)
        after, total = e - x @ change, self.moved + change
        return change, float(e @ e + self.moved @ self.moved - after @ after - total @ total)

    def explains(self, e: np.ndarray) -> bool:
        """Whether a start as far off as one may be can make up what errors e (n,) over the noise have beyond noise."""
        most = SIGMAS**2 * float(np.sum(self.responses**2))
        return most >= float(e @ e) - len(e)

    def start(self, moved: np.ndarray) -> Start:
        """The start that is so far from the origin."""
        return _moved(self.origin, {name: size * float(m) for name, size, m in zip(self.names, self.sizes, moved, strict=True)})


def _moved(origin: Start, by: Mapping[str, float]) -> Start:
    """A start with some of its numbers moved, by name.

    Those of couplings are `deflection` and `rate` with their place, those of effects `state` with their name.
    """
    deflections, rates, states = dict(enumerate(origin.deflections)), dict(enumerate(origin.rates)), dict(origin.states)
    own = {"angle": origin.angle, "velocity": origin.velocity}
    for name, value in by.items():
        kind, _, at = name.partition(":")
        if kind in own:
            own[kind] += value
        elif kind == "state":
            states[at] += value
        else:
            which = deflections if kind == "deflection" else rates
            which[int(at)] = which.get(int(at), 0.0) + value

    def row(of: Mapping[int, float]) -> tuple[float, ...]:
        return tuple(of.get(j, 0.0) for j in range(max(of, default=-1) + 1))

    return dataclasses.replace(origin, **own, deflections=row(deflections), rates=row(rates), states=tuple(states.items()))


def run_surrogate(
    axis: Axis, case: Case, start: Start, *, locked: bool = True, along: np.ndarray | None = None
) -> Run | None:  # fmt: skip
    """The fitting engine's run on a recording; None where it diverges.

    ``locked``: laws that repeat over the angle follow the recorded one, as in a fit; else the run's own, as in MuJoCo. ``along``
    (N,): an angle that all laws follow, gravity and springs too.
    """
    r = case.recording
    try:
        angle = (r.angle if along is None else along) if locked and not case.servo else None
        system = assemble(axis.started(start.states))
        y = simulate(
            system if along is None else system.tied(),
            r.input,
            r.dt,
            initial=start.of_bodies(system.f[2, :-1].tolist()),
            angle=angle,
            origin=0.0,
            before=start.input,
            hold=r.hold,
        )
    except (DivergedError, ValueError):
        return None
    return Run(np.array(y.velocity), np.array(y.angle), start)


def errors_of(case: Case, run: Run) -> np.ndarray:
    """Errors over the noise of all samples that count."""
    return np.asarray((case.measured - judged(case, run))[case.estimation | case.held_out] / case.sigma)


@dataclass(frozen=True)
class _Trial:
    """Errors of the engine's run of an axis on a case from a start; None where it diverges."""

    case: Case
    errors: Errors
    locked: bool

    def __call__(self, axis: Axis, start: Start) -> np.ndarray | None:
        """Run, and compare."""
        run = run_surrogate(axis, self.case, start, locked=self.locked)
        return None if run is None else self.errors(self.case, run)


def _moves(axis: Axis, case: Case) -> list[tuple[str, float]]:
    """Numbers of a start that are not known, and their standard deviations: those of couplings where it is in motion.

    A coupling's rate is known to the rms speed s of the body behind it, its deflection to s over the frequency of what is there.
    """
    moves = [(name, size) for name, size in zip(("angle", "velocity"), case.spread(), strict=True) if size > 0]
    moves += [(f"state:{name}", max(_asked(axis, case), abs(value))) for name, value in axis.start_states.items()]
    if not case.moving or case.servo:
        return moves
    try:
        inertia, ratio, stiffness = assemble(axis).f[[0, 2, 3]].tolist()
    except (NotApplicableError, ValueError):
        return moves
    speed, behind = float(np.sqrt(np.mean(case.measured**2))), 0.0
    found: list[tuple[str, float]] = []
    for j in reversed(range(len(inertia) - 1)):
        behind = inertia[j + 1] + behind * (ratio[j + 1] ** 2 if j + 2 < len(inertia) else 0.0)
        rate = speed * abs(math.prod(ratio[: j + 1]))
        if stiffness[j] > 0.0:
            found += [(f"deflection:{j}", rate * math.sqrt(behind / stiffness[j]))]
        found += [(f"rate:{j}", rate)]
    return [*moves, *found]


def _asked(axis: Axis, case: Case) -> float:
    """Rms force of the actuator that a servo asks for along a recording, without damping and limit [N m | N]."""
    s, servo, r = assemble(axis), axis.chain.servo, case.recording
    if servo is None or r.angle is None:
        return 0.0
    force = servo.kp * (servo.scale * r.input - servo.zero) - s.servo[0] / axis.chain.gain * r.angle
    return float(np.sqrt(np.mean(force**2)))


def suited(axis: Axis | None, case: Case, *, errors: Errors | None = None, locked: bool = False) -> tuple[Start, Shift | None]:
    """Where a run of the engine starts that suits the recording best, each number as its noise allows: Gauss-Newton steps.

    None beside it where the start is known, or changes nothing that shows. ``errors`` (M,), over the noise: others than those of
    the judged signal; ``locked``: as in `run_surrogate`.
    """
    origin, trial = case.start(), _Trial(case, errors or errors_of, locked)
    if axis is None:
        return origin, None
    origin = dataclasses.replace(origin, states=tuple(axis.start_states.items()))
    moves = _moves(axis, case)
    e, shift = trial(axis, origin) if moves else None, None
    if e is None:
        return origin, None
    for _ in range(ROUNDS):
        fresh = _slopes(axis, trial, origin, moves, e, shift)
        if fresh is None:
            break
        shift = fresh
        change, promised = shift.best(e)
        if promised < max(1.0, float(e @ e) / len(e)):  # no number of the start moves by a standard error
            break
        better = next(
            (t for t in (_moved_on(axis, trial, origin, shift, part * change, e) for part in PARTS) if t is not None), None
        )
        if better is None:
            break
        shift, e = better
    return (origin, None) if shift is None else (shift.start(shift.moved), shift)


def _slopes(
    axis: Axis, trial: _Trial, origin: Start, moves: Sequence[tuple[str, float]], e: np.ndarray, last: Shift | None
) -> Shift | None:
    """The shift so far with the engine's slopes there, of the numbers that show; None where none does."""
    if last is not None:
        moves = list(zip(last.names, last.sizes, strict=True))
    start = origin if last is None else last.start(last.moved)
    found = []
    for k, (name, size) in enumerate(moves):
        other = trial(axis, _moved(start, {name: OWN_STEP * size}))
        response = None if other is None else (e - other) / OWN_STEP
        if response is not None and (last is not None or math.sqrt(float(np.mean(response**2))) > SMALL):
            found.append((name, size, response, 0.0 if last is None else float(last.moved[k])))
    if not found:
        return None
    names, sizes, responses, moved = zip(*found, strict=True)
    return Shift(origin, names, sizes, np.column_stack(responses), np.array(moved))


def _moved_on(
    axis: Axis, trial: _Trial, origin: Start, shift: Shift, change: np.ndarray, e: np.ndarray
) -> tuple[Shift, np.ndarray] | None:
    """The shift moved on, and the errors there; None where the cost does not fall."""
    moved = np.clip(shift.moved + change, -SIGMAS, SIGMAS)
    rest = trial(axis, shift.start(moved))
    if rest is None or not rest @ rest + moved @ moved < e @ e + shift.moved @ shift.moved:
        return None
    return dataclasses.replace(shift, moved=moved), rest
