"""Numbers that others published, as tidy CSV files under ``results/published``."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

from bench.errors import BenchError, require_choice
from bench.installed_data import published_folder
from bench.io.text_files import read_text

STATUSES = ("ok", "dagger", "cross", "not reported")
AVERAGE = "average"
SEQUENCES_FILE = "sequences.csv"


@dataclass(frozen=True)
class PublishedValue:
    """One number as it was printed: ``value`` keeps its digits ("0.90") and is empty where there is none.

    ``status``: "ok"; "dagger" = on the first 300 frames only; "cross" = out of memory; "not reported". ``sequence`` is
    "average" for an average over the table's sequences, and empty where the source does not say which.
    """

    table: str
    dataset: str
    sequence: str
    method: str
    metric: str
    value: str
    unit: str
    status: str
    note: str
    source: str

    @property
    def number(self) -> float | None:
        """The value, in ``unit``."""
        return float(self.value) if self.value else None


# Of KITTI-360 the paper counts images. About every tenth, and the last of some sequences, have no pose.
_LEAST_WITH_POSE = {"kitti360": 0.8}


@dataclass(frozen=True)
class SequenceFacts:
    """Length in km and number of frames of a sequence as the paper has them, 0 where not known; frames may be rounded.

    ``withheld`` says why nobody can run it, or is empty.
    """

    dataset: str
    sequence: str
    length_km: float = 0.0
    frames: int = 0
    frames_rounded_to: int = 1
    withheld: str = ""

    def is_part(self, frames: int) -> bool:
        """Whether so many frames are not the whole sequence."""
        return frames < _LEAST_WITH_POSE.get(self.dataset, 1.0) * (self.frames - self.frames_rounded_to / 2)


def read_published(file: Path, table: str) -> list[PublishedValue]:
    """The numbers of a table in a CSV file, in its order; raises ``BenchError`` for a missing or damaged file, and for
    one without any number of this table."""
    values = [value for value in _read_values(file) if value.table == table]
    if not values:
        raise BenchError(f"{file} has no number of the table {table}. Write {table} into its column 'table'.")
    return values


def read_sequences(dataset: str, folder: Path | None = None) -> dict[str, SequenceFacts]:
    """Facts by sequence name; raises ``BenchError`` as ``read_published`` does."""
    path = (folder or published_folder()) / SEQUENCES_FILE
    found = {}
    for line, row in _rows(path, [field.name for field in fields(SequenceFacts)]):
        try:
            facts = SequenceFacts(
                row["dataset"],
                row["sequence"],
                float(row["length_km"]),
                int(row["frames"]),
                int(row["frames_rounded_to"]),
                row["withheld"],
            )
        except ValueError as error:
            raise BenchError(f"{path}, line {line}: {error}. Write numbers there.") from error
        if facts.dataset == dataset:
            found[facts.sequence] = facts
    return found


def _read_values(path: Path) -> list[PublishedValue]:
    columns = [field.name for field in fields(PublishedValue)]
    values = []
    for line, row in _rows(path, columns):
        value = PublishedValue(**{column: row[column] for column in columns})
        require_choice(f"{path}, line {line}: status", value.status, STATUSES)
        try:
            known = value.number is not None
        except ValueError as error:
            raise BenchError(f"{path}, line {line}: {value.value!r} is no number; leave it empty.") from error
        if known != (value.status in ("ok", "dagger")):
            raise BenchError(
                f"{path}, line {line}: status {value.status!r} does not go with the value {value.value!r}. "
                "Give a value with ok or dagger, and none with cross or not reported."
            )
        values.append(value)
    return values


def _rows(path: Path, columns: Sequence[str]) -> Iterator[tuple[int, dict[str, str]]]:
    """Line number and values of each row."""
    reader = csv.DictReader(read_text(path).splitlines())
    lacking = [column for column in columns if column not in (reader.fieldnames or [])]
    if lacking:
        raise BenchError(f"{path} lacks the column {lacking[0]!r}; it needs {', '.join(columns)}.")
    for row in reader:
        if None in row or None in row.values():
            raise BenchError(f"{path}, line {reader.line_num} has not {len(columns)} values. Quote values with commas.")
        yield reader.line_num, row
