"""Reading a named table from its YAML file, with every key checked."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, cast

import yaml  # type: ignore[import-untyped]  # comes with omegaconf

from bench.contracts.metric import Metric
from bench.discovery import load_plugins
from bench.errors import BenchError, did_you_mean, require_choice
from bench.evaluation.metrics import declared_metrics
from bench.installed_data import published_folder
from bench.io.text_files import read_text
from bench.registry import RUN_KINDS, SEVERAL_AT_ONCE
from bench.tables.named.definitions import MethodRow, NamedTable
from bench.tables.named.published import SEQUENCES_FILE, SequenceFacts, read_sequences

_OF_A_TABLE = (
    *("title", "dataset", "sequences", "metrics"),
    *(
        "about",
        "columns",
        "protocol",
        "seeds",
        "published",
        "references",
        "overrides",
        "never",
        "rows",
        "rows_of",
        "other_rows",
        "part",
    ),
)
_OF_A_ROW = ("label", "published", "compared_with", "overrides", "never", "on_part", "iterations", "note")
_OF_A_METRIC = ("key", "title", "decimals", "better")
# Kinds of which a run has one, so that a plugin can name a row.
_NAMING_ROWS = tuple(kind for kind in RUN_KINDS if kind not in (*SEVERAL_AT_ONCE, "dataset"))
# What an override of a row may set: all that is not the table's own.
_SETTINGS = (*RUN_KINDS, "system", "limits", "pipeline", "threads", "cache")


def read_table(file: Path, folders: Sequence[str] = ()) -> NamedTable:
    """The table that a YAML file holds, called as the file is; its metrics may be of evaluators in ``folders``.

    Raises ``BenchError``, with the file and the row, for a file that can't be read, an unknown key, a metric that no
    evaluator has, an override that is none, and a CSV file that is not there.
    """
    table = _read(file)
    across = require_choice(f"{file}: columns", table.text("columns") or "sequences", ("sequences", "metrics"))
    sequences = _sequences(table)
    if across == "metrics" and len(sequences) > 1:
        raise BenchError(f"{file}: where columns are metrics there is one sequence; give one, or columns: sequences.")
    rows_of = _with_rows(table, file)
    other_rows = rows_of.text("other_rows")
    if other_rows:
        require_choice(f"{rows_of.where}: other_rows", other_rows, _NAMING_ROWS)
    part, rows = table.overrides("part", ("dataset",)), _rows(rows_of)
    if not part and (whole := next((row.label for row in rows if row.on_part), "")):
        raise BenchError(f"{file}: row '{whole}' is on_part, and the table has no part: dataset.SETTING=VALUE. Add it.")
    return NamedTable(
        name=file.stem,
        file=file,
        title=table.text("title"),
        dataset=table.text("dataset"),
        sequences=sequences,
        metrics=tuple(_metric(f"{file}: a metric", each, folders) for each in table.list("metrics")),
        rows=rows,
        other_rows=other_rows,
        overrides=rows_of.overrides("overrides"),
        never=rows_of.overrides("never"),
        part=part,
        across=cast(Literal["sequences", "metrics"], across),
        about=table.text("about"),
        protocol=table.text("protocol") or "default",
        seeds=_seeds(table),
        published=_files(table, file, "published"),
        references=_files(table, file, "references"),
        facts=_facts(file, table.text("dataset")),
    )


class _Part:
    """A mapping in the file, with the place that errors name; it has no other keys than those that are ``accepted``."""

    def __init__(self, where: str, content: Any, accepted: Sequence[str], required: int = 1) -> None:
        names = ", ".join(accepted)
        if not isinstance(content, dict):
            raise BenchError(f"{where} must hold keys and values (KEY: VALUE), of {names}.")
        for key in content:
            if key not in accepted:
                hint = did_you_mean(str(key), accepted)
                raise BenchError(f"{where} has an unknown key '{key}'; there are {names}.{hint}")
        for key in accepted[:required]:
            if not content.get(key):
                raise BenchError(f"{where} lacks '{key}'. Write {key}: and what it is.")
        self.where, self.content = where, content

    def text(self, key: str) -> str:
        """A string on one line, empty where the key is not there."""
        return _text(self.where, key, self.content.get(key, ""))

    def list(self, key: str) -> list[Any]:
        value = self.content.get(key, [])
        if not isinstance(value, list):
            raise BenchError(f"{self.where}: {key} must be a list, {key}: [ONE, OTHER].")
        return value

    def overrides(self, key: str, accepted: Sequence[str] = _SETTINGS) -> tuple[str, ...]:
        """What is written as on the command line: ``system=bgs_slam loss=[rgb,ssim]``."""
        where, text = f"{self.where}: {key}", self.text(key)
        try:
            overrides = shlex.split(text)
        except ValueError as error:
            raise BenchError(f"{where}: {text}: {error}. Write it as on the command line.") from error
        for override in overrides:
            setting, _, value = override.partition("=")
            part = setting.partition(".")[0]
            if not value:
                raise BenchError(f"{where}: '{override}' sets nothing. Write SETTING=VALUE, with blanks between them.")
            if part not in accepted or setting == "dataset":
                names, hint = ", ".join(accepted), did_you_mean(part, accepted)
                raise BenchError(f"{where}: '{override}' is no setting here; they begin with one of {names}.{hint}")
        return tuple(overrides)


def _text(where: str, key: str, value: Any) -> str:
    if not isinstance(value, str):
        raise BenchError(f"{where}: {key}: {value!r} is no text. Put it in quotes, {key}: '{value}'.")
    return " ".join(value.split())


def _read(file: Path) -> _Part:
    try:
        return _Part(str(file), yaml.safe_load(read_text(file, "table")), _OF_A_TABLE, required=4)
    except yaml.YAMLError as error:
        raise BenchError(f"{file} is no YAML: {' '.join(str(error).split())}. Mend that line.") from error


def _sequences(table: _Part) -> dict[str, tuple[str, ...]]:
    """Names of sequences, or of columns with the overrides that choose them."""
    given = table.content["sequences"]
    names = [
        _text(table.where, "sequences", name)
        for name in (given if isinstance(given, dict) else table.list("sequences"))
    ]
    if not isinstance(given, dict):
        return {name: (f"dataset.sequence={name}",) for name in names}
    columns = _Part(f"{table.where}, sequences", given, names)
    return {name: columns.overrides(name, ("dataset",)) for name in names}


def _metric(where: str, value: Any, folders: Sequence[str]) -> Metric:
    """A metric by its key alone, or with what the table changes of it."""
    changed = dict(_Part(where, {"key": value} if isinstance(value, str) else value, _OF_A_METRIC).content)
    key = str(changed.pop("key"))
    known = {metric.key: metric for metric in declared_metrics()}
    if key not in known:
        # Only now, as importing every plugin takes seconds.
        load_plugins(folders)
        known = {metric.key: metric for metric in declared_metrics()}
    require_choice(f"{where}: key", key, known)
    if not isinstance(changed.get("decimals", 0), int):
        raise BenchError(f"{where}: decimals of {key}: {changed['decimals']!r} is no whole number.")
    try:
        return replace(known[key], **changed)
    except BenchError as error:
        raise BenchError(f"{where}: {error}") from error


def _with_rows(table: _Part, file: Path) -> _Part:
    """The table whose rows it has: itself, or another one beside it."""
    if ("rows" in table.content) == ("rows_of" in table.content):
        raise BenchError(f"{file} needs either rows, or rows_of with the name of a table whose rows it has.")
    if "rows_of" not in table.content:
        return table
    other = file.with_name(f"{table.text('rows_of')}.yaml")
    if not other.is_file():
        raise BenchError(f"{file}: rows_of: there is no {other}. Name a table that lies beside it.")
    of_other = _read(other)
    if "rows_of" in of_other.content:
        raise BenchError(f"{file}: rows_of: {other} has no rows of its own. Name the table that has them.")
    return of_other


def _rows(table: _Part) -> tuple[MethodRow, ...]:
    rows = tuple(_row(table, number, each) for number, each in enumerate(table.list("rows"), 1))
    labels = [row.label for row in rows]
    for label in labels:
        if labels.count(label) > 1:
            raise BenchError(f"{table.where}: two rows are labelled '{label}'. Give each row its own label.")
    return rows


def _row(table: _Part, number: int, value: Any) -> MethodRow:
    label = _Part(f"{table.where}, row {number}", value, _OF_A_ROW).text("label")
    row = _Part(f"{table.where}, row '{label}'", value, _OF_A_ROW)
    published, compared = row.text("published"), row.text("compared_with")
    if published and compared:
        raise BenchError(f"{row.where}: published and compared_with exclude each other. Keep one of them.")
    if "overrides" not in row.content:
        return MethodRow(label, published=published, compared_with=compared)
    overrides, never = ((*table.overrides(key), *row.overrides(key)) for key in ("overrides", "never"))
    on_part = row.content.get("on_part", False)
    if not isinstance(on_part, bool):
        raise BenchError(f"{row.where}: on_part: {on_part!r} is neither true nor false.")
    iterations = row.overrides("iterations")
    for each in iterations:
        if not each.partition("=")[2].isdecimal():
            raise BenchError(f"{row.where}: iterations: '{each}' is no whole number. Write SETTING=NUMBER.")
    return MethodRow(label, overrides, never, published, compared, on_part, iterations, row.text("note"))


def _seeds(table: _Part) -> tuple[int, ...]:
    seeds = table.list("seeds") if "seeds" in table.content else [0, 1, 2]
    if not seeds or not all(type(seed) is int and seed >= 0 for seed in seeds) or len(set(seeds)) < len(seeds):
        raise BenchError(f"{table.where}: seeds: {seeds} must be different whole numbers, 0 or more, as [0, 1, 2].")
    return tuple(seeds)


def _files(table: _Part, file: Path, key: str) -> tuple[Path, ...]:
    """The CSV files named under a key: beside the table, else among the bench's own."""
    names = table.content.get(key, [])
    found = []
    for name in names if isinstance(names, list) else [names]:
        places = [folder / str(name) for folder in (file.parent, published_folder())]
        path = next((place for place in places if place.is_file()), None)
        if path is None:
            raise BenchError(f"{file}: {key}: there is no {places[0]}. Put the CSV file there, or leave {key} out.")
        found.append(path)
    return tuple(found)


def _facts(file: Path, dataset: str) -> dict[str, SequenceFacts]:
    """What is known of the data set's sequences: the bench's own knowledge, then what lies beside the table."""
    beside = (file.parent / SEQUENCES_FILE).is_file()
    return read_sequences(dataset) | (read_sequences(dataset, file.parent) if beside else {})
