"""The contract of a sky segmenter: a boolean mask of the image's size, the same each time, and nothing else changed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from bench.authoring import cost, probes
from bench.authoring.verdict import Candidate, Check, Note
from bench.types import DepthMap, Image, Map, Mask

SIZES = ((96, 160), (97, 161), (61, 203))
"""Height and width of the test images."""


@dataclass
class Subject:
    """The segmenter under test."""

    candidate: Candidate

    @cached_property
    def segmenter(self) -> Any:
        return self.candidate.build()

    def mask(self, image: Image, depth: Map, segmenter: Any = None) -> Mask | None:
        """The answer for an image and its depth, checked for shape and dtype; None from one that does nothing."""
        camera = probes.PairDataset(image, image).camera
        answer = (segmenter or self.segmenter).segment(image, DepthMap(depth, "check-plugin"), camera)
        if answer is not None:
            probes.require_array(answer, image.shape[:2], np.bool_, "segment")
        return answer


def _scene(height: int, width: int) -> tuple[Image, Map]:
    """A white sky above a textured wall at 10 m; the sky's depth is unknown, and a part of the wall's."""
    image = probes.texture(height, width) // 2
    image[: height // 2] = 240
    depth = np.full((height, width), 10.0, np.float32)
    depth[: height // 2] = np.nan
    depth[-10:, :30] = np.nan
    return image, depth


def _shape(subject: Subject) -> str:
    answers = [subject.mask(*_scene(*size)) for size in SIZES]
    if all(answer is None for answer in answers):
        return "None: it finds no sky anywhere"
    return f"bool, the image's size, also at {SIZES[2][1]}x{SIZES[2][0]}"


def _inputs(subject: Subject) -> str:
    image, depth = _scene(*SIZES[0])
    given = image.copy(), depth.copy()
    subject.mask(*given)
    probes.require_untouched("the input image", image, given[0], "segment")
    probes.require_untouched("the input depth", depth, given[1], "segment")
    return "left as they were"


def _odd_scenes(subject: Subject) -> str:
    height, width = SIZES[0]
    unknown, near = np.full((height, width), np.nan, np.float32), np.full((height, width), 5.0, np.float32)
    for value in (0, 128, 255):
        image = np.full((height, width, 3), value, np.uint8)
        for depth in (unknown, near):
            subject.mask(image, depth)
    return "black, grey and white images, depth known everywhere or nowhere"


def _repeats(subject: Subject) -> str:
    scene, other = _scene(*SIZES[0]), (probes.texture(*SIZES[0], seed=5), np.full(SIZES[0], np.nan, np.float32))
    first = subject.mask(*scene)
    kept = None if first is None else first.copy()
    subject.mask(*other)
    probes.require_same(kept, first, "a mask before and after the next call", "segment")
    probes.require_same(first, subject.mask(*scene), "the same image twice", "segment")
    fresh = probes.in_thread(lambda: subject.mask(*scene, subject.candidate.build()))
    probes.require_same(first, fresh, "a fresh instance in a background thread", "segment")
    return "twice, and by a fresh instance in a background thread: the same mask"


def _on_the_dataset(subject: Subject) -> Note:
    dataset = subject.candidate.other("dataset")
    frame, depth, true = dataset.frame(0), dataset.true_depth(0), dataset.true_sky(0)
    unknown = np.full(frame.left.shape[:2], np.nan, np.float32)
    found = subject.mask(frame.left, unknown if depth is None else depth)
    if found is None or true is None:
        return Note(f"{dataset.label}, frame 0: {'no mask' if found is None else f'sky in {found.mean():.0%}'}")
    iou = (found & true).sum() / max((found | true).sum(), 1)
    return Note(f"{dataset.label}, frame 0: sky in {found.mean():.0%} of the pixels, IoU {iou:.2f} with the true sky")


def _cost(subject: Subject) -> str | Note:
    scene = _scene(*probes.FULL_SIZE)
    return cost.describe_cost(cost.cost_of(lambda: subject.mask(*scene)), np.prod(probes.FULL_SIZE) / 1e6, "segment")


def _weights(subject: Subject) -> str:
    return probes.weights_of(subject.segmenter)


def checks_of(subject: Subject) -> tuple[Check[Subject], ...]:
    """All checks of a sky segmenter."""
    return (
        Check("shape and dtype", _shape, essential=True),
        Check("inputs", _inputs),
        Check("odd scenes", _odd_scenes),
        Check("determinism", _repeats),
        Check("on the data set", _on_the_dataset),
        Check("memory and speed", _cost),
        Check("weights", _weights),
    )
