"""What a tracker said about a whole sequence, frame by frame, as one file of arrays."""

from __future__ import annotations

import io
import json
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from bench.cache.entry import DamagedEntryError, seal, unseal
from bench.errors import first_line
from bench.types import Event, Float, TrackingResult, Trajectory


@dataclass(frozen=True)
class TrackedFrame:
    """One frame: the tracker's answer and the seconds that it took.

    Of the trajectory after it, only what changed is kept: ``rows`` (K,) of poses and the ``poses`` (K, 4, 4) there now,
    new ones included.
    """

    digest: bytes
    result: TrackingResult
    seconds: float
    rows: npt.NDArray[np.int64]
    poses: Float


@dataclass(frozen=True)
class Correction:
    """What ``Tracker.finish`` changed: trajectory ``rows`` (K,), their ``poses`` (K, 4, 4); and what it logged."""

    rows: npt.NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    poses: Float = field(default_factory=lambda: np.zeros((0, 4, 4)))


@dataclass
class Recording:
    """A sequence of tracked frames; ``numbers`` and ``timestamps`` (N,) are those of the last trajectory, and ``last``
    is the correction that came after the last frame."""

    frames: list[TrackedFrame] = field(default_factory=list)
    numbers: npt.NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    timestamps: Float = field(default_factory=lambda: np.zeros(0))
    last: Correction = field(default_factory=lambda: Correction())
    _poses: Float = field(default_factory=lambda: np.zeros((0, 4, 4)))

    def add(self, digest: bytes, result: TrackingResult, seconds: float, after: Trajectory) -> bool:
        """Append a frame; False (and nothing is added) where the trajectory dropped a frame that it had before."""
        rows = self._changed(after)
        if rows is None:
            return False
        self.frames.append(TrackedFrame(digest, result, seconds, rows, after.T_world_cam[rows]))
        return True

    def end(self, after: Trajectory) -> bool:
        """Note what ``finish`` changed; False as in ``add``."""
        rows = self._changed(after)
        if rows is None:
            return False
        self.last = Correction(rows, after.T_world_cam[rows])
        return True

    def _changed(self, after: Trajectory) -> npt.NDArray[np.int64] | None:
        """Rows of the trajectory that are new or moved, which is known from now on; None where frames were dropped."""
        known = len(self.numbers)
        if not np.array_equal(after.numbers[:known], self.numbers):
            return None
        changed = np.ones(len(after), dtype=bool)
        changed[:known] = (after.T_world_cam[:known] != self._poses).any(axis=(1, 2))
        self.numbers, self.timestamps = after.numbers, after.timestamps
        self._poses = after.T_world_cam.copy()
        return np.flatnonzero(changed)

    def encode(self) -> bytes:
        """All of it as the bytes of an ``.npz`` file, behind their SHA-256."""
        results = [frame.result for frame in self.frames]
        nowhere = np.full((4, 4), np.nan)
        landmarks = [np.zeros(0, np.int64) if r.landmarks is None else r.landmarks for r in results]
        arrays: dict[str, npt.NDArray[Any]] = {
            "digests": np.array([np.frombuffer(frame.digest, np.uint8) for frame in self.frames]).reshape(-1, 32),
            "states": np.array([r.state for r in results], dtype=np.str_),
            "estimates": np.array([nowhere if r.T_world_cam is None else r.T_world_cam for r in results]),
            "inliers": np.array([r.inliers for r in results], dtype=np.int64),
            "reprojection_px": np.array([r.reprojection_px for r in results], dtype=np.float64),
            "without_landmarks": np.array([r.landmarks is None for r in results]),
            "landmark_counts": np.array([len(ids) for ids in landmarks], dtype=np.int64),
            "landmarks": np.concatenate([*landmarks, np.zeros(0, np.int64)]),
            "seconds": np.array([frame.seconds for frame in self.frames]),
            "events": np.array([json.dumps([asdict(event) for event in r.events]) for r in results]),
            "row_counts": np.array([len(frame.rows) for frame in self.frames], dtype=np.int64),
            "rows": np.concatenate([*(frame.rows for frame in self.frames), np.zeros(0, np.int64)]),
            "poses": np.concatenate([*(frame.poses for frame in self.frames), np.zeros((0, 4, 4))]),
            "numbers": self.numbers,
            "timestamps": self.timestamps,
            "last_rows": self.last.rows,
            "last_poses": self.last.poses,
        }
        file = io.BytesIO()
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]  # its stub takes allow_pickle for an array
        return seal(file.getvalue())

    @classmethod
    def decode(cls, content: bytes) -> Recording:
        """What ``encode`` was given, to the bit; raises ``DamagedEntryError`` for other bytes."""
        try:
            with np.load(io.BytesIO(unseal(content)), allow_pickle=False) as arrays:
                a = {name: arrays[name] for name in arrays.files}
            landmarks = np.split(a["landmarks"], np.cumsum(a["landmark_counts"])[:-1])
            rows = np.split(a["rows"], np.cumsum(a["row_counts"])[:-1])
            poses = np.split(a["poses"], np.cumsum(a["row_counts"])[:-1])
            frames = [
                TrackedFrame(
                    a["digests"][k].tobytes(),
                    TrackingResult(
                        None if a["states"][k] == "lost" else a["estimates"][k],
                        str(a["states"][k]),  # type: ignore[arg-type]  # a state, as it was written
                        int(a["inliers"][k]),
                        float(a["reprojection_px"][k]),
                        None if a["without_landmarks"][k] else landmarks[k],
                        tuple(Event(**event) for event in json.loads(str(a["events"][k]))),
                    ),
                    float(a["seconds"][k]),
                    rows[k],
                    poses[k],
                )
                for k in range(len(a["states"]))
            ]
            last = Correction(a["last_rows"], a["last_poses"])
            for changed, new_poses in [*((frame.rows, frame.poses) for frame in frames), (last.rows, last.poses)]:
                if new_poses.shape != (len(changed), 4, 4) or not (changed < len(a["numbers"])).all():
                    raise ValueError("its poses belong to no frames")
            return cls(frames, a["numbers"], a["timestamps"], last)
        except DamagedEntryError:
            raise
        except Exception as error:  # whole, but written by something else: it may hold anything
            raise DamagedEntryError(f"it is no recording ({first_line(error)})") from error
