"""What a folder of another system's output holds: found by names and content, or where the user says it is."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from bench.errors import BenchError
from bench.external.poses import SUFFIXES, TEXT
from bench.external.settings import NONE, SETTINGS_FILE, ScoreSettings
from bench.io.foreign import MOST_TEXT, open_plain
from bench.io.images import IMAGE_SUFFIXES
from bench.io.numpy_files import npy_header
from bench.io.torch_files import MOST_BYTES

DEPTH_SUFFIXES = (".png", ".npy")
_DEEPEST = 4
"""How many folders below the given one are looked into."""

# Names of folders, the surest first: SplaTAM keeps copies of the true images in `rgb` and `depth` beside its renders.
_COLOR = (
    *({"rendered_rgb", "rendered_image", "rendered_images", "rendered_imgs", "rendered_color", "renders", "render"},),
    *({"rendering", "renderings", "rendered", "renders_left", "rendered_left"}, {"color", "colour", "rgb", "left"}),
)
_RIGHT = ({"renders_right", "rendered_right", "right_renders", "render_right"}, {"right", "right_color"})
_DEPTH = (
    *({"rendered_depth", "renders_depth", "depth_rendered"}, {"depth", "depths", "depth_npy", "rendered_every_frame"}),
)
_BEGINNING = 65536
"""Bytes of a text file in which its first pose must lie."""
_NOT_ESTIMATES = ("gt", "truth", "times", "calib", "intrinsic", "reference")


@dataclass(frozen=True)
class Pictures:
    """Files of one kind, sorted; ``where`` is what the user knows them by, ``asked``: the user named them."""

    where: str
    files: tuple[Path, ...]
    asked: bool


@dataclass(frozen=True)
class Contents:
    """What there is to score; None for what there is not. ``outside``: links that were not opened, as they lead out of
    the folder."""

    trajectory: Path | None
    renders: Pictures | None
    renders_right: Pictures | None
    depth: Pictures | None
    outside: tuple[Path, ...] = ()


def search(folder: Path, settings: ScoreSettings) -> Contents:
    """Find trajectory, renders and depth in ``folder``.

    Links to files in the folder are followed, to folders never; nothing is opened that is no plain file in the folder,
    or is of an implausible size. Raises ``BenchError`` where there is more than one candidate, where what the user
    named is not there, and for what lies outside of the folder.
    """
    folders = list(_folders(folder))
    trajectory, outside = _trajectory(folder, folders, settings.trajectory)
    return Contents(
        trajectory,
        _pictures(folder, folders, settings.renders, _COLOR, IMAGE_SUFFIXES, "--renders"),
        _pictures(folder, folders, settings.renders_right, _RIGHT, IMAGE_SUFFIXES, "--renders-right"),
        _pictures(folder, folders, settings.depth, _DEPTH, DEPTH_SUFFIXES, "--depth"),
        outside,
    )


def _folders(top: Path) -> Iterator[tuple[Path, list[Path]]]:
    """The folder and those below it, sorted, each with its files; links to folders are not followed."""
    for place, below, names in os.walk(top):
        depth = len(Path(place).relative_to(top).parts)
        below[:] = sorted(name for name in below if not name.startswith(".")) if depth < _DEEPEST else []
        yield Path(place), [Path(place) / name for name in sorted(names) if not name.startswith(".")]


def _trajectory(
    top: Path, folders: Sequence[tuple[Path, list[Path]]], named: str
) -> tuple[Path | None, tuple[Path, ...]]:
    """The trajectory, and the links among those files that may be one which lead out of the folder."""
    if named == NONE:
        return None, ()
    if named:
        path = top / named
        if not path.exists():
            raise BenchError(f"--trajectory {named}: {path} does not exist. Give a file in {top}, or none.")
        return _inside(path, top), ()
    named_so = [file for _, files in folders for file in files if _may_be_a_trajectory(file)]
    outside = tuple(file for file in named_so if _leads_out(file, top))
    found = [file for file in named_so if file not in outside and _is_trajectory(file)]
    if len(found) > 1:
        names = ", ".join(str(file.relative_to(top)) for file in found[:5])
        raise BenchError(f"{top} holds {len(found)} files that may be the trajectory: {names}. Say --trajectory FILE.")
    return (found[0], ()) if found else (None, outside)


def _may_be_a_trajectory(file: Path) -> bool:
    name = file.name.lower()
    return (
        file.suffix.lower() in SUFFIXES and name != SETTINGS_FILE and not any(word in name for word in _NOT_ESTIMATES)
    )


def _is_trajectory(file: Path) -> bool:
    """By its name and a look at its beginning; checkpoints only under the names that systems give them."""
    name, suffix = file.name.lower(), file.suffix.lower()
    if suffix in TEXT:
        return _starts_with_a_pose(file)
    if suffix == ".npz":
        return name == "params.npz" or any(word in name for word in ("traj", "pose", "c2w"))
    if suffix == ".npy":
        return _is_pose_array(file)
    return name in ("trj_final.json", "estimated_c2w.ckpt")


def _starts_with_a_pose(file: Path) -> bool:
    """Whether the first line is 12 or 8 numbers."""
    try:
        with open_plain(file, MOST_TEXT) as opened:
            beginning = opened.read(_BEGINNING)
        lines = beginning.decode("utf-8-sig", errors="ignore").splitlines()
        words = next((line.split() for line in lines if line.strip() and not line.lstrip().startswith("#")), [])
        return len(words) in (8, 12) and bool([float(word) for word in words])
    except (OSError, ValueError, BenchError):  # ValueError: no numbers; BenchError: no plain file
        return False


def _is_pose_array(file: Path) -> bool:
    try:
        shape = npy_header(file, MOST_BYTES).shape
    except Exception:  # no array, whatever else it is; one that the user names is read, and what is wrong is told
        return False
    return len(shape) == 3 and shape[1:] in ((4, 4), (3, 4)) and shape[0] > 0


def _pictures(
    top: Path,
    folders: Sequence[tuple[Path, list[Path]]],
    named: str,
    names: Sequence[set[str]],
    suffixes: Sequence[str],
    option: str,
) -> Pictures | None:
    if named == NONE:
        return None
    if named:
        return _named_pictures(top, named, suffixes, option)
    for tier in names:
        found = []
        for place, files in folders:
            fitting = [file for file in files if file.suffix.lower() in suffixes]
            if place.name.lower() == "rendered_every_frame":  # Point-SLAM keeps colour and depth in one folder
                fitting = [file for file in fitting if file.name.startswith("depth")]
            if fitting and place != top and place.name.lower() in tier:
                found.append((place, fitting))
        if len(found) > 1:
            places = ", ".join(str(place.relative_to(top)) for place, _ in found[:5])
            raise BenchError(f"{top} holds several folders that fit {option}: {places}. Name one, or none.")
        if found:
            place, fitting = found[0]
            return Pictures(str(place.relative_to(top)), tuple(_inside(file, top) for file in fitting), asked=False)
    return None


def _named_pictures(top: Path, named: str, suffixes: Sequence[str], option: str) -> Pictures:
    path = top / named
    folder, pattern = (path.parent, path.name) if "*" in path.name else (path, "*")
    if not folder.is_dir():
        raise BenchError(f"{option} {named}: there is no folder {folder}. Give one in {top}, or none.")
    _inside(folder, top)
    files = sorted(file for file in folder.glob(pattern) if file.suffix.lower() in suffixes)
    if not files:
        raise BenchError(f"{option} {named}: {folder} holds no {' or '.join(suffixes)} file that fits. Name another.")
    return Pictures(named, tuple(_inside(file, top) for file in files), asked=True)


def _inside(path: Path, top: Path) -> Path:
    """``path``; ``BenchError`` where it, or what it is a link to, lies outside of the folder ``top``."""
    if _leads_out(path, top):
        raise BenchError(f"{path} leads out of the folder {top}. Put a copy of the file there.")
    return path


def _leads_out(path: Path, top: Path) -> bool:
    return not path.resolve().is_relative_to(top.resolve())
