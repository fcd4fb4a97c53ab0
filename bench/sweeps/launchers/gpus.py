"""The GPUs among which a sweep deals out its runs."""

from __future__ import annotations

import os

import torch


def gpus_of_this_machine() -> list[str]:
    """Names as ``CUDA_VISIBLE_DEVICES`` takes them: those it names already, else all; empty without any."""
    named = os.environ.get("CUDA_VISIBLE_DEVICES")
    if named is not None:
        return [name.strip() for name in named.split(",") if name.strip()]
    return [str(number) for number in range(torch.cuda.device_count())]
