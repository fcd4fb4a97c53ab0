"""The command: what is missing, the parts one by one, and ``results/gpu/<device>.json``."""

from __future__ import annotations

import argparse
import importlib
import os
import shutil
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from bench.errors import BenchError
from bench.io.atomic import write_json
from tools.gpu_check.parts import PARTS, Outcome, run_in_process, run_parts

FORMAT = 1
_ABOUT = """Checks gsplat on this machine's GPU against the float64 reference and the C++ core, measures iterations of
mapping and the whole system, and runs the tests marked cuda. Writes results/gpu/<device>.json, from which
`python -m tools.doc_tables` makes the table in docs/performance.md. Exit code 0 where all was done, 1 where a part
failed or did not fit, 2 where something is missing. Nothing is installed, and nothing comes from the network."""
_WORK = Path("build/gpu_check")
_INSTALL = "pip install '.[cuda]' (without a network: pip install --no-index --find-links FOLDER_OF_WHEELS '.[cuda]')"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the check, or one part of it (``--part``, which the check starts in a process of its own)."""
    parser = argparse.ArgumentParser(prog="python -m tools.gpu_check", description=_ABOUT)
    parser.add_argument("--seconds", type=float, default=480.0, help="what it may take in all (default: 480)")
    parser.add_argument("--out", type=Path, default=Path("results/gpu"), help="folder (default: results/gpu)")
    parser.add_argument("--part", choices=[part.name for part in PARTS], help=argparse.SUPPRESS)
    parser.add_argument("--to", type=Path, help=argparse.SUPPRESS)
    args = parser.parse_args(arguments)
    try:
        if args.part is not None:
            measure_part(args.part, args.to)
            return 0
        require_gpu()
        return check(args.out, args.seconds)
    except BenchError as error:
        print(f"tools.gpu_check: {error}", file=sys.stderr)
        return error.exit_code


def require_gpu() -> None:
    """Raises ``BenchError`` that says what is missing here and how to get it."""
    if find_spec("torch") is None:
        raise BenchError(
            "torch is not installed here. Install a build of torch for CUDA, then run make gpu-check again."
        )
    import torch

    if not torch.cuda.is_available():
        raise BenchError(
            f"torch {torch.__version__} sees no CUDA device, so there is nothing to check. Run make gpu-check on a "
            "machine with an NVIDIA GPU, a driver and a CUDA build of torch."
        )
    if find_spec("bench._native") is None:
        raise BenchError("the C++ core is not built. Run: pip install --no-build-isolation --no-deps -e .")
    packages = [name for name in ("gsplat", "jaxtyping", "ninja", "hydra", "cv2") if find_spec(name) is None]
    if packages:
        raise BenchError(f"not installed here: {', '.join(packages)}. Run: {_INSTALL}.")
    if find_spec("gsplat.csrc") is None and not (shutil.which("nvcc") or os.environ.get("CUDA_HOME")):
        raise BenchError(
            "gsplat's kernels are built at its first use, and there is no nvcc. Put the CUDA toolkit's bin on PATH."
        )


def check(out: Path, seconds: float) -> int:
    """Run all parts within so many seconds; what is known is written after each. Exit code 0 where all were done."""
    from tools.gpu_check.device import describe_device, file_name

    device = describe_device()
    file = out / file_name(device["gpu"])
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BenchError(f"Can't make the folder {out}: {error.strerror}. Give another --out.") from error
    # gsplat compiles with ten processes unless it is told.
    environment = os.environ | {"MAX_JOBS": os.environ.get("MAX_JOBS", str(device["usable_cores"]))}
    parts: dict[str, Outcome] = {}

    def tell(name: str, outcome: Outcome) -> None:
        reason = f": {outcome['reason']}" if "reason" in outcome else ""
        print(f"{name}: {outcome['status']}, {outcome['seconds']:.0f} s{reason}", flush=True)
        parts[name] = outcome
        write_json(file, {"format": FORMAT, "device": device, "parts": parts})

    def run(name: str, box_s: float) -> Outcome:
        return run_in_process(name, box_s, _WORK, environment=environment)

    print(f"{device['gpu']}, driver {device['driver']}, torch {device['torch']}; at most {seconds:.0f} s", flush=True)
    outcomes = run_parts(PARTS, run, seconds, tell)
    print(f"wrote {file}")
    return 0 if all(outcome["status"] == "done" for outcome in outcomes.values()) else 1


def measure_part(name: str, file: Path) -> None:
    """Make one part in this process; the file holds what is measured so far."""
    from bench.discovery import load_plugins

    load_plugins()
    for result in importlib.import_module(f"tools.gpu_check.{name}").measure():
        write_json(file, result)
