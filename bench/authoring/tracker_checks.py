"""The contract of a tracker, on a few frames of a data set: states, poses, the trajectory, and whether it tracks."""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, get_args

import numpy as np

from bench import registry
from bench.authoring import probes
from bench.authoring.poses import require_pose, require_trajectory
from bench.authoring.shown_map import ShownMap
from bench.authoring.verdict import Candidate, Check, ContractBrokenError, Note
from bench.evaluation.trajectory import absolute_trajectory_error
from bench.io.array_store import ArrayStore
from bench.types import DepthMap, StereoFrame, TrackingResult, TrackingState, Trajectory

FRAMES = 8
_STATES = get_args(TrackingState)


@dataclass(frozen=True)
class Drive:
    """What a tracker said about the first frames: one result per frame, the trajectory at the end, ms per frame."""

    results: list[TrackingResult]
    trajectory: Trajectory
    ms: float


@dataclass
class Subject:
    """The tracker under test and the frames it is tested with."""

    candidate: Candidate

    @cached_property
    def dataset(self) -> Any:
        """The frames' data set; the built-in street no faster than a third of what the tracker says that it reaches."""
        config, slower = self.candidate.run.plugin("dataset"), self.reach_m / 3
        if not self.candidate.names_data and slower < vars(config)["speed_m"]:
            changed: dict[str, Any] = {"speed_m": slower}
            config = replace(config, **changed)
        dataset = registry.build(config, "dataset")
        probes.require_frames(dataset, 3)
        return dataset

    @cached_property
    def reach_m(self) -> float:
        return float(self.candidate.build().reach_m)

    @cached_property
    def frames(self) -> list[StereoFrame]:
        frames = [self.dataset.frame(position) for position in range(min(FRAMES, len(self.dataset)))]
        return self._with_depth(frames) if self.candidate.build().uses_depth else frames

    def _with_depth(self, frames: list[StereoFrame]) -> list[StereoFrame]:
        """The depth of the run's stereo plugin for each; where the data set knows it exactly, that."""
        if self.dataset.true_depth(0) is not None:
            depths = [DepthMap(self.dataset.true_depth(k), "truth") for k in range(len(frames))]
        else:
            stereo = self.candidate.other("stereo")
            stereo.start(self.dataset)
            depths = [stereo.depth(frame, k, self.dataset.camera) for k, frame in enumerate(frames)]
        return [replace(frame, depth=depth) for frame, depth in zip(frames, depths, strict=True)]

    @cached_property
    def drive(self) -> Drive:
        return self.drive_again()

    def started(self) -> tuple[Any, ShownMap | None]:
        """A fresh instance, and the map that it looks at; None where it does not."""
        tracker = self.candidate.build()
        shown = ShownMap(self.candidate, self.dataset) if tracker.uses_map else None
        self._begin(tracker, shown, self._new_store())
        return tracker, shown

    def _begin(self, tracker: Any, shown: ShownMap | None, store: ArrayStore) -> None:
        tracker.start(self.dataset)
        if shown is not None:
            tracker.use_map(shown.mapper.view())
        self._store = store
        tracker.use_store(store)

    def _new_store(self) -> ArrayStore:
        return ArrayStore(Path(tempfile.mkdtemp(dir=self._stores.name)))

    @cached_property
    def _stores(self) -> tempfile.TemporaryDirectory[str]:
        return tempfile.TemporaryDirectory(prefix="bgs-check-")

    @staticmethod
    def map(shown: ShownMap | None, frame: StereoFrame, tracker: Any) -> None:
        """Let the map learn from a tracked frame, as in a run where every frame is a keyframe."""
        known = tracker.trajectory()
        pose = known.pose_of(frame.number)
        if shown is not None and pose is not None:
            shown.learn(frame, pose, known.numbers.tolist()[-5:], known)

    def drive_again(self, break_after: int | None = None) -> Drive:
        """The frames through a fresh instance, every answer checked.

        With ``break_after`` another instance goes on after so many frames, from what a checkpoint would hold.
        """
        tracker, shown = self.started()
        results, seconds, tracked = [], 0.0, []
        for frame in self.frames:
            start = time.perf_counter()
            result = tracker.track(frame)
            seconds += time.perf_counter() - start
            _require_result(result, frame)
            results.append(result)
            tracked += [] if result.state == "lost" else [frame.number]
            require_trajectory(tracker.trajectory(), tracked, f"trajectory() after frame {frame.number}", "trajectory")
            self.map(shown, frame, tracker)
            if len(results) == break_after:
                tracker = self._resumed(tracker, shown, self.frames[break_after])
        tracker.finish()
        require_trajectory(tracker.trajectory(), tracked, "trajectory() after finish()", "finish")
        return Drive(results, tracker.trajectory(), seconds / len(self.frames) * 1e3)

    def _resumed(self, tracker: Any, shown: ShownMap | None, next_frame: StereoFrame) -> Any:
        """A fresh instance with what a checkpoint holds, written when the other one had tracked a frame more."""
        state, store = tracker.state(), self._store
        tracker.track(next_frame)
        state = probes.through_a_file(state)
        tracker.finish()
        store.discard(state.get("stored", ()))
        tracker = self.candidate.build()
        self._begin(tracker, shown, store)
        tracker.restore(state)
        return tracker


def _require_result(result: Any, frame: StereoFrame) -> None:
    what = f"track() of frame {frame.number}"
    if not isinstance(result, TrackingResult):
        raise ContractBrokenError(
            f"{what} is {type(result).__name__}",
            "bench.types.TrackingResult",
            'return TrackingResult(T_world_cam, "ok", inliers)',
            "track",
        )
    if result.state not in _STATES or (result.state == "lost") != (result.T_world_cam is None):
        pose = "no pose" if result.T_world_cam is None else "a pose"
        raise ContractBrokenError(
            f"{what} has state {result.state!r} with {pose}",
            f"one of {', '.join(_STATES)}; None as pose exactly when it is lost",
            'TrackingResult(None, "lost")',
            "track",
        )
    if result.T_world_cam is not None:
        require_pose(result.T_world_cam, f"the pose of frame {frame.number}", "track")
    landmarks = result.landmarks
    if landmarks is not None and (
        np.asarray(landmarks).dtype != np.int64 or np.ndim(landmarks) != 1 or len(np.unique(landmarks)) < len(landmarks)
    ):
        raise ContractBrokenError(
            f"{what} has landmarks {np.asarray(landmarks).dtype} {np.shape(landmarks)}",
            "ids of the map points seen in this frame: int64 (N,), each once; or None",
            "np.unique(ids).astype(np.int64)",
            "track",
        )


def _answers(subject: Subject) -> str:
    states = [result.state for result in subject.drive.results]
    counts = ", ".join(f"{states.count(state)} {state}" for state in _STATES if state in states)
    return f"{len(states)} frames of {subject.dataset.label}: {counts}; the trajectory agrees after each"


def _times(subject: Subject) -> str:
    times = {frame.number: frame.timestamp for frame in subject.frames}
    trajectory = subject.drive.trajectory
    expected = np.array([times[number] for number in trajectory.numbers.tolist()])
    if not np.allclose(trajectory.timestamps, expected, atol=1e-6):
        raise ContractBrokenError(
            f"trajectory() has timestamps {np.round(trajectory.timestamps[:4], 3).tolist()}",
            f"those of the frames, in seconds: {np.round(expected[:4], 3).tolist()}",
            "keep frame.timestamp beside the pose",
            "trajectory",
        )
    return "those of the frames"


def _inputs(subject: Subject) -> str:
    tracker, _ = subject.started()
    for frame in subject.frames[:2]:
        left, right = frame.left.copy(), None if frame.right is None else frame.right.copy()
        depth = None if frame.depth is None else replace(frame.depth, depth=frame.depth.depth.copy())
        tracker.track(StereoFrame(frame.number, frame.timestamp, left, right, depth))
        probes.require_untouched("the input left", frame.left, left, "track")
        if right is not None:
            probes.require_untouched("the input right", frame.right, right, "track")
        if frame.depth is not None and depth is not None:
            probes.require_untouched("the input depth", frame.depth.depth, depth.depth, "track")
    return "left as they were"


def _repeats(subject: Subject) -> str:
    again = probes.in_thread(subject.drive_again)
    first, second = subject.drive.trajectory, again.trajectory
    probes.require_same(first.T_world_cam, second.T_world_cam, "a fresh instance in a background thread", "track")
    return "a fresh instance in a background thread: the same bits"


def _resumes(subject: Subject) -> str | Note:
    tracker, _ = subject.started()
    if tracker.state() is None:
        if not tracker.uses_map:
            return "it gives no state(): its frames are tracked again after a kill"
        return Note("it looks at the map and gives no state(): runs with it have no checkpoints")
    again = subject.drive_again(break_after=len(subject.frames) // 2)
    first, second = subject.drive.trajectory, again.trajectory
    probes.require_same(first.T_world_cam, second.T_world_cam, "with a break, and without", "restore")
    return f"a fresh instance goes on from state() after {len(subject.frames) // 2} frames: the same bits"


def _accuracy(subject: Subject) -> str | Note:
    truth = subject.dataset.ground_truth()
    tracked = subject.drive.trajectory
    if not len(tracked):
        raise ContractBrokenError(
            f"all {len(subject.frames)} frames are lost",
            "poses of an easy drive",
            "does it need more frames or larger images? Name another data set: dataset=kitti dataset.root=...",
            "track",
        )
    if truth is None or len(tracked) < 3:
        return Note(f"{len(tracked)} frames tracked; the data set has no poses to compare them with, or too few are")
    result = absolute_trajectory_error(tracked, truth, "se3")
    if isinstance(result, str):
        return Note(result)
    true_poses = truth.T_world_cam[np.isin(truth.numbers, result.numbers)]
    step = _largest_step(truth.T_world_cam[np.isin(truth.numbers, [frame.number for frame in subject.frames])])
    if step > subject.reach_m:
        return Note(f"not judged: it says that it reaches {subject.reach_m:.2g} m a frame, and these move {step:.2g} m")
    centres = true_poses[:, :3, 3]
    static = float(np.sqrt(((centres - centres.mean(axis=0)) ** 2).sum(axis=1).mean()))
    ratio = _length(tracked.T_world_cam) / max(_length(true_poses), 1e-9)
    text = f"ATE {result.rmse_m:.3f} m (a camera that never moves: {static:.3f} m), path length {ratio:.2f} of the true"
    text += f"; {step:.2g} m a frame" if np.isfinite(subject.reach_m) else ""
    if result.rmse_m > 0.5 * static and static > min(0.05, subject.reach_m / 2):
        raise ContractBrokenError(
            text,
            "less than half the error of a camera that never moves",
            "camera to world or world to camera? axes x right, y down, z forward? metres (path length 1.00)?",
            "track",
        )
    return text


def _largest_step(poses: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1).max())


def _length(poses: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1).sum())


def _speed(subject: Subject) -> Note:
    camera = subject.dataset.camera
    return Note(f"{subject.drive.ms:.1f} ms per frame at {camera.width}x{camera.height}")


def checks_of(subject: Subject) -> tuple[Check[Subject], ...]:
    """All checks of a tracker."""
    return (
        Check("states and poses", _answers, essential=True),
        Check("timestamps", _times),
        Check("inputs", _inputs),
        Check("determinism", _repeats),
        Check("resumes", _resumes),
        Check("accuracy", _accuracy),
        Check("speed", _speed),
    )
