"""The part of the system before the mapper: tracking, keyframes, stereo and sky of every frame, in order.

Unless a part of it looks at the map, it may run ahead of mapping in a thread of its own.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bench.cache import cost_of
from bench.cache.cost import Cost
from bench.contracts.tracker import Tracker
from bench.errors import BenchError
from bench.runs.events import check_events
from bench.runs.folder import CHECKSUM_COLUMN
from bench.slam.prefetch import prefetch
from bench.slam.system import System
from bench.tracking.pair_check import PairCheck
from bench.types import UNCONFIRMED, Event, Float, Keyframe, StereoFrame, TrackingResult, Trajectory

TakeStates = Callable[[PairCheck], dict[str, Any] | None]
"""Asked after each frame: what a checkpoint there keeps of the front end, or None where none is due."""


@dataclass(frozen=True)
class Seen:
    """What the front end says about one frame, which has the pose ``T_world_cam`` unless it is lost; ``keyframe`` and
    the poses of that moment for a keyframe only.

    ``states``: what the checkpoint that is due after this frame keeps of the front end; None = none is due.
    """

    frame: StereoFrame
    T_world_cam: Float | None
    row: dict[str, Any]
    events: tuple[Event, ...]
    keyframe: Keyframe | None = None
    window: tuple[int, ...] = ()
    trajectory: Trajectory | None = None
    states: dict[str, Any] | None = None


def front_end(system: System, check: PairCheck, take: TakeStates, first: int = 0) -> Generator[Seen, None, None]:
    """Tracking, keyframing, stereo and sky of every frame from position ``first`` on, in order."""
    for seen in _frames(system, check, first):
        states = take(check)
        yield seen if states is None else replace(seen, states=states)


def _frames(system: System, check: PairCheck, first: int) -> Generator[Seen, None, None]:
    doubts = [*system.dataset.to_tell(), check.about_camera()] if first == 0 else []
    for position, frame, checksum in prefetch(system.dataset, first):
        doubts.append(check.look(position, frame))
        told = tuple(Event("warning", frame.number, {"text": text}) for text in doubts if text is not None)
        doubts = []
        depth_cost = Cost(0.0, cached=False)
        if system.tracker.uses_depth:
            frame, depth_cost = with_depth(system, position, frame)
        start = time.perf_counter()
        tracking = _checked(system.tracker.track(frame), frame, system.tracker)
        cost = cost_of(system.tracker, time.perf_counter() - start)
        row: dict[str, Any] = {
            "number": frame.number,
            "timestamp": frame.timestamp,
            "state": tracking.state,
            "inliers": tracking.inliers,
            "reprojection_px": tracking.reprojection_px,
            "is_keyframe": False,
            "mapped": False,
            "heldout": system.protocol.is_held_out(frame.number),
            CHECKSUM_COLUMN: checksum,
            "tracking_s": cost.seconds,
            "tracking_cached": cost.cached,
            "stereo_s": depth_cost.seconds,
            "stereo_cached": depth_cost.cached,
        }
        events = (*told, *tracking.events)
        of_frame = (frame, tracking.T_world_cam, row)
        if tracking.state in UNCONFIRMED or row["heldout"]:
            yield Seen(*of_frame, events)
            continue
        decision = system.keyframer.update(frame, tracking)
        row["keyframe_reason"] = decision.reason
        row["is_keyframe"] = decision.is_keyframe
        if not (decision.is_keyframe and system.mapper.wants_keyframes):
            yield Seen(*of_frame, events)
            continue
        trajectory = system.tracker.trajectory()
        pose = trajectory.pose_of(frame.number)
        assert pose is not None
        # A copy: a view of it would keep the whole trajectory of this moment in memory.
        keyframe, cost = keyframe_of(system, position, frame, pose.copy())
        row["stereo_s"] += cost.seconds
        row["stereo_cached"] |= cost.cached
        if not keyframe.depth.known.any():
            events = (*events, Event("no_depth", frame.number, {"source": keyframe.depth.source}))
        keyframe = replace(keyframe, exposure=tracking.exposure)
        yield Seen(*of_frame, events, keyframe, decision.window, trajectory)


def keyframe_of(system: System, position: int, frame: StereoFrame, T_world_cam: Float) -> tuple[Keyframe, Cost]:
    """The frame with its sky, and its depth unless it has that already; and what these two took."""
    depth_cost = Cost(0.0, cached=False)
    if frame.depth is None:
        frame, depth_cost = with_depth(system, position, frame)
    depth = frame.depth
    assert depth is not None
    start = time.perf_counter()
    sky = system.sky.segment(frame.left, depth, system.dataset.camera)
    sky_cost = cost_of(system.sky, time.perf_counter() - start)
    cost = Cost(depth_cost.seconds + sky_cost.seconds, depth_cost.cached or sky_cost.cached)
    return Keyframe(frame, depth, sky, T_world_cam), cost


def with_depth(system: System, position: int, frame: StereoFrame) -> tuple[StereoFrame, Cost]:
    """The frame with its ``depth``, and what computing that took."""
    start = time.perf_counter()
    depth = system.stereo.depth(frame, position, system.dataset.camera)
    return replace(frame, depth=depth), cost_of(system.stereo, time.perf_counter() - start)


def _checked(tracking: TrackingResult, frame: StereoFrame, tracker: Tracker) -> TrackingResult:
    """The tracker's answer, if it is one; raises ``BenchError`` that says what was wrong with it."""
    pose = tracking.T_world_cam
    lost = tracking.state == "lost"
    if lost != (pose is None) or (pose is not None and (np.shape(pose) != (4, 4) or not np.isfinite(pose).all())):
        got = "None" if pose is None else f"shape {np.shape(pose)}" + ("" if np.isfinite(pose).all() else " with NaN")
        raise BenchError(
            f"{type(tracker).__name__}.track returned state '{tracking.state}' with a pose of {got} for frame "
            f"{frame.number}; expected a finite 4x4 pose, or None with state 'lost'."
        )
    check_events(tracking.events, f"{type(tracker).__name__}.track")
    return tracking
