"""Videos of runs whose pictures are known, read back; and the way of a flight."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from bench.authoring.random_scenes import SceneSpec, random_scene
from bench.cli import main
from bench.errors import BenchError
from bench.figures import video
from bench.figures.video import camera_path, fly_through
from bench.gaussians.ply import write_ply
from bench.geometry import se3
from bench.runs.folder import color_to_8bit
from bench.saved_map import load_map
from bench.types import Float, Image, StereoCamera, Trajectory
from tests.evaluation.tiny_run import straight_drive, write_tiny_run

CONFIG: dict[str, Any] = {"dataset": {"name": "tiny_for_tests"}, "protocol": {"lpips": False}, "system": "bgs_slam"}


def pictures(path: Path) -> tuple[list[Image], str]:
    """All pictures of a video as RGB, and its codec."""
    opened = cv2.VideoCapture(str(path))
    found = []
    while (read := opened.read())[0]:
        found.append(read[1][..., ::-1])
    return found, int(opened.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little").decode()


@pytest.mark.parametrize("codec", ["h264", "FMP4"])
def test_written_pictures_are_read_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, codec: str) -> None:
    monkeypatch.setattr(video, "has_h264", lambda: codec == "h264")
    colors = [(200, 40, 40), (40, 200, 40), (40, 40, 200)]
    with video.video_file(tmp_path / "a.mp4", 5.0) as add:
        for color in colors:
            add(np.full((63, 95, 3), color, np.uint8))
    found, written_as = pictures(tmp_path / "a.mp4")
    assert (written_as, len(found), found[0].shape) == (codec, 3, (64, 96, 3))
    for picture, color in zip(found, colors, strict=True):
        np.testing.assert_allclose(picture[10:-10, 10:-10].mean((0, 1)), color, atol=6)


def test_side_by_side_has_truth_render_and_depth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = write_tiny_run(tmp_path / "run", CONFIG)
    assert main(["video", str(run), "--out", str(tmp_path / "a.mp4")]) == 0
    found, _ = pictures(tmp_path / "a.mp4")
    assert len(found) == 4  # of five frames one was lost
    assert found[0].shape == (40, 3 * 56, 3)  # 56 x 40 is not wide
    truth, render, depth = (found[0][20:, 56 * k : 56 * (k + 1)].astype(int) for k in range(3))
    assert abs(truth.mean() + 1 - render.mean()) < 3  # one more than the truth
    assert np.abs(truth - render).mean() < 15 < np.abs(truth - truth[:, ::-1]).mean()
    assert depth.std((0, 1)).max() < 3  # 10 m everywhere
    assert "wrote" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--out", "a.avi"], "must end in .mp4"),
        (["--fps", "0"], "--fps goes from 0.1"),
        (["--kind", "fly-through"], "has no map: its mapper"),
    ],
)
def test_what_can_not_be_shown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], text: str
) -> None:
    run = write_tiny_run(tmp_path / "run", CONFIG | {"mapper": {"name": "none"}})
    assert main(["video", str(run), *arguments]) == 2
    assert text in capsys.readouterr().err


def drive(noise_m: float = 0.0) -> Trajectory:
    """Forty frames along a bend; their poses are off by as much."""
    rng = np.random.default_rng(0)
    angles = np.linspace(0, 1.2, 40)
    poses = np.stack([se3.exp(np.array([0, 0, 0, 0, angle, 0])) for angle in angles])
    poses[:, :3, 3] = np.stack([20 * (1 - np.cos(angles)), 0 * angles, 20 * np.sin(angles)], 1)
    poses[:, :3, 3] += noise_m * rng.normal(size=(40, 3))
    return Trajectory(poses, np.arange(40), 0.1 * np.arange(40))


def jerk(places: Float) -> float:
    return float(np.abs(np.diff(places, n=3, axis=0)).max())


def test_the_way_goes_through_the_poses_and_smoothing_takes_out_the_shaking() -> None:
    exact = camera_path(drive(), 3, 0.0)
    np.testing.assert_allclose(exact[::3], drive().T_world_cam, atol=1e-9)
    between = 20 * np.array([1 - np.cos(1.2 / 39 * 10 / 3), 0, np.sin(1.2 / 39 * 10 / 3)])  # on the circle
    np.testing.assert_allclose(exact[10, :3, 3], between, atol=1e-3)
    np.testing.assert_allclose(
        exact[:, :3, :3] @ exact[:, :3, :3].swapaxes(1, 2), np.tile(np.eye(3), (118, 1, 1)), atol=1e-9
    )
    shaky, smooth = (camera_path(drive(0.05), 3, sigma)[:, :3, 3] for sigma in (0.0, 2.0))
    assert jerk(smooth) < jerk(shaky) / 5
    assert np.linalg.norm(smooth - exact[:, :3, 3], axis=1)[12:-12].max() < 0.1


def test_frames_without_a_pose_take_their_time() -> None:
    whole = straight_drive((10, 11, 14))
    np.testing.assert_allclose(camera_path(whole, 2, 0.0)[:, 2, 3], np.arange(10, 14.1, 0.5))
    with pytest.raises(BenchError, match="needs two poses or more, and the trajectory has 1"):
        camera_path(straight_drive((10,)), 2, 0.0)


def test_a_flight_shows_the_map_from_its_way(tmp_path: Path) -> None:
    planes, view = random_scene(SceneSpec(0, 50, 40, 30, 2.0, (0.5, 0.9)))
    write_ply(tmp_path / "map.ply", planes)
    camera = StereoCamera(40, 30, view.fx, view.fy, view.cx, view.cy, (0.5, 0.0, 0.0))
    poses = np.tile(view.T_world_cam, (2, 1, 1))
    poses[1, 2, 3] += 0.1
    saved = replace(
        load_map(tmp_path / "map.ply"), camera=camera, trajectory=Trajectory(poses, np.arange(2), np.zeros(2))
    )
    flight = list(fly_through(saved, 0.0))
    assert [total for _, total in flight] == [4] * 4
    assert flight[0][0].std() > 10
    for place, pose in ((0, poses[0]), (3, poses[1])):
        shown = color_to_8bit(saved.render(pose).color)
        assert np.abs(flight[place][0].astype(int) - shown).max() <= 1
