"""``config.yaml`` of a run folder: the resolved config, with its hash in the first line."""

from __future__ import annotations

from collections.abc import Iterator
from copy import deepcopy
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from bench.errors import BenchError
from bench.io.atomic import write_text
from bench.io.foreign import read_plain_text, reading
from bench.runs.config_text import parse_config

CONFIG_FILE = "config.yaml"
RUNS_FOLDER = Path("results/runs")
"""Where run folders are made, and looked for, unless the user says otherwise; relative to the current folder."""
_HASH_LINE = "# bgs-bench run, config hash "
_MISSING = object()
_MOST_BYTES = 4_000_000
"""A config with the settings of all plugins has a few thousand."""
NO_PART_OF_THE_RUN = (
    *("output", "rerun", "resume", "checkpoint_s", "limits", "plugins", "pipeline", "threads", "cache"),
    *("viewer", "logger"),
)
"""Settings that can't change a result: where a run lies, how it was started, who follows it."""


def write_config(folder: Path, config: dict[str, Any], config_hash: str) -> None:
    """Write ``config.yaml`` atomically; ``config`` is resolved (plain dicts, lists, numbers, strings)."""
    write_text(folder / CONFIG_FILE, f"{_HASH_LINE}{config_hash}\n{OmegaConf.to_yaml(OmegaConf.create(config))}")


def read_config(folder: Path) -> tuple[dict[str, Any], str] | None:
    """The config and its hash, or None where the folder has no ``config.yaml`` of a run; ``BenchError`` as below."""
    known = read_shared_config(folder)
    return None if known is None else (deepcopy(known[0]), known[1])


def read_shared_config(folder: Path) -> tuple[dict[str, Any], str] | None:
    """As ``read_config``, for who reads many: what lies below a top-level key is shared and must not be changed.

    Raises ``BenchError`` when the file is damaged.
    """
    path = folder / CONFIG_FILE
    if not path.is_file():
        return None
    with reading(path, "can't be read", "Delete the run folder and run again."):
        text = read_plain_text(path, _MOST_BYTES)
        first = text.partition("\n")[0]
        if not first.startswith(_HASH_LINE):
            return None
        config = parse_config(text)
    if not config or not all(isinstance(key, str) for key in config):
        raise BenchError(f"{path} holds no settings. Delete the run folder and run again.")
    return config, first.removeprefix(_HASH_LINE).strip()


def differing_keys(one: dict[str, Any], other: dict[str, Any]) -> list[str]:
    """Dotted names of the settings whose values differ, sorted, for example ``["stereo.blocks", "tracker.name"]``."""
    first, second = dict(_flat(one, "")), dict(_flat(other, ""))
    keys = first.keys() | second.keys()
    return sorted(
        key
        for key in keys
        if key.partition(".")[0] not in NO_PART_OF_THE_RUN and first.get(key, _MISSING) != second.get(key, _MISSING)
    )


def _flat(config: dict[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    for key, value in config.items():
        if isinstance(value, dict) and value:
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", list(value) if isinstance(value, (list, tuple)) else value
