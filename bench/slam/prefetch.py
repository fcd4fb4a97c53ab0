"""Let a stage work ahead of the next one, in a background thread: decoding images, or the whole front end of the
system."""

from __future__ import annotations

import queue
import threading
from collections.abc import Generator, Iterable, Iterator
from typing import TypeVar

from bench.contracts.dataset import Dataset
from bench.runs.watchdog import TimeLimitError
from bench.types import StereoFrame

# How often a blocked thread looks whether the consumer has gone, in seconds.
_POLL_S = 0.1
_END = object()

T = TypeVar("T")


def prefetch(dataset: Dataset, first: int = 0, ahead: int = 2) -> Iterator[tuple[int, StereoFrame, int]]:
    """Yield ``(position, frame, checksum)`` from ``first`` on, with up to ``ahead`` frames decoded in a background
    thread."""
    frames = ((i, dataset.frame(i)) for i in range(first, len(dataset)))
    return in_background(((i, frame, frame.checksum()) for i, frame in frames), ahead, "bgs-prefetch")


def in_background(items: Iterable[T], ahead: int, thread_name: str) -> Generator[T, None, None]:
    """Yield the items in order; up to ``ahead`` of them are made before they are asked for, in a thread of their own.

    What making an item raises is raised here, in its place. The thread ends when the consumer closes this generator or
    lets go of it, at the latest after the item that it is making; a run that passed its limit of time while it waited
    for that item does not wait for it any longer.
    """
    ready: queue.Queue[object] = queue.Queue(maxsize=max(1, ahead))
    stop = threading.Event()
    failure: list[BaseException] = []

    def hand_over(item: object) -> bool:
        while not stop.is_set():
            try:
                ready.put(item, timeout=_POLL_S)
                return True
            except queue.Full:
                continue
        return False

    def make() -> None:
        iterator = iter(items)
        try:
            for item in iterator:
                if not hand_over(item):
                    break
        except BaseException as error:
            failure.append(error)  # handed to the consumer, who raises it
        finally:
            # A generator that runs a thread of its own ends it now, not when it happens to be collected.
            if hasattr(iterator, "close"):
                iterator.close()
            hand_over(_END)

    thread = threading.Thread(target=make, name=thread_name, daemon=True)
    thread.start()
    hangs = False
    try:
        while (item := ready.get()) is not _END:
            yield item  # type: ignore[misc]  # only T and _END are ever put
        if failure:
            raise failure[0]
    except TimeLimitError:
        hangs = True
        raise
    finally:
        stop.set()
        if not hangs:
            thread.join()
