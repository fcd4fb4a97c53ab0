"""The fast rasterizer on the CPU: the C++ core in ``bench/native``."""

from __future__ import annotations

import importlib.util
from dataclasses import fields
from typing import TYPE_CHECKING

import numpy as np
import torch

from bench.contracts.rasterizer import AdamStep, Gradients, Observation, Rasterizer, Rendered
from bench.registry import PluginConfig, register
from bench.types import PinholeView

if TYPE_CHECKING:
    from torch import Tensor


@register("rasterizer", "cpu")
class CpuRasterizer(Rasterizer):
    """C++17 core, eight lanes wide, on all cores; the same bits for any number of threads."""

    learns = True

    def __init__(self, config: PluginConfig) -> None:
        import bench._native as _native

        self.device = torch.device("cpu")
        self._native = _native
        self._free: list = []  # workspaces between uses
        self._gradients = torch.empty(0, 0)  # reused: new memory for each iteration costs more than what a view touches

    @classmethod
    def unavailable_reason(cls) -> str | None:
        """None, or why the core can't be loaded."""
        if importlib.util.find_spec("bench._native") is None:
            return "the C++ core is not built. Run: make install"
        return None

    def render(self, planes: Tensor, view: PinholeView, differentiable: bool = True) -> Rendered:
        workspace = self._free.pop() if self._free else self._native.Workspace()
        color = torch.empty(3, view.height, view.width)
        depth, alpha = torch.empty(view.height, view.width), torch.empty(view.height, view.width)
        workspace.forward(
            planes, np.ascontiguousarray(view.T_cam_world), view.fx, view.fy, view.cx, view.cy, color, depth, alpha
        )
        if not differentiable:
            self._free.append(workspace)
            return Rendered(color, depth, alpha)
        # The backward pass reads the images again: they must live as long as the context does.
        return Rendered(color, depth, alpha, (workspace, planes, (color, depth, alpha)))

    def learn(
        self,
        rendered: Rendered,
        grad_color: Tensor | None,
        grad_depth: Tensor | None,
        grad_alpha: Tensor | None,
        step: AdamStep,
        pose: bool = False,
    ) -> Tensor | None:
        workspace, planes, _images = rendered.context
        of_step = (getattr(step, each.name) for each in fields(step))
        twist = workspace.learn(planes, grad_color, grad_depth, grad_alpha, *of_step, pose)
        rendered.context = None
        self._free.append(workspace)
        return torch.tensor(twist, dtype=torch.float64) if pose else None

    def observe(self, planes: Tensor, view: PinholeView) -> Observation:
        workspace = self._free.pop() if self._free else self._native.Workspace()
        pixels = torch.empty(planes.shape[1], dtype=torch.int32)
        median_depth = torch.empty(view.height, view.width)
        T_cam_world = np.ascontiguousarray(view.T_cam_world)
        workspace.observe(planes, T_cam_world, view.fx, view.fy, view.cx, view.cy, pixels, median_depth)
        self._free.append(workspace)
        return Observation(pixels, median_depth)

    def backward(
        self,
        rendered: Rendered,
        grad_color: Tensor | None,
        grad_depth: Tensor | None,
        grad_alpha: Tensor | None,
        pose: bool = False,
        learning: int | None = None,
    ) -> Gradients:
        workspace, planes, _images = rendered.context
        rows, count = len(planes), planes.shape[1] if pose or learning is None else learning
        if len(self._gradients) != rows or self._gradients.shape[1] < count:
            # Not a multiple of 4 KiB between rows: all would want the same lines of the cache (Adam 1.6 times as long).
            self._gradients = torch.empty(rows, (count + count // 8) | 16)
        grads, touched = self._gradients[:, :count], torch.empty(count, dtype=torch.bool)
        twist = workspace.backward(planes, grad_color, grad_depth, grad_alpha, grads, touched, pose)
        rendered.context = None
        self._free.append(workspace)
        return Gradients(
            grads[:, :learning], touched[:learning], torch.tensor(twist, dtype=torch.float64) if pose else None
        )
