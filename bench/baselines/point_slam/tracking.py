"""A camera's pose by gradient descent on what its rays show of the neural points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import torch

from bench.baselines.point_slam.frames import directions_of, draw
from bench.baselines.point_slam.rays import Rays, RaySettings, RenderedRays, around
from bench.errors import BenchError, require_between, require_choice, require_least
from bench.geometry import se3
from bench.registry import PluginConfig
from bench.types import Float, Image, Map, StereoCamera

if TYPE_CHECKING:
    from torch import Generator, Tensor

_TINY = 1e-10
_POOL = 15
"""Rays at edges are drawn from so many times as many."""
_FAR_MEDIANS, _MOVING_MEANS = 10.0, 10.0
_DEPTH_CAP = 1000.0


@dataclass(frozen=True)
class PointSlamTrackerConfig(PluginConfig):
    """Settings of the pose search; the defaults are the original's for Replica."""

    iterations: int = 40
    """Steps of a frame; fewer are faster, and the trajectory is then another."""
    rays: int = 1500
    """Rays of a step."""
    pixels: str = "uniform"
    """Where rays are drawn: uniform, or edges (the 15 times as many pixels with the strongest edges)."""
    border: float = 0.147
    """Pixels nearer to the image's border than this share of its height are left out (100 of Replica's 680 rows)."""
    translation_rate: float = 0.002
    """Rate of the position, in metres."""
    rotation_rate: float = 0.0004
    """Rate of the quaternion."""
    color_weight: float = 0.5
    """Weight of colour beside depth."""
    reject_moving: bool = True
    """Whether rays whose depth is off by more than ten times the mean count as things that move, and are left out."""
    true_poses: int = 2
    """So many frames at the start take their pose from the ground truth, as in the original; where there is none the
    first is the world's origin, and the others are tracked."""

    def __post_init__(self) -> None:
        require_least("tracker", self, iterations=1, rays=1, color_weight=0, true_poses=0)
        require_between("tracker", self, 0, 0.45, "border")
        require_choice("tracker.pixels", self.pixels, ("uniform", "edges"))
        if not (self.translation_rate > 0 and self.rotation_rate > 0):
            raise BenchError(
                f"tracker.translation_rate={self.translation_rate} and tracker.rotation_rate={self.rotation_rate} must "
                "be above 0; the original has 0.002 and 0.0004."
            )


def usable_pixels(depth: Map, edge: Map, config: PointSlamTrackerConfig, camera: StereoCamera) -> npt.NDArray[np.int64]:
    """Flat indices of the pixels that rays are drawn from: of known depth and inside the border."""
    border = round(config.border * camera.height)
    inside = np.isfinite(depth)
    kept = np.zeros_like(inside)
    kept[border : camera.height - border, border : camera.width - border] = True
    pixels = np.flatnonzero(inside & kept)
    if config.pixels == "edges":
        strongest = np.argsort(-edge.reshape(-1)[pixels], kind="stable")[: _POOL * config.rays]
        pixels = pixels[strongest]
    return pixels


def tracking_loss(
    rendered: RenderedRays, depth: Tensor, color: Tensor, color_weight: float, reject_moving: bool
) -> Tensor:
    """Sum of depth errors over their standard deviation, capped at 1000, and of absolute colour errors times a weight.

    ``depth`` (R,) and ``color`` (R, 3) are the sensor's. With ``reject_moving`` rays whose scaled depth error is ten
    times the mean one or more don't count. The variance has no gradient.
    """
    scaled = (rendered.depth - depth).abs() / torch.sqrt(rendered.variance.detach() + _TINY)
    counts = ~torch.isnan(scaled)
    if reject_moving:
        counts &= scaled.detach() < _MOVING_MEANS * scaled.detach().mean()
    loss = scaled.clamp(0.0, _DEPTH_CAP)[counts].sum()
    return loss + color_weight * (rendered.color - color).abs()[counts].sum()


def rotation_of(quaternion: Tensor) -> Tensor:
    """Rotation matrix (3, 3), differentiable, of a quaternion (4,) ordered (x, y, z, w) of any length."""
    x, y, z, w = quaternion / quaternion.norm()
    rows = [
        torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)]),
        torch.stack([2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)]),
        torch.stack([2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]),
    ]
    return torch.stack(rows)


@dataclass(frozen=True)
class Sight:
    """What a frame offers its pose search: image (H, W, 3), depth (H, W) in metres, query radii (H, W) in metres, and
    the flat indices of its ``usable_pixels``."""

    image: Image
    depth: Map
    query_radius: Map
    pixels: npt.NDArray[np.int64]


def pose_loss(
    quaternion: Tensor,
    translation: Tensor,
    sight: Sight,
    pixels: npt.NDArray[np.int64],
    camera: StereoCamera,
    render: Callable[[Rays], RenderedRays],
    settings: RaySettings,
    config: PointSlamTrackerConfig,
) -> Tensor:
    """The loss at a pose, for rays through some of the frame's pixels, without those of more than 10 median depths."""
    depth = sight.depth.reshape(-1)[pixels]
    near = depth <= _FAR_MEDIANS * np.median(depth)
    pixels, depth = pixels[near], depth[near]

    def tensor(values: npt.NDArray[np.floating]) -> Tensor:
        return torch.from_numpy(values).to(translation)

    measured = tensor(depth)
    rays = Rays(
        translation.expand(len(pixels), 3),
        tensor(directions_of(pixels, camera)) @ rotation_of(quaternion).T,
        around(measured, settings),
        tensor(sight.query_radius.reshape(-1)[pixels]),
    )
    color = tensor(sight.image.reshape(-1, 3)[pixels] / np.float32(255.0))
    return tracking_loss(render(rays), measured, color, config.color_weight, config.reject_moving)


def search_pose(
    guess: Float,
    sight: Sight,
    camera: StereoCamera,
    render: Callable[[Rays], RenderedRays],
    settings: RaySettings,
    config: PointSlamTrackerConfig,
    device: torch.device,
    random: Generator,
) -> tuple[Float, float]:
    """The pose (4, 4) of least loss on the way down from ``guess``, and that loss; each step draws rays of its own.

    Where no ray meets points the guess stays, and the loss is infinite.
    """
    q = torch.tensor(se3.rotation_to_quaternion(guess[:3, :3]), dtype=torch.float32, device=device, requires_grad=True)
    t = torch.tensor(guess[:3, 3], dtype=torch.float32, device=device, requires_grad=True)
    adam = torch.optim.Adam(
        [{"params": [q], "lr": config.rotation_rate}, {"params": [t], "lr": config.translation_rate}]
    )
    best, least = guess, float("inf")
    if not len(sight.pixels):
        return best, least
    for _ in range(config.iterations):
        pixels = sight.pixels[draw(config.rays, len(sight.pixels), random)]
        with torch.enable_grad():
            loss = pose_loss(q, t, sight, pixels, camera, render, settings, config)
        if not loss.requires_grad:
            break
        if float(loss.detach()) < least:
            least = float(loss.detach())
            R = se3.quaternion_to_rotation(q.detach().double().cpu().numpy())
            best = se3.compose(R, t.detach().double().cpu().numpy())
        adam.zero_grad(set_to_none=True)
        loss.backward()
        adam.step()
    return best, least
