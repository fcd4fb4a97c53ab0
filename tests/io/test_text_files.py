"""Text as editors save it: the same words in every encoding that a mark tells, and the line where there is no text."""

from __future__ import annotations

import codecs
from pathlib import Path

import pytest

from bench.errors import BenchError
from bench.io.text_files import read_text

TEXT = "P0: 1 2 ä\nTr: 3\n"


@pytest.mark.parametrize(
    "content",
    [
        TEXT.encode(),
        codecs.BOM_UTF8 + TEXT.encode(),
        codecs.BOM_UTF16_LE + TEXT.encode("utf-16-le"),
        codecs.BOM_UTF16_BE + TEXT.encode("utf-16-be"),
        b"P0: 1 2 \xc3\xa4\n" + codecs.BOM_UTF8 + b"Tr: 3\n",
    ],
)
def test_byte_order_marks_do_not_matter(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "calib.txt").write_bytes(content)
    assert read_text(tmp_path / "calib.txt") == TEXT


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"1\n2\nL\xe4nge\n", "line 3: byte 0xe4 is not UTF-8. It must be a text file; save it as UTF-8"),
        ("1\n2".encode("utf-16-le"), "line 1: a zero byte, as in UTF-16 without a mark"),
        (codecs.BOM_UTF16_LE + b"1\x002", "is not UTF-16"),
    ],
)
def test_what_is_no_text_is_named_with_its_line(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "times.txt"
    path.write_bytes(content)
    with pytest.raises(BenchError) as error:
        read_text(path, "file of times")
    assert str(error.value).startswith(f"Can't read the file of times {path}, line ")
    assert message in str(error.value)
