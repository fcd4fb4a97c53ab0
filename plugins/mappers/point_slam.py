"""Point-SLAM's mapping: neural points around stereo or sensor depth, decoded along rays."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from bench.baselines.point_slam.adding import add_points, candidates
from bench.baselines.point_slam.cloud import FEATURES, PointCloud
from bench.baselines.point_slam.frames import MappedFrame, in_view, window_of
from bench.baselines.point_slam.learning import Learning, later_iterations
from bench.baselines.point_slam.map_view import PointMapView
from bench.baselines.point_slam.original_weights import WEIGHTS, load_geometry
from bench.baselines.point_slam.picture import picture
from bench.baselines.point_slam.radius import QUERY_FACTOR, add_radius, edges
from bench.baselines.point_slam.rays import RayRenderer
from bench.baselines.point_slam.settings import PointSlamMapperConfig
from bench.contracts.loss import LossTerm
from bench.contracts.map_view import MapView
from bench.contracts.mapper import CannotRenderError, MapNeeds, Mapper
from bench.registry import register
from bench.stereo.device import choose_device
from bench.types import Float, Keyframe, Map, MappingReport, PinholeView, RenderedView, StereoCamera, Trajectory
from bench.weights import resolve

_FLOAT, _POINT_FLOATS = 4, 3 + 2 * FEATURES
_PROGRAM_GB, _RAY_BYTES, _KEYFRAME_BYTES = 0.6, 60e3, 19


@register("mapper", "point_slam", config=PointSlamMapperConfig)
class PointSlamMapper(Mapper):
    """Point-SLAM's neural points, with features learned per mapped frame; a view is shown with its own depth alone.

    After Sandström et al., "Point-SLAM: Dense Neural Point Cloud-based SLAM", ICCV 2023. What differs from the released
    code: the geometry decoder is trained on the first frame and then frozen, unless ``pretrained_geometry``; the
    neighbour search is exact (a k-d tree, not an inverted file); samples without neighbours are empty and black; a view
    is drawn with the largest query radius, since the radius of its pixels would have to come from its own image. The
    loss terms of the run play no part.
    """

    map_file = "points.npz"
    needs_depth = True

    def __init__(self, config: PointSlamMapperConfig) -> None:
        self.config = config
        self._device = choose_device(config.device, "mapper.device")

    def start(self, camera: StereoCamera, losses: Sequence[LossTerm], seed: int) -> None:
        from bench.baselines.point_slam.decoders import ColorDecoder, GeometryDecoder  # here: it imports torch

        self._camera = camera
        self._random = torch.Generator().manual_seed(seed)
        self._cloud = PointCloud(self._device)
        geometry, color = GeometryDecoder(self._random), ColorDecoder(self.config.relative_positions, self._random)
        if self.config.pretrained_geometry:
            load_geometry(geometry)
        for decoder in (geometry, color):
            decoder.requires_grad_(False)
        self._renderer = RayRenderer(self._cloud, geometry.to(self._device), color.to(self._device), self.config.ray)
        self._keyframes: list[MappedFrame] = []
        self._poses: dict[int, Float] = {}  # of all mapped frames, as their points have them
        self._rounds = 0  # of colour refinement

    def weights(self) -> dict[str, Path]:
        return {"geometry": resolve(WEIGHTS)} if self.config.pretrained_geometry else {}

    def size(self) -> dict[str, int]:
        return {"points": len(self._cloud)}

    def add_keyframe(self, keyframe: Keyframe, window: Sequence[int]) -> MappingReport:
        c, first = self.config, not len(self._cloud)
        edge = edges(keyframe.frame.left)
        frame = self._mapped(keyframe, edge)
        self._poses[frame.number] = frame.T_world_cam
        pixels = candidates(frame, edge, c, first, self._random)
        added = add_points(self._cloud, frame, pixels, self._camera, c, self._random)
        frames = window_of(frame, self._keyframes, c.window, self._camera, self._random)
        total = c.first_iterations if first else later_iterations(c.iterations, added)
        geometry_alone = c.first_geometry_iterations if first else round(total * c.geometry_share)
        points = in_view(self._cloud.positions.cpu().numpy(), frame, self._camera, c.behind_m)
        learning = Learning(self._renderer, c, points, geometry_learns=first and not c.pretrained_geometry)
        loss = 0.0
        for iteration in range(total):
            loss = learning.iterate(frames, self._camera, iteration >= geometry_alone, self._random)
        learning.finish()
        if not self._keyframes or frame.number - self._keyframes[-1].number >= c.keyframe_every:
            self._keyframes.append(frame)
        psnr_db = self._psnr(frame, keyframe.depth.depth)
        return MappingReport(psnr_db, {"rays": loss})

    def update_poses(self, trajectory: Trajectory) -> None:
        for number, before in self._poses.items():
            now = trajectory.pose_of(number)
            if now is not None and not np.array_equal(now, before):
                self._cloud.move(number, now @ np.linalg.inv(before))
                self._poses[number] = now
        for frame in self._keyframes:
            frame.T_world_cam = self._poses[frame.number]

    def finish(self) -> None:
        for _ in self.final_steps():
            pass

    def final_steps(self) -> Iterator[None]:
        """Colour refinement, round by round."""
        c = self.config
        while self._keyframes and self._rounds < c.refinement_rounds:
            learning = Learning(self._renderer, c, np.ones(len(self._cloud), bool), refining=True)
            for _ in range(2 * c.iterations):
                order = torch.randperm(len(self._keyframes), generator=self._random)[: 2 * c.window].tolist()
                learning.iterate([self._keyframes[k] for k in order], self._camera, True, self._random)
            learning.finish()
            self._rounds += 1
            yield None

    def state(self) -> dict[str, Any]:
        return {
            "cloud": self._cloud.state(),
            "geometry": _copy(self._renderer.geometry),
            "color": _copy(self._renderer.color),
            "poses": {number: torch.from_numpy(pose.copy()) for number, pose in self._poses.items()},
            "keyframes": [frame.number for frame in self._keyframes],
            "rounds": self._rounds,
            "random": self._random.get_state(),
        }

    def restore(self, state: dict[str, Any], keyframes: Iterable[Keyframe]) -> None:
        self._cloud.restore(state["cloud"])
        self._renderer.geometry.load_state_dict(state["geometry"])
        self._renderer.color.load_state_dict(state["color"])
        self._poses = {number: pose.numpy() for number, pose in state["poses"].items()}
        wanted = set(state["keyframes"])
        self._keyframes = [
            self._mapped(keyframe, edges(keyframe.frame.left))
            for keyframe in keyframes
            if keyframe.frame.number in wanted
        ]
        for frame in self._keyframes:
            frame.T_world_cam = self._poses[frame.number]
        self._rounds = state["rounds"]
        self._random.set_state(state["random"])

    def render(self, view: PinholeView, depth: Map | None = None) -> RenderedView:
        if depth is None:
            raise CannotRenderError("neural points are shown with the depth of a view, and this one has none")
        depth = self._usable(depth)
        radius = QUERY_FACTOR * add_radius(np.zeros_like(depth), depth, self.config.radius)
        return picture(self._renderer, view, depth, radius)

    def view(self) -> MapView:
        return PointMapView(self._renderer, self.config.radius, self._usable)

    def save(self, path: Path) -> None:
        """Positions, features and anchors, and the decoders' tensors as ``geometry.NAME`` and ``color.NAME``."""
        arrays = {name: value.numpy() for name, value in self._cloud.state().items()}
        for of, decoder in (("geometry", self._renderer.geometry), ("color", self._renderer.color)):
            arrays |= {f"{of}.{name}": value.numpy() for name, value in _copy(decoder).items()}
        with open(path, "wb") as file:
            np.savez(file, **arrays)

    def needs(self, frames: int) -> MapNeeds:
        c, pixels = self.config, self._camera.width * self._camera.height
        points = frames * c.layers * (c.uniform_pixels + c.edge_pixels) * _FLOAT * _POINT_FLOATS
        kept = frames / c.keyframe_every * pixels * _KEYFRAME_BYTES
        return MapNeeds(points, points, _PROGRAM_GB + (c.rays * _RAY_BYTES + 5 * points + kept) / 1e9)

    def _mapped(self, keyframe: Keyframe, edge: Map) -> MappedFrame:
        depth = self._usable(keyframe.depth.depth)
        if keyframe.sky is not None:
            depth[keyframe.sky] = np.nan
        radius = add_radius(edge, depth, self.config.radius)
        return MappedFrame(keyframe.frame.number, keyframe.T_world_cam, keyframe.frame.left, depth, radius)

    def _usable(self, depth: Map) -> Map:
        """A copy with NaN where the depth is out of range."""
        low, high = self.config.depth_range_m
        with np.errstate(invalid="ignore"):
            return np.where((depth > low) & (depth <= high), depth, np.nan).astype(np.float32)

    def _psnr(self, frame: MappedFrame, depth: Map) -> float:
        shown = self.render(PinholeView.of(self._camera, frame.T_world_cam), depth).color
        error = shown - frame.image / np.float32(255.0)
        return float(-10.0 * np.log10(max(float((error.astype(np.float64) ** 2).mean()), 1e-10)))


def _copy(decoder: torch.nn.Module) -> dict[str, torch.Tensor]:
    return {name: tensor.detach().cpu().clone() for name, tensor in decoder.state_dict().items()}
