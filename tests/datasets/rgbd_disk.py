"""A sequence in TUM's layout and a room in Replica's, made up, as they lie on a disk."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

WIDTH, HEIGHT = 16, 12
OWN = {"fx": 20.0, "fy": 21.0, "cx": 7.5, "cy": 5.0}
COLOR = np.random.default_rng(0).integers(0, 256, (3, HEIGHT, WIDTH, 3), dtype=np.uint8)
STORED = np.random.default_rng(1).integers(4000, 20000, (3, HEIGHT, WIDTH)).astype(np.uint16)
STORED[:, 2, 3] = 0


def write(path: Path, pixels: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), pixels[..., ::-1] if pixels.ndim == 3 else pixels)


def tum(root: Path) -> Path:
    """Colour at 10, 10.1 and 10.2 s, depth a little later but for the second; poses at 100 Hz, one metre a second."""
    folder = root / "rgbd_dataset_handheld"
    lists: dict[str, list[str]] = {"rgb": [], "depth": []}
    for k, (color, depth) in enumerate([(10.0, 10.015), (10.1, 10.13), (10.2, 10.19)]):
        for kind, time, pixels in (("rgb", color, COLOR[k]), ("depth", depth, STORED[k])):
            write(folder / kind / f"{time:.3f}.png", pixels)
            lists[kind].append(f"{time:.3f} {kind}/{time:.3f}.png\n")
    for kind, lines in lists.items():
        (folder / f"{kind}.txt").write_text("# made up\n" + "".join(lines))
    times = np.arange(10.005, 10.25, 0.01)
    (folder / "groundtruth.txt").write_text("".join(f"{t:.3f} {t - 10:.3f} 0 0 0 0 0 1\n" for t in times))
    return folder


def replica(root: Path) -> Path:
    folder = root / "office7"
    for k in range(3):
        write(folder / "results" / f"frame{k:06d}.jpg", COLOR[k])
        write(folder / "results" / f"depth{k:06d}.png", STORED[k])
    rows = [f"1 0 0 {k} 0 1 0 0 0 0 1 0.5 0 0 0 1\n" for k in range(3)]
    (folder / "traj.txt").write_text("".join(rows))
    return folder
