"""A map in chunks on disk: the same bits whatever stays in memory, nothing lost, and it moves with its keyframes."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch

from bench.contracts.mapper import CannotRenderError
from bench.errors import BenchError
from bench.gaussians.chunk_schedule import ChunkSchedule
from bench.gaussians.chunked_map import ChunkDrawing, ChunkedMap
from bench.gaussians.last_optimisation import LastOptimisation
from bench.gaussians.map import GaussianMap
from bench.gaussians.schema import LOG_SCALE, MEAN, QUATERNION
from bench.io.array_store import ArrayStore
from bench.types import DepthMap, Keyframe, PinholeView, Trajectory
from plugins.datasets.street import Street, StreetConfig
from plugins.losses.geo import GeoConfig, GeoLoss
from plugins.losses.rgb import RgbConfig, RgbLoss
from plugins.mappers.gaussian import GaussianMapper, GaussianMapperConfig

FRAMES = 9
# A car's way of metres stands for one of hundreds.
SHORT = {"chunk_m": 1.5, "live_m": 2.5, "far_m": 3.0}
FEW = {"iterations": 2, "final_coarse_iterations": 1, "final_iterations": 1, "prune_opacity": 0.0}


@cache
def street() -> tuple[Street, list[Keyframe]]:
    """Nine frames a metre apart and back to the second, with exact depth, sky and poses."""
    dataset = Street(StreetConfig("street", frames=FRAMES, width=80, height=32))
    truth = dataset.ground_truth()
    assert truth is not None
    keyframes = []
    for k in range(FRAMES):
        depth = DepthMap(dataset.true_depth(k), "truth")
        keyframes.append(Keyframe(dataset.frame(k), depth, dataset.true_sky(k), truth.T_world_cam[k]))
    return dataset, keyframes


def started(store: Path, **settings: object) -> GaussianMapper:
    mapper = GaussianMapper(GaussianMapperConfig("gaussian", **{**SHORT, **FEW, **settings}))  # type: ignore[arg-type]
    mapper.start(street()[0].camera, [RgbLoss(RgbConfig("rgb")), GeoLoss(GeoConfig("geo"))], 0)
    mapper.use_store(ArrayStore(store))
    return mapper


def poses(changed: dict[int, np.ndarray] | None = None) -> Trajectory:
    T = np.stack([keyframe.T_world_cam for keyframe in street()[1]])
    for number, motion in (changed or {}).items():
        T[number] = motion @ T[number]
    return Trajectory(T, np.arange(FRAMES), np.arange(FRAMES) / 10)


def results(mapper: GaussianMapper, path: Path) -> list[bytes]:
    mapper.save(path)
    views = [PinholeView.of(street()[0].camera, T) for T in poses().T_world_cam]
    return [path.read_bytes(), *(mapper.render_frame(k, False, view).color.tobytes() for k, view in enumerate(views))]


def mapped(tmp_path: Path, **settings: object) -> GaussianMapper:
    mapper = started(tmp_path, **settings)
    for k, keyframe in enumerate(street()[1]):
        mapper.add_keyframe(keyframe, [k])
    mapper.finish()
    return mapper


def test_the_same_bits_whatever_stays_in_memory(tmp_path: Path) -> None:
    """With room for no chunk each look pages; with room for all none does twice."""
    paged, held = (mapped(tmp_path / name, chunk_memory_mb=mb) for name, mb in (("paged", 0.0), ("held", np.inf)))
    assert len(paged._map._numbers) >= 6
    assert results(paged, tmp_path / "a.ply") == results(held, tmp_path / "b.ply")


def test_the_same_bits_wherever_the_images_of_a_whole_map_are(tmp_path: Path) -> None:
    paged, held = (mapped(tmp_path / f"{n}", live_m=np.inf, live_keyframes=n) for n in (4, 200))
    assert paged._replay.keyframes.in_memory < held._replay.keyframes.in_memory == FRAMES
    assert len(ArrayStore(tmp_path / "4").names()) == FRAMES - 4
    assert not ArrayStore(tmp_path / "200").names()
    assert results(paged, tmp_path / "a.ply") == results(held, tmp_path / "b.ply")


@pytest.mark.parametrize("settings", [{}, {"live_m": np.inf, "live_keyframes": 4}], ids=["chunks", "whole map"])
def test_resumed_to_the_bit_at_each_keyframe(tmp_path: Path, settings: dict[str, float]) -> None:
    whole, broken = mapped(tmp_path / "whole", **settings), started(tmp_path / "broken", **settings)
    for k, keyframe in enumerate(street()[1]):
        broken.add_keyframe(keyframe, [k])
        torch.save(broken.state(), tmp_path / "state.pt")
        broken = started(tmp_path / "broken", **settings)
        broken.restore(torch.load(tmp_path / "state.pt", weights_only=True), iter(()))
    broken.finish()
    assert results(broken, tmp_path / "a.ply") == results(whole, tmp_path / "b.ply")


def chunked(store: ArrayStore, reach_m: float = 1e3, detail_m: float = 1e3) -> tuple[ChunkedMap, GaussianMap]:
    """Gaussians of nine keyframes of which the first three are on disk; and the same as one map in memory."""
    random = torch.Generator().manual_seed(0)
    live = GaussianMap(1, "cpu")
    for k, T in enumerate(poses().T_world_cam):
        planes = torch.randn(23, 50, generator=random)
        planes[MEAN] = planes[MEAN] * 0.3 + torch.from_numpy(T[:3, 3:]).float()
        planes[LOG_SCALE] -= 4
        live.add(k, T, planes, torch.ones(50))
    split = ChunkedMap(live, store, ChunkDrawing(reach_m, detail_m, 10.0, 0.01, 0.05, 0.0))
    split.freeze([0, 1, 2])
    # The hand-over of what lies nearer to other keyframes is the same in both.
    whole = GaussianMap(1, "cpu")
    frozen = ChunkedMap._map_of(split, next(iter(split._blocks.values())))
    assert frozen is not None
    one, other = frozen.state(), live.state()
    other["anchor"] += len(one["numbers"])
    joined = {key: torch.cat([one[key], other[key]], dim=0 if key == "T_world_cam" else -1) for key in one}
    whole.restore(joined | {"sky_about": one["sky_about"]})
    return split, whole


def test_what_goes_is_what_lies_nearest_to_its_keyframes(tmp_path: Path) -> None:
    split, whole = chunked(ArrayStore(tmp_path))
    assert len(split) == len(whole) == 50 * FRAMES
    places = poses().T_world_cam[:, :3, 3]
    stored = whole.planes[:, : len(split) - len(split.live)]
    for planes, sides in ((split.live.planes, {3, 4, 5, 6, 7, 8}), (stored, {0, 1, 2})):
        distance = np.linalg.norm(planes[MEAN].T.numpy()[:, None].astype(np.float64) - places[None], axis=2)
        assert set(distance.argmin(1).tolist()) <= sides
    assert len(split.live) < 50 * 7


def test_the_sky_stays_in_memory_and_is_no_chunks(tmp_path: Path) -> None:
    split, _ = chunked(ArrayStore(tmp_path))
    place = poses().T_world_cam[4, :3, 3]
    split.live.add_sky(place, torch.zeros(14, 6), torch.ones(6), 1e-3)  # where the next chunk is
    split.freeze([3, 4, 5])
    assert split.live.sky == 6
    assert len(split) == 50 * FRAMES + 6


def test_the_file_of_a_map_is_in_the_order_of_its_keyframes_numbers(tmp_path: Path) -> None:
    live = GaussianMap(0, "cpu")
    for number in (3, 5, 8):
        T, planes = np.eye(4), torch.zeros(14, 4 + number)
        T[2, 3] = planes[MEAN.start + 2] = number
        planes[QUATERNION.start] = 1.0
        live.add(number, T, planes, torch.ones(4 + number))
    live.add_sky(np.zeros(3), torch.full((14, 6), -1.0), torch.ones(6), 1e-3)
    split = ChunkedMap(live, ArrayStore(tmp_path), ChunkDrawing(1e3, 1e3, 10.0, 0.01, 0.05, 0.0))
    split.freeze([3, 5])
    split.save(tmp_path / "map.ply")
    depths = GaussianMap.load(tmp_path / "map.ply").planes[MEAN.start + 2]
    assert len(split.live) == 12 + 6
    assert split.keyframes_of_all().tolist() == depths.round().int().tolist()


def test_a_neighbour_that_is_damaged_no_longer_takes_part(tmp_path: Path) -> None:
    """It is told, and the run goes on; keyframes of the neighbourhood take turns in a chunk's last iterations."""
    mapper = started(tmp_path)
    for k, keyframe in enumerate(street()[1]):
        mapper.add_keyframe(keyframe, [k])
    last = mapper._last_optimisation(mapper._schedule.live, of_rest=True)
    frozen = set(mapper._map._numbers.tolist())
    assert last.neighbours
    assert frozen >= set(last.neighbours)
    rounds = LastOptimisation([1, 2, 3, 4], [7, 8, 9], 20, 20, seeds=False)
    random = np.random.default_rng(0)
    turns = [rounds.next(random)[0] for _ in range(rounds.steps)]
    assert len(turns) == 40 * (4 + 2)
    assert all(turns.count(number) == 40 for number in (1, 2, 3, 4))
    assert set(turns) == {1, 2, 3, 4, 7, 8, 9}
    for number in last.neighbours:
        for file in tmp_path.glob(f"keyframe-{number:06d}*"):
            file.write_bytes(b"")
    mapper._replay.keyframes._decoded.clear()
    mapper._last = last
    mapper.finish()
    assert not last.neighbours


def test_chunks_follow_corrections_as_live_gaussians_do(tmp_path: Path) -> None:
    """By a large one, and by one that is too small to be followed, until it has added up."""
    split, whole = chunked(ArrayStore(tmp_path))
    turn = np.array([[0.0, 0, 1, 2], [0, 1, 0, 1], [-1, 0, 0, 3], [0, 0, 0, 1]])
    small = np.eye(4)
    small[0, 3] = 0.006
    for changed in ({1: turn}, {1: turn, 0: small, 5: small}, {1: turn, 0: small @ small, 5: small @ small}):
        split.follow(poses(changed))
        whole.follow(poses(changed), 0.01, 0.05)
        split.look_from(np.zeros(3))
        stored, live = whole.planes.split([len(split) - len(split.live), len(split.live)], dim=1)
        torch.testing.assert_close(split.seen_from(np.zeros(3)), torch.cat([live, stored], 1), rtol=1e-5, atol=1e-5)


def test_only_chunks_within_reach_are_drawn(tmp_path: Path) -> None:
    split, _ = chunked(ArrayStore(tmp_path), reach_m=5.0)
    split.look_from(np.array([0.0, 0.0, 400.0]))
    assert split.seen_from(np.zeros(3)).shape[1] == len(split.live)
    split.look_from(np.zeros(3))
    assert split.seen_from(np.zeros(3)).shape[1] == len(split)


def test_what_is_far_is_drawn_in_fewer_gaussians(tmp_path: Path) -> None:
    split, _ = chunked(ArrayStore(tmp_path), detail_m=10.0)
    counts = []
    for distance in (0.0, 16.0, 26.0):
        split.look_from(np.array([0.0, -distance, 0.0]))
        counts.append(split.seen_from(np.zeros(3)).shape[1] - len(split.live))
    assert counts[0] == len(split) - len(split.live)
    assert counts[0] > counts[1] > counts[2] > 0


def test_a_revisit_is_drawn_from_disk_and_nothing_is_doubled(tmp_path: Path) -> None:
    """Its keyframe adds next to nothing where the map is right."""
    mapper, keyframes = started(tmp_path, live_m=1.5), street()[1]
    for k, keyframe in enumerate(keyframes):
        mapper.add_keyframe(keyframe, [k])
    while 4 in mapper._schedule.live:
        mapper._leave_behind(8)
    before = mapper.gaussians
    mapper.add_keyframe(replace(keyframes[4], frame=replace(keyframes[4].frame, number=9)), [9])
    assert mapper.gaussians - before < 0.3 * before / FRAMES


def test_another_look_of_a_known_place_is_seeded_only_where_it_is_far_off(tmp_path: Path) -> None:
    """A second visit in brighter light: what does not saturate is off by 0.15."""
    added = []
    for least in (0.1, 0.2):
        mapper, keyframes = started(tmp_path / f"{least}", exposure=False, revisit_error=least), street()[1]
        for k, keyframe in enumerate(keyframes):
            mapper.add_keyframe(keyframe, [k])
        mapper._map.freeze(range(FRAMES))
        before, frame = mapper.gaussians, keyframes[4].frame
        brighter = np.clip(frame.left.astype(np.int64) + 38, 0, 255).astype(np.uint8)
        mapper.add_keyframe(replace(keyframes[4], frame=replace(frame, number=9, left=brighter)), [9])
        added.append(mapper.gaussians - before)
    assert 0 < added[1] < 0.6 * added[0], added


def test_a_damaged_chunk_is_told_and_the_rest_goes_on(tmp_path: Path) -> None:
    mapper = mapped(tmp_path, chunk_memory_mb=0.0)
    before = mapper.gaussians
    block = next(iter(mapper._map._blocks.values()))
    (file,) = tmp_path.glob(f"{block.name}*")
    file.write_bytes(file.read_bytes()[:-40])
    views = [PinholeView.of(street()[0].camera, T) for T in poses().T_world_cam]
    with pytest.raises(CannotRenderError, match=f"keyframes {block.keyframes[0]} to"):
        mapper.render_frame(block.keyframes[0], False, views[block.keyframes[0]])
    far = poses().T_world_cam[8].copy()
    far[:3, 3] += 100.0
    mapper.render_frame(8, False, PinholeView.of(street()[0].camera, far))
    mapper.save(tmp_path / "map.ply")
    assert mapper.gaussians == before - block.gaussians


def test_a_full_disk_keeps_the_map_in_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise BenchError("Can't write: No space left on device.")

    monkeypatch.setattr(ArrayStore, "put", full)
    mapper = mapped(tmp_path)
    assert not mapper._map._blocks
    assert len(mapper._schedule.live) == FRAMES


def test_chunks_are_closed_by_way_and_number() -> None:
    def pose_of(number: int) -> np.ndarray:
        return np.block([[np.eye(3), np.array([[0.0], [0.0], [number]])], [np.zeros((1, 3)), 1.0]])

    schedule = ChunkSchedule(length_m=2.0, behind_m=4.0, most=16)
    for number in range(8):
        schedule.add(number, pose_of)
    assert (schedule.waiting, schedule.open) == ([[0, 1, 2], [3, 4, 5]], [6, 7])
    assert schedule.due(pose_of(7)[:3, 3], pose_of) == [[0, 1, 2]]
    schedule.freeze([0, 1, 2])
    assert schedule.live == [3, 4, 5, 6, 7]
    again = ChunkSchedule(2.0, 4.0, 16)
    again.restore(schedule.state())
    assert again == schedule
    for number in range(8, 40):
        schedule.add(number, lambda _: np.eye(4))  # standing still
    assert max(len(chunk) for chunk in schedule.waiting) == 16 // 4 + 1
    assert schedule.due(np.zeros(3), lambda _: np.eye(4)) == [[3, 4, 5]]
