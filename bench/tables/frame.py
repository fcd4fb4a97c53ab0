"""Runs as a pandas DataFrame: the rows of ``bgs-bench table``."""

from __future__ import annotations

import glob
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from bench.errors import BenchError
from bench.tables.collect import Row, collect_row, find_runs, row_of
from bench.tables.groups import by_settings
from bench.tables.records.file import is_record_file, read_record_file
from bench.tables.render import runs_data


def load_runs(*places: str | Path, average: bool = False) -> pd.DataFrame:
    """One row per run, with the columns of ``bgs-bench table --out FILE.csv``, and ``path``.

    ``places``: run folders, folders of them (a sweep's), record files (``NAME.runs.json``), or patterns of these
    (``"results/runs/a*"``); without any, all under ``results/runs``. A column for each setting in which the runs differ
    (``mapper.iterations``), then names, states and metrics by key, with units in the key (``psnr_db``); what is not
    known is NaN. ``average=True`` has one row for runs that differ in their seed alone, as the table has: means, and
    sample standard deviations under ``KEY_std``. A damaged run is a row that says so in ``status``. Raises
    ``BenchError`` for a place that holds no run.

    >>> runs = load_runs("results/tables/trackers.runs.json")
    >>> {"run", "path", "seed", "psnr_db", "ate_rmse_m"} <= set(runs.columns)
    True
    """
    rows = rows_at([path for place in places for path in expanded(str(place))])
    data = runs_data(rows, average)
    table = pd.DataFrame(list(data.rows), columns=list(data.columns))
    for column in table:
        numbers = pd.to_numeric(table[column], errors="coerce")
        if column not in ("run", "seeds", "frames") and (numbers.notna() == table[column].notna()).all():
            table[column] = numbers
    if not average:
        table.insert(1, "path", [str(row.runs[0].source) for row in rows])
        table["seeds"] = table["seeds"].astype(int)
        table = table.rename(columns={"seeds": "seed"}).drop(columns="n")
    return table


def rows_at(paths: Sequence[Path]) -> list[Row]:
    """The rows of run folders, of folders of them and of record files, ordered by the settings in which they differ."""
    files = [path for path in paths if is_record_file(path)]
    given = [path for path in paths if path not in files]
    folders = find_runs(given) if given or not files else []
    rows = [row_of(run) for file in files for run in read_record_file(file).runs]
    return by_settings([*rows, *(collect_row(folder) for folder in folders)])


def expanded(place: str) -> list[Path]:
    """The paths that a pattern stands for, or the one that it is; ``BenchError`` for a pattern of nothing."""
    if Path(place).exists() or not glob.has_magic(place):
        return [Path(place)]
    found = [Path(each) for each in sorted(glob.glob(place, recursive=True))]
    folders = [path for path in found if path.is_dir() or is_record_file(path)]
    if not folders:
        raise BenchError(f"Nothing here is called like {place}. Check the pattern and the working folder.")
    return folders
