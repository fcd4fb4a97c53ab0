"""A map larger than memory: Gaussians near the camera learn; those left behind lie on disk and are drawn from there."""

from __future__ import annotations

import itertools
import logging
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import torch

from bench.gaussians.levels import merged
from bench.gaussians.map import GaussianMap, MapMotion, keyframes_of, matches
from bench.gaussians.ply import write_ply_in_parts
from bench.gaussians.schema import LOG_SCALE, MEAN
from bench.geometry import se3
from bench.io.array_store import ArrayStore, DamagedError
from bench.process_memory import MemoryBudget
from bench.types import Float, Trajectory

if TYPE_CHECKING:
    from torch import Tensor

log = logging.getLogger(__name__)

_FAR_M = 60.0
"""What is farther from its keyframe (mostly sky) has a block of its own, so that the sphere of the rest is small."""
_SIGMAS = 3.0
_MOST_REACH_M = 30.0
"""So far a Gaussian reaches for its block's sphere. A few are huge: their block would be drawn from everywhere."""
_LEVELS, _CELL_PX = 2, 1.5
_SPARE = 0.1
"""Share of the run's limit of memory that blocks out of use leave to the rest of it."""


@dataclass(frozen=True)
class Block:
    """Gaussians of neighbouring keyframes as they lie in the store, and a sphere around them.

    ``keyframes``: the numbers of those that they move with. ``offset``: the sphere's centre in the camera frame of
    keyframe ``keyframes[len // 2]``, so that it moves with that; ``radius`` in metres.
    """

    name: str
    keyframes: tuple[int, ...]
    gaussians: int
    offset: tuple[float, float, float]
    radius: float


@dataclass(frozen=True)
class ChunkDrawing:
    """How what is on disk is drawn: as far as ``far_m``, and from ``detail_m`` on and twice that in fewer, larger
    Gaussians, those of cells of ``_CELL_PX`` pixels of a camera with ``focal_px``. It follows keyframes' corrections
    from ``follow_m`` metres or ``follow_deg`` degrees on, and as many as ``memory_bytes`` stay in memory out of use."""

    far_m: float
    detail_m: float
    focal_px: float
    follow_m: float
    follow_deg: float
    memory_bytes: float

    def pixel_m(self, level: int) -> float:
        """Size of a pixel at the distance from which ``level`` 1 or 2 is drawn."""
        return self.detail_m * level / self.focal_px

    def level(self, distance_m: float) -> int:
        """The level of detail at a distance: 0 (all Gaussians), 1 or 2."""
        return min(int(max(distance_m, 0.0) / self.detail_m), _LEVELS)


class ChunkedMap:
    """``live``: the Gaussians that learn, and the sky's. Others lie in ``store`` in blocks, each written once;
    ``seen_from`` gives the live ones followed by the blocks near the place of ``look_from``.

    Which blocks those are follows from places alone, and a block is drawn where its keyframes are now, whether it was
    in memory or not: so results do not depend on ``memory_bytes`` and ``budget``, up to which blocks stay in memory.
    """

    def __init__(self, live: GaussianMap, store: ArrayStore, drawing: ChunkDrawing) -> None:
        self.live = live
        self.lost: list[Block] = []
        self.budget: MemoryBudget | None = None
        self.store = store
        self._drawing = drawing
        self._blocks: OrderedDict[str, Block] = OrderedDict()
        self._made = 0
        self._at: dict[int, int] = {}  # rows of the keyframes of blocks in the two arrays below
        self._numbers = np.zeros(0, dtype=np.int64)
        self._poses = np.zeros((0, 4, 4))  # where they are now
        self._loaded: OrderedDict[tuple[str, int], Tensor] = OrderedDict()  # by name and level
        self._near: tuple[tuple[str, int], ...] = ()
        self._extended: tuple[int, tuple[tuple[str, int], ...], Tensor] | None = None

    def __len__(self) -> int:
        return len(self.live) + sum(block.gaussians for block in self._blocks.values())

    def seen_from(self, place: Float) -> Tensor:
        """Parameters (P, N) of what is in use, with the sky about ``place`` (3,): the live Gaussians, then those of the
        blocks near by. The live ones may be changed in place."""
        seen = self.live.seen_from(place)
        if not self._near:
            return seen
        known = self._extended
        if known is None or known[:2] != (self.live.changes, self._near):
            planes = self.live.extended([self._planes_of(*each) for each in self._near])
            self._extended = known = (self.live.changes, self._near, planes)
        return known[2]

    @property
    def sky(self) -> int:
        """How many Gaussians show the sky: the first ones."""
        return self.live.sky

    @property
    def drawn(self) -> Tensor:
        """Parameters (P, N) that ``seen_from`` gave last, the live ones as they are now: nothing is moved."""
        known = self._extended
        return self.live.planes if known is None or known[0] != self.live.changes else known[2]

    def frozen_seen_from(self, place: Float) -> Tensor:
        """Parameters (P, N) of those of ``seen_from`` that come from blocks."""
        return self.seen_from(place)[:, len(self.live) :]

    def look_from(self, place: Float) -> None:
        """From now on ``seen_from`` gives the blocks of which something is within reach of ``place`` (3,) in metres."""
        distances = self._distances(list(self._blocks.values()), place)
        drawing = self._drawing
        levels = [
            (name, drawing.level(d)) for name, d in zip(self._blocks, distances, strict=True) if d <= drawing.far_m
        ]
        self._near = tuple(levels)
        for each in self._near:
            self._planes_of(*each)  # one that turns out to be lost is not in use
        self._make_room()

    def lost_near(self, place: Float) -> list[Block]:
        """What was lost of what ``look_from`` this place (3,) should show."""
        distances = self._distances(self.lost, place)
        return [block for block, d in zip(self.lost, distances, strict=True) if d <= self._drawing.far_m]

    def keyframes_within(self, place: Float, distance_m: float) -> list[int]:
        """Numbers of the frozen keyframes at most so many metres from ``place`` (3,)."""
        return self._numbers[np.linalg.norm(self._poses[:, :3, 3] - place, axis=1) <= distance_m].tolist()

    def freeze(self, keyframes: Sequence[int]) -> None:
        """Let what lies nearest to these keyframes, of all keyframes that live, go to the store.

        Each Gaussian then belongs to a keyframe on its side; the sky stays. Raises ``BenchError`` where the store
        can't be written; the map is then as it was.
        """
        live = self.live
        leaves = np.isin(live.keyframes, keyframes)
        sky = live.sky
        rows = live.anchor[sky:].long().cpu().numpy()
        nearest = _nearest(live.planes[MEAN, sky:], live.poses[:, :3, 3])
        other_side = np.flatnonzero((leaves[nearest] != leaves[rows]) | (rows < 0))
        live.assign(torch.from_numpy(sky + other_side).to(live.device), torch.from_numpy(nearest[other_side]))
        rows = live.anchor.long().cpu().numpy()
        goes = leaves[rows] & (rows >= 0)
        means = live.planes[MEAN].double().cpu().numpy().T
        far = np.linalg.norm(means - live.poses[rows, :3, 3], axis=1) > _FAR_M
        blocks = [self._put(live.select(torch.from_numpy(goes & part).to(live.device)), leaves) for part in (~far, far)]
        self._blocks.update((block.name, block) for block in blocks if block is not None)
        self._set_poses(
            np.concatenate([self._numbers, live.keyframes[leaves]]), np.concatenate([self._poses, live.poses[leaves]])
        )
        live.keep(torch.from_numpy(~goes).to(live.device))
        live.forget_keyframes(leaves)

    def follow(self, trajectory: Trajectory) -> MapMotion:
        """As ``GaussianMap.follow`` of the live ones; blocks follow when they are next looked at."""
        rows, there = matches(self._numbers, trajectory.numbers)
        now = trajectory.T_world_cam[there]
        corrected = (now != self._poses[rows]).any(axis=(1, 2))
        self._poses[rows] = now
        moved = set(self._numbers[rows[corrected]].tolist())
        for block in self._blocks.values() if moved else ():
            if moved.intersection(block.keyframes):
                self._forget(block)
        return self.live.follow(trajectory, self._drawing.follow_m, self._drawing.follow_deg)

    def save(self, path: Path) -> None:
        """Write all parameters, but for what is lost, as a PLY file in the layout of 3DGS, a block at a time, with
        the sky about the origin."""
        for name in list(self._blocks):
            self._arrays_of(self._blocks[name])
        live, sky = self.live.seen_from(np.zeros(3)), self.live.sky
        parts = chain([live[:, :sky]], self._all_blocks(), [live[:, sky:]])
        write_ply_in_parts(path, parts, len(self), self.live.sh_degree, sky)

    def keyframes_of_all(self) -> npt.NDArray[np.int32]:
        """(N,) number of the keyframe of each Gaussian in the order of ``save``, -1 for none."""
        live, sky = self.live.keyframes_of_all(), self.live.sky
        stored = [self._arrays_of(block) for block in list(self._blocks.values())]
        blocks = [keyframes_of(arrays["anchor"], arrays["numbers"]) for arrays in stored if arrays is not None]
        return np.concatenate([live[:sky], *blocks, live[sky:]])

    def state(self) -> dict[str, Any]:
        """For a checkpoint; ``stored``: names in the store. The live Gaussians are put there, too: that takes no second
        copy of them in memory. Raises ``BenchError`` where the store can't be written."""
        live = next(name for name in (f"live-{n}" for n in itertools.count()) if name not in self.store)
        self.store.put(live, self.live.arrays())
        return {
            "live": live,
            "blocks": [asdict(block) for block in self._blocks.values()],
            "numbers": torch.from_numpy(self._numbers),
            "poses": torch.from_numpy(self._poses.copy()),
            "lost": [asdict(block) for block in self.lost],
            "made": self._made,
            "stored": [live, *self._blocks],
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Resume from what ``state`` gave; raises ``DamagedError`` where the live Gaussians are lost."""
        self.live.restore(_as_tensors(self.store.get(state["live"])))
        blocks = [Block(**block) for block in state["blocks"]]
        self._blocks = OrderedDict((block.name, block) for block in blocks)
        self.lost = [Block(**block) for block in state["lost"]]
        self._set_poses(state["numbers"].numpy(), state["poses"].numpy().copy())
        self._made = state["made"]

    def _distances(self, blocks: Sequence[Block], place: Float) -> list[float]:
        """From ``place`` (3,) to the nearest point of each block's sphere in metres, below 0 inside."""
        middle = self._poses[[self._at[block.keyframes[len(block.keyframes) // 2]] for block in blocks]]
        offsets = np.array([block.offset for block in blocks]).reshape(-1, 3)
        centers = np.einsum("nij,nj->ni", middle[:, :3, :3], offsets) + middle[:, :3, 3]
        distances = np.linalg.norm(centers - place, axis=1) - [block.radius for block in blocks]
        return list(distances.tolist())

    def _set_poses(self, numbers: npt.NDArray[np.int64], poses: Float) -> None:
        self._numbers, self._poses = numbers, poses
        self._at = {number: row for row, number in enumerate(numbers.tolist())}

    def _put(self, part: GaussianMap, leaves: npt.NDArray[np.bool_]) -> Block | None:
        """Write a block of the Gaussians of ``part``, which are of the keyframes ``leaves`` (K,); None for none."""
        if not len(part):
            return None
        part.forget_keyframes(~leaves)
        keyframes = tuple(part.keyframes.tolist())
        middle = part.poses[len(keyframes) // 2]
        means = part.planes[MEAN].double().cpu().numpy().T
        center = (means.min(0) + means.max(0)) / 2
        reach = _SIGMAS * part.planes[LOG_SCALE].max(0).values.exp().double().cpu().numpy()
        radius = float((np.linalg.norm(means - center, axis=1) + np.minimum(reach, _MOST_REACH_M)).max())
        offset = se3.inverse(middle)[:3] @ np.append(center, 1.0)
        name = f"block-{self._made:06d}"
        arrays = {key: values for key, values in part.arrays().items() if "moment" not in key}
        for level in range(1, _LEVELS + 1):
            pixel_m = self._drawing.pixel_m(level)
            arrays[f"level_{level}"] = merged(part.planes, _CELL_PX * pixel_m, pixel_m).cpu().numpy()
        self.store.put(name, arrays)
        self._made += 1
        return Block(name, keyframes, len(part), tuple(offset.tolist()), radius)

    def _arrays_of(self, block: Block) -> dict[str, npt.NDArray[Any]] | None:
        """What the store has of a block; None, and the block is lost from then on, where its file is damaged."""
        try:
            return self.store.get(block.name)
        except DamagedError as error:
            log.warning("keyframes %d to %d of the map are lost: %s", block.keyframes[0], block.keyframes[-1], error)
            self.lost.append(block)
            self._drop(block)
            return None

    def _map_of(self, block: Block, level: int = 0) -> GaussianMap | None:
        """A block as a map, where its keyframes are now; None where it is lost. Of a level above 0 all Gaussians move
        with the keyframe in the middle."""
        arrays = self._arrays_of(block)
        if arrays is None:
            return None
        names = ("planes", "birth_depth", "anchor", "numbers", "T_world_cam", "sky_about")
        state = _as_tensors({key: arrays[key] for key in names})
        if level:
            middle, count = len(block.keyframes) // 2, arrays[f"level_{level}"].shape[1]
            state |= {
                "planes": torch.from_numpy(np.array(arrays[f"level_{level}"])),
                "birth_depth": torch.zeros(count),
                "anchor": torch.zeros(count, dtype=torch.int32),
                "numbers": state["numbers"][middle : middle + 1],
                "T_world_cam": state["T_world_cam"][middle : middle + 1],
            }
        state |= {name: torch.zeros_like(state["planes"]) for name in ("first_moment", "second_moment")}
        stored = GaussianMap(self.live.sh_degree, self.live.device)
        stored.restore(state)
        rows = [self._at[number] for number in block.keyframes]
        now = Trajectory(self._poses[rows], np.array(block.keyframes), np.zeros(len(rows)))
        stored.follow(now, self._drawing.follow_m, self._drawing.follow_deg)
        return stored

    def _planes_of(self, name: str, level: int = 0) -> Tensor:
        """Parameters (P, M) of a block where its keyframes are now; none where it is lost."""
        key = (name, level)
        if key not in self._loaded and name in self._blocks:
            stored = self._map_of(self._blocks[name], level)
            if stored is not None:
                self._loaded[key] = stored.planes
        if key not in self._loaded:
            return self.live.planes[:, :0]
        self._loaded.move_to_end(key)
        return self._loaded[key]

    def _all_blocks(self) -> Iterator[Tensor]:
        for name in list(self._blocks):
            yield self._planes_of(name)
            self._make_room()

    def _make_room(self) -> None:
        """Drop blocks from memory, those used least recently first, where they are more than there may be."""
        used = set(self._near)
        unused = [each for each in self._loaded if each not in used]
        self._let_go(unused, sum(self._loaded[each].nbytes for each in unused) - self._drawing.memory_bytes)
        if self.budget is not None and self.budget.limit_gb is not None:
            self._let_go(list(self._loaded), 1e9 * (_SPARE * self.budget.limit_gb - self.budget.left_gb()))

    def _let_go(self, which: Sequence[tuple[str, int]], much: float) -> None:
        """Drop the first of these blocks from memory, until they are so many bytes or all."""
        for each in which:
            if much <= 0:
                return
            much -= self._loaded.pop(each).nbytes

    def _drop(self, block: Block) -> None:
        self._blocks.pop(block.name, None)
        self._near = tuple(each for each in self._near if each[0] != block.name)
        self._forget(block)

    def _forget(self, block: Block) -> None:
        """A block is to be read again."""
        for level in range(_LEVELS + 1):
            self._loaded.pop((block.name, level), None)
        self._extended = None


def _as_tensors(arrays: Mapping[str, npt.NDArray[Any]]) -> dict[str, Tensor]:
    return {key: torch.from_numpy(np.array(values)) for key, values in arrays.items()}


def _nearest(means: Tensor, places: Float) -> npt.NDArray[np.int64]:
    """Which of the ``places`` (K, 3) is the nearest to each of the means (3, N)."""
    there = torch.from_numpy(places).to(means.device)
    exact = "donot_use_mm_for_euclid_dist"
    parts = [torch.cdist(part.T.double(), there, compute_mode=exact).argmin(1) for part in means.split(1 << 16, dim=1)]
    return torch.cat(parts).cpu().numpy()
