"""A stereo pair side by side with its matched corners: in a rectified one every line is level."""

from __future__ import annotations

import cv2
import numpy as np

from bench.types import Float, Image

_LINES = 40
_GOOD_PX, _BAD_PX = 0.5, 2.0
_GREEN, _YELLOW, _RED = (70, 220, 90), (250, 210, 60), (250, 70, 60)


def rows_picture(left: Image, right: Image, start: Float, there: Float) -> Image:
    """Left and right (H, W, 3) beside each other, with lines between corners ``start`` and ``there``, (M, 2) pixels.

    At most 40 lines, spread over the rows; green where rows differ by under 0.5 px, yellow up to 2 px, red beyond.
    """
    picture = np.ascontiguousarray(np.hstack([left, right]))
    by_row = np.argsort(start[:, 1], kind="stable")
    for i in by_row[np.unique(np.linspace(0, len(by_row) - 1, _LINES).astype(int))] if len(by_row) else ():
        off = abs(there[i, 1] - start[i, 1])
        color = _GREEN if off < _GOOD_PX else _YELLOW if off <= _BAD_PX else _RED
        a, b = (tuple(np.rint(xy).astype(int).tolist()) for xy in (start[i], there[i] + (left.shape[1], 0)))
        cv2.line(picture, a, b, color, 1, cv2.LINE_AA)
        for place in (a, b):
            cv2.circle(picture, place, 3, color, 1, cv2.LINE_AA)
    return picture
