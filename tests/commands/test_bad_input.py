"""Wrong input through the command line: one line that says what, where and what to do, exit code 2, nothing written."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import TINY, bgs_bench

from bench.cli import main
from tests.datasets.kitti_disk import write_image, write_kitti

Damage = Callable[[Path, Path], object]


def cut(path: Path, size: int) -> None:
    path.write_bytes(path.read_bytes()[:size])


def without_line(path: Path, start: str) -> None:
    path.write_text("".join(line for line in path.read_text().splitlines(True) if not line.startswith(start)))


def last_line_off(path: Path) -> None:
    path.write_text("".join(path.read_text().splitlines(True)[:-1]))


BAD_KITTI: dict[str, tuple[Damage, list[str], str]] = {
    "missing root": (lambda r, f: None, ["dataset.root=/not/there"], r"/not/there.* does not exist"),
    "root not given": (
        lambda r, f: None,
        ["dataset.root=''"],
        r"/kitti_odometry: this folder does not .*data get kitti`",
    ),
    "no such sequence": (
        lambda r, f: None,
        ["dataset.sequence=17"],
        r"sequence=17 does not exist .* holds 04",
    ),
    "image missing": (lambda r, f: (f / "image_2/000002.png").unlink(), [], r"rame 2 is missing in .*image_2"),
    "image truncated": (lambda r, f: cut(f / "image_2/000001.png", 500), [], r"image_2/000001\.png is truncated"),
    "image empty": (lambda r, f: cut(f / "image_2/000001.png", 0), [], r"image_2/000001\.png is "),
    "another size": (
        lambda r, f: write_image(f / "image_3/000002.png", 1, width=60),
        [],
        r"image_3/000002\.png is 60x24 pixels, but .* is 64x24",
    ),
    "right fewer": (lambda r, f: (f / "image_3/000003.png").unlink(), [], r"image_3 lacks frame 3"),
    "no P": (lambda r, f: without_line(f / "calib.txt", "P3:"), [], r"calib\.txt.* has no line 'P3:'"),
    "no Tr": (lambda r, f: without_line(f / "calib.txt", "Tr:"), [], r"calib\.txt.* has no line 'Tr:'"),
    "few poses": (lambda r, f: last_line_off(r / "poses/04.txt"), [], r"04\.txt has 3 poses, too few for frame 3"),
    "empty scan": (lambda r, f: cut(f / "velodyne/000001.bin", 0), [], r"velodyne/000001\.bin is empty"),
    "short scan": (lambda r, f: cut(f / "velodyne/000002.bin", 20), [], r"velodyne/000002\.bin has 20 bytes"),
    "unknown plugin": (lambda r, f: None, ["stereo=sgmb"], r"Unknown stereo 'sgmb'.*Did you mean 'sgbm'"),
    "unknown setting": (
        lambda r, f: None,
        ["stereo.blocksize=5"],
        r"no setting 'blocksize'.*Did you mean 'block_size'",
    ),
    "ill-typed setting": (lambda r, f: None, ["stereo.block_size=big"], r"'big' .*Integer"),
    "ill-typed seed": (lambda r, f: None, ["seed=1.5"], r"seed=1\.5: .*Integer"),
}


@pytest.mark.parametrize("case", BAD_KITTI)
def test_one_line_exit_code_2_and_nothing_written(
    case: str, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    damage, overrides, message = BAD_KITTI[case]
    root, output = tmp_path / "kitti", tmp_path / "run"
    damage(root, write_kitti(root))
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    given = [f"dataset.root={root}", "dataset.sequence=04", *overrides]
    # A setting that is given twice is an error of its own; the case's comes last and alone.
    last = {override.partition("=")[0]: override for override in given}.values()
    assert main(["run", "dataset=kitti", *last, "tracker=groundtruth", f"output={output}"]) == 2
    out, error = capfd.readouterr()
    assert error.startswith("bgs-bench: ")
    assert error.count("\n") == 1
    assert re.search(message, error), error
    assert "Traceback" not in out + error
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("make", ["file", "below a file", "another's folder"])
def test_output_that_can_not_be_used(make: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("mine")
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "thesis.tex").write_text("mine")
    output = {"file": "file", "below a file": "file/run", "another's folder": "folder"}[make]
    before = sorted(tmp_path.rglob("*"))
    assert main(["run", *TINY, f"output={tmp_path / output}"]) == 2
    error = capfd.readouterr().err
    assert re.fullmatch(r"bgs-bench: .*output=.*\n", error), error
    assert sorted(tmp_path.rglob("*")) == before
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.skipif(sys.platform != "linux", reason="/proc is Linux's")
def test_output_that_is_not_writable(capfd: pytest.CaptureFixture[str]) -> None:
    """A place where even the superuser may not make folders."""
    assert main(["run", *TINY, "output=/proc/run"]) == 2
    assert capfd.readouterr().err.startswith("bgs-bench: Can't make the run folder /proc/run: ")


@pytest.mark.slow
def test_from_a_fresh_process(tmp_path: Path) -> None:
    process = bgs_bench("run", "dataset=kitti", "dataset.root=nowhere", "dataset.sequence=04", cwd=tmp_path)
    assert process.returncode == 2
    assert re.fullmatch(r"bgs-bench: .*nowhere.*\n", process.stderr), process.stderr
    assert process.stdout.strip() == ""
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "-m", "seed=0,x"], r"seed=x: Value 'x'"),
        (["run", "-m", "seed=0,1", "stereo.blocksize=3"], r"no setting 'blocksize'"),
        (["run", "-m", "stereo=sgbm,sgmb"], r"Unknown stereo 'sgmb'"),
        (["run", "-m", *TINY, "seed=0,1", "output=file/sweep"], r"Can't make the folder .*sweep"),
        (["list", "sterio"], r"kind='sterio' is not one of .*Did you mean 'stereo'"),
        (["evaluate", "nowhere"], r"There is no run folder nowhere"),
        (["table", "nowhere"], r"There is no folder and no table nowhere; the tables are ablation"),
    ],
)
def test_other_commands_and_sweeps(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    assert main(arguments) == 2
    out, error = capfd.readouterr()
    assert re.fullmatch(rf"bgs-bench: .*{message}.*\n", error), error
    assert "Traceback" not in out
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_an_image_that_only_decoding_finds_damaged(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Header and end are in order, so the run starts; it ends in that frame, names the file, keeps what was done."""
    folder = write_kitti(tmp_path / "kitti")
    path = folder / "image_2" / "000002.png"
    data = bytearray(path.read_bytes())
    at = data.index(b"IDAT") + 4
    data[at : at + 400] = bytes(400)
    path.write_bytes(bytes(data))
    output = tmp_path / "run"
    given = [f"dataset.root={tmp_path / 'kitti'}", "dataset.sequence=04", "tracker=groundtruth", "stereo=lidar"]
    assert main(["run", "dataset=kitti", *given, "mapper.iterations=2", f"output={output}"]) == 2
    error = capfd.readouterr().err
    # (libpng itself prints a line of its own before ours.)
    assert re.fullmatch(r"bgs-bench: .*image_2/000002\.png is damaged.*", error.splitlines()[-1]), error
    status = json.loads((output / "status.json").read_text())
    assert (status["state"], status["frames_done"]) == ("failed", 2)
    assert "000002.png is damaged" in status["reason"]
    assert len((output / "trajectory_kitti.txt").read_text().splitlines()) == 2
