"""Where keyframes show things that move: what other keyframes, which look at the same place, do not see there."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from bench.types import Keyframe, Map, Mask, PinholeView, StereoCamera

# Compared are images of half size, after a blur that forgives what poses and depth are off by.
_BLUR_PX = 1.5
# Keyframes before and after one that have a say in its mask.
_NEIGHBOURS = 4
# A place is hidden from another view where that sees something nearer by more pixels of disparity.
_NEARER_PX = 1.0
# The colour is another one where a channel differs by more, of 0 to 1.
_COLOR_STEP = 0.12
# So many keyframes must contradict, and more than agree.
_LEAST_VOTES = 2
# Sides of what is too small to count, of gaps that are closed, and of the rim added, and of a square as large as the
# smallest part, as shares of the width.
_OPEN, _CLOSE, _RIM, _LEAST = 0.0114, 0.0147, 0.0082, 0.023


@dataclass(eq=False)
class _Seen:
    """One keyframe at half size: blurred image (h, w, 3) of 0 to 1, inverse depth (h, w) with 0 where unknown, its
    view; and how many others agree with and contradict each pixel."""

    number: int
    image: npt.NDArray[np.float32]
    inverse: Map
    view: PinholeView
    agree: npt.NDArray[np.int8]
    contradict: npt.NDArray[np.int8]


class MovingThings:
    """The masks of a run's keyframes, as they come in order; they follow from keyframes and the poses these came with,
    so that a resumed run makes the same ones."""

    def __init__(self, camera: StereoCamera) -> None:
        self._camera = camera
        self._recent: list[_Seen] = []
        self._packed: dict[int, npt.NDArray[np.uint8]] = {}

    def add(self, keyframe: Keyframe) -> list[int]:
        """Compare a new keyframe with those before it; the numbers of all whose mask may be another one now."""
        new = self._seen(keyframe)
        for old in self._recent:
            for one, other in ((old, new), (new, old)):
                agrees, contradicts = self._compare(one, other)
                one.agree += agrees
                one.contradict += contradicts
        self._recent = [*self._recent, new][-_NEIGHBOURS - 1 :]
        for seen in self._recent:
            mask = _clean((seen.contradict >= _LEAST_VOTES) & (seen.contradict > seen.agree))
            self._packed[seen.number] = np.packbits(mask)
        self._recent = self._recent[-_NEIGHBOURS:]
        return [seen.number for seen in self._recent]

    @property
    def numbers(self) -> list[int]:
        """The keyframes that were added."""
        return list(self._packed)

    def mask(self, number: int) -> Mask:
        """Boolean (H, W) of a keyframe that was added, True where something moves."""
        height, width = self._camera.height // 2, self._camera.width // 2
        small = np.unpackbits(self._packed[number], count=height * width).reshape(height, width)
        size = (self._camera.width, self._camera.height)
        return np.asarray(cv2.resize(small, size, interpolation=cv2.INTER_NEAREST) > 0)

    def _seen(self, keyframe: Keyframe) -> _Seen:
        view = PinholeView.of(self._camera, keyframe.T_world_cam).halved()
        size = (view.width, view.height)
        small = cv2.resize(keyframe.frame.left, size, interpolation=cv2.INTER_AREA).astype(np.float32) / 255
        depth = keyframe.depth.depth[: 2 * view.height : 2, : 2 * view.width : 2]
        known = np.isfinite(depth)
        if keyframe.sky is not None:
            known &= ~keyframe.sky[: 2 * view.height : 2, : 2 * view.width : 2]
        inverse = np.where(known, 1 / np.where(known, depth, 1), 0).astype(np.float32)
        none = np.zeros(inverse.shape, np.int8)
        image = np.asarray(cv2.GaussianBlur(small, (0, 0), _BLUR_PX), np.float32)
        return _Seen(keyframe.frame.number, image, inverse, view, none, none.copy())

    def _compare(self, one: _Seen, other: _Seen) -> tuple[Mask, Mask]:
        """Which pixels of ``one`` ``other`` sees with their colour, and which it should see and does not."""
        view = one.view
        known = one.inverse > 0
        z = 1 / np.where(known, one.inverse, 1)
        x = (np.arange(view.width, dtype=np.float32) - view.cx) / view.fx * z
        y = (np.arange(view.height, dtype=np.float32) - view.cy)[:, None] / view.fy * z
        T = (other.view.T_cam_world @ view.T_world_cam).astype(np.float32)
        there = [T[k, 0] * x + T[k, 1] * y + T[k, 2] * z + T[k, 3] for k in range(3)]
        known &= there[2] > 0.1
        depth = np.where(known, there[2], 1)
        column = np.where(known, there[0] / depth * view.fx + view.cx, -9).astype(np.float32)
        row = np.where(known, there[1] / depth * view.fy + view.cy, -9).astype(np.float32)
        seen = cv2.remap(other.inverse, column, row, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
        nearer_px = (seen - 1 / depth) * (view.fx * self._camera.baseline)
        visible = known & (seen > 0) & (nearer_px < _NEARER_PX)
        color = cv2.remap(other.image, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        # Cameras with automatic exposure: what most places changed by is no contradiction, and white says nothing.
        same_place = visible & (nearer_px > -_NEARER_PX)
        if not same_place.any():
            return same_place, same_place
        gain = np.median(color[same_place], axis=0) / np.maximum(np.median(one.image[same_place], axis=0), 1e-3)
        expected = np.minimum(one.image * gain.astype(np.float32), 1)
        differs = np.abs(color - expected).max(2) > _COLOR_STEP
        # What sees another colour at another depth contradicts; the same colour there says nothing.
        return same_place & ~differs, visible & differs


def _clean(raw: Mask) -> Mask:
    """Without specks, with gaps closed and a rim."""
    width = raw.shape[1]

    def square(share: float) -> npt.NDArray[np.uint8]:
        side = max(round(share * width), 5)  # depth edges are off by pixels, however small the image is
        return np.ones((side, side), np.uint8)

    mask = cv2.morphologyEx(raw.astype(np.uint8), cv2.MORPH_OPEN, square(_OPEN))
    mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, square(_CLOSE))
    _, parts, statistics, _ = cv2.connectedComponentsWithStats(mask)
    large = statistics[:, cv2.CC_STAT_AREA] >= max(_LEAST * width, 9) ** 2
    large[0] = False
    return cv2.dilate(large[parts].astype(np.uint8), square(_RIM)) > 0
