"""The data that flows between the stages: camera, frames, depth, poses, renders.

Conventions, everywhere in the project: poses are ``T_world_cam`` (4x4, float64, camera to world, OpenCV axes:
x right, y down, z forward) of the LEFT camera; lengths in metres, disparities in pixels, times in seconds;
images are RGB uint8 (H, W, 3); depth and disparity maps are float32 (H, W) with NaN for "unknown".
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from bench.errors import BenchError

Float = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]
Map = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

TrackingState = Literal["ok", "weak", "predicted", "lost"]
"""Of a frame: located by its image; located, but doubtful; a pose that no image confirmed; no pose at all."""
UNCONFIRMED: tuple[TrackingState, ...] = ("predicted", "lost")
"""States of frames that become no keyframe and are not mapped."""


@dataclass(frozen=True)
class StereoCamera:
    """A rectified pinhole stereo pair; both cameras share the intrinsics.

    ``right_position`` is the right camera's centre in the left camera's frame, in metres. Its x component is the
    baseline; y and z are zero for an ideally rectified pair and millimetres for KITTI's colour pair.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    right_position: tuple[float, float, float]

    @property
    def baseline(self) -> float:
        """Distance of the two centres along x, in metres."""
        return self.right_position[0]

    @property
    def intrinsics(self) -> Float:
        """The 3x3 matrix K."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def T_left_right(self) -> Float:
        """4x4 pose of the right camera in the left camera's frame."""
        T = np.eye(4)
        T[:3, 3] = self.right_position
        return T

    def scaled(self, scale: float) -> StereoCamera:
        """The camera of the same images with sides ``scale`` times as long, to the nearest pixel."""
        if scale == 1:
            return self  # to the last bit
        width, height = (max(1, round(scale * side)) for side in (self.width, self.height))
        x, y = width / self.width, height / self.height
        cx, cy = (self.cx + 0.5) * x - 0.5, (self.cy + 0.5) * y - 0.5
        return StereoCamera(width, height, self.fx * x, self.fy * y, cx, cy, self.right_position)


@dataclass(frozen=True)
class PinholeView:
    """A camera to render from: its pose ``T_world_cam`` (4, 4) float64, intrinsics in px, pixel centres at integers."""

    T_world_cam: Float
    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    @classmethod
    def of(cls, camera: StereoCamera, T_world_cam: Float) -> PinholeView:
        """The view of ``camera``'s intrinsics at pose ``T_world_cam``."""
        return cls(T_world_cam, camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height)

    @cached_property
    def T_cam_world(self) -> Float:
        """World to camera (4, 4) float64, contiguous."""
        return np.asarray(np.linalg.inv(self.T_world_cam), np.float64)

    def halved(self) -> PinholeView:
        """The view whose pixels are the means of 2x2 blocks of this one (an odd last row or column is dropped)."""
        half = replace(
            self,
            fx=self.fx / 2,
            fy=self.fy / 2,
            cx=(self.cx - 0.5) / 2,
            cy=(self.cy - 0.5) / 2,
            width=self.width // 2,
            height=self.height // 2,
        )
        vars(half)["T_cam_world"] = self.T_cam_world  # the same camera: not inverted a second time
        return half

    def widened(self, columns: int) -> PinholeView:
        """The view that sees so many columns more on its left and on its right."""
        return replace(self, cx=self.cx + columns, width=self.width + 2 * columns)


@dataclass(frozen=True)
class StereoFrame:
    """One rectified pair, or a left image alone (``right`` None: RGB-D). ``number`` is the frame's number in its data
    set, ``timestamp`` is in seconds. ``depth`` of the left image: once it has been
    computed, which is before tracking for a tracker that ``uses_depth``."""

    number: int
    timestamp: float
    left: Image
    right: Image | None = None
    depth: DepthMap | None = None

    def checksum(self) -> int:
        """CRC-32 of both images' pixels, without the depth: tells whether a file was changed, not who did it."""
        left = zlib.crc32(np.ascontiguousarray(self.left).data)
        return left if self.right is None else zlib.crc32(np.ascontiguousarray(self.right).data, left)

    def pair(self, part: str, instead: str) -> tuple[Image, Image]:
        """Left and right image, for a part that needs both; ``BenchError`` naming it and what to choose instead."""
        if self.right is None:
            raise BenchError(f"{part} needs a right image, and frame {self.number} has none. Choose {instead}.")
        return self.left, self.right


def check_confidence(confidence: Map, shape: tuple[int, ...], source: str) -> None:
    """Raise ``BenchError`` unless it is a float32 array of ``shape`` from 0 to 1; ``source`` names who gave it."""
    expected = f"expected float32 {shape}, from 0 (none) to 1 (sure)"
    if not isinstance(confidence, np.ndarray) or confidence.shape != shape or confidence.dtype != np.float32:
        is_array = isinstance(confidence, np.ndarray)
        got = f"{confidence.dtype} {confidence.shape}" if is_array else type(confidence).__name__
        raise BenchError(f"{source} gave a confidence that is {got}; {expected}.")
    if not ((confidence >= 0) & (confidence <= 1)).all():
        reach = f"{confidence.min():.4g} to {confidence.max():.4g}"
        raise BenchError(f"{source} gave a confidence that reaches from {reach}; {expected}.")


@dataclass(frozen=True)
class DepthMap:
    """Depth of the left image, in metres, NaN where unknown, (H, W) float32; ``source`` names the plugin.

    ``confidence`` in the depth, (H, W) float32 from 0 (none) to 1 (sure), or None from a plugin that has none; anything
    else raises ``BenchError`` naming the plugin. Where the depth is unknown it says nothing.
    """

    depth: Map
    source: str
    confidence: Map | None = None

    def __post_init__(self) -> None:
        if self.confidence is not None:
            check_confidence(self.confidence, self.depth.shape, self.source)

    @property
    def known(self) -> Mask:
        """Boolean (H, W): where the depth is known."""
        return np.isfinite(self.depth)


@dataclass(frozen=True)
class Trajectory:
    """Poses of the left camera: ``T_world_cam`` (N, 4, 4) float64, frame numbers (N,), timestamps (N,) in seconds.

    Frames without a pose (lost) are simply absent; the numbers say which are there.
    """

    T_world_cam: Float
    numbers: npt.NDArray[np.int64]
    timestamps: Float

    def __len__(self) -> int:
        return len(self.numbers)

    def of_frames(self, numbers: Sequence[int]) -> Trajectory:
        """The part of these frames, as far as they have a pose."""
        keep = np.isin(self.numbers, numbers)
        return Trajectory(self.T_world_cam[keep], self.numbers[keep], self.timestamps[keep])

    def pose_of(self, number: int) -> Float | None:
        """The 4x4 pose of the frame with this number, or None if it has none."""
        found = np.flatnonzero(self.numbers == number)
        return self.T_world_cam[found[0]] if len(found) else None


@dataclass(frozen=True)
class Event:
    """Something that happened in a run, at the frame with number ``frame``; a line of ``events.jsonl``.

    ``kind`` is one of the project's own (``bench/runs/events.py`` lists them) or a plugin's; ``values`` are plain
    data (numbers, text, lists of them), without times, so that equal runs have equal events.
    """

    kind: str
    frame: int
    values: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class TrackingResult:
    """What a tracker says about one frame.

    ``T_world_cam`` is None exactly when ``state`` is "lost". "ok" and "weak" are poses that the image confirmed, "weak"
    with doubts; "predicted" is one that it did not, such as a guess of constant motion: no keyframe, and never mapped.
    ``landmarks`` are ids of the map points observed in this frame (int64, unique), or None from a tracker that has no
    features. ``reprojection_px`` is the RMS over inliers.
    ``exposure`` (a, b): the image is exp(a) times the map's colours (0 to 1) plus b, from a tracker that estimates it.
    ``events``: what happened at this frame, in order.
    """

    T_world_cam: Float | None
    state: TrackingState
    inliers: int = 0
    reprojection_px: float = float("nan")
    landmarks: npt.NDArray[np.int64] | None = None
    events: tuple[Event, ...] = ()
    exposure: tuple[float, float] | None = None


@dataclass(frozen=True)
class KeyframeDecision:
    """Whether the frame is a keyframe and why; ``window`` holds the frame numbers of the active keyframes, oldest
    first."""

    is_keyframe: bool
    reason: str
    window: tuple[int, ...]


@dataclass(frozen=True)
class Keyframe:
    """What the mapper gets: a frame, its stereo depth, its sky mask (True = sky, None without a segmenter), its
    pose, and ``exposure`` as in ``TrackingResult`` (not in keyframes that are made anew to resume a run)."""

    frame: StereoFrame
    depth: DepthMap
    sky: Mask | None
    T_world_cam: Float
    exposure: tuple[float, float] | None = None


@dataclass(frozen=True)
class MappingReport:
    """What the mapper says after a keyframe: PSNR of the newest keyframe in dB, loss terms by name; ``events``: what
    happened to the map, in order."""

    psnr_db: float
    losses: dict[str, float] = field(default_factory=dict)
    events: tuple[Event, ...] = ()


@dataclass(frozen=True)
class RenderedView:
    """A rendered image: colour (H, W, 3) float32 in [0, 1], ``depth`` = sum d a T (H, W) float32 in metres (not
    divided by alpha), alpha (H, W) float32 in [0, 1]."""

    color: npt.NDArray[np.float32]
    depth: Map
    alpha: Map
