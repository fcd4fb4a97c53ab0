"""Frames decoded ahead: order, errors handed over, and a thread that ends."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import numpy as np
import pytest

from bench.contracts.dataset import Dataset
from bench.errors import BenchError
from bench.slam.prefetch import prefetch
from bench.types import StereoCamera, StereoFrame


class Counted(Dataset):
    """Ten tiny frames; remembers which were decoded and in which thread."""

    def __init__(self, on_frame: Callable[[int], None] = lambda position: None) -> None:
        self.camera = StereoCamera(2, 2, 1.0, 1.0, 0.5, 0.5, (0.1, 0.0, 0.0))
        self.numbers = tuple(range(100, 110))
        self.decoded: list[int] = []
        self.threads: set[str] = set()
        self._on_frame = on_frame

    def frame(self, position: int) -> StereoFrame:
        self._on_frame(position)
        self.decoded.append(position)
        self.threads.add(threading.current_thread().name)
        image = np.full((2, 2, 3), position, dtype=np.uint8)
        return StereoFrame(self.numbers[position], 0.1 * position, image, image)


def prefetch_threads() -> int:
    return sum(thread.name == "bgs-prefetch" for thread in threading.enumerate())


def test_all_frames_in_order_from_another_thread() -> None:
    dataset = Counted()
    seen = [(position, frame.number, int(frame.left[0, 0, 0])) for position, frame, _ in prefetch(dataset)]
    assert seen == [(i, 100 + i, i) for i in range(10)]
    assert threading.current_thread().name not in dataset.threads
    assert prefetch_threads() == 0


def test_stays_no_more_than_ahead() -> None:
    dataset = Counted()
    frames = prefetch(dataset, ahead=2)
    next(frames)
    time.sleep(0.3)
    # One is out, two wait, one may be held by the thread.
    assert 3 <= len(dataset.decoded) <= 4
    frames.close()


def test_error_arrives_at_its_frame() -> None:
    def fail(position: int) -> None:
        if position == 3:
            raise BenchError("frame 103 is damaged")

    frames = prefetch(Counted(fail))
    assert [next(frames)[0] for _ in range(3)] == [0, 1, 2]
    with pytest.raises(BenchError, match="frame 103 is damaged"):
        next(frames)
    assert prefetch_threads() == 0


def test_thread_ends_when_the_consumer_stops() -> None:
    frames = prefetch(Counted(), ahead=1)
    next(frames)
    assert prefetch_threads() == 1
    frames.close()
    assert prefetch_threads() == 0
