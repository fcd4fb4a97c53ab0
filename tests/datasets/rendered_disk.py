"""Made-up folders of Virtual KITTI 2 and TartanAir: the same drive in both."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

WIDTH, HEIGHT = 64, 24
BASELINE = 0.532725
COUNT = 3
EXTRINSIC = "frame cameraID r1,1 r1,2 r1,3 t1 r2,1 r2,2 r2,3 t2 r3,1 r3,2 r3,3 t3 0 0 0 1"
# A camera that goes 2 m ahead a frame, and in the last one has turned by 90 degrees to the right, where it stands.
RIGHT_TURN = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])  # its axes in the world's: ahead is x, right is -z
CENTRES = np.array([[0.0, 0, 0], [0, 0, 2], [0, 0, 4]])


def depth_cm() -> np.ndarray:
    depth = np.full((HEIGHT, WIDTH), 1234, np.uint16)
    depth[:8] = 65535
    return depth


def picture(number: int, side: int) -> np.ndarray:
    """One colour each, which JPEG keeps nearly: red grows with the frame, blue is of the right camera."""
    return np.full((HEIGHT, WIDTH, 3), (200 * side, 20, 40 + 60 * number), np.uint8)  # BGR


def save(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image)


def write_vkitti2(root: Path) -> Path:
    folder = root / "Scene02" / "rain"
    extrinsic, intrinsic = [EXTRINSIC], ["frame cameraID K[0,0] K[1,1] K[0,2] K[1,2]"]
    for number in range(COUNT):
        R = RIGHT_TURN if number == 2 else np.eye(3)
        for side in range(2):
            frames, name = folder / "frames", f"{number:05d}"
            save(frames / "rgb" / f"Camera_{side}" / f"rgb_{name}.jpg", picture(number, side))
            save(frames / "depth" / f"Camera_{side}" / f"depth_{name}.png", depth_cm())
            classes = np.full((HEIGHT, WIDTH, 3), (100, 60, 100), np.uint8)
            classes[:8] = (255, 200, 90)  # the sky, BGR
            save(frames / "classSegmentation" / f"Camera_{side}" / f"classgt_{name}.png", classes)
            centre = CENTRES[number] + R @ [BASELINE * side, 0, 0]
            world_to_camera = np.column_stack([R.T, -R.T @ centre])
            extrinsic.append(f"{number} {side} {' '.join(f'{x:.9g}' for x in world_to_camera.ravel())} 0 0 0 1")
            intrinsic.append(f"{number} {side} 37.5 37.25 31.5 12.5")
    (folder / "extrinsic.txt").write_text("\n".join(extrinsic) + "\n")
    (folder / "intrinsic.txt").write_text("\n".join(intrinsic) + "\n")
    return folder


V2 = "V2"
LAYOUTS = {
    "v1": ("image_left", "image_right", "depth_left", "pose_left.txt", "left", "right"),
    "V2": (
        "image_lcam_front",
        "image_rcam_front",
        "depth_lcam_front",
        "pose_lcam_front.txt",
        "lcam_front",
        "rcam_front",
    ),
}


def write_tartanair(root: Path, version: str = "v1") -> Path:
    """In NED the camera goes 2 m along its x a frame, from a place of the world where it looks east and is tilted."""
    folder = root / "hospital" / "Easy" / "P001"
    left, right, depth, poses, *behind = LAYOUTS[version]
    lines = []
    for number in range(COUNT):
        for side, name in enumerate((left, right)):
            save(folder / name / f"{number:06d}_{behind[side]}.png", picture(number, side))
        values = np.full((HEIGHT, WIDTH), 12.34, np.float32)
        values[:8] = 1e4
        (folder / depth).mkdir(exist_ok=True)
        if version == V2:
            save(folder / depth / f"{number:06d}_lcam_front_depth.png", values.view(np.uint8).reshape(HEIGHT, WIDTH, 4))
        else:
            np.save(folder / depth / f"{number:06d}_left_depth.npy", values)
        # First frame: turned by 90 degrees about z (down), from north to east: quaternion 0 0 sin 45 cos 45. Last: by
        # another 90 to the right, so it looks south: 0 0 1 0.
        half = np.sqrt(0.5)
        quaternion = (0, 0, 1, 0) if number == 2 else (0, 0, half, half)
        lines.append(" ".join(map(str, (5.0, -3.0 + 2 * number, 1.5, *quaternion))))
    (folder / poses).write_text("\n".join(lines) + "\n")
    return folder
