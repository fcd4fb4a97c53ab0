"""Run BGS-SLAM on eight frames of the built-in street, score it, and look at the numbers."""

import json

import bench

# What is not said here is as in conf/config.yaml; `bgs-bench list KIND NAME` shows the settings of a part.
folder = bench.run(
    {"dataset": {"name": "street", "frames": 8, "width": 320, "height": 96}, "protocol.holdout_every": 4},
    output="results/examples/first",
    progress=True,
)

metrics = json.loads((folder / "metrics.json").read_text())
print(f"ATE {metrics['trajectory']['ate_rmse_m']:.3f} m")
for group in ("train", "heldout", "right"):
    print(f"PSNR of the {group} views: {metrics['views'][group]['psnr_db']:.2f} dB")
print(f"everything else is in {folder}")
