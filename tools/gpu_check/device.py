"""What the numbers were measured on, and the yardstick beside them."""

from __future__ import annotations

import datetime
import itertools
import re
import shutil
import subprocess
import time
from collections.abc import Callable
from typing import Any

import torch

from bench.machine import matrix_product_ms
from bench.runs.provenance import collect_provenance

_ROUNDS = 20


def describe_device() -> dict[str, Any]:
    """GPU, driver, versions, processor, code; of the GPU None where there is none."""
    found = collect_provenance({}, 0)
    there = torch.cuda.is_available()
    properties = torch.cuda.get_device_properties(0) if there else None
    return {
        "gpu": properties and properties.name,
        "gpu_memory_gb": properties and round(properties.total_memory / 1e9, 1),
        "capability": properties and f"{properties.major}.{properties.minor}",
        "driver": _driver() if there else None,
        "cuda": torch.version.cuda,
        "torch": torch.__version__,
        "gsplat": found["packages"].get("gsplat"),
        "cpu": found["machine"]["cpu"],
        "usable_cores": found["machine"]["usable_cores"],
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "git": found["git"],
    }


def file_name(gpu: str) -> str:
    """``nvidia-h100-80gb-hbm3.json`` for "NVIDIA H100 80GB HBM3"."""
    return f"{re.sub(r'[^a-z0-9]+', '-', gpu.lower()).strip('-')}.json"


def yardstick() -> dict[str, float | None]:
    """Milliseconds of ``torch.mm`` of 1024^3 in float32 now, on the CPU and on the GPU: the least of 20 rounds."""
    of_gpu = _mm_on_gpu_ms() if torch.cuda.is_available() else None
    return {"mm_cpu_ms": matrix_product_ms(_ROUNDS), "mm_gpu_ms": of_gpu}


def _mm_on_gpu_ms() -> float:
    device = torch.device("cuda")
    a = torch.ones(1024, 1024, device=device)
    return min(sum(staged(device, {"mm": lambda: torch.mm(a, a)}).values()) for _ in range(_ROUNDS))


def staged(device: torch.device, stages: dict[str, Callable[[], object]]) -> dict[str, float]:
    """Run the stages in turn; milliseconds of each, by events of the GPU or, on the CPU, by the clock."""
    marks: list[Any] = [_mark(device)]
    for run in stages.values():
        run()
        marks.append(_mark(device))
    if device.type == "cuda":
        torch.cuda.synchronize(device)
        spans = [begin.elapsed_time(end) for begin, end in itertools.pairwise(marks)]
    else:
        spans = [1e3 * (end - begin) for begin, end in itertools.pairwise(marks)]
    return dict(zip(stages, spans, strict=True))


def _mark(device: torch.device) -> Any:
    if device.type != "cuda":
        return time.perf_counter()
    event = torch.cuda.Event(enable_timing=True)
    event.record()
    return event


def _driver() -> str | None:
    if shutil.which("nvidia-smi") is None:
        return None
    query = ["nvidia-smi", "--query-gpu=driver_version", "--format=csv,noheader"]
    answer = subprocess.run(query, capture_output=True, text=True, timeout=20, check=False)
    return answer.stdout.partition("\n")[0].strip() or None
