"""Whether a resolved config is what an override would have made of it."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import yaml  # type: ignore[import-untyped]  # comes with omegaconf

from bench.installed_data import config_folder
from bench.runs.system_name import external_name
from bench.tables.named.definitions import MethodRow, NamedTable
from bench.tables.named.external import is_of_external


def holds(config: Mapping[str, Any], override: str) -> bool:
    """Whether ``override`` (``stereo=sgbm``, ``loss=[rgb,ssim]``, ``loss.geo.stride=2``) is true of a resolved config.

    A part of the config is compared by its name, parts of which a run uses several by the set of their names; a preset
    (``tracker=splatam_tum``) is as good as its plugin, since its settings may be changed. A key that the config lacks
    makes the answer False.
    """
    key, _, wanted = override.partition("=")
    value: Any = config
    for part in key.split("."):
        if not isinstance(value, Mapping) or part not in value:
            return False
        value = value[part]
    if isinstance(value, Mapping):
        if wanted.startswith("["):
            return set(value) == set(wanted.strip("[]").split(","))
        value, wanted = value.get("name"), _plugin_of(key, wanted)
    return _equal(value, wanted)


@cache
def _plugin_of(kind: str, name: str) -> str:
    """The plugin that a preset of this kind configures; ``name`` itself where there is no such preset."""
    file = config_folder() / kind / f"{name}.yaml"
    if kind == "system" or not file.is_file():
        return name
    defaults = yaml.safe_load(file.read_text("utf-8")).get("defaults", [])
    base = next((each for each in defaults if isinstance(each, str) and each != "_self_"), name)
    return base if base == name else _plugin_of(kind, base)


def row_of(table: NamedTable, config: Mapping[str, Any]) -> tuple[str, str] | None:
    """Label of the row and name of the sequence that a run with this config belongs to, or None.

    Where several rows fit (only rows of a user's own could), the first one is taken.
    """
    if not holds(config, f"dataset={table.dataset}"):
        return None
    sequence = next(
        (name for name, chosen in table.sequences.items() if all(holds(config, each) for each in chosen)), None
    )
    row = next((row for row in table.rows if belongs(row, config)), None)
    return None if sequence is None or row is None else (row.label, sequence)


def belongs(row: MethodRow, config: Mapping[str, Any]) -> bool:
    """Whether a run with this config is one of the row's method, on whatever sequence."""
    name = external_name(config)
    if name is not None:
        return is_of_external(row, name)
    if row.overrides is None:
        return False
    return all(holds(config, override) for override in row.overrides) and not any(
        holds(config, override) for override in row.never
    )


def _equal(value: Any, wanted: str) -> bool:
    if isinstance(value, bool):
        return wanted == str(value).lower()
    if isinstance(value, (int, float)):
        try:
            return float(wanted) == value
        except ValueError:
            return False
    # KITTI's sequence 3 may be written 3 or 03.
    return str(value) == wanted or (str(value).isdecimal() and wanted.isdecimal() and int(value) == int(wanted))
