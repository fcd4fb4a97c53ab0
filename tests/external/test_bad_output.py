"""Output that can't be scored, and wrong arguments: one sentence, exit code 2, and nothing written."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from bench.cli import main
from tests.external.foreign_case import COUNT, curve, dataset, refusal, score, write_poses, write_renders

NUMBERS = np.arange(COUNT)
pytestmark = pytest.mark.usefixtures("no_plot")


def damage(folder: Path, how: str) -> tuple[str, ...]:
    """Spoil a folder; returns further arguments."""
    renders = folder / "eval" / "rendered_rgb"
    picture = renders / "gs_0003.png"
    if how == "truncated":
        picture.write_bytes(picture.read_bytes()[:200])
    elif how == "garbled":
        content = bytearray(picture.read_bytes())
        content[60:400] = bytes(340)
        picture.write_bytes(bytes(content))
    elif how == "small":
        assert cv2.imwrite(str(picture), np.zeros((20, 30, 3), np.uint8))
    elif how == "no image":
        picture.write_text("hello")
    elif how == "twice":
        write_renders(renders, [3], name="again_{}.png")
    elif how == "beyond":
        write_renders(renders, [COUNT])
    elif how == "two folders":
        write_renders(folder / "renders", [0])
    elif how == "two trajectories":
        write_poses(folder / "other.txt", curve(NUMBERS))
    elif how == "longer":
        write_poses(folder / "est.txt", curve(np.arange(COUNT + 3)))
    elif how == "nan":
        (folder / "est.txt").write_text("nan 0 0 0 0 1 0 0 0 0 1 0\n")
        return ("--trajectory", "est.txt")
    elif how == "link":
        outside = folder.parent / "outside.png"
        picture.rename(outside)
        picture.symlink_to(outside)
    elif how == "small depth":
        np.save(folder / "depth" / "000000.npy", np.ones((4, 5), np.float32))
        (folder / "depth" / "000000.png").unlink()
    elif how == "pickled depth":
        np.save(folder / "depth" / "000000.npy", np.array([{}], dtype=object), allow_pickle=True)
        (folder / "depth" / "000000.png").unlink()
    elif how == "settings":
        (folder / "score.yaml").write_text("depth_scal: 1000\n")
    elif how == "yaml":
        (folder / "score.yaml").write_text("!!python/object/apply:os.system ['true']\n")
    elif how == "type":
        (folder / "score.yaml").write_text("depth_scale: much\n")
    return ()


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ("truncated", "gs_0003.png is truncated"),
        ("garbled", "gs_0003.png is damaged (a checksum in it is wrong)"),
        ("small", "gs_0003.png is 30x20 pixels, the data set's images 56x40. Render at the data set's size"),
        ("no image", "gs_0003.png is not a PNG or JPEG image"),
        ("twice", "both have the number 3. Keep one of them"),
        ("beyond", "rendered_rgb: number 8 is beyond the data set's 8 frames (0 to 7)"),
        ("two folders", "several folders that fit --renders: eval/rendered_rgb, renders. Name one"),
        ("two trajectories", "holds 2 files that may be the trajectory: est.txt, other.txt. Say --trajectory FILE"),
        ("longer", "est.txt has 11 poses, more than the data set's 8 frames (0 to 7)"),
        ("nan", "est.txt holds no pose: each of its 1 lines is NaN"),
        ("link", "gs_0003.png leads out of the folder"),
        ("small depth", "000000.npy has shape (4, 5)"),
        ("pickled depth", "000000.npy can't be read as a NumPy array"),
        ("settings", "there is no setting 'depth_scal'; there are name, trajectory"),
        ("yaml", "score.yaml can't be read: could not determine a constructor"),
        ("type", "depth_scale must be a number, and is 'much'"),
    ],
)
def test_bad_output_is_one_sentence_and_writes_nothing(
    folder: Path, output: Path, capfd: pytest.CaptureFixture[str], how: str, message: str
) -> None:
    more = damage(folder, how)
    assert message in refusal(capfd, folder, output, *more)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (("stereo=sgbm",), "stereo=sgbm: another system's output has no stereo of ours"),
        (("--trajectory", "no.txt"), "no.txt does not exist"),
        (("--renders", "no"), "there is no folder"),
        (("--depth", "../runs"), "leads out of the folder"),
        (("dataset.cont=3",), "dataset has no setting 'cont'"),
        (("evaluator=[psnr]",), "Unknown evaluator 'psnr'"),
        (("--plot", "x.png"), "--plot goes with two files"),
        (("other",), "One folder with a system's output is needed, and 2 are given"),
        (("--depth-scale", "-1"), "depth_scale=-1.0 must be a number above 0"),
        (("--name", ""), "The system has no name. Say --name NAME"),
        (("--numbers", "position", "dataset.count=3"), "est.txt has 8 poses, more than the data set's 3 frames"),
    ],
)
def test_bad_arguments(
    folder: Path, output: Path, capfd: pytest.CaptureFixture[str], more: tuple[str, ...], message: str
) -> None:
    assert message in refusal(capfd, folder, output, *more)


def test_folders_that_are_no_output_and_places_that_are_taken(
    folder: Path, output: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    assert "empty holds nothing to score" in refusal(capfd, empty, output)
    assert "There is no folder" in refusal(capfd, tmp_path / "nowhere", output)
    score(folder, output)
    capfd.readouterr()
    assert f"`bgs-bench evaluate {output}` scores it again" in refusal(capfd, output, tmp_path / "runs" / "b")
    assert "holds another run (it differs in foreign.name" in refusal(capfd, folder, output, "--name", "Else")
    (tmp_path / "runs" / "taken").mkdir()
    (tmp_path / "runs" / "taken" / "thesis.tex").write_text("mine")
    assert "is not empty and holds no run" in refusal(capfd, folder, tmp_path / "runs" / "taken")
    assert "is a file" in refusal(capfd, folder, tmp_path / "runs" / "taken" / "thesis.tex")
    assert "lies in the folder that is scored" in refusal(capfd, folder, folder / "run")


def test_the_data_set_must_be_said(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["score", str(folder), "--name", "Theirs"]) == 2
    assert "Say on which data set the system was run" in capfd.readouterr().err
    assert dataset().label == "case"
