"""What a checkpoint of a run holds, and how a run is resumed from one.

Where tracker and keyframer give their states, the front end goes on after the frame of the checkpoint, and the depth
and sky of earlier keyframes are computed again only if the mapper asks for them. Else tracking, keyframing, stereo and
sky are repeated up to that frame, which can't be done where one of the two looks at the map: the map of then is gone.
Once all frames are tracked, only the trajectory is needed.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

import torch

from bench.contracts.dataset import Dataset
from bench.contracts.tracker import Tracker
from bench.errors import BenchError
from bench.io.array_store import DamagedError
from bench.io.torch_files import from_state, to_state
from bench.runs.checkpoint import Checkpoints, Snapshot
from bench.runs.folder import CHECKSUM_COLUMN
from bench.runs.memory import PeakMemory
from bench.slam.front_end import Seen, keyframe_of, with_depth
from bench.slam.progress import Progress
from bench.slam.system import System
from bench.tracking.pair_check import PairCheck
from bench.types import Keyframe, StereoFrame, TrackingResult, Trajectory

# What the front end must say again, to the bit, when a run is resumed.
_REPEATED = (
    "number",
    "state",
    "inliers",
    "reprojection_px",
    "heldout",
    CHECKSUM_COLUMN,
    "is_keyframe",
    "keyframe_reason",
)


class CannotResumeError(Exception):
    """The run can't go on from its checkpoint: the message says why."""


class Tracked(Tracker):
    """In place of a tracker all of whose frames are done: what is left of it is the trajectory."""

    def __init__(self, trajectory: Trajectory, uses_depth: bool) -> None:
        self._trajectory = trajectory
        self.uses_depth = uses_depth

    def start(self, dataset: Dataset) -> None:
        """Nothing is left to begin."""

    def track(self, frame: StereoFrame) -> TrackingResult:
        """No frame follows."""
        raise AssertionError("all frames are tracked")

    def trajectory(self) -> Trajectory:
        """As it was when the run was broken."""
        return self._trajectory


def states_of_front_end(system: System, checkpoints: Checkpoints, check: PairCheck) -> dict[str, Any] | None:
    """What a checkpoint keeps of the front end as it is between two frames: its parts' states, and the sets of the
    tracker's store that they have no use for; empty where frames are to be repeated. None = no checkpoint is due."""
    if not checkpoints.due():
        return None
    tracker, keyframer = system.tracker.state(), system.keyframer.state()
    if tracker is not None and keyframer is not None:
        unused = checkpoints.unused("tracker", tracker)
        return {"tracker": tracker, "keyframer": keyframer, "check": check.state(), "unused": unused}
    if system.in_step:
        kind, part = ("tracker", system.tracker) if tracker is None else ("keyframer", system.keyframer)
        checkpoints.give_up(f"a part looks at the map, and the {kind} {type(part).__name__} gives no state")
        return None
    return {}


def snapshot_of(
    system: System, done: Progress, memory: PeakMemory, checkpoints: Checkpoints, seeing: dict[str, Any] | None
) -> Snapshot | None:
    """The run as it is between two steps; None, and the log says why, where the mapper gives no state to go on from, or
    can't write what that builds on.

    ``seeing`` is what the front end gave after the newest frame; None once all frames are tracked.
    """
    try:
        mapper = system.mapper.state()
    except BenchError as error:
        checkpoints.failed(error)
        return None
    if mapper is None:
        checkpoints.give_up(f"the mapper {type(system.mapper).__name__} gives no state")
        return None
    obsolete = {"mapper": checkpoints.unused("mapper", mapper)}
    if seeing is None:
        seeing = {"trajectory": to_state(vars(system.tracker.trajectory()))}
    elif seeing:
        obsolete["tracker"] = seeing["unused"]
        seeing = {kind: state for kind, state in seeing.items() if kind != "unused"}
    return Snapshot(
        rows=done.rows,
        mapper=mapper,
        seeing=seeing,
        obsolete=obsolete,
        keyframe_poses=done.keyframe_poses,
        seconds=done.seconds,
        elapsed_s=done.elapsed_s(),
        psnr_db=done.psnr_db,
        peak_memory_gb=done.peak_memory_gb(memory),
        random=torch.get_rng_state(),
        resumed_after=done.resumed_after(),
        optimised=done.optimised,
        events=done.events,
    )


def restore(system: System, snapshot: Snapshot, check: PairCheck, each: Callable[[int], None]) -> None:
    """Bring all parts to where ``snapshot``, which holds the front end's states, left them.

    ``each`` is told the number of frames done again whenever it grows. Raises ``CannotResumeError``.
    """
    try:
        if "trajectory" in snapshot.seeing:
            system.tracker.finish()
            uses_depth = system.tracker.uses_depth
            system.tracker = Tracked(Trajectory(**from_state(snapshot.seeing["trajectory"])), uses_depth)
        else:
            system.tracker.restore(snapshot.seeing["tracker"])
            system.keyframer.restore(snapshot.seeing["keyframer"])
            check.restore(snapshot.seeing["check"])
        keyframes = _seen_again(system, snapshot, each)
        system.mapper.restore(snapshot.mapper, keyframes)
    except DamagedError as error:
        raise CannotResumeError(str(error)) from error
    if system.stereo.temporal:
        deque(keyframes, maxlen=0)  # those that the mapper had no use for: stereo must get past them
    torch.set_rng_state(snapshot.random)


def repeat(system: System, snapshot: Snapshot, stream: Iterator[Seen], each: Callable[[int], None]) -> None:
    """Bring all parts to where ``snapshot``, which holds no states of the front end, left them: ``stream`` gives the
    frames from the first one on, and those after it from then on. Raises and tells ``each`` as ``restore``."""
    keyframes = _repeated(snapshot.rows, stream, each)
    try:
        system.mapper.restore(snapshot.mapper, keyframes)
    except DamagedError as error:
        raise CannotResumeError(str(error)) from error
    deque(keyframes, maxlen=0)  # those that the mapper had no use for: the front end must get past them
    torch.set_rng_state(snapshot.random)


def _seen_again(system: System, snapshot: Snapshot, each: Callable[[int], None]) -> Iterator[Keyframe]:
    """The keyframes until the break, with depth and sky computed again and the poses that they had when they came."""
    poses = iter(snapshot.keyframe_poses)
    every_depth = system.tracker.uses_depth and system.stereo.temporal
    for position, row in enumerate(snapshot.rows):
        each(position + 1)
        if not (row["mapped"] or every_depth):
            continue
        frame = system.dataset.frame(position)
        if every_depth:
            frame = with_depth(system, position, frame)[0]
        if row["mapped"]:
            yield keyframe_of(system, position, frame, next(poses))[0]


def _repeated(rows: list[dict[str, Any]], stream: Iterator[Seen], each: Callable[[int], None]) -> Iterator[Keyframe]:
    """The keyframes of the frames in ``rows``; raises ``CannotResumeError`` where the front end says otherwise."""
    for count, row in enumerate(rows, 1):
        seen = next(stream, None)
        now = None if seen is None else {key: seen.row.get(key) for key in _REPEATED}
        if not _same(now, {key: row.get(key) for key in _REPEATED}):
            raise CannotResumeError(
                f"tracking frame {row['number']} again gives another result than before; is a plugin not deterministic?"
            )
        each(count)
        if seen is not None and seen.keyframe is not None:
            yield seen.keyframe


def _same(one: object, other: object) -> bool:
    """Whether two rows are equal to the bit; NaN equals NaN, and numpy's numbers equal Python's."""
    first, second = (json.dumps(row, default=lambda number: number.item()) for row in (one, other))
    return first == second
