"""``bgs-bench doctor``: what this machine runs with, and what is missing with the command that mends it."""

from __future__ import annotations

import argparse
import importlib.metadata
import os
import platform
from typing import Any

import torch
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from bench.discovery import load_plugins
from bench.evaluation.lpips_metric import WeightsFound, find_alexnet_weights
from bench.registry import KINDS, broken_files, lookup, names

_EXAMPLES = """examples:
  bgs-bench doctor
  bgs-bench doctor > doctor.txt        # to go with the report of a fault
"""


def add_parser(subparsers: Any) -> None:
    """Register the command with the parser that ``bgs-bench`` builds."""
    parser = subparsers.add_parser(
        "doctor",
        help="what runs here, what is missing, and how to mend it",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print one line a fact; exit code 0 when everything that the default system needs is there, else 1."""
    load_plugins()
    rows = [*_machine(), *_native(), *_cuda(), _lpips(), *_plugins()]
    table = Table(show_header=False, box=None)
    for what, good, text in rows:
        table.add_row("[green]ok[/]" if good else "[yellow]--[/]", escape(what), escape(text))
    Console().print(table)
    return 0 if all(good for what, good, _ in rows if what == "C++ core") else 1


Row = tuple[str, bool, str]


def _machine() -> list[Row]:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return [
        ("machine", True, f"{platform.machine()}, {cores} cores, Python {platform.python_version()}"),
        ("torch", True, f"{torch.__version__}, {torch.get_num_threads()} threads"),
    ]


def _native() -> list[Row]:
    try:
        import bench._native as _native
    except ImportError as error:
        return [("C++ core", False, f"can't be loaded ({error}). Run: make install")]
    return [("C++ core", True, f"{_native.instruction_set()} kernels, {_native.threads()} threads")]


def _cuda() -> list[Row]:
    there = torch.cuda.is_available()
    device = torch.cuda.get_device_name(0) if there else "none found; the CPU core is used"
    try:
        gsplat = importlib.metadata.version("gsplat")
    except importlib.metadata.PackageNotFoundError:
        return [
            ("CUDA", there, device),
            ("gsplat", False, "not installed. With an NVIDIA GPU: pip install 'bgs-slam-bench[cuda]'"),
        ]
    return [("CUDA", there, device), ("gsplat", there, gsplat if there else f"{gsplat}, but there is no CUDA device")]


def _lpips() -> Row:
    found = find_alexnet_weights(None)
    if isinstance(found, WeightsFound):
        return ("LPIPS weights", True, str(found.source))
    return ("LPIPS weights", False, found)


def _plugins() -> list[Row]:
    rows: list[Row] = []
    for kind in KINDS:
        for name in names(kind):
            reason = lookup(kind, name).unavailable_reason()
            if reason is not None:
                rows.append((f"{kind}={name}", False, reason))
    return rows + [(file, False, f"failed to import: {reason}") for file, reason in broken_files.items()]
