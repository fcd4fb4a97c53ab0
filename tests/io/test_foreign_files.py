"""Files of strangers: opened only where they are plain files of a plausible size, and what they claim is checked."""

from __future__ import annotations

import json
import os
import tarfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from bench.errors import BenchError
from bench.external.poses import read_written_poses
from bench.external.search import search
from bench.external.settings import ScoreSettings, read_settings
from bench.gaussians.ply import read_ply
from bench.io.foreign import read_plain, reading
from bench.io.images import image_size, read_rgb
from bench.io.json_files import load_json
from bench.io.torch_files import load_tensors
from bench.io.yaml_files import parse_yaml
from bench.plain_text import plain_line
from bench.runs.status import read_json, read_status
from bench.stereo.checkpoint import load_state

POSES = np.tile(np.eye(4), (3, 1, 1))


def test_only_plain_files_of_a_plausible_size_are_opened(tmp_path: Path) -> None:
    """Opening the pipe would wait for its writer for ever."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "large").write_bytes(bytes(2000))
    (tmp_path / "link").symlink_to(tmp_path / "large")
    for name, why in (("pipe", "a named pipe"), (".", "a folder"), ("/dev/zero", "a device")):
        with pytest.raises(BenchError, match=f"is {why} and no plain file"):
            read_plain(tmp_path / name, 1e6)
    with pytest.raises(BenchError, match="are not plausible"):
        read_plain(tmp_path / "large", 1000)
    assert read_plain(tmp_path / "link", 2000) == bytes(2000)


@pytest.mark.parametrize("error", [RecursionError("deep"), MemoryError(), KeyError(3), ArithmeticError("a\nb" * 9000)])
def test_every_exception_of_a_reader_is_one_short_line(error: Exception) -> None:
    with pytest.raises(BenchError) as raised, reading(Path("a.csv"), "is damaged", "Write it again."):
        raise error
    assert str(raised.value).startswith("a.csv is damaged: ")
    assert str(raised.value).endswith(". Write it again.")
    assert len(str(raised.value)) < 600
    assert "\n" not in str(raised.value)


READERS: dict[str, Callable[[Path], object]] = {
    "est.txt": read_written_poses,
    "est.npy": read_written_poses,
    "params.npz": read_written_poses,
    "trj_final.json": read_written_poses,
    "estimated_c2w.ckpt": read_written_poses,
    "net.pth": load_state,
    "map.ply": read_ply,
    "left.png": image_size,
    "right.png": lambda path: read_rgb(path, (8, 8)),
}


@pytest.mark.parametrize("name", READERS)
def test_no_reader_waits_for_a_pipe(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    with pytest.raises(BenchError, match="is a named pipe and no plain file"):
        READERS[name](tmp_path / name)


def test_the_search_opens_no_pipe_no_endless_line_and_nothing_outside(tmp_path: Path) -> None:
    folder = tmp_path / "theirs"
    folder.mkdir()
    os.mkfifo(folder / "a.txt")
    os.mkfifo(folder / "b.npy")
    (folder / "endless.txt").write_bytes(b"1 " * 100_000)
    (tmp_path / "secret.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n")
    (folder / "c.txt").symlink_to(tmp_path / "secret.txt")
    (folder / "d.txt").symlink_to("/dev/zero")
    found = search(folder, ScoreSettings())
    assert found.trajectory is None
    assert [link.name for link in found.outside] == ["c.txt", "d.txt"]
    # A link to a file in the folder is as good as the file.
    (folder / "results").mkdir()
    (folder / "results" / "est").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n")
    (folder / "e.txt").symlink_to(folder / "results" / "est")
    assert search(folder, ScoreSettings()).trajectory == folder / "e.txt"


def npy_that_claims(shape: str) -> bytes:
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}}}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode()


def test_arrays_are_no_larger_than_their_files(tmp_path: Path) -> None:
    for number, shape in enumerate(["(1000000000000, 4, 4)", "(-3, 4, 4)", "(3, 4, 4)", "(1e9, 4, 4)"]):
        path = tmp_path / f"{number}.npy"
        path.write_bytes(npy_that_claims(shape))
        with pytest.raises(BenchError, match="without pickled objects"):
            read_written_poses(path)
    with zipfile.ZipFile(tmp_path / "poses.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("poses.npy", npy_that_claims("(1000000000, 4, 4)") + bytes(10**6))
    with pytest.raises(BenchError, match="shorter than its header says"):
        read_written_poses(tmp_path / "poses.npz")


def test_nothing_is_unpacked_to_look_at_a_shape(tmp_path: Path) -> None:
    """A gigabyte of zeros beside the poses, in a megabyte: reading it takes seconds, and a gigabyte."""
    path = tmp_path / "poses.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        with archive.open("means.npy", "w") as member:
            member.write(npy_that_claims("(8000000,)"))
            for _ in range(64):
                member.write(bytes(10**6))
        with archive.open("w2c.npy", "w") as member:
            np.save(member, POSES)
    content = bytearray(path.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 100] = bytes(range(100))  # whoever unpacks it falls over this
    path.write_bytes(bytes(content))
    assert np.array_equal(read_written_poses(path).T, POSES)


@pytest.mark.parametrize(
    "make",
    [
        lambda: torch.tensor(POSES, requires_grad=True),
        lambda: torch.nn.Parameter(torch.tensor(POSES, dtype=torch.float32)),
        lambda: torch.tensor(POSES, dtype=torch.bfloat16),
        lambda: list(torch.tensor(POSES).requires_grad_()),
        lambda: {"estimate_c2w_list": torch.tensor(POSES, requires_grad=True), "idx": torch.tensor(2)},
        lambda: {"estimate_c2w_list": list(torch.tensor(POSES)), "idx": 2, "keyframe_list": [0]},
    ],
)
def test_poses_that_were_being_learned_are_read(tmp_path: Path, make: Callable[[], object]) -> None:
    torch.save(make(), tmp_path / "estimated_c2w.ckpt")
    flipped = np.diag([1.0, -1.0, -1.0, 1.0]) if isinstance(make(), dict) else np.eye(4)
    assert read_written_poses(tmp_path / "estimated_c2w.ckpt").camera_to_world() == pytest.approx(POSES @ flipped)


@pytest.mark.parametrize(
    "content",
    [
        {"estimate_c2w_list": None},
        {"estimate_c2w_list": torch.zeros(3, 4, 4), "idx": "many"},
        {"estimate_c2w_list": [torch.zeros(4, 4), torch.zeros(2)]},
        {"estimate_c2w_list": torch.zeros(3, 4, 4).to_sparse()},
        torch.zeros(1).expand(10**12, 4, 4),
        torch.zeros(3, 4, 4, dtype=torch.complex64),
        [],
        "text",
    ],
)
def test_checkpoints_that_hold_no_poses(tmp_path: Path, content: object) -> None:
    torch.save(content, tmp_path / "estimated_c2w.ckpt")
    with pytest.raises(BenchError):
        read_written_poses(tmp_path / "estimated_c2w.ckpt")


def test_torch_files_are_not_unpacked(tmp_path: Path) -> None:
    torch.save(torch.zeros(10**6), tmp_path / "net.pth")
    with zipfile.ZipFile(tmp_path / "net.pth") as stored, zipfile.ZipFile(tmp_path / "small.pth", "w", 8) as packed:
        for name in stored.namelist():
            packed.writestr(name, stored.read(name))
    with pytest.raises(ValueError, match="its parts would take"):
        load_tensors(tmp_path / "small.pth")
    with tarfile.open(tmp_path / "old.pth", "w") as tar:
        tar.add(tmp_path / "net.pth", "storages")
    with pytest.raises(ValueError, match="it is a tar archive"):
        load_tensors(tmp_path / "old.pth")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[" * 100_000, "RecursionError|nested"),
        ("[" * 200 + "]" * 200, "nested more than 50 deep"),
        ('{"a": 1e999}', "too large"),
        ('{"a": ' + "9" * 400 + "}", "whole number of 400 digits"),
        ('{"a": ' + "9" * 5000 + "}", "whole number of 5000 digits"),
        ("\x00", "zero byte"),
    ],
)
def test_json_without_measure(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "status.json"
    path.write_text(text)
    for read in (read_json, lambda each: read_status(each.parent)):
        with pytest.raises(BenchError, match=message):
            read(path)


def test_json_as_others_write_it(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_bytes(b'\xef\xbb\xbf{"a": [NaN, -1.5e3, 9223372036854775807]}')
    assert read_json(tmp_path / "a.json") == {"a": [None, -1500.0, 2**63 - 1]}
    assert np.isnan(load_json(tmp_path / "a.json")["a"][0])


@pytest.mark.parametrize(
    "change",
    [
        {"frames_done": "7"},
        {"frames_total": -1},
        {"pid": 10**18},
        {"pid": True},
        {"reason": ["a"]},
        {"updated": 7},
        {"host": {}},
        {"lost_stretches": 3},
        {"lost_stretches": [[1, 2, 3]]},
        {"lost_stretches": [["a", "b"]]},
        {"process_started": "x"},
        {"state": []},
    ],
)
def test_a_status_of_wrong_types(tmp_path: Path, change: dict[str, object]) -> None:
    (tmp_path / "status.json").write_text(json.dumps({"state": "done", "frames_done": 3} | change))
    with pytest.raises(BenchError, match=f"status.json.*{next(iter(change))}"):
        read_status(tmp_path)


LAUGHS = "a: &a [x, x]\n" + "".join(f"{b}: &{b} [*{a}, *{a}]\n" for a, b in zip("abcdefg", "bcdefgh", strict=True))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (LAUGHS, "it has an alias"),
        ("a: &a [*a]", "it has an alias"),
        ("[" * 5000, "nested more than 50 deep"),
        ("- " * 5000 + "x", "nested more than 50 deep"),
        ("\n".join(" " * 2 * n + "a:" for n in range(90)), "nested more than 50 deep"),
        ("!!python/object/apply:os.system ['true']", "could not determine a constructor"),
        ("a: 9" + "9" * 5000, "Exceeds the limit"),
    ],
)
def test_yaml_without_measure(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        parse_yaml(text)
    (tmp_path / "score.yaml").write_text(text)
    with pytest.raises(BenchError, match=r"score\.yaml can't be read"):
        read_settings(tmp_path, {})


def test_yaml_as_people_write_it() -> None:
    text = "a: '*.png & more'\nb: [1, {c: 2}]\nd:\n- - x\n  - y\n"
    assert parse_yaml(text) == {"a": "*.png & more", "b": [1, {"c": 2}], "d": [["x", "y"]]}


def test_pictures_that_claim_to_be_huge(tmp_path: Path) -> None:
    side = (100_000).to_bytes(4, "big")
    path = tmp_path / "left.png"
    path.write_bytes(b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR" + side + side + bytes(9) + b"\0\0\0\0IEND\xaeB`\x82")
    for read in (image_size, lambda each: read_rgb(each, (100_000, 100_000))):
        with pytest.raises(BenchError, match="100000x100000 pixels"):
            read(path)


def test_text_that_is_plain_comes_back_as_it_is() -> None:
    for text in ("", "a  b", "  led by blanks", "ä ± → 漢字 😀", ":smile:"):
        assert plain_line(text) == text
    assert len(plain_line("x" * 10**7)) == 5000
    assert len(plain_line("x\n" * 10**7)) <= 5000


@pytest.mark.parametrize("name", ["est.txt", "est.tum", "est.npy"])
def test_positions_without_measure(tmp_path: Path, name: str) -> None:
    """Their squares are no numbers any more, and neither would the errors be."""
    T = POSES.copy()
    T[1, 0, 3] = 1e300
    if name == "est.npy":
        np.save(tmp_path / name, T)
    elif name == "est.tum":
        np.savetxt(tmp_path / name, [[k, *T[k, :3, 3], 0, 0, 0, 1] for k in range(3)])
    else:
        np.savetxt(tmp_path / name, T[:, :3].reshape(3, 12))
    with pytest.raises(BenchError, match=r"line 2: the position is farther|pose 1 \(from 0\) is not finite, or holds"):
        read_written_poses(tmp_path / name)
