"""The process in which ORB-SLAM3 runs; the only file that imports pyorbslam3. ``plugins/trackers/orbslam3.py`` starts
it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.geometry import se3
from bench.peers.serve import Grey, Peer, PeerPose, PeerPoses, serve
from bench.types import Float

# What each of the package's settings is called in ORB-SLAM3's file; the viewer's are read even when there is no viewer.
_SETTINGS = """%YAML:1.0
Camera.type: "PinHole"
Camera.fx: {fx:.9f}
Camera.fy: {fy:.9f}
Camera.cx: {cx:.9f}
Camera.cy: {cy:.9f}
Camera.k1: 0.0
Camera.k2: 0.0
Camera.p1: 0.0
Camera.p2: 0.0
Camera.width: {width}
Camera.height: {height}
Camera.fps: {fps}
Camera.bf: {bf:.9f}
Camera.RGB: 1
ThDepth: {th_depth:.6f}
ORBextractor.nFeatures: {features}
ORBextractor.scaleFactor: {scale_factor:.6f}
ORBextractor.nLevels: {octaves}
ORBextractor.iniThFAST: {fast_threshold}
ORBextractor.minThFAST: {fast_threshold_low}
Viewer.KeyFrameSize: 0.6
Viewer.KeyFrameLineWidth: 2.0
Viewer.GraphLineWidth: 1.0
Viewer.PointSize: 2.0
Viewer.CameraSize: 0.7
Viewer.CameraLineWidth: 3.0
Viewer.ViewpointX: 0.0
Viewer.ViewpointY: -100.0
Viewer.ViewpointZ: -0.1
Viewer.ViewpointF: 2000.0
"""
_LEAST_STEP_S = 1e-3
"""ORB-SLAM3 wants times that increase; it counts in them only how long it has been lost."""
_TIME_DIGITS = 6
"""Of the times in a saved trajectory."""
_LEAST_JUMP_M = 1.0
_JUMP_FACTOR = 3.0
"""A step that is longer than this times the one before, and by a metre, is a correction or another map's world."""
_SAME_ORIGIN_M = 1e-3


@dataclass
class Located:
    number: int
    time: float
    map: int
    T_map_cam: Float


class OrbSlam3Peer(Peer):
    """ORB-SLAM3's stereo mode. Its poses are in the world of its active map, which begins anew when it is lost for
    long, and may later be merged into an older one; neither is announced, so both are read off states and poses."""

    def start(self, settings: dict[str, Any]) -> None:
        """Load the vocabulary and start ORB-SLAM3's threads."""
        import pyorbslam3

        path = Path("settings.yaml").absolute()
        path.write_text(settings_text(settings))
        self._good = (pyorbslam3.TrackingState.OK, pyorbslam3.TrackingState.OK_KLT)
        self._short_loss = pyorbslam3.TrackingState.RECENTLY_LOST
        self._slam = pyorbslam3.Slam(settings["vocabulary"], str(path), pyorbslam3.Sensor.STEREO)
        self._frames: list[Located] = []
        self._map = self._maps_begun = 0
        self._first_time: float | None = None
        self._time = -np.inf
        self._has_map = self._was_lost = False

    def track(self, number: int, timestamp: float, left: Grey, right: Grey) -> PeerPose:
        """Pose of the frame; "lost" also while ORB-SLAM3 calls itself recently lost, for its poses are stale then."""
        if self._first_time is None:
            self._first_time = timestamp
        self._time = max(timestamp - self._first_time, self._time + _LEAST_STEP_S)
        result = self._slam.track_stereo(left, right, self._time)
        if result.state not in self._good or result.pose_wc is None:
            self._has_map = self._has_map and result.state == self._short_loss
            self._was_lost = True
            return PeerPose(None, "lost")
        T = np.array(result.pose_wc, dtype=np.float64)
        # After a short loss it may have found its place again; a new map begins with the identity.
        if self._frames and self._was_lost and (not self._has_map or np.array_equal(T, np.eye(4))):
            self._maps_begun += 1
            self._map = self._maps_begun
        self._has_map, self._was_lost = True, False
        located = Located(number, self._time, self._map, T)
        jumped = self._jumps(located) or self._slam.map_changed()
        self._frames.append(located)
        corrections = self._saved() if jumped else None
        return PeerPose(located.T_map_cam, "ok", located.map, int(result.num_tracked_points), corrections)

    def finish(self) -> PeerPoses | None:
        """Stop ORB-SLAM3's threads and read the trajectory with all corrections."""
        self._slam.shutdown()
        # Asked for its trajectory without a keyframe in its map, ORB-SLAM3 crashes.
        return self._saved() if self._has_map else None

    def _jumps(self, located: Located) -> bool:
        last = [*self._frames[-2:], located]
        if len(last) < 3 or any(one.map != located.map for one in last):
            return False
        before, now = (
            float(step) for step in np.linalg.norm(np.diff([one.T_map_cam[:3, 3] for one in last], axis=0), axis=1)
        )
        return now - before > _LEAST_JUMP_M and now > _JUMP_FACTOR * before

    def _saved(self) -> PeerPoses:
        """The trajectory that ORB-SLAM3 writes, each frame in the world of its map; merged maps are known from then
        on by the older one's number."""
        path = Path("trajectory.txt").absolute()
        self._slam.save_trajectory_tum(str(path))
        saved = read_saved(path)
        found = [(one, saved[key]) for one in self._frames if (key := round(one.time, _TIME_DIGITS)) in saved]
        for one, T in found:
            one.T_map_cam = T
        merged_into = merged_maps(self._frames)
        for one in self._frames:
            one.map = merged_into[one.map]
        self._map = merged_into[self._map]
        return PeerPoses(
            np.array([one.number for one, _ in found], dtype=np.int64),
            np.array([one.map for one, _ in found], dtype=np.int64),
            np.array([T for _, T in found], dtype=np.float64).reshape(-1, 4, 4),
        )


def settings_text(settings: dict[str, Any]) -> str:
    """ORB-SLAM3's settings file for a rectified pair; ``bf`` is the baseline in pixels times metres."""
    bf = settings["fx"] * settings["baseline_m"]
    return _SETTINGS.format(**settings, bf=bf, fps=max(1, round(settings["frame_rate_hz"])))


def read_saved(path: Path) -> dict[float, Float]:
    """Poses by time of a saved trajectory; the lines of lost frames repeat the time of the last pose."""
    table = np.loadtxt(path, ndmin=2)
    poses = se3.compose(se3.quaternion_to_rotation(table[:, 4:]), table[:, 1:4])
    return {round(float(time), _TIME_DIGITS): T for time, T in zip(table[::-1, 0], poses[::-1], strict=True)}


def merged_maps(frames: list[Located]) -> dict[int, int]:
    """Number of each map -> number of the map whose world its poses are in now.

    A map begins with the camera at its origin. Once ORB-SLAM3 has merged it into an older map, it does not; that older
    map is the last one before it which still does.
    """
    world: dict[int, int] = {}
    for one in frames:
        if one.map not in world:
            at_origin = np.linalg.norm(one.T_map_cam[:3, 3]) < _SAME_ORIGIN_M
            own = at_origin or not world
            world[one.map] = one.map if own else max(world.values())
    return world


if __name__ == "__main__":
    serve(OrbSlam3Peer())
