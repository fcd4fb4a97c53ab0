"""Frame-by-frame stereo odometry: predict, match with the local map, optimise, and keep the map."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from bench.geometry import se3
from bench.tracking import local_ba
from bench.tracking.features import Grey, Ints, OrbExtractor
from bench.tracking.local_map import NO_POINT, LocalMap, View
from bench.tracking.matching import KeypointIndex, choose_one_to_one, hamming
from bench.tracking.pose_optimization import PoseEstimate, optimise_pose
from bench.tracking.relocalise import match_descriptors, pose_by_pnp
from bench.tracking.stereo_match import match_stereo
from bench.types import Float, StereoCamera, TrackingState

_WIDE_RADIUS, _NARROW_RADIUS = 12.0, 4.0
"""Search radii in pixels of the octave: around the predicted pose, and around the pose optimised once."""
_MAX_HAMMING = 80
_RATIO, _FALLBACK_RATIO = 0.85, 0.9


@dataclass(frozen=True)
class OdometrySettings:
    """Numbers of the odometry; ``plugins/trackers/stereo_orb.py`` says what each is for."""

    features: int
    octaves: int
    scale_factor: float
    fast_threshold: int
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
class FramePose:
    """Result for one frame; ``T_world_cam`` is None when lost. ``keyframe`` and ``T_keyframe_cam`` let the pose follow
    later corrections of its reference keyframe; keyframe -1 = it hangs on none."""

    state: TrackingState
    T_world_cam: Float | None
    keyframe: int
    T_keyframe_cam: Float
    inliers: int
    rms_px: float
    landmarks: Ints


@dataclass
class _Matches:
    """Pairs of map rows and keypoints with the pose that they gave."""

    rows: Ints
    keypoints: Ints
    estimate: PoseEstimate

    @property
    def count(self) -> int:
        return int(self.estimate.inliers.sum())


class StereoOdometry:
    """Poses of a moving stereo pair, after ORB-SLAM2 (Mur-Artal and Tardos, 2017) without loop closing.

    The world is the first frame's camera. Deterministic: the same images give the same bits.
    """

    def __init__(self, camera: StereoCamera, settings: OdometrySettings) -> None:
        self._camera = camera
        self._set = settings
        self._extractors = tuple(
            OrbExtractor(settings.features, settings.octaves, settings.scale_factor, settings.fast_threshold)
            for _ in range(2)
        )
        self._threads = ThreadPoolExecutor(2, thread_name_prefix="orb")
        self._map = LocalMap(camera, settings.free_keyframes, settings.fixed_keyframes, settings.scale_factor)
        self._T_world_cam = np.eye(4)
        self._velocity = np.zeros(6)
        self._timestamp: float | None = None
        self._failures = 0
        self._reference_inliers = 0

    def keyframe_pose(self, index: int) -> Float:
        """Pose (4, 4) T_world_cam of a keyframe of the odometry, as known now."""
        return self._map.poses[index]

    def track(self, left: Grey, right: Grey, timestamp: float) -> FramePose:
        """Pose of the next frame; grey images (H, W) uint8, timestamp in seconds."""
        view = self._observe(left, right)
        elapsed = 0.0 if self._timestamp is None else max(timestamp - self._timestamp, 0.0)
        predicted = self._T_world_cam @ se3.exp(self._velocity * elapsed)
        if not self._map.keyframes:
            result = self._begin(view, predicted)
        else:
            matches = self._locate(view, se3.inverse(predicted))
            result = self._bridge(view, predicted) if matches is None else self._advance(view, matches)
        self._remember(result, predicted, elapsed)
        self._timestamp = timestamp
        return result

    def _observe(self, left: Grey, right: Grey) -> View:
        other = self._threads.submit(self._extractors[1].extract, right)
        features, pyramid = self._extractors[0].extract(left)
        right_features, right_pyramid = other.result()
        disparity = match_stereo(features, right_features, pyramid, right_pyramid, self._camera)
        weight = np.asarray(self._set.scale_factor ** (-2.0 * features.octave), dtype=np.float64)
        return View(features, disparity, weight, self._camera.fx / self._set.stereo_depth_baselines)

    def _begin(self, view: View, predicted: Float) -> FramePose:
        """Start a local map at ``predicted``. The very first map is "ok": its pose is the definition of the world."""
        first = not self._map.poses
        if np.isfinite(view.disparity).sum() < self._set.min_new_map_points:
            return self._result("lost", None)
        nothing = np.full(len(view.features), NO_POINT)
        self._add_keyframe(view, se3.inverse(predicted), nothing)
        record = self._map.keyframes[-1]
        self._reference_inliers = int((record.point_ids >= 0).sum())
        return self._result("ok" if first else "weak", predicted, record.point_ids[record.point_ids >= 0])

    def _locate(self, view: View, T_cam_world: Float) -> _Matches | None:
        """Pose from the map: around the prediction, else from descriptors alone; None without enough inliers."""
        index = KeypointIndex(view.features.xy)
        for start in (lambda: T_cam_world, lambda: self._pose_from_descriptors(view)):
            pose = start()
            if pose is None:
                continue
            for radius in (_WIDE_RADIUS, _NARROW_RADIUS):
                matches = self._match_map(view, index, pose, radius)
                if matches.count < self._set.min_inliers:
                    break
                pose = matches.estimate.T_cam_world
            else:
                return matches
        return None

    def _match_map(self, view: View, index: KeypointIndex, T: Float, radius: float) -> _Matches:
        camera, points, features = self._camera, self._map.points, view.features
        in_camera = points.position @ T[:3, :3].T + T[:3, 3]
        z = np.maximum(in_camera[:, 2], 1e-6)
        u = camera.fx * in_camera[:, 0] / z + camera.cx
        v = camera.fy * in_camera[:, 1] / z + camera.cy
        in_view = (in_camera[:, 2] > 0.1) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
        rows = np.flatnonzero(in_view)
        distance = np.linalg.norm(in_camera[rows], axis=1)
        octave = np.log(points.reach[rows] / distance) / np.log(self._set.scale_factor)
        reach = radius * self._set.scale_factor ** np.clip(octave, 0, self._set.octaves - 1)
        u, v, z = u[rows], v[rows], z[rows]
        query, keypoint = index.pairs(u - reach, u + reach, v - reach, v + reach)
        likely = np.abs(features.octave[keypoint] - octave[query]) <= 1.5
        likely &= ~(np.abs(view.disparity[keypoint] - camera.fx * camera.baseline / z[query]) > reach[query])
        query, keypoint = query[likely], keypoint[likely]
        bits = hamming(points.descriptor[rows[query]], features.descriptors[keypoint])
        query, keypoint, _ = choose_one_to_one(query, keypoint, bits, _MAX_HAMMING, _RATIO)
        matched = rows[query]
        estimate = optimise_pose(camera, points.position[matched], view.observations(keypoint), T)
        return _Matches(matched, keypoint, estimate)

    def _pose_from_descriptors(self, view: View) -> Float | None:
        row, keypoint = match_descriptors(self._map.points.descriptor, view.features.descriptors, _FALLBACK_RATIO)
        uv, position = view.features.xy[keypoint], self._map.points.position[row]
        return pose_by_pnp(self._camera, position, uv)

    def _advance(self, view: View, matches: _Matches) -> FramePose:
        inliers = matches.estimate.inliers
        point_ids = np.full(len(view.features), NO_POINT)
        rows, keypoints = matches.rows[inliers], matches.keypoints[inliers]
        point_ids[keypoints] = self._map.points.ids[rows]
        landmarks = np.sort(self._map.points.ids[rows])
        self._map.points.visible[matches.rows] += 1
        self._map.points.found[rows] += 1
        T_cam_world = matches.estimate.T_cam_world
        if self._needs_keyframe(T_cam_world, matches.count):
            self._add_keyframe(view, T_cam_world, point_ids)
            self._adjust()
            self._reference_inliers = int((self._map.keyframes[-1].point_ids >= 0).sum())
            T_cam_world = self._map.keyframes[-1].T_cam_world
        T_world_cam = se3.orthonormalise(se3.inverse(T_cam_world))
        return self._result("ok", T_world_cam, landmarks, matches.count, matches.estimate.rms_px)

    def _needs_keyframe(self, T_cam_world: Float, inliers: int) -> bool:
        motion = self._map.keyframes[-1].T_cam_world @ se3.inverse(T_cam_world)
        return bool(
            np.linalg.norm(motion[:3, 3]) > self._set.keyframe_translation_m
            or np.degrees(se3.rotation_angle(motion[:3, :3])) > self._set.keyframe_rotation_deg
            or inliers < self._set.keyframe_inlier_ratio * self._reference_inliers
        )

    def _add_keyframe(self, view: View, T_cam_world: Float, point_ids: Ints) -> None:
        self._map.add_keyframe(view, T_cam_world, point_ids, self._set.max_depth_baselines * self._camera.baseline)

    def _adjust(self) -> None:
        problem, rows, sources = self._map.problem()
        solution = local_ba.solve(self._camera, problem)
        self._map.accept(problem, solution, rows, sources)
        self._map.cull()

    def _bridge(self, view: View, predicted: Float) -> FramePose:
        """Nothing matches: go on at constant velocity for a few frames, then begin a new map where we should be."""
        if self._failures < self._set.bridge_frames:
            return self._result("weak", predicted)
        self._map.restart()
        result = self._begin(view, predicted)
        if result.T_world_cam is not None:
            self._failures = -1  # The new map gets as many attempts as the old one had.
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
        if result.state == "ok":
            assert result.T_world_cam is not None
            if elapsed > 0 and self._failures == 0:
                self._velocity = se3.log(se3.inverse(self._T_world_cam) @ result.T_world_cam) / elapsed
            self._T_world_cam, self._failures = result.T_world_cam, 0
        else:
            self._T_world_cam = predicted
            self._failures += 1
