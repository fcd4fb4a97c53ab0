"""Files are written whole or not at all."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from bench.errors import BenchError
from bench.io.atomic import atomic_path, write_bytes, write_image, write_json, write_text


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_a_writer_that_fails_leaves_the_old_file_and_nothing_else(tmp_path: Path, error: type[BaseException]) -> None:
    target = tmp_path / "map.ply"
    write_text(target, "old")

    def fail_half_way() -> None:
        with atomic_path(target) as temporary:
            temporary.write_text("half of the new")
            raise error("stop")

    with pytest.raises(error):
        fail_half_way()
    assert [file.name for file in tmp_path.iterdir()] == ["map.ply"]
    assert target.read_text() == "old"


def test_the_target_does_not_change_before_the_end(tmp_path: Path) -> None:
    target = tmp_path / "map.ply"
    write_text(target, "old")
    with atomic_path(target) as temporary:
        temporary.write_text("new")
        assert temporary.suffix == ".ply"
        assert temporary.parent == tmp_path
        assert target.read_text() == "old"
    assert target.read_text() == "new"


def test_a_folder_that_can_not_be_written_to_is_named(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match=r"Can't write .*nowhere/a\.txt: No such file or directory"):
        write_bytes(tmp_path / "nowhere" / "a.txt", b"")


def test_json_has_null_for_what_is_no_number(tmp_path: Path) -> None:
    content = {"nan": float("nan"), "inf": [np.float32("inf")], "array": np.array([1.0, np.nan]), "n": np.int64(3)}
    write_json(tmp_path / "a.json", content | {"flag": np.bool_(True), "path": Path("x/y")})
    read = json.loads((tmp_path / "a.json").read_text())
    assert read == {"nan": None, "inf": [None], "array": [1.0, None], "n": 3, "flag": True, "path": "x/y"}


def test_images_come_back_as_they_were(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    color = rng.integers(0, 256, (20, 30, 3), dtype=np.uint8)
    depth = rng.integers(0, 65536, (20, 30), dtype=np.uint16)
    write_image(tmp_path / "c.png", color)
    write_image(tmp_path / "d.png", depth)
    assert np.array_equal(cv2.imread(str(tmp_path / "c.png"))[..., ::-1], color)
    assert np.array_equal(cv2.imread(str(tmp_path / "d.png"), cv2.IMREAD_UNCHANGED), depth)
