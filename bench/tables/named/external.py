"""Rows of a named table for other systems, whose output was scored here."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from bench.runs.system_name import external_name, same_system
from bench.tables.named.definitions import MethodRow, NamedTable


def with_external_rows(table: NamedTable, configs: Iterable[Mapping[str, Any]]) -> NamedTable:
    """The table with a row below its own for each other system that has none, in alphabetical order.

    One that is called like a row of ours (MonoGS) is compared to the same number of the paper. Tables of variants of
    one system (the ablation) have no place for others.
    """
    if table.across != "sequences":
        return table
    rows = list(table.rows)
    names = {name for config in configs if (name := external_name(config)) is not None}
    for name in sorted(names, key=str.lower):
        if not any(is_of_external(row, name) for row in rows):
            namesake = next((row for row in rows if same_system(name, row.label)), None)
            of_paper = namesake.published or namesake.compared_with if namesake else ""
            rows.append(MethodRow(_apart(name) if namesake else name, compared_with=of_paper))
    return replace(table, rows=tuple(rows))


def is_of_external(row: MethodRow, name: str) -> bool:
    """Whether the scored output of the system ``name`` belongs to this row: never to one that runs of ours fill."""
    return row.overrides is None and (same_system(name, row.label) or row.label == _apart(name))


def _apart(name: str) -> str:
    """The label of a system that is called like a row of ours."""
    return f"{name} (scored output)"
