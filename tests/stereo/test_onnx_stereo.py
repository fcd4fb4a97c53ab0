"""ONNX networks of every calling convention around a matcher with known answers, and a real one (NVTiny)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stereo_pairs import end_point_error, kitti_2015_sample, shifted_pair

from bench.errors import BenchError
from plugins.stereo.onnx import OnnxConfig, OnnxStereo
from tests.stereo.tiny_onnx import INT8, UINT8, block_matcher, channel_reader, reshaped_matcher, sure_reader

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
        # ... or one side of it.
        ({"size": (64, "w")}, {}),
        ({"size": ("h", 160)}, {"pad_multiple": 8}),
        # What is read from the inputs: names in another order, grey, stacked, layout, whole numbers.
        ({"names": ("left_image", "right_image", "d"), "right_first": True}, {}),
        ({"names": ("image1", "image2", "d"), "right_first": True}, {}),
        ({"names": ("b", "a", "c"), "right_first": True}, {"right": "a"}),
        ({"names": ("imgL", "imgR", "d")}, {}),
        ({"names": ("image1", "image2", "d")}, {}),
        ({"colours": 1}, {}),
        ({"colours": 1, "layout": "nhwc"}, {}),
        ({"colours": 1, "stacked": "channels"}, {"colours": "imagenet"}),
        ({"colours": "c"}, {"grey": True}),
        ({"stacked": "channels"}, {}),
        ({"stacked": "batch"}, {}),
        ({"layout": "nhwc"}, {}),
        ({"element_type": UINT8}, {}),
        ({"element_type": INT8, "colours": 1}, {"mean": (128.0,)}),
        # A flow of two channels, four inputs in two sizes.
        ({"flow": True}, {}),
        ({"flow": True, "gain": -1.0}, {"gain": -1.0, "channel": 0}),
        ({"half": ("init_left", "init_right"), "names": ("next_left", "next_right", "next_output")}, {}),
        ({"half": ("left_2", "right_2"), "size": (64, 160)}, {}),
        ({"half": ("a", "b"), "flow": True}, {"left": "left", "right": "right", "half_left": "a", "half_right": "b"}),
    ],
)
def test_finds_a_known_shift(graph: dict[str, Any], settings: dict[str, Any], tmp_path: Path) -> None:
    network = opened(block_matcher(tmp_path / "net.onnx", **graph), **settings)
    disparity = network.disparity(*shifted_pair(HEIGHT, WIDTH, SHIFT))
    assert (disparity.shape, disparity.dtype) == ((HEIGHT, WIDTH), np.float32)
    assert (disparity[5:-5, SHIFT + 5 : -5] == SHIFT).mean() > 0.98


@pytest.mark.parametrize(
    ("graph", "settings"),
    [
        ({"shrink": 4}, {}),
        ({"shrink": 2, "flow": True, "gain": -1.0}, {"gain": -1.0}),
        # In pixels of the full image though the output is smaller.
        ({"shrink": 4, "gain": 4.0}, {"unit": "px"}),
        # The file's own size is half of the image's, and its output half of that.
        ({"shrink": 2, "size": (24, 76)}, {"fit": "resize"}),
    ],
)
def test_a_smaller_output_is_brought_to_the_images_size(
    graph: dict[str, Any], settings: dict[str, Any], tmp_path: Path
) -> None:
    network = opened(block_matcher(tmp_path / "net.onnx", **graph), **settings)
    disparity = network.disparity(*shifted_pair(HEIGHT, WIDTH, SHIFT))
    assert disparity.shape == (HEIGHT, WIDTH)
    assert np.nanmedian(disparity[8:-8, SHIFT + 16 : -16]) == pytest.approx(SHIFT, abs=0.25)


def test_what_was_read_from_the_file_is_logged(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    file = block_matcher(tmp_path / "net.onnx", colours=1, stacked="channels", names=("x", "x", "disp"))
    network = opened(file)
    with caplog.at_level("INFO"):
        for _ in range(2):
            network.disparity(*shifted_pair(HEIGHT, WIDTH, SHIFT))
    (line,) = caplog.messages
    assert "left and right: 'x' (1, 2, h, w) float, grey, nchw; disparity: 'disp' (1, 1, h, w) float" in line


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
        (
            {"stacked": "channels"},
            {"stacked": ""},
            r"has the inputs 'left' \(1, 6, h, w\) float, and none of them would",
        ),
        (
            {},
            {"stacked": "channels"},
            r"has the inputs 'left' .*, 'right' .*: stereo\.stacked=channels feeds 'left' alone",
        ),
        (
            {},
            {"left": "right", "right": "right"},
            r"'right' would be fed\. Set stereo\.left .* so that each is fed once",
        ),
        (
            {"layout": "nhwc"},
            {"layout": "nchw"},
            r"'left' \(1, h, w, 3\) float does not have 1 or 3 channels where stereo\.layout=nchw says",
        ),
        ({"stacked": "channels"}, {"stacked": "batch"}, r"does not have 1 or 3 channels .* or set stereo\.stacked"),
        ({}, {"grey": True}, r"'left' \(1, 3, h, w\) float takes colour images; leave stereo\.grey out"),
        ({}, {"channel": 2}, r"one map, and no channel 2\. Leave stereo\.channel out"),
        ({}, {"preset": "nvtini"}, r"stereo\.preset='nvtini' is not one of .* Did you mean 'nvtiny'"),
        ({}, {"colours": "bgr"}, r"stereo\.colours='bgr' is not one of unit, raw, signed, imagenet"),
        ({}, {"gain": 0.0}, r"stereo\.gain=0\.0 must not be 0"),
        ({}, {"std": (0.0,)}, r"stereo\.std=\[0\.0\] must be one or three numbers above 0"),
        ({}, {"mean": (1.0, 2.0)}, r"stereo\.mean=\[1\.0, 2\.0\] must be one or three numbers"),
        ({}, {"dtype": "bfloat16"}, r"stereo\.dtype=bfloat16: an ONNX file has its own number format"),
    ],
)
def test_what_the_file_does_not_have(
    graph: dict[str, Any], settings: dict[str, Any], message: str, tmp_path: Path
) -> None:
    file = block_matcher(tmp_path / "net.onnx", disparities=2, **graph)
    with pytest.raises(BenchError, match=message):
        opened(file, **settings).disparity(*shifted_pair(HEIGHT, WIDTH, SHIFT))


@pytest.mark.parametrize(("gain", "cure"), [(1.0, "-1"), (-0.25, "0.25")])
def test_wrong_sign_is_told_with_the_setting_that_turns_it(gain: float, cure: str, tmp_path: Path) -> None:
    network = opened(block_matcher(tmp_path / "net.onnx", gain=-1 if gain > 0 else 1), gain=gain)
    with pytest.raises(BenchError, match=rf"no disparity above zero .* Is its sign wrong \(set stereo\.gain={cure}\)"):
        network.disparity(*shifted_pair(HEIGHT, WIDTH, SHIFT))


@pytest.mark.parametrize(("gain", "says"), [(256.0, "the median is 3072"), (1 / 150, "the largest 0.")])
def test_a_unit_that_is_no_pixel_is_told_once(
    gain: float, says: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    network = opened(block_matcher(tmp_path / "net.onnx", gain=gain))
    for _ in range(2):
        network.disparity(*shifted_pair(HEIGHT, WIDTH, SHIFT))
    (line,) = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert says in line
    assert "Change stereo.gain=1 stereo.unit=output" in line


def test_an_image_larger_than_the_file_allows(tmp_path: Path) -> None:
    network = opened(block_matcher(tmp_path / "net.onnx", size=(32, 160), disparities=2), fit="pad")
    with pytest.raises(BenchError, match=r"takes images of 160x32, and the frame is 150x45\. Use stereo\.fit=resize"):
        network.disparity(*shifted_pair(HEIGHT, WIDTH, SHIFT))


def test_a_graph_that_refuses_its_input(tmp_path: Path) -> None:
    """Its reshape wants 64 rows, which its inputs do not say."""
    network = opened(reshaped_matcher(tmp_path / "net.onnx", rows=64))
    with pytest.raises(BenchError, match=r"net\.onnx can't compute with 'left' \(1, 3, 96, 160\) float32"):
        network.disparity(*shifted_pair(70, WIDTH, SHIFT))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"<html>quota exceeded</html>", r"onnxruntime can't open .*net\.onnx: it is a web page \(HTML\)"),
        (b"version https://git-lfs.github.com/spec/v1\n", r"it is a Git LFS pointer, which was not fetched\. Run `git"),
        (b"\x08\x08\x12\x07", r"onnxruntime can't open .*Is it an ONNX file, with the side files"),
    ],
)
def test_files_that_are_no_onnx(content: bytes, message: str, tmp_path: Path) -> None:
    file = tmp_path / "net.onnx"
    file.write_bytes(content)
    with pytest.raises(BenchError, match=message):
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
