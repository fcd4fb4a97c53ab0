"""The config of a run folder as overrides: what ``bgs-bench run --from RUN_FOLDER`` composes."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from bench import registry
from bench.config import RootConfig, check_overrides, compose_run, options_of
from bench.errors import BenchError
from bench.hydra_settings import EXPERIMENT, as_value
from bench.override_text import hydra_lines
from bench.registry import OBSERVERS, RUN_KINDS, SEVERAL_AT_ONCE
from bench.runs.config_file import read_config
from bench.runs.system_name import external_name

# Where a run lay and how it was started is no part of making it again; nor is whose code it imported, or who followed
# it: a stranger's folder could send a run's images anywhere.
_LEFT_OUT = ("output", "rerun", "resume", "plugins", *OBSERVERS)
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
# What choosing a system chooses too.
_OF_A_SYSTEM = ("mapper", "loss")


def overrides_of(folder: Path, changes: Sequence[str]) -> list[str]:
    """Overrides that compose the config of the run in ``folder`` with ``changes``, the overrides of the command line.

    A plugin that is chosen anew has none of the settings of the one before. Plugin folders that the config names are
    not imported: ``changes`` name them. Raises ``BenchError`` for a folder without the config of a run of the bench's
    own, and for a plugin that is not there.
    """
    saved = _read(folder)
    parsed = check_overrides(hydra_lines(changes))
    for change in parsed:
        if change.key_or_group == EXPERIMENT:
            raise BenchError(f"{change.input_line}: a run's config and an experiment's exclude each other. Give one.")
    _require_plugins(folder, saved)
    choices = dict(_choices(saved))
    chosen = {change.key_or_group.replace("/", ".") for change in parsed} & choices.keys()
    chosen |= set(_OF_A_SYSTEM) if "system" in chosen else set()
    _require_code_said(folder, saved, chosen | {change.key_or_group for change in parsed})

    def is_kept(key: str) -> bool:
        return not any(key == each or key.startswith(f"{each}.") for each in chosen)

    kept = [f"{key}={value}" for key, value in choices.items() if is_kept(key)]
    base = dict(_flat(compose_run(kept).values))
    settings = [
        f"{key}={as_value(value)}"
        for key, value in _flat(saved)
        if is_kept(key) and (key not in base or base[key] != value)
    ]
    return [*kept, *settings, *changes]


def _read(folder: Path) -> dict[str, Any]:
    if not folder.is_dir():
        raise BenchError(f"--from {folder}: there is no such folder. Give a run folder.")
    known = read_config(folder)
    if known is None:
        raise BenchError(
            f"--from {folder}: it holds no config.yaml of a run. Give a folder that `bgs-bench run` wrote."
        )
    if external_name(known[0]) is not None:
        raise BenchError(f"--from {folder}: it is another system's output, scored; there is nothing to run again.")
    names = [setting.name for setting in dataclasses.fields(RootConfig)]
    if others := [key for key in known[0] if key not in names]:
        raise BenchError(f"--from {folder}: its config.yaml has a setting {others[0]!r}, which no run has. Remove it.")
    for part in (*RUN_KINDS, "protocol"):
        if not isinstance(known[0].get(part), dict):
            raise BenchError(f"--from {folder}: its config.yaml has no settings of {part}. Give another run folder.")
    return {key: value for key, value in known[0].items() if key not in _LEFT_OUT}


def _require_plugins(folder: Path, saved: Mapping[str, Any]) -> None:
    for kind in RUN_KINDS:
        for name in saved[kind] if kind in SEVERAL_AT_ONCE else [saved[kind].get("name")]:
            if name not in registry.names(kind):
                raise BenchError(
                    f"--from {folder}: there is no {kind} '{name}' here. The plugin folders that a run "
                    "folder names are not imported; if you trust them, repeat plugins=[FOLDER]."
                )


def _require_code_said(folder: Path, saved: Mapping[str, Any], said: set[str]) -> None:
    """Raise ``BenchError`` for a setting that names code (``field(metadata={"code": True})``): a run folder can't."""
    for kind in RUN_KINDS:
        if kind in SEVERAL_AT_ONCE or kind in said:
            continue
        for setting in dataclasses.fields(registry.lookup(kind, saved[kind]["name"]).config):
            key, value = f"{kind}.{setting.name}", saved[kind].get(setting.name)
            if setting.metadata.get("code") and value and key not in said:
                raise BenchError(
                    f"--from {folder}: {key}={value} would run code that the run folder names. If you trust it, repeat "
                    f"{key}={as_value(value)}."
                )


def _choices(saved: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """The groups of which the config has chosen, and what."""
    for group in ("system", "protocol"):
        name = saved.get(group) if group == "system" else saved[group].get("name")
        if name in options_of(group):
            yield group, name
    for kind in RUN_KINDS:
        yield kind, f"[{','.join(saved[kind])}]" if kind in SEVERAL_AT_ONCE else saved[kind]["name"]
    for group in registry.nested_groups:
        kind, key = group.split("/")
        inner = saved[kind].get(key)
        if isinstance(inner, Mapping) and inner.get("name"):
            yield f"{kind}.{key}", inner["name"]


def _flat(config: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in config.items():
        # A stranger's file: what is no plain name could be read as an override of something else.
        if not (isinstance(key, str) and _NAME.fullmatch(key)):
            raise BenchError(f"The config has a setting {prefix}{key!r}, which is no name. Remove it.")
        if isinstance(value, Mapping) and value:
            yield from _flat(value, f"{prefix}{key}.")
        elif key != "name" or prefix.partition(".")[0] not in RUN_KINDS:
            yield f"{prefix}{key}", list(value) if isinstance(value, tuple) else value
