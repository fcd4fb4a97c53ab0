"""A tracker that repeats what it said about the same frames in an earlier run, from the disk cache."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import logging
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bench.cache.cost import Cost
from bench.cache.entry import DamagedEntryError
from bench.cache.identity import frame_identity
from bench.cache.recording import Recording
from bench.cache.settings import CacheConfig
from bench.cache.store import CacheStore
from bench.code_version import code_version, project_version
from bench.contracts.dataset import Dataset
from bench.contracts.tracker import Tracker
from bench.errors import BenchError
from bench.io.array_store import ArrayStore
from bench.machine import what_computes
from bench.registry import PluginConfig
from bench.types import StereoFrame, TrackingResult, Trajectory
from bench.weights.checksum import sha256_of

log = logging.getLogger(__name__)


def cached_tracker(tracker: Tracker, config: PluginConfig, dataset: Mapping[str, Any], cache: CacheConfig) -> Tracker:
    """``tracker`` behind the cache, or itself where sharing is switched off (``cache.all``) or it is not worth it.

    ``dataset`` is the data set's part of the run's config. What a tracker says that looks at the map or at depth is
    never shared.
    """
    if not (cache.enabled and cache.all and tracker.worth_caching) or tracker.uses_map or tracker.uses_depth:
        return tracker
    return CachedTracker(tracker, config, dataset, CacheStore(Path(cache.folder), cache.limit_gb * 1e9))


class CachedTracker(Tracker):
    """Repeats the recording of an earlier run as long as the frames are the same; else tracks, and records.

    Where a frame differs from the recorded one, the tracker is shown all frames so far and takes over. What is wrong
    with the disk costs time, never a result.
    """

    def __init__(self, tracker: Tracker, config: PluginConfig, dataset: Mapping[str, Any], store: CacheStore) -> None:
        self._tracker = tracker
        self._name = config.name
        self._key = _key(tracker, config, dataset)
        self._store = store
        self.last_cost = Cost(0.0, cached=False)

    def weights(self) -> dict[str, Path]:
        """The tracker's."""
        return self._tracker.weights()

    def start(self, dataset: Dataset) -> None:
        """Look for a recording; without one, start the tracker."""
        self._dataset = dataset
        self._kept: ArrayStore | None = None
        self._position = 0
        self._poses = np.zeros((0, 4, 4))
        self._repeated = self._read()
        self._recording: Recording | None = None
        if self._repeated is None:
            self._tracker.start(dataset)
            self._recording = Recording()

    def use_store(self, store: ArrayStore) -> None:
        """For the tracker, if it is asked."""
        self._kept = store
        if self._repeated is None:
            self._tracker.use_store(store)

    def state(self) -> dict[str, Any] | None:
        """How much of the recording was repeated, or what the tracker gives."""
        if self._repeated is not None:
            return {"repeated": self._position}
        state = self._tracker.state()
        return None if state is None else state | {"cached_position": self._position}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from ``state``. The tracker then keeps no recording, since it did not see all frames."""
        if "repeated" in state:
            self._position = state["repeated"]
            if self._repeated is None:
                self._recording = None
                self._show(self._position)
            else:
                for position in range(self._position):
                    self._repeat(position)
            return
        if self._repeated is not None:  # another run has made it meanwhile
            self._repeated = None
            self._start_tracker()
        self._recording, self._position = None, state["cached_position"]
        self._tracker.restore({key: value for key, value in state.items() if key != "cached_position"})

    def track(self, frame: StereoFrame) -> TrackingResult:
        """The recorded answer, or the tracker's; ``last_cost`` says what computing it took."""
        digest = frame_identity(frame, with_time=True)
        position = self._position
        self._position += 1
        if self._repeated is not None:
            if position < len(self._repeated.frames) and self._repeated.frames[position].digest == digest:
                return self._repeat(position)
            self._take_over(position)
        start = time.perf_counter()
        result = self._tracker.track(frame)
        seconds = time.perf_counter() - start
        self.last_cost = Cost(seconds, cached=False)
        self._record(digest, result, seconds)
        return result

    def finish(self) -> None:
        """Repeat the recorded last correction, or let the tracker finish, and keep the recording for later runs."""
        if self._repeated is not None:
            if self._position == len(self._repeated.frames):
                last = self._repeated.last
                self._poses[last.rows] = last.poses
            return
        self._tracker.finish()
        if self._recording is None or self._position < len(self._dataset):
            return
        if self._recording.end(self._tracker.trajectory()):
            try:
                self._store.write_content("tracker", self._name, self._key, self._recording.encode())
            except (OSError, BenchError) as error:
                log.warning("cache: going on without keeping the trajectory in %s: %s", self._store.folder, error)

    def trajectory(self) -> Trajectory:
        """As of the newest frame."""
        if self._repeated is None:
            return self._tracker.trajectory()
        count = len(self._poses)
        return Trajectory(self._poses.copy(), self._repeated.numbers[:count], self._repeated.timestamps[:count])

    def _repeat(self, position: int) -> TrackingResult:
        assert self._repeated is not None
        frame = self._repeated.frames[position]
        if len(frame.rows):
            missing = max(int(frame.rows.max()) + 1 - len(self._poses), 0)
            self._poses = np.concatenate([self._poses, np.zeros((missing, 4, 4))])
            self._poses[frame.rows] = frame.poses
        self.last_cost = Cost(frame.seconds, cached=True)
        return frame.result

    def _take_over(self, position: int) -> None:
        """The frames are not those of the recording: show the tracker what it has not seen."""
        log.info("cache: frame %d is not the one that was recorded; tracking from the first on", position)
        self._repeated = None
        self._start_tracker()
        self._show(position)

    def _start_tracker(self) -> None:
        self._tracker.start(self._dataset)
        if self._kept is not None:
            self._tracker.use_store(self._kept)

    def _show(self, count: int) -> None:
        """Show the tracker the first frames."""
        for each in range(count):
            self._tracker.track(self._dataset.frame(each))

    def _record(self, digest: bytes, result: TrackingResult, seconds: float) -> None:
        """Note the answer; a tracker that drops frames that it had located can't be recorded."""
        if self._recording is None:
            return
        if not self._recording.add(digest, result, seconds, self._tracker.trajectory()):
            self._recording = None

    def _read(self) -> Recording | None:
        content = self._store.read_content("tracker", self._name, self._key)
        if content is None:
            return None
        try:
            return Recording.decode(content)
        except DamagedEntryError as error:
            log.warning("cache: a recorded trajectory can't be used (%s); tracking again", error)
            return None


def _key(tracker: Tracker, config: PluginConfig, dataset: Mapping[str, Any]) -> str:
    """All that the answers depend on but for the frames themselves, which are compared one by one."""
    files = {
        setting.name: sha256_of(Path(value))
        for setting in dataclasses.fields(config)
        if setting.metadata.get("path") and (value := getattr(config, setting.name)) and Path(value).is_file()
    }
    parts = {
        "config": dataclasses.asdict(config) | files,
        "weights": {what: sha256_of(path) for what, path in tracker.weights().items()},
        "dataset": dict(dataset),
        "code": [code_version(type(tracker)), project_version()],
        "machine": what_computes(),
    }
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()
