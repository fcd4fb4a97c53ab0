"""The peer's side: what an external system has to offer, and the loop that answers the bench with it.

A peer program is a few lines::

    class MyPeer(Peer):
        ...

    if __name__ == "__main__":
        serve(MyPeer())
"""

from __future__ import annotations

import os
import queue
import sys
import threading
import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from bench.peers.messages import Message, encode, read_message
from bench.types import Float, TrackingState

Grey = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class PeerPoses:
    """Poses of N frames as the peer knows them now: frame ``numbers`` (N,), the ``maps`` (N,) that they belong to, and
    ``T_map_cam`` (N, 4, 4) in the world of that map."""

    numbers: npt.NDArray[np.int64]
    maps: npt.NDArray[np.int64]
    T_map_cam: Float


@dataclass(frozen=True)
class PeerPose:
    """The answer to one frame. ``T_map_cam`` is 4x4 in the world of map number ``map``, None when lost. A map that has
    not been seen before begins a world of its own. ``corrections``: poses of earlier frames that have changed."""

    T_map_cam: Float | None
    state: TrackingState
    map: int = 0
    inliers: int = 0
    corrections: PeerPoses | None = field(default=None)


class Peer(ABC):
    """An external tracker. What it raises is told to the bench and ends the process."""

    @abstractmethod
    def start(self, settings: dict[str, Any]) -> None:
        """Called once, with what the plugin on the bench's side has to say (plain JSON values)."""

    @abstractmethod
    def track(self, number: int, timestamp: float, left: Grey, right: Grey) -> PeerPose:
        """Pose of the frame ``number`` at ``timestamp`` in seconds; the images are (H, W) uint8, grey, rectified."""

    def finish(self) -> PeerPoses | None:
        """Called once after the last frame: the final poses where they differ from those given, or None."""
        return None


def serve(peer: Peer) -> None:
    """Answer the bench until it closes the connection; does not return. Whatever the peer prints goes to the log."""
    serve_messages(lambda message: _answer(peer, message))


def serve_messages(answer_to: Callable[[Message], Message]) -> None:
    """The same for a process that is no tracker: ``answer_to`` gives the answer to one message."""
    answers = os.fdopen(os.dup(1), "wb", buffering=0)
    os.dup2(2, 1)
    requests: queue.Queue[Message] = queue.Queue()
    threading.Thread(target=_listen, args=(os.fdopen(os.dup(0), "rb"), requests), daemon=True).start()
    code = 0
    while code == 0:
        message = requests.get()
        try:
            answer = answer_to(message)
        except Exception as error:
            traceback.print_exc()
            answer, code = Message("refused", {"reason": f"{type(error).__name__}: {error}"}), 1
        for piece in encode(answer):
            _write(answers, piece)
    sys.stderr.flush()
    # Not sys.exit: destructors of an external library may hang or crash.
    os._exit(code)


def _listen(source: BinaryIO, requests: queue.Queue[Message]) -> None:
    """Hand on what the bench asks; when it is gone, so is this process, whatever the peer is busy with."""

    def read(size: int) -> bytes:
        content = source.read(size)
        if len(content) < size:
            os._exit(0)
        return content

    try:
        while True:
            requests.put(read_message(read))
    finally:
        os._exit(2)  # what came was no message


def _answer(peer: Peer, message: Message) -> Message:
    fields, arrays = message.fields, message.arrays
    if message.kind == "start":
        peer.start(fields["settings"])
        return Message("started")
    if message.kind == "track":
        pose = peer.track(fields["number"], fields["timestamp"], arrays["left"], arrays["right"])
        found = {} if pose.T_map_cam is None else {"T_map_cam": np.asarray(pose.T_map_cam, np.float64)}
        said = {"state": pose.state, "map": int(pose.map), "inliers": int(pose.inliers)}
        return Message("pose", said, found | _poses(pose.corrections))
    if message.kind == "finish":
        return Message("finished", {}, _poses(peer.finish()))
    raise ValueError(f"the bench asked for '{message.kind}', which this peer does not know")


def _poses(poses: PeerPoses | None) -> dict[str, npt.NDArray[Any]]:
    if poses is None:
        return {}
    T = np.asarray(poses.T_map_cam, np.float64)
    return {"numbers": np.asarray(poses.numbers, np.int64), "maps": np.asarray(poses.maps, np.int64), "poses": T}


def _write(sink: BinaryIO, piece: bytes | memoryview) -> None:
    left = memoryview(piece)
    while left:
        left = left[sink.write(left) or 0 :]
