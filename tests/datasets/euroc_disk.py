"""A made-up EuRoC sequence on disk."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

START = 1403715273262142976
STEP = 50_000_000
# Published: the camera is on the drone's front, its x is the body's -y, its z ahead (the body's x is up).
T_BODY_LEFT = np.array(
    [
        [0.0148655429818, -0.999880929698, 0.00414029679422, -0.0216401454975],
        [0.999557249008, 0.0149672133247, 0.025715529948, -0.064676986768],
        [-0.0257744366974, 0.00375618835797, 0.999660727178, 0.00981073058949],
        [0.0, 0.0, 0.0, 1.0],
    ]
)
T_LEFT_RIGHT = np.array([[1.0, 0, 0, 0.11], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
TRUTH = "state_groundtruth_estimate0/data.csv"
HEADER = "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []"


def write_euroc(root: Path, count: int = 4, seconds: bool = False) -> Path:
    """Cameras without distortion that look the same way, so that rectifying moves nothing; returns ``mav0``."""
    mav0 = root / "V9_01_made_up" / "mav0"
    times = [START + number * STEP for number in range(count)]
    for side, T in enumerate((T_BODY_LEFT, T_BODY_LEFT @ T_LEFT_RIGHT)):
        camera = mav0 / f"cam{side}"
        (camera / "data").mkdir(parents=True)
        rows = "".join(f"{ns / 1e9:.6f},{ns}.png\n" if seconds else f"{ns},{ns}.png\n" for ns in times)
        (camera / "data.csv").write_text("#timestamp [ns],filename\n" + rows)
        for number, ns in enumerate(times):
            image = np.random.default_rng(2 * number + side).integers(0, 256, (24, 64), dtype=np.uint8)
            assert cv2.imwrite(str(camera / "data" / f"{ns}.png"), image)
        (camera / "sensor.yaml").write_text(
            "%YAML:1.0\nsensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n"
            f"  data: {T.ravel().tolist()}\nresolution: [64, 24]\ncamera_model: pinhole\n"
            "intrinsics: [50.0, 50.0, 31.0, 12.0] #fu, fv, cu, cv\ndistortion_model: radial-tangential\n"
            "distortion_coefficients: [0.0, 0.0, 0.0, 0.0]\n"
        )
    return mav0


def write_truth(mav0: Path) -> None:
    """A body that goes 1 m/s along the world's y and turns about its z by 90 degrees an image.

    Poses are between the images' times, the first 10 ms before image 0, and end before the last of four.
    """
    rows = []
    for k in range(6):
        ns = START - 10_000_000 + k * STEP // 2
        angle = np.deg2rad(90.0) * (ns - START) / STEP
        rows.append(f"{ns},0,{(ns - START) / 1e9},0,{np.cos(angle / 2)},0,0,{np.sin(angle / 2)},0\n")
    (mav0 / TRUTH).parent.mkdir()
    (mav0 / TRUTH).write_text(HEADER + "\n" + "".join(rows))
