"""Reading a named table from its YAML file, with every key checked."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, cast

import yaml  # type: ignore[import-untyped]  # comes with omegaconf

from bench.contracts.metric import Metric
from bench.discovery import load_plugins
from bench.errors import BenchError, did_you_mean, require_choice
from bench.evaluation.metrics import declared_metrics
from bench.installed_data import published_folder
from bench.registry import KINDS
from bench.tables.named.definitions import MethodRow, NamedTable
from bench.tables.named.published import SEQUENCES_FILE, SequenceFacts, read_sequences

_REQUIRED = ("title", "dataset", "sequences", "metrics")
_OPTIONAL = (
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
)
_OF_A_ROW = ("label", "published", "compared_with", "overrides", "never")
_OF_A_METRIC = ("key", "title", "decimals", "better")
# What an override of a row may set: the parts of a run that are not the table's own.
_SETTINGS = (*(kind for kind in KINDS if kind != "dataset"), "system", "dataset", "limits", "pipeline", "cache")


def read_table(file: Path, folders: Sequence[str] = ()) -> NamedTable:
    """The table that a YAML file holds, called as the file is; its metrics may be of evaluators in ``folders``.

    Raises ``BenchError``, with the file and the row, for a file that can't be read, an unknown key, a metric that no
    evaluator has, an override that is none, and a CSV file that is not there.
    """
    content = _mapping(str(file), _parsed(file), _REQUIRED, _OPTIONAL)
    where = str(file)
    columns = require_choice(f"{where}: columns", str(content.get("columns", "sequences")), ("sequences", "metrics"))
    dataset = _text(where, content, "dataset")
    sequences = _sequences(where, content["sequences"])
    if columns == "metrics" and len(sequences) > 1:
        raise BenchError(f"{where}: where columns are metrics there is one sequence; give one, or columns: sequences.")
    return NamedTable(
        name=file.stem,
        file=file,
        title=_text(where, content, "title"),
        dataset=dataset,
        sequences=sequences,
        metrics=tuple(_metric(where, each, folders) for each in _list(where, content, "metrics")),
        rows=_rows(file, content),
        across=cast(Literal["sequences", "metrics"], columns),
        about=_text(where, content, "about"),
        protocol=_text(where, content, "protocol") or "default",
        seeds=_seeds(where, content),
        published=_files(file, content, "published"),
        references=_files(file, content, "references"),
        facts=_facts(file, dataset),
    )


def _parsed(file: Path) -> Any:
    try:
        return yaml.safe_load(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise BenchError(f"Can't read {file}: {error}. Mend the file, or take it out of the folder.") from error
    except yaml.YAMLError as error:
        raise BenchError(f"{file} is no YAML: {' '.join(str(error).split())}. Mend that line.") from error


def _mapping(where: str, value: Any, required: Sequence[str], optional: Sequence[str] = ()) -> dict[str, Any]:
    """``value`` as a mapping that has all ``required`` keys and others only of ``optional``."""
    accepted = (*required, *optional)
    if not isinstance(value, dict):
        raise BenchError(f"{where} must hold keys and values (KEY: VALUE), of {', '.join(accepted)}.")
    for key in value:
        if key not in accepted:
            known = ", ".join(accepted)
            raise BenchError(
                f"{where} has an unknown key '{key}'; there are {known}.{did_you_mean(str(key), accepted)}"
            )
    lacking = [key for key in required if not value.get(key)]
    if lacking:
        raise BenchError(f"{where} lacks '{lacking[0]}'. Write {lacking[0]}: and what it is.")
    return value


def _text(where: str, content: Mapping[str, Any], key: str) -> str:
    """A string on one line, empty where the key is not there."""
    value = content.get(key, "")
    if not isinstance(value, str):
        raise BenchError(f"{where}: {key}: {value!r} is no text. Put it in quotes, {key}: '{value}'.")
    return " ".join(value.split())


def _list(where: str, content: Mapping[str, Any], key: str) -> list[Any]:
    value = content.get(key, [])
    if not isinstance(value, list):
        raise BenchError(f"{where}: {key} must be a list, {key}: [ONE, OTHER].")
    return value


def _sequences(where: str, value: Any) -> dict[str, tuple[str, ...]]:
    """Names of sequences, or of columns with the overrides that choose them."""
    if isinstance(value, dict):
        return {
            _text(where, {"sequences": name}, "sequences"): _overrides(f"{where}, sequence '{name}'", value, name, True)
            for name in value
        }
    names = [_text(where, {"sequences": name}, "sequences") for name in _list(where, {"sequences": value}, "sequences")]
    return {name: (f"dataset.sequence={name}",) for name in names}


def _metric(where: str, value: Any, folders: Sequence[str]) -> Metric:
    """A metric by its key alone, or with what the table changes of it."""
    if isinstance(value, str):
        value = {"key": value}
    changed = dict(_mapping(f"{where}: a metric", value, ("key",), _OF_A_METRIC[1:]))
    key = str(changed.pop("key"))
    known = {metric.key: metric for metric in declared_metrics()}
    if key not in known:
        # Only now, as importing every plugin takes seconds.
        load_plugins(folders)
        known = {metric.key: metric for metric in declared_metrics()}
    require_choice(f"{where}: the metric", key, known)
    if not isinstance(changed.get("decimals", 0), int):
        raise BenchError(f"{where}: decimals of {key}: {changed['decimals']!r} is no whole number.")
    try:
        return replace(known[key], **changed)
    except BenchError as error:
        raise BenchError(f"{where}: {error}") from error


def _rows(file: Path, content: Mapping[str, Any]) -> tuple[MethodRow, ...]:
    """The table's own rows, or those of another table beside it."""
    where = str(file)
    if ("rows" in content) == ("rows_of" in content):
        raise BenchError(f"{where} needs either rows, or rows_of with the name of a table whose rows it has.")
    if "rows_of" in content:
        other = file.with_name(f"{_text(where, content, 'rows_of')}.yaml")
        if not other.is_file():
            raise BenchError(f"{where}: rows_of: there is no {other}. Name a table that lies beside it.")
        of_other = _mapping(str(other), _parsed(other), _REQUIRED, _OPTIONAL)
        if "rows_of" in of_other:
            raise BenchError(f"{where}: rows_of: {other} has no rows of its own. Name the table that has them.")
        return _rows(other, of_other)
    shared = _overrides(where, content, "overrides"), _overrides(where, content, "never")
    rows = tuple(_row(where, number, each, *shared) for number, each in enumerate(_list(where, content, "rows"), 1))
    labels = [row.label for row in rows]
    for label in labels:
        if labels.count(label) > 1:
            raise BenchError(f"{where}: two rows are labelled '{label}'. Give each row its own label.")
    return rows


def _row(where: str, number: int, value: Any, shared: tuple[str, ...], never: tuple[str, ...]) -> MethodRow:
    of_row = _mapping(f"{where}, row {number}", value, ("label",), _OF_A_ROW[1:])
    label = _text(f"{where}, row {number}", of_row, "label")
    where = f"{where}, row '{label}'"
    published, compared = _text(where, of_row, "published"), _text(where, of_row, "compared_with")
    if published and compared:
        raise BenchError(f"{where}: published and compared_with exclude each other. Keep one of them.")
    if "overrides" not in of_row:
        return MethodRow(label, published=published, compared_with=compared)
    overrides = (*shared, *_overrides(where, of_row, "overrides"))
    return MethodRow(label, overrides, (*never, *_overrides(where, of_row, "never")), published, compared)


def _overrides(where: str, content: Mapping[str, Any], key: str, of_data: bool = False) -> tuple[str, ...]:
    """What is written as on the command line, ``system=bgs_slam loss=[rgb,ssim]``; ``of_data``: of the data set."""
    text = _text(where, content, key)
    try:
        overrides = shlex.split(text)
    except ValueError as error:
        raise BenchError(f"{where}: {key}: {text}: {error}. Write it as on the command line.") from error
    accepted = ("dataset",) if of_data else _SETTINGS
    for override in overrides:
        setting, equals, value = override.partition("=")
        part = setting.partition(".")[0]
        if not equals or not value:
            raise BenchError(
                f"{where}: {key}: '{override}' sets nothing. Write SETTING=VALUE, with blanks between them."
            )
        if part not in accepted or setting == "dataset":
            names = ", ".join(accepted)
            raise BenchError(
                f"{where}: {key}: '{override}' is no setting of a row; they begin with one of {names}."
                f"{did_you_mean(part, accepted)}"
            )
    return tuple(overrides)


def _seeds(where: str, content: Mapping[str, Any]) -> tuple[int, ...]:
    seeds = _list(where, content, "seeds") if "seeds" in content else [0, 1, 2]
    if not seeds or not all(type(seed) is int and seed >= 0 for seed in seeds) or len(set(seeds)) < len(seeds):
        raise BenchError(f"{where}: seeds: {seeds} must be different whole numbers, 0 or more, such as [0, 1, 2].")
    return tuple(seeds)


def _files(file: Path, content: Mapping[str, Any], key: str) -> tuple[Path, ...]:
    """The CSV files named under a key: beside the table, else among the bench's own."""
    names = content.get(key, [])
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
    beside = file.parent if (file.parent / SEQUENCES_FILE).is_file() else None
    return read_sequences(dataset) | (read_sequences(dataset, beside) if beside is not None else {})
