"""Videos of a run: ground truth and render beside each other, and a flight through its map."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation, RotationSpline

from bench.errors import BenchError
from bench.evaluation.saved_run import SavedRunFolder
from bench.figures.depth_colors import colored, depth_scale, known_depth, limit_of
from bench.geometry import se3
from bench.io.atomic import atomic_path
from bench.runs.folder import View, color_to_8bit
from bench.saved_map import SavedMap
from bench.types import Float, Image, Trajectory

BETWEEN = 3
"""Pictures of a flight for each step from frame to frame."""
_CRF = 18
"""Of x264: 0 is without loss, 51 the worst."""
_WIDE = 1.5
MPEG4 = "MPEG-4 Part 2 (mp4v), which players show and browsers don't; `pip install 'bgs-slam-bench[video]'` gives H.264"


def has_h264() -> bool:
    """Whether the extra ``[video]`` is installed."""
    return importlib.util.find_spec("imageio_ffmpeg") is not None


@contextmanager
def video_file(path: Path, fps: float) -> Iterator[Callable[[Image], None]]:
    """Give what appends a picture, RGB uint8 (H, W, 3) of one size; the file is written whole or not at all.

    H.264 by ffmpeg in a process of its own, where ``[video]`` is installed, else ``MPEG4``. An odd side is one pixel
    longer. Raises ``BenchError`` where it can't be written.
    """
    writer: _Writer | None = None
    with atomic_path(path) as temporary:

        def add(picture: Image) -> None:
            nonlocal writer
            height, width = picture.shape[:2]
            even = np.pad(picture, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
            if writer is None:
                writer = (_H264 if has_h264() else _Mpeg4)(temporary, even.shape[1], even.shape[0], fps)
            writer.add(even)

        try:
            yield add
        finally:
            if writer is not None:
                writer.close()


class _Mpeg4:
    def __init__(self, path: Path, width: int, height: int, fps: float) -> None:
        self._video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), fps, (width, height))
        if not self._video.isOpened():
            raise BenchError(f"OpenCV can't write videos at {path.parent}. Check the folder, or install [video].")

    def add(self, picture: Image) -> None:
        self._video.write(cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))

    def close(self) -> None:
        self._video.release()


class _H264:
    def __init__(self, path: Path, width: int, height: int, fps: float) -> None:
        import imageio_ffmpeg

        # Browsers show this form of colours alone, and begin before they have the whole file.
        more = ["-crf", str(_CRF), "-movflags", "+faststart"]
        size = (width, height)
        self._frames = imageio_ffmpeg.write_frames(
            str(path), size, fps=fps, codec="libx264", quality=None, macro_block_size=2, output_params=more
        )
        self._frames.send(None)

    def add(self, picture: Image) -> None:
        self._frames.send(np.ascontiguousarray(picture))

    def close(self) -> None:
        self._frames.close()


_Writer = _Mpeg4 | _H264


def side_by_side(run: SavedRunFolder, camera: View, max_depth_m: float) -> Iterator[tuple[Image, int]]:
    """Of each saved view a picture with the data set's image, the render and, where saved, its depth, and of how many
    views they are; below each other where they are wide. ``max_depth_m`` NaN: as in figures.

    Raises ``BenchError`` for a run without renders of this camera.
    """
    numbers = run.rendered(camera)
    if not numbers:
        raise BenchError(f"{run.path} has no {camera} renders to show. Choose --view, or run again with rerun=true.")
    some = sorted({numbers[0], numbers[len(numbers) // 2], numbers[-1]})
    rendered = [depth for number in some if (depth := run.depth(camera, number)) is not None]
    if np.isnan(max_depth_m):
        max_depth_m = limit_of([known_depth(run.dataset, run.position_of(n)) for n in some], rendered) or 1.0
    scale = depth_scale(max_depth_m)
    held_out = set(run.frames.loc[run.frames["heldout"], "number"].tolist())
    for number in numbers:
        view = run.views_of(number, [camera])[0]
        if view.render is None:
            raise BenchError(f"{run.path} has no {camera} render of frame {number}. Run again with rerun=true.")
        words = f"render, frame {number}, {camera}{', held out' if number in held_out else ''}"
        panes = [_titled(view.image, "ground truth"), _titled(view.render, words)]
        if rendered:
            depth = np.full(view.render.shape[:2], np.nan, np.float32) if view.depth is None else view.depth
            panes.append(_titled(colored(depth, scale), f"depth, 0 to {max_depth_m:.0f} m"))
        is_wide = view.render.shape[1] > _WIDE * view.render.shape[0]
        yield np.concatenate(panes, axis=0 if is_wide else 1), len(numbers)


def fly_through(saved: SavedMap, smooth_frames: float) -> Iterator[tuple[Image, int]]:
    """The map from along the run's trajectory, and of how many pictures the flight is."""
    assert saved.trajectory is not None
    path = camera_path(saved.trajectory, BETWEEN, smooth_frames)
    for pose in path:
        yield color_to_8bit(saved.render(pose).color), len(path)


def camera_path(trajectory: Trajectory, between: int, smooth_frames: float) -> Float:
    """Poses ``T_world_cam`` (M, 4, 4) on a smooth way along a trajectory, ``between`` for each step of a frame number.

    Positions and rotations are averaged with a Gaussian of ``smooth_frames`` frames (0: not), and splines go through
    them: the camera's speed and turning have no jumps. ``BenchError`` for fewer than two poses.
    """
    if len(trajectory) < 2:
        raise BenchError(f"A flight needs two poses or more, and the trajectory has {len(trajectory)}.")
    places, quaternions = (
        trajectory.T_world_cam[:, :3, 3],
        se3.rotation_to_quaternion(trajectory.T_world_cam[:, :3, :3]),
    )
    # q and -q are one rotation: each with the sign of the one before, so that they can be averaged.
    turns = np.where((quaternions[1:] * quaternions[:-1]).sum(1) < 0, -1.0, 1.0)
    quaternions[1:] *= np.cumprod(turns)[:, None]
    places, quaternions = (_averaged(values, smooth_frames) for values in (places, quaternions))
    at = trajectory.numbers.astype(np.float64)
    times = np.linspace(at[0], at[-1], int(at[-1] - at[0]) * between + 1)
    poses = np.tile(np.eye(4), (len(times), 1, 1))
    poses[:, :3, 3] = CubicSpline(at, places)(times)
    poses[:, :3, :3] = RotationSpline(at, Rotation.from_quat(quaternions))(times).as_matrix()
    return poses


def _averaged(values: npt.NDArray[np.float64], smooth_frames: float) -> Float:
    if smooth_frames == 0:
        return values
    return np.asarray(gaussian_filter1d(values, smooth_frames, axis=0, mode="nearest"), np.float64)


def _titled(picture: Image, text: str) -> Image:
    """A copy with words at its upper left."""
    titled, font, size = picture.copy(), cv2.FONT_HERSHEY_SIMPLEX, max(0.35, picture.shape[1] / 1800)
    (width, height), below = cv2.getTextSize(text, font, size, 1)
    cv2.rectangle(titled, (0, 0), (width + 8, height + below + 6), (0, 0, 0), cv2.FILLED)
    cv2.putText(titled, text, (4, height + 3), font, size, (255, 255, 255), 1, cv2.LINE_AA)
    return titled
