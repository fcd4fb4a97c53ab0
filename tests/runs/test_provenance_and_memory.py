"""Provenance against the tools it asks; peak memory against allocations of known size."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import math
import subprocess
from pathlib import Path

import numpy as np
import pytest

from bench.config import compose_run
from bench.process_memory import MemoryBudget
from bench.runs import provenance
from bench.runs.memory import PeakMemory
from bench.runs.provenance import collect_provenance, describe_weights
from bench.slam.system import System
from plugins.mappers.none import NoMapper


def test_provenance_names_what_made_the_run(tmp_path: Path) -> None:
    weights = tmp_path / "net.pth"
    weights.write_bytes(b"weights")
    found = collect_provenance({"stereo": {"name": "sgbm"}, "seed": 3}, 3)
    assert describe_weights({"stereo": weights})["stereo"] == {
        "file": "net.pth",
        "sha256": hashlib.sha256(b"weights").hexdigest(),
    }
    assert found["packages"]["numpy"] == importlib.metadata.version("numpy")
    assert found["seed"] == 3
    assert found["plugins"] == {"stereo": "sgbm"}
    json.dumps(found)


def test_git_state_of_a_checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "bench"
    package.mkdir()
    (package / "registry.py").write_text("")
    monkeypatch.setattr(provenance.bench, "__file__", str(package / "__init__.py"))
    monkeypatch.chdir(tmp_path)
    assert collect_provenance({}, 0)["git"] is None

    def git(*arguments: str) -> str:
        identity = ["-c", "user.name=a", "-c", "user.email=a@b"]
        done = subprocess.run(
            ["git", "-C", tmp_path, *identity, *arguments], capture_output=True, check=True, text=True
        )
        return done.stdout.strip()

    git("init")
    assert collect_provenance({}, 0)["git"] == {"commit": None, "dirty": True}
    git("add", ".")
    git("commit", "-m", "one")
    assert collect_provenance({}, 0)["git"] == {"commit": git("rev-parse", "HEAD"), "dirty": False}
    (package / "new.py").write_text("")
    assert collect_provenance({}, 0)["git"]["dirty"] is True


@pytest.mark.slow
def test_peak_memory_sees_what_was_allocated_and_freed() -> None:
    memory = PeakMemory()
    before = memory.host_gb()
    block = np.ones(50_000_000)
    del block
    after = memory.host_gb()
    if not memory.since_start:
        pytest.skip("this kernel does not let a process reset its high-water mark")
    assert 0.38 <= after - before <= 0.45
    assert PeakMemory().host_gb() < after - 0.3, "a new measurement starts from what is resident now"


def test_a_budget_says_what_is_left_and_seldom_asks_the_system(monkeypatch: pytest.MonkeyPatch) -> None:
    rss_kib = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmRSS"))
    assert MemoryBudget(100.0).left_gb() == pytest.approx(100 - int(rss_kib.split()[1]) * 1024 / 1e9, abs=0.05)
    asked: list[float] = []
    monkeypatch.setattr("bench.process_memory.occupied_gb", lambda: (asked.append(0.0), 1.5)[1])
    budget = MemoryBudget(1.0)
    assert {budget.left_gb() for _ in range(1000)} == {-0.5}
    assert len(asked) <= 2
    assert MemoryBudget(None).left_gb() == math.inf


def test_a_mapper_is_given_the_budget_of_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[float | None] = []
    monkeypatch.setattr(NoMapper, "use_memory_budget", lambda self, budget: given.append(budget.limit_gb))
    System.build(compose_run(["mapper=none", "limits.memory_gb=3.5", "dataset.frames=2"]))
    assert given == [3.5]
