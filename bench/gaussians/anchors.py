"""Which keyframe each Gaussian came from, so that the map follows when the keyframes' poses are corrected."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from bench.gaussians.optimizer import MapOptimizer
from bench.gaussians.schema import MEAN, QUATERNION
from bench.geometry import se3
from bench.types import Float, Trajectory


@dataclass(frozen=True)
class MapMotion:
    """What moved: keyframes, their Gaussians, and the largest move of a keyframe in metres and in degrees."""

    keyframes: int
    gaussians: int
    largest_m: float
    largest_deg: float


class KeyframeAnchors:
    """Moves Gaussians rigidly with the keyframe that seeded them.

    A keyframe's Gaussians follow once its pose differs from the one they stand for by more than ``follow_m`` metres or
    ``follow_deg`` degrees; until then the difference adds up. The Gaussians of a keyframe are neighbours in the map:
    new ones come at the end, and pruning keeps the order.
    """

    def __init__(self, follow_m: float, follow_deg: float) -> None:
        self._follow_m, self._follow_deg = follow_m, follow_deg
        self._numbers = np.zeros(0, dtype=np.int64)
        self._T_world_cam = np.zeros((0, 4, 4))
        self._ends = np.zeros(1, dtype=np.int64)

    def add(self, number: int, T_world_cam: Float, count: int) -> None:
        """``count`` Gaussians, the newest of the map, belong to keyframe ``number`` at this pose (4, 4)."""
        self._numbers = np.append(self._numbers, number)
        self._T_world_cam = np.concatenate([self._T_world_cam, T_world_cam[None]])
        self._ends = np.append(self._ends, self._ends[-1] + count)

    def keep(self, mask: Tensor) -> None:
        """Drop the Gaussians that are not in the (N,) bool mask."""
        kept = torch.cat([mask.new_zeros(1, dtype=torch.int64), mask.cumsum(0)])
        self._ends = kept[torch.from_numpy(self._ends).to(mask.device)].cpu().numpy()

    def state(self) -> dict[str, Tensor]:
        """Numbers (K,), poses (K, 4, 4) and ends (K + 1,)."""
        arrays = {"numbers": self._numbers, "T_world_cam": self._T_world_cam, "ends": self._ends}
        return {name: torch.from_numpy(array) for name, array in arrays.items()}

    def restore(self, state: dict[str, Tensor]) -> None:
        """Go on from what ``state`` gave."""
        self._numbers, self._ends = state["numbers"].numpy(), state["ends"].numpy()
        self._T_world_cam = state["T_world_cam"].numpy()

    def follow(self, trajectory: Trajectory, planes: Tensor, optimizer: MapOptimizer) -> MapMotion:
        """Move Gaussians of ``planes`` (14, N), in place, to where the trajectory has their keyframes now.

        Adam's moments turn with them. A keyframe that the trajectory lacks stays where it is.
        """
        anchors, places = _matches(self._numbers, trajectory.numbers)
        old, new = self._T_world_cam[anchors], trajectory.T_world_cam[places]
        moved_m = np.linalg.norm(new[:, :3, 3] - old[:, :3, 3], axis=1)
        moved_deg = np.rad2deg(se3.rotation_angle(np.swapaxes(old[:, :3, :3], 1, 2) @ new[:, :3, :3]))
        moves = (new != old).any(axis=(1, 2)) & ((moved_m > self._follow_m) | (moved_deg > self._follow_deg))
        for anchor, before, after in zip(anchors[moves], old[moves], new[moves], strict=True):
            _move(planes, optimizer, slice(int(self._ends[anchor]), int(self._ends[anchor + 1])), before, after)
        self._T_world_cam[anchors[moves]] = new[moves]
        return MapMotion(
            keyframes=int(moves.sum()),
            gaussians=int(np.diff(self._ends)[anchors[moves]].sum()),
            largest_m=float(moved_m[moves].max(initial=0.0)),
            largest_deg=float(moved_deg[moves].max(initial=0.0)),
        )


def _matches(numbers: np.ndarray, of_trajectory: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Indices i, j of all pairs ``numbers[i] == of_trajectory[j]``; the second is without repetitions."""
    order = np.argsort(of_trajectory)
    at = np.searchsorted(of_trajectory, numbers, sorter=order)
    known = np.flatnonzero(at < len(order))
    places = order[at[known]]
    same = of_trajectory[places] == numbers[known]
    return known[same], places[same]


def _move(planes: Tensor, optimizer: MapOptimizer, which: slice, before: Float, after: Float) -> None:
    """Apply the motion that takes pose ``before`` to pose ``after`` to some Gaussians: x -> R x + t, q -> r q."""
    R = after[:3, :3] @ before[:3, :3].T
    x, y, z, w = se3.rotation_to_quaternion(R)
    # The product r q as a matrix; it is orthogonal, so the length of q, which is free, stays.
    product = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])

    def tensor(values: Float) -> Tensor:
        return torch.from_numpy(values.astype(np.float32)).to(planes.device)

    # As a small change of position, turned about the camera: far from the origin float32 has no digits to lose.
    about, shift = tensor(before[:3, 3:]), tensor(after[:3, 3:] - before[:3, 3:])
    planes[MEAN, which] += tensor(R - np.eye(3)) @ (planes[MEAN, which] - about) + shift
    planes[QUATERNION, which] = tensor(product) @ planes[QUATERNION, which]
    optimizer.rotate(MEAN, which, tensor(R))
    optimizer.rotate(QUATERNION, which, tensor(product))
