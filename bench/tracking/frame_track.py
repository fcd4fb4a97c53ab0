"""Poses of all frames, which follow the keyframes that they hang on."""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.tracking.growing import Archive, Growing
from bench.tracking.odometry import FramePose
from bench.types import Float, Trajectory

_NAME = "frames"


class FrameTrack:
    """Located frames in order; of a frame it keeps number, time, keyframe and the pose relative to that, no more."""

    def __init__(self) -> None:
        self._columns = {
            "number": Growing(np.empty(0, np.int64)),
            "time": Growing(np.empty(0)),
            "keyframe": Growing(np.empty(0, np.int64)),
            "T_keyframe_cam": Growing(np.empty((0, 4, 4))),
        }
        self._T_world_cam = Growing(np.empty((0, 4, 4)))
        self._known = 0
        """Frames from the first on whose pose is that of the last ``trajectory``."""

    def add(self, number: int, time: float, found: FramePose) -> None:
        """Take in a frame; a lost one has no pose to keep."""
        if found.T_world_cam is None:
            return
        assert found.keyframe >= 0, "a located frame hangs on a keyframe"
        for column, value in zip(
            self._columns.values(), (number, time, found.keyframe, found.T_keyframe_cam), strict=True
        ):
            column.append(value)
        self._T_world_cam.append(found.T_world_cam)

    def trajectory(self, T_world_keyframe: Float, moved_from: int) -> Trajectory:
        """The poses with those of the keyframes (K, 4, 4); none before ``moved_from`` has moved since the last call."""
        number, time, keyframe, relative = (column.rows for column in self._columns.values())
        first = min(self._known, int(np.searchsorted(keyframe, moved_from)))  # keyframes come in order
        poses = self._T_world_cam.rows
        poses[first:] = T_world_keyframe[keyframe[first:]] @ relative[first:]
        self._known = len(poses)
        return Trajectory(poses.copy(), number, time)

    def state(self, archive: Archive) -> dict[str, Any]:
        """For a checkpoint."""
        return archive.rows(_NAME, {key: column.rows for key, column in self._columns.items()}, len(self._T_world_cam))

    def restore(self, state: dict[str, Any], archive: Archive) -> None:
        """Go on from ``state``."""
        columns = archive.rows_of(_NAME, state)
        self._columns = {key: Growing(columns[key]) for key in self._columns}
        self._T_world_cam, self._known = Growing(np.empty_like(columns["T_keyframe_cam"])), 0
