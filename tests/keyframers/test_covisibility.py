"""The paper's keyframe rule on sets of landmarks and motions worked by hand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from bench.contracts.keyframer import Keyframer
from bench.errors import BenchError
from bench.registry import lookup
from bench.types import KeyframeDecision, StereoFrame, TrackingResult
from plugins.keyframers.covisibility import covisibility

BLANK = np.zeros((120, 160, 3), np.uint8)


def keyframer(**settings: Any) -> Keyframer:
    plugin = lookup("keyframer", "covisibility")
    return plugin.cls(plugin.config(name="covisibility", **settings))


def decide(
    rule: Keyframer, number: int, seen: range | list[int], z: float = 0.0, turn_deg: float = 0.0
) -> KeyframeDecision:
    """One frame at (0, 0, z), turned about y, that sees the landmarks ``seen``."""
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    T = np.array([[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, z], [0, 0, 0, 1]])
    frame = StereoFrame(number, 0.1 * number, BLANK, BLANK)
    return rule.update(frame, TrackingResult(T, "ok", landmarks=np.array(seen, dtype=np.int64)))


def test_iou_worked_by_hand() -> None:
    assert covisibility(np.array([1, 2, 3, 4]), np.array([3, 4, 5])) == 2 / 5
    assert covisibility(np.array([1, 2]), np.array([3])) == 0.0
    assert covisibility(np.array([], np.int64), np.array([], np.int64)) == 0.0
    descriptors = np.random.default_rng(0).integers(0, 2**63, (40, 4), dtype=np.uint64)
    # 30 common ones out of 40 and 30: 30 / (40 + 30 - 30).
    assert covisibility(descriptors, descriptors[10:]) == 30 / 40
    assert covisibility(np.array([1, 2]), descriptors) == 0.0


def test_first_frame_is_a_keyframe() -> None:
    decision = decide(keyframer(), 7, [])
    assert decision == KeyframeDecision(True, "first frame", (7,))


def test_low_covisibility_makes_a_keyframe_and_is_counted_from_the_last_keyframe() -> None:
    rule = keyframer(iou_threshold=0.5)
    decide(rule, 0, range(0, 100))
    # 80 of 120 common: 0.67, none. Then 60 of 140: 0.43, a keyframe, though 80 of 120 with the frame before.
    assert not decide(rule, 1, range(20, 120)).is_keyframe
    decision = decide(rule, 2, range(40, 140))
    assert decision.is_keyframe
    assert decision.reason == "covisibility IoU 0.43 is below 0.5"
    assert decision.window == (0, 2)


def test_sudden_motion_makes_a_keyframe() -> None:
    rule = keyframer()
    for number, z in enumerate([0.0, 1.0, 2.0, 3.4]):
        assert decide(rule, number, range(50), z).is_keyframe == (number == 0)
    # Steps 1, 1, 1.4, then 2.2 = 1.57 times 1.4.
    decision = decide(rule, 4, range(50), 5.6)
    assert decision.is_keyframe
    assert decision.reason == "moved 2.20 m, more than 1.5 times the 1.40 m before"
    assert not decide(rule, 5, range(50), 7.8).is_keyframe


def test_sudden_turn_makes_a_keyframe() -> None:
    rule = keyframer()
    turns = [0.0, 1.0, 2.0, 4.0]
    assert [decide(rule, i, range(50), 0.0, turn).is_keyframe for i, turn in enumerate(turns)] == [
        True,
        False,
        False,
        True,
    ]


def test_a_frame_kept_out_of_mapping_is_no_sudden_motion() -> None:
    rule = keyframer()
    for number in (0, 1, 3, 4):
        assert decide(rule, number, range(50), 1.0 * number).is_keyframe == (number == 0)


def test_noise_of_a_standing_car_makes_none() -> None:
    rule = keyframer()
    rng = np.random.default_rng(0)
    decisions = [decide(rule, i, range(50), rng.normal() * 0.005, rng.normal() * 0.03) for i in range(30)]
    assert [d.is_keyframe for d in decisions] == [True] + [False] * 29


def test_window_drops_the_oldest_and_the_unrelated() -> None:
    rule = keyframer(iou_threshold=0.9, window_size=3, marginalise_iou=0.2)
    # Each step shifts 100 landmarks by 30: IoU 70/130 = 0.54 one keyframe back, 40/160 = 0.25 two, 10/190 = 0.05 three.
    windows = [decide(rule, i, range(30 * i, 30 * i + 100)).window for i in range(5)]
    assert windows == [(0,), (0, 1), (0, 1, 2), (1, 2, 3), (2, 3, 4)]
    assert decide(rule, 5, range(1000, 1100)).window == (5,)
    narrow = keyframer(iou_threshold=0.9, window_size=3, marginalise_iou=0.3)
    assert [decide(narrow, i, range(30 * i, 30 * i + 100)).window for i in range(3)] == [(0,), (0, 1), (1, 2)]


def test_frames_without_landmarks_are_compared_by_their_orb_features(kitti_root: Path) -> None:
    """KITTI 06 at 1.2 m per frame: each frame a keyframe, a picture shown twice none, and the window holds five."""
    rule = keyframer()
    decisions = []
    for number in (0, 0, 1, 2, 3, 4, 5, 5):
        path = kitti_root / "sequences" / "06" / "image_0" / f"{number:06d}.png"
        grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        assert grey is not None
        rgb = np.dstack([grey] * 3)
        pose = np.eye(4)
        pose[2, 3] = 1.2 * number
        decisions.append(rule.update(StereoFrame(len(decisions), 0.0, rgb, rgb), TrackingResult(pose, "ok")))
    assert [d.is_keyframe for d in decisions] == [True, False, True, True, True, True, True, False]
    assert decisions[-1].window == (2, 3, 4, 5, 6)


def test_black_images_don_t_crash() -> None:
    rule = keyframer()
    frame = StereoFrame(0, 0.0, BLANK, BLANK)
    assert rule.update(frame, TrackingResult(np.eye(4), "ok")).is_keyframe
    assert rule.update(frame, TrackingResult(np.eye(4), "ok")).window


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"iou_threshold": 1.2}, r"keyframer\.iou_threshold=1\.2 must lie between 0 and 1"),
        ({"window_size": 0}, r"keyframer\.window_size=0 must be at least 1"),
        ({"motion_factor": -1.0}, r"keyframer\.motion_factor=-1\.0 must not be negative"),
        ({"marginalise_iou": float("nan")}, r"keyframer\.marginalise_iou=nan must lie between"),
    ],
)
def test_wrong_settings_are_named(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(BenchError, match=message):
        keyframer(**settings)
