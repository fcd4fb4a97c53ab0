"""Rigid motions: exponential and logarithm, inverse, nearest rotation, quaternions.

Tangent vectors are ``(rho, phi)``: three translational components first, then three of rotation (radians). Quaternions
are ``(x, y, z, w)`` with unit norm. Formulas: Sola, Deray and Atchuthan, "A micro Lie theory for state estimation in
robotics", 2018, Secs. III and Appendix D. All functions take and give float64 and broadcast over leading axes.
"""

from __future__ import annotations

import cv2
import numpy as np

from bench.types import Float

_SMALL_ANGLE = 1e-4
"""Below this angle (radians) the closed forms lose digits and their Taylor series are exact to 1e-16."""


def skew(v: Float) -> Float:
    """Cross-product matrices (..., 3, 3) of vectors (..., 3): ``skew(a) @ b == cross(a, b)``."""
    v = np.asarray(v, dtype=np.float64)
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return out


def _rotation_coefficients(angle: Float) -> tuple[Float, Float, Float]:
    """sin(a)/a, (1 - cos(a))/a^2 and (a - sin(a))/a^3, each also right at a = 0."""
    a2 = angle * angle
    small = angle < _SMALL_ANGLE
    a = np.where(small, 1.0, angle)
    return (
        np.where(small, 1.0 - a2 / 6.0, np.sin(a) / a),
        np.where(small, 0.5 - a2 / 24.0, 2.0 * np.sin(0.5 * a) ** 2 / a**2),
        np.where(small, 1.0 / 6.0 - a2 / 120.0, (a - np.sin(a)) / a**3),
    )


def so3_exp(phi: Float) -> Float:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3) in radians (Rodrigues)."""
    phi = np.asarray(phi, dtype=np.float64)
    s, c, _ = _rotation_coefficients(np.linalg.norm(phi, axis=-1))
    K = skew(phi)
    return np.eye(3) + s[..., None, None] * K + c[..., None, None] * (K @ K)


def so3_log(R: Float) -> Float:
    """Rotation vectors (..., 3) in radians, of length at most pi, of rotation matrices (..., 3, 3)."""
    q = rotation_to_quaternion(R)
    q = np.where(q[..., 3:] < 0, -q, q)
    sine = np.linalg.norm(q[..., :3], axis=-1)
    small = sine < _SMALL_ANGLE
    safe = np.where(small, 1.0, sine)
    ratio = np.where(small, 2.0 + sine**2 / 3.0, 2.0 * np.arctan2(sine, q[..., 3]) / safe)
    return ratio[..., None] * q[..., :3]


def _left_jacobian(phi: Float) -> Float:
    _, c, d = _rotation_coefficients(np.linalg.norm(phi, axis=-1))
    K = skew(phi)
    return np.eye(3) + c[..., None, None] * K + d[..., None, None] * (K @ K)


def exp(xi: Float) -> Float:
    """Motions (..., 4, 4) of tangent vectors (..., 6), ordered (rho, phi).

    >>> T = exp([1.0, 0, 0, 0, 0, 0])  # a metre to the right
    >>> T[:3, 3].tolist()
    [1.0, 0.0, 0.0]
    >>> log(exp([1.0, 2, 3, 0.1, 0.2, 0.3])).round(9).tolist()
    [1.0, 2.0, 3.0, 0.1, 0.2, 0.3]
    """
    xi = np.asarray(xi, dtype=np.float64)
    rho, phi = xi[..., :3], xi[..., 3:]
    return compose(so3_exp(phi), (_left_jacobian(phi) @ rho[..., None])[..., 0])


def log(T: Float) -> Float:
    """Tangent vectors (..., 6), ordered (rho, phi), of motions (..., 4, 4); rotation angle at most pi."""
    phi = so3_log(T[..., :3, :3])
    rho = np.linalg.solve(_left_jacobian(phi), T[..., :3, 3:])[..., 0]
    return np.concatenate([rho, phi], axis=-1)


def compose(R: Float, t: Float) -> Float:
    """Motions (..., 4, 4) from rotations (..., 3, 3) and translations (..., 3) in metres."""
    out = np.zeros((*R.shape[:-2], 4, 4))
    out[..., :3, :3], out[..., :3, 3], out[..., 3, 3] = R, t, 1.0
    return out


def inverse(T: Float) -> Float:
    """Inverse motions (..., 4, 4); uses that the upper-left block is a rotation.

    >>> T = exp([1.0, 2, 3, 0.1, 0.2, 0.3])
    >>> bool(np.allclose(inverse(T) @ T, np.eye(4)))
    True
    """
    Rt = np.swapaxes(T[..., :3, :3], -1, -2)
    return compose(Rt, -(Rt @ T[..., :3, 3:])[..., 0])


def orthonormalise(T: Float) -> Float:
    """Poses (..., 4, 4) whose rotation is replaced by the nearest one in the Frobenius norm (SVD, determinant +1)."""
    U, _, Vt = np.linalg.svd(T[..., :3, :3])
    sign = np.ones(U.shape[:-1])
    sign[..., 2] = np.sign(np.linalg.det(U @ Vt))
    return compose((U * sign[..., None, :]) @ Vt, T[..., :3, 3])


def rotation_angle(R: Float) -> Float:
    """Angle in radians, in [0, pi], of rotation matrices (..., 3, 3); accurate for small angles too.

    >>> round(float(rotation_angle(so3_exp([0, 1e-9, 0]))), 15)
    1e-09
    """
    return np.linalg.norm(so3_log(R), axis=-1)


def quaternion_to_rotation(q: Float) -> Float:
    """Rotation matrices (..., 3, 3) of quaternions (..., 4) ordered (x, y, z, w), of any length above 0."""
    q = np.asarray(q, dtype=np.float64)
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    K = skew(q[..., :3])
    return np.eye(3) + 2.0 * q[..., 3, None, None] * K + 2.0 * (K @ K)


def rotation_to_quaternion(R: Float) -> Float:
    """Unit quaternions (..., 4), ordered (x, y, z, w) with w >= 0, of rotation matrices (..., 3, 3).

    Of the four equivalent formulas the one with the largest divisor is used (Shepperd, 1978).
    """
    R = np.asarray(R, dtype=np.float64)
    diagonal = np.diagonal(R, axis1=-2, axis2=-1)
    trace = diagonal.sum(-1)
    # The symmetric matrix 4 q q^T: its column with the largest diagonal element is q up to scale.
    M = np.empty((*R.shape[:-2], 4, 4))
    M[..., :3, :3] = R + np.swapaxes(R, -1, -2)
    for i in range(3):
        M[..., i, i] = 1.0 + 2.0 * diagonal[..., i] - trace
    M[..., 3, 3] = 1.0 + trace
    M[..., 0, 3] = M[..., 3, 0] = R[..., 2, 1] - R[..., 1, 2]
    M[..., 1, 3] = M[..., 3, 1] = R[..., 0, 2] - R[..., 2, 0]
    M[..., 2, 3] = M[..., 3, 2] = R[..., 1, 0] - R[..., 0, 1]
    best = np.argmax(np.diagonal(M, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(M, best[..., None, None], axis=-1)[..., 0]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.where(q[..., 3:] < 0, -q, q)


def rotation_to_quaternion_by_vector(R: Float) -> Float:
    """Unit quaternion (4,), ordered (x, y, z, w), of one rotation matrix (3, 3) by way of OpenCV's rotation vector.

    Up to 1e-12 off ``rotation_to_quaternion``. The Gaussians of all kept results were seeded with these bits.
    """
    vector = cv2.Rodrigues(R)[0][:, 0]
    angle = float(np.linalg.norm(vector))
    axis = vector / angle if angle > 1e-12 else np.zeros(3)
    return np.append(np.sin(angle / 2) * axis, np.cos(angle / 2))


def quaternion_product(p: Float, q: Float) -> Float:
    """Products p q (..., 4) of quaternions (..., 4), ordered (x, y, z, w) and of any length."""
    px, py, pz, pw = np.moveaxis(np.asarray(p, dtype=np.float64), -1, 0)
    qx, qy, qz, qw = np.moveaxis(np.asarray(q, dtype=np.float64), -1, 0)
    return np.stack(
        [
            pw * qx + px * qw + py * qz - pz * qy,
            pw * qy - px * qz + py * qw + pz * qx,
            pw * qz + px * qy - py * qx + pz * qw,
            pw * qw - px * qx - py * qy - pz * qz,
        ],
        -1,
    )


def interpolate(T: Float, later: Float, fraction: Float) -> Float:
    """Poses (..., 4, 4) between ``T`` (fraction 0) and ``later`` (1): straight centre, even turn about one axis."""
    turn = so3_log(np.swapaxes(T[..., :3, :3], -1, -2) @ later[..., :3, :3])
    R = T[..., :3, :3] @ so3_exp(fraction[..., None] * turn)
    return compose(R, T[..., :3, 3] + fraction[..., None] * (later[..., :3, 3] - T[..., :3, 3]))
