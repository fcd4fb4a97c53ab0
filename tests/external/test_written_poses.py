"""Trajectory files as other systems write them, made here by hand in their formats; the truth is the curve itself."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
import torch

from bench.errors import BenchError
from bench.external.poses import read_written_poses
from bench.external.search import search
from bench.external.settings import ScoreSettings
from tests.external.foreign_case import curve

NUMBERS = np.arange(6)
TRUE = curve(NUMBERS)
WORLD_TO_CAM = np.linalg.inv(TRUE)


def splatam(path: Path) -> Path:
    """A turn by a about y has the quaternion (cos a/2, 0, sin a/2, 0), w first; SplaTAM's have any length."""
    half = -0.02 * NUMBERS / 2  # world to camera turns the other way
    quaternions = 2.5 * np.stack([np.cos(half), 0 * half, np.sin(half), 0 * half])[None]
    np.savez(
        path,
        cam_unnorm_rots=quaternions.astype(np.float32),
        cam_trans=WORLD_TO_CAM[:, :3, 3].T[None].astype(np.float32),
        keyframe_time_indices=np.array([0, 4]),
        means3D=np.zeros((7, 3), np.float32),
    )
    return path


def test_splatam(tmp_path: Path) -> None:
    written = read_written_poses(splatam(tmp_path / "params.npz"))
    assert written.camera_to_world() == pytest.approx(TRUE, abs=2e-6)
    assert written.keyframes is not None
    assert written.keyframes.tolist() == [0, 4]


def test_monogs(tmp_path: Path) -> None:
    chosen = [0, 3, 5]
    content = {"trj_id": chosen, "trj_est": TRUE[chosen].tolist(), "trj_gt": TRUE[chosen].tolist()}
    (tmp_path / "trj_final.json").write_text(json.dumps(content))
    written = read_written_poses(tmp_path / "trj_final.json")
    assert written.camera_to_world() == pytest.approx(TRUE[chosen], abs=1e-12)
    assert written.numbers is not None
    assert written.numbers.tolist() == chosen


def test_loopsplat(tmp_path: Path) -> None:
    path = tmp_path / "estimated_c2w.ckpt"
    torch.save(torch.tensor(TRUE, dtype=torch.float32), path, _use_new_zipfile_serialization=False)
    assert read_written_poses(path).camera_to_world() == pytest.approx(TRUE, abs=2e-6)


def test_point_slam(tmp_path: Path) -> None:
    """Its camera looks along -z with y up, and the list has zeros behind the frame that it came to."""
    poses = torch.zeros(9, 4, 4)
    poses[:6] = torch.tensor(TRUE @ np.diag([1.0, -1.0, -1.0, 1.0]))
    torch.save({"estimate_c2w_list": poses, "idx": torch.tensor(5), "keyframe_list": [0, 5]}, tmp_path / "00005.tar")
    written = read_written_poses(tmp_path / "00005.tar")
    assert written.camera_to_world() == pytest.approx(TRUE, abs=2e-6)
    assert written.keyframes is not None
    assert written.keyframes.tolist() == [0, 5]


@pytest.mark.parametrize("rows", [3, 4])
def test_arrays_in_either_direction(tmp_path: Path, rows: int) -> None:
    np.save(tmp_path / "c2w.npy", TRUE[:, :rows])
    assert read_written_poses(tmp_path / "c2w.npy").camera_to_world() == pytest.approx(TRUE, abs=1e-12)
    np.savez(tmp_path / "poses.npz", w2c=WORLD_TO_CAM[:, :rows], loss=np.zeros(3))
    written = read_written_poses(tmp_path / "poses.npz")
    assert written.camera_to_world("world_to_camera") == pytest.approx(TRUE, abs=1e-12)
    assert written.form == "NumPy, array w2c"


class Malicious:
    """Unpickling it would make a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return os.mkdir, (str(self.folder),)


def test_nothing_in_a_file_is_run(tmp_path: Path) -> None:
    proof = tmp_path / "proof"
    np.save(tmp_path / "poses.npy", np.array([Malicious(proof)], dtype=object), allow_pickle=True)
    torch.save({"estimate_c2w_list": Malicious(proof)}, tmp_path / "00001.tar")
    with pytest.raises(BenchError, match=r"poses\.npy can't be read as NumPy arrays without pickled objects"):
        read_written_poses(tmp_path / "poses.npy")
    with pytest.raises(BenchError, match=r"00001\.tar can't be read without running code in it"):
        read_written_poses(tmp_path / "00001.tar")
    assert not proof.exists()


def broken(**changes: object) -> np.ndarray:
    T = TRUE.copy()
    for place, value in changes.items():
        T[2, int(place[1]), int(place[2])] = value
    return T


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (broken(_03=np.nan), r"pose 2 \(from 0\) is not finite"),
        (broken(_00=2.0), r"pose 2 \(from 0\) is no rigid motion"),
        (broken(_33=2.0), r"pose 2 \(from 0\) is no rigid motion"),
        (np.zeros((6, 7)), r"shape \(6, 7\); poses are \(N, 4, 4\) or \(N, 3, 4\)"),
        (np.zeros((0, 4, 4)), r"shape \(0, 4, 4\)"),
    ],
)
def test_poses_that_are_none(tmp_path: Path, array: np.ndarray, message: str) -> None:
    np.save(tmp_path / "poses.npy", array)
    with pytest.raises(BenchError, match=message):
        read_written_poses(tmp_path / "poses.npy")


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("trj_final.json", '{"trj_id": [0]}', "can't be read as MonoGS's trajectory"),
        ("trj_final.json", '{"trj_id": [0, 0], "trj_est": [[], []]}', "trj_id needs one number"),
        ("params.npz", "no zip", "can't be read as NumPy arrays"),
        ("est.txt", "1 0 0 0 0 1 0 0 0 0 1 nan\n", r"est\.txt holds no pose"),
        ("est.ckpt", "no pickle", "can't be read without running code"),
    ],
)
def test_damaged_files(tmp_path: Path, name: str, text: str, message: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(BenchError, match=message):
        read_written_poses(tmp_path / name)


def test_each_system_s_trajectory_is_found_among_its_other_files(tmp_path: Path) -> None:
    """Layouts as their code writes them: the true trajectory, logs and checkpoints are not the estimate."""
    layouts = {
        "splatam": (("params.npz", None), ("eval/psnr.txt", "20.1\n21.5\n"), ("params100.npz", None)),
        "monogs": (("plot/trj_final.json", "{}"), ("plot/trj_0050.json", "{}"), ("plot/stats_final.json", "{}")),
        "loopsplat": (("estimated_c2w.ckpt", ""), ("exposures_ab.ckpt", ""), ("submaps/000000.ckpt", "")),
        "kitti": (("est.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n"), ("gt_poses.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n")),
        "numpy": (("c2w.npy", None), ("gt_c2w.npy", None), ("times.txt", "0.1\n")),
    }
    for system, files in layouts.items():
        for name, text in files:
            path = tmp_path / system / name
            path.parent.mkdir(parents=True, exist_ok=True)
            if text is not None:
                path.write_text(text)
            elif path.suffix == ".npz":
                splatam(path)
            else:
                np.save(path, TRUE)
        found = search(tmp_path / system, ScoreSettings()).trajectory
        assert found == tmp_path / system / files[0][0]
