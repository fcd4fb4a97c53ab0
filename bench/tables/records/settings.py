"""The settings of runs, flat: what makes runs comparable."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from bench.runs.config_file import NO_PART_OF_THE_RUN
from bench.runs.system_name import is_content
from bench.tables.records.record import RunRecord

Settings = dict[str, str]
"""Dotted names of a config's values, and the values as text."""

# What may differ between runs whose numbers are averaged or compared: keys, and whole parts of the config.
_FREE = {"seed", "dataset.sequence", "dataset.root"}
_FREE_PARTS = (*NO_PART_OF_THE_RUN, "evaluator")


def scored_config(record: RunRecord) -> dict[str, Any]:
    """The run's config with the protocol that its numbers were made under; a run can be scored again under another."""
    config = dict(record.config)
    protocol = config.get("protocol")
    if isinstance(protocol, Mapping) and record.protocol:
        config["protocol"] = {key: record.protocol.get(key, value) for key, value in protocol.items()}
    return config


def settings_of(config: Mapping[str, Any]) -> Settings:
    """All that can change the result, by dotted name, except the seed and which sequence it is."""
    return {key: str(value) for key, value in _flat(config, "") if key not in _FREE and not is_content(key)}


def differing_keys(several: Sequence[Settings]) -> list[str]:
    """The keys, sorted, under which not all have the same value."""
    keys = {key for settings in several for key in settings}
    return sorted(key for key in keys if len({settings.get(key) for settings in several}) > 1)


def first_few(names: Sequence[str]) -> str:
    """Four of the names, and how many more there are."""
    return ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")


def _flat(config: Mapping[str, Any], prefix: str) -> Iterable[tuple[str, Any]]:
    for key, value in config.items():
        if not prefix and key in _FREE_PARTS:
            continue
        if isinstance(value, dict) and value:
            yield from _flat(value, f"{prefix}{key}.")
        elif isinstance(value, float) and math.isfinite(value) and value == int(value):
            # 1 and 1.0 are one setting.
            yield f"{prefix}{key}", int(value)
        else:
            yield f"{prefix}{key}", value
