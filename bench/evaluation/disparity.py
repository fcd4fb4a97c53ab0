"""Stereo scored as stereo: EPE, D1 and bad-n of a disparity map, with and without its holes."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from bench.errors import BenchError
from bench.types import Map, Mask, StereoCamera

BAD_LIMITS_PX = (1.0, 2.0, 3.0)
# KITTI 2015 counts a pixel as wrong when its error is above both (evaluate_scene_flow.cpp, ABS_THRESH, REL_THRESH).
D1_LIMIT_PX = 3.0
D1_LIMIT_SHARE = 0.05
# A return is hidden from the camera where another one, this share nearer, lies within so many pixels.
_HIDDEN_RADIUS = 3
_HIDDEN_SHARE = 0.1


@dataclass(frozen=True)
class DisparityErrors:
    """Sums over pixels, so that images are pooled by adding: count, absolute errors in px, pixels above each limit."""

    pixels: int = 0
    absolute_px: float = 0.0
    bad: tuple[int, ...] = (0,) * len(BAD_LIMITS_PX)
    d1: int = 0

    def __add__(self, other: DisparityErrors) -> DisparityErrors:
        bad = tuple(a + b for a, b in zip(self.bad, other.bad, strict=True))
        return DisparityErrors(
            self.pixels + other.pixels, self.absolute_px + other.absolute_px, bad, self.d1 + other.d1
        )

    @property
    def epe_px(self) -> float | None:
        """End-point error: mean absolute error in px; None without pixels."""
        return self.absolute_px / self.pixels if self.pixels else None

    @property
    def bad_percent(self) -> tuple[float | None, ...]:
        """Share of pixels whose error is above 1, 2 and 3 px, in percent."""
        return tuple(_percent(count, self.pixels) for count in self.bad)

    @property
    def d1_percent(self) -> float | None:
        """KITTI 2015's share of outliers in percent."""
        return _percent(self.d1, self.pixels)


@dataclass(frozen=True)
class DisparityScore:
    """What one image, or several added up, scored.

    ``filled``: over the pixels with truth and an estimate. ``interpolated``: over all pixels with truth, after
    ``background_interpolated`` filled the holes, as KITTI does for its number "all". ``holes``: pixels of the whole
    image, with truth or without, that have no estimate.
    """

    filled: DisparityErrors = DisparityErrors()
    interpolated: DisparityErrors = DisparityErrors()
    holes: int = 0
    image_pixels: int = 0

    def __add__(self, other: DisparityScore) -> DisparityScore:
        return DisparityScore(
            self.filled + other.filled,
            self.interpolated + other.interpolated,
            self.holes + other.holes,
            self.image_pixels + other.image_pixels,
        )

    @property
    def density_percent(self) -> float | None:
        """Share of the pixels with truth that have an estimate, in percent."""
        return _percent(self.filled.pixels, self.interpolated.pixels)

    @property
    def holes_percent(self) -> float | None:
        """Share of the image without an estimate, in percent."""
        return _percent(self.holes, self.image_pixels)


def score_disparity(estimate: Map, truth: Map) -> DisparityScore:
    """Score one map; both are (H, W) float32 in px, NaN = unknown. Raises ``BenchError`` when the sizes differ.

    >>> truth = np.array([[10.0, 10.0, 10.0, np.nan]], np.float32)
    >>> score = score_disparity(np.array([[10.5, 15.5, np.nan, 7.0]], np.float32), truth)
    >>> score.filled.epe_px, score.filled.d1_percent, score.holes
    (3.0, 50.0, 1)
    """
    if estimate.shape != truth.shape:
        raise BenchError(
            f"The disparity is {estimate.shape[1]}x{estimate.shape[0]} and its truth {truth.shape[1]}x"
            f"{truth.shape[0]}; they must be of the same size. Check the plugin with `bgs-bench check-plugin`."
        )
    known = np.isfinite(estimate)
    return DisparityScore(
        filled=_errors(estimate, truth, known & np.isfinite(truth)),
        interpolated=_errors(background_interpolated(estimate), truth, np.isfinite(truth)),
        holes=int(known.size - np.count_nonzero(known)),
        image_pixels=known.size,
    )


def _errors(estimate: Map, truth: Map, counts: Mask) -> DisparityErrors:
    true = truth[counts].astype(np.float64)
    # An image without any estimate can't be interpolated: it is wrong everywhere, by its full disparity.
    error = np.abs(np.nan_to_num(estimate[counts].astype(np.float64)) - true)
    bad = tuple(int(np.count_nonzero(error > limit)) for limit in BAD_LIMITS_PX)
    d1 = int(np.count_nonzero((error > D1_LIMIT_PX) & (error > D1_LIMIT_SHARE * true)))
    return DisparityErrors(len(true), float(error.sum()), bad, d1)


def background_interpolated(disparity: Map) -> Map:
    """The map (H, W) in px with its holes (NaN) filled as KITTI's benchmark fills them: from the background.

    A hole between two known pixels of its row gets the smaller of their disparities, one at the row's end the nearest
    known one. Rows without any are then filled the same way, column by column. A map without any stays as it is.
    """
    return _filled_along_rows(_filled_along_rows(disparity).T).T


def _filled_along_rows(disparity: Map) -> Map:
    width = disparity.shape[1]
    column = np.arange(width)
    known = np.isfinite(disparity)
    # Column of the nearest known pixel to the left and to the right; -1 and `width` point to a column of infinities.
    before = np.maximum.accumulate(np.where(known, column, -1), axis=1)
    after = np.minimum.accumulate(np.where(known, column, width)[:, ::-1], axis=1)[:, ::-1]
    padded = np.pad(np.where(known, disparity, np.inf), ((0, 0), (0, 1)), constant_values=np.inf).astype(np.float32)
    smaller = np.minimum(np.take_along_axis(padded, before, axis=1), np.take_along_axis(padded, after, axis=1))
    return np.where(np.isinf(smaller), np.float32(np.nan), smaller)


def disparity_of_depth(depth: Map, camera: StereoCamera) -> Map:
    """Disparity f b / z in px of a depth map (H, W) in metres; NaN stays NaN."""
    return (np.float32(camera.fx * camera.baseline) / depth).astype(np.float32)


def visible_returns(lidar: Map) -> Map:
    """Projected LiDAR (H, W) in metres without the returns that the camera can't see, NaN where there is none.

    The scanner sits above the camera and looks over things: what it sees behind them falls into the same place of the
    image. A return is dropped where one that is at least 10 % nearer lies within 3 pixels.
    """
    size = 2 * _HIDDEN_RADIUS + 1
    far = np.where(np.isfinite(lidar), lidar, np.float32(np.finfo(np.float32).max))
    nearest = cv2.erode(far, np.ones((size, size), np.uint8))
    return np.where(nearest < (1 - _HIDDEN_SHARE) * lidar, np.float32(np.nan), lidar)


def _percent(part: int, whole: int) -> float | None:
    return 100.0 * part / whole if whole else None
