"""In what the rows of a table differ by intention, and what all of them should share."""

from __future__ import annotations

import json
from collections.abc import Iterable

from bench.tables.named.definitions import NamedTable
from bench.tables.records.settings import Settings

# Choosing a system chooses these too.
_OF_A_SYSTEM = ("mapper", "loss")


def varied_parts(table: NamedTable) -> set[str]:
    """The parts of a config ("loss", "stereo", ...) in which the table's rows differ by intention."""
    overrides = [row.overrides for row in table.rows if row.overrides is not None]
    everywhere = set(overrides[0]).intersection(*overrides) if overrides else set()
    parts = {each.split("=")[0].split(".")[0] for of_row in overrides for each in set(of_row) - everywhere}
    return parts | set(_OF_A_SYSTEM) if "system" in parts else parts


def common(settings: Settings, varied: Iterable[str]) -> str:
    """The settings that all rows of a table should share, as one string."""
    parts = set(varied)
    return json.dumps({key: value for key, value in sorted(settings.items()) if key.split(".")[0] not in parts})
