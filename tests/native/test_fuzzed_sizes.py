"""The core with images and counts of any size, and numbers that a damaged map or a bad network may hold.

Results are compared elsewhere; here nothing may be read or written beside the arrays, which `make sanitize` sees.
"""

from __future__ import annotations

import numpy as np
import pytest
import torch

from bench import _native
from bench.authoring.random_scenes import SceneSpec, image_gradients, random_scene, render_and_back
from bench.registry import PluginConfig
from bench.tracking.orb_tests import comparisons
from plugins.rasterizers.cpu import CpuRasterizer

SEEDS = range(12)
STRANGE = np.array([np.nan, np.inf, -np.inf, 3e38, -3e38, 1e-45, 0.0], np.float32)


def strange(rng: np.random.Generator, values: torch.Tensor, share: float = 0.1) -> torch.Tensor:
    """A copy in which a share of the numbers is NaN, infinite, huge or nearly nothing."""
    array = values.numpy().copy()
    hit = rng.random(array.shape) < share
    array[hit] = rng.choice(STRANGE, int(hit.sum()))
    return torch.from_numpy(array)


def tensor(rng: np.random.Generator, *shape: int) -> torch.Tensor:
    return torch.from_numpy(rng.uniform(0.05, 1.0, shape).astype(np.float32))


@pytest.mark.parametrize("seed", SEEDS)
def test_render_and_back(seed: int) -> None:
    rng = np.random.default_rng(seed)
    width, height, count = (int(rng.integers(1, most)) for most in (70, 50, 60))
    spec = SceneSpec(seed, count, width, height, float(rng.uniform(1, 9)), (0.05, 0.99), degree=int(rng.integers(0, 4)))
    planes, view = random_scene(spec)
    rasterizer = CpuRasterizer(PluginConfig("cpu"))
    rendered, gradients = render_and_back(rasterizer, planes, view, image_gradients(view, seed))
    assert rendered.color.isfinite().all()
    assert gradients.planes.isfinite().all()
    render_and_back(rasterizer, strange(rng, planes), view, image_gradients(view, seed))


@pytest.mark.parametrize("seed", SEEDS)
def test_losses(seed: int) -> None:
    rng = np.random.default_rng(seed)
    h, w = (int(side) for side in rng.integers(1, 45, 2))
    image, target, mean, variance, grad = (tensor(rng, 3, h, w) for _ in range(5))
    depth, alpha, other, grad_depth = (tensor(rng, h, w) for _ in range(4))
    normals, mask = tensor(rng, 3, h, w), torch.from_numpy(rng.random((h, w)) < 0.8)
    for twist in (lambda values: values, lambda values: strange(rng, values)):
        image, depth, alpha, other = (twist(values) for values in (image, depth, alpha, other))
        _native.target_statistics(target, mean, variance)
        _native.photometric(image, target, mean, variance, 0.8, 0.1, 0.2, grad)
        focal = (20.0, 22.0, 0.4 * w, 0.6 * h)
        _native.normal_loss(depth, alpha, 0.5, normals, mask, *focal, 0.1, grad_depth, False)
        _native.smooth_loss(depth, alpha, 0.5, [1, int(rng.integers(1, 50))], *focal, 0.1, grad_depth, True)
        stride = int(rng.integers(1, 9))
        _native.geo_loss(depth, alpha, other, mask, None, stride, 0.1, grad_depth, torch.zeros(h, w), False)


@pytest.mark.parametrize("seed", SEEDS)
def test_adam(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(0, 40))
    planes, first, second, grads = (tensor(rng, 14, count) for _ in range(4))
    touched = torch.from_numpy(rng.random(count) < 0.5) if seed % 2 else None
    for gradients in (grads, strange(rng, grads)):
        _native.adam_step(planes, first, second, gradients, None, [0.01] * 14, 0.9, 0.999, 1e-15, 1, touched)


@pytest.mark.parametrize("seed", SEEDS)
def test_features_and_matches(seed: int) -> None:
    rng = np.random.default_rng(seed)
    h, w = (int(side) for side in rng.integers(1, 160, 2))
    image = rng.integers(0, 256, (h, w), dtype=np.uint8)
    extractor = _native.OrbExtractor(int(rng.integers(1, 300)), int(rng.integers(1, 5)), 1.2, 10, comparisons())
    xy, octave, bits, smaller = extractor.extract(image)
    levels = [image, *smaller]
    assert len(xy) == len(octave) == len(bits)
    n = len(xy)
    band = np.full(n, 2.0)
    right, _ = _native.pair_rows(xy, octave, bits, xy, octave, bits, band, 0.0, 1.0, 75)
    assert ((right >= -1) & (right < n)).all()
    at = np.round(xy / 1.2 ** octave[:, None]).astype(np.int64)
    _native.refine_disparity(levels, levels, octave, at, at[:, 0].copy())
    _native.refine_disparity(levels, levels, octave, rng.integers(-9, 200, (n, 2)), rng.integers(-9, 200, n))
    uv = rng.uniform(-50, 200, (30, 2))
    uv[rng.random(30) < 0.2] = np.nan
    descriptors = rng.integers(0, 2**63, (30, 4), dtype=np.uint64)
    radius, level = rng.uniform(0, 40, 30), rng.integers(0, 4, 30)
    unknown = np.full(30, np.nan)
    best, _ = _native.match_boxes(
        *(uv, radius, level, unknown, descriptors, xy, octave, np.full(n, np.nan), bits, 100, 0.9, 1.0)
    )
    assert ((best >= -1) & (best < n)).all()
    assert (best[np.isnan(uv).any(1)] == -1).all()
    nowhere = np.where(rng.random(xy.shape) < 0.3, np.nan, xy)
    right, _ = _native.pair_rows(nowhere, octave, bits, nowhere[::-1].copy(), octave, bits, band, 0.0, 1.0, 75)
    assert (right[np.isnan(nowhere).any(1)] == -1).all()


@pytest.mark.parametrize("seed", SEEDS)
def test_poses_and_bundles(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, keyframes = int(rng.integers(1, 30)), int(rng.integers(1, 4))
    camera, points = [100.0, 100.0, 50.0, 40.0, 54.0], rng.uniform(-5, 5, (n, 3)) + np.array([0, 0, 8])
    measured = np.concatenate([rng.uniform(0, 100, (n, 3)), rng.integers(0, 4, (n, 1))], 1)
    T = np.tile(np.eye(4), (keyframes, 1, 1))
    keyframe = np.sort(rng.integers(0, keyframes, n))
    for share in (0.0, 0.2):
        hit = rng.random(points.shape) < share
        points[hit] = rng.choice(STRANGE, int(hit.sum()))
        _native.optimise_pose(camera, points, measured, T[0].copy(), 3, 4, False)
        _native.bundle_adjust(camera, T, 0, points, keyframe, np.arange(n), measured, [2, 2])
