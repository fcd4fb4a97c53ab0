"""A rig as it lies on a disk: pictures as its cameras would take them, and its calibration in every format."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import yaml

from bench.geometry import se3
from bench.geometry.rectification import DistortedCamera
from bench.types import StereoCamera

LEFT = {
    "radtan": DistortedCamera(640, 192, 500.0, 502.0, 322.0, 94.0, "radtan", (-0.28, 0.07, 2e-4, 2e-5), "left"),
    "equidistant": DistortedCamera(
        640, 192, 400.0, 401.0, 318.0, 97.0, "equidistant", (-0.01, 0.02, -0.01, 0.002), "left"
    ),
}
ASKEW = {"left": np.array([0.01, 0.03, 0.02]), "right": np.array([-0.015, 0.01, -0.01])}
"""How each camera is turned against the street's (x right, y down, z ahead), as rotation vectors in radians."""


def right_of(left: DistortedCamera) -> DistortedCamera:
    return replace(left, fx=left.fx - 3, cx=left.cx + 5, where="right")


def T_right_left(baseline: float) -> np.ndarray:
    """By hand: p_left = R_left p, p_right = R_right (p - (b, 0, 0)) of a point p in the street camera's axes."""
    R_left, R_right = se3.so3_exp(ASKEW["left"]), se3.so3_exp(ASKEW["right"])
    return se3.compose(R_right @ R_left.T, -R_right @ np.array([baseline, 0.0, 0.0]))


def taken_by(camera: DistortedCamera, turn: np.ndarray, image: np.ndarray, street: StereoCamera) -> np.ndarray:
    """What the distorted camera sees of a picture that an ideal one took from the same place."""
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    pixels = np.stack([u, v], -1).reshape(-1, 1, 2)
    model = cv2.fisheye if camera.model == "equidistant" else cv2
    xy = model.undistortPoints(pixels, camera.intrinsics, np.array(camera.distortion))[:, 0]
    rays = np.column_stack([xy, np.ones(len(xy))]) @ se3.so3_exp(turn)  # R^T ray
    seen = (rays / rays[:, 2:]) @ street.intrinsics.T
    maps = (seen[:, i].reshape(camera.height, camera.width).astype(np.float32) for i in range(2))
    return cv2.remap(image, *maps, interpolation=cv2.INTER_CUBIC)


Write = Callable[[Path, DistortedCamera, DistortedCamera, np.ndarray], dict[str, str]]


def matrix(value: object, **more: object) -> dict[str, object]:
    array = np.atleast_2d(np.asarray(value))
    return {"rows": array.shape[0], "cols": array.shape[1], **more, "data": array.ravel().tolist()}


def dump(path: Path, content: object, start: str = "") -> str:
    path.write_text(start + yaml.safe_dump(content, default_flow_style=None))
    return str(path)


def opencv_yaml(path: Path, matrices: dict[str, object]) -> str:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in matrices.items():
        storage.write(name, np.asarray(value, np.float64))
    storage.release()
    return str(path)


def by_opencv(folder: Path, left: DistortedCamera, right: DistortedCamera, T: np.ndarray) -> dict[str, str]:
    """One file, written by OpenCV itself."""
    cameras = {f"{name}{i}": value for i, c in ((1, left), (2, right)) for name, value in _of(c).items()}
    path = opencv_yaml(folder / "stereo.yml", {**cameras, "R": T[:3, :3], "T": T[:3, 3]})
    return {"calibration": path, "model": left.model}


def by_opencv_in_two(folder: Path, left: DistortedCamera, right: DistortedCamera, T: np.ndarray) -> dict[str, str]:
    """Intrinsics and extrinsics, in millimetres."""
    cameras = {f"{name}{i}": value for i, c in ((1, left), (2, right)) for name, value in _of(c).items()}
    return {
        "calibration": opencv_yaml(folder / "intrinsics.yml", cameras),
        "second_calibration": opencv_yaml(folder / "extrinsics.yml", {"R": T[:3, :3], "T": 1000 * T[:3, 3]}),
        "model": left.model,
        "unit_m": "0.001",
    }


def _of(camera: DistortedCamera) -> dict[str, object]:
    return {"M": camera.intrinsics, "D": [camera.distortion]}


def _pinhole(camera: DistortedCamera) -> dict[str, object]:
    return {
        "camera_model": "pinhole",
        "intrinsics": [camera.fx, camera.fy, camera.cx, camera.cy],
        "resolution": [camera.width, camera.height],
    }


def by_kalibr(folder: Path, left: DistortedCamera, right: DistortedCamera, T: np.ndarray) -> dict[str, str]:
    cameras = {
        f"cam{i}": {**_pinhole(c), "distortion_model": c.model, "distortion_coeffs": list(c.distortion)}
        for i, c in enumerate((left, right))
    }
    cameras["cam1"]["T_cn_cnm1"] = T.tolist()
    return {"calibration": dump(folder / "camchain.yaml", cameras)}


def by_euroc(folder: Path, left: DistortedCamera, right: DistortedCamera, T: np.ndarray) -> dict[str, str]:
    T_body_left = se3.exp(np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6]))
    names = {"radtan": "radial-tangential", "equidistant": "equidistant"}
    paths = []
    for name, camera, T_BS in (("left", left, T_body_left), ("right", right, T_body_left @ np.linalg.inv(T))):
        content = {**_pinhole(camera), "T_BS": matrix(T_BS), "distortion_model": names[camera.model]}
        content["distortion_coefficients"] = list(camera.distortion)
        paths.append(dump(folder / f"{name}.yaml", content, "%YAML:1.0\n"))
    return {"calibration": paths[0], "second_calibration": paths[1]}


def by_ros(folder: Path, left: DistortedCamera, right: DistortedCamera, T: np.ndarray) -> dict[str, str]:
    """As ROS's calibrator, which asks OpenCV for the rectified axes."""
    zero, size = np.zeros(4), (left.width, left.height)
    turns = cv2.stereoRectify(left.intrinsics, zero, right.intrinsics, zero, size, T[:3, :3], T[:3, 3:], alpha=-1)
    names = {"radtan": "plumb_bob", "equidistant": "equidistant"}
    paths = []
    for name, camera, R, P in (("left", left, turns[0], turns[2]), ("right", right, turns[1], turns[3])):
        content = {
            "image_width": camera.width,
            "image_height": camera.height,
            "camera_name": name,
            "camera_matrix": matrix(camera.intrinsics),
            "distortion_model": names[camera.model],
            "distortion_coefficients": matrix([camera.distortion]),
            "rectification_matrix": matrix(R),
            "projection_matrix": matrix(P),
        }
        paths.append(dump(folder / f"{name}_info.yaml", content))
    return {"calibration": paths[0], "second_calibration": paths[1]}


def by_ros_topic(folder: Path, left: DistortedCamera, right: DistortedCamera, T: np.ndarray) -> dict[str, str]:
    """As `ros2 topic echo` prints the messages."""
    given = by_ros(folder, left, right, T)
    for path in map(Path, given.values()):
        content = yaml.safe_load(path.read_text())
        message = {"height": content["image_height"], "width": content["image_width"]}
        message["distortion_model"] = content["distortion_model"]
        for short, long in (
            ("d", "distortion_coefficients"),
            ("k", "camera_matrix"),
            ("r", "rectification_matrix"),
            ("p", "projection_matrix"),
        ):
            message[short] = content[long]["data"]
        text = yaml.safe_dump(message)
        path.write_text(f"{text}---\n{text}---\n")
    return given


FORMATS: dict[str, Write] = {
    "OpenCV": by_opencv,
    "OpenCV in two files": by_opencv_in_two,
    "Kalibr": by_kalibr,
    "EuRoC": by_euroc,
    "ROS": by_ros,
    "ROS 2 topic": by_ros_topic,
}
