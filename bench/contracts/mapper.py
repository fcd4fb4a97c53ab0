"""Contract of a mapper: keyframes in, a map that can be rendered out."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from bench.contracts.loss import LossTerm
from bench.contracts.map_view import MapView
from bench.errors import BenchError
from bench.io.array_store import ArrayStore
from bench.process_memory import MemoryBudget
from bench.types import Event, Keyframe, Map, MappingReport, Mask, PinholeView, RenderedView, StereoCamera, Trajectory


class CannotRenderError(BenchError):
    """A view that a map can't show, with the reason: it is left out of the scores, and the run goes on."""


class MapNeeds(NamedTuple):
    """About what a run's map takes: bytes of ``map_file``, bytes that its checkpoint and store have at most, and the
    memory of the whole run in GB of 1e9 bytes."""

    map_bytes: float
    checkpoint_bytes: float
    memory_gb: float


class Mapper(ABC):
    """Builds the map from keyframes. It never sees a held-out frame or, unless it ``uses_right_images``, a
    right image."""

    wants_keyframes: bool = True
    """False for a mapper that builds nothing: then stereo and sky are not computed, and nothing is rendered."""
    map_file: str | None = None
    """Name of the file in the run folder that ``save`` writes, for example ``map.ply``; None = it saves none."""
    needs_depth: bool = False
    """True for a mapper that renders a view with the help of the view's own stereo depth (neural points)."""
    uses_right_images: bool = False
    """True for a mapper that looks at keyframes' right images: then the right camera is scored at held-out frames
    only, whose right images the map never saw."""

    @abstractmethod
    def start(self, camera: StereoCamera, losses: Sequence[LossTerm], seed: int) -> None:
        """Called once before the first keyframe; all randomness comes from ``seed``. The map is empty."""

    def use_memory_budget(self, budget: MemoryBudget) -> None:  # noqa: B027 - most mappers have nothing on disk
        """Called once after ``start``: what ``limits.memory_gb`` leaves. A mapper that can read parts of its map again
        from disk keeps fewer of them in memory when little is left; its results must not depend on it."""

    def needs(self, frames: int) -> MapNeeds | None:
        """Roughly what a run of so many frames will need, to be said before it begins; None (the default): it can't
        tell. Asked for after ``start``."""
        return None

    def weights(self) -> dict[str, Path]:
        """Files of network weights in use, by what they are for; empty (the default) for a mapper without any."""
        return {}

    @abstractmethod
    def add_keyframe(self, keyframe: Keyframe, window: Sequence[int]) -> MappingReport:
        """Learn from a new keyframe. ``window`` holds the numbers of the active keyframes, the new one included."""

    @abstractmethod
    def update_poses(self, trajectory: Trajectory) -> None:
        """The tracker's current poses. A mapper takes over those of its keyframes, and its map follows: what a keyframe
        brought into the map moves with it when its pose is corrected, by local bundle adjustment or by a closed loop.

        Called before each keyframe and once before ``finish``; a frame that the trajectory lacks is lost and stays.
        """

    @abstractmethod
    def finish(self) -> None:
        """Called once after the last keyframe, before the map is rendered and saved."""

    def final_steps(self) -> Iterator[Sequence[Event] | None]:
        """``finish`` in pieces: whenever it yields, ``state`` is whole, so that a long end can have checkpoints too. It
        yields what happened to the map meanwhile, or nothing.

        A mapper whose ``finish`` takes long writes this one, and lets ``finish`` go through it.
        """
        self.finish()
        yield None

    def use_store(self, store: ArrayStore) -> None:  # noqa: B027 - small maps need none
        """Where large pieces that never change may lie, so that neither memory nor a checkpoint need hold them; called
        once, after ``start`` and before the first keyframe. ``state`` names, as ``"stored"``, the sets of the store
        that it builds on; others that were there are removed when the checkpoint has been written."""

    def state(self) -> dict[str, Any] | None:
        """All that learning resumes from, for a checkpoint: CPU tensors, numbers, text, and lists and dicts of them.

        Asked for between keyframes, between ``final_steps`` and after the last of them; what is resumed from that one
        is only rendered and saved. None (the default): runs with this mapper have no checkpoints, and begin anew after
        a kill. The keyframes' images and depth need not be in it. Raises ``BenchError`` where the store can't be
        written: the run then goes on without checkpoints.
        """
        return None

    def restore(self, state: dict[str, Any], keyframes: Iterable[Keyframe]) -> None:
        """Resume from what ``state`` gave: what follows must be the same to the bit as without the break.

        Called after ``start`` and ``use_store``. ``keyframes`` are those that ``add_keyframe`` was given until then, in
        order, each with the pose that it had when it came; they are made anew one by one as they are asked for, with
        their depth and sky. Whoever needs none asks for none.
        """
        raise NotImplementedError(f"{type(self).__name__} gives a state() and has no restore() to resume from it")

    @abstractmethod
    def render(self, view: PinholeView, depth: Map | None = None) -> RenderedView:
        """The map as seen from a view, as numpy arrays; raises ``CannotRenderError`` for a view that it can't show.

        ``depth`` (H, W) float32 metres, NaN where unknown, is given to one that ``needs_depth``: the stereo depth of
        the view's own pair. Right views have none: one that needs depth is not asked for them.
        """

    def render_frame(self, number: int, right: bool, view: PinholeView, depth: Map | None = None) -> RenderedView:
        """The map as the left or right camera would show it in frame ``number``, for the pictures that are scored.

        ``view`` is from the tracker's pose. By default the map from there; a mapper writes this one that has learned
        more of its keyframes than their poses: exposure, corrected poses, the right camera's colours. What it says of a
        held-out frame must come from other frames.
        """
        return self.render(view) if depth is None else self.render(view, depth)

    def view(self) -> MapView | None:
        """What a tracker or keyframer that ``uses_map`` looks at: always the map of now. None (the default): it offers
        nothing. Asked for after ``start``."""
        return None

    def pictures(self) -> Iterator[tuple[str, int, Mask]]:
        """Masks to look at: of what, of which keyframe, and (H, W). They become ``views/left/WHAT/NUMBER.png`` in the
        run folder, white where True. None by default."""
        yield from ()

    def size(self) -> dict[str, int]:
        """How large the map is, as named numbers, for example ``{"gaussians": 120000}``; empty (the default) where no
        number tells."""
        return {}

    def save(self, path: Path) -> None:
        """Write the map to ``path``, for one with a ``map_file``: PLY in the standard 3DGS layout for Gaussian maps."""
        raise NotImplementedError(f"{type(self).__name__} names a map_file and has no save() to write it")

    def keyframes_of_map(self) -> npt.NDArray[np.int32] | None:
        """(N,) the number of the keyframe that each element belongs to, in the order of what ``save`` has just written,
        -1 for none (the sky): by these ``view`` shows how the map grew. None (the default): it can't tell."""
        return None
