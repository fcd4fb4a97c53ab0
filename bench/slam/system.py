"""The parts of one run, built from its config."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch

from bench import _native, registry
from bench.cache import cached_depth_source, cached_segmenter, cached_tracker
from bench.config import RunConfig
from bench.contracts.dataset import Dataset
from bench.contracts.keyframer import Keyframer
from bench.contracts.mapper import Mapper
from bench.contracts.sky import SkySegmenter
from bench.contracts.stereo import DepthSource
from bench.contracts.tracker import Tracker
from bench.errors import BenchError
from bench.plugin_config import plugins_in
from bench.process_memory import MemoryBudget
from bench.protocol import Protocol
from bench.registry import OBSERVERS
from bench.runs.fingerprint import fingerprint


@dataclass
class System:
    """The parts of one run, built from its config. Building checks everything that can be checked before running."""

    dataset: Dataset
    tracker: Tracker
    keyframer: Keyframer
    stereo: DepthSource
    sky: SkySegmenter
    mapper: Mapper
    protocol: Protocol

    @classmethod
    def build(cls, config: RunConfig) -> System:
        """Construct every plugin; raises ``BenchError`` for bad settings or bad data, before anything is written."""
        _native.set_threads(config.values["threads"] or torch.get_num_threads())
        dataset = registry.build(config.plugin("dataset"), "dataset")
        parts = {
            kind: registry.build(config.plugin(kind), kind)
            for kind in ("tracker", "keyframer", "stereo", "sky", "mapper")
        }
        losses = [registry.build(loss, "loss") for loss in config.several("loss")]
        for evaluator in config.several("evaluator"):
            registry.lookup("evaluator", evaluator.name)
        parts["stereo"] = cached_depth_source(parts["stereo"], config.plugin("stereo"), dataset, config.cache)
        parts["sky"] = cached_segmenter(parts["sky"], config.plugin("sky"), dataset, config.cache)
        parts["tracker"] = cached_tracker(
            parts["tracker"], config.plugin("tracker"), config.values["dataset"], config.cache
        )
        parts["mapper"].start(dataset.camera, losses, config.values["seed"])
        parts["mapper"].use_memory_budget(MemoryBudget(config.limits.memory_gb))
        if parts["mapper"].uses_right_images and not dataset.has_right:
            raise BenchError(
                f"mapper={config.plugin('mapper').name} is set to use right images, and {dataset.label} has none. See "
                f"its settings: bgs-bench list mapper {config.plugin('mapper').name}."
            )
        looking = [kind for kind in ("tracker", "keyframer") if parts[kind].uses_map]
        view = parts["mapper"].view() if looking else None
        if looking and view is None:
            raise BenchError(
                f"{looking[0]}={config.plugin(looking[0]).name} looks at the map, and mapper="
                f"{config.plugin('mapper').name} offers no view of it; choose another of the two."
            )
        parts["tracker"].start(dataset)
        parts["keyframer"].start(dataset.camera)
        parts["stereo"].start(dataset)
        for kind in looking:
            parts[kind].use_map(view)
        return cls(dataset=dataset, protocol=config.protocol, **parts)

    @property
    def in_step(self) -> bool:
        """Whether a part looks at the map: then a frame is tracked only when the one before has been mapped."""
        return self.tracker.uses_map or self.keyframer.uses_map

    def weights(self) -> dict[str, Path]:
        """The files of network weights in use, as ``"tracker.<what>"``, ``"stereo.<what>"``, ``"sky.<what>"`` and
        ``"mapper.<what>"``."""
        parts: dict[str, Tracker | DepthSource | SkySegmenter | Mapper] = {
            "tracker": self.tracker,
            "stereo": self.stereo,
            "sky": self.sky,
            "mapper": self.mapper,
        }
        return {f"{kind}.{what}": path for kind, part in parts.items() for what, path in part.weights().items()}


def fingerprint_of(config: RunConfig, system: System) -> str:
    """What a checkpoint of this run must have been made with."""
    used = [
        registry.lookup(kind, part["name"])
        for kind, part in plugins_in(config.values)
        if kind not in ("evaluator", *OBSERVERS)
    ]
    return fingerprint(config.hash, [plugin.cls for plugin in used], system.weights())
