"""Contract of a loss term of mapping.

Most authors write a pure function of the rendered images in plain torch and subclass ``TorchLoss``::

    @register("loss", "my_term", config=MyConfig)
    class MyTerm(TorchLoss):
        def loss(self, color, depth, alpha, target):
            return (alpha - 1.0).abs().mean()

and switch it on with ``loss=[rgb,ssim,geo,my_term] loss.my_term.weight=0.1``.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import torch

from bench.contracts.rasterizer import Rendered
from bench.errors import BenchError, require_least
from bench.registry import PluginConfig
from bench.supervision.photometric import Photometric
from bench.supervision.target import Target

if TYPE_CHECKING:
    from torch import Tensor


@dataclass(frozen=True)
class LossConfig(PluginConfig):
    """What every loss term has; derive the term's own config from it."""

    weight: float = 1.0
    """Factor of the term in the sum that mapping minimises; 0: not computed."""

    def __post_init__(self) -> None:
        """Refuse a negative weight; a config with checks of its own calls this one too."""
        require_least(f"loss.{self.name}", self, weight=0)


class NotFiniteError(BenchError):
    """A loss term, or its gradient, is NaN or infinite: a step with it would spoil the map."""


@dataclass
class LossValue:
    """A term's unweighted value and its unweighted gradients by the rendered images (None = zero)."""

    value: float
    grad_color: Tensor | None = None
    grad_depth: Tensor | None = None
    grad_alpha: Tensor | None = None


@dataclass
class ImageGradients:
    """Gradients by the rendered images of the terms added so far, times their weights (None = zero)."""

    color: Tensor | None = None
    depth: Tensor | None = None
    alpha: Tensor | None = None

    def add(self, image: str, grad: Tensor | None, weight: float) -> None:
        """Add a term's unweighted gradient by one image."""
        if grad is not None:
            total = getattr(self, image)
            setattr(self, image, grad * weight if total is None else total.add_(grad, alpha=weight))

    def open(self, rendered: Rendered, *images: str) -> bool:
        """Have memory for these images' gradients; whether a kernel must add to what it holds, else overwrite it."""
        missing = [image for image in images if getattr(self, image) is None]
        add = len(missing) < len(images)
        for image in missing:
            like = getattr(rendered, image)
            setattr(self, image, torch.zeros_like(like) if add else torch.empty_like(like))
        return add


def runs_in_core(rendered: Rendered, target: Target) -> bool:
    """Whether the C++ core can evaluate a term of these images: float32 on the CPU."""
    images = (rendered.depth, rendered.alpha, target.depth)
    return all(image.device.type == "cpu" and image.dtype == torch.float32 for image in images)


class LossTerm(ABC):
    """One term. ``photometric`` says that the term is this mixture of mean L1, mean L2 and 1 - mean SSIM of the
    colours; all such terms of a run are computed in one fused pass and ``evaluate`` is not called."""

    photometric: Photometric | None = None

    def __init__(self, config: Any) -> None:
        self.config = config

    @abstractmethod
    def evaluate(self, rendered: Rendered, target: Target) -> LossValue:
        """Value and gradients for one render."""

    def add_to(self, sums: ImageGradients, rendered: Rendered, target: Target) -> float:
        """Add the weighted gradients for one render to ``sums``; the unweighted value. ``NotFiniteError`` for gradients
        that are no numbers."""
        value = self.evaluate(rendered, target)
        for image in ("color", "depth", "alpha"):
            grad = getattr(value, f"grad_{image}")
            # Of a value that is no number the sum of the terms tells.
            if grad is not None and math.isfinite(value.value) and not bool(torch.isfinite(grad).all()):
                raise NotFiniteError(
                    f"the loss term {self.config.name} is {value.value:.4g}, but its gradient by the rendered {image} "
                    "is not finite. Is there a root or a division of what can be 0?"
                )
            sums.add(image, grad, self.config.weight)
        return value.value


class TorchLoss(LossTerm):
    """A term written as a scalar torch function; autograd gives its gradients."""

    @abstractmethod
    def loss(self, color: Tensor, depth: Tensor, alpha: Tensor, target: Target) -> Tensor:
        """Scalar loss of colour (3, H, W), depth (H, W) in metres (sum d a T), alpha (H, W)."""

    def evaluate(self, rendered: Rendered, target: Target) -> LossValue:
        leaves = [image.detach().requires_grad_() for image in (rendered.color, rendered.depth, rendered.alpha)]
        with torch.enable_grad():
            value = self.loss(leaves[0], leaves[1], leaves[2], target)
        if not value.requires_grad:
            return LossValue(float(value))
        grads = torch.autograd.grad(value, leaves, allow_unused=True)
        return LossValue(float(value.detach()), *grads)


class CoreLoss(TorchLoss):
    """A torch term that the C++ core has too, value and weighted gradient in one pass, for float32 on the CPU."""

    @property
    def has_kernel(self) -> bool:
        """Whether the core has the term as it is set; where not, the torch form serves everywhere."""
        return True

    @abstractmethod
    def in_core(self, sums: ImageGradients, rendered: Rendered, target: Target, weight: float) -> float:
        """Add ``weight`` times the gradients for one render to ``sums``; the unweighted value."""

    def evaluate(self, rendered: Rendered, target: Target) -> LossValue:
        if not (self.has_kernel and runs_in_core(rendered, target)):
            return super().evaluate(rendered, target)
        sums = ImageGradients()
        value = self.in_core(sums, rendered, target, 1.0)
        return LossValue(value, sums.color, sums.depth, sums.alpha)

    def add_to(self, sums: ImageGradients, rendered: Rendered, target: Target) -> float:
        if not (self.has_kernel and runs_in_core(rendered, target)):
            return super().add_to(sums, rendered, target)
        return self.in_core(sums, rendered, target, self.config.weight)
