"""The file of one entry: every bit comes back, and no damage passes for an answer."""

from __future__ import annotations

import hashlib
import zlib

import numpy as np
import pytest

from bench.cache.entry import DamagedEntryError, Stored, decode, encode, seal
from bench.cache.recording import Recording


def test_every_bit_of_a_depth_map_comes_back() -> None:
    """All kinds of float32: both zeros, infinities, denormals, NaNs with different payloads, random mantissas."""
    rng = np.random.default_rng(0)
    bits = rng.integers(0, 2**32, size=(37, 53), dtype=np.uint32)
    bits[0, :6] = [0x80000000, 0x7F800000, 0xFF800000, 0x00000001, 0x7FC00000, 0x7FC12345]
    depth = bits.view(np.float32)
    back = decode(encode(Stored(depth, 1.25, "net")))
    assert (back.seconds, back.source, back.array.dtype, back.array.shape) == (1.25, "net", np.float32, (37, 53))
    assert np.array_equal(back.array.view(np.uint32), bits)
    back.array[0, 0] = 1.0  # the caller may write to it
    turned = np.asfortranarray(depth)
    assert np.array_equal(decode(encode(Stored(turned, 0.0, ""))).array.view(np.uint32), bits)


def test_a_confidence_comes_back_with_its_depth() -> None:
    rng = np.random.default_rng(2)
    depth, confidence = (rng.random((5, 7)).astype(np.float32) for _ in range(2))
    back = decode(encode(Stored(depth, 0.5, "net", confidence[:, ::-1])))
    assert np.array_equal(back.array, depth)
    assert back.confidence is not None
    assert np.array_equal(back.confidence, confidence[:, ::-1])
    assert decode(encode(Stored(depth, 0.5, "net"))).confidence is None


@pytest.mark.parametrize("shape", [(1, 1), (7, 9), (16, 16)])
def test_every_pixel_of_a_mask_comes_back(shape: tuple[int, int]) -> None:
    mask = np.random.default_rng(1).random(shape) < 0.5
    back = decode(encode(Stored(mask, 0.5, "")))
    assert back.array.dtype == np.bool_
    assert np.array_equal(back.array, mask)
    back.array[0, 0] = True


def test_a_sky_mask_is_small() -> None:
    mask = np.zeros((370, 1226), dtype=bool)
    mask[:150] = True
    assert len(encode(Stored(mask, 0.0, ""))) < 2000


def test_any_changed_byte_and_any_cut_is_seen() -> None:
    whole = encode(Stored(np.arange(12, dtype=np.float32).reshape(3, 4), 0.1, "net"))
    for place in range(len(whole)):
        changed = bytearray(whole)
        changed[place] ^= 0x10
        with pytest.raises(DamagedEntryError):
            decode(bytes(changed))
    for length in range(len(whole)):
        with pytest.raises(DamagedEntryError):
            decode(whole[:length])
    with pytest.raises(DamagedEntryError, match="no cache entry"):
        decode(b"\x93NUMPY...")


def test_the_format_is_what_it_says() -> None:
    """Read by hand: a line with the checksum, a line of JSON, the plain little-endian floats."""
    first, header, payload = encode(Stored(np.full((2, 2), 1.5, np.float32), 0.25, "a")).split(b"\n", 2)
    assert first == f"bgs-cache 2 {hashlib.sha256(header + bytes([10]) + payload).hexdigest()}".encode()
    assert header == b'{"dtype": "float32", "shape": [2, 2], "seconds": 0.25, "source": "a"}'
    assert payload == bytes.fromhex("0000c03f") * 4


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"no line",
        b"[]\n",
        b'{"dtype": "float32", "shape": [2, 2], "seconds": 0, "source": ""}\nshort',
        b'{"dtype": "float32", "shape": [-1, 4], "seconds": 0, "source": ""}\n' + bytes(16),
        b'{"dtype": "float32", "shape": [99999999999, 9], "seconds": 0, "source": ""}\n' + bytes(16),
        b'{"dtype": "bool", "shape": [3, 3], "seconds": 0, "source": ""}\n' + zlib.compress(bytes(10**6))[:-9],
        b'{"dtype": "bool", "shape": [9999999, 9999999], "seconds": 0, "source": ""}\n' + zlib.compress(bytes(9)),
        b'{"dtype": "float32", "shape": [1, 1], "seconds": {}, "source": ""}\n' + bytes(4),
    ],
)
def test_what_is_whole_and_no_answer_is_refused(body: bytes) -> None:
    with pytest.raises(DamagedEntryError, match="no depth map or mask"):
        decode(seal(body))
    with pytest.raises(DamagedEntryError, match="no recording"):
        Recording.decode(seal(body))
