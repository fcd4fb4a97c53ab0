"""What goes over the wire, and what is refused when it comes."""

from __future__ import annotations

import io
import json
import pickle
import struct

import numpy as np
import pytest

from bench.peers.messages import MalformedMessageError, Message, encode, read_message


def read(content: bytes) -> Message:
    stream = io.BytesIO(content)

    def exactly(size: int) -> bytes:
        piece = stream.read(size)
        if len(piece) < size:
            raise EOFError
        return piece

    message = read_message(exactly)
    assert stream.read() == b""
    return message


def wire(header: object, body: bytes = b"") -> bytes:
    text = json.dumps(header).encode()
    return struct.pack("<4sI", b"BGSP", len(text)) + text + body


def test_what_is_read_is_what_was_written() -> None:
    picture = np.random.default_rng(0).integers(0, 256, (7, 10), dtype=np.uint8)
    arrays = {"every second column": picture[:, ::2], "none": np.empty((0, 4, 4)), "one": np.array(-5)}
    message = read(b"".join(map(bytes, encode(Message("track", {"number": 3, "t": 0.1}, arrays)))))
    assert (message.kind, message.fields) == ("track", {"number": 3, "t": 0.1})
    assert list(message.arrays) == list(arrays)
    for name, array in arrays.items():
        np.testing.assert_array_equal(message.arrays[name], array)
        assert message.arrays[name].dtype == array.dtype


def test_the_wire_format_is_the_documented_one() -> None:
    header = {"kind": "pose", "fields": {"map": 1}, "arrays": [["a", "int64", [2]], ["b", "uint8", [1, 2]]]}
    message = read(wire(header, struct.pack("<2q", 7, -1) + b"\x01\xff"))
    assert message.kind == "pose"
    assert message.fields == {"map": 1}
    assert message.arrays["a"].tolist() == [7, -1]
    assert message.arrays["b"].tolist() == [[1, 255]]


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"Segmentation fault (core dumped)", "it begins with b'Segm'"),
        (pickle.dumps(print), "it begins with"),
        (struct.pack("<4sI", b"BGSP", 1 << 30), "it begins with"),
        (struct.pack("<4sI", b"BGSP", 2) + b"\xff\xfe", "header can't be read"),
        (wire([1, 2]), "header can't be read"),
        (wire({"kind": "pose", "fields": {}}), "header can't be read"),
        (wire({"kind": 1, "fields": {}, "arrays": []}), "no kind or no fields"),
        (wire({"kind": "pose", "fields": {}, "arrays": [["T", "object", [1]]]}, bytes(8)), "'T' is object of shape"),
        (wire({"kind": "pose", "fields": {}, "arrays": [["T", "float64", [-1]]]}), "of shape \\(-1,\\)"),
        (wire({"kind": "pose", "fields": {}, "arrays": [["T", "float64", [4, 1 << 40]]]}), "is too large"),
    ],
)
def test_nonsense_is_refused(content: bytes, reason: str) -> None:
    with pytest.raises(MalformedMessageError, match=reason):
        read(content)


def test_an_array_of_objects_is_not_sent() -> None:
    with pytest.raises(TypeError, match="'T' is object; a message carries uint8, int64, float64"):
        encode(Message("track", {}, {"T": np.array([None])}))
