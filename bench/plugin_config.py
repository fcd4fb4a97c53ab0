"""The typed config of a plugin, from plain data."""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Mapping
from typing import Any

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from bench import registry
from bench.errors import BenchError, did_you_mean, first_line
from bench.registry import PluginConfig


def plugin_config_from(kind: str, mapping: Mapping[str, Any]) -> PluginConfig:
    """The typed config of a plugin from plain data (``mapping["name"]`` names it); raises ``BenchError``."""
    plugin = registry.lookup(kind, str(mapping.get("name", "")))
    accepted = [f.name for f in dataclasses.fields(plugin.config)]
    for key in mapping:
        if key not in accepted:
            raise BenchError(
                f"{kind}={plugin.name} has no setting '{key}'; it has {', '.join(accepted)}."
                f"{did_you_mean(key, accepted)}"
            )
    try:
        merged = OmegaConf.merge(registry.config_node(plugin.config), dict(mapping))
        _check_lengths(kind, plugin.config, merged)
        config = OmegaConf.to_object(merged)
    except OmegaConfBaseException as error:
        raise BenchError(f"{kind}={plugin.name}: {first_line(error)}") from error
    assert isinstance(config, plugin.config)
    return config


def _check_lengths(kind: str, config: type[PluginConfig], values: Any) -> None:
    """Raise ``BenchError`` for a list in place of a tuple of another length, which OmegaConf lets pass."""
    for name, annotation in typing.get_type_hints(config).items():
        parts = typing.get_args(annotation)
        if typing.get_origin(annotation) is not tuple or Ellipsis in parts:
            continue
        value = values[name]
        if len(value) != len(parts):
            raise BenchError(f"{kind}.{name}={list(value)} has {len(value)} values; give {len(parts)}.")
