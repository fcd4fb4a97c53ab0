"""A mapper without Gaussians in a user's folder: coloured points of stereo, splatted by depth."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from bench.contracts.loss import LossTerm
from bench.contracts.mapper import Mapper
from bench.registry import PluginConfig, register
from bench.types import Float, Keyframe, Map, MappingReport, PinholeView, RenderedView, StereoCamera, Trajectory


@dataclass(frozen=True)
class PointCloudConfig(PluginConfig):
    """How dense the points are and how large they look."""

    stride: int = 1
    radius_px: int = 1


@register("mapper", "point_cloud", config=PointCloudConfig)
class PointCloud(Mapper):
    """Points of every keyframe's depth in its own frame; the nearest one wins each pixel."""

    map_file = "points.npz"

    def __init__(self, config: PointCloudConfig) -> None:
        self.config = config

    def start(self, camera: StereoCamera, losses: Sequence[LossTerm], seed: int) -> None:
        self.camera = camera
        self.points: dict[int, Float] = {}  # by keyframe, (N, 6): position in its camera's frame, colour
        self.poses: dict[int, Float] = {}

    def add_keyframe(self, keyframe: Keyframe, window: Sequence[int]) -> MappingReport:
        s, c, depth = self.config.stride, self.camera, keyframe.depth.depth
        v, u = np.mgrid[: c.height : s, : c.width : s].reshape(2, -1)
        z = depth[v, u].astype(np.float64)
        points = np.stack([(u - c.cx) / c.fx * z, (v - c.cy) / c.fy * z, z], axis=1)
        colours = keyframe.frame.left[v, u] / 255.0
        number = keyframe.frame.number
        self.points[number] = np.hstack([points, colours])[np.isfinite(z)]
        self.poses[number] = keyframe.T_world_cam
        error = self.render(PinholeView.of(c, keyframe.T_world_cam)).color - keyframe.frame.left / np.float32(255)
        return MappingReport(float(-10 * np.log10(max(float(np.mean(error**2)), 1e-10))))

    def update_poses(self, trajectory: Trajectory) -> None:
        known = zip(trajectory.numbers.tolist(), trajectory.T_world_cam, strict=True)
        self.poses |= {number: pose for number, pose in known if number in self.poses}

    def finish(self) -> None:
        pass

    def world(self) -> Float:
        """All points (N, 6): position in the world, colour."""
        found = [np.zeros((0, 6))]
        for number, points in self.points.items():
            T = self.poses[number]
            found.append(np.hstack([points[:, :3] @ T[:3, :3].T + T[:3, 3], points[:, 3:]]))
        return np.concatenate(found)

    def render(self, view: PinholeView, depth: Map | None = None) -> RenderedView:
        points = self.world()
        x, y, z = (points[:, :3] @ view.T_cam_world[:3, :3].T + view.T_cam_world[:3, 3]).T
        near = z > 0.2
        points, z = points[near], z[near]
        u, v = np.rint(view.fx * x[near] / z + view.cx), np.rint(view.fy * y[near] / z + view.cy)
        r, which = self.config.radius_px, np.arange(len(z))
        offsets = np.array(list(np.ndindex(2 * r + 1, 2 * r + 1))) - r
        column, row, which = (
            (axis[None] + shift[:, None]).ravel()
            for axis, shift in ((u, offsets[:, 0]), (v, offsets[:, 1]), (which, np.zeros(len(offsets), int)))
        )
        shown = (row >= 0) & (row < view.height) & (column >= 0) & (column < view.width)
        which = which[shown]
        order = np.argsort(-z[which], kind="stable")  # the farthest first, so that the nearest is written last
        at, which = (row[shown][order].astype(int), column[shown][order].astype(int)), which[order]
        color = np.zeros((view.height, view.width, 3), np.float32)
        seen = np.zeros((view.height, view.width), np.float32)
        color[at], seen[at] = points[which, 3:], z[which]
        return RenderedView(color, seen, (seen > 0).astype(np.float32))

    def size(self) -> dict[str, int]:
        return {"points": sum(map(len, self.points.values()))}

    def state(self) -> dict[str, Any]:
        kept = {"points": self.points, "poses": self.poses}
        return {key: {n: torch.from_numpy(each.copy()) for n, each in parts.items()} for key, parts in kept.items()}

    def restore(self, state: dict[str, Any], keyframes: Iterable[Keyframe]) -> None:
        self.points, self.poses = ({n: each.numpy() for n, each in state[key].items()} for key in ("points", "poses"))

    def save(self, path: Path) -> None:
        with path.open("wb") as file:
            np.savez_compressed(file, points=self.world())
