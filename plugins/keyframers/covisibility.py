"""The paper's keyframe rule: little covisibility with the last keyframe, or a sudden motion; with a sliding window."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from bench.contracts.keyframer import Keyframer
from bench.errors import BenchError, require_between, require_least
from bench.geometry import se3
from bench.io.images import grey
from bench.registry import PluginConfig, register
from bench.tracking.descriptors import Descriptors, Ints
from bench.tracking.features import OrbExtractor
from bench.tracking.relocalise import match_descriptors
from bench.types import Float, KeyframeDecision, StereoFrame, TrackingResult

_RATIO = 0.8
"""Lowe's ratio for descriptors of two keyframes."""

# What a frame saw: ids of the tracker's map points, or, from a tracker without features, ORB descriptors.
Sighting = Ints | Descriptors


@dataclass(frozen=True)
class CovisibilityConfig(PluginConfig):
    """Settings of the paper's rule (Sec. "KeyFraming"; the paper gives 1.5 and leaves the other numbers open)."""

    iou_threshold: float = 0.7
    """A frame whose covisibility IoU with the last keyframe is below this becomes a keyframe. On KITTI 06 the IoU of
    successive frames is 0.2 to 0.35 at 1.2 m per frame, above 0.8 for a standing car, whatever gives the features."""
    motion_factor: float = 1.5
    """A frame that moved more than this factor times the motion before becomes a keyframe."""
    min_translation_m: float = 0.05
    """Translations from frame to frame below this are noise and no motion."""
    min_rotation_deg: float = 0.3
    """Rotations from frame to frame below this are noise and no motion."""
    window_size: int = 5
    """Number of active keyframes."""
    marginalise_iou: float = 0.04
    """A keyframe leaves the window when its IoU with the newest one falls below this: on KITTI 06, five frames back."""
    features: int = 1000
    """ORB keypoints per frame, where the tracker gives no landmarks."""

    def __post_init__(self) -> None:
        require_between("keyframer", self, 0, 1, "iou_threshold", "marginalise_iou")
        for key in ("motion_factor", "min_translation_m", "min_rotation_deg"):
            if not getattr(self, key) >= 0.0:
                raise BenchError(f"keyframer.{key}={getattr(self, key)} must not be negative.")
        if self.window_size < 1:
            raise BenchError(f"keyframer.window_size={self.window_size} must be at least 1.")
        require_least("keyframer", self, features=100)


@register("keyframer", "covisibility", config=CovisibilityConfig)
class Covisibility(Keyframer):
    """Keyframe when the ORB covisibility with the last keyframe is low, or when the motion jumps (the paper's rule)."""

    def __init__(self, config: CovisibilityConfig) -> None:
        self._config = config
        self._extractor = OrbExtractor(config.features)
        self._window: list[tuple[int, Sighting]] = []
        self._last_pose: Float | None = None
        self._last_number = 0
        self._last_motion: tuple[float, float] | None = None

    def update(self, frame: StereoFrame, tracking: TrackingResult) -> KeyframeDecision:
        """Decide on one tracked frame; the first one is always a keyframe."""
        seen = self._sighting(frame, tracking)
        reason = self._sudden_motion(frame, tracking)
        if not self._window:
            reason = "first frame"
        else:
            overlap = covisibility(seen, self._window[-1][1])
            if overlap < self._config.iou_threshold:
                reason = f"covisibility IoU {overlap:.2f} is below {self._config.iou_threshold}"
        if reason is None:
            reason = f"covisibility IoU {overlap:.2f} and steady motion"
            return KeyframeDecision(False, reason, self._numbers())
        self._admit(frame.number, seen)
        return KeyframeDecision(True, reason, self._numbers())

    def state(self) -> dict[str, Any]:
        """The window and the last motion; ids and descriptors as int64."""
        return {
            "window": [(number, torch.from_numpy(seen.view(np.int64).copy())) for number, seen in self._window],
            "last_pose": None if self._last_pose is None else torch.from_numpy(self._last_pose.copy()),
            "last_number": self._last_number,
            "last_motion": self._last_motion,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from ``state``."""
        self._window = [(number, _as_seen(seen.numpy())) for number, seen in state["window"]]
        self._last_pose = None if state["last_pose"] is None else state["last_pose"].numpy()
        self._last_number, self._last_motion = state["last_number"], state["last_motion"]

    def _sighting(self, frame: StereoFrame, tracking: TrackingResult) -> Sighting:
        if tracking.landmarks is not None:
            return np.unique(tracking.landmarks)
        return self._extractor.extract(grey(frame.left))[0].descriptors

    def _sudden_motion(self, frame: StereoFrame, tracking: TrackingResult) -> str | None:
        """In words, if the motion since the frame before is ``motion_factor`` times the one before (paper, Eq.)."""
        pose, before, previous = tracking.T_world_cam, self._last_pose, self._last_motion
        # Frames kept out of mapping never come here; the motion across such a gap is shared out over it.
        gap = max(frame.number - self._last_number, 1)
        self._last_pose, self._last_number = pose, frame.number
        if pose is None or before is None:
            self._last_motion = None
            return None
        step = se3.inverse(before) @ pose
        angle = np.degrees(se3.rotation_angle(step[:3, :3]))
        motion = (float(np.linalg.norm(step[:3, 3])) / gap, float(angle) / gap)
        self._last_motion = motion
        if previous is None:
            return None
        config = self._config
        kinds = (("moved", "m", config.min_translation_m), ("turned", "deg", config.min_rotation_deg))
        for (verb, unit, floor), now, then in zip(kinds, motion, previous, strict=True):
            if now > floor and now > config.motion_factor * then:
                return f"{verb} {now:.2f} {unit}, more than {config.motion_factor} times the {then:.2f} {unit} before"
        return None

    def _admit(self, number: int, seen: Sighting) -> None:
        older = self._window[max(len(self._window) - self._config.window_size + 1, 0) :]
        kept = [(n, s) for n, s in older if covisibility(seen, s) >= self._config.marginalise_iou]
        self._window = [*kept, (number, seen)]

    def _numbers(self) -> tuple[int, ...]:
        return tuple(number for number, _ in self._window)


def _as_seen(values: Ints) -> Sighting:
    """What ``state`` kept: ids are one number each, descriptors four."""
    return values if values.ndim == 1 else values.view(np.uint64)


def covisibility(a: Sighting, b: Sighting) -> float:
    """Intersection over union of what two frames saw, in [0, 1]; 0 where neither saw anything.

    Landmark ids (N,) are intersected; descriptors (N, 4) are matched (mutual nearest, ratio test), and the IoU is
    matches / (n1 + n2 - matches). One of each kind (a tracker that changed its mind) counts as 0.
    """
    if a.ndim != b.ndim:
        return 0.0
    if a.ndim == 1:
        common = len(np.intersect1d(a, b, assume_unique=True))
    else:
        common = len(match_descriptors(a.view(np.uint64), b.view(np.uint64), _RATIO)[0])
    union = len(a) + len(b) - common
    return common / union if union else 0.0
