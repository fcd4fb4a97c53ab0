"""How a picture's colours differ from the map's: exposure of each keyframe, and its right camera against the left one.

A colour transform is a (3, 4) float64 array ``[A | b]``: a colour c of the map is seen as ``A c + b``, RGB in [0, 1],
or white where that is more.
Cameras with automatic exposure change from frame to frame, and each by itself (KITTI 09: right to left 0.87 to 0.72
within ten frames), so every keyframe has transforms of its own.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import torch

from bench.supervision.target import SATURATED, Target
from bench.types import Float, Image, Keyframe, StereoCamera

if TYPE_CHECKING:
    from torch import Tensor

CAMERA_COLORS = ("none", "gain_bias", "affine")
IDENTITY: Float = np.eye(3, 4)
_RIDGE = np.diag([1e-4, 1e-4, 1e-4, 1e-3])
"""Pull of a fit to the identity, in units of squared colour: grey pixels say nothing of how channels mix, and where
there is little contrast a factor explains more than an offset."""
_ROUNDS = 4
_EVERY, _BLUR = 8, 9
"""Fits take pixels of every eighth row and column, after a box filter of this width: edges are a little off."""
_EXPOSURE_RATE = 0.3
_LEAST_ALPHA = 0.9


def fit_colors(before: Float, after: Float, kind: str, start: Float = IDENTITY) -> Float:
    """The transform that takes colours ``before`` (M, 3) to ``after`` (M, 3), both in [0, 1].

    ``kind``: gain_bias (a gain and a bias per channel) or affine (3x3 and bias). Robust by reweighting (Cauchy's
    weights, from ``start`` on): occlusions and moving things fall out, and so does what is saturated.
    """
    good = (before.max(1) < SATURATED) & (after.max(1) < SATURATED)
    before, after = before[good], after[good]
    if not len(before):
        return start
    X, colors = np.column_stack([before, np.ones(len(before))]), start
    for _ in range(_ROUNDS):
        error = np.abs(after - X @ colors.T).mean(1)
        weight = 1 / (1 + (error / max(1.5 * float(np.median(error)), 1 / 255)) ** 2)
        pull = _RIDGE * weight.sum()
        left = (X * weight[:, None]).T @ X + pull
        right = (X * weight[:, None]).T @ after + pull @ IDENTITY.T
        if kind == "affine":
            colors = np.linalg.solve(left, right).T
        else:
            colors = np.zeros((3, 4))
            for channel in range(3):
                of = [channel, 3]
                colors[channel, of] = np.linalg.solve(left[np.ix_(of, of)], right[of, channel])
    return colors


class ColorsOfFrames:
    """Transforms of keyframes by number; a frame that is none is taken to lie between its neighbours."""

    def __init__(self) -> None:
        self._known: dict[int, Float] = {}

    def of(self, number: int) -> Float:
        """The transform of the frame with this number; the identity where none is known."""
        if not self._known or number in self._known:
            return self._known.get(number, IDENTITY)
        numbers = np.array(sorted(self._known))
        after = int(np.searchsorted(numbers, number))
        one, other = int(numbers[max(after - 1, 0)]), int(numbers[min(after, len(numbers) - 1)])
        share = 0.0 if one == other else (number - one) / (other - one)
        return (1 - share) * self._known[one] + share * self._known[other]

    def state(self) -> dict[int, Tensor]:
        """For a checkpoint."""
        return {number: torch.from_numpy(colors) for number, colors in self._known.items()}

    def restore(self, state: dict[int, Tensor]) -> None:
        """Resume from what ``state`` gave."""
        self._known = {number: colors.numpy() for number, colors in state.items()}


class CameraColors(ColorsOfFrames):
    """From the left to the right image of keyframes, by pixels that their stereo depth says are the same."""

    def __init__(self, kind: str, camera: StereoCamera) -> None:
        super().__init__()
        self._kind, self._camera = kind, camera

    def learn(self, keyframe: Keyframe) -> None:
        """Compare a pair; ``BenchError`` for a keyframe without right image."""
        if self._kind == "none":
            return
        pair = keyframe.frame.pair("mapper.camera_color", "mapper.camera_color=none")
        left, right = (cv2.blur(image, (_BLUR, _BLUR)) for image in pair)
        x, y, z = self._camera.right_position
        v, u = np.mgrid[: left.shape[0] : _EVERY, : left.shape[1] : _EVERY].astype(np.float32)
        depth = keyframe.depth.depth[::_EVERY, ::_EVERY]
        with np.errstate(invalid="ignore", divide="ignore"):
            scale = depth / (depth - z)
            to_u = (u - self._camera.cx - self._camera.fx * x / depth) * scale + self._camera.cx
            to_v = (v - self._camera.cy - self._camera.fy * y / depth) * scale + self._camera.cy
            there = (to_u >= 0) & (to_u <= left.shape[1] - 1) & (to_v >= 0) & (to_v <= left.shape[0] - 1)
        warped = cv2.remap(right, to_u.astype(np.float32), to_v.astype(np.float32), cv2.INTER_LINEAR)
        pixels = left[::_EVERY, ::_EVERY][there] / 255.0, warped[there] / 255.0
        number = keyframe.frame.number
        self._known[number] = fit_colors(*pixels, self._kind, self.of(number))


class Exposures(ColorsOfFrames):
    """A gain and a bias per channel of each keyframe, relative to the first one, whose colours the map has.

    Each view that mapping draws moves its keyframe's exposure a part of the way to the best one. Off, none learns.
    """

    def __init__(self, on: bool) -> None:
        super().__init__()
        self._on = on

    def learn(self, number: int, color: Tensor, alpha: Tensor, target: Target, share: float = _EXPOSURE_RATE) -> None:
        """Compare a render of a keyframe, in the map's colours, with its image; go ``share`` of the way to the best."""
        if not self._on:
            return
        if not self._known:
            self._known[number] = IDENTITY
        elif number != next(iter(self._known)):
            # Every second pixel will do for the box filter.
            images = torch.cat([each[:, ::2, ::2] for each in (color, target.image, alpha[None])])
            blocks = torch.nn.functional.avg_pool2d(images[None], _BLUR // 2, _EVERY // 2)[0]
            pooled = blocks.flatten(1).double().cpu().numpy()
            pixels = pooled[:6, pooled[6] > _LEAST_ALPHA].T
            before = self.of(number)
            best = fit_colors(pixels[:, :3], pixels[:, 3:], "gain_bias", before)
            self._known[number] = before + share * (best - before)


class Appearance:
    """Both together: what the picture of a frame's left or right camera shows of the map's colours."""

    def __init__(self, camera: StereoCamera, camera_color: str, exposure: bool) -> None:
        self.camera_colors, self.exposures = CameraColors(camera_color, camera), Exposures(exposure)
        self._on = exposure or camera_color != "none"

    def colors(self, number: int, right: bool) -> Float:
        """The transform of a frame's camera."""
        exposure = self.exposures.of(number)
        if not right:
            return exposure
        camera = self.camera_colors.of(number)
        return np.column_stack([camera[:, :3] @ exposure[:, :3], camera[:, :3] @ exposure[:, 3] + camera[:, 3]])

    def shown(self, color: Tensor, number: int, right: bool, limit: Tensor | None = None) -> Tensor:
        """Rendered colours (3, H, W) as a frame's camera shows them; the same object where nothing is learned.

        With the ``limit`` of the target that they are compared with, none is brighter than a saturated pixel.
        """
        if not self._on:
            return color
        transform = torch.from_numpy(self.colors(number, right)).to(color)
        gain, bias = transform.diagonal()[:, None, None], transform[:, 3, None, None]
        if _mixes_channels(transform):
            shown = (transform[:, :3, None, None] * color[None]).sum(1).add_(bias)
        else:
            shown = torch.addcmul(bias, color, gain)
        return shown if limit is None else shown.clamp_(max=limit)

    def back(self, grad: Tensor | None, shown: Tensor, number: int, right: bool, limit: Tensor) -> Tensor | None:
        """Gradient (3, H, W) by the map's colours from that by the colours ``shown`` with this ``limit``, in place."""
        if grad is None or not self._on:
            return grad
        transform = torch.from_numpy(self.colors(number, right)).to(grad)
        grad.masked_fill_(shown == limit, 0.0)
        if _mixes_channels(transform):
            return (transform[:, :3].T[:, :, None, None] * grad[None]).sum(1)
        return grad.mul_(transform.diagonal()[:, None, None])

    def in_map(self, number: int, image: Image) -> Image:
        """A frame's left image in the map's colours, for new Gaussians."""
        if not self._on:
            return image
        colors = self.exposures.of(number)
        there = (image / 255.0 - colors[:, 3]) @ np.linalg.inv(colors[:, :3]).T
        return np.clip(np.round(there * 255), 0, 255).astype(np.uint8)

    def state(self) -> dict[str, Any]:
        """For a checkpoint."""
        return {"camera": self.camera_colors.state(), "exposures": self.exposures.state()}

    def restore(self, state: dict[str, Any]) -> None:
        """Resume from what ``state`` gave."""
        self.camera_colors.restore(state["camera"])
        self.exposures.restore(state["exposures"])


def _mixes_channels(transform: Tensor) -> bool:
    return not torch.equal(transform[:, :3], torch.diag(transform.diagonal()))
