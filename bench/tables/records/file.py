"""Record files (``NAME.runs.json``): what tables need of runs, without the run folders, to keep in a repository.

A JSON object whose ``runs`` take one line each. ``common`` holds, once, the settings, protocol and provenance that all
of them share. The same runs give the same bytes; there is no path of a machine in it.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from bench.errors import BenchError, require_choice
from bench.io.foreign import reading
from bench.runs.status import read_json
from bench.tables.records.record import VIEW_GROUPS, RunRecord, what_no_run_writes
from bench.tables.records.shared import in_common, together, without

SUFFIX = ".runs.json"
_FORMAT = "bgs-bench runs 1"
_SHARED = ("config", "protocol", "provenance")
# The line of the first run: below the bracket, what `_head` says, what is common, and the key of the runs.
_FIRST_RUN = 9


@dataclass(frozen=True)
class TableRecord:
    """What a record file holds. ``others`` counts runs that were there and have no place in the table; ``problems`` say
    which could not be read. ``table`` is its name, or empty for a table of runs."""

    table: str
    views: str
    runs: tuple[RunRecord, ...]
    others: int = 0
    problems: tuple[str, ...] = ()


def is_record_file(path: Path) -> bool:
    """Whether the name is that of a record file."""
    return path.name.endswith(SUFFIX)


def in_order(runs: Sequence[RunRecord]) -> list[RunRecord]:
    """By name, then by content, as in a record file: wherever the runs were read from, the order is the same."""
    return sorted(runs, key=lambda run: (run.name, _one_line(_entry(run))))


def record_text(record: TableRecord) -> str:
    """The text of a record file."""
    entries = [_entry(run) for run in in_order(record.runs)]
    common = {key: in_common([entry[key] for entry in entries]) for key in _SHARED}
    for entry in entries:
        entry |= {key: without(entry[key], common[key]) for key in _SHARED}
    lines = [f'"{key}": {json.dumps(value)},' for key, value in _head(record).items()]
    lines.append(f'"common": {_one_line(common)},')
    text = "\n".join(["{", *lines, '"runs": [', ",\n".join(_one_line(entry) for entry in entries), "]", "}"]) + "\n"
    # Half a surrogate pair, which JSON can name and no file can hold.
    return text.encode(errors="replace").decode()


def lead_to(record: TableRecord, file: Path) -> TableRecord:
    """The same runs with their lines in ``file``, which is to get ``record_text``, as their sources."""
    runs = (replace(run, source=_line_of(file, place)) for place, run in enumerate(in_order(record.runs)))
    return replace(record, runs=tuple(runs))


def read_record_file(path: Path, views: str | None = None) -> TableRecord:
    """What a record file holds, its image metrics those of ``views`` (default: of the table it was made for).

    Raises ``BenchError`` for a file that is missing, damaged or none of these.
    """
    content = read_json(path)
    if content.get("format") != _FORMAT:
        raise BenchError(
            f"{path} is no record of runs ({_FORMAT!r}); write one with `bgs-bench table ... --out {path}`."
        )
    with reading(path, "is damaged", "Restore it, or make it again from the run folders."):
        chosen = require_choice("views", views or content["views"], VIEW_GROUPS)
        common = {key: content["common"][key] for key in _SHARED}
        runs = [_record(entry, common, chosen, _line_of(path, place)) for place, entry in enumerate(content["runs"])]
        others, problems = int(content["others"]), tuple(str(problem) for problem in content["problems"])
        return TableRecord(str(content["table"]), chosen, tuple(runs), others, problems)


def _head(record: TableRecord) -> dict[str, Any]:
    return {
        "format": _FORMAT,
        "table": record.table,
        "views": record.views,
        "others": record.others,
        "problems": list(record.problems),
    }


def _line_of(file: Path, place: int) -> Path:
    return file.with_name(f"{file.name}#L{_FIRST_RUN + place}")


def _one_line(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, separators=(",", ":"))


def _sorted(value: Any) -> Any:
    """Dicts with sorted keys, at any depth."""
    if isinstance(value, dict):
        return {key: _sorted(value[key]) for key in sorted(value)}
    return value


def _entry(run: RunRecord) -> dict[str, Any]:
    return {
        "name": run.name,
        "state": run.state,
        "reason": run.reason,
        "frames": [run.frames_done, run.frames_total],
        "date": run.date,
        "config": _sorted(run.config),
        "protocol": _sorted(run.protocol),
        "provenance": _sorted(run.provenance),
        # In the order of metrics.json, which is that of the lines in the table of dialects.
        "metrics": run.metrics,
    }


def _record(entry: dict[str, Any], common: dict[str, Any], views: str, source: Path) -> RunRecord:
    config, protocol, provenance = (together(common[key], entry[key]) for key in _SHARED)
    done, total = entry["frames"]
    run = RunRecord(
        name=entry["name"],
        source=source,
        config=config,
        state=entry["state"],
        reason=entry["reason"],
        frames_done=done,
        frames_total=total,
        date=entry["date"],
        metrics=entry["metrics"],
        protocol=protocol,
        provenance=provenance,
        views=views,
    )
    wrong = what_no_run_writes(run)
    if wrong:
        raise ValueError(f"of the run in line {source.name.rpartition('L')[2]} {wrong}")
    return run
