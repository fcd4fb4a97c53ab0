"""The plugins in a run's plain data, and the typed config of each."""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Iterator, Mapping
from typing import Any

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from bench import registry
from bench.errors import BenchError, did_you_mean, first_line
from bench.registry import CHOSEN_KINDS, SEVERAL_AT_ONCE, Plugin, PluginConfig
from bench.settings import check_numbers

_parsed: dict[tuple[str, type[PluginConfig], str], PluginConfig] = {}
"""The runs of a sweep share most of their parts, and parsing one takes milliseconds."""


def plugins_in(values: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Kind and settings of every plugin that a resolved config names, those that are settings of others included."""
    for kind in CHOSEN_KINDS:
        part = values.get(kind)
        if not part:
            continue
        for mapping in part.values() if kind in SEVERAL_AT_ONCE else [part]:
            yield kind, mapping
            for key, of_kind in registry.plugin_fields(registry.lookup(kind, mapping["name"]).config).items():
                if isinstance(mapping.get(key), dict):
                    yield of_kind, mapping[key]


def plugin_config_from(kind: str, mapping: Mapping[str, Any]) -> PluginConfig:
    """The typed config of a plugin from plain data (``mapping["name"]`` names it); raises ``BenchError``."""
    plugin = registry.lookup(kind, str(mapping.get("name", "")))
    key = (kind, plugin.config, repr(mapping))
    if key not in _parsed:
        _parsed[key] = _parse(kind, plugin, mapping)
    return _parsed[key]


def _parse(kind: str, plugin: Plugin, mapping: Mapping[str, Any]) -> PluginConfig:
    accepted = [f.name for f in dataclasses.fields(plugin.config)]
    for key in mapping:
        if key not in accepted:
            raise BenchError(
                f"{kind}={plugin.name} has no setting '{key}'; it has {', '.join(accepted)}."
                f"{did_you_mean(key, accepted)}"
            )
    prefix = plugin.prefix
    inner = registry.plugin_fields(plugin.config)
    own = {key: value for key, value in mapping.items() if key not in inner}
    try:
        merged = OmegaConf.merge(registry.config_node(plugin.config), own)
        _check_lengths(kind, plugin.config, merged)
        config = OmegaConf.to_object(merged)
    except OmegaConfBaseException as error:
        where = f"{prefix}.{error.full_key}" if error.full_key else f"{kind}={plugin.name}"
        raise BenchError(f"{where}: {first_line(error)}") from error
    except (TypeError, ValueError) as error:  # its own check, of a value that is not of its kind
        raise BenchError(f"{kind}={plugin.name}: {first_line(error)}") from error
    assert isinstance(config, plugin.config)
    check_numbers(prefix, config)
    chosen: dict[str, Any] = {key: _inner(kind, key, inner[key], mapping[key]) for key in inner if key in mapping}
    return dataclasses.replace(config, **chosen) if chosen else config


def _inner(kind: str, key: str, of_kind: str, value: Any) -> PluginConfig:
    """The typed config of a setting that is a plugin."""
    if not isinstance(value, Mapping):
        raise BenchError(f"{kind}.{key}={value!r} is no {of_kind}; give its name, one of {registry.names(of_kind)}.")
    return plugin_config_from(of_kind, value)


def _check_lengths(kind: str, config: type[PluginConfig], values: Any) -> None:
    """Raise ``BenchError`` for a list in place of a tuple of another length, which OmegaConf lets pass."""
    for name, annotation in typing.get_type_hints(config).items():
        parts = typing.get_args(annotation)
        if typing.get_origin(annotation) is not tuple or Ellipsis in parts:
            continue
        value = values[name]
        if len(value) != len(parts):
            raise BenchError(f"{kind}.{name}={list(value)} has {len(value)} values; give {len(parts)}.")
