"""Rows that a named table gets by the runs it is made of: the user's own plugins, and other systems scored here."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from bench.runs.system_name import external_name
from bench.tables.named.definitions import MethodRow, NamedTable
from bench.tables.named.external import with_external_rows
from bench.tables.named.overrides import belongs, holds


def with_found_rows(table: NamedTable, configs: Iterable[Mapping[str, Any]]) -> NamedTable:
    """The table with a row below its own for each plugin (of the kind ``other_rows``) and each system that it does not
    name and these runs have."""
    configs = list(configs)
    names: set[str] = set()
    for config in configs:
        part = config.get(table.other_rows)
        is_ours = external_name(config) is None and holds(config, f"dataset={table.dataset}")
        if is_ours and isinstance(part, Mapping) and not any(belongs(row, config) for row in table.rows):
            names.add(str(part.get("name") or ""))
    rows = [_other_row(table, name) for name in sorted(names - {""}) if not _rows_naming(table, name)]
    found = (row for row in rows if any(belongs(row, config) for config in configs))
    return with_external_rows(replace(table, rows=(*table.rows, *found)), configs)


def choose_rows(table: NamedTable, overrides: Sequence[str]) -> tuple[NamedTable, list[str]]:
    """The table with those rows alone that ``stereo=NAME`` or ``stereo=ONE,OTHER`` among a user's overrides chooses,
    and the overrides without it; the table and all overrides where none does, or the table has no ``other_rows``."""
    key = f"{table.other_rows}="
    chosen = [each for each in overrides if table.other_rows and each.startswith(key)]
    names = [name for each in chosen for name in each.removeprefix(key).split(",")]
    if not names:
        return table, list(overrides)
    rows = [row for name in names for row in _rows_naming(table, name) or [_other_row(table, name)]]
    return replace(table, rows=tuple(rows)), [each for each in overrides if each not in chosen]


def why_in_no_row(table: NamedTable, config: Mapping[str, Any]) -> str:
    """The setting that all rows have and a run on the table's data set lacks; empty where it is not one for all."""
    columns = list(table.sequences.values())
    everywhere = (*(columns[0] if len(columns) == 1 else ()), *table.overrides)
    lacking = next((override for override in everywhere if not holds(config, override)), "")
    never = next((override for override in table.never if holds(config, override)), "")
    return f"all rows have {lacking}" if lacking else f"no row has {never}" if never else ""


def _rows_naming(table: NamedTable, plugin: str) -> list[MethodRow]:
    return [row for row in table.rows if f"{table.other_rows}={plugin}" in (row.overrides or ())]


def _other_row(table: NamedTable, plugin: str) -> MethodRow:
    """A row called by the plugin's name, without a published number."""
    override = f"{table.other_rows}={plugin}"
    label = override if any(row.label == plugin for row in table.rows) else plugin
    return MethodRow(label, (*table.overrides, override), table.never)
