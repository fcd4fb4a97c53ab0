"""A tracker that looks at the map and a mapper without Gaussians, both in a user's folder."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from killed_run import killed_after

from bench import registry
from bench.authoring.check import check_plugin
from bench.config import compose_run
from bench.contracts.map_view import MapView
from bench.contracts.mapper import CannotRenderError
from bench.discovery import load_plugins
from bench.errors import BenchError
from bench.evaluation.run_evaluators import evaluate_run
from bench.runs.checkpoint import Checkpoints
from bench.slam.run import run_system
from bench.tables.collect import collect_row, columns_of
from bench.types import PinholeView
from plugins.mappers.gaussian import GaussianMapper

FOLDER = str(Path(__file__).parent / "user_plugins")
STREET = ("dataset=street", "protocol.lpips=false")
# A map that is good as soon as it is there.
DENSE = ("mapper.coarse_share=0.6", "mapper.scale_rate=1e-2", "mapper.rotation_rate=1e-3", "mapper.exposure=false")
DENSE += ("mapper.second_moment_decay=0.999", "loss=[rgb,ssim,geo]", "loss.ssim.weight=0.2", "loss.geo.weight=0.1")
DENSE += ("mapper.seeding.stride=2", "mapper.seeding.opacity=0.5", "mapper.seeding.margin=0")
DENSE += ("mapper.seeding.ground=false", "mapper.seeding.max_depth_m=0")
ALIGN = (
    *STREET,
    "dataset.width=160",
    "dataset.height=64",
    "dataset.speed_m=0.05",
    *DENSE,
    "tracker=map_align",
    "mapper.iterations=12",
    "mapper.final_coarse_iterations=0",
)
ALIGN += ("mapper.final_iterations=0", "protocol.right_view=false")
POINTS = (
    *STREET,
    "dataset.width=320",
    "dataset.height=96",
    "dataset.frames=4",
    "dataset.speed_m=0.5",
    "mapper=point_cloud",
    "tracker=groundtruth",
)


def run(output: Path, *overrides: str) -> Path:
    return run_system(compose_run([f"plugins=[{FOLDER}]", *overrides, f"output={output}"])).path


def killed(output: Path, monkeypatch: pytest.MonkeyPatch, after: int, *overrides: str) -> None:
    """Run until so many checkpoints have been written; nothing is saved then."""
    with killed_after(after, monkeypatch):
        run(output, "checkpoint_s=0", *overrides)


@pytest.mark.slow
def test_a_tracker_that_looks_at_the_map_is_resumed_to_the_bit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Frames before the break are not tracked again; what is saved is that of an unbroken run."""
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    settings = (*ALIGN, "dataset.frames=4", "tracker.iterations=8")
    run(whole, *settings, "checkpoint_s=inf")
    assert "pipeline: in step" in (whole / "log.txt").read_text()
    killed(broken, monkeypatch, 3, *settings)
    tracked: list[int] = []
    cls = registry.lookup("tracker", "map_align").cls
    track = cls.track  # type: ignore[attr-defined]
    monkeypatch.setattr(cls, "track", lambda self, frame: tracked.append(frame.number) or track(self, frame))
    run(broken, *settings)
    assert tracked == [3]
    for name in ("map.ply", "trajectory.csv", "views/left/color/000003.png"):
        assert (whole / name).read_bytes() == (broken / name).read_bytes(), name
    tables = [pd.read_csv(folder / "frames.csv").filter(regex="^(?!.*_s$|memory_gb$)") for folder in (whole, broken)]
    pd.testing.assert_frame_equal(*tables)


@pytest.mark.slow
def test_a_tracker_that_looks_at_the_map_stays_within_two_centimetres(tmp_path: Path) -> None:
    """8 frames of 10 cm each; the street knows its poses. A camera that never moves has 23 cm."""
    slow = (
        *DENSE,
        "mapper.iterations=24",
        "mapper.final_coarse_iterations=0",
        "dataset=street",
        "dataset.frames=8",
        "dataset.width=512",
        "dataset.height=160",
        "dataset.speed_m=0.1",
        "protocol.lpips=false",
        "protocol.right_view=false",
    )
    folder = run(tmp_path / "run", *slow, "tracker=map_align", "mapper.final_iterations=0", "evaluator=[ate]")
    found = evaluate_run(folder)["trajectory"]
    assert found["ate_rmse_m"] < 0.02
    assert found["static_camera_ate_rmse_m"] > 0.2


@pytest.mark.slow
def test_a_tracker_that_looks_at_the_map_passes_its_checks() -> None:
    small = ("dataset=street", "dataset.frames=6", "dataset.width=160", "dataset.height=64", "dataset.speed_m=0.05")
    findings = check_plugin("tracker=map_align", *small, *DENSE, "mapper.iterations=8", folders=[FOLDER])
    assert not [finding.lines() for finding in findings if finding.state == "FAILED"]
    assert "the same bits" in next(finding.seen for finding in findings if finding.title == "resumes")


@pytest.mark.slow
def test_each_frame_is_tracked_when_the_one_before_is_in_the_map(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever `pipeline` says; at the first frame the map is empty: black, and nothing is seen."""
    load_plugins([FOLDER])
    cls, happened = registry.lookup("tracker", "map_align").cls, []
    add, track = GaussianMapper.add_keyframe, cls.track  # type: ignore[attr-defined]

    def noted_track(self: Any, frame: Any) -> Any:
        happened.append(f"track {frame.number}")
        if frame.number == 0:
            view: MapView = self.map
            nothing = view.render(PinholeView.of(self.camera, np.eye(4)))
            assert not nothing.color.any()
            assert not nothing.alpha.any()
        return track(self, frame)

    def noted_add(self: GaussianMapper, keyframe: Any, window: Any) -> Any:
        report = add(self, keyframe, window)
        happened.append(f"mapped {keyframe.frame.number}")
        return report

    monkeypatch.setattr(cls, "track", noted_track)
    monkeypatch.setattr(GaussianMapper, "add_keyframe", noted_add)
    few = (
        "dataset.frames=3",
        "tracker.iterations=2",
        "pipeline=parallel",
        "keyframer.iou_threshold=1",
        "cache.all=true",
    )
    run(tmp_path / "run", *ALIGN, *few, f"cache.folder={tmp_path / 'cache'}")
    assert happened == [f"{what} {k}" for k in range(3) for what in ("track", "mapped")]
    assert not list((tmp_path / "cache").rglob("*tracker*"))


def test_no_state_no_checkpoints(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    load_plugins([FOLDER])
    monkeypatch.setattr(registry.lookup("tracker", "map_align").cls, "state", lambda self: None)
    monkeypatch.setattr(Checkpoints, "_write", lambda *nothing: pytest.fail("a checkpoint of nothing"))
    folder = run(tmp_path / "run", *ALIGN, "dataset.frames=2", "tracker.iterations=1", "checkpoint_s=0")
    assert (
        "no checkpoints: a part looks at the map, and the tracker MapAlign gives no state"
        in (folder / "log.txt").read_text()
    )


@pytest.mark.parametrize("mapper", ["none", "point_cloud"])
def test_a_mapper_without_a_view_is_refused_before_anything_is_written(tmp_path: Path, mapper: str) -> None:
    message = (
        rf"tracker=map_align looks at the map, and mapper={mapper} offers no view of it; choose another of the two"
    )
    with pytest.raises(BenchError, match=message):
        run(tmp_path / "run", *STREET, "tracker=map_align", f"mapper={mapper}")
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
def test_a_mapper_without_gaussians_is_run_scored_saved_resumed_and_tabled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, broken = run(tmp_path / "whole", *POINTS), tmp_path / "broken"
    metrics = evaluate_run(whole)
    # A cloud of points with holes is far from a map of Gaussians, and above the image's own mean colour.
    image = registry.build(compose_run(POINTS).plugin("dataset"), "dataset").frame(1).left / 255.0
    assert metrics["views"]["left"]["psnr_db"] > -10 * np.log10(((image - image.mean((0, 1))) ** 2).mean())
    assert set(metrics["map"]) == {"points"}
    with np.load(whole / "points.npz") as saved:
        assert len(saved["points"]) == metrics["map"]["points"] > 10_000
    assert not (whole / "map.ply").exists()
    assert "gaussians" not in json.loads((whole / "resources.json").read_text())
    assert "rasterizer" not in (whole / "config.yaml").read_text()
    killed(broken, monkeypatch, 3, *POINTS)
    run(broken, *POINTS)
    for name in ("trajectory.csv", "views/left/color/000003.png"):
        assert (whole / name).read_bytes() == (broken / name).read_bytes(), name
    with np.load(whole / "points.npz") as one, np.load(broken / "points.npz") as other:
        np.testing.assert_array_equal(one["points"], other["points"])
    row = collect_row(whole)
    titles = [column.title for column in columns_of([row]) if row.values.get(column.key) not in (None, "")]
    assert "Gaussians" not in titles


def test_the_mapper_without_gaussians_passes_its_checks() -> None:
    findings = check_plugin("mapper=point_cloud", folders=[FOLDER])
    assert not [finding.lines() for finding in findings if finding.state == "FAILED"]


@pytest.mark.slow
def test_views_that_need_depth_and_have_none_are_absent_and_never_black(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Left views get their stereo depth; right views have none, and frame 2 can't be shown for a reason of its own."""
    load_plugins([FOLDER])
    cls = registry.lookup("mapper", "point_cloud").cls
    render = cls.render  # type: ignore[attr-defined]

    def with_depth(self: Any, view: PinholeView, depth: Any = None) -> Any:
        if depth is not None and abs(view.T_world_cam[2, 3] - 1.0) < 0.2:
            raise CannotRenderError("nothing is near")
        assert depth is None or np.isfinite(depth).any()
        return render(self, view)

    monkeypatch.setattr(cls, "needs_depth", True)
    monkeypatch.setattr(cls, "render", with_depth)
    folder = run(tmp_path / "run", *POINTS)
    metrics = evaluate_run(folder)
    assert metrics["views"]["left"]["n"] == 3
    assert "right" not in metrics["views"]
    assert "needs the depth of a view" in metrics["notes"]["output"]
    assert "nothing is near" in metrics["notes"]["output"]
    assert not (folder / "views/right").exists()
    assert not (folder / "views/left/color/000002.png").exists()
