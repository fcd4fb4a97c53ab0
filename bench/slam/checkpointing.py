"""What a checkpoint of a run holds, and how a run is resumed from one.

Of a part that does not look at the map only the answers are kept: tracking, keyframing, stereo and sky are repeated up
to the frame of the checkpoint. Where a tracker or keyframer looks at the map, its frames can't be tracked again, since
the map of then is gone: both give their state, and only the depth and sky of keyframes are computed again.
"""

from __future__ import annotations

import json
import logging
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import asdict
from typing import Any

import torch

from bench.contracts.keyframer import Keyframer
from bench.contracts.tracker import Tracker
from bench.runs.checkpoint import Snapshot
from bench.runs.folder import CHECKSUM_COLUMN
from bench.runs.memory import PeakMemory
from bench.slam.front_end import Seen, keyframe_of
from bench.slam.progress import Progress
from bench.slam.system import System
from bench.types import Keyframe

log = logging.getLogger(__name__)

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


class ReplayDiffersError(Exception):
    """The front end says something else of a frame than it did before the break."""


def snapshot_of(system: System, done: Progress, memory: PeakMemory) -> Snapshot | None:
    """The run as it is between two steps; None, and the log says why, where a part gives no state to go on from."""
    mapper = system.mapper.state()
    if mapper is None:
        log.info("no checkpoints: the mapper %s gives no state", type(system.mapper).__name__)
        return None
    seeing: dict[str, Any] = {}
    if system.in_step:
        parts: dict[str, Tracker | Keyframer] = {"tracker": system.tracker, "keyframer": system.keyframer}
        for kind, part in parts.items():
            seeing[kind] = part.state()
            if seeing[kind] is None:
                name = type(part).__name__
                log.info("no checkpoints: a part looks at the map, and the %s %s gives no state", kind, name)
                return None
    return Snapshot(
        rows=done.rows,
        mapper=mapper,
        seeing=seeing,
        keyframe_poses={number: torch.from_numpy(pose) for number, pose in done.keyframe_poses.items()},
        seconds=done.seconds,
        elapsed_s=done.elapsed_s(),
        psnr_db=done.psnr_db,
        peak_memory_gb=done.peak_memory_gb(memory),
        random=torch.get_rng_state(),
        resumed_after=done.resumed_after(),
        events=[asdict(event) for event in done.events],
    )


def resume(system: System, snapshot: Snapshot, stream: Iterator[Seen], each: Callable[[int], None]) -> None:
    """Bring the parts to where ``snapshot`` left them; ``stream`` gives the frames after it from now on.

    ``each`` is told the number of frames done again whenever it grows. Raises ``ReplayDiffersError`` where the front
    end says something else of a frame than before.
    """
    if system.in_step:
        system.tracker.restore(snapshot.seeing["tracker"])
        system.keyframer.restore(snapshot.seeing["keyframer"])
        keyframes = _seen_again(system, snapshot, each)
    else:
        keyframes = _repeated(snapshot.rows, stream, each)
    system.mapper.restore(snapshot.mapper, keyframes)
    if not system.in_step or system.stereo.temporal:
        deque(keyframes, maxlen=0)  # those that the mapper had no use for: front end or stereo must get past them
    torch.set_rng_state(snapshot.random)


def _seen_again(system: System, snapshot: Snapshot, each: Callable[[int], None]) -> Iterator[Keyframe]:
    """The keyframes until the break, with depth and sky computed again and the poses that they had when they came."""
    for position, row in enumerate(snapshot.rows):
        each(position + 1)
        if row["mapped"]:
            frame = system.dataset.frame(position)
            pose = snapshot.keyframe_poses[row["number"]].numpy()
            yield keyframe_of(system, position, frame, pose)[0]


def _repeated(rows: list[dict[str, Any]], stream: Iterator[Seen], each: Callable[[int], None]) -> Iterator[Keyframe]:
    """The keyframes of the frames in ``rows``; raises ``ReplayDiffersError`` where the front end says otherwise."""
    for count, row in enumerate(rows, 1):
        seen = next(stream, None)
        now = None if seen is None else {key: seen.row.get(key) for key in _REPEATED}
        if not _same(now, {key: row.get(key) for key in _REPEATED}):
            raise ReplayDiffersError(f"tracking frame {row['number']} again gives another result than before")
        each(count)
        if seen is not None and seen.keyframe is not None:
            yield seen.keyframe


def _same(one: object, other: object) -> bool:
    """Whether two rows are equal to the bit; NaN equals NaN, and numpy's numbers equal Python's."""
    first, second = (json.dumps(row, default=lambda number: number.item()) for row in (one, other))
    return first == second
