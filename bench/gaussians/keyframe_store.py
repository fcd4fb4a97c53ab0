"""The keyframes that mapping learns from again: images, depth and sky of those that are far behind lie on disk."""

from __future__ import annotations

import itertools
from collections import OrderedDict
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import torch

from bench.io.array_store import ArrayStore
from bench.types import DepthMap, Float, Image, Keyframe, Map, StereoFrame

Packed = dict[str, npt.NDArray[Any]]
_IMAGES = ("left", "right")
_MOST_HALF = float(np.finfo(np.float16).max)


class KeyframeStore:
    """Keyframes by their frame number, in memory or in ``store``; which of them are where changes no value.

    For that, depth and confidence are rounded to float16 when a keyframe is added: depth by at most 1/2048 of itself
    (3 cm at 80 m), confidence by at most 1/4096; depth beyond 65,504 m becomes that. Images are kept to the bit.
    They lie packed in memory, too, in less than half the room. ``decoded``: how many stay as they are used after they
    were asked for, the last ones.
    """

    def __init__(self, store: ArrayStore, decoded: int = 4) -> None:
        self._store, self._most_decoded = store, decoded
        self._poses: dict[int, Float] = {}
        self._in_memory: dict[int, Packed] = {}
        self._decoded: OrderedDict[int, Keyframe] = OrderedDict()
        self._names: dict[int, str] = {}

    def add(self, keyframe: Keyframe) -> None:
        """Keep a keyframe, in memory; one of the same number is replaced."""
        number = keyframe.frame.number
        self.remove(number)
        self._in_memory[number] = _packed(keyframe)
        self._poses[number] = keyframe.T_world_cam

    def let_go(self, number: int) -> None:
        """Write a keyframe to disk, unless it is there, and drop it from memory; ``KeyError`` for one that is unknown.

        Raises ``BenchError`` when it can't be written; then it stays in memory.
        """
        self._write(number)
        self._in_memory.pop(number, None)
        self._decoded.pop(number, None)

    def __getitem__(self, number: int) -> Keyframe:
        """A keyframe with its pose of now; ``KeyError`` for one that is unknown, ``DamagedError`` if damaged."""
        pose = self._poses[number]
        keyframe = self._decoded.pop(number, None)
        if keyframe is None:
            keyframe = _unpacked(self._in_memory.get(number) or self._read(number))
        self._decoded[number] = keyframe
        while len(self._decoded) > self._most_decoded:
            self._decoded.popitem(last=False)
        return replace(keyframe, T_world_cam=pose)

    def __contains__(self, number: int) -> bool:
        return number in self._poses

    def __len__(self) -> int:
        return len(self._poses)

    def numbers(self) -> list[int]:
        """Frame numbers in the order in which the keyframes were added."""
        return list(self._poses)

    def pose(self, number: int) -> Float:
        """The ``T_world_cam`` (4, 4) of now; nothing is read from disk."""
        return self._poses[number]

    def set_pose(self, number: int, T_world_cam: Float) -> None:
        """The keyframe is at this pose from now on; ``KeyError`` for one that is unknown."""
        if number not in self._poses:
            raise KeyError(number)
        self._poses[number] = T_world_cam.copy()  # a view would keep all of its trajectory in memory

    def remove(self, number: int) -> None:
        """Forget a keyframe; its file stays, since a checkpoint may name it, until the array store discards it."""
        for part in (self._poses, self._in_memory, self._decoded, self._names):
            part.pop(number, None)

    @property
    def in_memory(self) -> int:
        """Number of keyframes whose images are in memory."""
        return len(self._in_memory.keys() | self._decoded.keys())

    def state(self) -> dict[str, Any]:
        """All that is needed to go on: those not on disk yet are written, and stay in memory.

        ``stored``: the names of their sets in the array store; ``numbers`` (K,) and ``poses`` (K, 4, 4), as tensors.
        """
        for number in self._in_memory:
            self._write(number)
        return {
            "stored": [self._names[number] for number in self._poses],
            "numbers": torch.tensor(self.numbers(), dtype=torch.int64),
            "poses": torch.from_numpy(np.array(list(self._poses.values()), np.float64).reshape(-1, 4, 4)),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from what ``state`` gave; all keyframes are on disk, and are read when they are asked for."""
        numbers = state["numbers"].tolist()
        self._in_memory.clear()
        self._decoded.clear()
        self._poses = dict(zip(numbers, state["poses"].numpy(), strict=True))
        self._names = dict(zip(numbers, state["stored"], strict=True))

    def _write(self, number: int) -> None:
        if number in self._names:
            return
        packed = self._in_memory[number]
        # Of a keyframe that was replaced, or that came after the checkpoint from which the run is resumed, the file may
        # still be there.
        names = (f"keyframe-{number:06d}-{count}" for count in itertools.count())
        name = next(name for name in names if name not in self._store)
        self._store.put(name, packed | {key: _png(packed[key]) for key in _IMAGES if key in packed})
        self._names[number] = name

    def _read(self, number: int) -> Packed:
        stored = self._store.get(self._names[number])
        return stored | {key: _image(stored[key]) for key in _IMAGES if key in stored}


def _half(values: Map) -> npt.NDArray[np.float16]:
    finite = np.isfinite(values)
    return np.where(finite, np.clip(values, -_MOST_HALF, _MOST_HALF), values).astype(np.float16)


def _packed(keyframe: Keyframe) -> Packed:
    frame, depth = keyframe.frame, keyframe.depth
    packed: Packed = {
        "number": np.array(frame.number),
        "timestamp": np.array(frame.timestamp),
        "left": _one_if_grey(frame.left),
        "depth": _half(depth.depth),
        "source": np.frombuffer(depth.source.encode(), np.uint8),
        "T_world_cam": keyframe.T_world_cam,
    }
    if frame.right is not None:
        packed["right"] = _one_if_grey(frame.right)
    if depth.confidence is not None:
        packed["confidence"] = _half(depth.confidence)
    if keyframe.sky is not None:
        packed["sky"] = np.packbits(keyframe.sky)
    return packed


def _unpacked(packed: Packed) -> Keyframe:
    depth = packed["depth"].astype(np.float32)
    confidence = packed["confidence"].astype(np.float32) if "confidence" in packed else None
    right = _in_color(packed["right"]) if "right" in packed else None
    frame = StereoFrame(int(packed["number"]), float(packed["timestamp"]), _in_color(packed["left"]), right)
    sky = None
    if "sky" in packed:
        sky = np.unpackbits(packed["sky"], count=depth.size).view(np.bool_).reshape(depth.shape)
    source = packed["source"].tobytes().decode()
    return Keyframe(frame, DepthMap(depth, source, confidence), sky, packed["T_world_cam"])


def _one_if_grey(image: Image) -> Image:
    """An image (H, W, 3), as (H, W) where its three channels are the same."""
    grey = bool((image == image[..., :1]).all())
    return np.ascontiguousarray(image[..., 0]) if grey else image


def _in_color(image: Image) -> Image:
    return image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2)


def _png(image: Image) -> Image:
    """An image as the bytes of a PNG, whose colours are in the order in which they lie."""
    # As for the pictures of a run: fast, and smaller than the default strategy at the same level.
    fast = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE]
    return np.asarray(cv2.imencode(".png", image, fast)[1], np.uint8)


def _image(png: Image) -> Image:
    return np.asarray(cv2.imdecode(png, cv2.IMREAD_UNCHANGED), np.uint8)
