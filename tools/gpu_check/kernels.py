"""gsplat's kernels, which are built from the sources in its wheel when they are used for the first time."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from bench.authoring.random_scenes import SceneSpec, image_gradients, random_scene, render_and_back
from bench.registry import PluginConfig, build


def measure(rasterizer: str = "gsplat") -> Iterator[dict[str, Any]]:
    """One render and its gradients; yields the mean alpha. Afterwards nothing is left to be built or loaded."""
    mine = build(PluginConfig(rasterizer), "rasterizer")
    planes, view = random_scene(SceneSpec(1, 10, 16, 16, 1.2, (0.5, 0.9), 1))
    grads = tuple(grad.to(mine.device) for grad in image_gradients(view, 1))
    rendered, _ = render_and_back(mine, planes.to(mine.device), view, grads)  # type: ignore[arg-type]
    yield {"alpha": float(rendered.alpha.mean())}
