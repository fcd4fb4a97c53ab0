"""Whether left and right images are a rectified stereo pair of one moment: looked at in a few frames of a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from bench.contracts.dataset import Dataset
from bench.io.images import grey
from bench.io.torch_files import from_state, to_state
from bench.tracking.features import Features, OrbExtractor
from bench.tracking.relocalise import match_descriptors
from bench.types import Float, StereoCamera, StereoFrame

# Every threshold lies between what KITTI 03, 06 (grey and colour), 09 and 2015 and the street have, and what the same
# pairs have when they are spoilt; the two numbers are given.
_FIRST, _LATER, _EVERY = 3, 2, 100
"""The first frames are looked at, and two successive ones of every hundred: about 1 ms a frame."""
_GIVE_UP = 30
"""The first frames may be black or blurred: then so many are looked at."""
_FEATURES = 1000
_RATIO = 0.8
_LEAST_MATCHES = 40
_LEAST_FEATURES = 200
"""Of an image that shows something."""
_FEW = 0.05
"""Share of the features that find a partner: 0.26 and more, and 0.02 in images of different places."""
_SAME_PX = 1.0
"""Nine of ten disparities of an image with itself are below this, also blurred or as JPEG (0.5); 15 pixels on pairs."""
_AGREE_PX, _AGREE = 3.0, 0.3
"""Matches whose rows differ by no more than this from the fit: 0.95 and more, and 0.03 with different places."""
_EXCHANGED = 0.7
"""Of these matches a share of 0.002 at most has a negative disparity, and 0.99 where the sides are exchanged."""
_LEAST_FLOW_PX, _LEAST_FLOWS, _LONGEST_FLOW_PX = 0.3, 150, 60.0
"""Motion that tells one moment from another, apart from what a turned camera would see; 0.6 and more on KITTI."""
_MOMENT = 0.1
"""Share of the motion between frames that the rows are off: 0.02, and 0.22 for a quarter of a frame."""
_ROWS_PX = 1.5
"""Nine of ten rows are off by less: 0.8 on KITTI's grey pair, 3 at a roll of 0.3 degrees."""
_IRREGULAR_PX = 0.7
"""Median of what no fit explains: 0.25, 0.35 on unrectified pairs, 1.2 and more where the moments are frames apart."""
_LONGEST_BASELINE_M, _SHORTEST_BASELINE_M = 5.0, 1e-3
"""No car is wider, and no endoscope narrower."""


@dataclass(frozen=True)
class PairMatches:
    """Descriptor matches of left and right images, without any constraint on where they lie.

    ``x`` and ``y`` (M,) are their places in the right image, in focal lengths from the principal point; ``disparity``
    (M,) and ``rows`` (M,), by which the right image shows them lower, in pixels; ``flow`` (M,) the rows that the left
    image moved them down since the frame before, NaN where unknown. ``features`` is how many there were to match.
    """

    x: Float
    y: Float
    disparity: Float
    rows: Float
    flow: Float
    features: int

    def __len__(self) -> int:
        return len(self.x)

    @classmethod
    def of(cls, left: Features, right: Features, before: Features | None, camera: StereoCamera) -> PairMatches:
        """The matches of one frame; ``before`` are the features of the left image of the frame before it."""
        a, b = match_descriptors(left.descriptors, right.descriptors, _RATIO)
        flow = np.full(len(left), np.nan)
        if before is not None:
            now, then = match_descriptors(left.descriptors, before.descriptors, _RATIO)
            moved = left.xy[now, 1] - before.xy[then, 1]
            flow[now] = np.where(np.abs(moved) < _LONGEST_FLOW_PX, moved, np.nan)
        across, down = (right.xy[b] - left.xy[a]).T
        x, y = ((right.xy[b] - (camera.cx, camera.cy)) / (camera.fx, camera.fy)).T
        return cls(x, y, -across, down, flow[a], min(len(left), len(right)))

    @classmethod
    def together(cls, parts: Sequence[PairMatches]) -> PairMatches:
        """The matches of several frames."""
        columns = [field.name for field in fields(cls) if field.name != "features"]
        joined = {name: np.concatenate([getattr(part, name) for part in parts]) for name in columns}
        return cls(**joined, features=sum(part.features for part in parts))

    def design(self, focal: float) -> Float:
        """(M, 5): the rows by which the right image is off when it is shifted, rolled by a radian, twice as large,
        turned about the vertical axis by a radian, or has the radial distortion 1, each for a small one."""
        x, y = focal * self.x, focal * self.y
        return np.column_stack([np.ones(len(self)), x, y, x * self.y, y * (self.x**2 + self.y**2)])


def fault_of_pair(matches: PairMatches, camera: StereoCamera) -> str | None:
    """One sentence on what is wrong with a pair, or None where nothing is, or too little can be seen."""
    if matches.features < _LEAST_FEATURES:
        return None
    if len(matches) < max(_LEAST_MATCHES, _FEW * matches.features):
        share = len(matches) / matches.features
        return _different(f"{share:.0%} of the corners match") if share < _FEW else None
    if max(np.percentile(np.abs(each), 90) for each in (matches.disparity, matches.rows)) < _SAME_PX:
        return (
            f"left and right images show the same: {len(matches)} matched corners have no disparity. Does the right "
            "camera's folder hold the left one's images?"
        )
    design = matches.design(camera.fy)
    fit = _robust_fit(design, matches.rows)
    left_over = np.abs(matches.rows - design @ fit)
    agree = left_over < _AGREE_PX
    if agree.mean() < _AGREE:
        return _different(f"only {agree.mean():.0%} of {len(matches)} matched corners agree on how the images lie")
    # Where the moments differ the other fits mean nothing, so that is asked first.
    return (
        _another_moment(matches, design)
        or _irregular(float(np.median(left_over)), len(matches))
        or _exchanged(matches.disparity[agree])
        or _unrectified(design, fit, len(matches))
    )


def _different(why: str) -> str:
    return (
        f"left and right images seem to show different places: {why}. Check that the images of a pair belong together "
        "and that none is mirrored or upside down."
    )


def _another_moment(matches: PairMatches, design: Float) -> str | None:
    """Rows that are off by a share of the motion between two frames: near things more than far ones."""
    known = np.isfinite(matches.flow)
    if known.sum() < _LEAST_FLOWS:
        return None
    flow, design = matches.flow[known], design[known]
    own = np.median(np.abs(flow - design @ _robust_fit(design, flow)))
    late = float(_robust_fit(np.column_stack([design, flow]), matches.rows[known])[-1])
    if own < _LEAST_FLOW_PX or abs(late) < _MOMENT:
        return None
    return (
        f"the right images seem to be taken about {abs(late):.1f} frames {'later' if late > 0 else 'earlier'} than the "
        f"left ones: the rows of {len(flow)} matched corners are off by that share of the motion between frames. Check "
        "that the images of a pair are of the same moment."
    )


def _exchanged(disparity: Float) -> str | None:
    negative = float((disparity < -0.5).mean())
    if negative < _EXCHANGED:
        return None
    return (
        f"left and right images seem to be swapped: {negative:.0%} of {len(disparity)} matched corners have a negative "
        "disparity. Swap the two cameras in the data set."
    )


def _unrectified(design: Float, fit: Float, count: int) -> str | None:
    """Rows that are out of line in the way of a turned, shifted or differently distorted camera; the largest part is
    named."""
    if np.percentile(np.abs(design @ fit), 90) < _ROWS_PX:
        return None
    shift, roll, larger, turn, radial = fit
    kinds = (
        f"the right image's rows lie {abs(shift):.1f} pixels {'lower' if shift > 0 else 'higher'} than the left's",
        f"the right image is rolled by {abs(np.degrees(roll)):.1f} degrees",
        f"the right image is {abs(larger):.1%} {'larger' if larger > 0 else 'smaller'} than the left one",
        f"the right camera is turned by {abs(np.degrees(turn)):.1f} degrees about its vertical axis",
        f"the right image has another radial distortion than the left one (by {radial:+.2g})",
    )
    largest = int(np.argmax(np.percentile(np.abs(design * fit), 90, axis=0)))
    return (
        f"{kinds[largest]} ({count} matched corners, rows off by up to {np.percentile(np.abs(design @ fit), 95):.1f} "
        "pixels); the pair is not rectified. Check the rectification, and that both images belong to the same camera "
        "pair and moment."
    )


def _irregular(left_over: float, count: int) -> str | None:
    if left_over < _IRREGULAR_PX:
        return None
    return (
        f"the rows of left and right images differ without a rule, by {left_over:.1f} pixels in the median of {count} "
        "matched corners. Check that the images of a pair are of the same moment, and the rectification."
    )


def _robust_fit(design: Float, values: Float) -> Float:
    """Coefficients (K,) that explain most of the values (M,), of which a third may be wrong: least absolute distances
    first, then a redescending weight that forgets what is far off."""
    weight: Float = np.ones(len(values))
    fit: Float = np.zeros(design.shape[1])
    for step in range(30):
        root = np.sqrt(weight)
        fit = np.asarray(np.linalg.lstsq(design * root[:, None], values * root, rcond=None)[0], dtype=np.float64)
        left_over = np.abs(values - design @ fit)
        if step < 20:
            weight = 1.0 / np.maximum(left_over, 0.3)
        else:
            weight = 1.0 / (1.0 + (left_over / max(2.2 * float(np.median(left_over)), 0.5)) ** 2) ** 2
    return fit


class PairCheck:
    """Looks at frames of a run, the first ones and now and then a later one, and tells of a fault once."""

    def __init__(self, dataset: Dataset) -> None:
        self._dataset = dataset
        self._extractor = OrbExtractor(_FEATURES)
        self._parts: list[PairMatches] = []
        self._before: tuple[int, Features] | None = None
        self._wanted = _FIRST
        self._told = False

    def about_camera(self) -> str | None:
        """What is odd about the pair's calibration, or None."""
        baseline = self._dataset.camera.baseline
        if not self._dataset.has_right or _SHORTEST_BASELINE_M <= abs(baseline) <= _LONGEST_BASELINE_M:
            return None
        return (
            f"the baseline is {baseline:g} metres, which no camera pair has: all depths and the trajectory have its "
            "unit. Give it in metres, or multiply the calibration's by its unit."
        )

    def look(self, position: int, frame: StereoFrame) -> str | None:
        """What is wrong with the pairs seen lately, once enough of them were seen; else None."""
        beginning = self._wanted == _FIRST and position < _GIVE_UP
        later = position >= _EVERY and position % _EVERY < _LATER
        if frame.right is None or self._told or not (beginning or later):
            return None
        left, right = (self._extractor.extract(grey(image))[0] for image in (frame.left, frame.right))
        camera, before = self._dataset.camera_of(position), self._before
        self._before = (position, left)
        follows = before is not None and self._dataset.is_sequence and before[0] == position - 1
        self._parts.append(PairMatches.of(left, right, before[1] if follows and before else None, camera))
        seen = PairMatches.together(self._parts)
        last = position + 1 in (_GIVE_UP, len(self._dataset))
        if not last and (len(self._parts) < self._wanted or (beginning and seen.features < _LEAST_FEATURES)):
            return None
        self._parts, self._wanted = [], _LATER
        fault = fault_of_pair(seen, camera)
        self._told = fault is not None
        return fault

    def state(self) -> dict[str, Any]:
        """What looking goes on from, for a checkpoint."""
        return {
            "parts": [to_state(vars(part)) for part in self._parts],
            "before": None if self._before is None else (self._before[0], to_state(vars(self._before[1]))),
            "wanted": self._wanted,
            "told": self._told,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from ``state``."""
        self._parts = [PairMatches(**from_state(part)) for part in state["parts"]]
        before = state["before"]
        self._before = None if before is None else (before[0], Features(**from_state(before[1])))
        self._wanted, self._told = state["wanted"], state["told"]
