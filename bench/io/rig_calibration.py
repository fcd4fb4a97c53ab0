"""Calibrations of unrectified stereo rigs, as OpenCV, Kalibr, ROS and the EuRoC data set write them in YAML.

Each file is told by its keys. OpenCV: ``stereoCalibrate`` as its samples save it, in one file or as intrinsics and
extrinsics. Kalibr: a camchain. ROS: two camera_info files. EuRoC: two sensor.yaml files.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bench.errors import BenchError
from bench.geometry import se3
from bench.geometry.rectification import DistortedCamera
from bench.io.foreign import read_plain_text, reading
from bench.io.named_matrices import is_rotation
from bench.io.yaml_files import parse_yaml
from bench.types import Float

_MODELS = {
    "radtan": "radtan",
    "radial-tangential": "radtan",
    "plumb_bob": "radtan",
    "rational_polynomial": "radtan",
    "none": "radtan",
    "equidistant": "equidistant",
}
"""What the formats call the models of distortion; others stay what they are, and are refused by name."""
_MOST_BYTES = 1_000_000
_FARTHEST_M = 20.0
"""No rig's cameras are farther apart: such a calibration is in millimetres."""

Size = tuple[int, int]


@dataclass(frozen=True)
class RigCalibration:
    """Both cameras, and ``T_right_left`` (4, 4), which takes points of the left camera's axes to the right one's."""

    left: DistortedCamera
    right: DistortedCamera
    T_right_left: Float

    def swapped(self) -> RigCalibration:
        """The same rig with its cameras exchanged."""
        return RigCalibration(self.right, self.left, se3.inverse(self.T_right_left))


def read_rig(first: Path, second: Path | None, size: Size, model: str = "", unit_m: float = 1.0) -> RigCalibration:
    """The calibration in one file or two, for images of ``size`` (width, height).

    ``model`` overrules what the files say of the distortion ("": nothing); ``unit_m``: metres of their unit of length.
    Raises ``BenchError`` for what is no such file, incomplete, of another image size or of another kind of camera.
    """
    of_first = _load(first)
    of_second = None if second is None else _load(second)
    if any(re.fullmatch(r"cam\d", str(key)) for key in of_first):
        rig = _of_kalibr(first, of_first, size)
    elif "T_BS" in of_first:
        rig = read_sensors(first, _required(second, first, "the right camera's sensor.yaml"), size)
    elif "projection_matrix" in of_first or "P" in of_first or "p" in of_first:
        other = _required(second, first, "the right camera's camera_info")
        rig = _of_ros((first, other), (of_first, of_second or {}), size)
    else:
        rig = _of_opencv(first, {**of_first, **(of_second or {})}, size, model)
    if model:
        rig = replace(rig, left=replace(rig.left, model=model), right=replace(rig.right, model=model))
    T = rig.T_right_left.copy()
    T[:3, 3] *= unit_m
    if not 0 < (apart := float(np.linalg.norm(T[:3, 3]))) <= _FARTHEST_M:
        raise BenchError(
            f"{first}: the cameras are {apart:g} m apart. Is it of one camera, or in millimetres "
            "(dataset.unit_m=0.001)?"
        )
    return replace(rig, T_right_left=T)


def read_sensors(left: Path, right: Path, size: Size) -> RigCalibration:
    """Of EuRoC's two sensor.yaml; raises ``BenchError`` as ``read_rig``."""
    (of_left, T_body_left), (of_right, T_body_right) = (read_sensor(path, size) for path in (left, right))
    return RigCalibration(of_left, of_right, se3.inverse(T_body_right) @ T_body_left)


def read_sensor(path: Path, size: Size) -> tuple[DistortedCamera, Float]:
    """A camera and T_body_camera (4, 4) of EuRoC's sensor.yaml; raises ``BenchError`` as ``read_rig``."""
    content = _load(path)
    camera = _pinhole(path, content, "distortion_coefficients", size)
    return camera, _motion(path, "T_BS", _matrix(path, content, "T_BS", (4, 4)))


def _of_kalibr(path: Path, content: Mapping[str, Any], size: Size) -> RigCalibration:
    cameras = [each for each in (content.get("cam0"), content.get("cam1")) if isinstance(each, Mapping)]
    if len(cameras) < 2:
        raise BenchError(f"{path} lacks cam0 or cam1: a stereo rig has both. Give the camchain of the two cameras.")
    left, right = (_pinhole(path, camera, "distortion_coeffs", size, f"cam{i}") for i, camera in enumerate(cameras))
    T = _motion(path, "T_cn_cnm1", _matrix(path, cameras[1], "T_cn_cnm1", (4, 4)))
    return RigCalibration(left, right, T)


def _pinhole(path: Path, content: Mapping[str, Any], coefficients: str, size: Size, name: str = "") -> DistortedCamera:
    """The keys that Kalibr and EuRoC share."""
    where = f"{path}, {name}" if name else str(path)
    if (kind := content.get("camera_model", "pinhole")) != "pinhole":
        raise BenchError(f"{where}: the camera_model {kind!r} is not read, only pinhole. Calibrate with that one.")
    _require_size(where, _numbers(where, content, "resolution", 2), size)
    fx, fy, cx, cy = _numbers(where, content, "intrinsics", 4)
    model = str(content.get("distortion_model", "none"))
    distortion = (0.0,) * 4 if model == "none" else _numbers(where, content, coefficients)
    return DistortedCamera(*size, fx, fy, cx, cy, _MODELS.get(model, model), distortion, where)


def _of_ros(paths: Sequence[Path], contents: Sequence[Mapping[str, Any]], size: Size) -> RigCalibration:
    """A camera_info says how its camera is turned to be rectified (R), and where it then is (P = K [I | t])."""
    cameras, turns, projections = [], [], []
    for path, content in zip(paths, contents, strict=True):
        named = {long: _either(path, content, long, short) for long, short in _ROS_KEYS.items()}
        _require_size(str(path), [*_flat(path, named, "image_width"), *_flat(path, named, "image_height")], size)
        K = _matrix(path, named, "camera_matrix", (3, 3))
        model = str(content.get("distortion_model", "plumb_bob"))
        distortion = _flat(path, named, "distortion_coefficients")
        where = str(path)
        cameras.append(_camera(K, distortion or (0.0,) * 4, _MODELS.get(model, model), size, where))
        turns.append(_rotation(path, "rectification_matrix", _matrix(path, named, "rectification_matrix", (3, 3))))
        P = _matrix(path, named, "projection_matrix", (3, 4))
        if not (P[0, 0] > 0 and P[1, 1] > 0 and P[2, 2] > 0):
            raise BenchError(f"{path}: the projection_matrix is none. Save the calibration after it was computed.")
        projections.append(np.linalg.solve(P[:, :3], P[:, 3]))
    # In the rectified axes, which both cameras share, the right camera's points are the left one's moved.
    R_left, R_right = turns
    T = se3.compose(R_right.T @ R_left, R_right.T @ (projections[1] - projections[0]))
    return RigCalibration(cameras[0], cameras[1], T)


_ROS_KEYS = {
    "image_width": "width",
    "image_height": "height",
    "camera_matrix": "K",
    "distortion_coefficients": "D",
    "rectification_matrix": "R",
    "projection_matrix": "P",
}
"""In files of ROS's calibrator, and in the message as ``rostopic echo`` prints it (ROS 2: small letters)."""


def _either(path: Path, content: Mapping[str, Any], long: str, short: str) -> Any:
    for key in (long, short, short.lower()):
        if key in content:
            return content[key]
    raise BenchError(f"{path} lacks {long}, which a camera_info has. Save it again by ROS's calibrator.")


def _of_opencv(path: Path, content: Mapping[str, Any], size: Size, model: str) -> RigCalibration:
    cameras = []
    for number in (1, 2):
        K = _matrix(path, content, _first_key(path, content, _OPENCV_K, number), (3, 3))
        distortion = _flat(path, content, _first_key(path, content, _OPENCV_D, number))
        if len(distortion) == 4 and not model:
            raise BenchError(
                f"{path}: four distortion coefficients may be k1, k2, p1, p2 or a fisheye's k1 to k4, and OpenCV does "
                "not write which. Say it: dataset.model=radtan or dataset.model=equidistant."
            )
        cameras.append(_camera(K, distortion, model or "radtan", size, f"{path}, camera {number}"))
    if "image_size" in content or "imageSize" in content:
        written = _flat(path, content, "image_size" if "image_size" in content else "imageSize")
        _require_size(str(path), written, size)
    if not {"R", "T"} <= content.keys():
        raise BenchError(
            f"{path} lacks R and T of the right camera. Where they are in a file of their own, as extrinsics.yml of "
            "OpenCV's sample, give it: dataset.second_calibration=FILE."
        )
    T = _flat(path, content, "T")
    if len(T) != 3:
        raise BenchError(f"{path}: T has {len(T)} numbers, expected 3. Restore the file.")
    T_right_left = se3.compose(_rotation(path, "R", _matrix(path, content, "R", (3, 3))), np.array(T))
    return RigCalibration(cameras[0], cameras[1], T_right_left)


_OPENCV_K = ("M{}", "K{}", "cameraMatrix{}", "camera_matrix_{}", "CM{}")
_OPENCV_D = ("D{}", "distCoeffs{}", "dist_coeffs_{}", "dist{}")


def _first_key(path: Path, content: Mapping[str, Any], patterns: Sequence[str], number: int) -> str:
    keys = [pattern.format(number) for pattern in patterns]
    found = next((key for key in keys if key in content), None)
    if found is None:
        raise BenchError(
            f"{path} has none of {', '.join(keys)} (it has {', '.join(map(str, list(content)[:8])) or 'nothing'}). "
            "Give a calibration by OpenCV (stereoCalibrate), Kalibr (camchain), ROS (camera_info) or EuRoC's "
            "sensor.yaml."
        )
    return found


def _camera(K: Float, distortion: tuple[float, ...], model: str, size: Size, where: str) -> DistortedCamera:
    if abs(K[0, 1]) > 1e-6:
        raise BenchError(f"{where}: the camera matrix has a skew of {K[0, 1]:g}, which is not read. Calibrate without.")
    fx, fy, cx, cy = (float(K[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return DistortedCamera(*size, fx, fy, cx, cy, model, _used(distortion), where)


def _used(distortion: tuple[float, ...]) -> tuple[float, ...]:
    """OpenCV pads its coefficients with zeros to 14, ROS to 5 or 8; the counts that it knows are kept."""
    return distortion[:5] if len(distortion) > 5 and not any(distortion[5:]) else distortion


def _load(path: Path) -> dict[str, Any]:
    """The mapping in a YAML file. OpenCV writes a directive and tags of its own, which say nothing more."""
    if not path.is_file():
        raise BenchError(f"The calibration {path} does not exist. Check the path.")
    with reading(path, "can't be read as YAML", "Give a calibration as YAML."):
        text = re.sub(r"\A%YAML[^\n]*\n(---[^\n]*\n)?", "", read_plain_text(path, _MOST_BYTES))
        text = re.sub(r"!!opencv-(nd-)?matrix", "", text)
        # `rostopic echo` puts --- behind each message: the first one counts.
        content = parse_yaml(re.split(r"(?m)^---\s*$", text.removeprefix("---\n"))[0])
    if not isinstance(content, dict):
        raise BenchError(f"{path} is no calibration: expected names and values. Give the right file.")
    return content


def _required(second: Path | None, first: Path, what: str) -> Path:
    if second is None:
        raise BenchError(f"{first} is of one camera alone. Give {what} too, dataset.second_calibration=FILE.")
    return second


def _numbers(where: str, content: Mapping[str, Any], key: str, count: int | None = None) -> tuple[float, ...]:
    numbers = _flat(where, content, key)
    if count is not None and len(numbers) != count:
        raise BenchError(f"{where}: {key} has {len(numbers)} numbers, expected {count}. Restore the file.")
    return numbers


def _flat(where: Path | str, content: Mapping[str, Any], key: str) -> tuple[float, ...]:
    """The numbers of a list, a list of lists, or a matrix with ``data``."""
    value = content.get(key)
    value = value.get("data") if isinstance(value, Mapping) else value
    if value is None:
        raise BenchError(f"{where}: {key} is missing. Restore the file.")
    try:
        return tuple(np.asarray(value, dtype=np.float64).reshape(-1).tolist())
    except (TypeError, ValueError, OverflowError):
        raise BenchError(f"{where}: {key} holds something that is no number. Restore the file.") from None


def _matrix(where: Path | str, content: Mapping[str, Any], key: str, shape: tuple[int, int]) -> Float:
    numbers = _flat(where, content, key)
    if len(numbers) != shape[0] * shape[1] or not np.isfinite(numbers).all():
        raise BenchError(f"{where}: {key} is no matrix of {shape[0]}x{shape[1]} numbers. Restore the file.")
    return np.array(numbers).reshape(shape)


def _rotation(path: Path, key: str, R: Float) -> Float:
    return _motion(path, key, se3.compose(R, np.zeros(3)))[:3, :3]


def _motion(path: Path, key: str, T: Float) -> Float:
    if not is_rotation(T[:3, :3]) or not np.allclose(T[3], [0, 0, 0, 1]):
        raise BenchError(f"{path}: {key} is no rigid motion, its 3x3 part is not a rotation. Restore the file.")
    return se3.orthonormalise(T)


def _require_size(where: str, written: Sequence[float], size: Size) -> None:
    if tuple(written) != size:
        raise BenchError(
            f"{where} is for images of {'x'.join(f'{side:g}' for side in written)} pixels, and these are "
            f"{size[0]}x{size[1]}. Give the calibration of these images, or the images of that size."
        )
