"""Pad images to the sizes that a network accepts, and find the image again in what comes out."""

from __future__ import annotations

import cv2
import numpy as np

from bench.errors import require_choice
from bench.types import Image

PAD_SIDES = ("top_right", "bottom_right", "centred")

Window = tuple[slice, slice]
"""Rows and columns of the image inside the padded one."""


def pad_to(image: Image, shape: tuple[int, int], side: str) -> tuple[Image, Window]:
    """The image with its border pixels repeated up to ``shape`` = (height, width), and where it lies in that.

    ``side`` says where the new pixels go: "top_right", "bottom_right", or "centred" (all around, odd ones right and
    below). Both views shift alike, so disparities stay what they are.
    """
    require_choice("pad side", side, PAD_SIDES)
    down, across = shape[0] - image.shape[0], shape[1] - image.shape[1]
    top = {"top_right": down, "bottom_right": 0, "centred": down // 2}[side]
    left = across // 2 if side == "centred" else 0
    window = (slice(top, top + image.shape[0]), slice(left, left + image.shape[1]))
    if down == 0 and across == 0:
        return image, window
    padded = cv2.copyMakeBorder(image, top, down - top, left, across - left, cv2.BORDER_REPLICATE)
    return np.asarray(padded, np.uint8), window


def next_multiple(shape: tuple[int, int], multiple: int) -> tuple[int, int]:
    """The least height and width that are multiples of ``multiple`` and not below ``shape``."""
    height, width = (-(-side // multiple) * multiple for side in shape)
    return height, width
