"""``bgs-bench vocabulary``: what it writes, and what it says to wrong input."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bench.cli import main
from bench.tracking.loops.vocabulary import load

SMALL = ("--frames", "3", "--features", "200", "dataset.frames=3", "dataset.width=320", "dataset.height=96")


def test_npz_from_the_street(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["vocabulary", *SMALL, "--depth", "2", "--branching", "5", "--out", str(tmp_path / "v.npz")]) == 0
    vocabulary = load(tmp_path / "v.npz")
    assert (vocabulary.branching, vocabulary.depth) == (5, 2)
    assert 5 < len(vocabulary) <= 25
    said = capsys.readouterr().out
    assert f"{len(vocabulary)} words" in said
    assert "3 frames of street/0 (npz, branching 5, depth 2)" in said


@pytest.mark.slow
def test_both_formats_hold_the_same_tree(tmp_path: Path) -> None:
    for name in ("v.npz", "v.txt", "w.txt"):
        assert main(["vocabulary", *SMALL, "--depth", "3", "--out", str(tmp_path / name)]) == 0
    text = (tmp_path / "v.txt").read_text()
    assert text == (tmp_path / "w.txt").read_text()
    header, *lines = text.split("\n")
    assert header == "10 3 0 0"
    table = np.array([line.split() for line in lines], dtype=np.float64)
    vocabulary = load(tmp_path / "v.npz")
    np.testing.assert_array_equal(table[:, 0], vocabulary.parent[1:])
    np.testing.assert_array_equal(table[:, 2:34], vocabulary.centroid.view(np.uint8)[1:])


def test_the_default_depth_is_that_of_the_format(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["vocabulary", *SMALL]) == 0
    assert main(["vocabulary", *SMALL, "--format", "dbow2"]) == 0
    assert load(tmp_path / "vocabulary.npz").depth == 4
    assert (tmp_path / "vocabulary.txt").read_text().startswith("10 6 0 0\n")


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["tracker=stereo_orb"], "tracker=stereo_orb: a vocabulary is trained from a data set only; give dataset=..."),
        (["dataset=streat"], "Unknown dataset 'streat'"),
        (["--out", "nowhere/v.npz"], "--out nowhere/v.npz: the folder "),
        (["--seed", "-1"], "--seed -1 is negative; choose 0 or more."),
        ([*SMALL, "--frames", "0"], "A vocabulary can't be trained from 0 frames; give 1 or more."),
        ([*SMALL, "--branching", "1"], "A vocabulary needs branching >= 2 and depth >= 1; got 1 and 4."),
        (
            [*SMALL, "--branching", "5000"],
            "are too few to train a vocabulary with branching 5000; it takes at least 10000. Use more or better",
        ),
    ],
)
def test_wrong_input(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    sentence: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["vocabulary", *arguments]) == 2
    said = capsys.readouterr().err
    assert sentence in said
    assert said.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
