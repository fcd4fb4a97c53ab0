"""Frames of a video file by number, decoded forwards: seeking in videos is not exact to the frame."""

from __future__ import annotations

import threading
from collections import OrderedDict
from pathlib import Path

import cv2
import numpy as np

from bench.errors import BenchError
from bench.io.foreign import open_plain
from bench.types import Image

_REMEMBERED = 8
"""Frames that are asked for in a slightly other order, as by several threads, are not decoded from the start."""
_MOST_BYTES = 1e12
_MP4_ATOMS = (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip")


class Video:
    """A video: ``size`` (width, height) in pixels, ``count`` of frames, and ``rate_hz`` or None."""

    def __init__(self, path: Path) -> None:
        """Raises ``BenchError`` where the file is missing or no video that OpenCV can decode."""
        if not path.exists():
            raise BenchError(f"The video {path} does not exist. Check the path.")
        with open_plain(path, _MOST_BYTES) as file:
            start = file.read(8)
        # Decoders also follow lists of addresses; only containers that hold the pictures themselves are opened.
        if not start.startswith((b"RIFF", b"\x1aE\xdf\xa3")) and start[4:] not in _MP4_ATOMS:
            raise BenchError(f"{path} is no video in MP4, MOV, AVI, MKV or WebM. Convert it, by ffmpeg for example.")
        self.path = path
        self._lock = threading.Lock()
        self._recent: OrderedDict[int, Image] = OrderedDict()
        self._open()
        get = self._capture.get
        self.size = int(get(cv2.CAP_PROP_FRAME_WIDTH)), int(get(cv2.CAP_PROP_FRAME_HEIGHT))
        rate = get(cv2.CAP_PROP_FPS)
        self.rate_hz = rate if 0 < rate < 1e4 else None
        self.count = self._counted(int(get(cv2.CAP_PROP_FRAME_COUNT)))
        if not self.count or min(self.size) <= 0:
            raise BenchError(f"{path} holds no frame that can be decoded. Convert it, by ffmpeg for example.")

    def read(self, number: int) -> Image:
        """Decode frame ``number`` (from 0) to RGB (H, W, 3); raises ``BenchError`` where the file is damaged there."""
        with self._lock:
            if number in self._recent:
                return self._recent[number]
            if number < self._next:
                self._open()
            while self._next < number and self._capture.grab():
                self._next += 1
            there, image = self._capture.read() if self._next == number else (False, None)
            if not there or image is None:
                raise BenchError(f"The video {self.path} can't be decoded at frame {number}. Convert or copy it again.")
            self._next += 1
            self._recent[number] = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8)
            if len(self._recent) > _REMEMBERED:
                self._recent.popitem(last=False)
            return self._recent[number]

    def _open(self) -> None:
        self._capture = cv2.VideoCapture(str(self.path), cv2.CAP_FFMPEG)
        self._capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)  # the calibration is of the pixels as they are stored
        self._next = 0
        if not self._capture.isOpened():
            raise BenchError(f"{self.path} is no video that can be decoded. Convert it, by ffmpeg for example.")

    def _counted(self, promised: int) -> int:
        """Some containers promise more frames than they hold: where the last one can't be had, all are counted."""
        self._capture.set(cv2.CAP_PROP_POS_FRAMES, promised - 1)
        there = self._capture.grab()
        self._open()
        if there:
            return promised
        count = 0
        while self._capture.grab():
            count += 1
        self._open()
        return count
