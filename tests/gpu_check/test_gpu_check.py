"""The check of a GPU, as far as a machine without one shows: refusals, time boxes, each part with a CPU rasterizer."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from bench.authoring.random_scenes import SceneSpec
from bench.errors import BenchError
from bench.types import PinholeView
from tools.gpu_check import command, conformance, device, kernels, mapping_step, marked_tests, whole_system
from tools.gpu_check.kernels import measure as kernels_of
from tools.gpu_check.parts import PARTS, Outcome, Part, run_in_process, run_parts

SMALL = {"degree 1": SceneSpec(1, 60, 40, 30, 3.0, (0.1, 0.9), 1)}


def test_without_cuda_nothing_is_written(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert command.main(["--out", str(tmp_path / "gpu")]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert "sees no CUDA device, so there is nothing to check. Run make gpu-check on a machine with an NVIDIA" in told
    assert not (tmp_path / "gpu").exists()


@pytest.mark.parametrize(
    ("missing", "told"),
    [
        ("torch", "torch is not installed here"),
        ("bench._native", r"the C\+\+ core is not built. Run: pip install --no-build-isolation --no-deps -e \."),
        ("jaxtyping", r"not installed here: jaxtyping. Run: pip install '\.\[cuda\]' \(without a network: pip"),
        ("nvcc", "there is no nvcc. Put the CUDA toolkit's bin on PATH"),
    ],
)
def test_what_is_missing_is_named(missing: str, told: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.delenv("CUDA_HOME", raising=False)
    monkeypatch.setattr(command, "find_spec", lambda name: None if name in (missing, "gsplat.csrc") else object())
    monkeypatch.setattr(command.shutil, "which", lambda name: None if name == missing else f"/bin/{name}")
    with pytest.raises(BenchError, match=told):
        command.require_gpu()


def boxes(times: dict[str, float], ends: dict[str, str], limit_s: float) -> tuple[dict[str, Outcome], dict[str, float]]:
    """Run three parts that take so long; the outcomes, and the seconds that each was given."""
    now, given = [0.0], dict[str, float]()

    def run(name: str, seconds: float) -> Outcome:
        given[name] = seconds
        now[0] += min(times[name], seconds)
        return {"status": ends.get(name, "done"), "seconds": times[name]}

    parts = (Part("first", 100, 10, needed=True), Part("second", 50, 20), Part("third", 30, 5))
    return run_parts(parts, run, limit_s, lambda name, outcome: None, lambda: now[0]), given


def test_parts_share_the_time() -> None:
    """Of 100 s the first takes 75; 25 are left for the second, which wants 50 and can begin with 20; it takes 22."""
    outcomes, given = boxes({"first": 75, "second": 22, "third": 1}, {}, 100)
    assert given == {"first": 100, "second": 25}
    assert outcomes["third"] == {"status": "left out", "seconds": 0.0, "reason": "3 s were left, and it wants 5"}
    outcomes, given = boxes({"first": 1, "second": 1, "third": 1}, {"first": "out of time"}, 100)
    assert list(given) == ["first"], "the others need it"
    assert outcomes["second"]["reason"] == "first was not done"
    outcomes, given = boxes({"first": 1, "second": 1, "third": 1}, {"second": "failed"}, 100)
    assert outcomes["third"]["status"] == "done"


def test_all_parts_begin_in_time_after_a_build_of_average_length() -> None:
    outcomes = run_parts(PARTS, lambda name, s: {"status": "done", "seconds": s}, 480, lambda *_: None, lambda: 0.0)
    assert all(outcome["status"] == "done" for outcome in outcomes.values())
    assert sum(part.least_s for part in PARTS) < 480 - 300


@pytest.mark.parametrize(
    ("code", "status", "reason"),
    [
        ("open(FILE, 'w').write('{\"a\": 1}')", "done", None),
        ("open(FILE, 'w').write('{\"a\": 1}'); raise ValueError('no')", "failed", "ValueError: no ("),
        (
            "open(FILE, 'w').write('{\"a\": 1}'); import time; print(1, flush=True); time.sleep(60)",
            "out of time",
            "ended",
        ),
    ],
)
def test_a_part_runs_in_a_process_that_can_be_ended(code: str, status: str, reason: str | None, tmp_path: Path) -> None:
    given = [sys.executable, "-S", "-c", code.replace("FILE", repr(str(tmp_path / "x.json")))]
    begin = time.monotonic()
    outcome = run_in_process("x", 0.4 if status == "out of time" else 20, tmp_path, given)
    assert time.monotonic() - begin < 15
    assert (outcome["status"], outcome["result"]) == (status, {"a": 1}), "kept, however it ended"
    assert ("reason" in outcome) == (reason is not None)
    assert outcome.get("reason", "").startswith(reason or "")


def test_what_is_known_is_written_after_each_part(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, seen = tmp_path / "gpu" / "nvidia-h100-80gb-hbm3.json", []

    def run(name: str, seconds: float, folder: Path, environment: dict[str, str]) -> Outcome:
        seen.append(len(json.loads(file.read_text())["parts"]) if file.exists() else 0)
        assert environment["MAX_JOBS"] == "7", "gsplat compiles on all cores"
        return {"status": "failed" if name == "mapping_step" else "done", "seconds": 1.0, "reason": "broke"}

    described = device.describe_device() | {"gpu": "NVIDIA H100 80GB HBM3", "usable_cores": 7}
    monkeypatch.delenv("MAX_JOBS", raising=False)
    monkeypatch.setattr(device, "describe_device", lambda: described)
    monkeypatch.setattr(command, "run_in_process", run)
    assert command.check(file.parent, 480) == 1, "a part failed"
    assert seen == [0, 1, 2, 3, 4]
    content = json.loads(file.read_text())
    assert list(content["parts"]) == [part.name for part in PARTS]
    keys = ("gpu", "driver", "cuda", "torch", "gsplat", "capability", "gpu_memory_gb", "cpu", "usable_cores", "date")
    assert set(keys) <= set(content["device"])
    assert "mapping_step: failed, 1 s: broke\n" in capsys.readouterr().out


def test_a_part_writes_what_it_measures(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(kernels, "measure", lambda: kernels_of("cpu"))
    assert command.main(["--part", "kernels", "--to", str(tmp_path / "kernels.json")]) == 0
    assert 0 < json.loads((tmp_path / "kernels.json").read_text())["alpha"] < 1


def test_conformance_of_the_core() -> None:
    """Against itself the core differs by nothing, against the reference by float32's rounding."""
    (found,) = conformance.measure("cpu", SMALL, None)
    of_scene = found["errors"]["degree 1"]
    compared = {
        "color",
        "depth",
        "alpha",
        "means",
        "log scales",
        "quaternions",
        "opacity",
        "colors",
        "harmonics",
        "twist",
    }
    assert set(of_scene["reference"]) == set(of_scene["cpu"]) == compared
    assert all(values == [0.0] * 4 for values in of_scene["cpu"].values())
    assert all(0 < values[-1] < 1e-3 and values == sorted(values) for values in of_scene["reference"].values())


@pytest.mark.parametrize(("wrong", "named"), [("color", "color of degree 1 against cpu"), ("alpha", "alpha of")])
def test_a_rasterizer_that_differs_is_found(wrong: str, named: str, monkeypatch: pytest.MonkeyPatch) -> None:
    render = conformance.render_and_back

    def spoilt(rasterizer: object, *given: object) -> object:
        rendered, gradients = render(rasterizer, *given)  # type: ignore[arg-type]
        if type(rasterizer).__name__ == "ReferenceRasterizer":
            getattr(rendered, wrong)[..., 3:9] += 1e-3 if wrong == "color" else float("nan")
        return rendered, gradients

    monkeypatch.setattr(conformance, "render_and_back", spoilt)
    with pytest.raises(BenchError, match=f"reference differs by more than it may: .*{named}"):
        list(conformance.measure("reference", SMALL, None))


def test_the_yardstick(monkeypatch: pytest.MonkeyPatch) -> None:
    """A product of 1024^3 is 2.1 GFLOP: no CPU does it in 0.1 ms."""
    monkeypatch.setattr(device, "_ROUNDS", 1)
    measured = device.yardstick()["mm_cpu_ms"]
    assert measured is not None
    assert measured > 0.1


def test_the_scenes_cover_every_degree() -> None:
    assert {spec.degree for spec in conformance.SCENES.values()} == {0, 1, 2, 3}


def test_steps_by_stage(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mapping_step, "yardstick", lambda: {"mm_cpu_ms": 8.5, "mm_gpu_ms": None})
    view = PinholeView(np.eye(4), 60.0, 60.0, 48.0, 16.0, 96, 32)
    begin = time.perf_counter()
    *_, found = mapping_step.measure("cpu", (300, 600), 2, view)
    passed_ms = 1e3 * (time.perf_counter() - begin)
    assert [row["gaussians"] for row in found["rows"]] == [300, 600]
    for row in found["rows"]:
        assert set(row["stages_ms"]) == {"render", "losses", "backward", "adam"}
        assert row["step_ms"] == pytest.approx(sum(row["stages_ms"].values()))
        assert 0 < row["step_ms"] < passed_ms
        assert row["mm_cpu_ms"] == 8.5
        assert row["gpu_memory_gb"] is None


def test_a_map_too_large_for_the_gpu_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise torch.cuda.OutOfMemoryError("CUDA out of memory")

    monkeypatch.setattr(mapping_step, "_measured", full)
    monkeypatch.setattr(mapping_step, "yardstick", dict)
    *_, found = mapping_step.measure("cpu", (300,))
    assert found["rows"][0]["reason"] == "out of memory"


def test_stages_are_timed_in_turn() -> None:
    def pause(seconds: float) -> Callable[[], None]:
        return lambda: time.sleep(seconds)

    spans = device.staged(torch.device("cpu"), {"short": pause(0.01), "long": pause(0.03)})
    assert 10 <= spans["short"] < spans["long"]


def test_frames_come_from_kitti_where_it_is(tmp_path: Path) -> None:
    assert whole_system.frames_of(None)[0] == whole_system.frames_of(str(tmp_path))[0] == "dataset=street"
    (tmp_path / "kitti_odometry" / "sequences" / "06").mkdir(parents=True)
    assert whole_system.frames_of(str(tmp_path), 5)[2:] == ["dataset.sequence='06'", "dataset.frames=0:5"]


@pytest.mark.slow
def test_the_whole_system_on_a_small_street(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(whole_system, "yardstick", dict)
    frames = ["dataset=street", "dataset.frames=2", "dataset.width=64", "dataset.height=32"]
    few = ["tracker=groundtruth"] + [
        f"mapper.{name}=1" for name in ("iterations", "final_iterations", "final_coarse_iterations")
    ]
    (found,) = whole_system.measure([("bgs_slam_fast", "cpu")], frames, few)
    row = found["rows"][0]
    assert found["frames"] == " ".join(frames)
    assert row["frames_per_s"] == pytest.approx(1 / row["wall_s_per_frame"])
    assert row["gaussians"] > 50
    assert 5 < row["psnr_db"] < 40
    assert row["mapping_s_per_frame"] > 0


def test_tests_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """By reports as pytest gives them: two phases of a test that passes, one skipped in its set-up, one that fails."""

    def ended(arguments: list[str], plugins: list[marked_tests._Counts]) -> int:
        marked = ("rasterizers/test_gsplat_rasterizer", "rasterizers/test_off_the_cpu", "tracking/test_xfeat")
        assert arguments[-5:] == ["-m", "cuda", *(f"tests/{name}.py" for name in marked)]
        for when, outcome in (("setup", "passed"), ("call", "passed"), ("setup", "skipped"), ("call", "failed")):
            plugins[0].pytest_runtest_logreport(
                pytest.TestReport(f"t::{when}", ("t", 1, "t"), {}, outcome, None, when)  # type: ignore[arg-type]
            )
        return 1

    monkeypatch.chdir(Path(__file__).parents[2])
    monkeypatch.setattr(pytest, "main", ended)
    measured = marked_tests.measure()
    assert next(measured) == {"passed": 1, "skipped": 1, "failed": ["t::call"]}
    with pytest.raises(BenchError, match="pytest ended with 1: 1 tests passed, 1 were skipped, and failed: t::call"):
        next(measured)
