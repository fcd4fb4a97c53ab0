"""The files that commands read, each whole, and what reads it: what a stranger's folder, a disk or a cache may hold."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch

from bench.cache.entry import Stored
from bench.cache.recording import Recording
from bench.cache.store import SEQUENCE_KEY, CacheStore
from bench.cli import main
from bench.contracts.dataset import Dataset
from bench.external.output import read_output
from bench.external.poses import read_written_poses
from bench.external.settings import read_settings
from bench.gaussians.ply import write_ply
from bench.io.images import image_size, read_rgb
from bench.io.kitti_files import KittiCalibration, read_kitti_times
from bench.io.scans import check_scan_file, read_scan
from bench.io.trajectories import read_kitti_poses, read_tum, write_tum
from bench.io.trajectories import write_kitti as write_kitti_poses
from bench.runs.checkpoint import Checkpoints, Snapshot
from bench.stereo.checkpoint import load_state
from bench.stereo.onnx_session import open_session
from bench.tables.named.records import read_runs
from bench.tables.records.file import record_text
from bench.tracking.loops.vocabulary import load as load_vocabulary
from bench.tracking.loops.vocabulary import train
from bench.types import TrackingResult, Trajectory
from bench.viewers.splats import read_splats
from plugins.datasets.euroc import Euroc, EurocConfig
from plugins.datasets.kitti import Kitti, KittiConfig
from plugins.datasets.kitti360 import Kitti360, Kitti360Config
from plugins.datasets.replica import Replica, ReplicaConfig
from plugins.datasets.rig import Rig, RigConfig
from plugins.datasets.tartanair import TartanAir, TartanAirConfig
from plugins.datasets.tum_rgbd import TumRgbd, TumRgbdConfig
from plugins.datasets.vkitti2 import Vkitti2, Vkitti2Config
from tests.datasets.euroc_disk import TRUTH, write_euroc, write_truth
from tests.datasets.kitti360_disk import drive_of, write_kitti360
from tests.datasets.kitti_disk import write_kitti
from tests.datasets.rendered_disk import write_tartanair, write_vkitti2
from tests.datasets.rgbd_disk import OWN, replica, tum
from tests.datasets.rig_disk import FORMATS, LEFT, T_right_left, right_of
from tests.evaluation.tiny_run import write_tiny_run
from tests.external.foreign_case import COUNT, HEIGHT, WIDTH, curve, dataset, write_depth, write_poses, write_renders
from tests.stereo.tiny_onnx import channel_reader

FRAMES = np.arange(COUNT)
TIMES = 0.1 * FRAMES
KEY = "ab" * 32


@dataclass(frozen=True)
class Target:
    """``make`` fills a folder; ``file`` in it is spoilt, and ``read`` called with the folder."""

    file: str
    make: Callable[[Path], object]
    read: Callable[[Path], object]


def command(*arguments: str) -> None:
    """A command that ends as a command should; its one line of error is looked at by the test."""
    assert main(arguments) in (0, 2)


def _image(path: Path) -> None:
    assert cv2.imwrite(str(path), np.random.default_rng(0).integers(0, 200, (HEIGHT, WIDTH, 3), dtype=np.uint8))


def _read_image(path: Path) -> None:
    image_size(path)
    read_rgb(path, (WIDTH, HEIGHT))


def _splatam(path: Path) -> None:
    np.savez_compressed(path, cam_unnorm_rots=np.ones((1, 4, COUNT)), cam_trans=np.zeros((1, 3, COUNT)))


def _monogs(path: Path) -> None:
    path.write_text(json.dumps({"trj_id": [0, 3], "trj_est": curve(FRAMES[[0, 3]]).tolist()}))


def _point_slam(path: Path) -> None:
    poses = torch.tensor(curve(FRAMES))
    torch.save({"estimate_c2w_list": poses, "idx": torch.tensor(5), "keyframe_list": [0, 5]}, path)


def _calibration(path: Path) -> None:
    path.write_text("".join(f"P{k}: 707 0 602 {-380.0 * k} 0 707 183 0 0 0 1 0\n" for k in range(4)))


def _scan(path: Path) -> None:
    np.random.default_rng(0).random((50, 4), dtype=np.float32).tofile(path)


def _snapshot(path: Path) -> None:
    checkpoints = Checkpoints(path.parents[1], "same", 0.0)
    snapshot = Snapshot(
        rows=[{"number": 0}],
        mapper={"planes": torch.zeros(14, 3)},
        seconds={"mapping": 1.0},
        elapsed_s=2.0,
        psnr_db=20.0,
        peak_memory_gb=0.1,
        random=torch.ones(4),
        resumed_after=[],
        events=[],
        keyframe_poses=[np.eye(4)],
        seeing={},
        obsolete={},
        optimised=False,
    )
    checkpoints.write(snapshot)


def _vocabulary(path: Path) -> None:
    words = np.random.default_rng(0).integers(0, 2**63, (2, 60, 4)).astype(np.uint64)
    train(list(words), branching=3, depth=2).save(path)


def _recorded(path: Path) -> None:
    recording = Recording()
    for k in range(2):
        result = TrackingResult(curve(FRAMES)[k], "ok", 9, 0.5, FRAMES)
        recording.add(b"0" * 32, result, 0.1, Trajectory(curve(FRAMES[: k + 1]), FRAMES[: k + 1], TIMES[: k + 1]))
    _store(path).write_content("tracker", "net", KEY, recording.encode())


def _read_recorded(path: Path) -> None:
    Recording.decode(_store(path).read_content("tracker", "net", KEY) or b"")


def _store(path: Path) -> CacheStore:
    return CacheStore(path.parents[3], 1e9)


def _mask(path: Path) -> None:
    _store(path).write("sky", "net", KEY, Stored(np.ones((40, 50), bool), 0.1, ""))


def _make_run(folder: Path) -> None:
    names = ("ate", "rpe", "image", "depth", "resources")
    config = {
        "system": "bgs_slam",
        "seed": 0,
        "protocol": {"name": "default", "lpips": False, "depth_min_m": 0.0},
        "dataset": {"name": "tiny_for_tests"},
        "stereo": {"name": "sgbm"},
        "mapper": {"name": "gaussian", "rasterizer": {"name": "cpu"}},
        "evaluator": {name: {"name": name} for name in names},
    }
    write_tiny_run(folder, config)
    metrics = {
        "protocol": {"name": "default", "ssim": "3dgs"},
        "trajectory": {"ate_rmse_m": 0.5, "static_camera_ate_rmse_m": 3.0},
        "views": {"left": {"n": 4, "psnr_db": 20.5}},
        "frames": {"total": 5, "tracked": 4, "lost": 1, "weak": 0, "lost_stretches": [[12, 12]]},
        "map": {"gaussians": 1234},
        "dialects": {"mono_gs": {"n_views": 3, "psnr_db": 30.0, "stamp": {"mask": "none"}}},
        "notes": {"lpips": "switched off"},
        "declared": [{"key": "halves", "title": "Halves", "path": "map.gaussians"}],
    }
    provenance = {"git": {"commit": "0" * 40}, "machine": {"cpu": "x", "gpu": None}, "weights": {}}
    (folder / "metrics.json").write_text(json.dumps(metrics))
    (folder / "provenance.json").write_text(json.dumps(provenance))
    (folder / "events.jsonl").write_text('{"kind": "loop_closed", "frame": 3, "values": {"to_frame": 1}}\n')


def _run(folder: Path) -> None:
    _make_run(folder / "run")


def _tables(folder: Path) -> None:
    command("table", str(folder / "run"))
    command("table", "dialects", str(folder / "run"), "--out", str(folder / "out"))
    command("table", "main_kitti", str(folder / "run"))


def _evaluate(folder: Path) -> None:
    command("evaluate", str(folder / "run"))


def _record(path: Path) -> None:
    for seed in range(2):
        _make_run(path.parent / f"run{seed}")
    path.write_text(record_text(read_runs([path.parent / f"run{seed}" for seed in range(2)])))
    for seed in range(2):
        shutil.rmtree(path.parent / f"run{seed}")


def _read_record(path: Path) -> None:
    command("table", str(path), "--out", str(path.parent / "out" / "t.runs.json"), str(path.parent / "out" / "t.tex"))
    command("table", "dialects", str(path))


def _their_output(top: Path) -> None:
    folder = top / "theirs"
    write_poses(folder / "est.txt", curve(FRAMES))
    write_renders(folder / "renders", [0, 1])
    write_depth(folder / "depth", [0], 12.0)
    np.save(folder / "depth" / "000001.npy", np.full((HEIGHT, WIDTH), 12.0, np.float32))
    (folder / "score.yaml").write_text("name: Theirs\ndepth_scale: 256\nresources: {gaussians: 7}\n")


def _read_output(top: Path) -> None:
    folder = top / "theirs"
    read_output(folder, read_settings(folder, {"name": "Theirs"}), dataset())


def _file(name: str, make: Callable[[Path], object], read: Callable[[Path], object]) -> Target:
    """A single file."""
    return Target(name, lambda folder: make(folder / name), lambda folder: read(folder / name))


def _in_cache_folder(kind: str) -> str:
    return f"{kind}/net/{KEY[:SEQUENCE_KEY]}/{KEY}.entry"


def _read_kitti(root: Path) -> None:
    _read_dataset(Kitti(KittiConfig(root=str(root), sequence="04")))


def _read_kitti360(root: Path) -> None:
    _read_dataset(Kitti360(Kitti360Config(root=str(root), sequence="0002")))


def _read_tum(root: Path) -> None:
    _read_dataset(TumRgbd(TumRgbdConfig(root=str(root), sequence="rgbd_dataset_handheld", **OWN)))


def _read_replica(root: Path) -> None:
    _read_dataset(Replica(ReplicaConfig(root=str(root), sequence="office7", **OWN)))


def _euroc(root: Path) -> None:
    shutil.rmtree(root / "V9_01_made_up", ignore_errors=True)
    write_truth(write_euroc(root))


def _read_euroc(root: Path) -> None:
    _read_dataset(Euroc(EurocConfig(root=str(root), sequence="V9_01_made_up")))


def _read_vkitti2(root: Path) -> None:
    _read_dataset(Vkitti2(Vkitti2Config(root=str(root), sequence="Scene02", variation="rain")))


def _read_tartanair(root: Path) -> None:
    _read_dataset(TartanAir(TartanAirConfig(root=str(root), sequence="hospital/Easy/P001")))


def _rig(root: Path) -> None:
    """Blank pictures, the calibrations of every format, and a video with both images."""
    for name, write in FORMATS.items():
        (root / name).mkdir(exist_ok=True)
        write(root / name, LEFT["radtan"], right_of(LEFT["radtan"]), T_right_left(0.3))
    for side in ("left", "right"):
        (root / side).mkdir(exist_ok=True)
        assert cv2.imwrite(str(root / side / "0.png"), np.full((192, 640), 90, np.uint8))
    writer = cv2.VideoWriter(str(root / "both.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 20.0, (1280, 192))
    for _ in range(3):
        writer.write(np.full((192, 1280, 3), 90, np.uint8))
    writer.release()


def _rig_reader(
    calibration: str, second: str | None = None, left: str = "left", right: str = "right"
) -> Callable[[Path], object]:
    def read(root: Path) -> None:
        other = None if second is None else str(root / second)
        given = {"calibration": str(root / calibration), "second_calibration": other, "model": "radtan"}
        pictures = {"left": str(root / left), "right": right and str(root / right)}
        _read_dataset(Rig(RigConfig(**given, **pictures)))

    return read


def _read_dataset(dataset: Dataset) -> None:
    dataset.frame(0)
    dataset.lidar_depth(0)
    dataset.sensor_depth(0)
    dataset.ground_truth()


def _map_and_keyframes(folder: Path) -> None:
    write_ply(folder / "map.ply", torch.randn(14, 30))
    np.save(folder / "map_keyframes.npy", np.arange(30, dtype=np.int32))


def _read_entry(path: Path) -> None:
    _store(path).read("sky", "net", KEY)


_RUN_FILES = ("config.yaml", "status.json", "metrics.json", "resources.json", "provenance.json", "events.jsonl")
_SCORED_FILES = (
    *("config.yaml", "status.json", "frames.csv", "trajectory.csv", "ground_truth.csv", "resources.json"),
    *("views/left/color/000010.png", "views/left/depth/000010.png"),
)
_THEIR_FILES = ("est.txt", "score.yaml", "renders/gs_0000.png", "depth/000000.png", "depth/000001.npy")
_KITTI360_FILES = (
    *("calibration/perspective.txt", "calibration/calib_cam_to_pose.txt", "calibration/calib_cam_to_velo.txt"),
    *(f"data_poses/{drive_of('0002')}/cam0_to_world.txt", f"data_2d_raw/{drive_of('0002')}/image_00/timestamps.txt"),
)
_KITTI_FILES = ("calib.txt", "times.txt", "image_2/000000.png", "velodyne/000000.bin")
_TUM_FILES = ("rgb.txt", "groundtruth.txt", "depth/10.015.png")
_REPLICA_FILES = ("traj.txt", "results/depth000000.png")
_EUROC_FILES = ("cam0/data.csv", "cam1/sensor.yaml", TRUTH)
_VKITTI2_FILES = ("extrinsic.txt", "intrinsic.txt", "frames/depth/Camera_0/depth_00000.png")
_TARTANAIR_FILES = ("pose_left.txt", "depth_left/000000_left_depth.npy")
_RIG_FILES = {
    "OpenCV/stereo.yml": _rig_reader("OpenCV/stereo.yml"),
    "Kalibr/camchain.yaml": _rig_reader("Kalibr/camchain.yaml"),
    "ROS/right_info.yaml": _rig_reader("ROS/left_info.yaml", "ROS/right_info.yaml"),
    "both.avi": _rig_reader("Kalibr/camchain.yaml", None, "both.avi", ""),
}
_TRAJECTORY = Trajectory(curve(FRAMES), FRAMES, TIMES)

TARGETS = (
    _file("calib.txt", _calibration, KittiCalibration),
    _file("times.txt", lambda path: path.write_text("".join(f"{time:.6e}\n" for time in TIMES)), read_kitti_times),
    _file("06.txt", lambda path: write_kitti_poses(path, curve(FRAMES)), read_kitti_poses),
    _file("est.tum", lambda path: write_tum(path, _TRAJECTORY), read_tum),
    _file("left.png", _image, _read_image),
    _file("left.jpg", _image, _read_image),
    _file("scan.bin", _scan, lambda path: (check_scan_file(path), read_scan(path))),
    _file("poses.npy", lambda path: np.save(path, curve(FRAMES)), read_written_poses),
    _file("params.npz", _splatam, read_written_poses),
    _file("trj_final.json", _monogs, read_written_poses),
    _file("00005.tar", _point_slam, read_written_poses),
    _file("net.pth", lambda path: torch.save({"model": torch.nn.Linear(2, 3).state_dict()}, path), load_state),
    _file("net.onnx", lambda path: channel_reader(path, 0), lambda path: open_session(path, "cpu", 1)),
    _file("map.ply", lambda path: write_ply(path, torch.randn(14, 30)), lambda path: command("map", str(path))),
    Target("map_keyframes.npy", _map_and_keyframes, lambda folder: read_splats(folder / "map.ply", 9)),
    _file("words.npz", _vocabulary, load_vocabulary),
    _file("checkpoint/state.pt", _snapshot, lambda path: Checkpoints(path.parents[1], "same", 0.0).load()),
    _file(_in_cache_folder("sky"), _mask, _read_entry),
    _file(_in_cache_folder("tracker"), _recorded, _read_recorded),
    _file("kept.runs.json", _record, _read_record),
    *(Target(f"run/{name}", _run, _tables) for name in _RUN_FILES),
    *(Target(f"run/{name}", _run, _evaluate) for name in _SCORED_FILES),
    *(Target(f"sequences/04/{name}", write_kitti, _read_kitti) for name in _KITTI_FILES),
    Target("poses/04.txt", write_kitti, _read_kitti),
    *(Target(name, write_kitti360, _read_kitti360) for name in _KITTI360_FILES),
    *(Target(f"rgbd_dataset_handheld/{name}", tum, _read_tum) for name in _TUM_FILES),
    *(Target(f"office7/{name}", replica, _read_replica) for name in _REPLICA_FILES),
    *(Target(f"V9_01_made_up/mav0/{name}", _euroc, _read_euroc) for name in _EUROC_FILES),
    *(Target(f"Scene02/rain/{name}", write_vkitti2, _read_vkitti2) for name in _VKITTI2_FILES),
    *(Target(f"hospital/Easy/P001/{name}", write_tartanair, _read_tartanair) for name in _TARTANAIR_FILES),
    *(Target(name, _rig, read) for name, read in _RIG_FILES.items()),
    *(Target(f"theirs/{name}", _their_output, _read_output) for name in _THEIR_FILES),
)
