"""``bgs-bench data check``: is a data set on disk whole? Read as its loader reads it, one verdict a sequence."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from bench import registry
from bench.contracts.dataset import Dataset, SequenceOnDisk
from bench.data.rows_picture import rows_picture
from bench.errors import BenchError
from bench.io.atomic import write_image
from bench.io.frame_range import describe
from bench.io.images import IMAGE_SUFFIXES, image_size
from bench.io.scans import check_scan_file
from bench.plugin_config import plugin_config_from
from bench.tracking.row_offset import matched_rows

_DECODED = 3
"""Frames of a sequence that are decoded: the first, one in the middle, the last."""
_SHOWN = 5
_FARTHEST_ROWS_PX = 2.0
"""Median row offset of matched corners; stereo matchers look for a pixel in its own row."""
T = TypeVar("T")


@dataclass(frozen=True)
class Verdict:
    """What was found: ``wrong`` must be mended before a run, ``told`` is good to know. Both are sentences."""

    name: str
    about: str
    wrong: tuple[str, ...]
    told: tuple[str, ...]


@dataclass(frozen=True)
class CheckOptions:
    """How thoroughly: ``decode`` every frame and not three of each sequence; a folder for pictures of matched rows."""

    decode: bool = False
    pictures: Path | None = None


def check_folder(root: Path, loader: str, options: CheckOptions) -> Iterator[Verdict]:
    """One verdict a sequence in ``root``, by the data set ``loader``, or by all whose layout it has ("").

    Raises ``BenchError`` where nothing is there.
    """
    if not root.is_dir():
        raise BenchError(f"{root} does not exist or is no folder. Give the root of a data set.")
    found = [(name, one) for name in ([loader] if loader else registry.names("dataset")) for one in _found(root, name)]
    if not found:
        raise BenchError(
            f"{root} holds no sequence in the layout of {loader or 'any data set'}. Give the folder that dataset.root "
            "of a run would be."
        )
    for name, one in found:
        yield _check(root, name, one, options)


def _found(root: Path, name: str) -> Iterable[SequenceOnDisk]:
    loader = registry.lookup("dataset", name).cls
    assert issubclass(loader, Dataset)
    return loader.sequences_in(root)


def _check(root: Path, name: str, one: SequenceOnDisk, options: CheckOptions) -> Verdict:
    title = " ".join([name, *(value for value in one.settings.values() if value)])
    wrong = _files_at_fault(one.folders)
    try:
        config = plugin_config_from("dataset", {"name": name, "root": str(root), **one.settings})
        dataset = registry.build(config, "dataset")
    except BenchError as error:
        # What the loader stumbles over first may be one of the files told already.
        return Verdict(title, "can't be read", tuple(dict.fromkeys([*wrong, str(error)])), ())
    return verdict_on(title, dataset, options, wrong)


def verdict_on(title: str, dataset: Dataset, options: CheckOptions, wrong: list[str]) -> Verdict:
    """What a loaded data set's frames say, beside what is known to be ``wrong``."""
    last = len(dataset) - 1
    positions = range(last + 1) if options.decode else sorted(set(np.linspace(0, last, _DECODED).astype(int).tolist()))
    unread = _each(positions, lambda position: _read(dataset, position), "frames can't be read")
    told, off = ((), ()) if unread else _about_rows(title, dataset, options.pictures)
    truth, camera = dataset.ground_truth(), dataset.camera
    posed = 0 if truth is None else len(truth.numbers)
    about = f"{describe(dataset.numbers)}, {camera.width}x{camera.height}, {posed} poses"
    return Verdict(title, about, (*wrong, *unread, *off), (*told, *dataset.lacks(), *dataset.to_tell()))


def _about_rows(title: str, dataset: Dataset, pictures: Path | None) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """What the middle pair says of the rectification: good to know, and wrong."""
    frame = dataset.frame(len(dataset) // 2)
    if frame.right is None:
        return (), ()
    start, there = matched_rows(frame.left, frame.right)
    if pictures is not None:
        pictures.mkdir(parents=True, exist_ok=True)
        picture = pictures / f"{title.replace(' ', '_').replace('/', '_')}.png"
        write_image(picture, rows_picture(frame.left, frame.right, start, there))
    if not len(start):
        return (f"frame {frame.number}: no corner of one image is found in the other; rows can't be judged",), ()
    off = float(np.median(np.abs(there[:, 1] - start[:, 1])))
    said = f"frame {frame.number}: rows of {len(start)} matched corners differ by {off:.2f} px in the median"
    if off > _FARTHEST_ROWS_PX:
        return (), (f"{said}: the pair is not rectified, or not a pair",)
    return (said,), ()


def _read(dataset: Dataset, position: int) -> None:
    dataset.frame(position)
    for method in (dataset.lidar_depth, dataset.sensor_depth, dataset.true_disparity):
        method(position)


def _files_at_fault(folders: tuple[Path, ...]) -> list[str]:
    """Images and scans that are cut, empty or something else, by their headers, ends and sizes alone."""
    there = [Path(entry) for folder in folders if folder.is_dir() for entry in _files(folder)]
    images = [file for file in there if file.suffix.lower() in IMAGE_SUFFIXES]
    scans = [file for file in there if file.suffix == ".bin"]
    return [
        *_each(images, image_size, "images are at fault"),
        *_each(scans, check_scan_file, "scans are at fault"),
    ]


def _files(folder: Path) -> list[str]:
    return sorted(entry.path for entry in os.scandir(folder) if entry.is_file() and not entry.name.startswith("."))


def _each(things: Iterable[T], look: Callable[[T], object], what: str) -> list[str]:
    """What ``look`` raises for these: the first few, and how many there are."""
    found: list[str] = []
    for thing in things:
        try:
            look(thing)
        except BenchError as error:
            found.append(str(error))
    if len(found) > _SHOWN:
        return [*found[:_SHOWN], f"{len(found)} {what}; the first {_SHOWN} are told"]
    return found
