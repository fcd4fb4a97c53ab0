"""A kept run as a row of the table of runs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bench.runs.system_name import system_name
from bench.tables.collect import COLUMNS, Row, row_from_parts
from bench.tables.records.record import RunRecord


def row_of_record(run: RunRecord) -> Row:
    """The row that ``collect_row`` gives of the run's folder; of a run that was never scored it lacks resources."""
    dataset = run.config.get("dataset")
    sequence = dataset.get("sequence") if isinstance(dataset, Mapping) else None
    values: dict[str, Any] = {column.key: None for column in COLUMNS} | {
        "run": run.name,
        "dataset": f"{_name(dataset)}/{sequence}" if sequence not in (None, "") else _name(dataset),
        "system": system_name(run.config),
        "stereo": _name(run.config.get("stereo")),
        "tracker": _name(run.config.get("tracker")),
        "status": run.state,
        "frames": f"{run.frames_done}/{run.frames_total}" if run.frames_total else None,
    }
    metrics = dict(run.metrics) | {"protocol": dict(run.protocol)}
    return row_from_parts(values, metrics, run.part("frames"), run.reason)


def _name(part: Any) -> str | None:
    name = part.get("name") if isinstance(part, Mapping) else part
    return str(name) if name not in (None, "") else None
