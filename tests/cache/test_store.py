"""The cache's folder: its size limit, what it removes, and what it leaves alone."""

from __future__ import annotations

import logging
import os
import time
from pathlib import Path

import numpy as np
import pytest

from bench.cache.entry import Stored, encode
from bench.cache.store import CacheStore

MAP = Stored(np.zeros((100, 100), np.float32), 0.1, "net")
SIZE = len(encode(MAP))


def key(number: int) -> str:
    return f"{number:02x}" * 32


def age(store: CacheStore, number: int, seconds: float) -> None:
    (path,) = store.folder.glob(f"*/*/*/{key(number)}.entry")
    os.utime(path, (time.time() - seconds,) * 2)


def there(store: CacheStore, numbers: range) -> list[int]:
    return [number for number in numbers if list(store.folder.glob(f"*/*/*/{key(number)}.entry"))]


def test_what_was_not_used_for_the_longest_time_goes_first(tmp_path: Path) -> None:
    store = CacheStore(tmp_path, limit=10.5 * SIZE)
    for number in range(10):
        store.write("stereo", "net", key(number), MAP)
        age(store, number, 1000 - number)
    assert there(store, range(11)) == list(range(10))
    assert store.read("stereo", "net", key(1)) is not None  # so it was used just now
    store.write("sky", "other", key(10), MAP)
    # 11 do not fit into 10.5: down to nine tenths of that, so 9 stay; 0 and 2 were the oldest.
    assert there(store, range(11)) == [1, 3, 4, 5, 6, 7, 8, 9, 10]


def frame_key(sequence: str, frame: int) -> str:
    return f"{sequence:0<12}{frame:064x}"


def read_through(folder: Path, sequence: str, frames: range, limit: float) -> float:
    """A run, days after what lies there: the share of its frames that came from the cache."""
    for file in folder.rglob("*.entry"):
        os.utime(file, (file.stat().st_mtime - 1e5,) * 2)
    store, hits = CacheStore(folder, limit * SIZE), 0
    for frame in frames:
        if store.read("stereo", "net", frame_key(sequence, frame)) is not None:
            hits += 1
        else:
            store.write("stereo", "net", frame_key(sequence, frame), MAP)
    assert len(list(folder.rglob("*.entry"))) <= 1.05 * limit
    return hits / len(frames)


@pytest.fixture
def unsynced(monkeypatch: pytest.MonkeyPatch) -> None:
    """Waiting for the disk is most of what many small files take."""
    monkeypatch.setattr("bench.io.atomic.os.fsync", lambda descriptor: None)


@pytest.mark.usefixtures("unsynced")
@pytest.mark.parametrize(("frames", "least"), [(36, 1.0), (50, 0.76), (120, 0.31)])
def test_a_sequence_that_is_read_again_and_again_hits_as_much_as_fits(
    tmp_path: Path, frames: int, least: float, caplog: pytest.LogCaptureFixture
) -> None:
    """At 0.9, 1.25 and 3 times the limit of 40 frames; another sequence filled the cache before and gives way."""
    read_through(tmp_path, "b", range(40), limit=40)
    assert read_through(tmp_path, "a", range(frames), limit=40) == 0.0
    caplog.clear()
    assert [read_through(tmp_path, "a", range(frames), limit=40) >= least for _ in range(3)] == [True] * 3
    assert len(list(tmp_path.glob("stereo/net/b*/*"))) <= max(42 - frames, 0)
    warned = [record.getMessage() for record in caplog.records if "larger than cache.limit_gb" in record.getMessage()]
    assert len(warned) == (3 if frames > 40 else 0)  # once a run


@pytest.mark.usefixtures("unsynced")
def test_another_part_of_a_sequence_takes_the_place_of_what_is_not_read(tmp_path: Path) -> None:
    read_through(tmp_path, "a", range(100), limit=40)
    read_through(tmp_path, "a", range(1000, 1030), limit=40)
    assert read_through(tmp_path, "a", range(1000, 1030), limit=40) == 1.0
    # A part that begins before what is there costs no more than what it brings.
    read_through(tmp_path, "a", range(980, 1030), limit=40)
    assert [read_through(tmp_path, "a", range(980, 1030), limit=40) >= 0.76 for _ in range(2)] == [True] * 2


def test_a_new_process_counts_what_others_left(tmp_path: Path) -> None:
    generous = CacheStore(tmp_path, limit=1e9)
    for number in range(10):
        generous.write("stereo", "net", key(number), MAP)
        age(generous, number, 1000 - number)
    CacheStore(tmp_path, limit=5 * SIZE).write("stereo", "net", key(10), MAP)
    assert there(generous, range(11)) == [7, 8, 9, 10]


def test_files_of_killed_writers_go_and_those_of_living_ones_stay(tmp_path: Path) -> None:
    store = CacheStore(tmp_path, limit=1e9)
    store.write("stereo", "net", key(0), MAP)
    folder = tmp_path / "stereo" / "net" / ("00" * 6)
    for name, seconds in ((".writing-1-0-dead.entry", 7200), (".writing-2-0-alive.entry", 10)):
        (folder / name).touch()
        os.utime(folder / name, (time.time() - seconds,) * 2)
    store.trim()
    assert sorted(file.name for file in folder.iterdir()) == [".writing-2-0-alive.entry", f"{key(0)}.entry"]


def test_clear_removes_entries_and_nothing_else(tmp_path: Path) -> None:
    store = CacheStore(tmp_path, limit=1e9)
    store.write("stereo", "net", key(1), MAP)
    store.write("sky", "net", key(2), MAP)
    mine = tmp_path / "stereo" / "net" / "notes.txt"
    mine.write_text("not the cache's")
    assert store.clear("sky") == (1, SIZE)
    assert there(store, range(3)) == [1]
    assert store.clear() == (1, SIZE)
    assert store.clear() == (0, 0)
    assert mine.is_file()


def test_plugin_names_do_not_leave_the_folder(tmp_path: Path) -> None:
    store = CacheStore(tmp_path / "cache", limit=1e9)
    store.write("stereo", "../../net", key(1), MAP)
    assert store.read("stereo", "../../net", key(1)) is not None
    assert [path.name for path in tmp_path.iterdir()] == ["cache"]


def test_a_damaged_entry_is_missing_and_logged(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    store = CacheStore(tmp_path, limit=1e9)
    store.write("stereo", "net", key(1), MAP)
    (path,) = tmp_path.glob("*/*/*/*.entry")
    path.write_bytes(path.read_bytes()[:-1])
    with caplog.at_level(logging.WARNING):
        assert store.read("stereo", "net", key(1)) is None
    assert f"{path} is damaged (its checksum is wrong); computing it again" in caplog.text
    store.write("stereo", "net", key(1), MAP)
    assert store.read("stereo", "net", key(1)) is not None


@pytest.mark.parametrize("what", ["folder", "pipe", "old", "empty"])
def test_whatever_is_in_the_place_of_an_entry_is_computed_again(tmp_path: Path, what: str) -> None:
    store = CacheStore(tmp_path, limit=1e9)
    store.write("stereo", "net", key(1), MAP)
    (path,) = tmp_path.glob("*/*/*/*.entry")
    path.unlink()
    if what == "folder":
        path.mkdir()
    elif what == "pipe":
        os.mkfifo(path)
    else:
        path.write_bytes(b"bgs-cache 1 00000000\n{}\n" if what == "old" else b"")
    assert store.read("stereo", "net", key(1)) is None


def test_a_folder_that_others_can_write_into_is_said_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    ours, theirs = tmp_path / "ours", tmp_path / "theirs"
    for folder, mode in ((ours, 0o755), (theirs, 0o777)):
        folder.mkdir()
        folder.chmod(mode)
    with caplog.at_level(logging.WARNING):
        for folder in (ours, theirs, theirs, tmp_path / "not there yet"):
            CacheStore(folder, limit=1e9)
    assert [record.getMessage().partition(",")[0] for record in caplog.records] == [
        f"cache: other users can write into {theirs}"
    ]
