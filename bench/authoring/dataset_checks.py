"""The contract of a data set: its frames, calibration, poses and depth, and what the images themselves say of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import cv2
import numpy as np

from bench.authoring import probes
from bench.authoring.poses import require_trajectory
from bench.authoring.verdict import Candidate, Check, ContractBrokenError, Note
from bench.io.images import grey
from bench.types import Image, StereoCamera, StereoFrame, Trajectory

_LEAST_MATCHES = 30
_WORST_ROW_OFFSET_PX = 1.0


@dataclass
class Subject:
    """The data set under test."""

    candidate: Candidate

    @cached_property
    def dataset(self) -> Any:
        return self.candidate.build()

    @property
    def sampled(self) -> list[int]:
        """A few positions over the whole sequence, the first and the last among them."""
        return sorted(set(np.linspace(0, len(self.dataset) - 1, 4).astype(int).tolist()))


def _describes(subject: Subject) -> str:
    dataset = subject.dataset
    for name, kind in (("label", str), ("camera", StereoCamera), ("numbers", tuple)):
        if not isinstance(getattr(dataset, name, None), kind):
            got = type(getattr(dataset, name, None)).__name__
            mend = f"set self.{name} in the constructor"
            raise ContractBrokenError(f"{name} is {got}", f"{name}: {kind.__name__}", mend, "__init__")
    numbers = dataset.numbers
    if not numbers or any(b <= a for a, b in pairwise(numbers)):
        raise ContractBrokenError(
            f"numbers are {list(numbers[:8])}", "at least one, strictly increasing", "sort them", "__init__"
        )
    if len(dataset) != len(numbers):
        raise ContractBrokenError(f"len() is {len(dataset)}", f"{len(numbers)}, as in numbers", "leave __len__ out")
    return f"{dataset.label}: {len(numbers)} frames, numbers {numbers[0]} to {numbers[-1]}"


def _camera(subject: Subject) -> str | Note:
    camera = subject.dataset.camera
    if min(camera.fx, camera.fy) <= 0 or (subject.dataset.has_right and camera.baseline <= 0):
        raise ContractBrokenError(
            f"fx {camera.fx:.4g}, fy {camera.fy:.4g}, baseline {camera.baseline:.4g}",
            "all positive; the right camera stands at positive x of the left one",
            "KITTI's P3[0, 3] is -fx * baseline",
            "__init__",
        )
    if not (0 < camera.cx < camera.width and 0 < camera.cy < camera.height):
        raise ContractBrokenError(
            f"principal point ({camera.cx:.4g}, {camera.cy:.4g}) is outside of {camera.width}x{camera.height}",
            "inside the image",
            "are width and height, or cx and cy, exchanged? images resized without the calibration?",
            "__init__",
        )
    text = f"{camera.width}x{camera.height}, fx {camera.fx:.4g} px, baseline {camera.baseline:.4g} m"
    return (
        text
        if 0.01 < camera.baseline < 3 or not subject.dataset.has_right
        else Note(f"{text}: is the baseline in metres?")
    )


def _frames(subject: Subject) -> str:
    dataset = subject.dataset
    for position in subject.sampled:
        frame, camera = dataset.frame(position), dataset.camera_of(position)
        if not isinstance(frame, StereoFrame) or frame.number != dataset.numbers[position]:
            got = f"number {frame.number}" if isinstance(frame, StereoFrame) else type(frame).__name__
            raise ContractBrokenError(
                f"frame({position}) is {got}",
                f"StereoFrame with number {dataset.numbers[position]}",
                "StereoFrame(self.numbers[position], timestamp, left, right)",
                "frame",
            )
        for side, image in [("left", frame.left)] + [("right", frame.right)] * dataset.has_right:
            expected = (camera.height, camera.width, 3)
            if not isinstance(image, np.ndarray) or image.shape != expected or image.dtype != np.uint8:
                got = f"{image.dtype} {image.shape}" if isinstance(image, np.ndarray) else type(image).__name__
                raise ContractBrokenError(
                    f"the {side} image of frame({position}) is {got}",
                    f"uint8 {expected}: RGB, of the camera's size",
                    "OpenCV reads BGR and, of grey files, 2 dimensions: cv2.cvtColor(image, cv2.COLOR_BGR2RGB); "
                    "a data set without right images says has_right = False in its class",
                    "frame",
                )
    return f"RGB uint8, of the camera's size, at positions {', '.join(map(str, subject.sampled))}"


def _images(frame: StereoFrame) -> dict[str, Image]:
    return {"left": frame.left} | ({} if frame.right is None else {"right": frame.right})


def _timestamps(subject: Subject) -> str | Note:
    if not subject.dataset.is_sequence:
        return Note("single pairs, no sequence")
    times = [subject.dataset.frame(position).timestamp for position in subject.sampled]
    if not np.isfinite(times).all() or (np.diff(times) <= 0).any():
        raise ContractBrokenError(
            f"timestamps {times}", "finite, strictly increasing, in seconds", "nanoseconds / 1e9?", "frame"
        )
    if len(times) < 2:
        return Note("one frame only")
    step = (times[-1] - times[0]) / (subject.sampled[-1] - subject.sampled[0])
    text = f"{1 / step:.3g} frames per second"
    return text if 1e-4 < step < 60 else Note(f"{text}: are timestamps in seconds?")


def _repeats(subject: Subject) -> str:
    dataset = subject.dataset
    first = dataset.frame(0)
    before = {side: image.copy() for side, image in _images(first).items()}
    dataset.frame(len(dataset) - 1)
    for side, kept in _images(first).items():
        probes.require_same(before[side], kept, f"the {side} image before and after the next frame()", "frame")
    for side, after in _images(probes.in_thread(lambda: dataset.frame(0))).items():
        what = f"frame(0) a second time, in a background thread: its {side} image"
        probes.require_same(before[side], after, what, "frame")
    return "frame(0) twice, the second time in a background thread: the same bits"


def _rectified(subject: Subject) -> str | Note:
    """Matched corners lie in the same row of both images, further left in the right one."""
    if not subject.dataset.has_right:
        return Note("no right images (has_right is False)")
    offsets = np.concatenate([_offsets(subject.dataset.frame(position)) for position in subject.sampled])
    if len(offsets) < _LEAST_MATCHES:
        return Note(f"only {len(offsets)} corners could be matched: too few to say")
    across, down = np.median(offsets, axis=0)
    if np.median(np.abs(offsets[:, 1])) > _WORST_ROW_OFFSET_PX:
        raise ContractBrokenError(
            f"{len(offsets)} corners: the right image is off by {down:+.1f} rows (median)",
            "a point lies in the same row of both images",
            "rectify the pair (cv2.stereoRectify, cv2.remap), or use the data set's rectified images",
            "frame",
        )
    if across < 0:
        raise ContractBrokenError(
            f"{len(offsets)} corners: disparity is {across:.1f} px (median)",
            "positive: what the left image shows at x, the right one shows further left",
            "exchange left and right",
            "frame",
        )
    return f"{len(offsets)} corners: median row offset {down:+.2f} px, disparity {across:.1f} px"


def _offsets(frame: StereoFrame) -> np.ndarray:
    """Left minus right position (N, 2) in px of matched ORB corners of one pair."""
    orb, matcher = cv2.ORB.create(800), cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True)
    (left, a), (right, b) = (orb.detectAndCompute(grey(image), None) for image in _images(frame).values())
    if a is None or b is None:
        return np.zeros((0, 2))
    found = [match for match in matcher.match(a, b) if match.distance < 40]
    pairs = [np.subtract(left[match.queryIdx].pt, right[match.trainIdx].pt) for match in found]
    return np.array(pairs).reshape(-1, 2)


def _ground_truth(subject: Subject) -> str | Note:
    truth = subject.dataset.ground_truth()
    if truth is None:
        return Note("none: runs have no ATE, and tracker=groundtruth does not work")
    having = set(np.asarray(truth.numbers).tolist()) if isinstance(truth, Trajectory) else set()
    numbers = [number for number in subject.dataset.numbers if number in having] or subject.dataset.numbers
    require_trajectory(truth, numbers, "ground_truth()", "ground_truth")
    T = truth.T_world_cam
    if len(T) < 2:
        return "one pose"
    steps = (np.linalg.inv(T[:-1]) @ T[1:])[:, :3, 3]
    mean, length = steps.mean(axis=0), float(np.linalg.norm(steps, axis=1).mean())
    axis = int(np.argmax(np.abs(mean)))
    text = (
        f"{len(T)} poses in SE(3), {length:.3g} m per frame, mostly along {'-' if mean[axis] < 0 else '+'}{'xyz'[axis]}"
    )
    if length > 0.01 and (axis != 2 or mean[2] < 0):
        return Note(f"{text} of the camera: a car drives along +z; other axes, or world to camera?")
    return text


def _depth(subject: Subject) -> str | Note:
    dataset, camera = subject.dataset, subject.dataset.camera_of(subject.sampled[0])
    texts = []
    for method, unit in (("lidar_depth", "m"), ("sensor_depth", "m"), ("true_depth", "m"), ("true_disparity", "px")):
        depth = getattr(dataset, method)(subject.sampled[0])
        if depth is None:
            continue
        probes.require_array(depth, (camera.height, camera.width), np.float32, method)
        known = depth[~np.isnan(depth)]
        if not len(known) or known.min() <= 0 or np.isinf(known).any():
            raise ContractBrokenError(
                f"{method} is zero, negative, infinite or nowhere known",
                "metres (disparity: pixels) where it is known, NaN elsewhere",
                "values[values <= 0] = np.nan",
                method,
            )
        texts.append(f"{method}: {len(known) / depth.size:.1%}, {known.min():.1f} to {known.max():.1f} {unit}")
    sky = dataset.true_sky(subject.sampled[0])
    if sky is not None:
        probes.require_array(sky, (camera.height, camera.width), np.bool_, "true_sky")
    return "; ".join(texts) if texts else Note("neither LiDAR nor sensor nor true depth: runs have no Depth-L1")


def checks_of(subject: Subject) -> tuple[Check[Subject], ...]:
    """All checks of a data set."""
    return (
        Check("label and numbers", _describes, essential=True),
        Check("camera", _camera),
        Check("frames", _frames, essential=True),
        Check("timestamps", _timestamps),
        Check("determinism", _repeats),
        Check("rectified", _rectified),
        Check("ground truth", _ground_truth),
        Check("depth", _depth),
    )
