"""Archives unpacked into a folder: made here by tarfile and zipfile, whole, cut, and such as to do harm."""

from __future__ import annotations

import io
import shutil
import tarfile
import zipfile
from collections.abc import Callable
from pathlib import Path, PurePosixPath
from typing import NamedTuple

import pytest

from bench.errors import BenchError
from bench.io.archives import NoRoomError, unpack

CONTENT = {"top/a/1.png": b"one" * 1000, "top/a/2.png": b"", "top/b/x.txt": b"x"}


def tar_of(path: Path, files: dict[str, bytes], mode: str = "w") -> Path:
    with tarfile.open(path, mode) as tar:  # type: ignore[call-overload]
        for name, content in files.items():
            info = tarfile.TarInfo(name)
            info.size = len(content)
            tar.addfile(info, io.BytesIO(content))
    return path


def tgz_of(path: Path, files: dict[str, bytes]) -> Path:
    return tar_of(path, files, "w:gz")


def zip_of(path: Path, files: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as bundle:
        bundle.writestr(zipfile.ZipInfo("top/a/"), b"")
        for name, content in files.items():
            bundle.writestr(name, content)
    return path


MAKERS = [tar_of, tgz_of, zip_of]


def below(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def without_top(path: PurePosixPath) -> PurePosixPath | None:
    return None if path.name == "x.txt" else PurePosixPath(*path.parts[1:])


@pytest.mark.parametrize("make", MAKERS)
def test_what_is_wanted_where_it_is_wanted(tmp_path: Path, make: Callable[..., Path]) -> None:
    archive, folder = make(tmp_path / "a.bin", CONTENT), tmp_path / "out"
    left = folder / ".unpacking-a.bin" / "a" / "3.png"  # by a process that was killed
    left.parent.mkdir(parents=True)
    left.touch()
    assert unpack(archive, folder, without_top) == [PurePosixPath("a/1.png"), PurePosixPath("a/2.png")]
    assert below(folder) == {"a/1.png": b"one" * 1000, "a/2.png": b""}
    assert [entry.name for entry in folder.iterdir()] == ["a"]


@pytest.mark.parametrize(
    ("make", "share"),
    [*((make, share) for make in MAKERS for share in (0.0, 0.3, 0.45)), (tgz_of, 0.98), (zip_of, 0.98)],
)
def test_a_cut_archive_leaves_nothing(tmp_path: Path, make: Callable[..., Path], share: float) -> None:
    archive, folder = make(tmp_path / "a.bin", CONTENT), tmp_path / "out"
    archive.write_bytes(archive.read_bytes()[: int(share * archive.stat().st_size)])
    with pytest.raises(BenchError, match=r"a\.bin is damaged \(.+\)\. Download it again"):
        unpack(archive, folder, without_top)
    assert below(folder) == {}


@pytest.mark.parametrize("make", MAKERS)
@pytest.mark.parametrize("name", ["top/../../x", "/x", "top\\..\\x"])
def test_one_member_that_leads_out_spoils_all(tmp_path: Path, make: Callable[..., Path], name: str) -> None:
    archive = make(tmp_path / "a.bin", CONTENT | {name: b"harm"})
    with pytest.raises(BenchError, match="which leads out of its folder"):
        unpack(archive, tmp_path / "in" / "out", without_top)
    assert below(tmp_path).keys() == {"a.bin"}


@pytest.mark.parametrize("kind", [tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.FIFOTYPE, tarfile.CHRTYPE])
def test_links_and_devices_are_refused(tmp_path: Path, kind: bytes) -> None:
    with tarfile.open(tmp_path / "a.tar", "w") as tar:
        info = tarfile.TarInfo("top/a")
        info.type, info.linkname = kind, "/etc"
        tar.addfile(info)
    with pytest.raises(BenchError, match=r"top/a in a\.tar is a link or no file"):
        unpack(tmp_path / "a.tar", tmp_path / "out", without_top)
    assert below(tmp_path).keys() == {"a.tar"}


class _Usage(NamedTuple):
    total: int
    used: int
    free: int


def test_more_than_the_disk_has_is_no_fault_of_the_archive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    archive = zip_of(tmp_path / "a.zip", CONTENT)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: _Usage(10_000, 7_001, 2_999))
    with pytest.raises(NoRoomError, match=r"a\.zip needs more space than is free, at top/a/1\.png.*set \$BGS_DATA"):
        unpack(archive, tmp_path / "out", without_top)
    assert below(tmp_path).keys() == {"a.zip"}


def test_far_more_than_its_size_lets_expect(tmp_path: Path) -> None:
    """A header that claims 1 TB; nothing of it is written."""
    with tarfile.open(tmp_path / "a.tar", "w") as tar:
        info = tarfile.TarInfo("top/a")
        info.size = 10**12
        tar.addfile(info)
    with pytest.raises(BenchError, match=r"a\.tar holds far more than its size lets expect, at top/a"):
        unpack(tmp_path / "a.tar", tmp_path / "out", without_top)
    assert below(tmp_path).keys() == {"a.tar"}


def test_a_zip_file_with_a_password(tmp_path: Path) -> None:
    archive = zip_of(tmp_path / "a.zip", {"top/a": b"x"})
    content = bytearray(archive.read_bytes())
    for header, flag in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        content[content.rindex(header) + flag] |= 1  # as the format marks an encrypted member
    archive.write_bytes(content)
    with pytest.raises(BenchError, match=r"a\.zip is damaged \(.*password"):
        unpack(archive, tmp_path / "out", without_top)
