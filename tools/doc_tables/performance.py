"""The benchmarks' ratios, kept as one file that says on what they were measured."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from bench.errors import BenchError
from bench.runs.status import read_json

FILE = "performance.json"


def performance_text(folder: Path, machine: dict[str, Any], commit: str) -> str:
    """The text of the kept file, from those that ``make bench`` left in ``folder``.

    ``machine`` says cpu, usable_cores and gpu, ``commit`` the code. Raises ``BenchError`` for a folder that holds none,
    and for a damaged file.
    """
    files = sorted(folder.glob("*.json"))
    if not files:
        raise BenchError(f"{folder} holds no results of benchmarks. Make them with `make bench`.")
    content = {
        "device": machine,
        "commit": commit,
        "benchmarks": {file.stem: read_json(file) for file in files},
    }
    return json.dumps(content, indent=1) + "\n"


def ratio(kept: dict[str, Any], benchmark: str, name: str) -> float:
    """A ratio of a benchmark; raises ``BenchError`` where the kept file lacks it."""
    found = kept.get("benchmarks", {}).get(benchmark, {}).get("ratios", {}).get(name)
    if not isinstance(found, (int, float)):
        raise BenchError(
            f"{FILE} lacks the ratio {name!r} of {benchmark}. Run `make bench`, then keep its results again."
        )
    return float(found)


def device_of(kept: dict[str, Any]) -> str:
    """What the benchmarks ran on, in words, with the yardstick's milliseconds."""
    device = kept.get("device", {})
    gpu = device.get("gpu") or "no GPU"
    mm = kept.get("benchmarks", {}).get("rasterizer", {}).get("milliseconds", {}).get("torch.mm 1024^3")
    yardstick = f", mm 1024^3 {mm:.0f} ms" if isinstance(mm, int | float) else ""
    return f"{device.get('cpu', 'unknown processor')}, {device.get('usable_cores', '?')} cores, {gpu}{yardstick}"
