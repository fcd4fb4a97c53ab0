"""The contract of a mapper, on three keyframes with true depth and poses: report, renders, file, determinism."""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from plyfile import PlyData

from bench import registry
from bench.authoring import probes
from bench.authoring.verdict import Candidate, Check, ContractBrokenError, Note
from bench.io.array_store import ArrayStore
from bench.runs.folder import OTHER_FILES
from bench.types import DepthMap, Float, Keyframe, Map, MappingReport, PinholeView, RenderedView, Trajectory

_KEYFRAMES = 3
_SEED = 0


@dataclass(frozen=True)
class Mapped:
    """A finished map, the reports of its keyframes, what it showed of the newest one before the end, seconds each."""

    mapper: Any
    reports: list[MappingReport]
    newest: RenderedView
    seconds: float


@dataclass
class Subject:
    """The mapper under test and the keyframes it learns from."""

    candidate: Candidate

    @cached_property
    def dataset(self) -> Any:
        dataset = self.candidate.other("dataset")
        probes.require_frames(dataset, _KEYFRAMES)
        return dataset

    @cached_property
    def keyframes(self) -> list[Keyframe]:
        truth = self.dataset.ground_truth()
        found = []
        for k in range(_KEYFRAMES):
            T = np.eye(4) if truth is None or len(truth) < len(self.dataset) else truth.T_world_cam[k]
            depth = self.dataset.true_depth(k)
            if depth is None:
                depth = self.dataset.lidar_depth(k)
            shape = (self.dataset.camera.height, self.dataset.camera.width)
            known = np.full(shape, np.nan, np.float32) if depth is None else depth
            found.append(Keyframe(self.dataset.frame(k), DepthMap(known, "truth"), self.dataset.true_sky(k), T))
        return found

    @cached_property
    def mapped(self) -> Mapped:
        return self.map(self.keyframes)

    def view(self, T_world_cam: Float) -> PinholeView:
        return PinholeView.of(self.dataset.camera, T_world_cam)

    def depth(self, mapper: Any, k: int) -> Map | None:
        """What a render of keyframe ``k`` is given as its depth: that of a mapper which needs it."""
        return self.keyframes[k].depth.depth if mapper.needs_depth else None

    @cached_property
    def folder(self) -> tempfile.TemporaryDirectory[str]:
        """Where mappers keep what is not in memory."""
        return tempfile.TemporaryDirectory()

    def started(self, store: ArrayStore | None = None) -> Any:
        """A fresh instance, started with the losses of the surroundings and a store, which is empty if none is
        given."""
        mapper = self.candidate.build()
        losses = [registry.build(loss, "loss") for loss in self.candidate.run.several("loss")]
        mapper.start(self.dataset.camera, losses, _SEED)
        mapper.use_store(store or ArrayStore(Path(tempfile.mkdtemp(dir=self.folder.name))))
        return mapper

    def map(self, keyframes: list[Keyframe], break_after: int | None = None) -> Mapped:
        """Learn from the keyframes in the order of calls of a run.

        With ``break_after`` a fresh instance resumes after so many keyframes, from what a checkpoint would hold.
        """
        store = ArrayStore(Path(tempfile.mkdtemp(dir=self.folder.name)))
        mapper, reports, begin = self.started(store), [], time.perf_counter()
        numbers = [keyframe.frame.number for keyframe in keyframes]
        poses = np.stack([keyframe.T_world_cam for keyframe in keyframes])
        times = np.array([keyframe.frame.timestamp for keyframe in keyframes])
        for k, keyframe in enumerate(keyframes, 1):
            mapper.update_poses(Trajectory(poses[:k], np.array(numbers[:k]), times[:k]))
            reports.append(mapper.add_keyframe(keyframe, numbers[:k]))
            if k == break_after:
                state = probes.through_a_file(mapper.state())
                mapper = self.started(store)
                mapper.restore(state, iter(keyframes[:k]))
        seconds = (time.perf_counter() - begin) / len(keyframes)
        newest = mapper.render_frame(numbers[-1], False, self.view(keyframes[-1].T_world_cam), self.depth(mapper, -1))
        mapper.update_poses(Trajectory(poses, np.array(numbers), times))
        mapper.finish()
        return Mapped(mapper, reports, newest, seconds)


def _require_view(subject: Subject, rendered: Any, what: str) -> None:
    if not isinstance(rendered, RenderedView):
        raise ContractBrokenError(
            f"{what} is {type(rendered).__name__}",
            "bench.types.RenderedView",
            "RenderedView(color, depth, alpha)",
            "render",
        )
    size = (subject.dataset.camera.height, subject.dataset.camera.width)
    for name, shape in (("color", (*size, 3)), ("depth", size), ("alpha", size)):
        image = getattr(rendered, name)
        if not isinstance(image, np.ndarray) or image.shape != shape or image.dtype != np.float32:
            got = f"{image.dtype} {image.shape}" if isinstance(image, np.ndarray) else type(image).__name__
            mend = "color.permute(1, 2, 0).cpu().numpy(), float32"
            raise ContractBrokenError(f"{what}: {name} is {got}", f"float32 numpy {shape}", mend, "render")
        if not np.isfinite(image).all():
            raise ContractBrokenError(
                f"{what}: {name} holds NaN or infinity",
                "finite images",
                "look for log(0), 0/0 or a diverged optimizer",
                "render",
            )
    lowest, highest = (min(rendered.color.min(), rendered.alpha.min()), max(rendered.color.max(), rendered.alpha.max()))
    if lowest < -1e-3 or highest > 1 + 1e-3 or rendered.depth.min() < 0:
        raise ContractBrokenError(
            f"{what}: colour and alpha lie in {lowest:.3g} to {highest:.3g}, depth from {rendered.depth.min():.3g}",
            "colour and alpha in [0, 1], depth not negative",
            "color.clamp(0, 1)",
            "render",
        )


def _empty(subject: Subject) -> str:
    mapper = subject.started()
    size = mapper.size()
    if not isinstance(size, dict) or any(not isinstance(count, int) for count in size.values()):
        raise ContractBrokenError(
            f"size() is {size!r}", "whole numbers by name", 'return {"points": len(self.points)}', "size"
        )
    if any(size.values()):
        raise ContractBrokenError(
            f"{_in_words(size)} before the first keyframe",
            "0: start() empties the map",
            "reset in start()",
            "start",
        )
    mapper.finish()
    return "nothing in the map before the first keyframe; finish() works on an empty map"


def _in_words(size: dict[str, int]) -> str:
    return ", ".join(f"{count} {what}" for what, count in size.items()) or "a map without a size"


def _learns(subject: Subject) -> str | Note:
    for k, report in enumerate(subject.mapped.reports):
        if not isinstance(report, MappingReport) or not np.isfinite(report.psnr_db):
            raise ContractBrokenError(
                f"add_keyframe() of keyframe {k} returned {report!r}",
                "bench.types.MappingReport with a finite PSNR in dB",
                "return MappingReport(psnr_db, losses)",
                "add_keyframe",
            )
    last = subject.mapped.reports[-1]
    text = f"{last.psnr_db:.2f} dB on the newest of {_KEYFRAMES} keyframes; {_in_words(subject.mapped.mapper.size())}"
    image = subject.keyframes[-1].frame.left
    flat = _psnr(np.broadcast_to(image.mean(axis=(0, 1)) / 255, image.shape), image)
    return text if last.psnr_db > flat else Note(f"{text}: a flat colour would have {flat:.2f} dB")


def _psnr(color: Any, image: Any) -> float:
    error = np.asarray(color, np.float64) - image / 255.0
    return float(-10 * np.log10(max((error**2).mean(), 1e-10)))


def _honest(subject: Subject) -> str:
    image = subject.keyframes[-1].frame.left
    found, said = _psnr(subject.mapped.newest.color, image), subject.mapped.reports[-1].psnr_db
    if abs(found - said) > 0.1:
        raise ContractBrokenError(
            f"the report says {said:.2f} dB, the render has {found:.2f} dB",
            "the PSNR of the newest keyframe's whole left image, as the map is when add_keyframe returns",
            "render once more after the last step, over all pixels and channels",
            "add_keyframe",
        )
    return f"the report's PSNR is that of the render ({found:.2f} dB)"


def _renders(subject: Subject) -> str:
    mapper, pose = subject.mapped.mapper, subject.keyframes[0].T_world_cam
    depth = subject.depth(mapper, 0)
    first = mapper.render(subject.view(pose), depth)
    _require_view(subject, first, "render() of the first keyframe")
    elsewhere = pose.copy()
    elsewhere[:3, 3] += 1000.0
    _require_view(subject, mapper.render(subject.view(elsewhere), depth), "render() far away")
    again = mapper.render(subject.view(pose), depth)
    probes.require_same(first.color, again.color, "the same view rendered twice", "render")
    return "finite, in range, also where nothing is; the same view twice: the same bits"


def _repeats(subject: Subject) -> str:
    again = subject.map(subject.keyframes)
    probes.require_same(subject.mapped.newest.color, again.newest.color, "the same seed twice", "add_keyframe")
    return f"the same seed twice: the same map ({_in_words(again.mapper.size())})"


def _inputs(subject: Subject) -> str | Note:
    first = subject.keyframes[0]
    left, depth, T = first.frame.left.copy(), first.depth.depth.copy(), first.T_world_cam.copy()
    blind = [
        replace(k, frame=replace(k.frame, right=None if k.frame.right is None else np.zeros_like(k.frame.right)))
        for k in subject.keyframes
    ]
    without_right = subject.map(blind)
    probes.require_untouched("the input left", left, first.frame.left, "add_keyframe")
    probes.require_untouched("the input depth", depth, first.depth.depth, "add_keyframe")
    probes.require_untouched("the input T_world_cam", T, first.T_world_cam, "add_keyframe")
    if not probes.same_arrays(without_right.newest.color, subject.mapped.newest.color):
        if not subject.mapped.mapper.uses_right_images:
            raise ContractBrokenError(
                "with black right images the map is another one",
                "the map of left images alone, or uses_right_images = True in the class",
                "uses_right_images = True: then right views of keyframes are not scored as unseen ones",
                "add_keyframe",
            )
        return Note("left as they were; it learns from right images: the right camera is scored at held-out frames")
    return "left as they were; right images are not looked at"


def _saves(subject: Subject) -> str | Note:
    mapper = subject.mapped.mapper
    if mapper.map_file is None:
        return Note("no map_file: runs with it save no map")
    if Path(mapper.map_file).name != mapper.map_file or mapper.map_file in OTHER_FILES:
        raise ContractBrokenError(
            f"map_file is {mapper.map_file!r}",
            "the name of a file that a run has no other use for",
            'map_file = "map.npz"',
            "save",
        )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / mapper.map_file
        mapper.save(path)
        if not path.is_file():
            raise ContractBrokenError(
                "save(path) wrote no file", "a file at exactly that path", "write to path", "save"
            )
        if path.suffix != ".ply":
            return f"{mapper.map_file} with {path.stat().st_size} bytes"
        count = PlyData.read(str(path))["vertex"].count
    gaussians = mapper.size().get("gaussians", count)
    if count != gaussians:
        raise ContractBrokenError(
            f"the PLY has {count} vertices, size() says {gaussians} Gaussians",
            "equal numbers",
            "save all of them",
            "save",
        )
    return f"PLY with {count} vertices"


def _resumes(subject: Subject) -> str | Note:
    if subject.mapped.mapper.state() is None:
        return Note("no state(): runs with it have no checkpoints, and begin anew after a kill")
    again = subject.map(subject.keyframes, break_after=_KEYFRAMES - 1)
    probes.require_same(subject.mapped.newest.color, again.newest.color, "with a break, and without", "restore")
    poses = [keyframe.T_world_cam for keyframe in subject.keyframes]
    view, mappers = subject.view(poses[0]), (subject.mapped.mapper, again.mapper)
    ends = [mapper.render(view, subject.depth(mapper, 0)).color for mapper in mappers]
    probes.require_same(ends[0], ends[1], "after finish(), with a break and without", "restore")
    return f"a fresh instance goes on from state() after {_KEYFRAMES - 1} keyframes: the same bits"


def _speed(subject: Subject) -> Note:
    camera = subject.dataset.camera
    return Note(f"{subject.mapped.seconds:.2f} s per keyframe at {camera.width}x{camera.height}")


def checks_of(subject: Subject) -> tuple[Check[Subject], ...]:
    """All checks of a mapper; of one that builds nothing, that it builds nothing."""
    if not subject.candidate.build().wants_keyframes:
        return (Check("empty map", _empty),)
    return (
        Check("empty map", _empty, essential=True),
        Check("learns", _learns, essential=True),
        Check("honest report", _honest),
        Check("renders", _renders),
        Check("determinism", _repeats),
        Check("resumes", _resumes),
        Check("inputs", _inputs),
        Check("saves", _saves),
        Check("speed", _speed),
    )
