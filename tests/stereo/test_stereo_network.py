"""The base class of networks, around a block matcher: scale, strips, left-right check, and what it refuses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stereo_pairs import block_match, card_before_wall, shifted_pair

from bench.contracts.stereo import Matched
from bench.errors import BenchError
from bench.stereo.network import NetworkConfig, StereoNetwork
from bench.stereo.padding import next_multiple, pad_to
from bench.stereo.resizing import resize_disparity
from bench.types import DepthMap, Image, Map, StereoCamera, StereoFrame


class Blocks(StereoNetwork):
    """The block matcher as a network; remembers the sizes it was given."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__(config)
        self.seen: list[tuple[int, ...]] = []

    def match(self, left: Image, right: Image) -> Map:
        self.seen.append(left.shape)
        return block_match(left, right)


class Given(StereoNetwork):
    """Returns what it was made with."""

    def __init__(self, answer: object, **settings: Any) -> None:
        super().__init__(NetworkConfig(**settings))
        self._answer = answer

    def match(self, left: Image, right: Image) -> Map:
        return self._answer  # type: ignore[return-value]


@pytest.mark.parametrize(("scale", "shape"), [(1.0, (61, 203, 3)), (0.5, (30, 102, 3)), (2.0, (122, 406, 3))])
def test_disparity_is_in_pixels_of_the_full_image_at_any_scale(scale: float, shape: tuple[int, ...]) -> None:
    network = Blocks(NetworkConfig(scale=scale))
    disparity = network.disparity(*shifted_pair(61, 203, 16))
    assert network.seen == [shape]
    assert (disparity.shape, disparity.dtype) == ((61, 203), np.float32)
    # Whole pixels of the fed image are 1 / scale pixels here; 102 / 203 makes 16 px of it 8.04.
    assert np.nanmedian(disparity) == pytest.approx(16, abs=0.15)


def test_scaling_follows_the_widths_and_not_the_setting() -> None:
    # 5 columns fed for 9: a disparity of 2 there is 2 * 9 / 5 here.
    np.testing.assert_allclose(resize_disparity(np.full((3, 5), 2, np.float32), (6, 9)), 3.6, rtol=1e-6)


def test_unknown_pixels_do_not_leak_into_known_ones() -> None:
    disparity = np.full((4, 8), 3.0, np.float32)
    disparity[:, :4] = np.nan
    resized = resize_disparity(disparity, (8, 16))
    assert np.isnan(resized[:, :8]).all()
    np.testing.assert_allclose(resized[:, 8:], 6.0)


def test_left_right_check_drops_what_the_right_camera_cannot_see() -> None:
    left, right, hidden = card_before_wall(60, 200, near=30, far=10)
    unchecked = Blocks(NetworkConfig()).disparity(left, right)
    checked = Blocks(NetworkConfig(left_right_check_px=1.0)).disparity(left, right)
    inner = slice(10, 50)
    assert np.isfinite(unchecked[inner, hidden]).mean() > 0.9
    # The block is 7 px wide: at the border of the hidden strip it still sees some of what is visible.
    assert np.isfinite(checked[inner, hidden]).mean() < 0.25
    np.testing.assert_array_equal(checked[inner, 105:145], 30)
    np.testing.assert_array_equal(checked[inner, 20:75], 10)


def test_left_right_check_is_in_pixels_of_the_full_image() -> None:
    """At half size a disagreement of one fed pixel is two of the full image."""

    class OneOff(StereoNetwork):
        calls = 0

        def match(self, left: Image, right: Image) -> Map:
            self.calls += 1
            return np.full(left.shape[:2], 5.0 + self.calls % 2, np.float32)

    pair = shifted_pair(20, 80, 4)
    known = [
        np.isfinite(OneOff(NetworkConfig(scale=0.5, left_right_check_px=px)).disparity(*pair)).mean()
        for px in (1.9, 2.1)
    ]
    assert known[0] == 0
    assert known[1] > 0.8


class Sure(StereoNetwork):
    """12 px everywhere, 13 in the second match of a pair; as sure as the image's green is bright."""

    calls = 0

    def match(self, left: Image, right: Image) -> Matched:
        self.calls += 1
        confidence = left[..., 1].astype(np.float32) / np.float32(255)
        return Matched(np.full(left.shape[:2], 13.0 - self.calls % 2, np.float32), confidence)


@pytest.mark.parametrize(
    ("settings", "factor"),
    [
        ({}, 1.0),
        ({"tile_rows": 7, "tile_overlap": 2}, 1.0),
        # Off by 1 px of 2; with half the size, by 1 fed pixel of 2 px / 2.
        ({"left_right_check_px": 2.0}, np.exp(-1 / 2)),
        ({"left_right_check_px": 2.0, "scale": 0.5}, np.exp(-1)),
    ],
)
def test_confidence_is_the_networks_times_that_of_the_left_right_check(settings: dict[str, Any], factor: float) -> None:
    green = np.tile(np.uint8([0, 204, 0]), (20, 80, 1))
    network = Sure(NetworkConfig(**settings))
    confidence = network.matched(green, green).confidence
    assert confidence is not None
    assert (confidence.shape, confidence.dtype) == ((20, 80), np.float32)
    np.testing.assert_allclose(confidence[:, 30:], 0.8 * factor, rtol=1e-5)
    frame, camera = StereoFrame(0, 0.0, green, green), StereoCamera(80, 20, 60.0, 60.0, 40.0, 10.0, (0.5, 0, 0))
    assert Sure(NetworkConfig(**settings)).depth(frame, 0, camera).confidence is not None
    if "left_right_check_px" in settings:
        assert (confidence[:, :12] == 0).all(), "the right camera does not see it"


def test_strips_keep_each_pixels_confidence() -> None:
    green = np.zeros((33, 9, 3), np.uint8)
    green[..., 1] = np.arange(33 * 9).reshape(33, 9) % 256
    whole, strips = (Sure(NetworkConfig(tile_rows=rows)).matched(green, green).confidence for rows in (0, 10))
    assert whole is not None
    np.testing.assert_array_equal(whole, strips)


@pytest.mark.parametrize(
    ("confidence", "text"),
    [
        (
            np.zeros((20, 79), np.float32),
            r"Given\.match gave a confidence that is float32 \(20, 79\); expected",
        ),
        (np.zeros((20, 80)), r"that is float64 \(20, 80\)"),
        (np.full((20, 80), 1.01, np.float32), r"reaches from 1\.01 to 1\.01"),
        (np.full((20, 80), np.nan, np.float32), r"reaches from nan"),
        (0.5, "that is float; expected"),
    ],
)
def test_a_wrong_confidence_names_the_network(confidence: Any, text: str) -> None:
    disparity = np.full((20, 80), 3, np.float32)
    with pytest.raises(BenchError, match=text):
        Given(Matched(disparity, confidence)).disparity(*shifted_pair(20, 80, 3))
    with pytest.raises(BenchError, match=text.replace(r"Given\.match", "MyDepth")):
        DepthMap(disparity, "MyDepth", confidence)


@pytest.mark.parametrize("rows", [20, 33, 64])
def test_strips_equal_the_whole_where_the_matcher_sees_no_further(rows: int) -> None:
    pair = shifted_pair(101, 160, 9)
    network = Blocks(NetworkConfig(tile_rows=rows, tile_overlap=3))
    np.testing.assert_array_equal(network.disparity(*pair), Blocks(NetworkConfig()).disparity(*pair))
    assert len(network.seen) == -(-101 // rows)
    assert max(shape[0] for shape in network.seen) <= rows + 6


def test_strips_without_overlap_differ() -> None:
    """Else the test above would say nothing."""
    pair = shifted_pair(101, 160, 9, seed=3)
    pair[1][::7] = np.random.default_rng(0).integers(0, 255, pair[1][::7].shape, np.uint8)
    cut = Blocks(NetworkConfig(tile_rows=20, tile_overlap=0)).disparity(*pair)
    assert (cut != Blocks(NetworkConfig()).disparity(*pair)).any()


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (np.ones((20, 79), np.float32), r"Given\.match returned an array of shape \(20, 79\); expected \(20, 80\)"),
        (np.full((20, 80), -4, np.float32), r"Given\.match returned no disparity above zero .* sign wrong"),
        (
            np.full((20, 80), np.nan, np.float32),
            r"Given returned no number at all, only NaN: it divides by zero, or the images are not normalised",
        ),
        (None, "Given.match returned NoneType"),
    ],
)
def test_wrong_answers_are_named(answer: object, message: str) -> None:
    with pytest.raises(BenchError, match=message):
        Given(answer).disparity(*shifted_pair(20, 80, 4))


def test_what_is_not_positive_becomes_unknown() -> None:
    answer = np.full((20, 80), 4, np.float32)
    answer[0, :3] = (0, -1, np.inf)
    disparity = Given(answer).disparity(*shifted_pair(20, 80, 4))
    assert np.isnan(disparity[0, :3]).all()
    assert np.isfinite(disparity).sum() == 20 * 80 - 3


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"scale": 0.0}, r"stereo\.scale=0\.0 must be between 0\.05 and 4"),
        ({"tile_rows": -1}, r"stereo\.tile_rows=-1 .* must not be negative"),
        ({"left_right_check_px": -1.0}, r"stereo\.left_right_check_px=-1\.0 must be 0"),
        ({"weights": "nowhere.pth"}, r"stereo\.weights=nowhere\.pth is no file\. Correct the path"),
    ],
)
def test_wrong_settings(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(BenchError, match=message):
        Blocks(NetworkConfig(**settings))


def test_images_of_two_sizes() -> None:
    left, right = shifted_pair(20, 80, 4)
    with pytest.raises(BenchError, match=r"left image is \(20, 80, 3\), the right one \(20, 79, 3\)"):
        Blocks(NetworkConfig()).disparity(left, right[:, :79])


def test_weights_are_named_for_the_provenance(tmp_path: Path) -> None:
    file = tmp_path / "net.bin"
    file.touch()
    assert Blocks(NetworkConfig(weights=str(file))).weights() == {"network": file}
    assert Blocks(NetworkConfig()).weights() == {}


@pytest.mark.parametrize(("side", "top", "left"), [("top_right", 3, 0), ("bottom_right", 0, 0), ("centred", 1, 2)])
def test_padding_repeats_the_border_and_finds_the_image_again(side: str, top: int, left: int) -> None:
    image = np.random.default_rng(0).integers(0, 255, (13, 27, 3), np.uint8)
    padded, window = pad_to(image, next_multiple((13, 27), 16), side)
    assert padded.shape == (16, 32, 3)
    np.testing.assert_array_equal(padded[top : top + 13, left : left + 27], image)
    np.testing.assert_array_equal(padded[window], image)
    np.testing.assert_array_equal(padded[:, -1], padded[:, left + 26])
