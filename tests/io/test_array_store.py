"""Sets of arrays on disk: whole or not there, and never wrong."""

from __future__ import annotations

import errno
import os
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from bench.errors import BenchError
from bench.io.array_store import ArrayStore, DamagedError

ONE = {"a": np.arange(6.0)}


@pytest.mark.parametrize("dtype", ["?", "i1", "u1", "<i2", ">u2", "<i4", "<i8", "<u8", "<f2", "<f4", ">f8", "<c8"])
@pytest.mark.parametrize("shape", [(), (0,), (7,), (3, 0), (2, 3, 5)])
def test_arrays_come_back_to_the_bit(tmp_path: Path, dtype: str, shape: tuple[int, ...]) -> None:
    array = np.frombuffer(np.random.default_rng(0).bytes(8 * 30), np.uint8)[: np.dtype(dtype).itemsize * 30] & 1
    array = np.resize(array.view(dtype), shape)
    ArrayStore(tmp_path / "s").put("x", {"first": array, "second": ONE["a"]})
    back = ArrayStore(tmp_path / "s").get("x")
    assert list(back) == ["first", "second"]
    assert (back["first"].dtype, back["first"].shape) == (array.dtype, shape)
    assert back["first"].tobytes() == array.tobytes()
    np.testing.assert_array_equal(back["second"], ONE["a"])
    assert not back["first"].flags.writeable


def test_views_into_larger_buffers(tmp_path: Path) -> None:
    buffer = np.random.default_rng(0).random((5, 40, 3)).astype(np.float32)
    views = {"rows": buffer[:, 3:17], "columns": buffer.transpose(2, 1, 0), "steps": buffer[0, ::2, 1]}
    store = ArrayStore(tmp_path)
    store.put("x", views)
    for key, array in store.get("x").items():
        np.testing.assert_array_equal(array, views[key])


def test_two_stores_share_a_folder(tmp_path: Path) -> None:
    one, other = ArrayStore(tmp_path / "s"), ArrayStore(tmp_path / "s")
    assert other.names() == []
    for name in ("b", "a", "c.1"):
        one.put(name, ONE)
    assert other.names() == ["a", "b", "c.1"]
    assert other.bytes("a") == (tmp_path / "s" / "a.arrays").stat().st_size
    with pytest.raises(BenchError, match=r"a.arrays exists already, and sets of arrays are never changed"):
        other.put("a", ONE)
    mapped = one.get("a")["a"]
    other.remove("a")
    other.discard(["b", "never there"])
    assert one.names() == ["b"]
    assert "b" in one
    assert "a" not in one
    np.testing.assert_array_equal(mapped, ONE["a"])
    one.clear()
    assert other.names() == []
    one.put("a", ONE)


@pytest.mark.parametrize("name", ["a/b", "../a", "", ".hidden", "a b", "ä", "a\n", "a" * 201])
@pytest.mark.parametrize("use", [lambda s, n: s.put(n, ONE), ArrayStore.get, ArrayStore.bytes, ArrayStore.remove])
def test_names_that_are_none(tmp_path: Path, name: str, use: Callable[[ArrayStore, str], object]) -> None:
    with pytest.raises(BenchError, match="can't name a set of arrays"):
        use(ArrayStore(tmp_path), name)


def test_only_numbers_are_stored(tmp_path: Path) -> None:
    for array in (np.array([{}]), np.array(["text"]), np.zeros(2, "f4,i4")):
        with pytest.raises(BenchError, match="only numbers and bools are stored"):
            ArrayStore(tmp_path).put("x", {"a": array})
    assert not list(tmp_path.iterdir())


def test_a_cut_file(tmp_path: Path) -> None:
    ArrayStore(tmp_path).put("x", ONE)
    content = (tmp_path / "x.arrays").read_bytes()
    for stay in (*range(0, len(content), 6), len(content) - 1):
        (tmp_path / "x.arrays").write_bytes(content[:stay])
        with pytest.raises(DamagedError, match=r"x.arrays is damaged: .*\. Start the run anew"):
            ArrayStore(tmp_path).get("x")


def test_a_changed_byte_anywhere(tmp_path: Path) -> None:
    ArrayStore(tmp_path).put("x", ONE)
    content = (tmp_path / "x.arrays").read_bytes()
    for at in (*range(0, len(content), 6), len(content) - 1):
        changed = bytearray(content)
        changed[at] ^= 0x04
        (tmp_path / "x.arrays").write_bytes(changed)
        with pytest.raises(DamagedError, match=r"x.arrays is damaged: "):
            ArrayStore(tmp_path).get("x")


def test_the_length_is_looked_at_each_time(tmp_path: Path) -> None:
    store = ArrayStore(tmp_path)
    store.put("x", ONE)
    path = tmp_path / "x.arrays"
    size = path.stat().st_size
    os.truncate(path, size - 1)
    with pytest.raises(DamagedError, match=f"it has {size - 1} bytes, and should have {size}"):
        store.get("x")
    path.unlink()
    for use in (store.get, store.bytes):
        with pytest.raises(DamagedError, match=r"x\.arrays"):
            use("x")
    path.mkdir()
    with pytest.raises(DamagedError, match=r"x.arrays is a folder"):
        store.get("x")


def test_a_full_disk_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    store = ArrayStore(tmp_path / "s")
    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", full)
        with pytest.raises(BenchError, match=r"Can't write .*x.arrays: No space left on device. Check"):
            store.put("x", ONE)
    assert not list((tmp_path / "s").iterdir())
    store.put("x", ONE)
    (tmp_path / "file").touch()
    with pytest.raises(BenchError, match=r"Can't make .*file/s: "):
        ArrayStore(tmp_path / "file" / "s").put("x", ONE)


def test_a_writer_that_was_killed(tmp_path: Path) -> None:
    store = ArrayStore(tmp_path)
    store.put("x", ONE)
    (tmp_path / ".writing-1-0-y.arrays").write_bytes((tmp_path / "x.arrays").read_bytes()[:99])
    mine = tmp_path / f".writing-{os.getpid()}-7-z.arrays"  # as of another thread
    mine.touch()
    assert store.names() == ["x"]
    store.discard(["x"])
    assert {path.name for path in tmp_path.iterdir()} == {"x.arrays", mine.name}


def test_threads_write_and_read_at_once(tmp_path: Path) -> None:
    store, wrong = ArrayStore(tmp_path), []

    def work(who: int) -> None:
        for number in range(5):
            store.put(f"{who}-{number}", {"a": np.full(1000, who * number)})
            wrong.extend(store.get(f"{who}-{number}")["a"] != who * number)

    threads = [threading.Thread(target=work, args=(who,)) for who in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(store.names()) == 15
    assert not any(wrong)


@pytest.mark.skipif(not Path("/proc/self/smaps").is_file(), reason="this system does not tell what is resident")
def test_what_is_released_is_no_longer_resident_and_can_be_read_again(tmp_path: Path) -> None:
    store = ArrayStore(tmp_path)
    values = np.random.default_rng(0).integers(0, 255, 1 << 22, dtype=np.uint8)
    store.put("large", {"values": values})
    mapped = store.get("large")["values"]
    total = int(mapped.sum(dtype=np.int64))
    assert _resident_kib(tmp_path) >= 4096
    store.release()
    assert _resident_kib(tmp_path) == 0
    assert int(mapped.sum(dtype=np.int64)) == total == int(values.sum(dtype=np.int64))


def _resident_kib(folder: Path) -> int:
    """What is resident of the files of a folder that this process maps, by Linux."""
    lines = Path("/proc/self/smaps").read_text().splitlines()
    starts = [k for k, line in enumerate(lines) if str(folder) in line]
    return sum(int(next(line for line in lines[k:] if line.startswith("Rss:")).split()[1]) for k in starts)
