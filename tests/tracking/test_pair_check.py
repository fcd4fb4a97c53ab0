"""Pairs that are no rectified pairs, made from cameras by hand: what is wrong with them is said, and good ones pass."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from bench.geometry import se3
from bench.registry import lookup
from bench.tracking.pair_check import PairCheck, PairMatches, fault_of_pair
from bench.types import StereoCamera, StereoFrame

CAMERA = StereoCamera(1240, 370, 700.0, 700.0, 620.0, 185.0, (0.5, 0.0, 0.0))
STEP = se3.compose(np.eye(3), np.array([0.0, 0.02, 1.2]))
"""Where the camera is a frame later."""


def project(points: np.ndarray, T_world_cam: np.ndarray, zoom: float = 1.0, radial: float = 0.0) -> np.ndarray:
    """Pixels (N, 2) of points (N, 3) by the pinhole equations, with a focal length and one distortion of its own."""
    in_camera = (points - T_world_cam[:3, 3]) @ T_world_cam[:3, :3]
    x, y = (in_camera[:, :2] / in_camera[:, 2:]).T
    bent = zoom * (1 + radial * (x**2 + y**2))
    return np.column_stack([700.0 * bent * x + 620.0, 700.0 * bent * y + 185.0])


def matches(
    T_left_right: np.ndarray | None = None, late: float = 0.0, wrong: float = 0.15, speed: float = 1.0, **lens: float
) -> PairMatches:
    """A street's points in both cameras, with the noise of corners and a share of wrong matches."""
    rng = np.random.default_rng(0)
    z = rng.uniform(5.0, 60.0, 900)
    points = np.column_stack([rng.uniform(-0.8, 0.8, 900) * z, rng.uniform(-0.2, 0.25, 900) * z, z])
    motion = se3.exp(speed * se3.log(STEP))
    right_pose = se3.exp(late * se3.log(motion)) @ se3.compose(np.eye(3), np.array([0.5, 0.0, 0.0]))
    left, before = project(points, np.eye(4)), project(points, se3.inverse(motion))
    right = project(points, right_pose if T_left_right is None else right_pose @ T_left_right, **lens)
    left, right, before = (each + rng.normal(0, 0.3, each.shape) for each in (left, right, before))
    lost = rng.uniform(size=len(right)) < wrong
    right[lost] = rng.uniform((0, 0), (1240, 370), (int(lost.sum()), 2))
    x, y = ((right - (620.0, 185.0)) / 700.0).T
    flow = np.where(rng.uniform(size=len(x)) < 0.5, (left - before)[:, 1], np.nan)
    return PairMatches(x, y, left[:, 0] - right[:, 0], right[:, 1] - left[:, 1], flow, features=3000)


def turned(axis: int, degrees: float) -> np.ndarray:
    """The right camera turned about an axis (0: x, 1: y, 2: z, which is a roll)."""
    phi = np.zeros(6)
    phi[3 + axis] = np.radians(degrees)
    return se3.exp(phi)


@pytest.mark.parametrize("wrong", [0.0, 0.15, 0.3])
@pytest.mark.parametrize("speed", [0.0, 1.0, 5.0])
def test_a_good_pair_passes(wrong: float, speed: float) -> None:
    assert fault_of_pair(matches(wrong=wrong, speed=speed), CAMERA) is None
    assert fault_of_pair(matches(turned(2, 0.1), wrong=wrong, speed=speed), CAMERA) is None


@pytest.mark.parametrize(
    ("made", "said", "size"),
    [
        ({"T_left_right": turned(2, -0.7)}, r"the right image is rolled by ([\d.]+) degrees", 0.7),
        ({"T_left_right": turned(2, 0.5)}, r"the right image is rolled by ([\d.]+) degrees", 0.5),
        ({"T_left_right": turned(2, 1.0), "wrong": 0.3}, r"the right image is rolled by ([\d.]+) degrees", 1.0),
        ({"T_left_right": turned(2, 4.0)}, r"the right image is rolled by ([\d.]+) degrees", 4.0),
        # f tan(0.5 degrees) = 6.1 pixels.
        ({"T_left_right": turned(0, 0.5)}, r"the right image's rows lie ([\d.]+) pixels lower", 6.1),
        ({"T_left_right": turned(0, -0.5)}, r"the right image's rows lie ([\d.]+) pixels higher", 6.1),
        ({"T_left_right": turned(1, 3.0)}, r"the right camera is turned by ([\d.]+) degrees", 3.0),
        ({"zoom": 1.02}, r"the right image is ([\d.]+)% larger", 2.0),
        ({"zoom": 0.98}, r"the right image is ([\d.]+)% smaller", 2.0),
        ({"radial": -0.06}, r"the right image has another radial distortion than the left one \(by -([\d.]+)\)", 0.06),
    ],
)
def test_rows_that_vary_are_measured(made: dict[str, Any], said: str, size: float) -> None:
    fault = str(fault_of_pair(matches(**made), CAMERA))
    found = re.match(said, fault)
    assert found, fault
    assert float(found[1]) == pytest.approx(size, rel=0.15)
    assert "the pair is not rectified" in fault


@pytest.mark.parametrize(("late", "side"), [(1.0, "later"), (-1.0, "earlier"), (0.25, "later"), (-0.5, "earlier")])
def test_another_moment_is_told_by_the_motion(late: float, side: str) -> None:
    fault = str(fault_of_pair(matches(late=late), CAMERA))
    found = re.match(rf"the right images seem to be taken about ([\d.]+) frames {side}", fault)
    assert found, fault
    # What a point moves in the coming frame is not quite what it moved in the last one.
    assert float(found[1]) == pytest.approx(abs(late), rel=0.4)


def test_several_frames_late_is_no_other_camera() -> None:
    assert "of the same moment" in str(fault_of_pair(matches(late=4.0), CAMERA))


def test_exchanged_sides_the_same_image_and_other_places() -> None:
    good = matches()
    swapped = PairMatches(good.x, good.y, -good.disparity, -good.rows, good.flow, good.features)
    assert "swapped: 100% of" in str(fault_of_pair(swapped, CAMERA))
    zero = 0.3 * np.random.default_rng(0).normal(size=(2, len(good)))
    same = PairMatches(good.x, good.y, zero[0], zero[1], good.flow, good.features)
    assert "show the same" in str(fault_of_pair(same, CAMERA))
    assert "different places" in str(fault_of_pair(matches(wrong=1.0), CAMERA))
    few = PairMatches(*(column[:50] for column in (good.x, good.y, good.disparity, good.rows, good.flow)), 3000)
    assert "different places: 2% of the corners match" in str(fault_of_pair(few, CAMERA))


def test_an_image_that_shows_nothing_is_not_judged() -> None:
    nothing = np.zeros(0)
    assert fault_of_pair(PairMatches(nothing, nothing, nothing, nothing, nothing, 0), CAMERA) is None


class _Frames:
    """A data set of as many frames; pairs of noise, whose right image is the left one moved by ``shift`` pixels."""

    is_sequence = has_right = True

    def __init__(self, count: int, baseline: float = 0.5) -> None:
        self.camera = StereoCamera(320, 160, 300.0, 300.0, 160.0, 80.0, (baseline, 0.0, 0.0))
        self._count = count

    def __len__(self) -> int:
        return self._count

    def camera_of(self, position: int) -> StereoCamera:
        return self.camera

    def frame(self, position: int, shift: int = 12, bright: bool = True) -> StereoFrame:
        rng = np.random.default_rng(position)
        noise = cv2.GaussianBlur(rng.integers(0, 256, (160, 340), dtype=np.uint8), (0, 0), 2.0)
        wide = cv2.cvtColor(cv2.normalize(noise, None, 0, 255 * bright, cv2.NORM_MINMAX), cv2.COLOR_GRAY2RGB)
        return StereoFrame(position, 0.1 * position, wide[:, :320], wide[:, shift : 320 + shift])


def looked(frames: _Frames, **of_frame: Any) -> list[tuple[int, str]]:
    check = PairCheck(frames)  # type: ignore[arg-type]
    told = [(at, check.look(at, frames.frame(at, **of_frame))) for at in range(len(frames))]
    return [(at, text) for at, text in told if text is not None]


def test_frames_are_looked_at_as_images_and_told_of_once() -> None:
    assert looked(_Frames(4)) == []
    ((at, text),) = looked(_Frames(8), shift=0)
    assert at == 2
    assert "show the same" in text
    ((at, _),) = looked(_Frames(2), shift=0)
    assert at == 1
    assert looked(_Frames(4), bright=False) == []


def test_a_later_fault_is_seen_too() -> None:
    frames = _Frames(300)
    check = PairCheck(frames)  # type: ignore[arg-type]
    told = [check.look(at, frames.frame(at, shift=0 if at > 50 else 12)) for at in (*range(6), 99, 100, 101, 102)]
    assert [at for at, text in enumerate(told) if text] == [8]


@pytest.mark.parametrize("broken_after", range(5))
def test_looking_goes_on_after_a_break(broken_after: int) -> None:
    frames = _Frames(8)
    check, told = PairCheck(frames), []  # type: ignore[arg-type]
    for at in range(6):
        told.append(check.look(at, frames.frame(at, shift=0)))
        if at == broken_after:
            state, check = check.state(), PairCheck(frames)  # type: ignore[arg-type]
            check.restore(state)
    assert [at for at, text in enumerate(told) if text] == [2]


@pytest.mark.parametrize(
    ("baseline", "odd"), [(537.15, True), (12.0, True), (5e-4, True), (0.11, False), (0.004, False)]
)
def test_a_baseline_in_another_unit(baseline: float, odd: bool) -> None:
    said = PairCheck(_Frames(1, baseline)).about_camera()  # type: ignore[arg-type]
    assert (said is not None) == odd
    assert said is None or f"{baseline:g} metres" in said


KITTI = [("03", "color"), ("06", "gray")]


def spoilt(frame: StereoFrame, later: StereoFrame, how: str) -> StereoFrame:
    assert frame.right is not None
    height, width = frame.left.shape[:2]
    turn = cv2.getRotationMatrix2D((width / 2, height / 2), 0.5, 1.0)
    right = {
        "good": frame.right,
        "rolled": cv2.warpAffine(frame.right, turn, (width, height), borderMode=cv2.BORDER_REPLICATE),
        "one frame late": later.right,
        "the left one as JPEG": cv2.imdecode(cv2.imencode(".jpg", frame.left, [cv2.IMWRITE_JPEG_QUALITY, 50])[1], 1),
    }[how]
    return dataclasses.replace(frame, right=right)


@pytest.mark.slow
@pytest.mark.parametrize(("sequence", "cameras"), KITTI)
def test_real_pairs(kitti_root: Path, sequence: str, cameras: str) -> None:
    """No alarm on any of them as they are, and the right one when they are spoilt."""
    plugin = lookup("dataset", "kitti")
    settings = {"root": str(kitti_root), "sequence": sequence, "camera": cameras, "frames": "0:6"}
    dataset = plugin.cls(plugin.config(name="kitti", **settings))
    frames = [dataset.frame(at) for at in range(5)]
    for how, said in (
        ("good", ""),
        ("rolled", "rolled by 0.5 degrees"),
        ("one frame late", "of the same moment"),
        ("the left one as JPEG", "show the same"),
    ):
        check = PairCheck(dataset)
        told = [check.look(at, spoilt(frames[at], frames[at + 1], how)) for at in range(4)]
        assert [text for text in told if text] == [] if not said else any(said in str(text) for text in told), told
