"""Run folders with known numbers, as `bgs-bench run` would leave them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bench.runs.folder import RunFolder

ALL_TERMS = ("rgb", "ssim", "geo", "normal", "smooth")
FRAMES = {"03": 801, "05": 2761, "06": 1101, "07": 1101, "09": 1591, "10": 1201}


def config(
    sequence: str = "06",
    system: str = "bgs_slam_paper",
    seed: int = 0,
    losses: tuple[str, ...] = ALL_TERMS,
    stereo: str = "sgbm",
    sky: str = "horizon",
    **settings: Any,
) -> dict[str, Any]:
    """A resolved config; ``settings`` by dotted name with ``__`` for the dot (``mapper__iterations=3``)."""
    made: dict[str, Any] = {
        "system": system,
        "seed": seed,
        "output": f"/somewhere/{sequence}/{seed}",
        "protocol": {"name": "paper", "alignment": "se3"},
        "dataset": {"name": "kitti", "root": "/data", "sequence": sequence, "frames": ""},
        "stereo": {"name": stereo},
        "sky": {"name": sky},
        "tracker": {"name": "stereo_orb"},
        "mapper": {"name": "gaussian", "iterations": 60},
        "loss": {name: {"name": name, "weight": 1.0} for name in losses},
        "evaluator": {"ate": {"name": "ate"}},
    }
    if "geo" in losses:
        made["loss"]["geo"] |= {"stride": 2, "edge_weighted": True}
    for name, value in settings.items():
        *parts, last = name.split("__")
        place = made
        for part in parts:
            place = place[part]
        place[last] = value
    return made


def metrics(frames: int, **values: float | None) -> dict[str, Any]:
    """A ``metrics.json`` with these values of the left views, the trajectory or the resources."""
    in_trajectory = {key: value for key, value in values.items() if key.endswith("_m")}
    in_resources = {key: value for key, value in values.items() if key.endswith(("_gb", "_per_frame"))}
    in_views = {key: v for key, v in values.items() if key not in in_trajectory and key not in in_resources}
    return {
        "protocol": {"name": "paper", "alignment": "se3"},
        "trajectory": in_trajectory,
        "views": {"left": {"n": frames, **in_views}},
        "resources": in_resources,
        "frames": {"total": frames, "tracked": frames, "lost": 0},
    }


def make_run(
    path: Path,
    made: dict[str, Any],
    scores: dict[str, Any] | None,
    state: str = "done",
    frames: int | None = None,
    reason: str = "",
) -> Path:
    """Write the folder; ``frames`` done default to the whole sequence. Without ``scores`` it was never scored."""
    total = FRAMES[made["dataset"]["sequence"]]
    folder = RunFolder.create(path, made, "0123456789ab", rerun=False)
    folder.set_status(state, reason, total if frames is None else frames, total)
    if scores is not None:
        folder.write_json("metrics.json", scores)
    return path


def make_mixed_runs(folder: Path) -> Path:
    """Runs with all that a table can show, and words that formats have to escape."""
    for seed in (0, 1):
        made = config("03", "bgs_slam", seed)
        scores = metrics(801, psnr_db=20.0 + seed, ate_rmse_m=1, wall_s_per_frame=1)
        scores["dialects"] = {"mono_gs": {"n_views": 3, "psnr_db": 30.0 + seed, "stamp": {"mask": "a & b, 50 %"}}}
        make_run(folder / f"a_{seed}", made, scores)
    make_run(folder / "b", config("05"), None, state="out_of_memory", frames=1, reason="a < b | 50 % & $x_1^2 {~}\\")
    make_run(folder / "c", config("06"), metrics(300, psnr_db=9.0), frames=300)
    return folder
