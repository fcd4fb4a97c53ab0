"""Decode frames ahead of their use, in one background thread."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator

from bench.contracts.dataset import Dataset
from bench.types import StereoFrame

# How often a blocked thread looks whether the consumer has gone, in seconds.
_POLL_S = 0.1


def prefetch(dataset: Dataset, ahead: int = 2) -> Iterator[tuple[int, StereoFrame]]:
    """Yield ``(position, frame)`` in order, with up to ``ahead`` frames decoded in a background thread.

    What ``dataset.frame`` raises is raised here, at the frame that failed. The thread ends when the consumer closes the
    generator or lets go of it, at the latest after the frame that it is decoding.
    """
    ready: queue.Queue[tuple[int, StereoFrame | BaseException]] = queue.Queue(maxsize=max(1, ahead))
    stop = threading.Event()

    def hand_over(position: int, item: StereoFrame | BaseException) -> bool:
        while not stop.is_set():
            try:
                ready.put((position, item), timeout=_POLL_S)
                return True
            except queue.Full:
                continue
        return False

    def decode() -> None:
        for position in range(len(dataset)):
            try:
                frame = dataset.frame(position)
            except BaseException as error:
                # Handed to the consumer, who raises it.
                hand_over(position, error)
                return
            if not hand_over(position, frame):
                return

    thread = threading.Thread(target=decode, name="bgs-prefetch", daemon=True)
    thread.start()
    try:
        for _ in range(len(dataset)):
            position, item = ready.get()
            if isinstance(item, BaseException):
                raise item
            yield position, item
    finally:
        stop.set()
        thread.join()
