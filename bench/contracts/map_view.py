"""What a tracker or keyframer may ask of the map: the one arrow of the data flow that points back."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from bench.types import Float, Image, Map, PinholeView, RenderedView

if TYPE_CHECKING:
    from torch import Tensor

ImageLoss: TypeAlias = "Callable[[Tensor, Tensor, Tensor], Tensor]"
"""A scalar of colour (3, H, W), depth (H, W) = sum d alpha T in metres and alpha (H, W): tensors with gradients."""


class MapPoints(NamedTuple):
    """Elements of a map as points: ``positions`` (N, 3) float32 metres in the world, ``colors`` (N, 3) RGB uint8,
    ``radii`` (N,) float32 metres."""

    positions: npt.NDArray[np.float32]
    colors: Image
    radii: npt.NDArray[np.float32]


class MapView(ABC):
    """Read-only sight of the map as the mapper has it now: all keyframes before the current frame are in it.

    Before the first keyframe the map is empty: renders are black with alpha and depth 0, gradients are zero, nothing is
    seen. A map that can't offer one of these raises ``BenchError`` with the reason.
    """

    def require_images(self) -> None:  # noqa: B027 - most can
        """``BenchError`` where the map can't be rendered from any pose without depth: asked before the first frame, in
        ``use_map``, by whoever needs that."""

    @abstractmethod
    def render(self, view: PinholeView) -> RenderedView:
        """The map from a view, as numpy arrays."""

    @abstractmethod
    def differentiate(self, view: PinholeView, loss: ImageLoss) -> tuple[float, Float]:
        """Value of ``loss`` of the render, and its gradient (6,) float64 by the camera's twist.

        The twist is the left perturbation p_cam -> exp(twist) p_cam: translation in metres, then rotation in radians.
        """

    @abstractmethod
    def seen(self, view: PinholeView) -> npt.NDArray[np.int32]:
        """(N,) for each element of the map (Gaussian, point): pixels in which it shows while more than half of the
        light is left."""

    @abstractmethod
    def median_depth(self, view: PinholeView) -> Map:
        """(H, W) float32 metres: where half of the light is gone; NaN where it never is."""

    def refined_pose(self, number: int) -> Float | None:
        """``T_world_cam`` (4, 4) that mapping has found for a keyframe, for a tracker or keyframer that wants to go on
        from it; None (the default): it has none of its own for this frame."""
        return None

    def points(self, most: int) -> MapPoints | None:
        """At most ``most`` elements of what was drawn last, every n-th, without the sky, for who shows a run while it
        is made. Asking changes nothing, not a bit. None (the default): it has no points to show."""
        return None
