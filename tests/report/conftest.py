"""A scored run of five frames, and the report of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from bench.evaluation.run_evaluators import evaluate_run
from tests.evaluation.tiny_run import write_tiny_run

HOSTILE = """x"><script>window.hurt=1</script> 'a' | b & =1+1"""


def tiny_config(**settings: Any) -> dict[str, Any]:
    """A config of the tiny run; ``settings`` are more of it."""
    return {
        "system": "bgs_slam",
        "seed": 0,
        "dataset": {"name": "tiny_for_tests"},
        "stereo": {"name": "sgbm"},
        "mapper": {"name": "gaussian", "iterations": 1},
        "evaluator": {name: {"name": name} for name in ("ate", "image", "depth_l1")},
        "protocol": {"holdout_every": 5, "holdout_remainder": 3, "lpips": False},
        **settings,
    }


@pytest.fixture(scope="session")
def scored_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = write_tiny_run(tmp_path_factory.mktemp("runs") / "scored", tiny_config())
    evaluate_run(path)
    return path
