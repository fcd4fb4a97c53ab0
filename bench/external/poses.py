"""Trajectories as other systems write them: KITTI, TUM, arrays, and the files of SplaTAM, MonoGS, LoopSplat and
Point-SLAM."""

from __future__ import annotations

import math
import pickle
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.errors import BenchError, first_line
from bench.evaluation.trajectory_pair import detect_format
from bench.external.numbering import Numbers
from bench.geometry import se3
from bench.io.foreign import MOST_TEXT, plain_size, reading
from bench.io.json_files import load_json
from bench.io.numpy_files import npy_header, npz_headers, read_npy, read_npz
from bench.io.torch_files import MOST_BYTES, load_tensors
from bench.io.trajectories import FARTHEST_M, read_kitti_poses, read_tum
from bench.types import Float

TEXT, ARRAY, TORCH = (".txt", ".tum", ".kitti"), (".npy", ".npz"), (".ckpt", ".tar", ".pt", ".pth")
SUFFIXES = (*TEXT, *ARRAY, *TORCH, ".json")
_ROTATION_TOLERANCE = 1e-2
_MOST_POSES = 1_000_000
"""A day of driving at ten frames a second; an array that claims more is damaged, or made to fill the memory."""
_FLIP_YZ = np.diag([1.0, -1.0, -1.0, 1.0])
"""From OpenGL's camera axes (y up, z backwards) to OpenCV's; its own inverse."""


@dataclass(frozen=True)
class WrittenPoses:
    """The poses ``T`` (N, 4, 4) of a file as they are in it, and what its format says about them.

    ``times`` (N,) in seconds, or ``numbers`` (N,) of the system's frames, where the file has them. ``keyframes``:
    numbers of those that the system mapped, None where the file doesn't tell. ``world_to_camera`` and ``opengl``: of
    the format.
    """

    T: Float
    form: str
    times: Float | None = None
    numbers: Numbers | None = None
    keyframes: Numbers | None = None
    world_to_camera: bool = False
    opengl: bool = False

    def camera_to_world(self, convention: str = "auto", axes: str = "auto") -> Float:
        """The poses (N, 4, 4) as ``T_world_cam`` in OpenCV's axes; "auto" takes the format's word."""
        T = self.T
        if self.world_to_camera if convention == "auto" else convention == "world_to_camera":
            T = se3.inverse(T)
        return T @ _FLIP_YZ if (self.opengl if axes == "auto" else axes == "opengl") else T


def read_written_poses(path: Path) -> WrittenPoses:
    """Read a trajectory file by its extension and content.

    Text is KITTI's (12 numbers per line) or TUM's (8). ``.npy`` and ``.npz`` hold (N, 4, 4) or (N, 3, 4), or are
    SplaTAM's ``params.npz``; ``.json`` is MonoGS's ``trj_final.json``; ``.ckpt`` LoopSplat's ``estimated_c2w.ckpt``,
    ``.tar`` a checkpoint of Point-SLAM. Nothing in a file is ever run: pickled objects are refused. Raises
    ``BenchError`` with the file and the line or pose for what can't be read, for poses that are not finite, and for
    those that are no rigid motion.
    """
    suffix = path.suffix.lower()
    if not path.exists():
        raise BenchError(f"The trajectory file {path} does not exist. Check the path.")
    plain_size(path, MOST_BYTES if suffix in (*ARRAY, *TORCH) else MOST_TEXT)
    if suffix in ARRAY:
        return _read_numpy(path)
    if suffix == ".json":
        return _read_monogs(path)
    if suffix in TORCH:
        return _read_torch(path)
    if detect_format(path) == "kitti":
        return WrittenPoses(read_kitti_poses(path), "KITTI")
    trajectory = read_tum(path)
    return WrittenPoses(trajectory.T_world_cam, "TUM", times=trajectory.timestamps)


def _read_numpy(path: Path) -> WrittenPoses:
    with reading(
        path, "can't be read as NumPy arrays without pickled objects", "Save the trajectory alone, with numpy.save."
    ):
        if path.suffix.lower() == ".npy":
            _require_stack(npy_header(path, MOST_BYTES).shape, path)
            return WrittenPoses(_checked(read_npy(path, MOST_BYTES), path), "NumPy")
        there = npz_headers(path, MOST_BYTES)
        if {"cam_unnorm_rots", "cam_trans"} <= set(there):
            names = ("cam_unnorm_rots", "cam_trans", "keyframe_time_indices")
            wanted = {name: there[name] for name in names if name in there}
            return _splatam(read_npz(path, wanted, 16 * 8 * _MOST_POSES), path)
        stacks = [name for name, header in there.items() if header.dtype.kind in "fiu" and _is_stack(header.shape)]
        if len(stacks) != 1:
            raise BenchError(
                f"{path} holds {len(stacks)} arrays of poses (N, 4, 4) ({', '.join(there)}); one is needed. Save the "
                "trajectory alone, as .npy."
            )
        _require_stack(there[stacks[0]].shape, path)
        poses = read_npz(path, {stacks[0]: there[stacks[0]]}, math.inf)[stacks[0]]
        return WrittenPoses(_checked(poses, path), f"NumPy, array {stacks[0]}")


def _splatam(arrays: dict[str, Any], path: Path) -> WrittenPoses:
    """World-to-camera quaternions (1, 4, N), w first and not of unit length, and translations (1, 3, N)."""
    quaternions, translations = arrays["cam_unnorm_rots"], arrays["cam_trans"]
    count = translations.shape[-1]
    if quaternions.shape != (1, 4, count) or translations.shape != (1, 3, count):
        raise BenchError(
            f"{path}: cam_unnorm_rots has shape {quaternions.shape} and cam_trans {translations.shape}; SplaTAM writes "
            "(1, 4, N) and (1, 3, N). Is it the params.npz of a finished run?"
        )
    q = quaternions[0].T.astype(np.float64)
    length = np.linalg.norm(q, axis=1, keepdims=True)
    _require_finite(np.column_stack([q, translations[0].T, np.where(length > 0, 1.0, np.nan)]), path)
    T = se3.compose(se3.quaternion_to_rotation(np.roll(q / length, -1, axis=1)), translations[0].T.astype(np.float64))
    keyframes = arrays.get("keyframe_time_indices")
    mapped = None if keyframes is None else np.asarray(keyframes, dtype=np.int64).ravel()
    return WrittenPoses(T, "SplaTAM params", keyframes=mapped, world_to_camera=True)


def _read_monogs(path: Path) -> WrittenPoses:
    """Ids of keyframes and their camera-to-world poses: ``{"trj_id": [...], "trj_est": [...], ...}``."""
    with reading(
        path, "can't be read as MonoGS's trajectory, with lists trj_id and trj_est", "Convert it to KITTI or TUM."
    ):
        content = load_json(path)
        numbers = np.array(content["trj_id"], dtype=np.int64)
        T = np.array(content["trj_est"], dtype=np.float64)
        if numbers.shape != T.shape[:1] or len(np.unique(numbers)) != len(numbers):
            raise BenchError(f"{path}: trj_id needs one number for each of the {len(T)} poses of trj_est, none twice.")
        return WrittenPoses(_checked(T, path), "MonoGS keyframes", numbers=numbers, keyframes=numbers)


def _read_torch(path: Path) -> WrittenPoses:
    with reading(path, "can't be read as a file of torch.save", "Save its poses with numpy.save as (N, 4, 4)."):
        try:
            content = load_tensors(path)
        except pickle.UnpicklingError as error:
            raise BenchError(
                f"{path} can't be read without running code in it ({first_line(error)}). Save its poses with "
                "numpy.save as (N, 4, 4)."
            ) from error
        if isinstance(content, dict) and "estimate_c2w_list" in content:
            poses, count = content["estimate_c2w_list"], int(content.get("idx", -1)) + 1
            keyframes = content.get("keyframe_list")
            mapped = None if keyframes is None else np.asarray(keyframes, dtype=np.int64).ravel()
            T = _array(poses, path)[: count or None]
            return WrittenPoses(_checked(T, path), "Point-SLAM checkpoint", keyframes=mapped, opengl=True)
        if not isinstance(content, dict):
            return WrittenPoses(_checked(_array(content, path), path), "PyTorch tensor")
    raise BenchError(f"{path} holds no tensor of poses (N, 4, 4) and no estimate_c2w_list. Save them as .npy.")


def _array(poses: Any, path: Path) -> Float:
    """Poses (N, 4, 4) of a checkpoint: one tensor, also one that was being learned, or a list of matrices."""
    import torch  # its tensors come from its files only

    if isinstance(poses, (list, tuple)) and all(isinstance(pose, torch.Tensor) for pose in poses):
        _require_stack((len(poses), *(poses[0].shape if poses else ())), path)
        poses = torch.stack([pose.detach() for pose in poses])
    if not isinstance(poses, torch.Tensor):
        return np.asarray(poses, dtype=np.float64)
    # Before it is converted: a tensor's shape costs nothing, whatever it says.
    _require_stack(tuple(poses.shape), path)
    if poses.is_complex():
        raise BenchError(f"{path} holds complex numbers; poses are real.")
    return np.asarray(poses.detach().double().numpy())


def _require_stack(shape: tuple[int, ...], path: Path) -> None:
    if not _is_stack(shape):
        raise BenchError(f"{path} holds an array of shape {shape}; poses are (N, 4, 4) or (N, 3, 4).")
    if shape[0] > _MOST_POSES:
        raise BenchError(f"{path} says that it holds {shape[0]} poses; more than {_MOST_POSES} are not plausible.")


def _checked(poses: Any, path: Path) -> Float:
    """Poses (N, 4, 4) with exact rotations; ``BenchError`` names the first that is none."""
    T = np.asarray(poses)
    if T.dtype.kind not in "fiu" or not _is_stack(T.shape):
        raise BenchError(f"{path} holds {T.dtype} of shape {T.shape}; poses are (N, 4, 4) or (N, 3, 4).")
    full = np.tile(np.eye(4), (len(T), 1, 1))
    full[:, : T.shape[1]] = T
    _require_finite(full, path)
    R = full[:, :3, :3]
    with np.errstate(all="ignore"):  # of numbers without measure
        wrong = ~(np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2)) <= _ROTATION_TOLERANCE)
        wrong |= ~(np.linalg.det(R) > 0)
    wrong |= np.abs(full[:, 3] - [0, 0, 0, 1]).max(axis=1) > 1e-6
    if wrong.any():
        raise BenchError(
            f"{path}, pose {int(np.argmax(wrong))} (from 0) is no rigid motion [R t; 0 0 0 1]. Write rotations without "
            "scale, row by row."
        )
    return se3.orthonormalise(full)


def _require_finite(values: Float, path: Path) -> None:
    wrong = ~(np.abs(values.reshape(len(values), -1)) <= FARTHEST_M).all(axis=1)
    if wrong.any():
        raise BenchError(
            f"{path}, pose {int(np.argmax(wrong))} (from 0) is not finite, or holds a number above {FARTHEST_M:g}. "
            "Leave such poses out: as TUM, with times."
        )


def _is_stack(shape: tuple[int, ...]) -> bool:
    return len(shape) == 3 and shape[0] > 0 and shape[1:] in ((4, 4), (3, 4))
