"""What each law promises beside a structure, by the slope of the error at its starts: a score test of each law."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from diagnose.robot.servos.fit import jacobian, start_of
from diagnose.robot.servos.library import ServoLaw
from diagnose.robot.servos.motion import JointProblem
from diagnose.robot.servos.starts import THIN
from diagnose.robot.servos.state import JointSearch, Structure, cleared, free_numbers, replaced
from mjsim.robot.joint_kernel import SLOT

__all__ = ["own_as_in_file", "screen", "with_start"]

SMALLEST = 0.02  # of the size of a start: the least that a screening makes of it


def with_start(s: JointSearch, law: ServoLaw, start: dict[str, float], base: np.ndarray) -> np.ndarray:
    """Slots of a start beside what stands; dry friction keeps the size that it has."""
    out, values = base.copy(), dict(start)
    present = float(base[SLOT["friction"]])
    if "friction" in values and present > 0:
        ratio = present / values["friction"]
        values["friction"] = present * (0.8 if "extra" in values else 1.0)
        for name in ("extra", "asymmetry"):
            if name in values:
                values[name] *= ratio
    for name, value in values.items():
        for slot in ("load", "load_back") if name == "load_both" else (name,):
            out[SLOT[slot]] = value
    return out


def own_as_in_file(s: JointSearch, slots: np.ndarray) -> np.ndarray:
    """Slots with the joint's own numbers as in the file, where it has them: without a law they have taken its place."""
    out = slots.copy()
    for name in ("kp", "kv", "damping", "armature", "zero"):
        given = float(s.problem.nominal[SLOT[name]])
        out[SLOT[name]] = given if given > 0.0 or name == "zero" else out[SLOT[name]]
    return out


def screen(s: JointSearch, now: Structure, laws: Sequence[ServoLaw]) -> list[tuple[float, ServoLaw, np.ndarray]]:
    """(promised gain less the price, law, slots of its best start), most first.

    A run at a start is one direction d of the error; what it explains beside the free numbers is (d'r)^2 / d'd, both projected
    on the complement of their derivatives. Where numbers of the joint have taken the place of a law, its direction tells nothing:
    what a run leaves at a start beside the file's own numbers counts as well. A law that is linear in several numbers is screened
    along all of them.
    """
    part = s.problem.windows(THIN)
    weights = s.weights[part.rows]
    each = weights[part.fitted]
    J = jacobian(part, now.fit.numbers, now.fit.x, now.fit.slots, weights)[: int(part.fitted.sum())]
    Q = np.linalg.qr(J + 1e-12)[0]
    r = each * part.error(now.fit.slots)[part.fitted]
    r0 = r - Q @ (Q.T @ r)
    left = float(r0 @ r0)
    n = s.independent_samples
    out = []
    for law in laws:
        if len(law.linear) > 1:
            out.append(_screened_together(s, now, law, part, each, left))
            continue
        best: tuple[float, np.ndarray] | None = None
        for start in law.starts:
            slots = with_start(s, law, dict(start), now.fit.slots)
            d = each * part.error(slots)[part.fitted] - r
            d = d - Q @ (Q.T @ d)
            size = float(d @ d)
            explained = float(d @ r0) ** 2 / size if size > 1e-12 * left else 0.0
            for name in law.linear:  # the size that explains most along this direction
                slots[SLOT[name]] *= min(max(-float(d @ r0) / (size + 1e-300), SMALLEST), 1.0 / SMALLEST)
            if float(d @ r0) > 0 and _one_sided(law):
                explained = 0.0  # the error would grow with it
            given = own_as_in_file(s, slots)
            beside = left - float(np.sum((each * part.error(given)[part.fitted]) ** 2))
            if beside > explained:
                explained, slots = beside, given
            if best is None or explained > best[0]:
                best = explained, slots
        assert best is not None
        promised = -n * math.log(max(1.0 - best[0] / left, 1e-9)) - s.price([law])
        out.append((promised, law, best[1]))
    return sorted(out, key=lambda x: -x[0])


def _screened_together(
    s: JointSearch, now: Structure, law: ServoLaw, part: JointProblem, each: np.ndarray, left: float
) -> tuple[float, ServoLaw, np.ndarray]:
    """(promised gain less the change of the price, law, slots) of a law that is linear in several signed numbers.

    The laws that it takes the place of are cleared, and its numbers are those of a regression of the error that is then there,
    beside the joint's other free numbers. ``left``: projected sum of squares of what stands.
    """
    laws = replaced(now.laws, law)
    base = cleared(now.laws, laws, with_start(s, law, dict(law.starts[0]), now.fit.slots), s.problem.nominal)
    for name in law.linear:
        base[SLOT[name]] = s.problem.nominal[SLOT[name]]
    numbers = free_numbers(s.numbers, tuple(x for x in laws if x is not law))
    J = jacobian(part, numbers, start_of(numbers, base), base, s.weights[part.rows])[: int(part.fitted.sum())]
    Q = np.linalg.qr(J + 1e-12)[0]
    r = each * part.error(base)[part.fitted]
    sizes = {x.slot: x.scale for x in law.numbers}
    columns = []
    for name in law.linear:
        moved = base.copy()
        moved[SLOT[name]] += sizes[name]
        columns.append(each * part.error(moved)[part.fitted] - r)
    D, r = np.column_stack(columns), r - Q @ (Q.T @ r)
    D = D - Q @ (Q.T @ D)
    amounts = np.clip(-np.linalg.lstsq(D, r, rcond=1e-6)[0], -1.0 / SMALLEST, 1.0 / SMALLEST)
    rest = r + D @ amounts
    for name, amount in zip(law.linear, amounts, strict=True):
        base[SLOT[name]] += amount * sizes[name]
    more = s.price(laws) - s.price(now.laws)
    return -s.independent_samples * math.log(max(float(rest @ rest) / left, 1e-9)) - more, law, base


def _one_sided(law: ServoLaw) -> bool:
    """Whether all amplitudes of a law are positive."""
    return all(n.log for n in law.numbers)
