"""Fixtures of the evaluation tests."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.evaluation.tiny_run import write_tiny_run


@pytest.fixture
def tiny_config() -> dict[str, Any]:
    names = ("ate", "rpe", "kitti_odometry", "image", "depth_l1", "resources")
    return {
        "dataset": {"name": "tiny_for_tests"},
        "stereo": {"name": "sgbm"},
        "evaluator": {name: {"name": name} for name in names},
        "protocol": {"holdout_every": 5, "holdout_remainder": 3, "lpips": False},
    }


@pytest.fixture
def tiny_run(tmp_path: Path, tiny_config: dict[str, Any]) -> Path:
    return write_tiny_run(tmp_path / "run", tiny_config)
