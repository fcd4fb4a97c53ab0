"""Frame-by-frame stereo odometry: predict, match with the local map, optimise, and keep the map."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bench.errors import BenchError
from bench.geometry import se3
from bench.io.torch_files import from_state, to_state
from bench.tracking import local_ba
from bench.tracking.descriptors import Ints
from bench.tracking.features import Extractor, Grey
from bench.tracking.local_map import NO_POINT, KeyframeRecord, LocalMap, View
from bench.tracking.localisation import Localiser, Matches
from bench.tracking.stereo_match import match_stereo
from bench.types import Float, StereoCamera, TrackingState

_STATE = ("T_world_cam", "velocity", "velocity_known", "timestamp", "failures", "reference_inliers")
"""What the odometry knows besides its map."""

Relocaliser = Callable[[View], tuple[int, Float] | None]
"""Recognises a place: (index of a keyframe, T_keyframe_cam (4, 4)), verified, or None."""


@dataclass(frozen=True)
class OdometrySettings:
    """Numbers of the odometry; ``plugins/trackers/stereo_orb.py`` says what each is for."""

    max_depth_baselines: float
    stereo_depth_baselines: float
    free_keyframes: int
    fixed_keyframes: int
    min_inliers: int
    min_new_map_points: int
    bridge_frames: int
    keyframe_translation_m: float
    keyframe_rotation_deg: float
    keyframe_inlier_ratio: float


@dataclass(frozen=True)
class TwoMotions:
    """Two rigid motions of one image: points that agree with each, and how far the camera moved since the newest
    keyframe as each has it, in metres. The first is believed."""

    inliers: int
    moved_m: float
    other_inliers: int
    other_moved_m: float


@dataclass(frozen=True)
class FramePose:
    """Result for one frame; ``T_world_cam`` is None when lost. ``keyframe`` and ``T_keyframe_cam`` let the pose follow
    later corrections of its reference keyframe; keyframe -1 = it hangs on none. "weak": located, but many matches
    disagree or show a second motion; or found again at ``recognised``, the keyframe whose place it is. Without inlier
    a frame is lost, but for the very first one, whose pose defines the world. ``motions``: of a frame where something
    else than the world begins to explain much of the image."""

    state: TrackingState
    T_world_cam: Float | None
    keyframe: int
    T_keyframe_cam: Float
    inliers: int
    rms_px: float
    landmarks: Ints
    recognised: int | None = None
    motions: TwoMotions | None = None


class StereoOdometry:
    """Poses of a moving stereo pair, after ORB-SLAM2 (Mur-Artal and Tardos, 2017) without loop closing.

    The world is the first frame's camera. Deterministic: the same images give the same bits. ``relocaliser`` is asked
    whenever a frame can't be located in the local map; where it knows the place, a new local map begins there.
    """

    def __init__(
        self,
        camera: StereoCamera,
        settings: OdometrySettings,
        extractor: Extractor,
        relocaliser: Relocaliser | None = None,
    ) -> None:
        self._camera = camera
        self._set = settings
        self._extractor = extractor
        self._relocaliser = relocaliser
        self._new_keyframe: KeyframeRecord | None = None
        self._threads = ThreadPoolExecutor(2, thread_name_prefix="features")
        octaves, scale_factor = extractor.octaves, extractor.scale_factor
        self._map = LocalMap(camera, settings.free_keyframes, settings.fixed_keyframes, scale_factor)
        self._localiser = Localiser(camera, self._map, octaves, scale_factor, settings.min_inliers)
        self._T_world_cam = np.eye(4)
        self._velocity = np.zeros(6)
        self._velocity_known = False
        self._timestamp: float | None = None
        self._failures = 0
        self._reference_inliers = 0

    def keyframe_pose(self, index: int) -> Float:
        """Pose (4, 4) T_world_cam of a keyframe of the odometry, as known now."""
        return self._map.poses[index]

    def keyframe_poses(self) -> Float:
        """Poses (K, 4, 4) T_world_cam of all keyframes that the odometry ever had, until the next ``track``."""
        return self._map.poses

    def moved_from(self) -> int:
        """Index of the first keyframe whose pose may have changed since this was asked last."""
        return self._map.moved_from()

    @property
    def new_keyframe(self) -> KeyframeRecord | None:
        """The keyframe that the last call of ``track`` added, or None."""
        return self._new_keyframe

    def correct(self, poses: Float) -> None:
        """Take over corrected poses (K, 4, 4) T_world_cam of all keyframes, in the order of ``keyframe_poses``.

        Map points and the current pose move along, so that tracking goes on without a break. Raises ``BenchError`` for
        a wrong number of poses or one that is not finite.
        """
        before = self.keyframe_poses()
        if poses.shape != before.shape or not np.isfinite(poses).all():
            raise BenchError(
                f"Corrected keyframe poses have shape {poses.shape}; expected {before.shape}, all finite. "
                "Correct all poses of keyframe_poses()."
            )
        if len(before) == 0:
            return
        self._T_world_cam = poses[-1] @ se3.inverse(before[-1]) @ self._T_world_cam
        self._map.correct(poses)

    def state(self) -> dict[str, Any]:
        """All that tracking goes on from, for a checkpoint."""
        own = to_state({name: getattr(self, f"_{name}") for name in _STATE})
        return {"map": self._map.state(), "localiser": self._localiser.state(), **own}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from ``state``."""
        self._map.restore(state["map"])
        self._localiser.restore(state["localiser"])
        for name, value in from_state({name: state[name] for name in _STATE}).items():
            setattr(self, f"_{name}", value)

    def track(self, left: Grey, right: Grey, timestamp: float) -> FramePose:
        """Pose of the next frame; grey images (H, W) uint8, timestamp in seconds."""
        self._new_keyframe = None
        view = self._observe(left, right)
        elapsed = 0.0 if self._timestamp is None else max(timestamp - self._timestamp, 0.0)
        predicted = self._T_world_cam @ se3.exp(self._velocity * elapsed)
        if not len(self._map.poses):
            result = self._begin(view, predicted)
        else:
            matches = self._locate(view, predicted)
            result = self._recover(view, predicted) if matches is None else self._advance(view, matches)
        self._remember(result, predicted, elapsed)
        self._timestamp = timestamp
        # What was only predicted serves to go on from, and is no answer.
        unseen = result.state == "weak" and result.inliers == 0 and result.recognised is None
        return replace(result, state="lost", T_world_cam=None) if unseen else result

    def _observe(self, left: Grey, right: Grey) -> View:
        other = self._threads.submit(self._extractor.extract, right)
        features, pyramid = self._extractor.extract(left)
        right_features, right_pyramid = other.result()
        disparity = match_stereo(features, right_features, pyramid, right_pyramid, self._camera)
        scale, sigma = self._extractor.scale_factor, self._extractor.sigma_px
        weight = np.asarray(scale ** (-2.0 * features.octave) / sigma**2, dtype=np.float64)
        return View(features, disparity, weight, self._camera.fx / self._set.stereo_depth_baselines)

    def _begin(self, view: View, predicted: Float) -> FramePose:
        """Start a local map at ``predicted``. The very first map is "ok": its pose is the definition of the world."""
        first = not len(self._map.poses)
        if np.isfinite(view.disparity).sum() < self._set.min_new_map_points:
            return self._result("lost", None)
        nothing = np.full(len(view.features), NO_POINT)
        self._add_keyframe(view, se3.inverse(predicted), nothing)
        record = self._map.keyframes[-1]
        self._reference_inliers = int((record.point_ids >= 0).sum())
        return self._result("ok" if first else "weak", predicted, record.point_ids[record.point_ids >= 0])

    def _locate(self, view: View, predicted: Float) -> Matches | None:
        if not self._map.keyframes:
            return None
        trusted = self._velocity_known and self._failures == 0
        return self._localiser.locate(view, se3.inverse(predicted), trusted)

    def _advance(self, view: View, matches: Matches) -> FramePose:
        inliers = matches.estimate.inliers
        point_ids = np.full(len(view.features), NO_POINT)
        rows, keypoints = matches.rows[inliers], matches.keypoints[inliers]
        point_ids[keypoints] = self._map.points.ids[rows]
        landmarks = np.sort(self._map.points.ids[rows])
        self._map.points.visible[matches.rows] += 1
        self._map.points.found[rows] += 1
        T_cam_world, motions = matches.estimate.T_cam_world, self._motions(matches)
        if self._needs_keyframe(T_cam_world, matches.count):
            self._add_keyframe(view, T_cam_world, point_ids)
            self._adjust()
            self._reference_inliers = int((self._map.keyframes[-1].point_ids >= 0).sum())
            T_cam_world = self._map.keyframes[-1].T_cam_world
        T_world_cam = se3.orthonormalise(se3.inverse(T_cam_world))
        state: TrackingState = "weak" if matches.doubtful else "ok"
        result = self._result(state, T_world_cam, landmarks, matches.count, matches.estimate.rms_px)
        return replace(result, motions=motions)

    def _motions(self, matches: Matches) -> TwoMotions | None:
        if matches.second is None or not matches.begins:
            return None
        newest = self._map.keyframes[-1].T_cam_world
        each = matches.estimate, matches.second
        moved = [float(np.linalg.norm((newest @ se3.inverse(e.T_cam_world))[:3, 3])) for e in each]
        return TwoMotions(matches.count, moved[0], int(matches.second.inliers.sum()), moved[1])

    def _needs_keyframe(self, T_cam_world: Float, inliers: int) -> bool:
        motion = self._map.keyframes[-1].T_cam_world @ se3.inverse(T_cam_world)
        return bool(
            np.linalg.norm(motion[:3, 3]) > self._set.keyframe_translation_m
            or np.degrees(se3.rotation_angle(motion[:3, :3])) > self._set.keyframe_rotation_deg
            or inliers < self._set.keyframe_inlier_ratio * self._reference_inliers
        )

    def _add_keyframe(self, view: View, T_cam_world: Float, point_ids: Ints) -> None:
        self._map.add_keyframe(view, T_cam_world, point_ids, self._set.max_depth_baselines * self._camera.baseline)
        self._new_keyframe = self._map.keyframes[-1]

    def _adjust(self) -> None:
        problem, rows, sources = self._map.problem()
        solution = local_ba.solve(self._camera, problem)
        self._map.accept(problem, solution, rows, sources)
        self._map.cull()

    def _recover(self, view: View, predicted: Float) -> FramePose:
        """The local map doesn't know this frame: recognise the place, else bridge."""
        place = self._relocaliser(view) if self._relocaliser is not None else None
        if place is None or np.isfinite(view.disparity).sum() < self._set.min_new_map_points:
            return self._bridge(view, predicted)
        keyframe, T_keyframe_cam = place
        T_world_cam = self._map.poses[keyframe] @ T_keyframe_cam
        if self._map.keyframes and self._localiser.drives(se3.inverse(T_world_cam), se3.inverse(predicted)):
            return self._bridge(view, predicted)
        self._map.restart()
        result = self._begin(view, T_world_cam)
        self._failures = -1  # The new map gets as many attempts as the old one had.
        return replace(result, recognised=keyframe)

    def _bridge(self, view: View, predicted: Float) -> FramePose:
        """Nothing matches: go on at constant velocity for a few frames, then begin a new map where we should be."""
        if self._failures < self._set.bridge_frames:
            return self._result("weak", predicted)
        self._map.restart()
        result = self._begin(view, predicted)
        if result.T_world_cam is not None:
            self._failures = -1
        return result

    def _result(
        self,
        state: TrackingState,
        T_world_cam: Float | None,
        landmarks: Ints | None = None,
        inliers: int = 0,
        rms_px: float = float("nan"),
    ) -> FramePose:
        keyframe = self._map.keyframes[-1].index if self._map.keyframes else -1
        relative = np.eye(4) if T_world_cam is None else T_world_cam
        if keyframe >= 0 and T_world_cam is not None:
            relative = self._map.keyframes[-1].T_cam_world @ T_world_cam
        ids = np.empty(0, dtype=np.int64) if landmarks is None else landmarks
        return FramePose(state, T_world_cam, keyframe, relative, inliers, rms_px, ids)

    def _remember(self, result: FramePose, predicted: Float, elapsed: float) -> None:
        located = result.state == "ok" or result.inliers > 0
        if located and result.T_world_cam is not None:
            if elapsed > 0 and self._failures == 0:
                self._velocity = se3.log(se3.inverse(self._T_world_cam) @ result.T_world_cam) / elapsed
                self._velocity_known = True
            self._T_world_cam, self._failures = result.T_world_cam, 0
        else:
            self._T_world_cam = predicted if result.T_world_cam is None else result.T_world_cam
            self._failures += 1
