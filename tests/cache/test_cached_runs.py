"""Whole runs with the cache: the same bits, honest times, one computation for many runs, no harm from a bad disk."""

from __future__ import annotations

import hashlib
import json
import logging
import subprocess
import sys
from pathlib import Path

import network_plugins
import numpy as np
import pandas as pd
import pytest

from bench.cache import CacheConfig, cached_depth_source, cost_of
from bench.config import compose_run
from bench.contracts.dataset import Dataset
from bench.errors import BenchError
from bench.evaluation.run_evaluators import evaluate_run
from bench.registry import build
from bench.slam.run import run_system
from plugins.datasets.street import Street, StreetConfig
from plugins.stereo.sgbm import SgbmConfig
from tests.short_runs import FEW_ITERATIONS

TINY = ("dataset.frames=4", "dataset.width=96", "dataset.height=48", *FEW_ITERATIONS, "protocol.lpips=false")
DELAY_S = 0.15


@pytest.fixture
def settings(tmp_path: Path) -> list[str]:
    weights = tmp_path / "net.pth"
    weights.write_bytes(b"weights")
    return [
        *TINY,
        "tracker=groundtruth",
        "stereo=counting_for_tests",
        f"stereo.log={tmp_path / 'stereo.log'}",
        f"stereo.delay_s={DELAY_S}",
        f"stereo.weights={weights}",
        "sky=counting_sky_for_tests",
        f"sky.log={tmp_path / 'sky.log'}",
        f"cache.folder={tmp_path / 'cache'}",
    ]


def run(settings: list[str], output: Path, *overrides: str) -> Path:
    return run_system(compose_run([*settings, f"output={output}", *overrides])).path


def calls(log: Path) -> int:
    return len(log.read_text().splitlines()) if log.exists() else 0


@pytest.mark.slow
def test_the_same_bits_and_honest_times(settings: list[str], tmp_path: Path) -> None:
    plain = run(settings, tmp_path / "plain", "cache.enabled=false")
    computed = calls(tmp_path / "stereo.log")
    assert computed >= 2
    first, second = (run(settings, tmp_path / name) for name in ("first", "second"))
    assert calls(tmp_path / "stereo.log") == calls(tmp_path / "sky.log") == 2 * computed
    for name in ("map.ply", "trajectory.csv", "views/left/color/000003.png", "views/right/depth/000002.png"):
        assert (plain / name).read_bytes() == (first / name).read_bytes() == (second / name).read_bytes(), name
    frames = {path: pd.read_csv(path / "frames.csv", index_col="number") for path in (plain, first, second)}
    assert not frames[plain]["stereo_cached"].any()
    assert not frames[first]["stereo_cached"].any()
    keyframes = frames[second]["is_keyframe"]
    assert frames[second]["stereo_cached"].equals(keyframes)
    # What a cached frame is said to cost is what it cost when it was computed, not what reading it took.
    assert frames[second]["stereo_s"].equals(frames[first]["stereo_s"])
    assert (frames[second].loc[keyframes, "stereo_s"] >= DELAY_S).all()
    resources = json.loads((second / "resources.json").read_text())
    assert resources["stereo_cached_frames"] == computed
    assert resources["stereo_s_per_frame"] == pytest.approx(frames[first]["stereo_s"].sum() / 4)
    notes = {path: evaluate_run(path).get("notes", {}) for path in (first, second)}
    assert "resources" not in notes[first]
    assert f"stereo or sky of {computed} frames came from the cache" in notes[second]["resources"]


def test_provenance_names_the_weights(settings: list[str], tmp_path: Path) -> None:
    path = run(settings, tmp_path / "run", "dataset.frames=1")
    weights = json.loads((path / "provenance.json").read_text())["weights"]
    assert weights == {"stereo.network": {"file": "net.pth", "sha256": hashlib.sha256(b"weights").hexdigest()}}


def test_the_cache_is_no_part_of_the_run(settings: list[str], tmp_path: Path) -> None:
    one = compose_run(settings)
    other = compose_run([*settings, "cache.enabled=false", "cache.limit_gb=3"])
    assert one.hash == other.hash
    path = run(settings, tmp_path / "run", "dataset.frames=1")
    assert run(settings, tmp_path / "run", "dataset.frames=1", f"cache.folder={tmp_path / 'elsewhere'}") == path
    assert not (tmp_path / "elsewhere").exists()  # the finished run was found again
    with pytest.raises(BenchError, match=r"it differs in dataset\.frames\)"):
        run(settings, tmp_path / "run", "dataset.frames=2", "cache.enabled=false")


def test_bad_settings_are_one_line() -> None:
    with pytest.raises(BenchError, match=r"cache\.limit_gb=0\.0 must be positive\. cache\.enabled=false switches"):
        compose_run(["cache.limit_gb=0"])
    with pytest.raises(BenchError, match=r"cache has no setting 'limitgb'.*Did you mean 'limit_gb'\?"):
        compose_run(["cache.limitgb=3"])


@pytest.mark.slow
@pytest.mark.parametrize("other", ["stereo.far=79", "dataset.seed=5"])
def test_another_input_is_computed(settings: list[str], tmp_path: Path, other: str) -> None:
    run(settings, tmp_path / "one", "dataset.frames=1")
    run(settings, tmp_path / "two", "dataset.frames=1", other)
    assert calls(tmp_path / "stereo.log") == 2


def street() -> Dataset:
    return Street(StreetConfig(name="street", frames=2, width=96, height=48))


def source(tmp_path: Path, folder: Path) -> network_plugins.CountingStereo:
    config = network_plugins.CountingConfig(name="counting_for_tests", log=str(tmp_path / "log"))
    cache = CacheConfig.from_mapping({"folder": str(folder)})
    return cached_depth_source(build(config, "stereo"), config, street(), cache)  # type: ignore[return-value]


def test_a_damaged_entry_is_replaced(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    dataset, folder = street(), tmp_path / "cache"
    depths = [source(tmp_path, folder).depth(dataset.frame(0), 0, dataset.camera).depth]
    (path,) = folder.glob("stereo/*/*/*.entry")
    whole = path.read_bytes()
    path.write_bytes(whole[:500] + bytes([whole[500] ^ 1]) + whole[501:])
    with caplog.at_level(logging.WARNING):
        depths.append(source(tmp_path, folder).depth(dataset.frame(0), 0, dataset.camera).depth)
    assert "is damaged" in caplog.text
    again = source(tmp_path, folder)
    depths.append(again.depth(dataset.frame(0), 0, dataset.camera).depth)
    assert cost_of(again, 0.0).cached
    assert calls(tmp_path / "log") == 2
    assert all(np.array_equal(depth.view(np.uint32), depths[0].view(np.uint32)) for depth in depths)


def test_a_folder_that_can_not_be_written_costs_time_only(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "file").touch()
    dataset = street()
    part = source(tmp_path, tmp_path / "file" / "cache")
    with caplog.at_level(logging.WARNING):
        for position in (0, 1, 0):
            assert np.isfinite(part.depth(dataset.frame(position), position, dataset.camera).depth).any()
    assert calls(tmp_path / "log") == 3
    assert caplog.text.count("going on without keeping answers") == 1


def test_what_the_network_raises_is_raised(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise OSError("the network's own trouble")

    dataset, part = street(), source(tmp_path, tmp_path / "cache")
    monkeypatch.setattr(network_plugins.CountingStereo, "depth", broken)
    with pytest.raises(OSError, match="own trouble"):
        part.depth(dataset.frame(0), 0, dataset.camera)
    assert list((tmp_path / "cache").glob("stereo/*/*/*")) == []


def test_sources_that_are_not_worth_it_stay_as_they_are(tmp_path: Path) -> None:
    for config in (compose_run([]).plugin("stereo"), network_plugins.CountingConfig(name="temporal_for_tests")):
        part = build(config, "stereo")
        assert cached_depth_source(part, config, street(), CacheConfig.from_mapping({})) is part
    config = network_plugins.CountingConfig(name="counting_for_tests")
    part = build(config, "stereo")
    off = CacheConfig.from_mapping({"enabled": False})
    assert cached_depth_source(part, config, street(), off) is part


_PROCESS = """
import sys; sys.path.insert(0, {here!r})
from pathlib import Path
import test_cached_runs as t
from network_plugins import CountingConfig
from bench.cache import CacheConfig, cached_depth_source
from bench.registry import build
config = CountingConfig(name="counting_for_tests", log={log!r}, delay_s=0.5)
dataset = t.street()
part = cached_depth_source(build(config, "stereo"), config, dataset, CacheConfig.from_mapping({{"folder": {cache!r}}}))
frames = [dataset.frame(i) for i in range(2)]
print("ready", flush=True); input()
import hashlib
for i in range(2):
    print(hashlib.sha256(part.depth(frames[i], i, dataset.camera).depth.tobytes()).hexdigest())
"""


@pytest.mark.slow
def test_processes_that_start_at_once_compute_once(tmp_path: Path) -> None:
    code = _PROCESS.format(here=str(Path(__file__).parent), log=str(tmp_path / "log"), cache=str(tmp_path / "cache"))
    processes = [
        subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    for process in processes:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
    for process in processes:
        assert process.stdin is not None
        process.stdin.write("\n")
        process.stdin.flush()
    answers = {process.communicate()[0] for process in processes}
    assert [process.returncode for process in processes] == [0, 0]
    assert calls(tmp_path / "log") == 2  # one for each frame
    assert len(answers) == 1


def test_a_confidence_is_cached_with_its_depth(tmp_path: Path) -> None:
    """Semi-global matching with the full left-right check: the first answer, the cached one and one without a cache."""
    dataset = Street(StreetConfig("street", frames=1, width=160, height=64))
    config = SgbmConfig("sgbm", full_check=True, num_disparities=32)
    cache = CacheConfig(all=True, folder=str(tmp_path / "cache"))
    sources = [cached_depth_source(build(config, "stereo"), config, dataset, cache) for _ in range(2)]
    answers = [each.depth(dataset.frame(0), 0, dataset.camera) for each in (*sources, build(config, "stereo"))]
    assert cost_of(sources[1], 0.0).cached
    confidence = answers[2].confidence
    assert confidence is not None
    assert 0 < np.mean(confidence > 0.5) < 1
    for answer in answers[:2]:
        np.testing.assert_array_equal(answer.depth, answers[2].depth)
        np.testing.assert_array_equal(answer.confidence, confidence)
    # Unknown depth: no confidence; known depth: exp(-1) at the tolerance of one pixel, or more.
    assert (confidence[np.isnan(answers[2].depth)] == 0).all()
    assert confidence[np.isfinite(answers[2].depth)].min() >= np.float32(np.exp(-1.0)) - 1e-6
