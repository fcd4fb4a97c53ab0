"""A rasterizer against the float64 reference and the C++ core: images and gradients, by quantiles of their errors."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from bench.authoring.random_scenes import GROUPS, SceneSpec, image_gradients, random_scene, render_and_back
from bench.contracts.rasterizer import Rasterizer
from bench.errors import BenchError
from bench.registry import PluginConfig, build

if TYPE_CHECKING:
    from torch import Tensor

SCENES: Mapping[str, SceneSpec] = {
    f"degree {degree}, axes {ratio:g}:1": SceneSpec(20 + degree, 400, 150, 70, ratio, opacity, degree)
    for degree, ratio, opacity in (
        *((0, 1.2, (0.05, 0.5)), (0, 6.0, (0.1, 0.99))),
        *((degree, 3.0, (0.05, 0.95)) for degree in (1, 2, 3)),
    )
}
"""Compared with the reference, which takes every Gaussian at every pixel, and with the core."""
LARGE = SceneSpec(30, 50_000, 1241, 376, 3.0, (0.05, 0.95), 3)
"""Compared with the core."""
IMAGES = ("color", "depth", "alpha")
QUANTILES = (0.5, 0.99, 0.999, 1.0)
IMAGES_WITHIN, GRADIENTS_WITHIN = 1e-4, 1e-2
"""What the 0.99 quantile may be. Errors of images are absolute, or relative above 1; those of gradients are relative to
their root mean square."""


def measure(
    rasterizer: str = "gsplat", scenes: Mapping[str, SceneSpec] = SCENES, large: SceneSpec | None = LARGE
) -> Iterator[dict[str, Any]]:
    """Yields what is known so far: quantiles by scene, by ``reference`` or ``cpu``, and by what was compared.

    Raises ``BenchError`` in the end where one of them is beyond its limit.
    """
    found: dict[str, Any] = {"quantiles": QUANTILES, "errors": {}, "beyond": []}
    mine = build(PluginConfig(rasterizer), "rasterizer")
    for name, spec in [*scenes.items(), *([("large", large)] if large else [])]:
        found["errors"][name] = {}
        for other in ("cpu",) if spec is large else ("reference", "cpu"):
            errors = compare(mine, build(PluginConfig(other), "rasterizer"), spec)
            found["errors"][name][other] = errors
            found["beyond"] += [
                f"{what} of {name} against {other}: {values[1]:.2g}, at most {values[-1]:.2g}"
                for what, values in errors.items()
                if values[1] > (IMAGES_WITHIN if what in IMAGES else GRADIENTS_WITHIN) or not math.isfinite(values[-1])
            ]
        yield found
    if found["beyond"]:
        raise BenchError(f"{rasterizer} differs by more than it may: {'; '.join(found['beyond'])}.")


def compare(mine: Rasterizer, other: Rasterizer, spec: SceneSpec) -> dict[str, list[float]]:
    """``QUANTILES`` of the errors of colour, depth, alpha, of the gradients of each group, and of the twist's."""
    planes, view = random_scene(spec)
    results = []
    for rasterizer in (mine, other):
        grads = tuple(grad.to(rasterizer.device) for grad in image_gradients(view, spec.seed))
        results.append(render_and_back(rasterizer, planes.to(rasterizer.device), view, grads))  # type: ignore[arg-type]
    (images, gradients), (true_images, true_gradients) = results
    errors = {}
    for name in IMAGES:
        true = _whole(getattr(true_images, name))
        errors[name] = _quantiles((_whole(getattr(images, name)) - true).abs() / true.abs().clamp_min(1.0))
    touched = true_gradients.touched.cpu()
    for group, rows in GROUPS.items():
        if not len(planes[rows]):
            continue
        of_group, true = (_whole(each.planes)[rows][:, touched] for each in (gradients, true_gradients))
        errors[group] = _relative(of_group, true)
    assert gradients.twist is not None
    assert true_gradients.twist is not None
    errors["twist"] = _relative(_whole(gradients.twist), _whole(true_gradients.twist))
    return errors


def _whole(values: Tensor) -> Tensor:
    return values.detach().cpu().double()


def _relative(values: Tensor, true: Tensor) -> list[float]:
    size = true.square().mean().sqrt().clamp_min(1e-300)
    return _quantiles((values - true).abs() / size)


def _quantiles(errors: Tensor) -> list[float]:
    # Not torch.quantile, which refuses more than 16 million values; NaN is the largest.
    ordered = errors.flatten().sort().values
    return [float(ordered[round(q * (len(ordered) - 1))]) for q in QUANTILES]
