"""Keys of the disk cache: everything that a depth map or a sky mask depends on, as a hash behind its sequence's."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from bench.cache.store import SEQUENCE_KEY
from bench.code_version import code_version
from bench.machine import what_computes
from bench.registry import PluginConfig
from bench.types import DepthMap, Image, StereoCamera, StereoFrame
from bench.weights.checksum import sha256_of


def frame_identity(frame: StereoFrame, with_time: bool) -> bytes:
    """SHA-256 of a frame's number and every pixel of its pair, and of its time where that counts."""
    # SHA-256, since processors compute it: 1.5 ms per KITTI pair, a half of what BLAKE2 takes.
    digest = hashlib.sha256(repr((frame.number, frame.timestamp if with_time else None)).encode())
    _feed(digest, frame.left, frame.right)
    return digest.digest()


def _feed(digest: hashlib._Hash, *arrays: npt.NDArray[Any] | None) -> None:
    """Shape, type and every byte of the arrays, or that there is none."""
    for array in arrays:
        if array is None:
            digest.update(b"none")
            continue
        digest.update(repr((array.shape, array.dtype.str)).encode())
        digest.update(np.ascontiguousarray(array).data)


class Identity:
    """One plugin with its settings, weights, code and machine; gives the key of each answer of it."""

    def __init__(self, kind: str, plugin: type, config: PluginConfig, weights: dict[str, Path], sequence: str) -> None:
        """``sequence`` is the data set's label. Raises ``OSError`` if a file of weights can't be read."""
        same_for_all = {
            "kind": kind,
            "config": _settings(config, weights),
            "weights": {what: sha256_of(path) for what, path in weights.items()},
            "code": code_version(plugin),
            "machine": what_computes(),
            "sequence": sequence,
        }
        self._same_for_all = json.dumps(same_for_all, sort_keys=True, default=str).encode()
        self._sequence = hashlib.sha256(self._same_for_all).hexdigest()[:SEQUENCE_KEY]

    def of_frame(self, frame: StereoFrame, camera: StereoCamera) -> str:
        """Key of a frame's depth, from its number, camera and every pixel of the pair: hexadecimal."""
        digest = self._begun(camera)
        digest.update(frame_identity(frame, with_time=False))
        return self._sequence + digest.hexdigest()

    def of_image(self, image: Image, depth: DepthMap, camera: StereoCamera) -> str:
        """Key of an image's sky mask, from every pixel of image, depth and confidence: hexadecimal."""
        digest = self._begun(camera)
        _feed(digest, image, depth.depth, depth.confidence)
        return self._sequence + digest.hexdigest()

    def _begun(self, camera: StereoCamera) -> hashlib._Hash:
        digest = hashlib.sha256(self._same_for_all)
        digest.update(repr(dataclasses.astuple(camera)).encode())
        return digest


def _settings(config: PluginConfig, weights: dict[str, Path]) -> dict[str, Any]:
    """The config, without paths that name a file of weights: its contents count, wherever it lies."""
    known = {"", *(str(path) for path in weights.values())}
    by_content = {
        setting.name
        for setting in dataclasses.fields(config)
        if setting.metadata.get("path") and str(getattr(config, setting.name) or "") in known
    }
    return {name: value for name, value in dataclasses.asdict(config).items() if name not in by_content}
