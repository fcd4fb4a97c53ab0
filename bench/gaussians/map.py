"""The map as one thing: every column of its Gaussians, and all that grows, shrinks, splits or moves them."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import torch

from bench.gaussians.ply import read_ply, write_ply
from bench.gaussians.schema import HARMONICS, MEAN, QUATERNION, degree_of, planes_of
from bench.gaussians.spherical_harmonics import band_rotation
from bench.geometry import se3
from bench.types import Float, Trajectory

if TYPE_CHECKING:
    from torch import Tensor

_COLUMNS = ("planes", "first_moment", "second_moment", "birth_depth", "anchor")
SKY = -2
"""``anchor`` of the sky's Gaussians."""
_SKY_STEP_M = 1 / 256
_SPARE = 1.25
"""Columns get so many times the room that they need when they outgrow theirs."""


@dataclass(frozen=True)
class MapMotion:
    """What moved: keyframes, their Gaussians, and the largest move of a keyframe in metres and in degrees."""

    keyframes: int
    gaussians: int
    largest_m: float
    largest_deg: float


class GaussianMap:
    """N Gaussians; the last axis of each column has one entry per Gaussian.

    ``planes`` (P, N): the parameters (``bench/gaussians/schema.py``). ``first_moment``, ``second_moment`` (P, N):
    Adam's. ``birth_depth`` (N,): metres from the camera when it was seeded. ``anchor`` (N,) int32: which keyframe
    seeded it, as an index of the keyframes that were added, or -1 for none, or ``SKY``. Gaussians of one keyframe are
    neighbours, in the order of the keyframes; the sky comes first. It is infinitely far: it belongs to no keyframe, and
    moves with whoever looks at it (``seen_from``). Values may be changed in place; columns are not replaced from
    outside. They are views into buffers with room to spare, so that the map grows and shrinks in place: rows may be
    farther apart than N.
    """

    planes: Tensor
    first_moment: Tensor
    second_moment: Tensor
    birth_depth: Tensor
    anchor: Tensor
    changes: int = 0
    """Grows whenever Gaussians come, go or change places."""

    def __init__(self, sh_degree: int, device: str | torch.device) -> None:
        rows = planes_of(sh_degree)
        self._buffers = {name: torch.zeros(rows, 0, device=device) for name in _COLUMNS[:3]}
        self._buffers["birth_depth"] = torch.zeros(0, device=device)
        self._buffers["anchor"] = torch.zeros(0, dtype=torch.int32, device=device)
        self._resize(0)
        self._numbers = np.zeros(0, dtype=np.int64)
        self._T_world_cam = np.zeros((0, 4, 4))
        self._sky_about = np.zeros(3)

    def __len__(self) -> int:
        return self.planes.shape[1]

    @property
    def device(self) -> torch.device:
        """Where all columns are."""
        return self.planes.device

    @property
    def sh_degree(self) -> int:
        """Degree of the spherical harmonics, 0 to 3."""
        return degree_of(len(self.planes))

    @property
    def keyframes(self) -> npt.NDArray[np.int64]:
        """Numbers (K,) of the keyframes that ``anchor`` means."""
        return self._numbers

    @property
    def poses(self) -> Float:
        """``T_world_cam`` (K, 4, 4) of these, as the Gaussians stand for them."""
        return self._T_world_cam

    def add(self, number: int, T_world_cam: Float, planes: Tensor, depths: Tensor) -> None:
        """New Gaussians of keyframe ``number`` at this pose (4, 4), seen at ``depths`` (M,) metres.

        ``planes`` (P', M) may have a lower degree than the map; the missing harmonics are zero. A keyframe that is
        known keeps the pose that its Gaussians stand for.
        """
        again = np.flatnonzero(self._numbers == number)
        if not len(again):
            self._numbers = np.append(self._numbers, number)
            self._T_world_cam = np.concatenate([self._T_world_cam, T_world_cam[None]])
        row = int(again[0]) if len(again) else len(self._numbers) - 1
        self._append(planes, depths, torch.full((len(depths),), row, dtype=torch.int32, device=self.device))
        if len(again):
            self.keep(torch.argsort(self.anchor, stable=True))

    def add_sky(self, place: Float, planes: Tensor, depths: Tensor, cell: float) -> None:
        """New Gaussians (P', M) of the sky as seen from ``place`` (3,) at ``depths`` (M,) metres.

        Only those in directions where the sky has none yet, in cells of ``cell`` radians: what is wrong along the edges
        of things in front of the sky is not mended by more of it, and it would grow with every keyframe.
        """
        self._look_from(place)
        planes, depths = planes.to(self.device), depths.to(self.device)
        known, new = (
            _direction_cells(means - torch.from_numpy(about).to(means)[:, None], cell)
            for means, about in ((self.planes[MEAN, : self.sky], self._sky_about), (planes[MEAN], place))
        )
        fresh = ~torch.isin(new, known)
        planes, depths = planes[:, fresh], depths[fresh]
        if not len(depths):
            return
        self._append(planes, depths, torch.full((len(depths),), SKY, dtype=torch.int32, device=self.device))
        self.keep(torch.argsort(self.anchor, stable=True))

    @property
    def sky(self) -> int:
        """How many Gaussians show the sky: the first ones."""
        return int(torch.searchsorted(self.anchor, torch.tensor(SKY, device=self.device).to(self.anchor), right=True))

    @property
    def drawn(self) -> Tensor:
        """``planes``, as ``ChunkedMap.drawn``."""
        return self.planes

    def seen_from(self, place: Float) -> Tensor:
        """``planes`` with the sky about ``place`` (3,)."""
        self._look_from(place)
        return self.planes

    def keep(self, which: Tensor) -> None:
        """Drop all Gaussians but those of the (N,) bool mask, or of the indices (M,)."""
        indices = torch.nonzero(which)[:, 0] if which.dtype == torch.bool else which
        for name in _COLUMNS:
            column = getattr(self, name)
            for row in column if column.ndim == 2 else [column]:  # row by row: no second copy of the map
                row[: len(indices)] = row[indices]
        self._resize(len(indices))

    def extended(self, others: Sequence[Tensor]) -> Tensor:
        """Parameters (P, N + M) of this map's Gaussians and, after them, of ``others`` (P, M_k), M in all.

        Good until the map grows, shrinks or is extended again: it is the map's own buffer.
        """
        end = len(self)
        self._reserve("planes", end + sum(each.shape[1] for each in others))
        self._resize(len(self))
        for each in others:
            self._buffers["planes"][:, end : end + each.shape[1]] = each
            end += each.shape[1]
        return self._buffers["planes"][:, :end]

    def assign(self, which: Tensor, keyframes: Tensor) -> None:
        """Make the Gaussians of the indices (M,) those of other keyframes: rows (M,) of ``keyframes``."""
        self.anchor[which] = keyframes.to(self.anchor)
        self.keep(torch.argsort(self.anchor, stable=True))

    def forget_keyframes(self, which: npt.NDArray[np.bool_]) -> None:
        """Forget keyframes of the mask (K,), which no Gaussian has any more."""
        stays = ~which
        rows = torch.from_numpy(np.cumsum(stays) - 1).to(self.anchor)
        self.anchor.copy_(torch.where(self.anchor < 0, self.anchor, rows[self.anchor.clamp_min(0).long()]))
        self._numbers, self._T_world_cam = self._numbers[stays], self._T_world_cam[stays]

    def replace(self, gone: Tensor, children: Tensor, parents: Tensor) -> None:
        """Put ``children`` (P', M) in, and take out those of the (N,) bool mask ``gone``.

        ``parents`` (M,): index of the Gaussian whose keyframe and birth depth each child inherits. A split names the
        parents in ``gone`` too, a clone does not. Adam's moments of the children are zero.
        """
        depths, anchor = self.birth_depth[parents], self.anchor[parents]
        self.keep(~gone)
        self._append(children, depths, anchor)
        self.keep(torch.argsort(self.anchor, stable=True))

    def select(self, which: Tensor | slice) -> GaussianMap:
        """A map of some Gaussians by mask, indices or slice, which shares no memory with this one."""
        chosen = copy.copy(self)
        indices = torch.arange(len(self), device=self.device)[which]
        chosen._buffers = {name: getattr(self, name)[..., indices].contiguous() for name in _COLUMNS}
        chosen._resize(len(indices))
        return chosen

    def follow(self, trajectory: Trajectory, least_m: float, least_deg: float) -> MapMotion:
        """Move Gaussians rigidly with their keyframes to where the trajectory has these now; Adam's moments turn too.

        A keyframe's Gaussians follow once its pose differs from the one they stand for by more than ``least_m`` metres
        or ``least_deg`` degrees; until then the difference adds up. A keyframe that the trajectory lacks stays.
        """
        anchors, places = matches(self._numbers, trajectory.numbers)
        old, new = self._T_world_cam[anchors], trajectory.T_world_cam[places]
        moved_m = np.linalg.norm(new[:, :3, 3] - old[:, :3, 3], axis=1)
        moved_deg = np.rad2deg(se3.rotation_angle(np.swapaxes(old[:, :3, :3], 1, 2) @ new[:, :3, :3]))
        moves = (new != old).any(axis=(1, 2)) & ((moved_m > least_m) | (moved_deg > least_deg))
        rows = torch.arange(len(self._numbers) + 1, dtype=torch.int32, device=self.device)
        ends = torch.searchsorted(self.anchor, rows).cpu().numpy()
        for anchor, before, after in zip(anchors[moves], old[moves], new[moves], strict=True):
            self._move(slice(int(ends[anchor]), int(ends[anchor + 1])), before, after)
        self._T_world_cam = self._T_world_cam.copy()  # a selection may share it
        self._T_world_cam[anchors[moves]] = new[moves]
        return MapMotion(
            keyframes=int(moves.sum()),
            gaussians=int(np.diff(ends)[anchors[moves]].sum()),
            largest_m=float(moved_m[moves].max(initial=0.0)),
            largest_deg=float(moved_deg[moves].max(initial=0.0)),
        )

    def arrays(self) -> dict[str, npt.NDArray[Any]]:
        """All columns, and numbers (K,) and poses (K, 4, 4) of the keyframes: good until the map is changed, since on
        the CPU they are no copies."""
        columns = {name: getattr(self, name).cpu().numpy() for name in _COLUMNS}
        return columns | {"numbers": self._numbers, "T_world_cam": self._T_world_cam, "sky_about": self._sky_about}

    def state(self) -> dict[str, Any]:
        """The same as tensors that share no memory with the map."""
        return {name: torch.from_numpy(np.array(values, order="C")) for name, values in self.arrays().items()}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from what ``state`` gave."""
        device = self.device
        self._buffers = {name: state[name].to(device) for name in _COLUMNS}
        self._resize(len(state["anchor"]))
        self._numbers, self._T_world_cam = state["numbers"].numpy(), state["T_world_cam"].numpy()
        self._sky_about = state["sky_about"].numpy()

    def save(self, path: Path) -> None:
        """Write the parameters as a PLY file in the layout of 3DGS, with the sky about the origin."""
        write_ply(path, self.seen_from(np.zeros(3)), self.sky)

    def keyframes_of_all(self) -> npt.NDArray[np.int32]:
        """(N,) number of the keyframe of each Gaussian, -1 for none."""
        return keyframes_of(self.anchor.cpu().numpy(), self._numbers)

    @classmethod
    def load(cls, path: Path, device: str | torch.device = "cpu") -> GaussianMap:
        """A map that ``save`` or another 3DGS program wrote; ``BenchError`` for a file that is none.

        The file has the parameters alone: moments are zero, birth depths NaN, and no Gaussian has a keyframe.
        """
        planes, sky = read_ply(path)
        loaded = cls(degree_of(len(planes)), device)
        count = planes.shape[1]
        anchor = torch.full((count,), -1, dtype=torch.int32, device=device)
        anchor[:sky] = SKY
        loaded._append(planes, torch.full((count,), torch.nan), anchor)
        return loaded

    def _look_from(self, place: Float) -> None:
        """Move the sky to about ``place`` (3,), to the nearest step of ``_SKY_STEP_M``.

        In such steps float32 adds without rounding, as far as 64 km: the way to a place makes no difference.
        """
        about = np.round(place / _SKY_STEP_M) * _SKY_STEP_M
        if (about != self._sky_about).any():
            shift = torch.from_numpy((about - self._sky_about).astype(np.float32)).to(self.device)
            means = self.planes[MEAN, : self.sky]
            means.copy_((means / _SKY_STEP_M).round() * _SKY_STEP_M + shift[:, None])
            self._sky_about = about

    def _append(self, planes: Tensor, depths: Tensor, anchor: Tensor) -> None:
        missing = len(self.planes) - len(planes)
        planes = torch.nn.functional.pad(planes.to(self.device), (0, 0, 0, missing))
        moments = torch.zeros_like(planes)
        self._grow(dict(zip(_COLUMNS, (planes, moments, moments, depths.to(self.device), anchor), strict=True)))

    def _grow(self, new: dict[str, Tensor]) -> None:
        """Put columns of M Gaussians behind those that are there."""
        count, end = len(self), len(self) + len(new["anchor"])
        for name, values in new.items():
            self._reserve(name, end)
            self._buffers[name][..., count:end] = values
        self._resize(end)

    def _reserve(self, name: str, count: int) -> None:
        """Room for so many Gaussians in a column's buffer; what is in it stays."""
        buffer = self._buffers[name]
        if buffer.shape[-1] >= count:
            return
        # Rows that are a multiple of 4 KiB apart fall on the same lines of the processor's cache.
        larger = torch.zeros(*buffer.shape[:-1], int(count * _SPARE) | 16, dtype=buffer.dtype, device=buffer.device)
        larger[..., : buffer.shape[-1]] = buffer
        self._buffers[name] = larger

    def _resize(self, count: int) -> None:
        """The first ``count`` entries of the buffers are the map."""
        self.changes += 1
        for name in _COLUMNS:
            setattr(self, name, self._buffers[name][..., :count])

    def _move(self, which: slice, before: Float, after: Float) -> None:
        """Apply the motion that takes pose ``before`` to pose ``after`` to some Gaussians: x -> R x + t, q -> r q, and
        their colours' harmonics turn."""
        R = after[:3, :3] @ before[:3, :3].T

        def tensor(values: Float) -> Tensor:
            return torch.from_numpy(values.astype(np.float32)).to(self.device)

        # As a small change of position, turned about the camera: far from the origin float32 has no digits to lose.
        about, shift = tensor(before[:3, 3:]), tensor(after[:3, 3:] - before[:3, 3:])
        self.planes[MEAN, which] += tensor(R - np.eye(3)) @ (self.planes[MEAN, which] - about) + shift
        self._turn_moments(MEAN, which, tensor(R))
        # The product r q as a matrix; it is orthogonal, so the length of q, which is free, stays.
        columns = se3.quaternion_product(se3.rotation_to_quaternion(R), np.eye(4))
        product = tensor(np.roll(columns.T, 1, axis=(0, 1)))  # from x y z w to w x y z
        self.planes[QUATERNION, which] = product @ self.planes[QUATERNION, which]
        self._turn_moments(QUATERNION, which, product)
        if self.sh_degree:
            bands = band_rotation(torch.from_numpy(R), self.sh_degree)
            harmonics = torch.kron(bands, torch.eye(3, dtype=bands.dtype)).to(self.planes)  # the same per channel
            self.planes[HARMONICS, which] = harmonics @ self.planes[HARMONICS, which]
            self._turn_moments(HARMONICS, which, harmonics)

    def _turn_moments(self, planes: slice, which: slice, matrix: Tensor) -> None:
        """The K parameters ``planes`` of the Gaussians ``which`` have been multiplied by an orthogonal (K, K) matrix.

        Gradients turn with the parameters, and so does their mean, the first moment. Of their second moments Adam knows
        only the diagonal; it turns as if the gradient's components were uncorrelated.
        """
        self.first_moment[planes, which] = matrix @ self.first_moment[planes, which]
        self.second_moment[planes, which] = matrix.square() @ self.second_moment[planes, which]


def keyframes_of(anchor: npt.NDArray[np.int32], numbers: npt.NDArray[np.int64]) -> npt.NDArray[np.int32]:
    """Numbers (N,) of the keyframes that the rows ``anchor`` (N,) of ``numbers`` (K,) mean, -1 for none."""
    return np.append(numbers, -1)[np.where(anchor < 0, len(numbers), anchor)].astype(np.int32)


def _direction_cells(offsets: Tensor, cell: float) -> Tensor:
    """Which cell of a grid with so wide cells, laid over the unit sphere, each direction (3, N) points to, as (N,)."""
    x, y, z = torch.floor(offsets / (offsets.norm(dim=0) * cell)).long()
    return (x * (1 << 21) + y) * (1 << 21) + z


def matches(numbers: np.ndarray, of_trajectory: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Indices i, j of all pairs ``numbers[i] == of_trajectory[j]``; the second is without repetitions."""
    order = np.argsort(of_trajectory)
    at = np.searchsorted(of_trajectory, numbers, sorter=order)
    known = np.flatnonzero(at < len(order))
    places = order[at[known]]
    same = of_trajectory[places] == numbers[known]
    return known[same], places[same]
