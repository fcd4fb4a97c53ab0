"""ONNX networks of every calling convention around a matcher with known answers, and a real one (NVTiny)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stereo_pairs import end_point_error, kitti_2015_sample, shifted_pair
from tiny_onnx import block_matcher, channel_reader, sure_reader

from bench.errors import BenchError
from plugins.stereo.onnx import OnnxConfig, OnnxStereo

HEIGHT, WIDTH, SHIFT = 45, 150, 12


def opened(path: Path, **settings: Any) -> OnnxStereo:
    return OnnxStereo(OnnxConfig(weights=str(path), device="cpu", threads=1, **settings))


@pytest.mark.parametrize(
    ("graph", "settings"),
    [
        ({}, {}),
        ({}, {"preset": "left_right_disp", "pad_side": "top_right"}),
        ({"names": ("left_values", "right_values", "disparity"), "squeezed": True}, {"preset": "stereo_matching"}),
        ({"names": ("b", "a", "c")}, {"left": "b", "right": "a", "output": "c"}),
        ({"layout": "nhwc"}, {"layout": "nhwc", "colours": "unit"}),
        ({"stacked": "channels"}, {"stacked": "channels", "colours": "signed"}),
        ({"stacked": "batch"}, {"stacked": "batch"}),
        ({"gain": -1.0}, {"gain": -1.0}),
        ({"gain": -0.25}, {"gain": -4.0}),
        # A size that the file fixes: the image fits and is padded, ...
        ({"size": (64, 160)}, {}),
        ({"size": (HEIGHT, WIDTH)}, {"fit": "pad"}),
    ],
)
def test_finds_a_known_shift(graph: dict[str, Any], settings: dict[str, Any], tmp_path: Path) -> None:
    network = opened(block_matcher(tmp_path / "net.onnx", **graph), **settings)
    disparity = network.disparity(*shifted_pair(HEIGHT, WIDTH, SHIFT))
    assert (disparity.shape, disparity.dtype) == ((HEIGHT, WIDTH), np.float32)
    assert (disparity[5:-5, SHIFT + 5 : -5] == SHIFT).mean() > 0.98


@pytest.mark.parametrize(("fixed", "unit", "gain"), [(75, "px", 1.0), (300, "px", 1.0), (75, "width", 1 / 75)])
def test_resized_images_bring_back_pixels_of_their_own(fixed: int, unit: str, gain: float, tmp_path: Path) -> None:
    """... or it is resized: 12 px of 150 are 6 of 75 and 24 of 300, and all of them are a share of 0.08."""
    file = block_matcher(tmp_path / "net.onnx", size=(HEIGHT, fixed), gain=gain, disparities=32)
    disparity = opened(file, fit="resize", unit=unit).disparity(*shifted_pair(HEIGHT, WIDTH, SHIFT))
    assert np.nanmedian(disparity[:, SHIFT + 5 :]) == pytest.approx(SHIFT, abs=0.01)


@pytest.mark.parametrize(
    ("colours", "red", "blue"),
    [
        ("raw", 200.0, 50.0),
        ("unit", 200 / 255, 50 / 255),
        ("signed", 2 * 200 / 255 - 1, 2 * 50 / 255 - 1),
        ("imagenet", (200 / 255 - 0.485) / 0.229, (50 / 255 - 0.406) / 0.225),
    ],
)
def test_colours_reach_the_network_as_told(colours: str, red: float, blue: float, tmp_path: Path) -> None:
    image = np.tile(np.array([200, 100, 50], np.uint8), (32, 64, 1))
    for channel, value in ((0, red), (2, blue)):
        network = opened(channel_reader(tmp_path / f"{channel}.onnx", channel), colours=colours)
        np.testing.assert_allclose(network.disparity(image, image), 10 + value, atol=1e-4)


def test_a_second_output_says_how_sure_the_network_is(tmp_path: Path) -> None:
    image = np.tile(np.array([200, 51, 0], np.uint8), (20, 50, 1))
    file = sure_reader(tmp_path / "net.onnx")
    disparity, confidence = opened(file, confidence="sure").matched(image, image)
    assert (disparity == 210).all()
    assert confidence is not None
    assert confidence.shape == (20, 50)
    np.testing.assert_allclose(confidence, 0.2, rtol=1e-6)
    assert opened(file).matched(image, image).confidence is None
    with pytest.raises(BenchError, match=r"stereo\.confidence=shure: .*Did you mean 'sure'"):
        opened(file, confidence="shure")


def test_two_runs_are_equal_to_the_bit(tmp_path: Path) -> None:
    network = opened(block_matcher(tmp_path / "net.onnx"))
    pair = shifted_pair(HEIGHT, WIDTH, SHIFT)
    first = network.disparity(*pair)
    network.disparity(*shifted_pair(HEIGHT, WIDTH, 3, seed=1))
    np.testing.assert_array_equal(network.disparity(*pair), first)


@pytest.mark.parametrize(
    ("graph", "settings", "message"),
    [
        (
            {},
            {"left": "leftt"},
            r"stereo\.left=leftt: .*net\.onnx has 'left' \(1, 3, h, w\) float, 'right' \(1, 3, h, w\) float, and no "
            r"'leftt' among them\. Did you mean 'left'\? Give one of these names, or its position from 0\.",
        ),
        ({}, {"output": "1"}, r"stereo\.output=1: .* has 'disp' \(1, 1, h, w\) float, and no '1' among them"),
        ({"stacked": "channels"}, {}, r"stereo\.right=1: .* has 'left' \(1, 6, h, w\) float, and no '1'"),
        (
            {},
            {"stacked": "channels"},
            r"has the inputs 'left' .*, 'right' .*; stereo\.preset=generic feeds 'left'\. Set",
        ),
        ({}, {"right": "left"}, r"feeds 'left'\. Set left, right and stacked so that each is fed once"),
        (
            {"layout": "nhwc"},
            {},
            r"'left' \(1, h, w, 3\) float does not have 3 channels where stereo\.layout=nchw says",
        ),
        ({"stacked": "channels"}, {"stacked": "batch"}, r"does not have 3 channels .* or stereo\.stacked"),
        ({}, {"preset": "nvtini"}, r"stereo\.preset='nvtini' is not one of .* Did you mean 'nvtiny'"),
        ({}, {"colours": "bgr"}, r"stereo\.colours='bgr' is not one of unit, raw, signed, imagenet"),
        ({}, {"gain": 0.0}, r"stereo\.gain=0\.0 must not be 0"),
        ({}, {"dtype": "bfloat16"}, r"stereo\.dtype=bfloat16: an ONNX file has its own number format"),
    ],
)
def test_what_the_file_does_not_have(
    graph: dict[str, Any], settings: dict[str, Any], message: str, tmp_path: Path
) -> None:
    file = block_matcher(tmp_path / "net.onnx", disparities=2, **graph)
    with pytest.raises(BenchError, match=message):
        opened(file, **settings)


def test_wrong_sign_is_told(tmp_path: Path) -> None:
    network = opened(block_matcher(tmp_path / "net.onnx", gain=-1.0))
    with pytest.raises(BenchError, match=r"OnnxStereo\.match returned no disparity above zero .* Is its sign wrong"):
        network.disparity(*shifted_pair(HEIGHT, WIDTH, SHIFT))


def test_an_image_larger_than_the_file_allows(tmp_path: Path) -> None:
    network = opened(block_matcher(tmp_path / "net.onnx", size=(32, 160), disparities=2), fit="pad")
    with pytest.raises(BenchError, match=r"takes images of 160x32, and the frame is 150x45\. Use stereo\.fit=resize"):
        network.disparity(*shifted_pair(HEIGHT, WIDTH, SHIFT))


def test_a_graph_that_refuses_its_input(tmp_path: Path) -> None:
    # Four rows are fewer than its padding needs, and no other size is fixed.
    network = opened(block_matcher(tmp_path / "net.onnx", size=(64, "w"), disparities=2))
    with pytest.raises(BenchError, match=r"net\.onnx can't compute with 'left' \(1, 3, 96, 160\) float32"):
        network.disparity(*shifted_pair(70, WIDTH, SHIFT))


def test_files_that_are_no_onnx(tmp_path: Path) -> None:
    file = tmp_path / "net.onnx"
    file.write_bytes(b"<html>quota exceeded</html>")
    with pytest.raises(BenchError, match=r"onnxruntime can't open .*net\.onnx: .*Is it an ONNX file"):
        opened(file)


def test_a_file_is_needed() -> None:
    with pytest.raises(BenchError, match=r"stereo=onnx needs the network's file: give stereo\.weights=FILE\.onnx"):
        OnnxStereo(OnnxConfig())


@pytest.mark.slow
def test_nvtiny_on_kitti_2015(test_data: Path, weights_root: Path) -> None:
    """Measured outside this project: end-point error 1.73 px."""
    left, right, truth = kitti_2015_sample(test_data)
    network = OnnxStereo(OnnxConfig(preset="nvtiny", device="cpu"))
    assert network.weights() == {"network": weights_root / "nvtiny" / "nvtiny_161x513.onnx"}
    disparity = network.disparity(left, right)
    assert end_point_error(disparity, truth) == pytest.approx(1.73, abs=0.02)
    np.testing.assert_array_equal(network.disparity(left, right), disparity)
