"""A run as it is made, for the viewer of rerun.io."""

from __future__ import annotations

import importlib.util
import itertools
import logging
import socket
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import cv2
import numpy as np

from bench.contracts.map_view import MapView
from bench.contracts.observer import FrameDone, Observer, RunBegins, numbers_in
from bench.errors import BenchError, require_between, require_least
from bench.registry import PluginConfig, register
from bench.types import Float, Image, Map, Trajectory

log = logging.getLogger(__name__)

_FOUND_S = 2.0
_COLORS = {"estimate": (66, 133, 244), "ground_truth": (52, 168, 83), "keyframes": (234, 67, 53)}


@dataclass(frozen=True)
class RerunConfig(PluginConfig):
    """Where it goes, and how much of it."""

    save: str | None = field(default=None, metadata={"path": True})
    """An .rrd file that is written, to be opened later (`rerun FILE.rrd`); null: the run is sent to a viewer ..."""
    url: str = "rerun+http://127.0.0.1:9876/proxy"
    """... that listens here; `rerun --bind 127.0.0.1` starts one."""
    every: int = 1
    """Images of every so-manieth frame."""
    max_side_px: int = 640
    """Images are shrunk to this width or height."""
    jpeg_quality: int = 75
    """Of the images, 1 to 100."""
    map_every: int = 5
    """The map with every so-manieth keyframe."""
    max_gaussians: int = 50_000
    """Of a larger map every n-th Gaussian is shown, so that there are at most so many."""

    def __post_init__(self) -> None:
        require_least("viewer", self, every=1, max_side_px=16, map_every=1, max_gaussians=1)
        require_between("viewer", self, 1, 100, "jpeg_quality")
        if self.save is not None and Path(self.save).suffix != ".rrd":
            raise BenchError(f"viewer.save={self.save} must end in .rrd.")


@register("viewer", "rerun", config=RerunConfig)
class Rerun(Observer):
    """Images, depth, trajectory, keyframes, Gaussians and losses for the viewer of rerun, live or as a file."""

    def __init__(self, config: RerunConfig) -> None:
        self.config = config
        self._keyframes: list[int] = []
        if config.save is None:
            _require_viewer(config.url)

    @classmethod
    def unavailable_reason(cls) -> str | None:
        """None, or that the package is missing and how to get it."""
        missing = importlib.util.find_spec("rerun") is None
        return "rerun-sdk is not installed. Run: pip install 'bgs-slam-bench[rerun]'" if missing else None

    def begin(self, run: RunBegins) -> None:
        """Open the file, or the way to the viewer. A resumed run writes a file beside the one before its break: opened
        together they are one recording."""
        import rerun as rr  # takes a second

        self._rr = rr
        self._stream = rr.RecordingStream("bgs-slam-bench", recording_id=f"{run.config_hash}-{run.folder.name}")
        if self.config.save is None:
            self._stream.connect_grpc(self.config.url)
        else:
            file = _free(Path(self.config.save)) if run.first else Path(self.config.save)
            file.parent.mkdir(parents=True, exist_ok=True)
            self._stream.save(file)
            log.info("the viewer's recording is written to %s", file)
        camera = run.camera
        self._scale = min(1.0, self.config.max_side_px / max(camera.width, camera.height))
        small = camera.scaled(self._scale)
        self._size = (small.width, small.height)
        self._log("world", rr.ViewCoordinates.RDF, static=True)
        pinhole = rr.Pinhole(image_from_camera=small.intrinsics, resolution=self._size, image_plane_distance=1.0)
        self._log("world/camera", pinhole, static=True)
        if run.ground_truth is not None:
            self._line("ground_truth", run.ground_truth.T_world_cam, static=True)

    def frame(self, done: FrameDone) -> None:
        """Image and pose of the frame; of a keyframe its depth, the trajectory and now and then the map."""
        rr, number = self._rr, int(done.row["number"])
        self._stream.set_time("frame", sequence=number)
        if done.T_world_cam is not None:
            T = done.T_world_cam
            self._log("world/camera", rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3]))
        if number % self.config.every == 0 or done.keyframe is not None:
            self._log("world/camera/image", self._picture(done.frame.left))
        for name, value in done.scalars().items():
            self._log(f"numbers/{name}", rr.Scalars(value))
        if done.keyframe is not None and done.trajectory is not None:
            self._log("world/camera/depth", self._depth(done.keyframe.depth.depth))
            if len(self._keyframes) % self.config.map_every == 0:
                self._map(done.map)
            self._keyframes.append(number)
            self._poses(done.trajectory)

    def optimised(self, trajectory: Trajectory, map: MapView | None) -> None:
        """The final trajectory and map."""
        self._poses(trajectory)
        self._map(map)

    def scored(self, metrics: Mapping[str, Any]) -> None:
        """The metrics as text."""
        lines = "\n".join(f"{name}: {value:g}" for name, value in numbers_in(metrics).items())
        self._log("metrics", self._rr.TextDocument(lines), static=True)

    def end(self) -> None:
        """Send or write what is waiting."""
        self._stream.flush(timeout_sec=10.0)
        self._stream.disconnect()

    def _log(self, entity: str, what: Any, static: bool = False) -> None:
        self._rr.log(entity, what, static=static, recording=self._stream)

    def _picture(self, image: Image) -> Any:
        small = cv2.resize(image, self._size, interpolation=cv2.INTER_AREA)
        _, jpeg = cv2.imencode(".jpg", small[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, self.config.jpeg_quality])
        return self._rr.EncodedImage(contents=jpeg.tobytes(), media_type="image/jpeg")

    def _depth(self, depth: Map) -> Any:
        small = np.nan_to_num(cv2.resize(depth, self._size, interpolation=cv2.INTER_NEAREST), nan=0.0)
        return self._rr.DepthImage((small * 256).clip(0, 65535).astype(np.uint16), meter=256.0)

    def _poses(self, trajectory: Trajectory) -> None:
        self._line("estimate", trajectory.T_world_cam)
        places = trajectory.of_frames(self._keyframes).T_world_cam[:, :3, 3]
        self._log("world/keyframes", self._rr.Points3D(places, colors=[_COLORS["keyframes"]], radii=[0.1]))

    def _line(self, name: str, poses: Float, static: bool = False) -> None:
        strip = self._rr.LineStrips3D([poses[:, :3, 3]], colors=[_COLORS[name]])
        self._log(f"world/{name}", strip, static)

    def _map(self, map: MapView | None) -> None:
        points = None if map is None else map.points(self.config.max_gaussians)
        if points is not None:
            shown = self._rr.Points3D(points.positions, colors=points.colors, radii=points.radii.clip(0.01, 1.0))
            self._log("world/map", shown)


def _free(file: Path) -> Path:
    """The file, or where it is there the first of FILE-2, FILE-3, ... that is not."""
    others = (file.with_stem(f"{file.stem}-{count}") for count in itertools.count(2))
    return next(each for each in itertools.chain([file], others) if not each.exists())


def _require_viewer(url: str) -> None:
    """Raise ``BenchError`` where nobody listens: what is sent would be lost without a word."""
    try:
        place = urlsplit(url)
        socket.create_connection((place.hostname or "", place.port or 9876), timeout=_FOUND_S).close()
    except (OSError, ValueError) as error:
        raise BenchError(
            f"viewer.url={url}: no viewer listens there ({error}). Start one with `rerun --bind 127.0.0.1`, or write a "
            "file, viewer.save=FILE.rrd."
        ) from error
