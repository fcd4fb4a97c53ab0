"""Which plugin is to be checked, in which surroundings; and what holds for plugins of every kind."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from bench import registry
from bench.authoring.verdict import Candidate, Check, ContractBrokenError, Note
from bench.config import check_overrides, compose_run
from bench.contracts.dataset import Dataset
from bench.contracts.evaluator import Evaluator
from bench.contracts.keyframer import Keyframer
from bench.contracts.loss import LossConfig, LossTerm
from bench.contracts.mapper import Mapper
from bench.contracts.observer import Observer
from bench.contracts.rasterizer import Rasterizer
from bench.contracts.sky import SkySegmenter
from bench.contracts.stereo import DepthSource
from bench.contracts.tracker import Tracker
from bench.discovery import load_plugins
from bench.errors import BenchError
from bench.override_text import hydra_lines
from bench.registry import CHOSEN_KINDS, KINDS, OBSERVERS, SEVERAL_AT_ONCE

CONTRACTS: dict[str, type] = {
    "dataset": Dataset,
    "stereo": DepthSource,
    "sky": SkySegmenter,
    "tracker": Tracker,
    "keyframer": Keyframer,
    "mapper": Mapper,
    "loss": LossTerm,
    "rasterizer": Rasterizer,
    "evaluator": Evaluator,
    "viewer": Observer,
    "logger": Observer,
}
"""The base class of each kind."""

# The surroundings unless the author names others: the built-in street, small and short.
_SMALL = ("dataset=street", "dataset.frames=8", "dataset.width=128", "dataset.height=64")
# The map that a keyframer looks at is made again for each check.
_QUICK_MAP = "mapper.iterations=4"
# A tracker needs more pixels to find features in.
_SMALL_FOR_TRACKER = ("dataset=street", "dataset.frames=8", "dataset.width=320", "dataset.height=96")


def candidate_of(overrides: Sequence[str], folders: Sequence[str] = ()) -> Candidate:
    """The plugin that the first ``KIND=NAME`` of the overrides names, configured by all of them.

    ``folders`` are plugin folders, like ``plugins=[...]`` among the overrides. Raises ``BenchError`` where no plugin
    is named, or for what ``bgs-bench run`` would refuse too: an unknown name, a wrong setting.
    """
    load_plugins(folders)
    given = hydra_lines(overrides)
    parsed = check_overrides(given)
    named = [override for override in parsed if override.key_or_group in KINDS and not override.is_delete()]
    if not named:
        raise BenchError("Name the plugin to check as KIND=NAME, for example: bgs-bench check-plugin stereo=my_net")
    kind = named[0].key_or_group
    value = named[0].value()
    if named[0].is_sweep_override() or (isinstance(value, list) and len(value) != 1):
        raise BenchError(f"{named[0].input_line} names several plugins; check one at a time: {kind}=NAME.")
    small = _SMALL_FOR_TRACKER if kind == "tracker" else _SMALL
    names_data = any(override.key_or_group.startswith("dataset") for override in parsed)
    surroundings = () if names_data else small
    if kind == "keyframer" and not any(override.key_or_group.startswith(("mapper", "system")) for override in parsed):
        surroundings = (*surroundings, _QUICK_MAP)
    if kind in CHOSEN_KINDS:
        run = compose_run([*surroundings, *given])
        config = run.several(kind)[0] if kind in (*SEVERAL_AT_ONCE, *OBSERVERS) else run.plugin(kind)
    else:
        # A setting of another plugin, such as mapper.rasterizer: checked where a run would have it.
        holder, setting = next(group for group, held in registry.nested_groups.items() if held == kind).split("/")
        own = [f"{holder}.{setting}{each.removeprefix(kind)}" if each.startswith(kind) else each for each in given]
        run = compose_run([*surroundings, *own])
        config = getattr(run.plugin(holder), setting)
    return Candidate(registry.lookup(kind, config.name), config, run, names_data)


def _config(candidate: Candidate) -> str:
    config = candidate.plugin.config
    if not config.__dataclass_params__.frozen:  # type: ignore[attr-defined]
        raise ContractBrokenError(
            f"{config.__name__} is a dataclass that can be changed",
            "a frozen dataclass: a config that changes while it runs is not the one that was saved",
            f"write @dataclass(frozen=True) above class {config.__name__}",
        )
    if candidate.plugin.kind == "loss" and not issubclass(config, LossConfig):
        raise ContractBrokenError(
            f"{config.__name__} has no weight",
            "a config that derives from LossConfig, which brings `weight`",
            f"write class {config.__name__}(LossConfig): and register(..., config={config.__name__})",
        )
    settings = [field.name for field in dataclasses.fields(config) if field.name != "name"]
    return f"frozen dataclass; settings: {', '.join(settings) or 'none'}"


def _base_class(candidate: Candidate) -> str:
    base = CONTRACTS[candidate.plugin.kind]
    if not issubclass(candidate.plugin.cls, base):
        raise ContractBrokenError(
            f"{candidate.plugin.cls.__name__} does not derive from {base.__name__}",
            f"a subclass of {base.__module__}.{base.__name__}",
            f"write class {candidate.plugin.cls.__name__}({base.__name__}):",
        )
    missing = sorted(getattr(candidate.plugin.cls, "__abstractmethods__", ()))
    if missing:
        raise ContractBrokenError(
            f"{candidate.plugin.cls.__name__} lacks {', '.join(missing)}",
            f"all abstract methods of {base.__module__}.{base.__name__}",
            f"write def {missing[0]}(...) with the arguments that {base.__module__} shows",
        )
    return base.__name__


def _summary(candidate: Candidate) -> str | Note:
    return candidate.plugin.summary or Note("no docstring: `bgs-bench list` has nothing to say about it")


def _builds(candidate: Candidate) -> str:
    candidate.build()
    return f"{candidate.plugin.cls.__name__}({type(candidate.config).__name__}(...))"


FOR_ALL_KINDS = (
    Check("config", _config),
    Check("base class", _base_class, essential=True),
    Check("docstring", _summary),
    Check("construction", _builds, essential=True),
)
