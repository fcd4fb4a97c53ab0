"""What can change the last bits of a computed result: versions of what computes, GPU, vector instructions; and how fast
the machine is now."""

from __future__ import annotations

import importlib.metadata
import os
import time
from typing import Any

import torch

_COMPUTING_PACKAGES = ("torch", "numpy", "opencv-python-headless", "opencv-python", "onnxruntime", "onnxruntime-gpu")


def what_computes() -> dict[str, Any]:
    """Versions of the packages that compute, the GPU's name, and the vector instructions that torch and our own kernels
    use here; as plain data, equal on machines whose results are comparable to the bit."""
    versions = {}
    for package in _COMPUTING_PACKAGES:
        try:
            versions[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            continue
    return {
        "packages": versions,
        "gpu": torch.cuda.get_device_name() if torch.cuda.is_available() else None,
        "cpu": torch.backends.cpu.get_cpu_capability(),
        "kernels": os.environ.get("BGS_KERNELS"),
    }


def matrix_product_ms(rounds: int = 5) -> float:
    """Milliseconds that ``torch.mm`` of 1024^3 in float32 takes on the CPU now, with torch's threads: the least of
    ``rounds``. The yardstick beside seconds, which differ with the machine and with what else it does."""
    a = torch.ones(1024, 1024)  # no random numbers: a run's stay as its seed says
    seconds = []
    for _ in range(rounds):
        start = time.perf_counter()
        torch.mm(a, a)
        seconds.append(time.perf_counter() - start)
    return 1e3 * min(seconds)
