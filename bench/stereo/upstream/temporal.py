"""A published network that carries what it knows from frame to frame, by TCSM's convention."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import Any

from bench.contracts.dataset import Dataset
from bench.errors import BenchError
from bench.peers.messages import Array
from bench.stereo.padding import Window
from bench.stereo.upstream.motion import motion_between, size_of
from bench.stereo.upstream.network import UpstreamConfig, UpstreamNetwork
from bench.types import DepthMap, Float, Image, StereoCamera, StereoFrame

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class TemporalConfig(UpstreamConfig):
    """When the network begins anew, as if the frame were the first one."""

    max_gap: int = 5
    """Frame numbers may grow by this many; 0: every frame stands alone."""
    max_step_m: float = 8.0
    """The camera may move this far between two frames that it is given, ..."""
    max_turn_deg: float = 20.0
    """... and turn this much."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.tile_rows:
            raise BenchError(
                f"stereo={self.name} carries its state from frame to frame for whole images: leave stereo.tile_rows "
                "at 0; stereo.scale saves memory too."
            )
        for key in ("max_gap", "max_step_m", "max_turn_deg"):
            if getattr(self, key) < 0:
                raise BenchError(f"stereo.{key}={getattr(self, key)} must not be negative.")


@dataclass(frozen=True)
class _Seen:
    number: int
    left: Image
    depth: DepthMap


class TemporalUpstreamNetwork(UpstreamNetwork):
    """Tells the network how the camera has moved since the frame before.

    It needs the motion before the frame's disparity, so it is estimated here, from the depth of the frame before
    (``motion_between``): no tracker is needed. State begins anew at ``start``, where the numbers jump or go back, and
    where no plausible motion is found. ``disparity`` alone, without a frame's number and camera, has no state.
    """

    temporal = True

    def __init__(self, config: TemporalConfig) -> None:
        super().__init__(config)
        self._limits = config
        # An exported graph has no state.
        self.temporal = not config.onnx
        self._seen: _Seen | None = None
        self._pending: tuple[StereoCamera, Float | None] | None = None

    def start(self, dataset: Dataset) -> None:
        """Forget the frames of another sequence."""
        super().start(dataset)
        self._seen = None

    def depth(self, frame: StereoFrame, position: int, camera: StereoCamera) -> DepthMap:
        """Depth in metres, with the help of the frame that this method was given before."""
        if not self.temporal:
            return super().depth(frame, position, camera)
        self._pending = (camera, self._motion_since(frame, camera))
        depth = super().depth(frame, position, camera)
        self._seen = _Seen(frame.number, frame.left, depth)
        return depth

    def told_beside(self, shape: tuple[int, ...], window: Window) -> tuple[dict[str, Any], dict[str, Array]]:
        """Camera and motion, for a frame's first match only: that of its mirrored image must not be remembered."""
        if self._pending is None:
            return {}, {}
        (camera, T_now_before), self._pending = self._pending, None
        fed = _camera_of(camera, shape, window)
        arrays = {"K": fed.intrinsics} if T_now_before is None else {"K": fed.intrinsics, "T_now_before": T_now_before}
        return {"baseline": float(camera.baseline)}, arrays

    def _motion_since(self, frame: StereoFrame, camera: StereoCamera) -> Float | None:
        """``T_now_before`` (4, 4), or None where the network is to begin anew."""
        seen, limits = self._seen, self._limits
        if seen is None or seen.left.shape != frame.left.shape:
            return None
        if not 0 < frame.number - seen.number <= limits.max_gap:
            log.info("frame %d: the frame before was %d, so the network begins anew", frame.number, seen.number)
            return None
        T = motion_between(seen.left, seen.depth.depth, frame.left, camera)
        if T is None:
            log.info(
                "frame %d: no motion since frame %d is found, so the network begins anew", frame.number, seen.number
            )
            return None
        step_m, turn_deg = size_of(T)
        if step_m > limits.max_step_m or turn_deg > limits.max_turn_deg:
            log.info(
                "frame %d: a jump of %.1f m and %.0f degrees, so the network begins anew",
                frame.number,
                step_m,
                turn_deg,
            )
            return None
        return T


def _camera_of(camera: StereoCamera, shape: tuple[int, ...], window: Window) -> StereoCamera:
    """The camera of the image that the network sees: scaled to ``shape`` and padded, so that the image is at
    ``window``. Pixel centres are whole numbers."""
    down, across = shape[0] / camera.height, shape[1] / camera.width
    return replace(
        camera,
        fx=camera.fx * across,
        fy=camera.fy * down,
        cx=(camera.cx + 0.5) * across - 0.5 + window[1].start,
        cy=(camera.cy + 0.5) * down - 0.5 + window[0].start,
    )
