"""Other conventions that poses may be written in, tried out on two trajectories of the same drive."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from bench.geometry import se3
from bench.types import Float

_LEAST_STEPS = 5
_STEPS = 50
"""Steps are as long as a fiftieth of the drive: noise from frame to frame says little then."""
_GOOD = 0.05
"""Steps off by less than this share of their length are read rightly."""
_CLEARLY = 5.0
"""So many times smaller the error of another reading must be. On 15 trajectories of ORB-SLAM2, whole and in parts, none
is; a wrong convention has an error of 0.3 to 2, and the right reading of such a file 0.02."""
_ALIKE, _EXACT = 1.3, 1e-6
"""Of readings whose errors are closer than this factor, or nothing at all, the one that changes least is told."""


@dataclass(frozen=True)
class Reading:
    """How poses would have to be read, in words; how far their steps are then off those of the other trajectory, as a
    share of their length plus radians, and how far as they are."""

    words: str
    error: float
    error_as_is: float
    changes: int
    """How far-fetched it is: one for each convention that is another one, and one more where nobody uses it."""


def _rolled(shift: int) -> Callable[[Float], Float]:
    """Poses as they are when the numbers of each quaternion are in another order."""

    def read(T: Float) -> Float:
        quaternions = np.roll(se3.rotation_to_quaternion(T[:, :3, :3]), shift, axis=1)
        return se3.compose(se3.quaternion_to_rotation(quaternions), T[:, :3, 3])

    return read


def _rotations_transposed(T: Float) -> Float:
    return se3.compose(np.swapaxes(T[:, :3, :3], 1, 2), T[:, :3, 3])


_WRITTEN: tuple[tuple[str, int, Callable[[Float], Float]], ...] = (
    ("", 0, lambda T: T),
    ("as world to camera", 1, se3.inverse),
    ("with quaternions in the order w x y z", 1, _rolled(-1)),
    ("with quaternions in the order x y z w", 2, _rolled(1)),
    ("with rotations from world to camera", 1, _rotations_transposed),
)
"""In words, how far-fetched, and how the poses are then."""
_USUAL_AXES = (
    "x forward, y left, z up",
    "x forward, y right, z down",
    "x right, y up, z back",
    "x right, y forward, z up",
)
"""Bodies of robots and of aircraft, OpenGL's cameras, and maps."""


def _all_axes() -> list[tuple[str, int, Float]]:
    """The 24 ways to turn a camera's axes, in words, how far-fetched, and as columns (3, 3) in ours (right, down,
    forward)."""
    ends = {(0, 1): "right", (0, -1): "left", (1, 1): "down", (1, -1): "up", (2, 1): "forward", (2, -1): "back"}
    found = []
    for places, signs in product(permutations(range(3)), product((1, -1), repeat=3)):
        Q = np.zeros((3, 3))
        Q[places, range(3)] = signs
        if np.linalg.det(Q) > 0:
            words = ", ".join(
                f"{axis} {ends[end]}" for axis, end in zip("xyz", zip(places, signs, strict=True), strict=True)
            )
            ours = np.trace(Q) == 3
            found.append(("" if ours else f"in axes {words}", 0 if ours else 1 + (words not in _USUAL_AXES), Q))
    return found


_READINGS = tuple(product(_WRITTEN, _all_axes()))


def alike(error: float, best: float) -> bool:
    """Whether a reading fits as well as the best one."""
    return error <= _ALIKE * best + _EXACT


def step_error(T: Float, other: Float) -> float:
    """How far the steps of poses (N, 4, 4) are off those of others: the median distance as a share of the others'
    median length, plus the median angle in radians."""
    return _error(_steps(T), _steps(other))


def other_reading(T: Float, other: Float) -> Reading | None:
    """The reading of the poses ``T`` (N, 4, 4) that fits ``other`` (N, 4, 4) clearly better than they do as T_world_cam
    in our axes; None where they fit, where nothing fits better, or too little moves.

    Steps are compared, so that it does not matter where the world is and how it is turned.
    """
    true_steps = _steps(other)
    if len(true_steps) < _LEAST_STEPS or not np.median(np.linalg.norm(true_steps[:, :3, 3], axis=1)) > 0:
        return None
    now = _error(_steps(T), true_steps)
    if now < _GOOD:
        return None
    readings = []
    for (written, changed, read), (axes, turns, Q) in _READINGS:
        steps = _steps(read(T))
        turned = se3.compose(Q @ steps[:, :3, :3] @ Q.T, steps[:, :3, 3] @ Q.T)
        words = ", ".join(part for part in (written, axes) if part)
        readings.append(Reading(words, _error(turned, true_steps), now, changed + turns))
    best = min(reading.error for reading in readings)
    if best * _CLEARLY > now:
        return None
    fitting = [reading for reading in readings if alike(reading.error, best)]
    return min(fitting, key=lambda reading: (reading.changes, reading.error))


def _steps(T: Float) -> Float:
    length = max(1, len(T) // _STEPS)
    return se3.inverse(T[:-length]) @ T[length:]


def _error(steps: Float, others: Float) -> float:
    apart = np.linalg.norm(steps[:, :3, 3] - others[:, :3, 3], axis=1)
    turned = se3.rotation_angle(np.swapaxes(steps[:, :3, :3], 1, 2) @ others[:, :3, :3])
    return float(np.median(apart) / np.median(np.linalg.norm(others[:, :3, 3], axis=1)) + np.median(turned))
