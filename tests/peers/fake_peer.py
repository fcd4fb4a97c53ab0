"""A peer that drives 1 m forward a frame and misbehaves in the frames that its settings name. No test: the tests start
it as a program of its own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from typing import Any

import numpy as np

from bench.peers.serve import Grey, Peer, PeerPose, PeerPoses, serve


class FakePeer(Peer):
    """``settings["events"]`` maps a frame number to what happens in it."""

    def start(self, settings: dict[str, Any]) -> None:
        self.settings = settings
        self.count = self.map = 0
        self.given: list[tuple[int, int, np.ndarray]] = []
        print("what a peer prints is no answer")
        if settings.get("start") == "refuse":
            raise ValueError("no such vocabulary")
        self.happen(settings.get("start", ""))

    def happen(self, event: str) -> None:
        if event == "segfault":
            os.kill(os.getpid(), signal.SIGSEGV)
        if event == "exit":
            print("out of luck", file=sys.stderr, flush=True)
            os._exit(3)
        if event == "eat":
            self.eaten = np.ones(300_000_000, np.uint8)
        if event == "hang":
            time.sleep(60)
        if event == "raise":
            raise RuntimeError("frame without a name")

    def track(self, number: int, timestamp: float, left: Grey, right: Grey) -> PeerPose:
        event = self.settings.get("events", {}).get(str(number), "")
        self.happen(event)
        if event == "lost":
            self.count += 1
            return PeerPose(None, "lost", self.map)
        if event == "new map":
            self.map, self.count = self.map + 1, 0
        T = np.eye(4)
        # The image says how far the peer has come, to see that it arrives whole.
        T[2, 3] = self.count if left.any() else -1.0
        self.count += 1
        if event == "nan":
            T[0, 0] = np.nan
        if event == "sheared":
            T[0, 1] = 0.5
        self.given.append((number, self.map, T))
        corrections = self.moved(0.5) if event == "correct" else None
        return PeerPose(T, "weak" if event == "weak" else "ok", self.map, 40, corrections)

    def finish(self) -> PeerPoses | None:
        self.happen(self.settings.get("finish", ""))
        return self.moved(0.25) if self.settings.get("finish") == "correct" else None

    def moved(self, by: float) -> PeerPoses:
        """All poses given, moved sideways, and one of a frame that the bench never showed."""
        T = np.array([pose for _, _, pose in self.given] + [np.eye(4)])
        T[:, 0, 3] += by
        numbers, maps = ([one[i] for one in self.given] for i in (0, 1))
        return PeerPoses(np.array([*numbers, 9999]), np.array([*maps, 0]), T)


if __name__ == "__main__":
    peer = FakePeer()
    if "grandchild" in sys.argv:
        subprocess.Popen(["sleep", "60"])
    serve(peer)
