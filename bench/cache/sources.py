"""Depth sources and sky segmenters that ask the disk cache before they compute."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from bench.cache.cost import Cost
from bench.cache.entry import Stored
from bench.cache.identity import Identity
from bench.cache.settings import CacheConfig
from bench.cache.store import CacheStore, Kind
from bench.contracts.dataset import Dataset
from bench.contracts.sky import SkySegmenter
from bench.contracts.stereo import DepthSource
from bench.errors import BenchError
from bench.registry import PluginConfig
from bench.types import DepthMap, Image, Mask, StereoCamera, StereoFrame

log = logging.getLogger(__name__)


def cached_depth_source(source: DepthSource, config: PluginConfig, dataset: Dataset, cache: CacheConfig) -> DepthSource:
    """``source`` behind the cache, or itself where that is switched off, of no use, or wrong (temporal
    networks)."""
    if not cache.enabled or not (source.worth_caching or cache.all) or source.temporal:
        return source
    identity = Identity("stereo", type(source), config, source.weights(), dataset.label)
    return CachedDepthSource(source, config.name, identity, _store(cache))


def cached_segmenter(sky: SkySegmenter, config: PluginConfig, dataset: Dataset, cache: CacheConfig) -> SkySegmenter:
    """``sky`` behind the cache, or itself where that is switched off or of no use."""
    if not cache.enabled or not sky.worth_caching:
        return sky
    identity = Identity("sky", type(sky), config, sky.weights(), dataset.label)
    return CachedSkySegmenter(sky, config.name, identity, _store(cache))


def _store(cache: CacheConfig) -> CacheStore:
    return CacheStore(Path(cache.folder), cache.limit_gb * 1e9)


class CachedDepthSource(DepthSource):
    """A depth source whose answers are kept on disk. Its depth may depend on the frame, not on those before it."""

    def __init__(self, source: DepthSource, name: str, identity: Identity, store: CacheStore) -> None:
        self._source = source
        self._identity = identity
        self._shelf = _Shelf("stereo", name, store)
        self.last_cost = Cost(0.0, cached=False)

    def weights(self) -> dict[str, Path]:
        """Those of the source."""
        return self._source.weights()

    def start(self, dataset: Dataset) -> None:
        """Start the source."""
        self._source.start(dataset)

    def depth(self, frame: StereoFrame, position: int, camera: StereoCamera) -> DepthMap:
        """The source's answer, from disk where it is there; ``last_cost`` then says what it cost."""

        def compute() -> Stored:
            start = time.perf_counter()
            answer = self._source.depth(frame, position, camera)
            return Stored(answer.depth, time.perf_counter() - start, answer.source, answer.confidence)

        stored, self.last_cost = self._shelf.answer(
            self._identity.of_frame(frame, camera), frame.left.shape[:2], compute
        )
        return DepthMap(stored.array, stored.source, stored.confidence)


class CachedSkySegmenter(SkySegmenter):
    """A sky segmenter whose masks are kept on disk."""

    def __init__(self, sky: SkySegmenter, name: str, identity: Identity, store: CacheStore) -> None:
        self._sky = sky
        self._identity = identity
        self._shelf = _Shelf("sky", name, store)
        self.last_cost = Cost(0.0, cached=False)

    def weights(self) -> dict[str, Path]:
        """Those of the segmenter."""
        return self._sky.weights()

    def segment(self, image: Image, depth: DepthMap, camera: StereoCamera) -> Mask | None:
        """The segmenter's answer, from disk where it is there; ``last_cost`` then says what it cost."""
        none_found = False

        def compute() -> Stored:
            nonlocal none_found
            start = time.perf_counter()
            mask = self._sky.segment(image, depth, camera)
            none_found = mask is None
            return Stored(np.empty((0, 0)) if mask is None else mask, time.perf_counter() - start, "")

        stored, self.last_cost = self._shelf.answer(
            self._identity.of_image(image, depth, camera), image.shape[:2], compute
        )
        return None if none_found else stored.array


class _Shelf:
    """The place of one plugin's answers in the cache. What is wrong with the disk costs time, never a result."""

    def __init__(self, kind: Kind, plugin: str, store: CacheStore) -> None:
        self._kind = kind
        self._dtype = np.dtype(np.float32 if kind == "stereo" else np.bool_)
        self._plugin = plugin
        self._store = store
        self._warned = False

    def answer(self, key: str, shape: tuple[int, ...], compute: Callable[[], Stored]) -> tuple[Stored, Cost]:
        """The entry of ``key``, of this shape, or what ``compute`` gives, kept for the next one who asks.

        Of several processes that ask at once, one computes and the others wait for it. What ``compute`` raises goes on.
        """
        stored = self._read(key, shape)
        if stored is not None:
            return stored, Cost(stored.seconds, cached=True)
        with ExitStack() as held:
            try:
                held.enter_context(self._store.lock(key))
            except OSError as error:
                self._warn(error)
            stored = self._read(key, shape)
            if stored is not None:
                return stored, Cost(stored.seconds, cached=True)
            stored = compute()
            self._write(key, stored)
        return stored, Cost(stored.seconds, cached=False)

    def _read(self, key: str, shape: tuple[int, ...]) -> Stored | None:
        stored = self._store.read(self._kind, self._plugin, key)
        if stored is not None and (stored.array.dtype, stored.array.shape) != (self._dtype, shape):
            log.warning("cache: the entry %s is of another image or kind; computing it again", key)
            return None
        return stored

    def _write(self, key: str, stored: Stored) -> None:
        if stored.array.dtype != self._dtype or stored.array.ndim != 2:
            return  # not what the contract promises, or no answer at all: nothing to keep
        try:
            self._store.write(self._kind, self._plugin, key, stored)
        except (OSError, BenchError) as error:
            self._warn(error)

    def _warn(self, error: Exception) -> None:
        if not self._warned:
            log.warning("cache: going on without keeping answers in %s: %s", self._store.folder, error)
        self._warned = True
