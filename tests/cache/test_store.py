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
    folder = tmp_path / "stereo" / "net" / "00"
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
