"""A drive along the built-in street, written as KITTI-360 writes its drives: every axis and sign has to be right."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from evo.core import metrics
from evo.core.trajectory import PosePath3D

from bench.cli import main
from bench.evaluation.saved_run import SavedRunFolder
from plugins.datasets.kitti360 import Kitti360, Kitti360Config
from plugins.datasets.street import Street, StreetConfig
from tests.datasets.kitti360_disk import (
    CAM_TO_POSE,
    CAM_TO_VELO,
    homogeneous,
    write_calibration,
    write_images,
    write_poses,
    write_scan,
)

pytestmark = pytest.mark.slow

FRAMES = 14
WITHOUT_POSE = (0, 5)
# Half a degree about every axis, like that of the real cameras.
R_RECT = cv2.Rodrigues(np.array([0.008, -0.01, 0.006]))[0]
# The street (x right, y down, z ahead) in a world whose z is up, kilometres from its origin.
T_WORLD_STREET = np.array([[0.0, 0, 1, 2841.0], [-1, 0, 0, -6117.0], [0, -1, 0, 116.0], [0, 0, 0, 1]])


@pytest.fixture(scope="module")
def street() -> Street:
    return Street(StreetConfig(frames=FRAMES, width=512, height=160, seed=1))


@pytest.fixture(scope="module")
def root(street: Street, tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("kitti360")
    camera = street.camera
    rendered = [street.frame(i) for i in range(FRAMES)]
    K = camera.intrinsics
    P = [np.column_stack([K, [0, 0, 0]]), np.column_stack([K, [-camera.fx * camera.baseline, 0, 0]])]
    write_calibration(root, P, (camera.width, camera.height), R_RECT)
    write_images(
        root, "0009", range(FRAMES), lambda n, side: (rendered[n].right if side else rendered[n].left)[..., ::-1]
    )
    T_rect_cam0 = homogeneous(np.column_stack([R_RECT, np.zeros(3)]))
    vehicle = T_WORLD_STREET @ street.ground_truth().T_world_cam @ T_rect_cam0 @ np.linalg.inv(homogeneous(CAM_TO_POSE))
    write_poses(root, "0009", {n: vehicle[n] for n in range(FRAMES) if n not in WITHOUT_POSE}, R_RECT)
    v, u = np.mgrid[: camera.height, : camera.width]
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)
    for n in range(FRAMES):
        depth = street.lidar_depth(n)
        rectified = (rays * depth[..., None])[np.isfinite(depth)]
        write_scan(root, "0009", n, rectified @ R_RECT @ CAM_TO_VELO[:, :3].T + CAM_TO_VELO[:, 3])
    return root


def test_ground_truth_is_the_street_s(root: Path, street: Street) -> None:
    dataset = Kitti360(Kitti360Config(root=str(root), sequence="0009"))
    assert dataset.numbers == tuple(n for n in range(FRAMES) if n not in WITHOUT_POSE)
    truth, given = street.ground_truth().T_world_cam, dataset.ground_truth()
    assert given is not None
    expected = np.linalg.inv(truth[1]) @ truth[list(dataset.numbers)]
    np.testing.assert_allclose(given.T_world_cam, expected, atol=1e-8)


def test_lidar_is_the_street_s(root: Path, street: Street) -> None:
    """The street's LiDAR measures all at once, so there is no motion to undo."""
    dataset = Kitti360(Kitti360Config(root=str(root), sequence="0009", uncurl=False))
    for position in (0, 7):
        depth, expected = dataset.lidar_depth(position), street.lidar_depth(dataset.numbers[position])
        assert depth is not None
        np.testing.assert_array_equal(np.isfinite(depth), np.isfinite(expected))
        np.testing.assert_allclose(depth, expected, rtol=1e-5)


def test_a_run_finds_its_way(root: Path, street: Street, tmp_path: Path) -> None:
    """Tracked from images alone; evo compares with the street's own poses, and the run's score agrees with evo."""
    out = tmp_path / "run"
    overrides = [
        *("dataset=kitti360", f"dataset.root={root}", "dataset.sequence=0009", "mapper=none", "stereo=sgbm"),
        *("tracker=stereo_orb", "evaluator=[ate]", f"output={out}", "cache.enabled=false"),
    ]
    assert main(["run", *overrides]) == 0
    tracked = SavedRunFolder(out).trajectory
    numbers = [n for n in range(FRAMES) if n not in WITHOUT_POSE]
    assert tracked.numbers.tolist() == numbers
    reference = PosePath3D(poses_se3=list(street.ground_truth().T_world_cam[numbers]))
    estimate = PosePath3D(poses_se3=list(tracked.T_world_cam))
    estimate.align(reference)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data((reference, estimate))
    ate = float(ape.get_statistic(metrics.StatisticsType.rmse))
    assert ate < 0.05
    scored = json.loads((out / "metrics.json").read_text())["trajectory"]
    assert scored["ate_rmse_m"] == pytest.approx(ate, rel=1e-3)
    assert scored["static_camera_ate_rmse_m"] > 3.0


def test_check_plugin_accepts_it(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = main(["check-plugin", "dataset=kitti360", f"dataset.root={root}", "dataset.sequence=0009"])
    told = capsys.readouterr().out
    assert code == 0, told
    assert "mostly along +z" in told
    assert "median row offset" in told
