"""A thousand run folders, as sweeps leave them."""

from __future__ import annotations

from pathlib import Path

from bench.config import compose_run
from bench.runs.folder import RunFolder

SYSTEMS = ("bgs_slam", "bgs_slam_fast")
FRAMES = {"03": 801, "05": 2761, "06": 1101, "07": 1101, "09": 1591, "10": 1201}
SEEDS = 84


def make_thousand_runs(folder: Path) -> int:
    """1,008 run folders: two systems on six sequences with 84 seeds, PSNR 20 + seed; returns how many.

    Their configs are as Hydra composes them.
    """
    for system in SYSTEMS:
        for sequence, frames in FRAMES.items():
            where = ["dataset=kitti", "dataset.root=/data", f"dataset.sequence={sequence}", f"system={system}"]
            first = _make_run(folder / f"{system}_{sequence}_0", ["protocol=paper", *where], frames)
            texts = {name: (first / name).read_text() for name in ("config.yaml", "status.json", "metrics.json")}
            for seed in range(1, SEEDS):
                other = folder / f"{system}_{sequence}_{seed}"
                other.mkdir()
                of_seed = {
                    "config.yaml": ("\nseed: 0\n", f"\nseed: {seed}\n"),
                    "metrics.json": ("20.0", f"{20.0 + seed}"),
                }
                for name, text in texts.items():
                    (other / name).write_text(text.replace(*of_seed[name]) if name in of_seed else text)
    return SEEDS * len(SYSTEMS) * len(FRAMES)


def _make_run(path: Path, overrides: list[str], frames: int) -> Path:
    folder = RunFolder.create(path, compose_run(overrides).values, "0123456789ab", rerun=False)
    folder.set_status("done", "", frames, frames)
    scores = {
        "protocol": {"name": "paper", "alignment": "se3"},
        "trajectory": {"ate_rmse_m": 1.0},
        "views": {"left": {"n": frames, "psnr_db": 20.0}},
        "frames": {"total": frames, "tracked": frames, "lost": 0},
    }
    folder.write_json("metrics.json", scores)
    return path
