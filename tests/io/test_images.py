"""Pictures as files hold them: pixel values written by another library, read as they are stored and scaled as one."""

from __future__ import annotations

import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from bench.errors import BenchError
from bench.io.images import ImageSequence, read_rgb

GREY = np.arange(256, dtype=np.uint8).reshape(8, 32)
COLOUR = np.random.default_rng(0).integers(0, 256, (8, 32, 3), dtype=np.uint8)


def save(path: Path, values: np.ndarray) -> Path:
    assert cv2.imwrite(str(path), values)
    return path


def with_sbit(path: Path, bits: int) -> Path:
    """Put an sBIT chunk behind the header of a grey PNG."""
    content = path.read_bytes()
    chunk = b"sBIT" + bytes([bits])
    path.write_bytes(
        content[:33] + (1).to_bytes(4, "big") + chunk + zlib.crc32(chunk).to_bytes(4, "big") + content[33:]
    )
    return path


@pytest.mark.parametrize("bits", [8, 10, 12, 14])
def test_cameras_of_fewer_bits_in_16_bit_files(tmp_path: Path, bits: int) -> None:
    """The darker frame of a sequence and the other camera have the scale of the brightest."""
    deep = GREY.astype(np.uint16) << (bits - 8)
    paths = [save(tmp_path / "a.png", deep), save(tmp_path / "b.png", deep // 16)]
    images = ImageSequence(paths[1:], paths)
    np.testing.assert_array_equal(images.read(paths[0])[..., 1], GREY)
    np.testing.assert_array_equal(images.read(paths[1])[..., 1], GREY // 16)
    (remark,) = images.remarks
    assert f"use {bits} bits (largest value {deep.max()})" in remark


def test_full_16_bits_are_read_by_their_high_byte(tmp_path: Path) -> None:
    path = save(tmp_path / "a.png", GREY.astype(np.uint16) * 257)
    images = ImageSequence([path], [path])
    assert images.remarks == ()
    np.testing.assert_array_equal(images.read(path)[..., 0], GREY)


def test_the_file_says_how_many_bits_count(tmp_path: Path) -> None:
    dark = (GREY // 8).astype(np.uint16) << 4
    said = with_sbit(save(tmp_path / "a.png", dark), 12)
    np.testing.assert_array_equal(ImageSequence([said], [said]).read(said)[..., 0], GREY // 8)
    full = with_sbit(save(tmp_path / "b.png", GREY.astype(np.uint16) * 257), 12)
    np.testing.assert_array_equal(ImageSequence([full], [full]).read(full)[..., 0], GREY)


def pictures(tmp_path: Path) -> dict[str, tuple[Path, np.ndarray]]:
    """Files by another library, and the RGB that they hold."""
    palette = Image.fromarray(COLOUR).quantize(16)
    alpha = Image.fromarray(np.dstack([COLOUR, GREY]))
    grey_alpha = Image.merge("LA", [Image.fromarray(GREY), Image.fromarray(255 - GREY)])
    black_white = Image.fromarray(GREY > 99)
    made = {"palette": palette, "RGBA": alpha, "LA": grey_alpha, "1 bit": black_white}
    for name, picture in made.items():
        picture.save(tmp_path / f"{name}.png")
    repeated = {"LA": GREY, "1 bit": np.where(GREY > 99, 255, 0).astype(np.uint8)}
    truth = {"palette": np.asarray(palette.convert("RGB")), "RGBA": COLOUR}
    truth |= {name: np.dstack([values] * 3) for name, values in repeated.items()}
    return {name: (tmp_path / f"{name}.png", truth[name]) for name in made}


@pytest.mark.parametrize("name", ["palette", "RGBA", "LA", "1 bit"])
def test_kinds_of_png(tmp_path: Path, name: str) -> None:
    path, truth = pictures(tmp_path)[name]
    images = ImageSequence([path], [path])
    np.testing.assert_array_equal(images.read(path), truth)
    assert images.remarks == ()


@pytest.mark.parametrize("orientation", [3, 6])
def test_orientation_is_left_to_viewers(tmp_path: Path, orientation: int) -> None:
    smooth = Image.fromarray(np.dstack([GREY] * 3))
    smooth.save(tmp_path / "plain.jpg", quality=95)
    exif = Image.Exif()
    exif[0x0112] = orientation
    smooth.save(tmp_path / "turned.jpg", quality=95, exif=exif)
    plain, turned = (read_rgb(tmp_path / name, (32, 8)) for name in ("plain.jpg", "turned.jpg"))
    np.testing.assert_array_equal(turned, plain)


def test_tiff_called_png_is_refused(tmp_path: Path) -> None:
    Image.fromarray(GREY.astype(np.float32)).save(tmp_path / "a.png", format="TIFF")
    with pytest.raises(BenchError, match=r"a\.png is not a PNG or JPEG image"):
        ImageSequence([tmp_path / "a.png"], [])
