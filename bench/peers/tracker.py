"""A tracker whose work a peer process does: crashes, hangs and nonsense of the peer are lost frames, not a dead run."""

from __future__ import annotations

import logging
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.contracts.dataset import Dataset
from bench.contracts.tracker import Tracker
from bench.errors import BenchError
from bench.geometry import se3
from bench.io.images import grey
from bench.peers.messages import Message
from bench.peers.process import PeerFailure, PeerProcess
from bench.types import Float, StereoFrame, TrackingResult, TrackingState, Trajectory

log = logging.getLogger(__name__)

_INSTEAD = "tracker=groundtruth, or tracker=trajectory_file with poses of another system"

_ROTATION_TOLERANCE = 1e-3
"""How far R R^T of a peer's pose may be from the identity; many peers compute in float32."""

MapKey = tuple[int, int]
"""Which start of the peer, and which of its maps."""


@dataclass(frozen=True)
class PeerLimits:
    """Seconds that the peer may take to start (and to finish), and for a frame; how often it is started again."""

    start_timeout_s: float
    timeout_s: float
    restarts: int


@dataclass
class _Tracked:
    """A frame that the peer has located: ``position`` counts all frames, ``key`` says in which map."""

    position: int
    number: int
    timestamp: float
    key: MapKey
    T_map_cam: Float


class PeerTracker(Tracker):
    """Sends the frames to a peer process and puts its maps into one world.

    The first map's world is the world. A later map (the peer lost its place and began anew, or crashed and was started
    again) is put where constant velocity would have brought the camera; its first frame counts as "predicted". After
    ``limits.restarts`` failures all further frames are lost. A subclass says what the peer is told at its start.
    """

    def __init__(self, name: str, command: Sequence[str], limits: PeerLimits) -> None:
        self._name, self._command, self._limits = name, command, limits
        self._peer: PeerProcess | None = None
        self._settings: dict[str, Any] = {}
        self._forget()

    @abstractmethod
    def peer_settings(self, dataset: Dataset) -> dict[str, Any]:
        """Plain JSON values for ``Peer.start``."""

    def start(self, dataset: Dataset) -> None:
        """Start the peer; raises ``BenchError`` with its own words when it can't."""
        dataset.require_right(f"tracker={self._name}", _INSTEAD)
        self._close()
        self._forget()
        self._settings = self.peer_settings(dataset)
        self._frames_expected = len(dataset)
        try:
            self._start_peer()
        except PeerFailure as failure:
            self._close()
            raise BenchError(
                f"tracker={self._name}: its process {failure}. Correct the tracker's settings, or use "
                "tracker=stereo_orb."
            ) from failure

    def track(self, frame: StereoFrame) -> TrackingResult:
        """Pose of the frame as the peer has it; "predicted" where a new map begins, "lost" without a usable answer."""
        self._frames_seen += 1
        if self._failures > self._limits.restarts:
            return TrackingResult(None, "lost")
        try:
            if self._peer is None:
                log.warning("frame %d: %s is started again; it begins a new map", frame.number, self._name)
                self._start_peer()
            return self._locate(frame)
        except PeerFailure as failure:
            self._count_failure(f"frame {frame.number}", failure)
            return TrackingResult(None, "lost")

    def finish(self) -> None:
        """Take over the peer's final poses, if it was shown all frames, and end its process."""
        if self._peer is None:
            return
        try:
            if self._frames_seen >= self._frames_expected:
                self._take_corrections(self._ask(Message("finish"), self._limits.start_timeout_s, "finished"))
        except PeerFailure as failure:
            log.warning("at the end, %s %s; the poses are those that it gave frame by frame", self._name, failure)
        finally:
            self._close()

    def trajectory(self) -> Trajectory:
        """Poses of the located frames; after ``finish`` the peer's final ones."""
        tracked = sorted(self._tracked.values(), key=lambda one: one.position)
        return Trajectory(
            np.array([self._in_world(one) for one in tracked], dtype=np.float64).reshape(-1, 4, 4),
            np.array([one.number for one in tracked], dtype=np.int64),
            np.array([one.timestamp for one in tracked], dtype=np.float64),
        )

    def _forget(self) -> None:
        self._frames_expected = self._frames_seen = self._starts = self._failures = 0
        self._tracked: dict[int, _Tracked] = {}
        self._worlds: dict[MapKey, Float] = {}
        self._told: set[str] = set()

    def _start_peer(self) -> None:
        self._peer = PeerProcess(self._command)
        self._starts += 1
        self._ask(Message("start", {"settings": self._settings}), self._limits.start_timeout_s, "started")

    def _ask(self, message: Message, timeout_s: float, expected: str) -> Message:
        assert self._peer is not None
        answer = self._peer.request(message, timeout_s)
        if answer.kind == "refused":
            raise PeerFailure(f"reports: {answer.fields.get('reason')}")
        if answer.kind != expected:
            raise PeerFailure(f"answered '{answer.kind}' where '{expected}' was expected")
        return answer

    def _locate(self, frame: StereoFrame) -> TrackingResult:
        left, right = frame.pair(f"tracker={self._name}", _INSTEAD)
        images = {"left": grey(left), "right": grey(right)}
        asked = Message("track", {"number": int(frame.number), "timestamp": float(frame.timestamp)}, images)
        answer = self._ask(asked, self._limits.timeout_s, "pose")
        self._take_corrections(answer)
        T_map_cam = answer.arrays.get("T_map_cam")
        if answer.fields.get("state") not in ("ok", "weak") or T_map_cam is None:
            return TrackingResult(None, "lost")
        state: TrackingState = "weak" if answer.fields["state"] == "weak" else "ok"
        if not _is_rigid(T_map_cam):
            self._tell_once(f"frame {frame.number}: the pose that {self._name} gave is no rigid motion; lost")
            return TrackingResult(None, "lost")
        key = (self._starts, _whole_number(answer, "map"))
        T_map_cam = se3.orthonormalise(T_map_cam)
        if key not in self._worlds:
            if self._worlds:
                log.warning("frame %d: %s began a new map, put at constant velocity", frame.number, self._name)
                state = "predicted"
            self._worlds[key] = self._predicted() @ se3.inverse(T_map_cam)
        one = _Tracked(self._frames_seen, frame.number, frame.timestamp, key, T_map_cam)
        self._tracked[frame.number] = one
        return TrackingResult(self._in_world(one), state, _whole_number(answer, "inliers"))

    def _in_world(self, one: _Tracked) -> Float:
        return self._worlds[one.key] @ one.T_map_cam

    def _predicted(self) -> Float:
        """T_world_cam of the frame in hand, at the velocity of the last two located frames."""
        last = list(self._tracked.values())[-2:]
        if not last:
            return np.eye(4)
        before, now = last[0], last[-1]
        elapsed = now.position - before.position
        velocity = se3.log(se3.inverse(self._in_world(before)) @ self._in_world(now)) / max(elapsed, 1)
        return self._in_world(now) @ se3.exp((self._frames_seen - now.position) * velocity)

    def _take_corrections(self, answer: Message) -> None:
        """Put the peer's corrected poses in the place of those that it gave; nonsense among them is left out."""
        if "poses" not in answer.arrays:
            return
        numbers, maps, poses = (answer.arrays.get(name, np.empty(0)) for name in ("numbers", "maps", "poses"))
        if poses.shape != (len(poses), 4, 4) or numbers.shape != (len(poses),) or maps.shape != (len(poses),):
            raise PeerFailure(f"gave corrections of shapes {numbers.shape}, {maps.shape} and {poses.shape}")
        for number, which, T_map_cam in zip(numbers.tolist(), maps.tolist(), poses, strict=True):
            one, key = self._tracked.get(number), (self._starts, which)
            if one is None or one.key[0] != self._starts or key not in self._worlds:
                continue
            if _is_rigid(T_map_cam):
                one.key, one.T_map_cam = key, se3.orthonormalise(T_map_cam)
            else:
                self._tell_once(f"a corrected pose that {self._name} gave is no rigid motion; the first one is kept")

    def _count_failure(self, where: str, failure: PeerFailure) -> None:
        self._close()
        self._failures += 1
        if self._failures > self._limits.restarts:
            log.warning(
                "%s: %s %s. That was failure number %d: all further frames are lost",
                *(where, self._name, failure, self._failures),
            )
        else:
            log.warning("%s: %s %s. The frame is lost", where, self._name, failure)

    def _tell_once(self, text: str) -> None:
        kind = text.partition(": ")[2] or text
        if kind not in self._told:
            self._told.add(kind)
            log.warning("%s", text)

    def _close(self) -> None:
        if self._peer is not None:
            self._peer.close()
            self._peer = None


def _whole_number(answer: Message, key: str) -> int:
    value = answer.fields.get(key)
    if not isinstance(value, int):
        raise PeerFailure(f"answered {key}={value!r}, which is no whole number")
    return value


def _is_rigid(T: Float) -> bool:
    if T.shape != (4, 4) or not np.isfinite(T).all():
        return False
    R = T[:3, :3]
    close = np.abs(R @ R.T - np.eye(3)).max() < _ROTATION_TOLERANCE and np.array_equal(T[3], [0, 0, 0, 1])
    return bool(close and np.linalg.det(R) > 0)
