"""From rows to a chain: inertias that move together are one body, elements between two bodies are one coupling, in one path."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mjsim.chain import Body, Chain, Coupling
from mjsim.mjcf.drive_laws import Form
from mjsim.mjcf.layout import Layout, Mass, Passive, motion_of, outside, parallel

__all__ = ["Found", "Part", "find_chain"]

_TOL = 1e-9


@dataclass(frozen=True)
class Part:
    """A passive element at its place in the chain; its coordinate is ``scale`` times the body's angle or the deflection."""

    element: Passive
    scale: float


@dataclass(frozen=True)
class Found:
    """A chain and where each of its numbers stands in the model.

    rows (n, nv): coordinate of each body; masses[i]: (mass, scale) of body i; on_body[i], on_coupling[j]: passive elements;
    gaps[j]: slack joints and dead bands of coupling j with their width on the coupling's side.
    """

    layout: Layout
    chain: Chain
    rows: np.ndarray
    masses: tuple[tuple[tuple[Mass, float], ...], ...]
    on_body: tuple[tuple[Part, ...], ...]
    on_coupling: tuple[tuple[Part, ...], ...]
    gaps: tuple[tuple[tuple[str, int, float], ...], ...]

    def base(self) -> np.ndarray:
        """T (nv, n): q' = T x' for body velocities x'."""
        return np.asarray(self.layout.base @ np.linalg.inv(self.rows @ self.layout.base))


def find_chain(layout: Layout, source: object, sensors: tuple[str, str]) -> Found:
    """Recognise the chain; raises InputError that says what is outside the class."""
    base = layout.base
    groups = _groups(layout)
    loose = [g for g in groups if not any(m.kind == "body" for m, _ in g)]
    if loose:
        raise outside(
            source, f"the armature at {loose[0][0][0].name!r} acts on a relative motion and couples two bodies",
            "move it to a body's inertia",
        )  # fmt: skip
    n = base.shape[1]
    if len(groups) != n:
        raise outside(
            source, f"{len(groups)} inertias on {n} degrees of freedom", "give every part of the chain one joint of its own"
        )
    first = next((i for i, g in enumerate(groups) if parallel(g[0][1], layout.drive.row @ base)), None)
    if first is None:
        raise outside(source, f"actuator {layout.drive.name!r} acts between two bodies", "drive the first body of the chain")
    groups.insert(0, groups.pop(first))
    chosen = [_coordinate(layout, g, driven=i == 0) for i, g in enumerate(groups)]
    joints, rows = [c[0] for c in chosen], np.array([c[1] for c in chosen])
    inverse = np.linalg.inv(rows @ base)
    parts = [_share(p, inverse, base) for p in layout.passives]
    order = _path(parts, n, layout, source)
    groups, joints, rows = [groups[i] for i in order], [joints[i] for i in order], rows[order]
    names = [layout.model.joint(j).name or f"#{j}" for j in joints]
    inverse = np.linalg.inv(rows @ base)
    masses = tuple(tuple((m, _ratio(r, x @ base)) for m, r in g) for g, x in zip(groups, rows, strict=True))
    inertia = [_clean(sum(m.value * s * s for m, s in group)) for group in masses]
    on_body: list[list[Part]] = [[] for _ in range(n)]
    on_coupling: list[list[Part]] = [[] for _ in range(n - 1)]
    ratios: list[float | None] = [None] * (n - 1)
    for p in layout.passives:
        share = _share(p, inverse, base)
        where = np.flatnonzero(share)
        if len(where) == 1:
            if any(p.stiffness) and (where[0] > 0 or any(p.stiffness[1:]) or p.gap > 0):  # a linear spring of the driven body
                raise outside(source, f"the spring at {p.name!r} holds {names[where[0]]!r} to the ground", "remove it")
            on_body[where[0]].append(Part(p, float(share[where[0]])))
        elif len(where) == 2:
            j = int(where[0])
            scale = -float(share[j + 1])
            ratio = float(share[j]) / scale
            if p.friction > 0:
                raise outside(source, f"the frictionloss at {p.name!r} acts between two bodies", "put it on an absolute angle")
            known = ratios[j]
            if known is not None and abs(known - ratio) > 1e-7 * abs(known):
                raise outside(
                    source, f"{p.name!r} couples with ratio {ratio:.6g}, another element with {known:.6g}", "use one ratio"
                )
            ratios[j] = ratio if known is None else known
            on_coupling[j].append(Part(p, scale))
    places = _places(n)
    bodies = tuple(
        Body(places[i], inertia[i], _clean(sum(p.element.damping[0] * p.scale**2 for p in on_body[i])), names[i])
        for i in range(n)
    )
    couplings = tuple(
        Coupling(
            _coupling_places(n)[j],
            _clean(ratios[j] or 0.0),
            _clean(sum(p.element.stiffness[0] * p.scale**2 for p in on_coupling[j])),
            _clean(sum(p.element.damping[0] * p.scale**2 for p in on_coupling[j])),
            _coupling_name(layout, on_coupling[j]),
        )
        for j in range(n - 1)
    )
    gaps = _gaps(layout, rows, couplings, on_coupling, source)
    gain = _clean(layout.drive.gain * _ratio(layout.drive.row @ base, rows[0] @ base))
    law = layout.drive.law
    held = ("zero",) if layout.drive.servo is not None and law.form is Form.DCMOTOR else ()  # which a <dcmotor> has none of
    chain = Chain(bodies, couplings, motion_of(layout.model, joints[0]), gain, layout.drive.name, *sensors, layout.drive.servo,
                  driven=layout.drive.id >= 0, idle=law.inputs[1:], held=held)  # fmt: skip
    return Found(layout, chain, rows, masses, tuple(map(tuple, on_body)), tuple(map(tuple, on_coupling)), gaps)


def _groups(layout: Layout) -> list[list[tuple[Mass, np.ndarray]]]:
    """Inertias that move together, each with its row over the motions that the ties leave; without those that cannot move."""
    base = layout.base
    groups: list[list[tuple[Mass, np.ndarray]]] = []
    for mass in layout.masses:
        row = mass.row @ base
        if np.linalg.norm(row) < _TOL * np.linalg.norm(mass.row):
            continue
        for group in groups:
            if parallel(group[0][1], row):
                group.append((mass, row))
                break
        else:
            groups.append([(mass, row)])
    return groups


def _clean(value: float) -> float:
    """Fifteen digits: what was written, without the rounding of the way here."""
    return float(f"{value:.15g}")


def _ratio(row: np.ndarray, unit: np.ndarray) -> float:
    """Row over unit, for parallel rows."""
    return float(row @ unit) / float(unit @ unit)


def _share(p: Passive, inverse: np.ndarray, base: np.ndarray) -> np.ndarray:
    """The element's row in body coordinates, rounding cut off."""
    share = (p.row @ base) @ inverse
    share[np.abs(share) < 1e-10 * np.max(np.abs(share), initial=0.0)] = 0.0
    if np.linalg.norm(p.row @ base) < _TOL * np.linalg.norm(p.row):
        share[:] = 0.0
    return np.asarray(share)


def _coordinate(layout: Layout, group: list[tuple[Mass, np.ndarray]], *, driven: bool) -> tuple[int, np.ndarray]:
    """Joint that stands for a body, and its coordinate's row: the driven joint, or the absolute angle of the heaviest part."""
    model = layout.model
    if driven:
        for mass, _ in group:
            for j in _joints(layout, mass):
                unit = np.zeros(model.nv)
                unit[model.jnt_dofadr[j]] = 1.0
                if parallel(unit, layout.drive.row):
                    return j, unit
    mass = max((m for m, _ in group if m.kind == "body"), key=lambda m: m.value)
    joints = _joints(layout, mass)
    moving = [j for j in joints if np.linalg.norm(layout.base[model.jnt_dofadr[j]]) > _TOL]
    return (moving or joints)[-1], mass.row


def _joints(layout: Layout, mass: Mass) -> list[int]:
    """Joints of a mass: of the body itself, else of the nearest body above it that has some."""
    model = layout.model
    if mass.kind == "joint":
        return [mass.id]
    if mass.kind != "body":
        return []
    b = mass.id
    while model.body_jntnum[b] == 0:
        b = int(model.body_parentid[b])
    return [int(model.body_jntadr[b]) + k for k in range(int(model.body_jntnum[b]))]


def _path(parts: list[np.ndarray], n: int, layout: Layout, source: object) -> list[int]:
    """Order of the bodies along the one path from the driven one."""
    near: list[set[int]] = [set() for _ in range(n)]
    for p, share in zip(layout.passives, parts, strict=True):
        where = np.flatnonzero(share)
        if len(where) > 2:
            raise outside(source, f"{p.name!r} couples {len(where)} bodies at once", "join neighbours only")
        if len(where) == 2:
            a, b = map(int, where)
            near[a].add(b)
            near[b].add(a)
    order = [0]
    while True:
        ahead = sorted(near[order[-1]] - set(order[-2:-1]))
        if len(ahead) > 1:
            raise outside(source, "the chain branches", "keep one path from the actuator to the last body")
        if not ahead or ahead[0] in order:
            break
        order.append(ahead[0])
    if len(order) != n:
        raise outside(
            source,
            f"{n - len(order)} of {n} inertias hang on no spring or damper from the actuator on",
            "couple them, or fix their joints",
        )
    return order


def _places(n: int) -> list[str]:
    if n == 1:
        return ["motor"]
    if n == 2:
        return ["motor", "arm"]
    return ["motor", "gearbox", *(f"body{i}" for i in range(2, n - 1)), "arm"]


def _coupling_places(n: int) -> list[str]:
    if n == 2:
        return ["gearbox"]
    return ["gearbox", *(f"body{i}" for i in range(2, n - 1)), "arm"]


def _coupling_name(layout: Layout, parts: list[Part]) -> str:
    """Element that stands for a coupling: the joint of its spring (also under a tendon over one joint), else its tendon."""
    ranked = sorted(parts, key=lambda p: (not p.element.stiffness[0], p.element.kind != "joint"))
    element = ranked[0].element
    touched = np.flatnonzero(element.row)
    if element.kind == "tendon" and len(touched) == 1:
        return str(layout.model.joint(int(layout.model.dof_jntid[touched[0]])).name) or element.name
    return element.name or f"#{element.id}"


def _gaps(
    layout: Layout, rows: np.ndarray, couplings: tuple[Coupling, ...], on_coupling: list[list[Part]], source: object
) -> tuple[tuple[tuple[str, int, float], ...], ...]:
    """Slack joints and dead bands of every coupling: (kind, id, width on the coupling's side)."""
    model = layout.model
    out: list[list[tuple[str, int, float]]] = [[] for _ in couplings]
    for joint, width in layout.slack.items():
        for j, c in enumerate(couplings):
            deflection = c.ratio * rows[j] - rows[j + 1]
            scale = abs(float(deflection[model.jnt_dofadr[joint]]))
            if scale > _TOL:
                out[j].append(("joint", joint, scale * width))
                break
        else:
            raise outside(
                source, f"the slack at joint {model.joint(joint).name!r} is in series with no spring", "add the joint's stiffness"
            )
    for j, parts in enumerate(on_coupling):
        springs = [p for p in parts if any(p.element.stiffness)]
        if len(springs) > 1 and any(p.element.gap > 0 for p in springs):
            raise outside(
                source, f"a dead band and another spring act side by side at {couplings[j].joint!r}", "keep one of them"
            )
        out[j] += [("tendon", p.element.id, p.element.gap / abs(p.scale)) for p in parts if p.element.gap > 0]
    return tuple(map(tuple, out))
