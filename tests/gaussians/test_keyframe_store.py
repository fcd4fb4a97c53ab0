"""Keyframes in memory and on disk: the same to the bit, at the poses of now."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench.errors import BenchError
from bench.gaussians.keyframe_store import KeyframeStore
from bench.io.array_store import ArrayStore, DamagedError
from bench.types import DepthMap, Keyframe, StereoFrame


def keyframe(number: int, full: bool = True, grey: bool = False) -> Keyframe:
    """One with depth from 0.5 m to 200 m, unknown in places; ``full``: with right image, confidence and sky."""
    random = np.random.default_rng(number)
    images = random.integers(0, 256, (2, 13, 21, 1 if grey else 3), dtype=np.uint8)
    left, right = np.broadcast_to(images, (2, 13, 21, 3))
    depth = np.exp(random.uniform(np.log(0.5), np.log(200), (13, 21))).astype(np.float32)
    depth[random.random((13, 21)) < 0.3] = np.nan
    confidence = random.random((13, 21), np.float32) if full else None
    T = np.eye(4)
    T[:3, 3] = random.normal(size=3)
    frame = StereoFrame(number, 0.1 * number + 1e9, left, right if full else None)
    return Keyframe(frame, DepthMap(depth, "by hand", confidence), depth > 100 if full else None, T)


def assert_same(one: Keyframe, other: Keyframe) -> None:
    assert (one.frame.number, one.frame.timestamp) == (other.frame.number, other.frame.timestamp)
    assert one.depth.source == other.depth.source
    pairs = [(one.frame.left, other.frame.left), (one.frame.right, other.frame.right), (one.sky, other.sky)]
    pairs += [(one.depth.depth, other.depth.depth), (one.depth.confidence, other.depth.confidence)]
    for a, b in [*pairs, (one.T_world_cam, other.T_world_cam)]:
        if a is None or b is None:
            assert a is b
        else:
            assert (a.dtype, a.shape, a.tobytes()) == (b.dtype, b.shape, b.tobytes())


@pytest.mark.parametrize("grey", [False, True])
@pytest.mark.parametrize("full", [False, True])
def test_what_was_on_disk_is_the_same_to_the_bit(tmp_path: Path, full: bool, grey: bool) -> None:
    store, given = KeyframeStore(ArrayStore(tmp_path)), keyframe(7, full, grey)
    store.add(given)
    before = store[7]
    np.testing.assert_array_equal(before.frame.left, given.frame.left)
    store.let_go(7)
    assert store.in_memory == 0
    assert_same(store[7], before)
    assert store.in_memory == 1
    assert_same(store[7], before)


def test_how_much_rounding_changes(tmp_path: Path) -> None:
    given = keyframe(0)
    far = given.depth.depth.copy()
    far[0, :3] = [1e5, np.inf, 80.0]
    store = KeyframeStore(ArrayStore(tmp_path))
    store.add(replace(given, depth=replace(given.depth, depth=far)))
    kept = store[0].depth
    assert kept.confidence is not None
    assert given.depth.confidence is not None
    np.testing.assert_array_equal(kept.depth[0, :3], [65504, np.inf, 80])
    np.testing.assert_allclose(kept.depth[1:], far[1:], rtol=1 / 2048)
    np.testing.assert_allclose(kept.confidence, given.depth.confidence, rtol=0, atol=1 / 4096)


def test_few_stay_decoded_and_poses_are_those_of_now(tmp_path: Path) -> None:
    store, moved = KeyframeStore(ArrayStore(tmp_path), decoded=2), np.diag([1.0, -1, -1, 1])
    for number in (5, 3, 9, 4):
        store.add(keyframe(number))
    assert store.numbers() == [5, 3, 9, 4]
    for number in (5, 3, 9):
        store.let_go(number)
        store.let_go(number)
    store.set_pose(3, moved)
    store.set_pose(4, moved)
    for number in (5, 3, 9, 4, 3, 5):
        pose = moved if number in (3, 4) else keyframe(number).T_world_cam
        np.testing.assert_array_equal(store[number].T_world_cam, pose)
        np.testing.assert_array_equal(store.pose(number), pose)
        np.testing.assert_array_equal(store[number].frame.left, keyframe(number).frame.left)
    assert store.in_memory == 3
    assert len(list(tmp_path.iterdir())) == 3
    store.remove(9)
    assert 9 not in store
    assert len(store) == 3
    for use in (store.__getitem__, store.let_go, store.pose, lambda number: store.set_pose(number, moved)):
        with pytest.raises(KeyError):
            use(9)


def test_going_on_from_a_state(tmp_path: Path) -> None:
    arrays = ArrayStore(tmp_path)
    store = KeyframeStore(arrays)
    assert KeyframeStore(arrays).state()["stored"] == []
    for number in (2, 0):
        store.add(keyframe(number))
    store.let_go(2)
    store.set_pose(0, np.diag([-1.0, -1, 1, 1]))
    state = store.state()
    assert store.in_memory == 1
    # What comes after the checkpoint is lost, and comes again; what it names stays as it is.
    store.add(keyframe(0, full=False))
    store.add(keyframe(8, full=False))
    store.let_go(0)
    store.let_go(8)
    resumed = KeyframeStore(arrays)
    resumed.restore(state)
    assert resumed.numbers() == [2, 0]
    assert resumed.in_memory == 0
    first = KeyframeStore(ArrayStore(tmp_path / "other"))
    for number in (2, 0, 8):
        first.add(keyframe(number))
    first.set_pose(0, np.diag([-1.0, -1, 1, 1]))
    resumed.add(keyframe(8))
    resumed.let_go(8)
    for number in (2, 0, 8):
        assert_same(resumed[number], first[number])
    arrays.discard(resumed.state()["stored"])
    assert len(arrays.names()) == 3
    assert_same(resumed[0], first[0])


def test_a_damaged_file_and_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = KeyframeStore(ArrayStore(tmp_path))
    store.add(keyframe(1))

    def full(*_: object) -> None:
        raise BenchError("no space left")

    with monkeypatch.context() as patched:
        patched.setattr(ArrayStore, "put", full)
        with pytest.raises(BenchError):
            store.let_go(1)
    assert store.in_memory == 1
    store.let_go(1)
    (path,) = tmp_path.iterdir()
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(DamagedError, match=r"keyframe-000001-0.arrays is damaged"):
        store[1]
