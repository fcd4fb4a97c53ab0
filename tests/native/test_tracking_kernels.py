"""The tracker's kernels: what their bindings check, the stereo cost in numpy, and both builds side by side."""

from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

from bench import _native
from bench.tracking.orb_tests import comparisons

CAMERA = [700.0, 700.0, 600.0, 180.0, 378.0]


def test_stereo_refinement_is_the_parabola_of_squared_differences() -> None:
    """Oracle: windows cut out and compared in float64, one shift after the other."""
    rng = np.random.default_rng(0)
    left = rng.integers(0, 256, (60, 90), dtype=np.uint8)
    blend = 0.6 * np.roll(left, -7, axis=1).astype(float) + 0.4 * np.roll(left, -8, axis=1) + 20.0
    right = np.clip(np.rint(0.7 * blend), 0, 255).astype(np.uint8)
    at = np.array([[x, y] for x in range(30, 70, 5) for y in range(10, 50, 10)])
    guess = at[:, 0] - 7 + rng.integers(-3, 4, len(at))
    octave = np.zeros(len(at), np.int64)
    disparity, rms = _native.refine_disparity([left], [right], octave, at, guess)
    for (x, y), start, found, difference in zip(at, guess, disparity, rms, strict=True):
        window = left[y - 5 : y + 6, x - 5 : x + 6].astype(float)
        cost = []
        for s in range(-5, 6):
            there = right[y - 5 : y + 6, start + s - 5 : start + s + 6].astype(float)
            cost.append((((window - window.mean()) - (there - there.mean())) ** 2).sum())
        best = int(np.argmin(cost))
        before, centre, after = cost[best - 1 : best + 2]
        shift = 0.5 * (before - after) / (before + after - 2 * centre)
        assert found == pytest.approx(x - (start + best - 5 + shift), abs=1e-3)
        assert difference == pytest.approx(np.sqrt(centre) / 11, rel=1e-4)


def test_stereo_refinement_leaves_out_what_it_can_not_search() -> None:
    image = np.random.default_rng(0).integers(0, 256, (60, 90), dtype=np.uint8)
    at = np.array([[2, 30], [45, 2], [45, 30], [45, 58]])
    disparity, _ = _native.refine_disparity([image], [image], np.zeros(4, np.int64), at, np.array([40, 40, 3, 40]))
    assert np.isnan(disparity).all()


def _wrong_shapes() -> list[tuple[str, Any]]:
    xy, octave, bits = np.zeros((5, 2)), np.zeros(5, np.int64), np.zeros((5, 4), np.uint64)
    T, points, measured = np.eye(4), np.zeros((6, 3)), np.zeros((6, 4))
    index, places, blank = np.zeros(6, np.int64), np.zeros((6, 2), np.int64), np.zeros((60, 60), np.uint8)
    tests = comparisons()
    return [
        (
            "octaves .* must match the positions",
            lambda: _native.pair_rows(xy, octave[:4], bits, xy, octave, bits, np.ones(5), 100.0, 1.0, 75),
        ),
        (
            r"band must have shape \(N,\)",
            lambda: _native.pair_rows(xy, octave, bits, xy, octave, bits, np.ones(4), 100.0, 1.0, 75),
        ),
        ("camera must be", lambda: _native.optimise_pose(CAMERA[:4], points, measured, T, 3, 4, False)),
        (
            "points and measured must have equal length",
            lambda: _native.optimise_pose(CAMERA, points[:5], measured, T, 3, 4, False),
        ),
        (
            "fixed must be at least 0",
            lambda: _native.bundle_adjust(CAMERA, T[None], 1, points, index, index, measured, [3]),
        ),
        ("must index into", lambda: _native.bundle_adjust(CAMERA, T[None], 0, points, index + 1, index, measured, [3])),
        (
            "sorted by keyframe",
            lambda: _native.bundle_adjust(
                CAMERA, np.stack([T, T]), 0, points, np.array([1, 0, 0, 0, 0, 0]), index, measured, [3]
            ),
        ),
        ("octave without an image", lambda: _native.refine_disparity([blank], [blank], index + 1, places, index)),
        ("scores in 0 .. 255", lambda: _native.bucketed(np.array([[1, 1, 300]]), 5, 30)),
        ("threshold must be between", lambda: _native.OrbExtractor(500, 4, 1.2, 255, tests)),
        ("scale_factor above 1", lambda: _native.OrbExtractor(500, 4, 1.0, 10, tests)),
        (r"tests must have shape \(4, 256\)", lambda: _native.OrbExtractor(500, 4, 1.2, 10, tests[:, :9].copy())),
    ]


@pytest.mark.parametrize(("message", "call"), _wrong_shapes(), ids=lambda x: x if isinstance(x, str) else "")
def test_wrong_input_is_refused(message: str, call: Any) -> None:
    with pytest.raises(ValueError, match=message):
        call()


_PRINT_FEATURES = """
import numpy as np
from bench import _native
from bench.tracking.orb_tests import comparisons
image = np.random.default_rng(0).integers(0, 256, (24, 48), dtype=np.uint8).repeat(10, 0).repeat(10, 1)
image = np.clip(image + np.random.default_rng(1).normal(0, 2, image.shape), 0, 255).astype(np.uint8)
xy, octave, bits, levels = _native.OrbExtractor(500, 4, 1.2, 10, comparisons()).extract(image)
print(_native.instruction_set(), xy.sum(), octave.sum(), int(bits.sum()), sum(int(m.sum()) for m in levels))
"""


def test_the_build_for_every_machine_sees_the_same_features() -> None:
    """Integer arithmetic throughout, but for the turn of the descriptor: the sums differ if anything does."""
    said = [
        subprocess.run(
            [sys.executable, "-c", _PRINT_FEATURES],
            env=os.environ | {"BGS_KERNELS": build},
            capture_output=True,
            text=True,
            check=True,
        ).stdout.split()
        for build in ("baseline", "")
    ]
    assert said[0][0] == "baseline"
    assert said[0][1:3] == said[1][1:3]
    assert said[0][4] == said[1][4]


def test_threads_may_share_an_extractor() -> None:
    images = [np.random.default_rng(k).integers(0, 256, (200, 300), dtype=np.uint8) for k in range(4)]
    extractor = _native.OrbExtractor(500, 4, 1.2, 10, comparisons())
    alone = [extractor.extract(image)[2] for image in images]
    with ThreadPoolExecutor(2) as pool:
        together = list(pool.map(lambda image: extractor.extract(image)[2], images * 5))
    for k, bits in enumerate(together):
        np.testing.assert_array_equal(bits, alone[k % 4])
