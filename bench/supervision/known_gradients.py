"""A loss whose gradients are known already, for autograd. Importing this executes torch."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch

if TYPE_CHECKING:
    from torch import Tensor


class KnownGradients(torch.autograd.Function):
    """``KnownGradients.apply(color, depth, value, by_color, by_depth)``: the scalar ``value``, whose gradients by
    ``color`` (3, H, W) and ``depth`` (H, W) are the last two."""

    @staticmethod
    def forward(ctx: Any, color: Tensor, depth: Tensor, value: Tensor, by_color: Tensor, by_depth: Tensor) -> Tensor:
        """``value``."""
        ctx.save_for_backward(by_color, by_depth)
        return value

    @staticmethod
    def backward(ctx: Any, *by_value: Tensor) -> tuple[Tensor | None, ...]:
        """The gradients, times that by ``value``."""
        by_color, by_depth = ctx.saved_tensors
        share = float(by_value[0])
        return by_color * share, by_depth * share, None, None, None
