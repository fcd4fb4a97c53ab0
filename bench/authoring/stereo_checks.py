"""The contract of a stereo backbone: shape, units, sign, the NaN rule, determinism, memory and speed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from bench.authoring import cost, probes
from bench.authoring.units import Medians, explain_sizes, explain_units, is_accurate
from bench.authoring.verdict import Candidate, Check, ContractBrokenError, Note
from bench.contracts.stereo import StereoBackbone, shape_hint
from bench.errors import BenchError
from bench.types import Image, Map, StereoFrame

SIZE, ODD_SIZE = (256, 480), (261, 417)
"""Height and width of the test pairs; networks with wide pooling need about 256 rows."""
SHIFTS_PX = (5, 17, 41)
_LEAST_KNOWN = 0.3
# A foreground at 24 px before a background at 4 px tells the left image's disparity from the right's.
_NEAR_PX, _FAR_PX = 24, 4

Pair = tuple[Image, Image]


@dataclass
class Subject:
    """The backbone under test; a ``DepthSource`` without ``disparity`` is tested on a data set's frames alone."""

    candidate: Candidate

    @cached_property
    def source(self) -> Any:
        return self.candidate.build()

    @property
    def gain(self) -> float | None:
        """The setting stereo.gain as stereo=onnx has it (null is 1); None of a plugin without it."""
        config = self.candidate.config
        return float(getattr(config, "gain", None) or 1) if hasattr(config, "gain") else None

    @property
    def sign_cure(self) -> str:
        """How to turn the sign."""
        return "return -d (of an ONNX file: stereo.gain=-1)" if self.gain is None else f"set stereo.gain={-self.gain:g}"

    @property
    def matches(self) -> bool:
        return isinstance(self.source, StereoBackbone)

    def disparity(self, pair: Pair, source: Any = None) -> Map:
        """The answer for a pair that begins a sequence of its own, checked for shape and dtype."""
        source = self.source if source is None else source
        source.start(probes.PairDataset(*pair))
        answer = source.disparity(*pair)
        hint = shape_hint(np.shape(np.squeeze(answer)), pair[0].shape[:2]) if isinstance(answer, np.ndarray) else ""
        if hint:
            raise ContractBrokenError(
                f"disparity returned shape {answer.shape}",
                f"numpy array {pair[0].shape[:2]} of float32",
                hint,
                "disparity",
            )
        probes.require_array(answer, pair[0].shape[:2], np.float32, "disparity")
        return answer


def _shape(subject: Subject) -> str:
    for size in (SIZE, ODD_SIZE):
        subject.disparity(probes.shifted_pair(*size, SHIFTS_PX[1]))
    return f"float32, the image's size, also at {ODD_SIZE[1]}x{ODD_SIZE[0]}"


def _nan_rule(subject: Subject) -> str:
    pairs = {
        "a textured pair": probes.shifted_pair(*SIZE, SHIFTS_PX[1]),
        "two equal images": (probes.texture(*SIZE), probes.texture(*SIZE)),
        "two grey images": (np.full((*SIZE, 3), 128, np.uint8),) * 2,
        "two black images": (np.zeros((*SIZE, 3), np.uint8),) * 2,
    }
    refused = ""
    for what, pair in pairs.items():
        try:
            answer = subject.disparity((pair[0].copy(), pair[1].copy()))
        except BenchError:
            # A pair without anything to match is no pair of a data set; networks refuse what is zero everywhere.
            if what == "a textured pair":
                raise
            refused = f"; {what} are refused"
            continue
        if what == "a textured pair" and not np.isfinite(answer).any():
            raise ContractBrokenError(
                "NaN for every pixel of a textured pair",
                "a disparity for most pixels: this pair is easy",
                "look where NaN begins: a division by zero, a logarithm of 0, images that are not normalised as in "
                "training, weights that were not loaded, half precision that overflows",
                "disparity",
            )
        with np.errstate(invalid="ignore"):
            counts = {"infinite": np.isinf(answer), "negative": answer < 0, "zero": answer == 0}
        found = [f"{np.mean(where):.1%} {name}" for name, where in counts.items() if where.any()]
        if found:
            mend = "np.where(np.isfinite(d) & (d > 0), d, np.float32(np.nan))"
            if counts["negative"].mean() > 0.5:
                mend = f"the sign is wrong: {subject.sign_cure}"
            raise ContractBrokenError(
                f"for {what} the disparity is {' and '.join(found)}",
                "positive and finite, or NaN for unknown; infinite distance is unknown too",
                mend,
                "disparity",
            )
    return f"unknown is NaN, also in equal, grey and black images{refused}"


def _units(subject: Subject) -> str | Note:
    found: list[Medians] = []
    for size in (SIZE, ODD_SIZE):
        medians, known = [], []
        for shift in SHIFTS_PX:
            answer = subject.disparity(probes.shifted_pair(*size, shift, seed=shift))
            # What the right image does not show, and a window's half width beside it, is left out.
            seen = answer[8:-8, shift + 16 : -8]
            known.append(float(np.isfinite(seen).mean()))
            medians.append(float(np.nanmedian(seen)) if known[-1] > 0 else float("nan"))
        if min(known) < _LEAST_KNOWN:
            least = int(np.argmin(known))
            raise ContractBrokenError(
                f"only {known[least]:.0%} of a textured wall at {SHIFTS_PX[least]} px is known",
                f"at least {_LEAST_KNOWN:.0%} (this pair is easy), for disparities up to {max(SHIFTS_PX)} px",
                "raise the largest disparity or loosen the test that throws pixels away; are the images exchanged?",
                "disparity",
            )
        found.append(Medians(np.array(SHIFTS_PX, float), np.array(medians), size))
        explain_units(found[-1], subject.gain)
    explain_sizes(*found)
    texts = [", ".join(f"{median:.1f}" for median in medians.answered) for medians in found]
    true = ", ".join(map(str, SHIFTS_PX))
    text = f"walls at {true} px: medians {texts[0]} px; at {ODD_SIZE[1]}x{ODD_SIZE[0]}: {texts[1]} px"
    return text if all(map(is_accurate, found)) else Note(f"{text}: the right units, but not accurate")


def _left_image(subject: Subject) -> str | Note:
    """A near card before a far wall: where its left edge shows in the answer."""
    height, width = SIZE
    far_left, far_right = probes.shifted_pair(height, width, _FAR_PX, seed=1)
    card = probes.texture(height // 2, width // 3, seed=2)
    top, at = height // 4, width // 2
    rows = slice(top, top + len(card))
    far_left[rows, at : at + card.shape[1]] = card
    far_right[rows, at - _NEAR_PX : at - _NEAR_PX + card.shape[1]] = card
    answer = subject.disparity((far_left, far_right))[rows]
    with np.errstate(invalid="ignore"):
        near = np.flatnonzero((answer[8:-8] > (_NEAR_PX + _FAR_PX) / 2).mean(axis=0) > 0.5)
    if len(near) < card.shape[1] / 4:
        return Note(f"a near card of {card.shape[1]} px was not found, so the image could not be told")
    in_left = abs(float(np.median(near)) - (at + card.shape[1] / 2))
    in_right = abs(float(np.median(near)) - (at - _NEAR_PX + card.shape[1] / 2))
    if in_right < in_left:
        raise ContractBrokenError(
            f"a near card lies {_NEAR_PX} px too far left: this is the right image's disparity",
            "the left image's disparity: d[y, x] belongs to left[y, x]",
            "exchange the images, or take the network's other output",
            "disparity",
        )
    return "a near card lies where the left image shows it"


def _repeats(subject: Subject) -> str:
    pair, other = probes.shifted_pair(*SIZE, SHIFTS_PX[1]), probes.shifted_pair(*SIZE, SHIFTS_PX[0], seed=9)
    first = subject.disparity(pair)
    kept = first.copy()
    subject.disparity(other)
    if not probes.same_arrays(first, kept):
        raise ContractBrokenError(
            "the next call overwrote the array that the call before had returned",
            "an array of its own for each call",
            "return result.copy()",
            "disparity",
        )
    later = subject.source.disparity(*pair)
    probes.require_same(first, subject.disparity(pair), "the same pair twice, each after start()", "disparity")
    if not subject.source.temporal and not probes.same_arrays(first, later):
        raise ContractBrokenError(
            "the same pair gave another disparity after another frame",
            "a disparity that depends on its pair alone, or the class attribute temporal = True",
            "write temporal = True in the class: the cache must not mix up such frames",
            "",
        )
    fresh = probes.in_thread(lambda: subject.disparity(pair, subject.candidate.build()))
    probes.require_same(first, fresh, "a fresh instance in a background thread", "disparity")
    return "twice, and by a fresh instance in a background thread: the same bits"


def _inputs(subject: Subject) -> str:
    pair = probes.shifted_pair(*SIZE, SHIFTS_PX[1])
    given = (pair[0].copy(), pair[1].copy())
    subject.disparity(given)
    for what, before, after in zip(("the input left", "the input right"), pair, given, strict=True):
        probes.require_untouched(what, before, after, "disparity")
    return "left as they were"


def _depth(subject: Subject) -> str:
    """Depth of a wall from its disparity, by the camera's focal length and baseline, worked out here: f b / d."""
    pair = probes.shifted_pair(*SIZE, SHIFTS_PX[1])
    inside = (slice(8, -8), slice(SHIFTS_PX[1] + 16, -8))
    disparity = float(np.nanmedian(subject.disparity(pair)[inside]))
    dataset = probes.PairDataset(*pair)
    subject.source.start(dataset)
    median = float(np.nanmedian(_checked_depth(subject, dataset.frame(0), 0, dataset.camera)[inside]))
    expected = dataset.camera.fx * 0.54 / disparity
    text = f"{disparity:.1f} px is {median:.2f} m for fx {dataset.camera.fx:.1f} px and a baseline of 0.54 m"
    if not 0.98 * expected < median < 1.02 * expected:
        raise ContractBrokenError(
            text,
            f"fx * baseline / disparity = {expected:.2f} m, of the camera that depth() is given",
            "leave depth() to StereoBackbone, or use camera.fx and camera.baseline",
            "depth",
        )
    return text


def _checked_depth(subject: Subject, frame: StereoFrame, position: int, camera: Any) -> Map:
    answer = subject.source.depth(frame, position, camera)
    depth = getattr(answer, "depth", answer)
    if depth is answer:
        raise ContractBrokenError(
            f"depth returned {type(answer).__name__}",
            "bench.types.DepthMap(depth, source)",
            "return DepthMap(depth.astype(np.float32), type(self).__name__)",
            "depth",
        )
    probes.require_array(depth, frame.left.shape[:2], np.float32, "depth")
    with np.errstate(invalid="ignore"):
        if (depth <= 0).any() or np.isinf(depth).any():
            raise ContractBrokenError(
                "depth is zero, negative or infinite somewhere",
                "positive and finite, or NaN for unknown",
                "np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(np.nan))",
                "depth",
            )
    return depth


def _on_the_dataset(subject: Subject) -> str | Note:
    """Depth against the exact depth of the surroundings' data set, where it has one."""
    dataset = subject.candidate.other("dataset")
    subject.source.start(dataset)
    depth = _checked_depth(subject, dataset.frame(0), 0, dataset.camera)
    true = dataset.true_depth(0)
    known = float(np.isfinite(depth).mean())
    if true is None or not (np.isfinite(depth) & np.isfinite(true)).any():
        return Note(f"{dataset.label}, frame 0: depth at {known:.0%} of the pixels")
    error = float(np.nanmedian(np.abs(depth - true) / true))
    text = f"{dataset.label}, frame 0: depth at {known:.0%} of the pixels, median error {error:.1%}"
    if error > 0.3 and not subject.matches:
        raise ContractBrokenError(text, "metres along the optical axis", "return metres, not disparity", "depth")
    return text if error <= 0.3 else Note(f"{text}: too small a picture for it, or a network far from home")


def _cost(subject: Subject) -> str | Note:
    pair = probes.shifted_pair(*probes.FULL_SIZE, SHIFTS_PX[2])
    subject.source.start(probes.PairDataset(*pair))
    measured = cost.cost_of(lambda: subject.source.disparity(*pair))
    return cost.describe_cost(measured, np.prod(probes.FULL_SIZE) * 4 / 1e6, "disparity")


def _weights(subject: Subject) -> str:
    return probes.weights_of(subject.source)


_OF_A_MATCHER: tuple[Check[Subject], ...] = (
    Check("shape and dtype", _shape, essential=True),
    Check("inputs", _inputs),
    Check("NaN rule", _nan_rule),
    Check("units and sign", _units),
    Check("of the left image", _left_image),
    Check("determinism", _repeats),
    Check("depth", _depth),
    Check("on the data set", _on_the_dataset),
    Check("memory and speed", _cost),
    Check("weights", _weights),
)
_OF_A_DEPTH_SOURCE: tuple[Check[Subject], ...] = (
    Check("on the data set", _on_the_dataset),
    Check("weights", _weights),
)


def checks_of(subject: Subject) -> tuple[Check[Subject], ...]:
    """All checks of a matcher or network; those of depth alone for a source that does not match images."""
    return _OF_A_MATCHER if subject.matches else _OF_A_DEPTH_SOURCE
