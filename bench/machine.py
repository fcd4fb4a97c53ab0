"""What can change the last bits of a computed result: versions of what computes, GPU, vector instructions."""

from __future__ import annotations

import importlib.metadata
import os
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
