"""The neural points: where they are, what they know, and which of them are near a place."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import torch

from bench.types import Float

if TYPE_CHECKING:
    from scipy.spatial import cKDTree
    from torch import Generator

FEATURES = 32
"""Numbers in a point's feature for geometry, and in that for colour."""
BIRTH_SCALE = 0.1
"""Standard deviation of a new point's features."""


class PointCloud:
    """``positions`` (N, 3) in metres in the world, ``geometry`` and ``color`` (N, 32) features, and ``anchor`` (N,):
    the number of the frame that brought a point."""

    def __init__(self, device: torch.device) -> None:
        self.positions = torch.zeros(0, 3, device=device)
        self.geometry = torch.zeros(0, FEATURES, device=device)
        self.color = torch.zeros(0, FEATURES, device=device)
        self.anchor: npt.NDArray[np.int64] = np.zeros(0, np.int64)
        self._tree: cKDTree | None = None

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def device(self) -> torch.device:
        return self.positions.device

    def add(self, positions: Float, frame: int, generator: Generator) -> None:
        """Points (M, 3) of a frame, with features N(0, 0.1^2) from the generator."""
        new = torch.from_numpy(positions.astype(np.float32)).to(self.device)
        born = [BIRTH_SCALE * torch.randn(len(new), FEATURES, generator=generator) for _ in range(2)]
        self.positions = torch.cat([self.positions, new])
        self.geometry = torch.cat([self.geometry, born[0].to(self.device)])
        self.color = torch.cat([self.color, born[1].to(self.device)])
        self.anchor = np.append(self.anchor, np.full(len(new), frame))
        self._tree = None

    def move(self, frame: int, motion: Float) -> None:
        """Move the points of a frame by a rigid motion (4, 4) of the world."""
        of_frame = torch.from_numpy(self.anchor == frame).to(self.device)
        there = self.positions[of_frame].double().cpu().numpy() @ motion[:3, :3].T + motion[:3, 3]
        self.positions[of_frame] = torch.from_numpy(there.astype(np.float32)).to(self.device)
        self._tree = None

    def nearest(self, places: Float, count: int, reach: float) -> tuple[Float, npt.NDArray[np.int64]]:
        """Distances (Q, count), infinite beyond ``reach`` metres, and indices of the nearest points of (Q, 3) places;
        an index without a point is 0. The search is exact."""
        if not len(self):
            return np.full((len(places), count), np.inf), np.zeros((len(places), count), np.int64)
        if self._tree is None:
            from scipy.spatial import cKDTree  # here: it takes a while to load

            self._tree = cKDTree(self.positions.cpu().numpy(), balanced_tree=False)
        distance, index = self._tree.query(
            places, k=range(1, count + 1), distance_upper_bound=reach, workers=torch.get_num_threads()
        )
        index[index == len(self)] = 0
        return distance, index

    def state(self) -> dict[str, Any]:
        """For a checkpoint: copies on the CPU."""
        tensors = {"positions": self.positions, "geometry": self.geometry, "color": self.color}
        copies: dict[str, Any] = {name: tensor.detach().cpu().clone() for name, tensor in tensors.items()}
        return copies | {"anchor": torch.from_numpy(self.anchor.copy())}

    def restore(self, state: dict[str, Any]) -> None:
        """Resume from what ``state`` gave."""
        device = self.device
        self.positions, self.geometry, self.color = (
            state[name].to(device) for name in ("positions", "geometry", "color")
        )
        self.anchor = state["anchor"].numpy()
        self._tree = None
