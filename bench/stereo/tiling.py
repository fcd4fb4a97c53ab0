"""Match a pair strip by strip, so that a network's memory is bounded by the strip and not by the image."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from bench.contracts.stereo import Matched
from bench.stereo.resizing import Matcher
from bench.types import Image, Map


def tiled(matcher: Matcher, left: Image, right: Image, rows: int, overlap: int) -> Matched:
    """Disparity (H, W) from strips of at most ``rows`` rows; each sees ``overlap`` more rows above and below it.

    Rectified pairs match along rows, so strips keep the full width. The result is that of the whole image where the
    matcher looks at most ``overlap`` rows far; what sees further (pooling over the whole image) differs a little.
    """
    height = left.shape[0]
    strips = math.ceil(height / rows)
    if strips == 1:
        return matcher(left, right)
    # Equal strips: a last one of a few rows would have next to no context.
    borders = [round(height * i / strips) for i in range(strips + 1)]
    parts: list[Map] = []
    confidences: list[Map] = []
    for start, end in pairwise(borders):
        top, bottom = max(0, start - overlap), min(height, end + overlap)
        inside = slice(start - top, end - top)
        strip = matcher(left[top:bottom], right[top:bottom])
        parts.append(strip.disparity[inside])
        if strip.confidence is not None:
            confidences.append(strip.confidence[inside])
    return Matched(np.concatenate(parts), np.concatenate(confidences) if confidences else None)
