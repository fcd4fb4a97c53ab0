"""Rays through pixels of known depth, and what the neural points show along them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import torch

from bench.baselines.point_slam.cloud import PointCloud
from bench.errors import BenchError, require_least

if TYPE_CHECKING:
    from torch import Tensor

    from bench.baselines.point_slam.decoders import ColorDecoder, GeometryDecoder

EMPTY_LOGIT = -100.0
LOGIT_SHARE = 0.1
"""alpha = sigmoid(0.1 logit)."""
_TINY = 1e-10


@dataclass(frozen=True)
class RaySettings:
    """Where a ray is sampled and which points count there."""

    samples: int = 5
    """Samples of a ray, evenly spread around the pixel's depth."""
    near: float = 0.98
    """First sample, as a share of the pixel's depth."""
    far: float = 1.02
    """Last sample, as a share of the pixel's depth."""
    neighbours: int = 8
    """Points that a sample takes its features from, the nearest ones, as far as they lie in its radius."""
    least_neighbours: int = 2
    """With fewer points in its radius a sample counts as empty."""
    march: bool = False
    """Whether a pixel of unknown depth is rendered from where its ray first meets points; false = it stays black."""
    unit_m: float = 1.0
    """Metres that count as 1 where decoders look at positions, whose finest waves are a few centimetres long with 1."""

    def __post_init__(self) -> None:
        require_least("mapper.ray", self, samples=2, neighbours=1, least_neighbours=1)
        if not 0 < self.near < self.far:
            raise BenchError(f"mapper.ray: near={self.near} must be above 0 and below far={self.far}.")
        if not self.unit_m > 0:
            raise BenchError(f"mapper.ray.unit_m={self.unit_m} must be above 0.")
        if self.least_neighbours > self.neighbours:
            raise BenchError(
                f"mapper.ray: least_neighbours={self.least_neighbours} is more than neighbours={self.neighbours}."
            )


class Rays(NamedTuple):
    """Origins (R, 3) in metres, directions (R, 3) whose length is 1 along the camera's axis, both in the world; ``z``
    (R, S) metres along that axis, where they are sampled; query radius (R,) in metres."""

    origins: Tensor
    directions: Tensor
    z: Tensor
    radius: Tensor


class RenderedRays(NamedTuple):
    """``depth`` (R,) metres; ``variance`` (R,) m^2 of the depth; ``valid`` (R,): enough samples have neighbours;
    ``color`` (R, 3) in [0, 1], black where nobody asked for it."""

    depth: Tensor
    variance: Tensor
    valid: Tensor
    color: Tensor


@dataclass(frozen=True)
class Features:
    """Tables of features (N, 32) for all points of a cloud; ``row`` (N,): where each point's features stand in them,
    None = in the order of the points."""

    geometry: Tensor
    color: Tensor
    row: Tensor | None = None


def around(depth: Tensor, settings: RaySettings) -> Tensor:
    """Samples (R, S) around depths (R,)."""
    shares = torch.linspace(settings.near, settings.far, settings.samples, dtype=depth.dtype, device=depth.device)
    return depth[:, None] * shares


class RayRenderer:
    """A cloud seen through its decoders."""

    def __init__(
        self, cloud: PointCloud, geometry: GeometryDecoder, color: ColorDecoder, settings: RaySettings
    ) -> None:
        self.cloud, self.geometry, self.color, self.settings = cloud, geometry, color, settings

    def render(self, rays: Rays, with_color: bool = True, features: Features | None = None) -> RenderedRays:
        """What the rays show; differentiable by origins, directions, features and the decoders' weights.

        alpha = sigmoid(0.1 logit), weights w = alpha T; depth and colour are divided by the sum of w, so that they say
        nothing of what lies behind the last sample; variance is sum w (z - depth)^2.
        """
        s = self.settings
        places = rays.origins[:, None] + rays.directions[:, None] * rays.z[..., None]
        logits = places.new_full(rays.z.shape, EMPTY_LOGIT)
        colors = places.new_zeros((*rays.z.shape, 3))
        features = features or Features(self.cloud.geometry, self.cloud.color)
        index, inside = self._neighbours(places.detach(), rays.radius)
        found = inside.sum(-1) >= s.least_neighbours
        if bool(found.any()):
            where, index, inside = places[found], index[found], inside[found]
            offset = self.cloud.positions[index].to(where.dtype) - where[:, None]
            weight = torch.where(inside, 1.0 / ((offset * offset).sum(-1) + _TINY), 0.0)
            weight = weight / weight.sum(-1, keepdim=True)
            index = index if features.row is None else features.row[index]
            logits = _put(logits, found, self.geometry(where / s.unit_m, _average(features.geometry, index, weight)))
            if with_color:
                mean = self._color_features(features.color, index, offset, weight)
                colors = _put(colors, found, self.color(where / s.unit_m, mean))
        alpha = torch.sigmoid(LOGIT_SHARE * logits)
        light = torch.cumprod(torch.cat([torch.ones_like(alpha[:, :1]), 1.0 - alpha + _TINY], 1), 1)[:, :-1]
        w = alpha * light
        total = w.sum(1) + _TINY
        depth = (w * rays.z).sum(1) / total
        variance = (w * (rays.z - depth[:, None]) ** 2).sum(1)
        color = (w[..., None] * colors).sum(1) / total[:, None]
        return RenderedRays(depth, variance, found.sum(1) >= s.samples // 2 + 1, color)

    def _neighbours(self, places: Tensor, radius: Tensor) -> tuple[Tensor, Tensor]:
        """Indices (R, S, K) of the nearest points of (R, S, 3) places, and whether each is within its ray's radius."""
        flat, k = places.reshape(-1, 3).cpu().numpy(), self.settings.neighbours
        distance, index = self.cloud.nearest(flat, k, float(radius.max()) if len(radius) else 0.0)
        within = radius.cpu().numpy().astype(np.float64).repeat(places.shape[1])
        inside = distance < within[:, None]
        shape = (*places.shape[:2], k)
        return (
            torch.from_numpy(index).reshape(shape).to(places.device),
            torch.from_numpy(inside).reshape(shape).to(places.device),
        )

    def _color_features(self, table: Tensor, index: Tensor, offset: Tensor, weight: Tensor) -> Tensor:
        if not self.color.relative:
            return _average(table, index, weight)
        each = torch.nn.functional.embedding(index.reshape(-1), table)
        passed = self.color.of_neighbours(each, offset.reshape(-1, 3) / self.settings.unit_m)
        return (passed.reshape(*index.shape, -1) * weight[..., None]).sum(1)


def _average(table: Tensor, index: Tensor, weight: Tensor) -> Tensor:
    """Weighted sums (Q, F) of rows of a table (N, F) by indices and weights (Q, K)."""
    sums: Tensor = torch.nn.functional.embedding_bag(
        index, table, per_sample_weights=weight.to(table.dtype), mode="sum"
    )
    return sums


def _put(into: Tensor, where: Tensor, values: Tensor) -> Tensor:
    """A copy of ``into`` with ``values`` where the mask says so, differentiable by these."""
    return torch.masked_scatter(into, where if into.dim() == where.dim() else where[..., None], values)
