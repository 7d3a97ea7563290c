"""Inertial parameters of a rigid body as a vector (10,), as a pseudo-inertia matrix (4, 4) and as MuJoCo writes them.

phi = [m, m cx, m cy, m cz, Ixx, Iyy, Izz, Ixy, Ixz, Iyz], in the frame of the body and about its origin [kg, kg m, kg m^2].
A rigid body of positive mass density has a positive definite pseudo-inertia [[S, h], [h', m]], S = tr(I)/2 1 - I, h = m c:
that is mass above zero, inertia positive definite and the triangle inequality.
Source: P. M. Wensing, S. Kim, J.-J. E. Slotine, IEEE Robotics and Automation Letters 3 (2018) 60.
"""

from __future__ import annotations

import mujoco
import numpy as np

__all__ = ["NAMES", "SIZE", "from_body", "moved", "point_mass", "pseudo_inertia", "to_body", "unpack_pseudo_inertia"]

NAMES = ("mass", "mx", "my", "mz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")
SIZE = len(NAMES)


def _vector(mass: float, first: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    i = inertia
    return np.array([mass, *first, i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]], float)


def _matrix(phi: np.ndarray) -> np.ndarray:
    """Rotational inertia (3, 3) about the frame's origin."""
    xx, yy, zz, xy, xz, yz = phi[4:]
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _about_origin(mass: float, centre: np.ndarray, central: np.ndarray) -> np.ndarray:
    return _vector(mass, mass * centre, central + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre)))


def _rotation(quat: np.ndarray) -> np.ndarray:
    out = np.zeros(9)
    mujoco.mju_quat2Mat(out, np.asarray(quat, float))
    return out.reshape(3, 3)


def from_body(mass: float, ipos: np.ndarray, iquat: np.ndarray, principal: np.ndarray) -> np.ndarray:
    """Parameters (10,) of a body from MuJoCo's mass, centre of mass, principal axes (quaternion wxyz) and principal inertia."""
    R = _rotation(iquat)
    return _about_origin(mass, np.asarray(ipos, float), R @ np.diag(principal) @ R.T)


def to_body(phi: np.ndarray) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
    """Mass, centre of mass (3,), principal axes (quaternion wxyz) and principal inertia (3,), largest first, of phi (10,)."""
    mass = float(phi[0])
    c = phi[1:4] / mass
    central = _matrix(phi) - mass * (c @ c * np.eye(3) - np.outer(c, c))
    values, axes = np.linalg.eigh(central)
    values, axes = values[::-1], axes[:, ::-1].copy()
    if np.linalg.det(axes) < 0:
        axes[:, 2] *= -1
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, axes.ravel())
    return mass, c, quat, values


def moved(phi: np.ndarray, pos: np.ndarray, quat: np.ndarray) -> np.ndarray:
    """Parameters (10,) in a parent frame in which the body's own frame stands at ``pos`` with the orientation ``quat``."""
    R, p, m = _rotation(quat), np.asarray(pos, float), phi[0]
    h = R @ phi[1:4]
    inertia = R @ _matrix(phi) @ R.T + (2 * (h @ p) + m * (p @ p)) * np.eye(3)
    inertia -= np.outer(h, p) + np.outer(p, h) + m * np.outer(p, p)
    return _vector(m, h + m * p, inertia)


def point_mass(mass: float, pos: np.ndarray) -> np.ndarray:
    """Parameters (10,) of a point mass [kg] at ``pos`` [m]."""
    return _about_origin(mass, np.asarray(pos, float), np.zeros((3, 3)))


def pseudo_inertia(phi: np.ndarray) -> np.ndarray:
    """Pseudo-inertia (..., 4, 4) of parameters (..., 10)."""
    phi = np.asarray(phi, float)
    out = np.empty((*phi.shape[:-1], 4, 4))
    xx, yy, zz, xy, xz, yz = np.moveaxis(phi[..., 4:], -1, 0)
    half = 0.5 * (xx + yy + zz)
    for i, value in enumerate((xx, yy, zz)):
        out[..., i, i] = half - value
    for (i, j), value in zip(((0, 1), (0, 2), (1, 2)), (xy, xz, yz), strict=True):
        out[..., i, j] = out[..., j, i] = -value
    for i in range(3):
        out[..., i, 3] = out[..., 3, i] = phi[..., 1 + i]
    out[..., 3, 3] = phi[..., 0]
    return out


def unpack_pseudo_inertia(J: np.ndarray) -> np.ndarray:
    """Parameters (..., 10) of symmetric matrices (..., 4, 4): the inverse of `pseudo_inertia`."""
    s = [J[..., i, i] for i in range(3)]
    return np.stack(
        [J[..., 3, 3], J[..., 0, 3], J[..., 1, 3], J[..., 2, 3], s[1] + s[2], s[0] + s[2], s[0] + s[1], -J[..., 0, 1],
         -J[..., 0, 2], -J[..., 1, 2]],
        axis=-1,
    )  # fmt: skip
