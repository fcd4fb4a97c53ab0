"""Reading the CSV files of a run folder."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import pandas as pd

from bench.errors import BenchError
from bench.io.foreign import MOST_TEXT, open_plain, reading


def read_csv(path: Path, columns: Iterable[str]) -> pd.DataFrame:
    """Read a CSV file that must have these columns; raises ``BenchError`` when it is missing, damaged or lacks one."""
    if not path.is_file():
        raise BenchError(
            f"{path} is missing: the run did not get far enough to be scored. Run it again with rerun=true."
        )
    with reading(path, "can't be read as CSV", "Run again with rerun=true."), open_plain(path, MOST_TEXT) as file:
        # The default float parser is off by an ulp; poses must come back as they were.
        table = pd.read_csv(file, float_precision="round_trip", encoding="utf-8-sig")
    lacking = [name for name in columns if name not in table.columns]
    if lacking:
        raise BenchError(f"{path} lacks the column {lacking[0]!r}. Run again with rerun=true.")
    return table
