"""Where new Gaussians start: on the surfaces of a keyframe's depth that the map does not explain yet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np
import torch

from bench.errors import BenchError, require_between, require_least
from bench.gaussians.parameters import planes_from
from bench.geometry import se3
from bench.geometry.ground import ground_inverse_depth
from bench.supervision.target import depth_in_range
from bench.types import Image, Keyframe, Map, Mask, PinholeView

if TYPE_CHECKING:
    from torch import Tensor

# Few iterations or none make these Gaussians opaque: no keyframe sees them.
_MARGIN_OPACITY = 0.9


@dataclass(frozen=True)
class SeedingConfig:
    """How a keyframe's pixels become Gaussians."""

    stride: int = 2
    """Every stride-th pixel in both directions."""
    max_alpha: float = 0.5
    """A pixel is not explained yet where the map's alpha is below this."""
    min_error: float = 0.1
    """A pixel is not explained yet where the mean colour error, of 0 to 1, is above this."""
    size: float = 0.6
    """Standard deviation along the surface, in units of the pixel's footprint times the stride."""
    thickness: float = 0.2
    """Standard deviation across the surface, as a share of that along it."""
    opacity: float = 0.5
    """Opacity of new Gaussians."""
    fill_holes: bool = True
    """Whether pixels of unknown depth get a smoothly filled one, for seeding only."""
    ground: bool = False
    """Whether filled depth ends at the ground: a plane fitted to the depth below the principal point, where one is
    found. For cameras that stand upright above a road or floor, whose overexposed parts stereo does not see."""
    max_depth_m: float = 0.0
    """How far stereo depth seeds, in metres (0: as far as it supervises, ``mapper.depth_range_m``)."""
    margin: float = 0.0
    """How far seeds go on beyond the left and right border of the image, as a share of its width, with the depth and
    colour of the border: what the keyframes do not see is less wrong like that than black."""
    min_confidence: float = 0.0
    """Depth counts as unknown where the stereo plugin's confidence in it, 0 to 1, is below this (0: any counts)."""
    sky_distance_m: float = 200.0
    """How far from the camera the sky is, in metres (0: no Gaussians for the sky). It moves with the camera."""

    def __post_init__(self) -> None:
        if self.stride < 1:
            raise BenchError(f"mapper.seeding.stride={self.stride} must be at least 1.")
        if not 0 < self.opacity < 1:
            raise BenchError(f"mapper.seeding.opacity={self.opacity} must lie between 0 and 1.")
        for name in ("size", "thickness"):
            if not getattr(self, name) > 0:
                raise BenchError(f"mapper.seeding.{name}={getattr(self, name)} must be above 0.")
        require_between("mapper.seeding", self, 0, 1, "max_alpha", "min_confidence", "margin")
        require_least("mapper.seeding", self, min_error=0, max_depth_m=0)
        if not self.sky_distance_m >= 0:
            raise BenchError(f"mapper.seeding.sky_distance_m={self.sky_distance_m} must be 0 (no sky) or more metres.")

    def margin_columns(self, width: int) -> int:
        """The margin of an image of this width on each side, in pixels."""
        return round(self.margin * width)


class Seeds(NamedTuple):
    """New Gaussians (14, N), of degree 0; their depths (N,) in metres; which of them show the sky, (N,) bool."""

    planes: Tensor
    depths: Tensor
    of_sky: Tensor


def depth_to_seed_from(keyframe: Keyframe, depth_range_m: tuple[float, float], config: SeedingConfig) -> Map:
    """Depth (H, W) in metres, NaN for the sky, outside of the range, and where it is not sure enough.

    Raises ``BenchError`` where ``min_confidence`` asks for a confidence that the depth has not.
    """
    depth = keyframe.depth
    sure = depth_in_range(keyframe, (depth_range_m[0], config.max_depth_m or depth_range_m[1]))
    if config.min_confidence == 0:
        return np.where(sure, depth.depth, np.nan)
    if depth.confidence is None:
        raise BenchError(
            f"mapper.seeding.min_confidence={config.min_confidence}: {depth.source} gives no confidence. Use a stereo "
            "plugin that does, such as stereo=sgbm stereo.full_check=true or a network with "
            "stereo.left_right_check_px=1."
        )
    return np.where(sure & (depth.confidence >= config.min_confidence), depth.depth, np.nan)


def fill_inverse_depth(inverse: Map, known: Mask) -> Map:
    """Inverse depth (H, W) with holes filled by ever wider means of the known surroundings."""
    filled, weight = np.where(known, inverse, 0.0).astype(np.float32), known.astype(np.float32)
    result, done = filled.copy(), known.copy()
    size = 7
    while not done.all() and size < 4 * max(inverse.shape):
        total = cv2.boxFilter(filled, -1, (size, size), normalize=False, borderType=cv2.BORDER_CONSTANT)
        count = cv2.boxFilter(weight, -1, (size, size), normalize=False, borderType=cv2.BORDER_CONSTANT)
        use = ~done & (count > 0.5)
        result[use] = total[use] / count[use]
        done |= use
        size = 2 * size + 1
    return result


def disc_axes(inverse: Map, view: PinholeView) -> Map:
    """Unit surface normals (H, W, 3) in the camera's frame from a smoothed inverse depth (1/m).

    A plane has linear inverse depth: 1/z = (n . (x, y, 1)) / distance with normalised image coordinates x, y.
    """
    smooth = cv2.boxFilter(inverse, -1, (5, 5))
    a = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8)
    b = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, ksize=3, scale=1 / 8)
    x = (np.arange(view.width, dtype=np.float32) - view.cx)[None, :]
    y = (np.arange(view.height, dtype=np.float32) - view.cy)[:, None]
    normal = np.dstack([a * view.fx, b * view.fy, smooth - a * x - b * y])
    length = np.sqrt((normal * normal).sum(2, keepdims=True))
    return np.where(length > 1e-9, normal / np.maximum(length, 1e-9), np.array([0, 0, 1], np.float32)).astype(
        np.float32
    )


def _quaternions_from_z(normals: np.ndarray) -> np.ndarray:
    """Shortest rotations (N, 4) x, y, z, w that turn the z axis to the unit ``normals`` (N, 3)."""
    normals = np.where(normals[:, 2:] < 0, -normals, normals)
    q = np.stack([1 + normals[:, 2], -normals[:, 1], normals[:, 0], np.zeros(len(normals))], 1)
    return np.roll(q / np.linalg.norm(q, axis=1, keepdims=True), -1, axis=1)


def _beyond_the_border(image: np.ndarray, columns: int) -> np.ndarray:
    """The image (H, W, ...) with its first and last column repeated on its sides."""
    return np.pad(image, ((0, 0), (columns, columns)) + ((0, 0),) * (image.ndim - 2), mode="edge")


def _surfaces(depth: Map, sky: Mask | None, view: PinholeView, config: SeedingConfig) -> tuple[Map, Map, Mask]:
    """Inverse depth (H, W) and normals (H, W, 3) of what the pixels show, and where these are known or filled."""
    h, w = depth.shape
    known = np.isfinite(depth)
    inverse = np.where(known, 1.0 / np.where(known, depth, 1.0), 0.0).astype(np.float32)
    usable = known.copy()
    if config.fill_holes and known.any():
        inverse = fill_inverse_depth(inverse, known)
        ground = ground_inverse_depth(depth, view) if config.ground else None
        if ground is not None:
            inverse = np.where(known, inverse, np.maximum(inverse, ground))
        usable[:] = inverse > 0
    normals = disc_axes(inverse, view)
    if sky is not None:
        usable &= ~sky
        if config.sky_distance_m > 0:
            inverse = np.where(sky, 1.0 / config.sky_distance_m, inverse).astype(np.float32)
            rays = np.dstack(
                [
                    np.broadcast_to((np.arange(w, dtype=np.float32) - view.cx)[None, :] / view.fx, (h, w)),
                    np.broadcast_to((np.arange(h, dtype=np.float32) - view.cy)[:, None] / view.fy, (h, w)),
                    np.ones((h, w), np.float32),
                ]
            )
            normals[sky] = rays[sky] / np.linalg.norm(rays[sky], axis=1, keepdims=True)
            usable |= sky
    return inverse, normals, usable


def seed_gaussians(
    image: Image,
    depth: Map,
    sky: Mask | None,
    unexplained: Mask,
    view: PinholeView,
    config: SeedingConfig,
) -> Seeds:
    """New Gaussians for the unexplained pixels.

    ``depth`` (H, W) metres is NaN where unknown or out of range; ``sky`` (H, W) or None. ``unexplained``
    (H, W + 2 margin columns) has the margins of both sides too.
    """
    margin = config.margin_columns(view.width)
    no_sky = np.zeros(depth.shape, bool)
    inverse, normals, usable, image, sky = (
        _beyond_the_border(a, margin)
        for a in (*_surfaces(depth, sky, view, config), image, no_sky if sky is None else sky)
    )
    wide = view.widened(margin)
    grid = np.zeros(inverse.shape, bool)
    grid[:: config.stride, margin % config.stride :: config.stride] = True
    v, u = np.nonzero(grid & usable & unexplained)
    z = 1.0 / inverse[v, u]
    points = np.stack([(u - wide.cx) / view.fx * z, (v - view.cy) / view.fy * z, z], 1)
    # The inverse of the inverse, which differs from view.T_world_cam in the last bits: all kept results stand on it.
    T_world_cam = np.asarray(np.linalg.inv(view.T_cam_world), np.float64)
    means = points @ T_world_cam[:3, :3].T + T_world_cam[:3, 3]
    sigma = config.size * config.stride * z / view.fx
    scales = np.stack([sigma, sigma, sigma * config.thickness], 1)
    turn = se3.rotation_to_quaternion_by_vector(T_world_cam[:3, :3])
    quaternions = np.roll(se3.quaternion_product(turn, _quaternions_from_z(normals[v, u])), 1, axis=1)
    colors = image[v, u].astype(np.float32) / 255.0
    in_margin = (u < margin) | (u >= margin + view.width)
    opacities = np.where(in_margin, max(config.opacity, _MARGIN_OPACITY), config.opacity)
    columns = (means, scales, quaternions, opacities, colors)
    planes = planes_from(*(torch.from_numpy(np.ascontiguousarray(a, np.float32)) for a in columns))
    return Seeds(planes, torch.from_numpy(z.astype(np.float32)), torch.from_numpy(sky[v, u]))
