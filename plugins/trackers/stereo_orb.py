"""Stereo visual odometry on ORB or XFeat with a local map: the bench's stand-in for the paper's ORB-SLAM2."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from bench.contracts.dataset import Dataset
from bench.contracts.tracker import Tracker
from bench.errors import BenchError, require_between, require_choice, require_least
from bench.io.array_store import ArrayStore
from bench.io.images import grey
from bench.io.torch_files import to_state
from bench.registry import PluginConfig, register
from bench.tracking.features import Extractor, OrbExtractor
from bench.tracking.frame_track import FrameTrack
from bench.tracking.growing import Archive, Growing
from bench.tracking.loops import vocabulary
from bench.tracking.loops.closer import Closure, LoopCloser
from bench.tracking.loops.pose_graph import import_gtsam
from bench.tracking.loops.settings import LoopSettings
from bench.tracking.odometry import FramePose, OdometrySettings, StereoOdometry
from bench.types import Event, Float, StereoFrame, TrackingResult, Trajectory
from bench.weights import chosen

_SETTINGS_OF = {"orb": ("weights", "device"), "xfeat": ("octaves", "scale_factor", "fast_threshold", "vocabulary")}
"""Settings that mean nothing to each kind of features."""
_INSTEAD = "a tracker that looks at depth and the map, such as tracker=splatam, or tracker=groundtruth"


@dataclass(frozen=True)
class StereoOrbConfig(PluginConfig):
    """Settings of the tracker. The defaults are tuned on car-borne stereo at 10 Hz and about 1240 x 370 pixels."""

    features: str = "orb"
    """orb, or xfeat: a small network's keypoints and descriptors, for dim places. Elsewhere ORB is as exact or more so,
    and faster."""
    keypoints: int = 2000
    """Keypoints per image: of ORB, spread over the image; of XFeat, the best."""
    octaves: int = 8
    """Levels of ORB's image pyramid; XFeat has one."""
    scale_factor: float = 1.2
    """Size of an octave of ORB's image pyramid relative to the next."""
    fast_threshold: int = 7
    """ORB's least FAST contrast, grey values 0-255; lower finds corners in dim places, higher is faster."""
    weights: str = field(default="", metadata={"path": True})
    """XFeat's file of weights; empty: the published one, from where `bgs-bench weights path xfeat` finds it."""
    device: str = "auto"
    """XFeat's: auto, cpu, cuda, cuda:1, ..."""
    max_depth_baselines: float = 100.0
    """Map points come from stereo up to this depth, in baselines (100 x 0.54 m = 54 m on KITTI)."""
    stereo_depth_baselines: float = 35.0
    """Disparities count as measurements up to this depth (19 m on KITTI, as in ORB-SLAM2's settings); beyond, the depth
    of a point comes from the camera's motion."""
    free_keyframes: int = 10
    """Keyframes that local bundle adjustment moves."""
    fixed_keyframes: int = 10
    """Older keyframes that hold it in place."""
    min_inliers: int = 25
    """Fewer inliers than this and a frame counts as not tracked."""
    min_new_map_points: int = 100
    """Stereo points that a frame needs to begin a new map after a loss."""
    bridge_frames: int = 5
    """Frames without inliers (they are lost) that go on at constant velocity before the map is given up."""
    keyframe_translation_m: float = 0.3
    """A frame becomes one of the tracker's own keyframes beyond this motion since the last one ..."""
    keyframe_rotation_deg: float = 2.0
    """... or this rotation ..."""
    keyframe_inlier_ratio: float = 0.75
    """... or when its inliers fall below this share of the points that the last keyframe saw."""
    loop_closure: bool = True
    """Whether places that are seen again correct the trajectory; false is the ablation "no loop closure". A lost camera
    recognises places either way."""
    vocabulary: str = field(default="", metadata={"path": True})
    """A file of `bgs-bench vocabulary`, of ORB's descriptors; empty = train one on the first places of each run."""
    loops: LoopSettings = field(default_factory=LoopSettings)
    """When two places count as the same."""

    def __post_init__(self) -> None:
        self._check_features()
        require_least("tracker", self, keypoints=100, octaves=1, fast_threshold=1, free_keyframes=1, fixed_keyframes=0)
        require_least("tracker", self, min_inliers=6, min_new_map_points=6, bridge_frames=0)
        require_least("tracker", self, keyframe_translation_m=0, keyframe_rotation_deg=0)
        require_between("tracker", self, 0, 1, "keyframe_inlier_ratio")
        if not 1 < self.scale_factor <= 2:
            raise BenchError(f"tracker.scale_factor={self.scale_factor} must be above 1 and at most 2; 1.2 is usual.")
        if self.fast_threshold > 254:
            raise BenchError(f"tracker.fast_threshold={self.fast_threshold} must be below 255; 7 is usual.")
        for key in ("max_depth_baselines", "stereo_depth_baselines"):
            if not getattr(self, key) > 0:
                raise BenchError(f"tracker.{key}={getattr(self, key)} must be above 0.")

    def _check_features(self) -> None:
        """A setting of features that are not in use would do nothing."""
        if self.features.isdigit():
            raise BenchError(
                f"tracker.features={self.features}: it says which features, orb or xfeat; their number is "
                f"tracker.keypoints={self.features}."
            )
        others = _SETTINGS_OF[require_choice("tracker.features", self.features, tuple(_SETTINGS_OF))]
        for each in fields(StereoOrbConfig):
            if each.name in others and getattr(self, each.name) != each.default:
                raise BenchError(
                    f"tracker.{each.name}={getattr(self, each.name)} is not for tracker.features={self.features}; "
                    "leave it out."
                )


@register("tracker", "stereo_orb", config=StereoOrbConfig)
class StereoOrb(Tracker):
    """Stereo odometry (ORB or XFeat) with local map, local bundle adjustment, loop closing; world = first camera."""

    worth_caching = True

    def __init__(self, config: StereoOrbConfig) -> None:
        if config.loop_closure:
            import_gtsam()
        self._config = config
        self._settings = OdometrySettings(**{f.name: getattr(config, f.name) for f in fields(OdometrySettings)})
        self._weights = chosen("tracker.weights", config.weights, "xfeat") if config.features == "xfeat" else None
        self._extractor = self._make_extractor()
        self._vocabulary = vocabulary.load(Path(config.vocabulary)) if config.vocabulary else None
        self._odometry: StereoOdometry | None = None
        self._closer: LoopCloser | None = None
        self._keyframe_numbers = Growing(np.empty(0, np.int64))
        self._frames = FrameTrack()
        self._archive = Archive()

    def weights(self) -> dict[str, Path]:
        """XFeat's, where it is on."""
        return {} if self._weights is None else {"network": self._weights}

    def _make_extractor(self) -> Extractor:
        config = self._config
        if self._weights is None:
            return OrbExtractor(config.keypoints, config.octaves, config.scale_factor, config.fast_threshold)
        from bench.stereo.device import choose_device  # here: they import torch
        from bench.tracking.xfeat import XFeatExtractor

        return XFeatExtractor(config.keypoints, self._weights, choose_device(config.device, "tracker.device"))

    def start(self, dataset: Dataset) -> None:
        """Begin a new sequence with its camera."""
        dataset.require_right("tracker=stereo_orb", _INSTEAD)
        self._keyframe_numbers = Growing(np.empty(0, np.int64))
        self._frames, self._archive = FrameTrack(), Archive()
        self._closer = LoopCloser(
            dataset.camera,
            self._config.loops,
            dataset.camera.fx / self._settings.max_depth_baselines,
            self._extractor.scale_factor,
            self._vocabulary,
            self._config.loop_closure,
            self._archive,
            self._extractor.sigma_px,
        )
        self._odometry = StereoOdometry(dataset.camera, self._settings, self._extractor, self._closer.relocalise)

    def use_store(self, store: ArrayStore) -> None:
        """Places, words, and poses of long ago go there."""
        self._archive.use_store(store)

    def state(self) -> dict[str, Any]:
        """All that tracking goes on from."""
        assert self._odometry is not None, "start() comes before state()"
        assert self._closer is not None
        parts = {
            "odometry": self._odometry.state(),
            "closer": self._closer.state(),
            "frames": self._frames.state(self._archive),
            **to_state({"keyframe_numbers": self._keyframe_numbers.rows}),
        }
        return parts | self._archive.state()  # last: the parts put into it what has come to rest

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from ``state``."""
        assert self._odometry is not None, "start() comes before restore()"
        assert self._closer is not None
        self._archive.restore(state)
        self._odometry.restore(state["odometry"])
        self._closer.restore(state["closer"])
        self._frames.restore(state["frames"], self._archive)
        self._keyframe_numbers = Growing(state["keyframe_numbers"].numpy())

    def track(self, frame: StereoFrame) -> TrackingResult:
        """Pose of the frame after local bundle adjustment; "weak" where it is doubtful, "lost" without an inlier."""
        assert self._odometry is not None, "start() comes before track()"
        left, right = frame.pair("tracker=stereo_orb", _INSTEAD)
        found = self._odometry.track(grey(left), grey(right), frame.timestamp)
        self._frames.add(frame.number, frame.timestamp, found)
        pose, events = found.T_world_cam, []
        if found.recognised is not None:
            events.append(Event("relocalised", frame.number, {"to_frame": self._number_of(found.recognised)}))
        if found.motions is not None:
            events.append(Event("second_motion", frame.number, asdict(found.motions)))
        closure = self._closed_loop(frame.number)
        if closure is not None:
            events.append(self._event(closure))
            pose = pose if pose is None else self._corrected(found)
        return TrackingResult(pose, found.state, found.inliers, found.rms_px, found.landmarks, tuple(events))

    def _closed_loop(self, number: int) -> Closure | None:
        """Show the frame's keyframe, if it is one, to the loop closer; the closure that corrected all poses, if any."""
        assert self._odometry is not None
        assert self._closer is not None
        keyframe = self._odometry.new_keyframe
        if keyframe is None:
            return None
        self._keyframe_numbers.append(number)
        closure = self._closer.add(keyframe, self._odometry.keyframe_poses())
        if closure is not None:
            self._odometry.correct(closure.poses)
        return closure

    def _event(self, closure: Closure) -> Event:
        values = {
            "to_frame": self._number_of(closure.old),
            "inliers": closure.inliers,
            "loops_believed": closure.loops,
            "loops": closure.known,
            "keyframes_moved": closure.moved,
            "keyframes": len(closure.poses),
            "farthest_m": closure.farthest_m,
        }
        return Event("loop_closed", self._number_of(closure.new), values)

    def _number_of(self, keyframe: int) -> int:
        """Of its frame."""
        return int(self._keyframe_numbers.rows[keyframe])

    def trajectory(self) -> Trajectory:
        """Poses that follow all later corrections of the keyframes they hang on."""
        assert self._odometry is not None, "start() comes before trajectory()"
        return self._frames.trajectory(self._odometry.keyframe_poses(), self._odometry.moved_from())

    def _corrected(self, found: FramePose) -> Float:
        assert self._odometry is not None
        return self._odometry.keyframe_pose(found.keyframe) @ found.T_keyframe_cam
