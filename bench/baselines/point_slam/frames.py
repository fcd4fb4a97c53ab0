"""What learning keeps of a mapped frame, and which points and which older frames belong to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch

from bench.baselines.point_slam.radius import QUERY_FACTOR
from bench.baselines.point_slam.rays import Rays, RaySettings, around
from bench.geometry.pinhole import directions, inside, project, to_world
from bench.types import Float, Image, Map, PinholeView, StereoCamera

if TYPE_CHECKING:
    from torch import Generator, Tensor

OVERLAP_PIXELS, _OVERLAP_SAMPLES = 200, 8
_OVERLAP_NEAR, _OVERLAP_BEHIND_M = 0.8, 0.5
_OVERLAP_BORDER_PX, _VIEW_BORDER_PX = 20.0, -4.0


@dataclass
class MappedFrame:
    """A frame with its pose (4, 4), its image (H, W, 3), depth (H, W) in metres, NaN where unknown, and the distances
    (H, W) within which its pixels add no second point."""

    number: int
    T_world_cam: Float
    image: Image
    depth: Map
    add_radius: Map

    @cached_property
    def known(self) -> npt.NDArray[np.int64]:
        """Flat indices of the pixels of known depth."""
        return np.flatnonzero(np.isfinite(self.depth))


def draw(count: int, of: int, generator: Generator) -> npt.NDArray[np.int64]:
    """``count`` random numbers below ``of``, with repetition."""
    drawn: npt.NDArray[np.int64] = torch.randint(of, (count,), generator=generator).numpy()
    return drawn


def directions_of(pixels: npt.NDArray[np.int64], camera: StereoCamera | PinholeView) -> Float:
    """Directions (R, 3) in the camera's frame, 1 long along its axis, of flat pixel indices (R,)."""
    v, u = np.divmod(pixels, camera.width)
    return directions(u, v, camera)


def places_of(frame: MappedFrame, pixels: npt.NDArray[np.int64], camera: StereoCamera, share: float = 1.0) -> Float:
    """World positions (R, 3) at so many times the depth of flat pixel indices (R,)."""
    in_camera = directions_of(pixels, camera) * (frame.depth.reshape(-1)[pixels, None] * share)
    return to_world(in_camera, frame.T_world_cam)


def in_view(positions: Float, frame: MappedFrame, camera: StereoCamera, behind_m: float) -> npt.NDArray[np.bool_]:
    """Which positions (N, 3) the frame sees, with 4 pixels around it: in front of its depth plus ``behind_m``, or
    anywhere on a ray of unknown depth."""
    u, v, z = project(positions, frame.T_world_cam, camera)
    seen = inside(u, v, z, camera, _VIEW_BORDER_PX)
    column = np.clip(np.rint(u[seen]), 0, camera.width - 1).astype(np.int64)
    row = np.clip(np.rint(v[seen]), 0, camera.height - 1).astype(np.int64)
    depth = frame.depth[row, column]
    seen[seen] = ~(z[seen] > depth + behind_m)  # also where the depth is NaN
    return seen


def overlap(frame: MappedFrame, pixels: npt.NDArray[np.int64], other: Float, camera: StereoCamera) -> float:
    """Share of samples along rays of ``frame`` (flat pixel indices) that a camera at pose ``other`` sees.

    Eight samples a ray, from 0.8 of its depth to half a metre behind it; 20 pixels at the image's border don't count.
    """
    depth = frame.depth.reshape(-1)[pixels, None, None]
    shares = np.linspace(0.0, 1.0, _OVERLAP_SAMPLES)[:, None]
    z = _OVERLAP_NEAR * depth + shares * ((1 - _OVERLAP_NEAR) * depth + _OVERLAP_BEHIND_M)
    samples = to_world(directions_of(pixels, camera)[:, None] * z, frame.T_world_cam).reshape(-1, 3)
    return float(inside(*project(samples, other, camera), camera, _OVERLAP_BORDER_PX).mean())


class Seen(NamedTuple):
    """Rays through pixels of a frame, with their depth (R,) in metres and colour (R, 3) in [0, 1]."""

    rays: Rays
    depth: Tensor
    color: Tensor


def seen_by(
    frame: MappedFrame, pixels: npt.NDArray[np.int64], camera: StereoCamera, settings: RaySettings, device: torch.device
) -> Seen:
    """The rays of flat pixel indices (R,), sampled around their depth, from the frame's pose."""

    def tensor(values: npt.NDArray[Any]) -> Tensor:
        return torch.from_numpy(values.astype(np.float32)).to(device)

    R, centre = frame.T_world_cam[:3, :3], frame.T_world_cam[:3, 3]
    depth = tensor(frame.depth.reshape(-1)[pixels])
    rays = Rays(
        tensor(centre).expand(len(pixels), 3),
        tensor(directions_of(pixels, camera) @ R.T),
        around(depth, settings),
        QUERY_FACTOR * tensor(frame.add_radius.reshape(-1)[pixels]),
    )
    return Seen(rays, depth, tensor(frame.image.reshape(-1, 3)[pixels]) / 255.0)


def window_of(
    frame: MappedFrame, keyframes: Sequence[MappedFrame], size: int, camera: StereoCamera, random: Generator
) -> list[MappedFrame]:
    """Frames that a mapped frame learns from: random ones of the keyframes that overlap with it, the last keyframe, and
    itself; ``size`` at most."""
    if not len(frame.known):
        return [frame]
    pixels = frame.known[draw(OVERLAP_PIXELS, len(frame.known), random)]
    sharing = [each for each in keyframes[:-1] if overlap(frame, pixels, each.T_world_cam, camera) > 0]
    chosen = torch.randperm(len(sharing), generator=random)[: size - 2].tolist()
    return [*(sharing[k] for k in chosen), *keyframes[-1:], frame]
