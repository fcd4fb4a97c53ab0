"""Register and look up plugins by kind and name.

A plugin is a class with a frozen config dataclass beside it::

    @dataclass(frozen=True)
    class MyNetConfig(PluginConfig):
        iterations: int = 32

    @register("stereo", "my_net", config=MyNetConfig)
    class MyNet(StereoBackbone):
        ...

The registered class is constructed as ``MyNet(config)``. Registering also puts the config into Hydra's ConfigStore, so
``stereo=my_net stereo.iterations=16`` works on the command line without any YAML file.

A setting of a plugin can itself be a plugin (``plugin_field``): ``mapper.rasterizer=gsplat``.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any, TypeVar

from hydra.core.config_store import ConfigStore
from omegaconf import Container, ListConfig, OmegaConf, open_dict

from bench.errors import BenchError, did_you_mean

# Kinds that follow a run and are no part of it: its result and its hash are the same without them.
OBSERVERS = ("viewer", "logger")
KINDS = ("dataset", "stereo", "sky", "tracker", "keyframer", "mapper", "loss", "rasterizer", "evaluator", *OBSERVERS)
# Kinds that make up a run; a rasterizer is a setting of the mappers that render Gaussians.
RUN_KINDS = tuple(kind for kind in KINDS if kind not in ("rasterizer", *OBSERVERS))
# Kinds that are chosen by KIND=NAME.
CHOSEN_KINDS = (*RUN_KINDS, *OBSERVERS)
# Kinds of which one run uses several at once; each config lives under its own key, for example `loss.geo.weight`.
SEVERAL_AT_ONCE = ("loss", "evaluator", "logger")


@dataclass(frozen=True)
class PluginConfig:
    """Base of every plugin's config; ``name`` is filled in by the registry."""

    name: str = ""


def plugin_field(kind: str, default: str) -> Any:
    """A field of a plugin's config that is itself a plugin, for example
    ``rasterizer: PluginConfig = plugin_field("rasterizer", "cpu")``; the field holds the typed config of the chosen
    one, for ``build``.
    """
    metadata = {"plugin": kind, "default": default}
    return field(default_factory=lambda: lookup(kind, default).config(name=default), metadata=metadata)


def plugin_fields(config: type[PluginConfig]) -> dict[str, str]:
    """The kinds of plugins that a config's fields hold, by the field's name."""
    return {each.name: each.metadata["plugin"] for each in fields(config) if "plugin" in each.metadata}


@dataclass(frozen=True)
class Plugin:
    """One registered plugin: its class, its config class, the file that defines it and a one-line summary."""

    kind: str
    name: str
    cls: type
    config: type[PluginConfig]
    file: str
    summary: str

    @property
    def prefix(self) -> str:
        """What stands before its settings: ``stereo``, or ``loss.geo`` of a kind of which a run has several."""
        return f"{self.kind}.{self.name}" if self.kind in SEVERAL_AT_ONCE else self.kind

    def unavailable_reason(self) -> str | None:
        """Why the plugin can't run here, with the command that mends it, or None; asks ``cls.unavailable_reason()``."""
        check = getattr(self.cls, "unavailable_reason", None)
        return check() if check is not None else None

    def missing_weights(self) -> str | None:
        """What to fetch, and how, before the plugin runs with its default settings, or None; asks
        ``cls.missing_weights()``, which is quick: it looks for files and reads none."""
        check = getattr(self.cls, "missing_weights", None)
        return check() if check is not None else None


_plugins: dict[tuple[str, str], Plugin] = {}
nested_groups: dict[str, str] = {}
"""Kinds of plugins that are settings of others, by the config group that chooses one, for example ``mapper/rasterizer``
(on the command line ``mapper.rasterizer=NAME``)."""
# Plugin files that failed to import: file -> reason. Filled by discovery.
broken_files: dict[str, str] = {}

C = TypeVar("C", bound=type)


def register(kind: str, name: str, config: type[PluginConfig] = PluginConfig) -> Callable[[C], C]:
    """Class decorator that makes a plugin known under ``kind`` and ``name``; raises ``BenchError`` on a clash."""
    if kind not in KINDS:
        raise BenchError(f"Unknown plugin kind '{kind}'; the kinds are {', '.join(KINDS)}.{did_you_mean(kind, KINDS)}")
    if not (is_dataclass(config) and issubclass(config, PluginConfig)):
        raise BenchError(f"The config of {kind} plugin '{name}' must be a dataclass that derives from PluginConfig.")
    if plugin_fields(config) and kind in SEVERAL_AT_ONCE:
        raise BenchError(f"The config of {kind} plugin '{name}' can't hold a plugin: a run has several {kind} plugins.")

    def add(cls: C) -> C:
        file = inspect.getfile(cls)
        known = _plugins.get((kind, name))
        if known is not None and (known.file, known.cls.__qualname__) != (file, cls.__qualname__):
            places = [f"{plugin.__qualname__} in {where}" for plugin, where in ((known.cls, known.file), (cls, file))]
            raise BenchError(f"Two {kind} plugins are called '{name}': {' and '.join(places)}. Rename one of them.")
        summary = (inspect.getdoc(cls) or "").split("\n", 1)[0]
        try:
            # The default of a field that is a plugin comes by the defaults list: its file may not be imported yet.
            node = config_node(config(name=name, **{each: PluginConfig() for each in plugin_fields(config)}))
        except BenchError as error:
            raise ValueError(f"the defaults of {kind}={name} fail the config's own check: {error}") from error
        _plugins[kind, name] = Plugin(kind, name, cls, config, file, summary)
        _put_into_config_store(kind, name, config, node)
        return cls

    return add


def _put_into_config_store(kind: str, name: str, config: type[PluginConfig], node: Container) -> None:
    store = ConfigStore.instance()
    inner = plugin_fields(config)
    if inner:
        defaults = {each.name: each.metadata["default"] for each in fields(config) if each.name in inner}
        with open_dict(node):
            node["defaults"] = ["_self_", *({each: choice} for each, choice in defaults.items())]
    if kind in CHOSEN_KINDS:
        package = f"{kind}.{name}" if kind in SEVERAL_AT_ONCE else kind
        store.store(group=kind, name=name, node=node, package=package)
    nested_groups.update({f"{kind}/{each}": of_kind for each, of_kind in inner.items()})
    for group, of_kind in nested_groups.items():
        for option in names(of_kind):
            settings = config_node(lookup(of_kind, option).config(name=option))
            store.store(group=group, name=option, node=settings, package=group.replace("/", "."))


def config_node(config: Any) -> Container:
    """A typed node for Hydra's ConfigStore; a frozen dataclass's instances are read-only, but not this node."""
    node = OmegaConf.structured(config)
    pending = [node]
    while pending:
        container = pending.pop()
        OmegaConf.set_readonly(container, None)
        pending += [child for child in _children(container) if isinstance(child, Container)]
    return node


def _children(container: Container) -> list[Any]:
    keys = range(len(container)) if isinstance(container, ListConfig) else list(container)
    return [container._get_node(key) for key in keys]


def names(kind: str) -> list[str]:
    """Sorted names of all registered plugins of a kind."""
    return sorted(n for k, n in _plugins if k == kind)


def lookup(kind: str, name: str) -> Plugin:
    """The plugin, or a ``BenchError`` that lists the names there are and the nearest one.

    >>> from bench.discovery import load_plugins
    >>> load_plugins()
    >>> lookup("stereo", "sgbm").cls.__name__
    'Sgbm'
    """
    try:
        return _plugins[kind, name]
    except KeyError:
        near = did_you_mean(name, names(kind))
        blame = [f"{file} ({why})" for file, why in broken_files.items() if name in file]
        hint = f" A file that may define it failed to import: {'; '.join(blame)}." if blame else ""
        raise BenchError(f"Unknown {kind} '{name}'. Known: {', '.join(names(kind))}.{near}{hint}") from None


def build(config: PluginConfig, kind: str) -> Any:
    """Construct the plugin that ``config`` belongs to; raises ``BenchError`` if it can't run on this machine."""
    plugin = lookup(kind, config.name)
    reason = plugin.unavailable_reason()
    if reason is not None:
        raise BenchError(f"{kind}={config.name} can't run here: {reason}")
    return plugin.cls(config)
