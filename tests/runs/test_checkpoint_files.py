"""A checkpoint comes back to the bit, writes only what is new, and keeps the parts' stores in step with it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from bench.runs.checkpoint import CHECKPOINT_FOLDER, Checkpoints, Snapshot
from bench.runs.journal import Journal
from bench.types import Event


def snapshot(frames: int, **changed: Any) -> Snapshot:
    """Of a run after so many frames, each a keyframe."""
    rng = np.random.default_rng(0)
    made = Snapshot(
        rows=[{"number": k, "reprojection_px": 0.1 * k, "mapped": True} for k in range(frames)],
        mapper={"step": frames},
        seconds={"mapping": 1 / 3},
        elapsed_s=2.0,
        psnr_db=20.0,
        peak_memory_gb=1.0,
        random=torch.zeros(3, dtype=torch.uint8),
        resumed_after=[],
        events=[Event("pruned", k, {"count": k}) for k in range(frames)],
        keyframe_poses=list(rng.normal(size=(frames, 4, 4))),
        seeing={},
        obsolete={},
        optimised=False,
    )
    return replace(made, **changed)


def checkpoints(folder: Path, fingerprint: str = "f") -> Checkpoints:
    return Checkpoints(folder, fingerprint, 0.0)


def put(kept: Checkpoints, kind: str, *names: str) -> None:
    for name in names:
        kept.stores[kind].put(name, {"x": np.arange(3)})


def test_what_is_read_is_what_was_written(tmp_path: Path) -> None:
    writer = checkpoints(tmp_path)
    for frames in (2, 5):
        writer.write(snapshot(frames))
    read, wanted = checkpoints(tmp_path).load(), snapshot(5)
    assert read is not None
    np.testing.assert_array_equal(read.keyframe_poses, wanted.keyframe_poses)
    assert (read.rows, read.events, read.seconds) == (wanted.rows, wanted.events, wanted.seconds)
    assert read.mapper == {"step": 5}


def test_lines_after_the_newest_checkpoint_do_not_count(tmp_path: Path) -> None:
    """The writer was killed between the lines and the checkpoint that counts them; the next one goes on before them."""
    checkpoints(tmp_path).write(snapshot(3))
    with (tmp_path / CHECKPOINT_FOLDER / "rows.jsonl").open("a") as file:
        file.write('{"number": 3}\n{"numb')
    again = checkpoints(tmp_path)
    read = again.load()
    assert read is not None
    assert [row["number"] for row in read.rows] == [0, 1, 2]
    again.write(snapshot(4))
    read = checkpoints(tmp_path).load()
    assert read is not None
    assert read.rows == snapshot(4).rows


@pytest.mark.parametrize("damage", ["rows.jsonl", "events.jsonl", "keyframe_poses.jsonl", "state.pt", "fingerprint"])
def test_what_does_not_fit_is_cleared_with_its_stores(tmp_path: Path, damage: str) -> None:
    writer = checkpoints(tmp_path)
    put(writer, "mapper", "chunk-0")
    writer.write(snapshot(3, mapper={"stored": ["chunk-0"]}))
    if damage != "fingerprint":
        path = tmp_path / CHECKPOINT_FOLDER / damage
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 0x15
        path.write_bytes(bytes(content) if damage != "state.pt" else bytes(content[:100]))
    again = checkpoints(tmp_path, "other" if damage == "fingerprint" else "f")
    assert again.load() is None
    assert again.stores["mapper"].names() == []


def test_stores_hold_what_the_newest_checkpoint_names_and_what_came_since(tmp_path: Path) -> None:
    writer = checkpoints(tmp_path)
    put(writer, "tracker", "a", "b")
    state = {"stored": ["b"]}
    unused = writer.unused("tracker", state)
    put(writer, "tracker", "since")
    writer.write(snapshot(1, seeing={"tracker": state}, obsolete={"tracker": unused}))
    assert writer.stores["tracker"].names() == ["b", "since"]
    resumed = checkpoints(tmp_path)
    assert resumed.load() is not None
    assert resumed.stores["tracker"].names() == ["b"]


def test_the_ten_thousandth_row_costs_what_the_hundredth_did(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    looked_at: list[int] = []
    journal = Journal(tmp_path / "rows.jsonl")
    for count in (100, 200, 10_000, 10_100):
        journal.extend(range(count), lambda item: looked_at.append(item) or item)
        written = len(looked_at)
        looked_at.clear()
    assert written == 100
    mark = journal.extend(range(10_100), int)
    assert Journal(tmp_path / "rows.jsonl").read(mark) == list(range(10_100))
