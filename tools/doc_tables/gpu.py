"""The table of GPUs, from the files of ``make gpu-check``: a row for each device, nothing where there is none."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from bench.errors import BenchError
from bench.runs.status import read_json
from tools.doc_tables.columns import link, text_table

FOLDER = "gpu"
_HEADINGS = (
    "device",
    "step, ms: 100 k / 1 M / 5 M",
    "of it render / losses / backward / Adam, % at 1 M",
    "GPU memory of steps, GB",
    "frames per s: bgs_slam_fast / bgs_slam",
    "all views dB",
    "largest 0.99 quantile of errors: images / gradients",
    "tests",
    "`torch.mm` of 1024^3, ms: GPU / CPU",
)
_COUNTS = (100_000, 1_000_000, 5_000_000)
_IMAGES = ("color", "depth", "alpha")
_NONE = "-"


def gpu_table(kept: Path, folder: Path) -> str:
    """Rows of all files in the folder ``gpu`` beside ``kept``, links relative to ``folder``.

    What was left out or failed has a dash. Raises ``BenchError`` for a damaged file.
    """
    files = sorted((kept.parent / FOLDER).glob("*.json"))
    return text_table(_HEADINGS, [_cells(read_json(file), file, folder) for file in files]) if files else ""


def _cells(content: dict[str, Any], file: Path, folder: Path) -> list[str]:
    try:
        device, parts = content["device"], content["parts"]
        results = {name: part.get("result") or {} for name, part in parts.items()}
        steps = {row["gaussians"]: row for row in results.get("mapping_step", {}).get("rows", [])}
        of_steps = [steps.get(count, {}) for count in _COUNTS]
        runs = {(row["system"], row["rasterizer"]): row for row in results.get("whole_system", {}).get("rows", [])}
        ours = [runs.get((system, "gsplat"), {}) for system in ("bgs_slam_fast", "bgs_slam")]
        versions = (
            f"driver {device['driver']}, CUDA {device['cuda']}, torch {device['torch']}, gsplat {device['gsplat']}"
        )
        return [
            f"[{device['gpu']}]({link(file, folder)}), {versions}; {device['date']}",
            _joined(of_steps, lambda row: f"{row['step_ms']:.1f}"),
            _shares(of_steps[1]),
            _joined(of_steps, lambda row: f"{row['gpu_memory_gb']:.1f}"),
            _joined(ours, lambda row: f"{row['frames_per_s']:.2f}"),
            _joined(ours, lambda row: f"{row['psnr_db']:.2f}"),
            _errors(results.get("conformance", {}).get("errors", {})),
            _tests(results.get("marked_tests")),
            _joined(of_steps[1:2], lambda row: f"{row['mm_gpu_ms']:.2f} / {row['mm_cpu_ms']:.1f}"),
        ]
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise BenchError(f"{file} is damaged ({error!r}). Make it again with `make gpu-check`.") from error


def _joined(rows: list[dict[str, Any]], text: Callable[[dict[str, Any]], str]) -> str:
    """The rows' texts; a row that is not there, or was out of memory, has none."""
    return " / ".join(_NONE if not row or "reason" in row else text(row) for row in rows)


def _shares(row: dict[str, Any]) -> str:
    if "stages_ms" not in row:
        return _NONE
    stages = [row["stages_ms"][name] for name in ("render", "losses", "backward", "adam")]
    return " / ".join(f"{100 * each / row['step_ms']:.0f}" for each in stages)


def _errors(errors: dict[str, Any]) -> str:
    """Over scenes and what was compared with; the second number of each list is the 0.99 quantile."""
    found: dict[bool, list[float]] = {True: [], False: []}
    for of_scene in errors.values():
        for of_other in of_scene.values():
            for what, quantiles in of_other.items():
                found[what in _IMAGES].append(float("nan") if quantiles[1] is None else quantiles[1])
    if not errors:
        return _NONE
    # NaN is the largest.
    worst = [max(values, key=lambda value: (value != value, value)) for values in found.values()]
    return " / ".join(f"{value:.1e}" for value in worst)


def _tests(result: dict[str, Any] | None) -> str:
    return _NONE if not result else f"{result['passed']} of {result['passed'] + len(result['failed'])} passed"
