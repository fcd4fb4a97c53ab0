"""A Gaussian map as trackers and keyframers see it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import torch

from bench.contracts.map_view import ImageLoss, MapPoints, MapView
from bench.contracts.rasterizer import Rasterizer, Rendered
from bench.errors import BenchError
from bench.gaussians.chunked_map import ChunkedMap
from bench.gaussians.map import GaussianMap
from bench.gaussians.parameters import NamedParameters
from bench.types import Float, Map, PinholeView, RenderedView

if TYPE_CHECKING:
    from torch import Tensor


def as_arrays(rendered: Rendered) -> RenderedView:
    """A render as numpy arrays, colours clamped to [0, 1]."""
    color = rendered.color.clamp(0.0, 1.0).permute(1, 2, 0).float().cpu().numpy()
    return RenderedView(color, rendered.depth.float().cpu().numpy(), rendered.alpha.float().cpu().numpy())


class GaussianMapView(MapView):
    """Looks at ``gaussians`` as they are when it is asked; never changes them, but for where their sky stands."""

    def __init__(
        self,
        gaussians: GaussianMap | ChunkedMap,
        rasterizer: Rasterizer,
        refined_pose: Callable[[int], Float | None] = lambda number: None,
    ) -> None:
        self._map, self._rasterizer, self._refined_pose = gaussians, rasterizer, refined_pose

    def _planes(self, view: PinholeView) -> Tensor:
        return self._map.seen_from(view.T_world_cam[:3, 3])

    def render(self, view: PinholeView) -> RenderedView:
        """The map from a view, colours clamped to [0, 1]."""
        rendered = self._rasterizer.render(self._planes(view), view, differentiable=False)
        return as_arrays(rendered)

    def differentiate(self, view: PinholeView, loss: ImageLoss) -> tuple[float, Float]:
        """Value and gradient (6,) by the twist, with the sky as a thing at its distance; ``BenchError`` for a loss that
        does not depend on the render."""
        rendered = self._rasterizer.render(self._planes(view), view)
        images = [image.detach().requires_grad_() for image in (rendered.color, rendered.depth, rendered.alpha)]
        with torch.enable_grad():
            value = loss(*images)
        if not value.requires_grad:
            raise BenchError("The loss given to MapView.differentiate() does not depend on colour, depth or alpha.")
        gradients = torch.autograd.grad(value, images, allow_unused=True)
        color, depth, alpha = (None if gradient is None else gradient.contiguous() for gradient in gradients)
        twist = self._rasterizer.backward(rendered, color, depth, alpha, pose=True).twist
        assert twist is not None
        return float(value.detach()), twist.double().cpu().numpy()

    def seen(self, view: PinholeView) -> npt.NDArray[np.int32]:
        """(N,) pixels per Gaussian in which it is blended while more than half of the light is left."""
        return self._rasterizer.observe(self._planes(view), view).pixels.cpu().numpy()

    def median_depth(self, view: PinholeView) -> Map:
        """(H, W) metres of the Gaussian with which half of the light is gone; NaN where it never is."""
        return self._rasterizer.observe(self._planes(view), view).median_depth.float().cpu().numpy()

    def refined_pose(self, number: int) -> Float | None:
        """The keyframe's pose as mapping has it, where mapping optimises poses."""
        return self._refined_pose(number)

    def points(self, most: int) -> MapPoints:
        """Gaussians as they stand: asking for them from another place would move the sky, which rounds."""
        seen = self._map.drawn[:, self._map.sky :]
        named = NamedParameters(seen[:, :: max(1, -(-seen.shape[1] // most))].detach())
        colors = (named.colors.clamp_max(1.0) * 255).round().to(torch.uint8)
        radii = named.scales.amax(1)
        return MapPoints(*(values.cpu().numpy() for values in (named.means.contiguous(), colors, radii)))
