"""Colour transforms: what made the pictures is found again, and gradients are those of autograd."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from bench.errors import BenchError
from bench.supervision.appearance import IDENTITY, Appearance, CameraColors, Exposures, fit_colors
from bench.supervision.target import Target
from bench.types import DepthMap, Float, Keyframe, PinholeView
from plugins.datasets.street import Street, StreetConfig

DARKER: Float = np.column_stack([np.diag([0.8, 0.7, 0.9]), [0.02, 0.0, -0.01]])
MIXED: Float = np.column_stack([[[0.8, 0.1, 0.0], [0.05, 0.9, 0.0], [-0.1, 0.0, 1.1]], [0.0, 0.03, 0.01]])


def seen(image: np.ndarray, colors: Float) -> np.ndarray:
    """An image (..., 3) in [0, 1] with each pixel's colour changed, clipped."""
    return np.clip(image @ colors[:, :3].T + colors[:, 3], 0, 1)


@pytest.mark.parametrize(("kind", "truth"), [("gain_bias", DARKER), ("affine", MIXED), ("affine", DARKER)])
def test_a_transform_is_found_among_outliers(kind: str, truth: Float) -> None:
    random = np.random.default_rng(0)
    before = random.uniform(0.1, 0.8, (4000, 3))
    after = seen(before, truth) + random.normal(0, 0.005, before.shape)
    after[::4] = random.uniform(0, 1, after[::4].shape)
    assert np.abs(fit_colors(before, after, kind) - truth).max() < 0.03


def test_grey_pixels_do_not_mix_channels() -> None:
    grey = np.repeat(np.random.default_rng(0).uniform(0, 1, (500, 1)), 3, 1)
    np.testing.assert_allclose(fit_colors(grey, grey, "affine"), IDENTITY, atol=1e-9)
    assert np.array_equal(fit_colors(grey[:0], grey[:0], "affine"), IDENTITY)


@pytest.mark.parametrize(("kind", "truth"), [("gain_bias", DARKER), ("affine", MIXED)])
def test_the_right_camera_is_found_by_the_depth_and_changes_evenly_in_between(kind: str, truth: Float) -> None:
    """The street's cameras are alike; frame 2 shows the whole change, frame 0 none."""
    street = Street(StreetConfig("street", frames=3, width=320, height=96))
    colors = CameraColors(kind, street.camera)
    for k, change in ((0, IDENTITY), (2, truth)):
        frame = street.frame(k)
        right = np.uint8(np.round(255 * seen(frame.right / 255, change)))
        depth = DepthMap(street.true_depth(k), "truth")
        colors.learn(Keyframe(replace(frame, right=right), depth, None, np.eye(4)))
    for number, expected in ((0, IDENTITY), (1, (IDENTITY + truth) / 2), (2, truth), (9, truth)):
        # What counts is what becomes of colours that there are.
        for color in (np.array([0.2, 0.2, 0.2, 1]), np.array([0.5, 0.5, 0.45, 1])):
            np.testing.assert_allclose(colors.of(number) @ color, expected @ color, atol=0.02)


def test_the_right_camera_needs_right_images() -> None:
    frame = replace(Street(StreetConfig("street", frames=1, width=64, height=32)).frame(0), right=None)
    keyframe = Keyframe(frame, DepthMap(np.ones((32, 64), np.float32), "ones"), None, np.eye(4))
    camera = Street(StreetConfig("street", frames=1, width=64, height=32)).camera
    CameraColors("none", camera).learn(keyframe)
    with pytest.raises(BenchError, match=r"mapper\.camera_color needs a right image, .* mapper\.camera_color=none"):
        CameraColors("affine", camera).learn(keyframe)


def pictures(change: Float) -> tuple[Tensor, Tensor, Target]:
    """A render that shows the map's colours, and the picture that a camera with this exposure makes of it."""
    random = torch.Generator().manual_seed(0)
    color = torch.rand(3, 5, 6, generator=random, dtype=torch.float64).repeat_interleave(8, 1).repeat_interleave(10, 2)
    color = 0.7 * color + 0.1
    image = torch.from_numpy(seen(color.permute(1, 2, 0).numpy(), change)).permute(2, 0, 1)
    flat, view = torch.ones(40, 60), PinholeView(np.eye(4), 50, 50, 30, 20, 60, 40)
    return color.float(), flat, Target(image.float(), flat, flat > 2, view)


def test_exposure_is_relative_to_the_first_keyframe() -> None:
    exposures = Exposures(on=True)
    for _ in range(20):
        exposures.learn(4, *pictures(MIXED))
        exposures.learn(8, *pictures(DARKER))
    assert np.array_equal(exposures.of(4), IDENTITY)
    middle = np.array([0.45, 0.45, 0.45, 1])
    np.testing.assert_allclose(exposures.of(8) @ middle, DARKER @ middle, atol=0.005)
    np.testing.assert_allclose(exposures.of(6), (IDENTITY + exposures.of(8)) / 2)
    off = Exposures(on=False)
    off.learn(4, *pictures(DARKER))
    off.learn(8, *pictures(DARKER))
    assert np.array_equal(off.of(8), IDENTITY)


def test_the_right_camera_sees_the_exposed_colours_and_state_is_kept() -> None:
    camera = Street(StreetConfig("street", frames=1, width=64, height=32)).camera
    appearance = Appearance(camera, "affine", exposure=True)
    appearance.restore({"camera": {0: torch.from_numpy(MIXED)}, "exposures": {0: torch.from_numpy(DARKER)}})
    color = np.array([0.3, 0.5, 0.2])
    exposed = DARKER[:, :3] @ color + DARKER[:, 3]
    np.testing.assert_allclose(appearance.colors(0, False) @ [*color, 1], exposed)
    np.testing.assert_allclose(appearance.colors(0, True) @ [*color, 1], MIXED[:, :3] @ exposed + MIXED[:, 3])
    image = np.random.default_rng(0).integers(60, 200, (32, 64, 3), dtype=np.uint8)
    dark = np.uint8(np.round(255 * seen(image / 255, DARKER)))
    assert np.abs(appearance.in_map(0, dark).astype(int) - image).max() <= 1
    again = Appearance(camera, "affine", exposure=True)
    again.restore(appearance.state())
    assert np.array_equal(again.colors(0, True), appearance.colors(0, True))


def test_gradients_go_back_to_the_maps_colours_but_not_from_saturated_pixels() -> None:
    camera = Street(StreetConfig("street", frames=1, width=64, height=32)).camera
    appearance = Appearance(camera, "affine", exposure=False)
    appearance.restore({"camera": {0: torch.from_numpy(MIXED)}, "exposures": {}})
    color, _, target = pictures(MIXED)
    torch.testing.assert_close(appearance.shown(color, 0, True), target.image, atol=1e-6, rtol=0)
    image = 0.5 * target.image
    image[:, :20, :] = 1.0
    limit = replace(target, image=image).limit
    color[:, :10] += 1.0
    leaf = color.requires_grad_()
    shown = appearance.shown(leaf, 0, True, limit)
    assert bool((shown[:, :10] == 1.0).all())
    ((shown - image) ** 2).sum().backward()
    by_shown = 2 * (shown - image).detach()
    torch.testing.assert_close(appearance.back(by_shown.clone(), shown, 0, True, limit), leaf.grad)
    bright = appearance.back(torch.ones_like(image), shown, 0, True, limit)
    assert bright is not None
    assert not bright[:, :10].any()
    assert bool(bright[:, 20:].all())
    assert appearance.back(None, shown, 0, True, limit) is None
    off = Appearance(camera, "none", exposure=False)
    assert off.shown(color, 0, True) is color
    assert off.back(by_shown, color, 0, True, limit) is by_shown
