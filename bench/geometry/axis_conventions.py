"""Tell from a car's poses that they are written in another convention than ours."""

from __future__ import annotations

import numpy as np

from bench.geometry import se3
from bench.types import Float

_LEAST_STEP_M = 0.05
"""Shorter steps have no direction; longer ones of this kind are needed ..."""
_LEAST_STEPS = 5
"""... this often, to judge."""
_CLEARLY = 0.9
_NOT = 0.8
"""Of a unit vector along an axis. All sequences of KITTI have 0.99 along z, and less than 0.8 in a wrong convention."""


def suspected_convention(T_world_cam: Float) -> str | None:
    """What the poses (N, 4, 4) of a camera that looks where it drives seem to be instead of T_world_cam, or None.

    Such a camera moves along its own z axis. It moves along x if the poses are those of a body frame (x forward); it
    moves along z only after inverting the poses if they are world to camera; and only after putting the first of four
    quaternion numbers last if these came as w, x, y, z. Poses that fit nothing are left alone: cameras look sideways,
    too.
    """
    forward = _mean_direction(T_world_cam)
    if forward is None or forward[2] > _NOT:
        return None
    if _first_is_largest(T_world_cam) and _drives_forward(_with_quaternion_rolled(T_world_cam)):
        return "the quaternions look like qw qx qy qz; TUM's order is qx qy qz qw"
    if _drives_forward(se3.inverse(T_world_cam)):
        return "the poses look like world to camera, or the camera drives backwards; ours are camera to world"
    if forward[0] > _CLEARLY:
        return "the poses look like those of a body frame (x forward, z up); ours have x right, y down, z forward"
    return None


def _mean_direction(T: Float) -> Float | None:
    """Mean unit vector (3,) of the steps, each in the axes of the pose where it begins; None with too few steps."""
    steps = (se3.inverse(T[:-1]) @ T[1:])[:, :3, 3]
    length = np.linalg.norm(steps, axis=1)
    far = length > _LEAST_STEP_M
    return (steps[far] / length[far, None]).mean(axis=0) if far.sum() >= _LEAST_STEPS else None


def _drives_forward(T: Float) -> bool:
    forward = _mean_direction(T)
    return forward is not None and bool(forward[2] > _CLEARLY)


def _first_is_largest(T: Float) -> bool:
    quaternion = np.abs(se3.rotation_to_quaternion(T[0, :3, :3]))
    return bool(quaternion[0] > quaternion[3])


def _with_quaternion_rolled(T: Float) -> Float:
    quaternions = se3.rotation_to_quaternion(T[:, :3, :3])
    return se3.compose(se3.quaternion_to_rotation(np.roll(quaternions, -1, axis=1)), T[:, :3, 3])
