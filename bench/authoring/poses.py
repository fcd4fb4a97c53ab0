"""What is asked of poses: rigid, finite, float64, and of a trajectory: its frames and their order."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bench.authoring.verdict import ContractBrokenError
from bench.types import Trajectory

# Pose files have about seven digits.
_RIGID = 1e-3


def require_pose(T: Any, what: str, method: str) -> None:
    """Raise ``ContractBrokenError`` unless ``T`` is one pose (4, 4) or several (N, 4, 4) in SE(3), float64."""
    if not isinstance(T, np.ndarray) or T.shape[-2:] != (4, 4) or T.dtype != np.float64:
        got = f"{T.dtype} {T.shape}" if isinstance(T, np.ndarray) else type(T).__name__
        raise ContractBrokenError(
            f"{what} is {got}", "float64 (4, 4): T_world_cam", "np.asarray(T, np.float64)", method
        )
    if not np.isfinite(T).all():
        raise ContractBrokenError(f"{what} holds NaN or infinity", "finite poses", 'lost frames: None, "lost"', method)
    R = T[..., :3, :3]
    rigid = np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max(initial=0.0) < _RIGID
    right_handed = (np.linalg.det(R) > 0).all()
    last = np.abs(T[..., 3, :] - [0, 0, 0, 1]).max(initial=0.0) < 1e-9
    if rigid and right_handed and last:
        return
    wrong = (
        "the last row is not 0 0 0 1"
        if not last
        else "the rotation is not orthonormal"
        if not rigid
        else "it is a reflection, not a rotation"
    )
    raise ContractBrokenError(
        f"{what}: {wrong}",
        "a rigid motion: R R^T = 1, det R = 1, last row 0 0 0 1",
        "is it transposed, scaled, or in other axes? orthonormalise what drifts: bench.geometry.se3.orthonormalise",
        method,
    )


def require_trajectory(answer: Any, numbers: Sequence[int], what: str, method: str) -> None:
    """Raise ``ContractBrokenError`` unless it is a ``Trajectory`` of rigid poses of exactly these frames, in order."""
    if not isinstance(answer, Trajectory):
        raise ContractBrokenError(
            f"{what} is {type(answer).__name__}",
            "bench.types.Trajectory",
            "return Trajectory(poses, numbers, timestamps)",
            method,
        )
    found = np.asarray(answer.numbers).tolist()
    if found != list(numbers):
        raise ContractBrokenError(
            f"{what} has frames {_listed(found)}",
            f"the frames {_listed(list(numbers))}, in order (lost ones absent)",
            "numbers are those of the frames (frame.number), not positions",
            method,
        )
    if np.shape(answer.T_world_cam) != (len(found), 4, 4) or np.shape(answer.timestamps) != (len(found),):
        raise ContractBrokenError(
            f"{what} has poses {np.shape(answer.T_world_cam)} and timestamps {np.shape(answer.timestamps)}",
            f"({len(found)}, 4, 4) and ({len(found)},)",
            "one pose and one time per frame; of no frame: np.zeros((0, 4, 4))",
            method,
        )
    require_pose(answer.T_world_cam, what, method)


def _listed(numbers: list[int]) -> str:
    shown = ", ".join(map(str, numbers[:8]))
    return f"{shown}, ... ({len(numbers)} in all)" if len(numbers) > 8 else shown or "none"
