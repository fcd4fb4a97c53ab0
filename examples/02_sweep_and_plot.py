"""How PSNR on views never seen grows with the iterations of mapping: two seeds each, as a plot.

A long sweep is better made by `bgs-bench run -m mapper.iterations=2,4,8 seed=0,1 output=...`, which runs several at
once and resumes; this reads its folder just the same.
"""

import matplotlib.pyplot as plt

import bench

for iterations in (2, 4, 8):
    for seed in (0, 1):
        settings = {"dataset": {"name": "street", "frames": 8, "width": 320, "height": 96}, "protocol.holdout_every": 4}
        bench.run(
            settings | {"mapper.iterations": iterations, "seed": seed},
            output=f"results/examples/sweep/{iterations}_{seed}",
        )

runs = bench.load_runs("results/examples/sweep")
print(runs[["run", "mapper.iterations", "seed", "psnr_db", "heldout_psnr_db", "gaussians"]])

spread = runs.groupby("mapper.iterations")["heldout_psnr_db"].agg(["mean", "std"])
plt.errorbar(spread.index, spread["mean"], yerr=spread["std"], marker="o", capsize=3)
plt.xlabel("mapper.iterations")
plt.ylabel("held-out PSNR [dB], mean ± std of two seeds")
plt.savefig("results/examples/sweep.png", dpi=150)
print("wrote results/examples/sweep.png")
