"""A thousand run folders make a table in five seconds."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from fake_runs import FRAMES, make_run, metrics

from bench.config import compose_run
from bench.tables.named.table import FORMATS, make_table

SYSTEMS = ("bgs_slam", "bgs_slam_fast")


@pytest.mark.slow
def test_a_thousand_run_folders_make_a_table_in_five_seconds(tmp_path: Path) -> None:
    """Configs as Hydra composes them, which are three times as long as those of the other tests."""
    made = {
        (system, sequence): compose_run(
            ["dataset=kitti", "dataset.root=/data", f"dataset.sequence={sequence}", f"system={system}"]
        ).values
        for system in SYSTEMS
        for sequence in FRAMES
    }
    count = 0
    for seed in range(84):
        for (system, sequence), config in made.items():
            config["seed"] = seed
            scores = metrics(FRAMES[sequence], psnr_db=20.0 + seed, ate_rmse_m=1.0)
            folder = tmp_path / f"{system}_{sequence}_{seed}"
            if seed == 0:
                make_run(folder, config, scores)
            else:
                _copy(tmp_path / f"{system}_{sequence}_0", folder, seed)
            count += 1
    assert count > 1000
    started = time.perf_counter()
    table = make_table("main_kitti", [tmp_path])
    texts = [table.text(form, tmp_path) for form in FORMATS]
    seconds = time.perf_counter() - started
    assert seconds < 5
    assert len({cell.n for block in table.grid.blocks for line in block for cell in line.cells} - {0}) == 1
    assert all("61.50" in text or "61.5," in text for text in texts)  # the mean of 20 .. 103
    print(f"{count} runs: {seconds:.2f} s")


def _copy(source: Path, target: Path, seed: int) -> None:
    """The same run with another seed."""
    target.mkdir()
    config = (source / "config.yaml").read_text().replace("\nseed: 0\n", f"\nseed: {seed}\n")
    (target / "config.yaml").write_text(config)
    (target / "status.json").write_bytes((source / "status.json").read_bytes())
    scores = (source / "metrics.json").read_text().replace("20.0", f"{20.0 + seed}")
    (target / "metrics.json").write_text(scores)
