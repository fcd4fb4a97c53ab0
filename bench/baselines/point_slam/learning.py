"""Learning the points' features, and the decoders, from rays of a few frames."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import torch

from bench.baselines.point_slam.frames import MappedFrame, Seen, draw, seen_by
from bench.baselines.point_slam.rays import Features, RayRenderer, Rays, RenderedRays
from bench.baselines.point_slam.settings import PointSlamMapperConfig
from bench.types import StereoCamera

if TYPE_CHECKING:
    from torch import Generator, Tensor

_REFINEMENT_SHARE = 0.1


class Learning:
    """Adam on the features of some ``points`` (N,) bool of the cloud, and on the decoders that learn.

    ``geometry_learns``: whether the geometry decoder does. ``refining``: colour features alone learn, at a tenth of
    their rate.
    """

    def __init__(
        self,
        renderer: RayRenderer,
        config: PointSlamMapperConfig,
        points: npt.NDArray[np.bool_],
        geometry_learns: bool = False,
        refining: bool = False,
    ) -> None:
        self._renderer, self._config, self._refining = renderer, config, refining
        cloud = renderer.cloud
        # Rows that learn come first: the others are joined to them in each iteration, without a gradient.
        order = torch.from_numpy(np.argsort(~points, kind="stable")).to(cloud.device)
        self._learned, rest = order[: points.sum()], order[points.sum() :]
        self._row = torch.argsort(order)
        self._fixed = cloud.geometry[rest], cloud.color[rest]
        self._geometry = cloud.geometry[self._learned].requires_grad_(not refining)
        self._color = cloud.color[self._learned].requires_grad_()
        for decoder, learns in ((renderer.geometry, geometry_learns), (renderer.color, not refining)):
            decoder.requires_grad_(learns)
        self._groups: dict[str, list[Tensor]] = {
            "geometry": [] if refining else [self._geometry],
            "color": [self._color],
            "geometry decoder": list(renderer.geometry.parameters()) if geometry_learns else [],
            "color decoder": [] if refining else list(renderer.color.parameters()),
        }
        groups = [{"params": tensors, "lr": 0.0, "of": of} for of, tensors in self._groups.items() if tensors]
        self._adam = torch.optim.Adam(groups, fused=True)

    def iterate(
        self, frames: Sequence[MappedFrame], camera: StereoCamera, with_color: bool, random: Generator
    ) -> float:
        """One iteration with rays shared out over ``frames``; the value of its loss."""
        share, device = self._config.rays // len(frames), self._renderer.cloud.device
        drawn = [(frame, frame.known[draw(share, len(frame.known), random)]) for frame in frames if len(frame.known)]
        if not drawn:
            return 0.0
        parts = [seen_by(frame, pixels, camera, self._renderer.settings, device) for frame, pixels in drawn]
        rays = Rays(*(torch.cat(each) for each in zip(*(part.rays for part in parts), strict=True)))
        seen = Seen(rays, torch.cat([part.depth for part in parts]), torch.cat([part.color for part in parts]))
        for group in self._adam.param_groups:
            group["lr"] = self._rate(group["of"], with_color)
        self._adam.zero_grad(set_to_none=True)
        with torch.enable_grad():
            geometry = torch.cat([self._geometry, self._fixed[0]])
            color = torch.cat([self._color, self._fixed[1]])
            rendered = self._renderer.render(rays, with_color, Features(geometry, color, self._row))
            loss = mapping_loss(rendered, seen, self._config.color_weight if with_color else 0.0)
            if loss.requires_grad:  # else no ray had neighbours
                loss.backward()
                self._adam.step()
        return float(loss.detach())

    def finish(self) -> None:
        """Put what was learned into the cloud."""
        cloud = self._renderer.cloud
        cloud.geometry[self._learned] = self._geometry.detach()
        cloud.color[self._learned] = self._color.detach()
        for decoder in (self._renderer.geometry, self._renderer.color):
            decoder.requires_grad_(False)

    def _rate(self, of: str, with_color: bool) -> float:
        c = self._config
        if self._refining:
            return c.color_stage_rate * _REFINEMENT_SHARE
        if with_color:
            return c.color_stage_rate
        return {"geometry": c.geometry_rate, "color": 0.0}.get(of, c.decoder_rate)


def mapping_loss(rendered: RenderedRays, seen: Seen, color_weight: float) -> Tensor:
    """Sum of absolute differences of depth in metres, and of colour times its weight, over rays with neighbours."""
    valid = rendered.valid
    loss = (rendered.depth - seen.depth).abs()[valid].sum()
    if color_weight:
        loss = loss + color_weight * (rendered.color - seen.color).abs()[valid].sum()
    return loss


def later_iterations(base: int, added: int) -> int:
    """Iterations of a frame that added so many points: in proportion, 300 points for ``base``, 0.95 to 2 times that."""
    return int(np.clip(int(base * added / 300), int(0.95 * base), 2 * base))
