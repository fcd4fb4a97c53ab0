"""The runs that a table is made of, from run folders and record files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bench.errors import BenchError
from bench.runs.config_file import CONFIG_FILE, RUNS_FOLDER
from bench.tables.collect import find_runs
from bench.tables.records.file import TableRecord, in_order, is_record_file, read_record_file
from bench.tables.records.folder import read_folder


def read_runs(paths: Sequence[Path], views: str | None = None) -> TableRecord:
    """The runs in and directly under ``paths`` (default ``results/runs``), and in record files among them.

    ``views`` says whose PSNR, SSIM, LPIPS and Depth-L1 are read: "left" (all left images), "heldout" or "right"; None:
    those that a record file was made with, else "left". Raises ``BenchError`` for a path that was given and holds no
    run; no runs in the default folder are no error.
    """
    files = [path for path in paths if is_record_file(path)]
    folders = [path for path in paths if path not in files]
    records: list[TableRecord] = []
    for file in files:
        records.append(read_record_file(file, views or (records[0].views if records else None)))
    chosen = views or (records[0].views if records else "left")
    runs = [run for one in records for run in one.runs]
    problems = [problem for one in records for problem in one.problems]
    if folders or (not files and any(RUNS_FOLDER.glob(f"*/{CONFIG_FILE}"))):
        for folder in sorted(set(find_runs(folders))):
            try:
                runs.append(read_folder(folder, chosen))
            except BenchError as error:
                problems.append(_about(folder, error))
    table = records[0].table if records else ""
    return TableRecord(table, chosen, tuple(in_order(runs)), sum(one.others for one in records), tuple(problems))


def _about(folder: Path, error: BenchError) -> str:
    """What is wrong with a run folder; it is called by its name alone, so that a table does not say where it lay."""
    return str(error).replace(str(folder), folder.resolve().name)
