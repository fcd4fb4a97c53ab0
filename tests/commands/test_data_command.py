"""``bgs-bench data``: what the user reads, and the way from a server to a data set that is read."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path, PurePath

import pytest

from bench import registry
from bench.cli import main
from bench.config import compose_run
from tests.data.test_fetch import archive_of
from tests.datasets.kitti_disk import write_kitti
from tests.weights.cutting_server import CuttingServer, serving


@pytest.fixture(autouse=True)
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("BGS_DATA", str(tmp_path / "data"))
    return tmp_path / "data"


@pytest.fixture
def server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[CuttingServer]:
    """One that has KITTI's calibration, poses and colour images of a made-up sequence 04."""
    published = tmp_path / "published"
    write_kitti(published)
    files = {str(file.relative_to(published)): file.read_bytes() for file in published.rglob("*") if file.is_file()}
    of_archive = {"calib": "sequences/04/*.txt", "poses": "poses/*.txt", "color": "image_[23]/*.png"}
    with serving(b"") as running:
        for what, pattern in of_archive.items():
            inside = {name: content for name, content in files.items() if PurePath(name).match(pattern)}
            running.files[f"data_odometry_{what}.zip"] = archive_of(inside)
        monkeypatch.setenv("BGS_DATA_MIRROR", running.url.rpartition("/")[0])
        yield running


def test_from_a_server_to_a_data_set_that_is_read(
    server: CuttingServer, root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    server.cuts = [10**6, 10**6, 5000]  # the colour images come in two pieces
    assert main(["data", "get", "kitti", "--sequence", "04"]) == 0
    told = capsys.readouterr().out
    assert "kitti: licence CC BY-NC-SA 3.0; see https://www.cvlibs.net/" in told
    assert f"data_odometry_color.zip: from {server.url.rpartition('/')[0]}/data_odometry_color.zip\n" in told
    assert server.asked[-1] == "bytes=5000-"
    # dataset.root is that folder by default, and is stored with the run.
    config = compose_run(["dataset=kitti", "dataset.sequence=04"]).plugin("dataset")
    assert getattr(config, "root") == str(root / "kitti_odometry")  # noqa: B009
    assert len(registry.build(config, "dataset")) == 4
    asked = len(server.asked)
    assert main(["data", "get", "kitti", "--sequence", "04"]) == 0
    assert capsys.readouterr().out.count(": is here") == 3
    assert len(server.asked) == asked
    assert main(["data", "check"]) == 0
    assert "kitti 04 color: frames 0 to 3, 64x24, 4 poses: good" in capsys.readouterr().out
    (root / "kitti_odometry" / "poses" / "04.txt").write_text("1 2 3\n")
    pictures = tmp_path / "pictures"
    assert main(["data", "check", str(root / "kitti_odometry"), "--pictures", str(pictures)]) == 1
    told = capsys.readouterr().out
    assert "kitti 04 color: can't be read: NOT whole\n    wrong: " in told
    assert main(["data", "list"]) == 0
    told = capsys.readouterr().out
    assert f"here: {root / 'kitti_odometry'}\n    `bgs-bench data get kitti`; page: https://www.cvlibs.net" in told
    assert "    fetched: data_odometry_calib.zip\n" in told
    assert "    fetched: data_odometry_color.zip, of it 04\n" in told


def test_a_wrong_sum_is_exit_code_2_and_leaves_nothing(
    server: CuttingServer, root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sums = tmp_path / "SHA256SUMS"
    sums.write_text(f"{'0' * 64}  data_odometry_calib.zip\n")
    assert main(["data", "get", "kitti", "--sequence", "04", "--sums", str(sums)]) == 2
    assert "which should begin with 0000" in capsys.readouterr().err
    assert [file for file in root.rglob("*") if file.is_file() and file.suffix != ".lock"] == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["get", "tartanair"], r"tartanair can't be fetched by a program. From https://"),
        (["get", "kiti"], r"There is no data set called 'kiti'"),
        (["get", "kitti", "--sequence", "6"], r"kitti has no sequence '6'"),
        (["get", "kitti", "--mirror", "here"], r"The mirror here is no address"),
        (["check"], r"data holds no data set yet"),
        (["check", "a", "b"], r"Give one folder, or dataset=NAME"),
        (["make", "street", "dataset=kitti"], r"leave dataset= out"),
    ],
)  # fmt: skip
def test_wrong_words(arguments: list[str], message: str, root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["data", *arguments]) == 2
    assert message in capsys.readouterr().err
    assert not root.exists() or not any(file.suffix != ".lock" for file in root.rglob("*") if file.is_file())


def test_make_writes_a_sequence_that_is_whole(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["data", "make", "street", "dataset.frames=2", "dataset.width=160", "dataset.height=64"]) == 0
    made = capsys.readouterr().out
    assert f"Run: bgs-bench run dataset=kitti dataset.root={root / 'street_kitti'} dataset.sequence=00" in made
    assert main(["data", "check", str(root / "street_kitti")]) == 0
    assert "kitti 00 color: frames 0 to 1, 160x64, 2 poses: good" in capsys.readouterr().out
    assert main(["data", "check", "dataset=street", "dataset.frames=2", "dataset.width=160", "dataset.height=64"]) == 0
    assert ": frames 0 to 1, 160x64, 2 poses: good" in capsys.readouterr().out
