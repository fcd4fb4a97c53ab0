"""A card that slides past a wall is masked, a card that hangs there is not, whatever the exposure."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from bench.io.array_store import ArrayStore
from bench.supervision.moving import MovingThings
from bench.types import DepthMap, Image, Keyframe, Map, Mask, StereoCamera, StereoFrame
from plugins.losses.geo import GeoConfig, GeoLoss
from plugins.losses.rgb import RgbConfig, RgbLoss
from plugins.losses.ssim import SsimConfig, SsimLoss
from plugins.mappers.gaussian import GaussianMapper, GaussianMapperConfig

CAMERA = StereoCamera(240, 160, 150.0, 150.0, 119.5, 79.5, (0.5, 0.0, 0.0))
CARD_M, WALL_M = 8.0, 20.0
RNG = np.random.default_rng(0)


def texture(low: int, high: int) -> Image:
    """Soft spots of brightness ``low`` to ``high``, 512x512."""
    return cv2.resize(RNG.integers(low, high, (64, 64, 3), dtype=np.uint8), (512, 512), interpolation=cv2.INTER_CUBIC)


WALL, CARD = texture(20, 140), texture(160, 250)


def shot(number: int, card_x: float) -> tuple[Keyframe, Mask]:
    """A camera that goes forward 0.3 m per frame, and where it sees the card, 2 m wide and high, 12 m before the wall;
    the card's middle is at ``card_x``."""
    T_world_cam = np.eye(4)
    T_world_cam[2, 3] = 0.3 * number
    u, v = np.meshgrid(np.arange(240.0), np.arange(160.0))

    def at(distance: float) -> tuple[Map, Map]:
        z = distance - T_world_cam[2, 3]
        return ((u - 119.5) / 150 * z).astype(np.float32), ((v - 79.5) / 150 * z).astype(np.float32)

    def painted(image: Image, x: Map, y: Map) -> Image:
        return cv2.remap(image, 256 + 12 * x, 256 + 12 * y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)

    x, y = at(CARD_M)
    on_card = (np.abs(x - card_x) < 1) & (np.abs(y) < 1)
    left = np.where(on_card[..., None], painted(CARD, x - card_x, y), painted(WALL, *at(WALL_M)))
    depth = np.where(on_card, CARD_M, WALL_M) - T_world_cam[2, 3]
    frame = StereoFrame(number, 0.1 * number, left)
    return Keyframe(frame, DepthMap(depth.astype(np.float32), "by hand"), None, T_world_cam), on_card


def masks(shots: list[tuple[Keyframe, Mask]]) -> list[Mask]:
    moving = MovingThings(CAMERA)
    for keyframe, _ in shots:
        moving.add(keyframe)
    return [moving.mask(number) for number in moving.numbers]


SLIDING = [shot(k, 0.8 * k - 1.6) for k in range(5)]


def test_what_slides_is_masked_and_little_else() -> None:
    for found, (_, truth) in list(zip(masks(SLIDING), SLIDING, strict=True))[1:4]:
        assert (found & truth).sum() > 0.9 * truth.sum()
        assert not (found & ~(cv2.dilate(truth.astype(np.uint8), np.ones((21, 21))) > 0)).any()


@pytest.mark.parametrize("gains", [(1, 1, 1, 1, 1), (0.5, 0.6, 0.7, 0.9, 1.1)])
def test_nothing_moves_in_a_standing_scene(gains: tuple[float, ...]) -> None:
    shots = [shot(k, 0.3) for k in range(5)]
    for (keyframe, _), gain in zip(shots, gains, strict=True):
        keyframe.frame.left[:] = np.clip(keyframe.frame.left * gain, 0, 255)
    assert not np.any(masks(shots))


def mapper_of(keyframes: list[Keyframe], store: Path) -> GaussianMapper:
    mapper = GaussianMapper(GaussianMapperConfig("gaussian", moving=True, iterations=2, final_iterations=1))
    losses = [RgbLoss(RgbConfig("rgb")), SsimLoss(SsimConfig("ssim")), GeoLoss(GeoConfig("geo"))]
    mapper.start(CAMERA, losses, 0)
    mapper.use_store(ArrayStore(store))
    for k, keyframe in enumerate(keyframes):
        mapper.add_keyframe(keyframe, list(range(k + 1)))
    return mapper


def test_the_mapper_neither_seeds_nor_learns_there_and_resumes_to_the_bit(tmp_path: Path) -> None:
    keyframes = [keyframe for keyframe, _ in SLIDING]
    whole, first = mapper_of(keyframes, tmp_path / "whole"), mapper_of(keyframes[:4], tmp_path / "broken")
    again = mapper_of([], tmp_path / "broken")
    again.restore(first.state(), keyframes[:4])
    again.add_keyframe(keyframes[4], list(range(5)))
    assert torch.equal(again._map.live.planes, whole._map.live.planes)

    pictures = list(again.pictures())
    assert [(what, number) for what, number, _ in pictures] == [("moving", k) for k in range(5)]
    mask = pictures[2][2]
    assert mask.any()
    target = again._replay.target(2, half=False)
    assert not bool(target.depth_mask[torch.from_numpy(mask)].any())
    rendered = again._rasterizer.render(again._map.live.planes, target.view)
    for gradient in again._losses.evaluate(rendered, target)[1][:2]:
        assert gradient is not None
        at = gradient.reshape(-1, *mask.shape).abs().sum(0).numpy()
        assert not at[mask].any()
        assert (at[~mask] > 0).mean() > 0.1
