"""What a number came from: code, packages, machine, seed, weights."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

import bench
from bench.weights.checksum import sha256_of as sha256_of

_PACKAGES = (
    "bgs-slam-bench",
    "torch",
    "numpy",
    "opencv-python-headless",
    "opencv-python",
    "onnxruntime",
    "gtsam",
    "pyorbslam3",
    "hydra-core",
    "omegaconf",
    "pandas",
    "scikit-image",
    "lpips",
    "torchvision",
    "gsplat",
    "gtsam",
)


def collect_provenance(config: dict[str, Any], seed: int, weights: Mapping[str, Path] | None = None) -> dict[str, Any]:
    """Everything that is needed to make a run again, as a plain dict for ``provenance.json``.

    A missing git, checkout or GPU gives None, never an error. ``weights`` are the files that the run's networks use, by
    what they are for; scoring adds its own later (``describe_weights``).
    """
    return {
        "git": _git_state(),
        "command": list(sys.argv),
        "seed": seed,
        "plugins": _plugins(config),
        "packages": _versions(),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "machine": {
            "cpu": _cpu_model(),
            "cores": os.cpu_count(),
            "usable_cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
            "torch_threads": torch.get_num_threads(),
            "gpu": torch.cuda.get_device_name() if torch.cuda.is_available() else None,
        },
        "weights": describe_weights(weights or {}),
    }


def _plugins(config: dict[str, Any]) -> dict[str, str]:
    """Name of the plugin of each kind of which a run has one, and of those that are settings of these."""
    parts = {kind: part for kind, part in config.items() if isinstance(part, dict) and part.get("name")}
    inner = {key: each for part in parts.values() for key, each in part.items() if isinstance(each, dict)}
    return {key: part["name"] for key, part in (parts | inner).items() if part.get("name")}


def describe_weights(weights: Mapping[str, Path]) -> dict[str, dict[str, str]]:
    """Name and SHA-256 of each file of network weights, by what it is for."""
    return {name: {"file": path.name, "sha256": sha256_of(path)} for name, path in weights.items()}


def _git_state() -> dict[str, Any] | None:
    """Commit and dirty flag of this project's checkout: where the package lies, else where the command was given."""
    for root in (Path(bench.__file__).resolve().parents[1], Path.cwd()):
        if (root / ".git").exists() and (root / "bench" / "registry.py").is_file():
            commit = _git(root, "rev-parse", "HEAD")
            changes = _git(root, "status", "--porcelain")
            return {"commit": commit, "dirty": None if changes is None else bool(changes)}
    return None


def _git(root: Path, *arguments: str) -> str | None:
    try:
        answer = subprocess.run(
            ["git", "-C", str(root), *arguments], capture_output=True, text=True, timeout=20, check=True
        )
    except (OSError, subprocess.SubprocessError):
        return None  # no git here, or a checkout without a commit: provenance says so with null
    return answer.stdout.strip()


def _versions() -> dict[str, str]:
    installed = {}
    for name in _PACKAGES:
        try:
            installed[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return installed


def _cpu_model() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        for line in cpuinfo.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
