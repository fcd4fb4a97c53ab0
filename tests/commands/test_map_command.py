"""``bgs-bench map``: a saved map is opened again, and shows what its run showed."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest

from bench.cli import main

Finished = tuple[Path, subprocess.CompletedProcess[str]]


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_frame_of_the_saved_map_is_that_of_the_run(finished_run: Finished, tmp_path: Path, side: str) -> None:
    run, out = finished_run[0], tmp_path / "view.png"
    right = ["--right"] if side == "right" else []
    assert main(["map", str(run), "--view", "2", *right, "--out", str(out)]) == 0
    saved = cv2.imread(str(run / f"views/{side}/color/000002.png"))
    again = cv2.imread(str(out))
    assert saved.std() > 10
    assert np.abs(saved.astype(int) - again.astype(int)).max() <= 1


def test_numbers_of_a_map(finished_run: Finished, capsys: pytest.CaptureFixture[str]) -> None:
    content = (finished_run[0] / "map.ply").read_bytes()
    count = int(content.split(b"element vertex ")[1].split()[0])
    opacity = np.frombuffer(content.partition(b"end_header\n")[2], "<f4").reshape(count, 17)[:, 9]
    for source in (finished_run[0], finished_run[0] / "map.ply"):
        assert main(["map", str(source)]) == 0
        printed = capsys.readouterr().out
        assert f"map.ply: {count} Gaussians, spherical harmonics of degree 0" in printed
        row = next(line.split() for line in printed.splitlines() if line.split()[:1] == ["opacity"])
        assert float(row[4]) == pytest.approx(np.median(1 / (1 + np.exp(-opacity))), rel=1e-2)
        assert float(row[-1]) == pytest.approx(1 / (1 + np.exp(-opacity.max())), rel=1e-3)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["RUN", "--view", "99", "--out", "OUT.png"], "has no pose of frame 99; it has those of frames 0 to 3"),
        (["RUN", "--view", "2"], "wants both --view FRAME and --out FILE.png"),
        (["RUN", "--right"], "wants both --view FRAME and --out FILE.png"),
        (["RUN", "--view", "2", "--out", "OUT.jpg"], "must end in .png"),
        (["RUN/map.ply", "--view", "2", "--out", "OUT.png"], "give its run folder"),
        (["RUN/frames.csv"], "no PLY file, or damaged"),
        (["OUT.ply"], "There is no map"),
    ],
)
def test_what_can_not_be_shown(
    finished_run: Finished, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], text: str
) -> None:
    places = {"RUN": str(finished_run[0]), "OUT": str(tmp_path / "out")}
    for name, place in places.items():
        arguments = [argument.replace(name, place) for argument in arguments]
    assert main(["map", *arguments]) == 2
    assert text in capsys.readouterr().err


def test_a_run_whose_mapper_saves_none(
    finished_run: Finished, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = shutil.copytree(finished_run[0], tmp_path / "run")
    config = (run / "config.yaml").read_text()
    (run / "config.yaml").write_text(config.replace("name: gaussian", "name: none"))
    assert main(["map", str(run)]) == 2
    assert "has no map: its mapper (none) saves none" in capsys.readouterr().err
